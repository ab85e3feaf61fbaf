// Motions whose answers are known in closed form, and what must hold of any motion.
#include <catch2/catch.hpp>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

constexpr double kPi = std::numbers::pi;

RegionParams nothing_but_integration() {
  RegionParams region;
  region.damping = 0;
  region.local.stiffness = 0;
  region.global.stiffness = 0;
  region.lengths = LengthParams::iterated(0);
  return region;
}

// log2 of the error's ratio where the number of substeps doubles.
double order(double coarse, double fine) {
  return std::log2(coarse / fine);
}

// Arithmetic-geometric mean.
double agm(double a, double b) {
  while (std::abs(a - b) > 1e-15 * a) {
    const double mean = (a + b) / 2;
    b = std::sqrt(a * b);
    a = mean;
  }
  return a;
}

// A segment of length 0.1 m that swings about its root, let go at `angle` from hanging. Vertices 0 and 1 hold the root.
constexpr double kArm = 0.1, kGravity = 9.81;
Shot pendulum(double angle, int substeps) {
  Shot shot;
  shot.groom = groom_of({{{0, 0.1, 0}, {0, 0, 0}, {kArm * std::sin(angle), -kArm * std::cos(angle), 0}}});
  shot.region = nothing_but_integration();
  shot.region.lengths = LengthParams::iterated(20);  // the first already sets the one free vertex on its circle
  shot.fps = 240;
  shot.substeps = substeps;
  shot.frames = 480;
  return shot;
}

// Time of the swing from the first to the third passage of the lowest point, each found by a straight line between
// frames.
double measured_period(const Shot& shot) {
  const std::vector<Points> taken = run(shot, in_double());
  std::vector<double> passages;
  for (std::size_t f = 1; f < taken.size(); ++f) {
    const double before = taken[f - 1][2].x(), after = taken[f][2].x();
    if ((before > 0) != (after > 0)) passages.push_back((static_cast<double>(f) - after / (after - before)) / shot.fps);
  }
  REQUIRE(passages.size() >= 3);
  return passages[2] - passages[0];
}

}  // namespace

// P_n = P_0 + a h^2 n (n + 1) / 2: the first substep starts from P = Q. In the limit P_0 + a t^2 / 2.
TEST_CASE("free fall is that of the discrete Verlet scheme, and converges to a parabola at first order") {
  std::vector<double> errors;
  for (const int substeps : {1, 2, 4, 8}) {
    Shot shot;
    shot.groom = groom_of({straight(12, 0.3, {0.2, 1, -0.1})});
    shot.region = nothing_but_integration();
    shot.gravity = {1, -9.81, 0.5};
    shot.substeps = substeps;
    shot.fps = 24;
    shot.frames = 24;
    const std::vector<Points> taken = run(shot, in_double());
    const double h = 1 / (shot.fps * substeps);
    for (std::size_t frame = 0; frame < taken.size(); ++frame) {
      const double n = static_cast<double>(frame) * substeps;
      for (std::size_t i = 0; i < 12; ++i) {
        const Vector3d expected = i < 2 ? shot.groom.position[i]
                                        : Vector3d(shot.groom.position[i] + shot.gravity * (h * h * n * (n + 1) / 2));
        REQUIRE((taken[frame][i] - expected).norm() < 1e-12);
      }
    }
    errors.push_back((taken.back()[11] - (shot.groom.position[11] + shot.gravity * 0.5)).norm());
  }
  // The error is a h t / 2 and nothing else.
  for (std::size_t k = 1; k < errors.size(); ++k) CHECK(order(errors[k - 1], errors[k]) == Approx(1).margin(1e-6));
}

// With the share k of the velocity kept: v_n = a h (1 - k^n) / (1 - k), so the fall ends at the speed a h / (1 - k).
TEST_CASE("a damped fall follows its closed form to its terminal speed") {
  const double damping = 0.15;
  std::vector<double> speeds;
  for (const int substeps : {1, 2, 4, 8, 16}) {
    Shot shot;
    shot.groom = groom_of({straight(3, 0.1)});
    shot.region = nothing_but_integration();
    shot.region.damping = damping;
    shot.substeps = substeps;
    shot.frames = 120;
    const std::vector<Points> taken = run(shot, in_double());
    const double h = 1 / (shot.fps * substeps), k = std::pow(1 - damping, 60 * h);
    for (std::size_t frame = 0; frame < taken.size(); ++frame) {
      const double n = static_cast<double>(frame) * substeps;
      // The sum of the first n velocities times h.
      const double fall = 9.81 * h * h / (1 - k) * (n - k * (1 - std::pow(k, n)) / (1 - k));
      // k is rounded to float: 6e-8 of it, times up to 1 / (1 - k) = 100.
      CHECK(taken[frame][2].y() == Approx(shot.groom.position[2].y() - fall).epsilon(1e-5).margin(1e-12));
    }
    speeds.push_back((taken[119][2].y() - taken[120][2].y()) * shot.fps);
    CHECK(speeds.back() == Approx(9.81 * h / (1 - k)).epsilon(1e-5));
  }
  // In the limit g / (-60 ln(1 - c)), reached at first order.
  const double limit = 9.81 / (-60 * std::log(1 - damping));
  for (std::size_t k = 1; k < speeds.size(); ++k) {
    CHECK(order(std::abs(speeds[k - 1] - limit), std::abs(speeds[k] - limit)) == Approx(1).margin(0.06));
  }
}

TEST_CASE("a segment swings with the period of a pendulum") {
  const auto errors_of = [](double angle, const std::vector<int>& substeps) {
    // Exact at any angle: 2 pi sqrt(L / g) / agm(1, cos(angle / 2)).
    const double expected = 2 * kPi * std::sqrt(kArm / kGravity) / agm(1, std::cos(angle / 2));
    std::vector<double> errors;
    for (const int count : substeps) errors.push_back(std::abs(measured_period(pendulum(angle, count)) / expected - 1));
    return errors;
  };
  SECTION("small, where it is 2 pi sqrt(L / g) but for angle^2 / 16: second order") {
    const double angle = 0.02;
    const std::vector<double> errors = errors_of(angle, {2, 4, 8});
    CAPTURE(errors[0], errors[1], errors[2]);
    CHECK(errors[2] < 1e-5);
    CHECK(order(errors[0], errors[1]) == Approx(2).margin(0.15));
    CHECK(order(errors[1], errors[2]) == Approx(2).margin(0.15));
    CHECK(measured_period(pendulum(angle, 8)) ==
          Approx(2 * kPi * std::sqrt(kArm / kGravity)).epsilon(angle * angle / 16 + 1e-5));
  }
  SECTION("large, where the swing that the projection takes away shortens the period: first order") {
    const std::vector<double> errors = errors_of(2.2, {16, 32, 64});
    CAPTURE(errors[0], errors[1], errors[2]);
    CHECK(errors[2] < 0.01);
    CHECK(order(errors[0], errors[1]) == Approx(1).margin(0.15));
    CHECK(order(errors[1], errors[2]) == Approx(1).margin(0.1));
  }
}

// Stiffness and damping are given per 1/60 s. A vertex pulled to its place with S and damped by c is a damped
// oscillator; what it has settled to after a while must not depend on how many substeps that while was cut into.
TEST_CASE("damping takes the same velocity whatever the number of substeps") {
  for (const double damping : {0.05, 0.3, 0.9}) {
    std::vector<double> speeds;
    for (const int substeps : {1, 2, 4, 8, 16}) {
      Shot shot;
      shot.groom = groom_of({straight(3, 0.1)});
      shot.regions_at = [damping](int frame) {
        RegionParams region = nothing_but_integration();
        region.damping = frame <= 10 ? 0 : damping;
        return std::vector<RegionParams>{region};
      };
      shot.substeps = substeps;
      shot.frames = 10;
      // Ten frames of free fall give the velocity, ten without gravity take it.
      const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), in_double());
      Points before(3), after(3);
      for (int frame = 1; frame <= 20; ++frame) {
        shot.gravity = frame <= 10 ? Vector3d(0, -9.81, 0) : Vector3d(0, 0, 0);
        solver->read(before);
        solver->advance(frame_input(shot, frame));
      }
      solver->read(after);
      // Velocity over the last frame, h (k + ... + k^n) v: divided by that sum it is the velocity at its start.
      const double k = std::pow(1 - damping, 1.0 / substeps);
      double sum = 0;
      for (int n = 1; n <= substeps; ++n) sum += std::pow(k, n) / substeps;
      speeds.push_back((before[2].y() - after[2].y()) * 60 / sum);
    }
    for (const double speed : speeds) {
      CHECK(speed == Approx(9.81 * 10 / 60 * std::pow(1 - damping, 9)).epsilon(1e-5).margin(1e-12));
    }
  }
}

TEST_CASE("the global shape settles in the same time whatever the number of substeps") {
  // A head that has jumped aside by 0.1 m: the time until a vertex is within a tenth of that of its place for good.
  const auto settling_time = [](double stiffness, double damping, int substeps) {
    Shot shot;
    shot.groom = groom_of({straight(3, 0.1)});
    shot.region = nothing_but_integration();
    shot.region.damping = damping;
    shot.region.global = {stiffness, 1, 0};
    shot.gravity = {0, 0, 0};
    shot.head = [](double time) { return pose(Eigen::Matrix3d::Identity(), {time > 0 ? 0.1 : 0.0, 0, 0}); };
    shot.fps = 60;
    shot.frames = 200;
    shot.substeps = substeps;
    const std::vector<Points> taken = run(shot, in_double());
    std::size_t settled = taken.size();
    while (settled > 0 && std::abs(taken[settled - 1][2].x() - 0.1) < 0.01) --settled;
    // Between the last frame outside and the first inside, by a straight line.
    const double outside = std::abs(taken[settled - 1][2].x() - 0.1), inside = std::abs(taken[settled][2].x() - 0.1);
    return (static_cast<double>(settled) - (0.01 - inside) / (outside - inside)) / shot.fps;
  };
  // Overdamped, so that the way there has no waves. 16 substeps are the yardstick.
  for (const double stiffness : {0.02, 0.05}) {
    const double damping = 0.6, fine = settling_time(stiffness, damping, 16);
    CAPTURE(stiffness, fine);
    for (const int substeps : {1, 2, 4, 8}) {
      CAPTURE(substeps);
      // A step is of first order: the difference to the fine one halves from line to line.
      CHECK(settling_time(stiffness, damping, substeps) == Approx(fine).epsilon(0.35 / substeps));
    }
  }
}

TEST_CASE("a stiffness of one is rigid, and none leaves free") {
  Shot shot;
  shot.groom = mixed_groom(31, 20, 30);
  shot.head = dance;
  shot.frames = 20;
  shot.substeps = GENERATE(1, 3);
  SECTION("the global shape freezes hair to the head, tips included") {
    shot.region.global = {1, 1, 0};
    shot.region.local.stiffness = 0.3;
    const std::vector<Points> taken = run(shot, in_double());
    for (int frame = 1; frame <= shot.frames; ++frame) {
      for (std::size_t v = 0; v < shot.groom.vertex_count(); ++v) {
        const Vector3d expected = shot.head(frame / shot.fps) * shot.groom.position[v];
        REQUIRE((taken[static_cast<std::size_t>(frame)][v] - expected).norm() < 1e-14);
      }
    }
  }
  SECTION("the local shape follows the head where it is swept often enough") {
    // Half the error of each vertex goes with each sweep, from the root on.
    shot.groom = mixed_groom(31, 20, 6);
    shot.region.global.stiffness = 0;
    shot.region.local = {1, 1000, 1};
    const std::vector<Points> taken = run(shot, in_double());
    for (std::size_t v = 0; v < shot.groom.vertex_count(); ++v) {
      CHECK((taken.back()[v] - shot.head(shot.frames / shot.fps) * shot.groom.position[v]).norm() < 1e-9);
    }
  }
  SECTION("without stiffness hair falls freely") {
    shot.region = nothing_but_integration();
    const Points end = run(shot, in_double()).back();
    const double n = shot.frames * shot.substeps, h = 1 / (shot.fps * shot.substeps);
    for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
      for (std::size_t v = shot.groom.offset[s] + 2; v < shot.groom.offset[s + 1]; ++v) {
        CHECK((end[v] - (shot.groom.position[v] + shot.gravity * (h * h * n * (n + 1) / 2))).norm() < 1e-13);
      }
    }
  }
}

TEST_CASE("pinned vertices are exactly where the head is at the end of each frame") {
  Shot shot;
  shot.groom = mixed_groom(32, 20, 30);
  for (std::size_t s = 0; s < 20; s += 3) pin(shot.groom, s, shot.groom.vertex_count(s) - 1);
  shot.head = [](double time) { return pose(Eigen::Matrix3d::Identity(), Vector3d(0.5, -0.25, 1) * time); };
  shot.fps = 32;
  shot.substeps = 3;
  shot.frames = 32;
  shot.spheres = [](double) { return std::vector<Sphere>{{{0.3, 0, 0.5}, 0.4}}; };
  const std::vector<Points> taken = run(shot, in_double());
  for (int frame = 0; frame <= shot.frames; ++frame) {
    const Vector3d moved = Vector3d(0.5, -0.25, 1) * (frame / shot.fps);
    for (std::size_t s = 0; s < 20; ++s) {
      const std::size_t first = shot.groom.offset[s];
      for (std::size_t v = first; v < shot.groom.offset[s + 1]; ++v) {
        if (v > first + 1 && shot.groom.pinned[v] == 0) continue;
        REQUIRE(taken[static_cast<std::size_t>(frame)][v] == shot.groom.position[v] + moved);
      }
    }
  }
}

// With exact lengths a strand whose root is in the sphere goes straight out as far as it has to.
TEST_CASE("no free vertex that can be out ends a frame inside a sphere") {
  Shot shot;
  shot.region.lengths = GENERATE(LengthParams{}, LengthParams::iterated(2));
  shot.groom = mixed_groom(33, 30, 40);
  shot.head = dance;
  shot.spheres = [](double time) { return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.03, 0), 0.12}}; };
  shot.frames = 30;
  const std::vector<Points> taken = run(shot, in_double());
  int touching = 0;
  for (int frame = 1; frame <= shot.frames; ++frame) {
    const Sphere sphere = shot.spheres(frame / shot.fps)[0];
    for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
      const Points& now = taken[static_cast<std::size_t>(frame)];
      double reach = (now[shot.groom.offset[s] + 1] - sphere.center).norm();
      for (std::size_t v = shot.groom.offset[s] + 2; v < shot.groom.offset[s + 1]; ++v) {
        const double distance = (now[v] - sphere.center).norm();
        reach += (shot.groom.position[v] - shot.groom.position[v - 1]).norm();
        const double out = shot.region.lengths.direct ? std::min(sphere.radius, reach) : sphere.radius;
        REQUIRE(distance > out - 1e-14);
        if (std::abs(distance - sphere.radius) < 1e-15) ++touching;
      }
    }
  }
  CHECK(touching > 100);
}

// Vertices 1 and n - 1 are held, so the chain hangs between them. With many sweeps its lengths hold to a share of a
// percent, and a chain of n segments differs from the catenary by O(1 / n^2).
TEST_CASE("a strand pinned at both ends sags to a catenary") {
  const std::size_t vertices = 34;
  const double span = 0.2, length = 0.3;  // of the 32 segments from vertex 1 to the end
  // The rest pose is a shallow wave of the right length between the pins, found by bisection.
  const auto wave = [&](double amplitude) {
    Points p = {{-0.01, 0, 0}};
    for (std::size_t i = 1; i < vertices; ++i) {
      const double u = static_cast<double>(i - 1) / static_cast<double>(vertices - 2);
      p.push_back({span * u, amplitude * std::sin(4 * kPi * u), 0});
    }
    return p;
  };
  const auto length_of = [](const Points& p) {
    double total = 0;
    for (std::size_t i = 2; i < p.size(); ++i) total += (p[i] - p[i - 1]).norm();
    return total;
  };
  double low = 0, high = 0.2;
  for (int k = 0; k < 60; ++k) (length_of(wave((low + high) / 2)) < length ? low : high) = (low + high) / 2;
  Shot shot;
  shot.groom = groom_of({wave(low)});
  pin(shot.groom, 0, vertices - 1);
  shot.region = nothing_but_integration();
  shot.region.damping = 0.2;
  shot.region.lengths = LengthParams::iterated(300);
  shot.substeps = 4;
  shot.frames = 300;
  const std::vector<Points> taken = run(shot, in_double());
  const Points& hanging = taken.back();
  CHECK(largest_distance(taken[static_cast<std::size_t>(shot.frames) - 30], hanging) < 1e-4);  // at rest
  CHECK(length_of(hanging) == Approx(length).epsilon(0.01));

  // y = a cosh((x - span/2) / a) with 2 a sinh(span / 2a) = length.
  double a_low = 0.01, a_high = 10;
  for (int k = 0; k < 80; ++k) {
    const double a = (a_low + a_high) / 2;
    (2 * a * std::sinh(span / (2 * a)) > length ? a_low : a_high) = a;
  }
  const double sag = a_low * (std::cosh(span / (2 * a_low)) - 1);
  double farthest = 0;
  for (std::size_t i = 1; i < vertices; ++i) {
    const double x = hanging[i].x();
    const double y = a_low * std::cosh((x - span / 2) / a_low) - a_low * std::cosh(span / (2 * a_low));
    farthest = std::max(farthest, std::abs(hanging[i].y() - y));
    CHECK(std::abs(hanging[i].z()) < 1e-12);
  }
  CAPTURE(sag, farthest);
  CHECK(farthest < 0.02 * sag);
}

TEST_CASE("wind carries hair along, and more drag carries it further") {
  Shot shot;
  shot.groom = groom_of({straight(20, 0.2)});
  shot.gravity = {0, 0, 0};
  shot.frames = 10;
  double before = 0;
  for (const double drag : {0.0, 0.5, 2.0}) {
    shot.region.drag = drag;
    shot.wind.velocity = {3, 0, 0};
    const double aside = run(shot, in_double()).back()[19].x();
    if (drag > 0) CHECK(aside > before + 1e-3);
    if (drag == 0) CHECK(aside == 0);
    before = aside;
  }
  SECTION("along the strand it slides off") {
    shot.region.drag = 5;
    shot.wind.velocity = {0, 7, 0};
    const std::vector<Points> taken = run(shot, in_double());
    CHECK(largest_distance(taken.back(), taken.front()) < 1e-14);
  }
}

// Rest frames do not know where a strand has bent to, so curls further down the strand point elsewhere. What is left
// between methods 1 and 4 is the order of constraints.
TEST_CASE("method 4 is nearer to method 1 than rest frames are") {
  Shot shot;
  Random random(30);
  for (int s = 0; s < 20; ++s) {
    const Vector3d root = 0.1 * random.direction();
    add_strand(shot.groom, curly(16, 0.3, 0.02, random.uniform(1, 4), root));
  }
  shot.head = dance;
  shot.frames = 40;
  shot.region.lengths = LengthParams::iterated(2);
  std::vector<std::vector<Points>> results;
  for (const int method : {1, 2, 3, 4}) {
    shot.region.local.method = method;
    results.push_back(run(shot, in_double()));
  }
  // Root mean square over the shot.
  const auto away = [&](const std::vector<Points>& result) {
    double sum = 0;
    for (std::size_t frame = 1; frame < result.size(); ++frame) {
      for (std::size_t v = 0; v < result[frame].size(); ++v)
        sum += (result[frame][v] - results[0][frame][v]).squaredNorm();
    }
    return std::sqrt(sum / static_cast<double>(shot.frames) / static_cast<double>(shot.groom.vertex_count()));
  };
  INFO("method 2: " << away(results[1]) << " m, method 3: " << away(results[2]) << " m, method 4: " << away(results[3])
                    << " m");
  CHECK(away(results[2]) > 0.005);
  CHECK(away(results[3]) < away(results[2]) / 2);
}
