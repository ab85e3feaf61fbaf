// Direct lengths: against a dense solve of the same equations, and for what they promise: no stretch on hair that is
// held by its root, and what cannot be avoided shared where both ends are held.
#include <Eigen/Dense>
#include <catch2/catch.hpp>

#include "sim/measure.h"
#include "sim/passes/direct_length.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

constexpr double kCompliance = 1e-3f;  // HELD_COMPLIANCE

// Lengths alone: whatever moves is moved by gravity, by the head and by what is left of its velocity.
RegionParams lengths_alone() {
  RegionParams region;
  region.damping = 0;
  region.local.stiffness = 0;
  region.global.stiffness = 0;
  return region;
}

// One strand, as direct_length.h has it, with every system written out in full.
struct Reference {
  std::vector<double> length;  // rest length of the segment that ends there
  std::vector<bool> pinned;
  std::size_t last_pinned = 1;
  std::vector<double> tension;  // as `length`

  Reference(const Points& rest, const std::vector<bool>& pins)
      : length(rest.size(), 0), pinned(pins), tension(rest.size(), 0) {
    for (std::size_t i = 1; i < rest.size(); ++i) {
      length[i] = (rest[i] - rest[i - 1]).norm();
      if (pinned[i]) last_pinned = i;
    }
  }

  void solve(Points& p) {
    const auto n = static_cast<Eigen::Index>(p.size()) - 2;  // segments 2 .. size - 1
    if (n <= 0) return;
    const auto vertex = [](Eigen::Index row) { return static_cast<std::size_t>(row) + 2; };
    Eigen::MatrixXd gradient = Eigen::MatrixXd::Zero(n, 3 * n);  // of C, by the coordinates of vertices 2 and on
    Eigen::VectorXd error(n), weight(3 * n), compliance(n);
    for (Eigen::Index row = 0; row < n; ++row) {
      const std::size_t j = vertex(row);
      const Vector3d edge = p[j] - p[j - 1];
      const double now = edge.norm();
      const Vector3d u = now > 1e-15 ? Vector3d(edge / now) : Vector3d(0, 0, 0);
      error[row] = now > 1e-15 ? now - length[j] : 0;
      gradient.block<1, 3>(row, 3 * row) = u.transpose();
      if (row > 0) gradient.block<1, 3>(row, 3 * row - 3) = -u.transpose();
      weight.segment<3>(3 * row).setConstant(pinned[j] ? 0 : 1);
      compliance[row] = j <= last_pinned ? kCompliance : 0;
    }
    Eigen::MatrixXd system = gradient * weight.asDiagonal() * gradient.transpose();
    system += Eigen::MatrixXd(compliance.asDiagonal());
    // A point has no row of its own to solve.
    for (Eigen::Index row = 0; row < n; ++row) {
      if (gradient.row(row).squaredNorm() == 0) system(row, row) = 1;
    }
    const Eigen::VectorXd lambda = system.fullPivLu().solve(error);
    const Eigen::VectorXd move = weight.asDiagonal() * (gradient.transpose() * lambda);
    for (Eigen::Index row = 0; row < n; ++row) {
      p[vertex(row)] -= move.segment<3>(3 * row);
      tension[vertex(row)] += lambda[row];
    }
  }

  void walk(Points& p) const {
    const Points before = p;
    Vector3d direction = (before[1] - before[0]).normalized();
    for (std::size_t i = 2; i < p.size(); ++i) {
      const Vector3d edge = before[i] - p[i - 1];
      if (edge.norm() > 1e-15) direction = edge.normalized();
      if (i > last_pinned) p[i] = p[i - 1] + length[i] * direction;
    }
  }

  // The tension that the substep before has found, along directions that come out of it.
  std::vector<double> pull(Points& p) const {
    const auto n = static_cast<Eigen::Index>(p.size());
    std::vector<double> a(p.size() + 1, 0);
    Eigen::MatrixXd system = Eigen::MatrixXd::Identity(n, n);
    Eigen::MatrixXd free(n, 3);
    for (Eigen::Index i = 0; i < n; ++i) {
      const auto v = static_cast<std::size_t>(i);
      free.row(i) = p[v].transpose();
      if (v >= 2 && length[v] > 0) a[v] = std::max(tension[v] / length[v] - 0.125, 0.0);
    }
    for (Eigen::Index i = 2; i < n; ++i) {
      const auto v = static_cast<std::size_t>(i);
      if (pinned[v]) continue;
      system(i, i) += a[v] + a[v + 1];
      system(i, i - 1) -= a[v];
      if (i + 1 < n) system(i, i + 1) -= a[v + 1];
    }
    const Eigen::MatrixXd moved = system.fullPivLu().solve(free);
    for (Eigen::Index i = 0; i < n; ++i) p[static_cast<std::size_t>(i)] = moved.row(i).transpose();
    return a;
  }

  // What it is going to take of the motion, by the stiffness matrix of the tension.
  std::vector<Vector3d> returned(const Points& now, const Points& before) const {
    std::vector<Vector3d> back(now.size(), Vector3d::Zero());
    for (std::size_t j = 2; j < now.size(); ++j) {
      if (length[j] <= 0) continue;
      const double ratio = std::min(std::max(tension[j] / length[j], 0.0), 2.0);
      const Vector3d force = 0.9375 * ratio * ((now[j] - now[j - 1]) - (before[j] - before[j - 1]));
      back[j] += force;
      back[j - 1] -= force;
    }
    return back;
  }

  // A substep from the positions `now` and those of the substep before.
  Points step(const Points& rest, const Points& now, const Points& before, const Isometry3d& head,
              const Vector3d& fall) {
    Points p = now;
    const std::vector<Vector3d> back = returned(now, before);
    for (std::size_t i = 0; i < p.size(); ++i)
      p[i] = pinned[i] ? Vector3d(head * rest[i]) : Vector3d(now[i] + (now[i] - before[i]) + back[i] + fall);
    const std::vector<double> a = pull(p);
    for (std::size_t j = 2; j < p.size(); ++j) tension[j] = a[j] * std::min((p[j] - p[j - 1]).norm(), length[j]);
    for (int round = 0; round < 2; ++round) solve(p);
    walk(p);
    return p;
  }
};

std::vector<bool> pins_of(const Groom& groom, std::size_t strand) {
  const std::vector<std::uint8_t> all = pinned_vertices(groom);
  return {all.begin() + static_cast<std::ptrdiff_t>(groom.offset[strand]),
          all.begin() + static_cast<std::ptrdiff_t>(groom.offset[strand + 1])};
}

Points part_of(const Points& all, const Groom& groom, std::size_t strand) {
  return {all.begin() + static_cast<std::ptrdiff_t>(groom.offset[strand]),
          all.begin() + static_cast<std::ptrdiff_t>(groom.offset[strand + 1])};
}

// Free, pinned at the tip, in the middle, at both, and twice in the middle: one after the other.
void pin_in_many_ways(Groom& groom) {
  for (std::size_t s = 0; s < groom.strand_count(); ++s) {
    const std::size_t n = groom.vertex_count(s);
    if (n < 6) continue;
    if (s % 5 == 1 || s % 5 == 3) pin(groom, s, n - 1);
    if (s % 5 == 2 || s % 5 == 3) pin(groom, s, n / 2);
    if (s % 5 == 4) pin(groom, s, n / 3);
    if (s % 5 == 4) pin(groom, s, n / 3 + 1);
  }
}

// What is wrong with the length of any segment that is not between pinned vertices.
struct Stretch {
  double share = 0;   // of the rest length
  double metres = 0;  // [m]
};
Stretch stretch_of_held_by_root(const Groom& groom, const Points& now) {
  Stretch largest;
  for (std::size_t s = 0; s < groom.strand_count(); ++s) {
    const std::vector<bool> pinned = pins_of(groom, s);
    for (std::size_t i = groom.vertex_count(s) - 1; i > 1 && !pinned[i]; --i) {
      const std::size_t v = groom.offset[s] + i;
      const double rest = (groom.position[v] - groom.position[v - 1]).norm();
      const double off = std::abs((now[v] - now[v - 1]).norm() - rest);
      largest.share = std::max(largest.share, off / rest);
      largest.metres = std::max(largest.metres, off);
    }
  }
  return largest;
}

// Turns twice a frame at 24 frames a second, and jumps.
Isometry3d wild(double time) {
  const Eigen::Matrix3d turn = (Eigen::AngleAxisd(300 * time, Vector3d::UnitX()) *
                                Eigen::AngleAxisd(170 * std::sin(3 * time), Vector3d::UnitZ()))
                                   .toRotationMatrix();
  return pose(turn, {std::sin(40 * time), std::floor(8 * time), 0.5 * std::cos(90 * time)});
}

template <class Real>
Vec3<Real> vec(const Vector3d& v) {
  return {static_cast<Real>(v.x()), static_cast<Real>(v.y()), static_cast<Real>(v.z())};
}
template <class Real>
Vector3d point(const Vec3<Real>& v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}

}  // namespace

// Each frame, one substep long, from the positions that the solver itself had before it, so that errors do not pile up.
// Measured: 5e-15 m in double, 5e-7 m in float, where 0.3 m rounds at 1.5e-8 m.
TEST_CASE("the direct solve is the dense solve of the same equations, wherever strands are pinned") {
  Shot shot;
  shot.groom = mixed_groom(71, 60, 40);
  pin_in_many_ways(shot.groom);
  shot.region = lengths_alone();
  shot.head = dance;
  shot.fps = 120;
  shot.frames = 60;
  const bool in_float = GENERATE(false, true);
  const std::vector<Points> taken = run(shot, {.precision = in_float ? Precision::Float : Precision::Double});
  const Vector3d fall = shot.gravity / (shot.fps * shot.fps);
  double farthest = 0;
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
    const Points rest = points_of(shot.groom, s);
    Reference reference(rest, pins_of(shot.groom, s));
    for (int frame = 1; frame <= shot.frames; ++frame) {
      const auto f = static_cast<std::size_t>(frame);
      const Points now = part_of(taken[f - 1], shot.groom, s);
      const Points before = part_of(taken[f >= 2 ? f - 2 : 0], shot.groom, s);
      const Points expected = reference.step(rest, now, before, shot.head(frame / shot.fps), fall);
      farthest = std::max(farthest, largest_distance(part_of(taken[f], shot.groom, s), expected));
    }
  }
  CAPTURE(in_float, farthest);
  CHECK(farthest < (in_float ? 5e-6 : 1e-13));
  CHECK(largest_distance(taken.front(), taken.back()) > 0.05);
}

// Float has 6e-8 m at a metre from the groom's centre, and a length is the difference of two positions. Measured: at
// most 6.1e-8 m and 6.2e-6 of a length.
TEST_CASE("hair that is held by its root does not stretch, in wild motion and among spheres too") {
  Shot shot;
  const bool calm = GENERATE(false, true);
  if (calm) {
    Random random(72);
    for (int s = 0; s < 20; ++s) add_strand(shot.groom, curly(21, 0.19, 0.01, 2, 0.1 * random.direction()));
  } else {
    shot.groom = mixed_groom(72, 40, 64);
    pin_in_many_ways(shot.groom);
  }
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  shot.head = calm ? dance : wild;
  shot.fps = 24;
  shot.frames = 48;
  shot.substeps = GENERATE(1, 3);
  const bool spheres = GENERATE(false, true);
  if (spheres) {
    shot.spheres = [head = shot.head](double time) {
      const Vector3d center = head(time) * Vector3d(0, -0.05, 0);
      return std::vector<Sphere>{{center, 0.12}, {{0, 0, 0}, 0.3}, {head(time - 0.02) * Vector3d(0, 0, 0), 0.2}};
    };
  }
  for (const bool in_float : {false, true}) {
    double share = 0, metres = 0;
    for (const Points& now : run(shot, {.precision = in_float ? Precision::Float : Precision::Double})) {
      const Stretch stretch = stretch_of_held_by_root(shot.groom, now);
      share = std::max(share, stretch.share);
      metres = std::max(metres, stretch.metres);
    }
    CAPTURE(calm, shot.region.local.method, shot.substeps, spheres, in_float, 1e6 * share, 1e6 * metres);
    CHECK(metres < (in_float ? 2e-7 : 1e-14));
    CHECK(share < (in_float ? 1e-5 : 1e-12));
  }
}

// No walk can satisfy both ends, so there lengths are as good as two rounds of Newton's method make them: with the head
// still for two seconds, what is left of the tension that the rounds bear leaves a residual. Measured with 4 substeps
// at 60 frames a second 9e-7, 1.7e-5, 3.8e-5 with 12, 24 and 48 vertices, with 16 at most 1.2e-5.
TEST_CASE("between two pins the residual is small where lengths can hold") {
  const std::size_t n = GENERATE(std::size_t{12}, std::size_t{24}, std::size_t{48});
  Shot shot;
  shot.groom = groom_of({curly(n, 0.2, 0.02, 2)});
  pin(shot.groom, 0, n - 1);
  shot.region = lengths_alone();
  shot.region.damping = 0.1;
  shot.frames = 240;
  shot.head = [](double time) { return dance(std::min(time, 2.0)); };
  for (const int substeps : {4, 16}) {
    shot.substeps = substeps;
    double moving = 0, still = 0;
    for (const Points& now : run(shot, in_double())) {
      still = 0;
      for (std::size_t i = 2; i < n; ++i) {
        const double rest = (shot.groom.position[i] - shot.groom.position[i - 1]).norm();
        still = std::max(still, std::abs((now[i] - now[i - 1]).norm() / rest - 1));
      }
      moving = std::max(moving, still);
    }
    CAPTURE(n, substeps, moving, still);
    CHECK(moving < 5e-4);
    CHECK(still < (substeps == 4 ? 1e-4 : 2e-5));
  }
}

// A rigid head never pulls its pins apart, so this one grows, by a quarter in a second.
TEST_CASE("between two pins that are too far apart all segments stretch alike") {
  const std::size_t n = 34;
  Shot shot;
  shot.groom = groom_of({straight(n, 0.3, {0, 0, 0}, {1, 0, 0})});
  pin(shot.groom, 0, n - 1);
  shot.region = lengths_alone();
  shot.region.damping = 0.2;
  shot.gravity = {0, 0, 0};
  shot.frames = 120;
  shot.head = [](double time) {
    Isometry3d grown = Isometry3d::Identity();
    grown.linear() *= 1 + 0.25 * std::min(time, 1.0);
    return grown;
  };
  const bool in_float = GENERATE(false, true);
  const std::vector<Points> taken = run(shot, {.precision = in_float ? Precision::Float : Precision::Double});
  for (const std::size_t frame : {std::size_t{30}, std::size_t{60}, std::size_t{120}}) {
    const double grown = 1 + 0.25 * std::min(static_cast<double>(frame) / 60, 1.0);
    double least = 1e9, most = 0;
    for (std::size_t i = 2; i < n; ++i) {
      const double ratio = (taken[frame][i] - taken[frame][i - 1]).norm() / (0.3 / static_cast<double>(n - 1));
      least = std::min(least, ratio);
      most = std::max(most, ratio);
    }
    CAPTURE(in_float, frame, least, most);
    CHECK(least > 0.99 * grown);
    CHECK(most < 1.01 * grown);
  }
}

TEMPLATE_TEST_CASE("a vertex swings out of a sphere to the nearest point at its length", "", float, double) {
  Random random(74);
  const double epsilon = std::numeric_limits<TestType>::epsilon();
  int tried = 0;
  while (tried < 400) {
    const Vector3d near = random.in_cube(0.5), center = random.in_cube(0.5);
    const double length = random.uniform(0.05, 1), radius = random.uniform(0.05, 0.6);
    const Vector3d p = near + length * random.direction();
    const double away = (center - near).norm();
    if ((p - center).norm() > 0.99 * radius || away < 0.05) continue;
    if (away + length < 1.01 * radius) continue;  // nowhere to go
    ++tried;
    const Vector3d out = point(swing_out_of_sphere(vec<TestType>(p), vec<TestType>(near), static_cast<TestType>(length),
                                                   vec<TestType>(center), static_cast<TestType>(radius)));
    const double tolerance = 100 * epsilon;
    CAPTURE(length, radius, away);
    CHECK(std::abs((out - near).norm() - length) < tolerance);
    CHECK(std::abs((out - center).norm() - radius) < 4 * tolerance);
    // All around the circle where both are right.
    const Vector3d axis = (center - near) / away;
    const Vector3d across = axis.unitOrthogonal(), third = axis.cross(across);
    const double along = (length * length + away * away - radius * radius) / (2 * away);
    const double aside = std::sqrt(std::max(0.0, length * length - along * along));
    for (int k = 0; k < 360; ++k) {
      const double angle = 2 * std::numbers::pi * k / 360;
      const Vector3d other = near + axis * along + (across * std::cos(angle) + third * std::sin(angle)) * aside;
      CHECK((out - p).norm() < (other - p).norm() + tolerance);
    }
    // And anywhere else at that length and out of the sphere.
    for (int k = 0; k < 50; ++k) {
      const Vector3d other = near + length * random.direction();
      if ((other - center).norm() > radius) CHECK((out - p).norm() < (other - p).norm() + tolerance);
    }
  }
}

TEMPLATE_TEST_CASE("a vertex that cannot leave a sphere goes where it is least deep", "", float, double) {
  Random random(75);
  for (int trial = 0; trial < 200; ++trial) {
    const Vector3d center = random.in_cube(0.1), near = center + random.uniform(0.01, 0.2) * random.direction();
    const double away = (near - center).norm(), length = random.uniform(0.01, 0.2), radius = away + length + 0.05;
    const Vector3d p = near + length * random.direction();
    const Vector3d out = point(swing_out_of_sphere(vec<TestType>(p), vec<TestType>(near), static_cast<TestType>(length),
                                                   vec<TestType>(center), static_cast<TestType>(radius)));
    const Vector3d expected = near + (near - center) * (length / away);
    // A root of a difference of squares that should be 0.
    const double tolerance = 4 * std::sqrt(std::numeric_limits<TestType>::epsilon()) * length;
    CHECK((out - expected).norm() < tolerance + 1e-6);
  }
}

TEMPLATE_TEST_CASE("odd places of a vertex, its sphere and the vertex before are taken care of", "", float, double) {
  const auto swing = [](const Vector3d& p, const Vector3d& near, double length, const Vector3d& center, double radius) {
    return point(swing_out_of_sphere(vec<TestType>(p), vec<TestType>(near), static_cast<TestType>(length),
                                     vec<TestType>(center), static_cast<TestType>(radius)));
  };
  const double tolerance = 8 * static_cast<double>(std::numeric_limits<TestType>::epsilon());
  SECTION("outside, not a bit changes") {
    const Vector3d p = {0.25, 0.3125, -0.4375};
    CHECK(swing(p, {0.25, 0.3125, 0}, 0.4375, {0, 0, 0}, 0.5) == p);
  }
  SECTION("straight at the centre it goes to one side") {
    for (const Vector3d& axis : {Vector3d(1, 0, 0), Vector3d(0, 1, 0), Vector3d(0, 0, 1), Vector3d(0, 0, -1)}) {
      const Vector3d out = swing(axis * 0.5, {0, 0, 0}, 0.5, axis * 0.75, 0.5);
      CHECK(std::abs(out.norm() - 0.5) < tolerance);
      CHECK(std::abs((out - axis * 0.75).norm() - 0.5) < tolerance);
    }
  }
  SECTION("where the vertex before is the centre there is nothing nearer") {
    const Vector3d p = {0.25, 0, 0};
    CHECK(swing(p, {0, 0, 0}, 0.25, {0, 0, 0}, 0.5) == p);
  }
  SECTION("a segment of no length stays a point") {
    const Vector3d p = {0.25, 0.125, 0};
    CHECK((swing(p, p, 0, {0, 0, 0}, 0.5) - p).norm() < 1e-7);
  }
}

TEST_CASE("segments of no length stay points, and their neighbours keep their lengths") {
  Random random(76);
  Shot shot;
  for (int s = 0; s < 12; ++s) add_strand(shot.groom, stuttering(random, 24, 0.1 * random.direction()));
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  shot.head = wild;
  shot.frames = 30;
  const bool in_float = GENERATE(false, true);
  double off = 0;
  for (const Points& now : run(shot, {.precision = in_float ? Precision::Float : Precision::Double})) {
    for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
      for (std::size_t v = shot.groom.offset[s] + 1; v < shot.groom.offset[s + 1]; ++v) {
        const double rest = (shot.groom.position[v] - shot.groom.position[v - 1]).norm();
        off = std::max(off, std::abs((now[v] - now[v - 1]).norm() - rest));
      }
    }
  }
  CAPTURE(in_float, shot.region.local.method, off);
  CHECK(off < (in_float ? 1e-7 : 1e-15));
}

TEST_CASE("the direct solve leaves hair that is at its lengths alone, to the bit") {
  Shot shot;
  shot.groom = mixed_groom(77, 40, 64);
  pin_in_many_ways(shot.groom);
  shot.region = lengths_alone();
  shot.gravity = {0, 0, 0};
  shot.frames = 5;
  shot.substeps = 3;
  // Nothing may be left out because it is known to be at rest.
  SolverOptions options;
  options.skip.resting = false;
  options.precision = GENERATE(Precision::Float, Precision::Double);
  const std::vector<Points> taken = run(shot, options);
  for (const Points& now : taken) CHECK(same_bits(now, taken.front()));
}
