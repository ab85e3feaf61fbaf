// The rod's formulas against finite differences and a dense solve, in doubles; and the rod in the solver against
// itself.
#include <Eigen/Dense>
#include <catch2/catch.hpp>
#include <functional>

#include "sim/passes/rod_contact.h"
#include "tests/sim/harness.h"
#include "tests/validation/rod_driver.h"

using namespace strandbake;
using namespace strandbake::harness;
using namespace strandbake::validation;

namespace {

using Eigen::Matrix3d;

Frame<double> random_frame(Random& random) {
  const Matrix3d r = random.rotation();
  return {to_vec(r.col(0)), to_vec(r.col(1))};
}
// By so much and about any axis.
Frame<double> turned_by(const Frame<double>& f, double angle, Random& random) {
  const Matrix3d r = Eigen::AngleAxisd(angle, random.direction()).toRotationMatrix();
  return {to_vec(r * to_eigen(f.x)), to_vec(r * to_eigen(f.y))};
}
Vec random_vec(Random& random, double half) {
  return to_vec(random.in_cube(half));
}

// Central differences of a function of a small angle.
Vector3d gradient_of(const std::function<double(Vec)>& f, double step) {
  Vector3d g;
  for (int k = 0; k < 3; ++k) {
    const Vec d = to_vec(step * Vector3d::Unit(k));
    g[k] = (f(d) - f(d * -1.0)) / (2 * step);
  }
  return g;
}
Matrix3d hessian_of(const std::function<double(Vec)>& f, double step) {
  Matrix3d h;
  for (int k = 0; k < 3; ++k) {
    for (int l = 0; l < 3; ++l) {
      const Vector3d a = step * Vector3d::Unit(k), b = step * Vector3d::Unit(l);
      h(k, l) = (f(to_vec(a + b)) - f(to_vec(a - b)) - f(to_vec(b - a)) + f(to_vec(-a - b))) / (4 * step * step);
    }
  }
  return h;
}
double least_eigenvalue(const Matrix3d& m) {
  return Eigen::SelfAdjointEigenSolver<Matrix3d>(m).eigenvalues().minCoeff();
}

constexpr double kBend = 0.7, kTwist = 0.4;  // B / l, C / l

double joint_energy(const Frame<double>& f, const Frame<double>& g, Vec rest) {
  const Vec off = rod_curvature(f, g) - rest;
  return 0.5 * (kTwist * off.x * off.x + kBend * (off.y * off.y + off.z * off.z));
}

}  // namespace

TEST_CASE("the curvature is 2 tan(angle / 2) about the axis of the turn, whatever the frames") {
  Random random(81);
  for (int k = 0; k < 200; ++k) {
    const Matrix3d f = random.rotation();
    const Vector3d axis = random.direction();  // in the frame
    const double angle = random.uniform(-2.8, 2.8);
    const Matrix3d g = f * Eigen::AngleAxisd(angle, axis).toRotationMatrix();
    const Vec kappa = rod_curvature<double>({to_vec(f.col(0)), to_vec(f.col(1))}, {to_vec(g.col(0)), to_vec(g.col(1))});
    CHECK((to_eigen(kappa) - 2 * std::tan(angle / 2) * axis).norm() < 1e-12);
  }
}

TEST_CASE("near a half turn the curvature ends at 40") {
  Random random(82);
  for (int k = 0; k < 200; ++k) {
    const Frame<double> f = random_frame(random);
    const double less = random.uniform(1e-4, 0.3);
    const Frame<double> g = turned_by(f, std::numbers::pi - less, random);
    const Vec kappa = rod_curvature(f, g);
    CHECK(std::sqrt(inner(kappa, kappa)) == Approx(std::min(2 / std::tan(less / 2), 40.0)).epsilon(1e-7));
    const Vec half_a_turn = rod_curvature(f, turned_by(f, std::numbers::pi, random));
    CHECK(inner(half_a_turn, half_a_turn) < 1600 + 1e-9);
  }
}

// Central differences: the error is 1e-16 / step + step^2.
TEST_CASE("the couple of a joint is the gradient of its energy by either turn") {
  Random random(83);
  for (int k = 0; k < 100; ++k) {
    const Frame<double> f = random_frame(random), g = turned_by(f, random.uniform(0, 2.5), random);
    const Vec rest = random_vec(random, 1.5);
    const Vector3d couple = to_eigen(rod_joint(f, g, rest, kBend, kTwist).couple);
    const double size = 1 + couple.norm();
    const Vector3d after = gradient_of([&](Vec w) { return joint_energy(f, turned_frame(g, w), rest); }, 1e-5);
    const Vector3d before = gradient_of([&](Vec w) { return joint_energy(turned_frame(f, w), g, rest); }, 1e-5);
    CHECK((after - couple).norm() < 1e-7 * size);
    CHECK((before + couple).norm() < 1e-7 * size);
    // In the axes of either frame it is the same.
    CHECK((to_eigen(from_frame(f, rod_curvature(f, g))) - to_eigen(from_frame(g, rod_curvature(f, g)))).norm() < 1e-12);
  }
}

TEST_CASE("the matrix of a joint is Gauss's and Newton's, and at rest the exact one") {
  Random random(84);
  for (int k = 0; k < 100; ++k) {
    const Frame<double> f = random_frame(random), g = turned_by(f, random.uniform(0, 2.5), random);
    const Vec now = rod_curvature(f, g);
    const Matrix3d used = to_eigen(rod_joint(f, g, random_vec(random, 1.5), kBend, kTwist).matrix);
    CHECK(least_eigenvalue(used) > 0);
    Matrix3d change;  // of the curvature
    for (int l = 0; l < 3; ++l) {
      const Vec w = to_vec(1e-5 * Vector3d::Unit(l));
      change.col(l) =
          to_eigen(rod_curvature(f, turned_frame(g, w)) - rod_curvature(f, turned_frame(g, w * -1.0))) / 2e-5;
    }
    const Matrix3d expected = change.transpose() * Vector3d(kTwist, kBend, kBend).asDiagonal() * change;
    CHECK((used - expected).norm() < 1e-7 * expected.norm());
    const Matrix3d exact = hessian_of([&](Vec w) { return joint_energy(f, turned_frame(g, w), now); }, 1e-3);
    const Matrix3d at_rest = to_eigen(rod_joint(f, g, now, kBend, kTwist).matrix);
    CHECK((at_rest - exact).norm() < 1e-4 * exact.norm());
  }
}

TEST_CASE("the rest curvature that bears a couple does") {
  Random random(85);
  for (int k = 0; k < 100; ++k) {
    const Frame<double> f = random_frame(random), g = turned_by(f, random.uniform(0, 2.5), random);
    const Vec couple = random_vec(random, 2);
    const Vec rest = curvature_that_bears(rod_curvature(f, g), into_frame(f, couple), kBend, kTwist);
    CHECK((to_eigen(rod_joint(f, g, rest, kBend, kTwist).couple) - to_eigen(couple)).norm() < 1e-12);
  }
}

// The work of a load at the far end of an edge that turns by Rodrigues' formula.
TEST_CASE("the matrix of a load bounds the exact one, and leaves the pull along the edge as it is") {
  Random random(86);
  const Symmetric<double> none = no_link(0.0).D;
  for (int k = 0; k < 200; ++k) {
    const Vector3d x = random.direction(), load = 3 * random.in_cube(1);
    const double length = random.uniform(0.1, 2);
    const auto energy = [&](Vec w) {
      const double angle = to_eigen(w).norm();
      const Matrix3d turn =
          angle > 0 ? Eigen::AngleAxisd(angle, to_eigen(w) / angle).toRotationMatrix() : Matrix3d(Matrix3d::Identity());
      return -load.dot(turn * (length * x));
    };
    const Matrix3d exact = hessian_of(energy, 1e-3);
    const double pull = length * x.dot(load);
    const Matrix3d formula = pull * Matrix3d::Identity() - 0.5 * length * (load * x.transpose() + x * load.transpose());
    CHECK((exact - formula).norm() < 1e-5 * (1 + formula.norm()));
    const Matrix3d used = to_eigen(plus_load(none, to_vec(x), to_vec(length * x), to_vec(load)));
    CHECK(least_eigenvalue(used) > -1e-13);
    CHECK(least_eigenvalue(used - formula) > -1e-13);
    // Across the edge and the load nothing is added to it.
    const Vector3d across = x.cross(load).normalized();
    CHECK(across.dot(used * across) == Approx(std::max(pull, 0.0)).margin(1e-12));
    const Matrix3d along = to_eigen(plus_load(none, to_vec(x), to_vec(length * x), to_vec(2.0 * x)));
    CHECK((along - 2 * length * (Matrix3d::Identity() - x * x.transpose())).norm() < 1e-13);
  }
}

TEST_CASE("turned frames stay orthonormal over a hundred thousand turns in float") {
  Random random(87);
  Frame<float> f = {{1, 0, 0}, {0, 1, 0}};
  for (int k = 0; k < 100000; ++k) {
    const Vector3d w = random.uniform(0, k % 100 == 0 ? 50 : 0.3) * random.direction();
    f = turned_frame(f, {static_cast<float>(w.x()), static_cast<float>(w.y()), static_cast<float>(w.z())});
    REQUIRE(std::abs(inner(f.x, f.x) - 1) < 5e-7f);
    REQUIRE(std::abs(inner(f.y, f.y) - 1) < 5e-7f);
    REQUIRE(std::abs(inner(f.x, f.y)) < 5e-7f);
  }
}

TEST_CASE("a small angle turns a frame about itself, by Cayley's map, and none not at all") {
  Random random(88);
  for (int k = 0; k < 100; ++k) {
    const Frame<double> f = random_frame(random);
    const Vector3d w = random.uniform(0, 5) * random.direction();
    const Matrix3d turn = Eigen::AngleAxisd(2 * std::atan(w.norm() / 2), w.normalized()).toRotationMatrix();
    const Frame<double> to = turned_frame(f, to_vec(w));
    CHECK((to_eigen(to.x) - turn * to_eigen(f.x)).norm() < 1e-14);
    CHECK((to_eigen(to.y) - turn * to_eigen(f.y)).norm() < 1e-14);
    const Frame<double> kept = turned_frame(f, {0, 0, 0});
    CHECK(std::memcmp(&kept, &f, sizeof(f)) == 0);
  }
}

namespace {

Matrix3d cross_matrix(const Vector3d& v) {
  return Matrix3d{{0, -v.z(), v.y()}, {v.z(), 0, -v.x()}, {-v.y(), v.x(), 0}};
}

// The normal equations of one iteration as one dense system, by the energy at the head of rod_link.h. Unknowns: by edge
// from 2 on its turn in the world and its stretch.
struct Dense {
  const RodDriver& rod;
  double h;
  std::size_t edges = rod.size() - 2;
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(size(), size());
  Eigen::VectorXd gradient = Eigen::VectorXd::Zero(size());
  std::vector<Matrix3d> inertia = std::vector<Matrix3d>(rod.size(), Matrix3d::Zero());  // by the move of a vertex

  Eigen::Index size() const { return static_cast<Eigen::Index>(4 * edges); }
  static Eigen::Index turn_at(std::size_t i) { return static_cast<Eigen::Index>(4 * (i - 2)); }
  static Eigen::Index stretch_at(std::size_t i) { return turn_at(i) + 3; }
  Vector3d along(std::size_t i) const { return to_eigen(rod.frame[i].x); }
  Vector3d edge(std::size_t i) const { return rod.length[i] * along(i); }

  // How vertex i moves.
  Eigen::MatrixXd moves(std::size_t i) const {
    Eigen::MatrixXd j = Eigen::MatrixXd::Zero(3, size());
    for (std::size_t k = 2; k <= i; ++k) {
      j.middleCols(turn_at(k), 3) = -cross_matrix(edge(k));
      if (rod.stretch > 0) j.col(stretch_at(k)) = along(k);
    }
    return j;
  }

  // What pulls vertex i on, when all beyond it has done what it can: the gradient of the least energy.
  Vector3d load(std::size_t i) const {
    const Eigen::Index after = size() - turn_at(i + 1), begin = turn_at(i + 1);
    Eigen::MatrixXd by_move = Eigen::MatrixXd::Zero(3, after);  // second derivative by the move of i and the unknowns
    Vector3d by_own = Vector3d::Zero();
    for (std::size_t k = i; k < rod.size(); ++k) {
      by_own += rod.mass(k) * to_eigen(rod.at[k] - rod.target[k]);
      if (k > i) by_move += inertia[k] * moves(k).rightCols(after);
    }
    if (after > 0) {
      by_own -= by_move * matrix.block(begin, begin, after, after).ldlt().solve(gradient.tail(after));
    }
    return -by_own;
  }

  // What with_joint() leaves of A and D: shares of what it costs to move what hangs on vertex i - 1 and to turn it as a
  // piece, when all beyond edge i has done what it can.
  void add_shares(std::size_t i) {
    const Eigen::Index at = turn_at(i), before = turn_at(i - 1), rest = size() - at - 3;
    Matrix3d by_move = Matrix3d::Zero(), by_turn = matrix.block(at, at, 3, 3);
    Eigen::MatrixXd mixed = Eigen::MatrixXd::Zero(3, rest);
    for (std::size_t k = i; k < rod.size(); ++k) {
      by_move += inertia[k];
      mixed += inertia[k] * moves(k).rightCols(rest);
    }
    const auto beyond = matrix.bottomRightCorner(rest, rest).ldlt();
    const Eigen::MatrixXd turn_mixed = matrix.block(at, at + 3, 3, rest);
    by_move -= mixed * beyond.solve(mixed.transpose());
    by_turn -= turn_mixed * beyond.solve(turn_mixed.transpose());
    const Matrix3d share = (3e-7 * by_move.diagonal()).asDiagonal();
    inertia[i - 1] += share;
    matrix += moves(i - 1).transpose() * share * moves(i - 1);
    matrix.block(before, before, 3, 3).diagonal() += 1e-6 * by_turn.diagonal();
  }

  explicit Dense(const RodDriver& r, double step) : rod(r), h(step) {
    // From the tip, as the matrix of a load needs the rest of the strand. Of the joint at vertex i - 1 only what edge i
    // has in it is there when that load is asked for.
    for (std::size_t i = rod.size() - 1; i >= 2; --i) {
      const Eigen::MatrixXd j = moves(i);
      inertia[i] += rod.mass(i) * Matrix3d::Identity();
      matrix += rod.mass(i) * j.transpose() * j;
      gradient += rod.mass(i) * j.transpose() * to_eigen(rod.at[i] - rod.target[i]);
      const Eigen::Index at = turn_at(i);
      const Vec pull = to_vec(load(i));
      Symmetric<double> own = plus_load(no_link(0.0).D, rod.frame[i].x, to_vec(edge(i)), pull);
      own = plus_square(own, to_vec(edge(i)), static_cast<double>(1e-8f) * rod.mass(i));
      matrix.block(at, at, 3, 3) += to_eigen(own);
      const double stiffness = rod.stretch > 0 ? h * h * rod.stretch / rod.rest_length[i] : 1;
      matrix(stretch_at(i), stretch_at(i)) += stiffness;
      gradient[stretch_at(i)] += rod.stretch > 0 ? stiffness * (rod.length[i] - rod.rest_length[i]) : 0;
      if (i > 2) add_shares(i);
      const Joint<double> joint = rod.joint(i, h);
      const Matrix3d s = to_eigen(joint.matrix);
      matrix.block(at, at, 3, 3) += s;
      gradient.segment(at, 3) += to_eigen(joint.couple);
      if (i == 2) continue;
      const Eigen::Index before = turn_at(i - 1);
      matrix.block(before, before, 3, 3) += s;
      matrix.block(before, at, 3, 3) -= s;
      matrix.block(at, before, 3, 3) -= s;
      gradient.segment(before, 3) -= to_eigen(joint.couple);
    }
  }

  Eigen::VectorXd solved() const { return -matrix.ldlt().solve(gradient); }
};

}  // namespace

TEST_CASE("the walk to the root and back solves the normal equations of the whole strand") {
  Random random(89);
  const double h = 1.0 / 60;
  for (int k = 0; k < 30; ++k) {
    const Points bent = rambling(random, static_cast<std::size_t>(random.integer(3, 12)), random.in_cube(0.1));
    RodDriver rod(bent, random.uniform(1e-5, 1e-2), random.uniform(1e-5, 1e-2));
    rod.stretch = k % 2 == 0 ? 0 : random.uniform(1, 100);
    if (k % 3 == 2) rod.share[rod.size() / 2 + 1 - rod.size() % 2] = 1e5;  // pinned
    for (std::size_t i = 2; i < rod.size(); ++i) {
      rod.frame[i] = turned_by(rod.frame[i], 0.4, random);
      if (rod.stretch > 0) rod.length[i] *= random.uniform(0.9, 1.1);
      rod.at[i] = rod.at[i - 1] + rod.frame[i].x * rod.length[i];
      rod.target[i] = rod.at[i] + random_vec(random, 0.01);
    }
    const Eigen::VectorXd expected = Dense(rod, h).solved();
    const RodDriver before = rod;
    rod.iterate(h);
    const double near = 1e-8;
    for (std::size_t i = 2; i < rod.size(); ++i) {
      const Vector3d turn = expected.segment(Dense::turn_at(i), 3);
      const Frame<double> frame = turned_frame(before.frame[i], to_vec(turn));
      CHECK((to_eigen(rod.frame[i].x) - to_eigen(frame.x)).norm() < near);
      CHECK((to_eigen(rod.frame[i].y) - to_eigen(frame.y)).norm() < near);
      CHECK(rod.length[i] - before.length[i] == Approx(expected[Dense::stretch_at(i)]).margin(near));
    }
  }
}

namespace {

// Rods of every kind.
Shot rod_shot() {
  Shot shot = busy_shot();
  shot.frames = 8;
  shot.regions_at = [](int frame) {
    std::vector<RegionParams> regions(4);
    for (RegionParams& region : regions) {
      region.method = "rod";
      region.global = {frame < 4 ? 0.1 : 0.0, 0.5, 1};
    }
    regions[1].rod.stiffness = 100;
    regions[1].rod.iterations = 3;
    regions[1].drag = frame < 5 ? 1 : 0;
    regions[2].rod.stiffness = 0.01;
    regions[2].sag_free = true;
    regions[2].global.stiffness = 0;
    regions[3].rod.exact_lengths = false;
    regions[3].rod.young = 1e6;
    regions[3].rod.iterations = 2;
    return regions;
  };
  return shot;
}

Plan plan_with(const Shot& shot, const Skip& skip) {
  Plan plan = plan_of(shot);
  for (std::size_t r = 0; r < plan.regions.size(); ++r) {
    std::vector<RegionParams> over_time;
    for (int frame = 1; frame <= shot.frames; ++frame) over_time.push_back(regions_of(shot, frame)[r]);
    plan.regions[r] = plan_region(over_time, is_windy(shot), skip.passes);
  }
  return plan;
}

bool same(const std::vector<Points>& a, const std::vector<Points>& b) {
  bool all = a.size() == b.size();
  for (std::size_t frame = 0; all && frame < a.size(); ++frame) all = same_bits(a[frame], b[frame]);
  return all;
}

}  // namespace

TEST_CASE("threads, lanes and what is skipped have no influence on a bit of a rod") {
  const Shot shot = rod_shot();
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const std::vector<Points> expected = run(shot, {precision, 1, available_lanes().front()});
    CHECK(largest_distance(expected.back(), expected.front()) > 0.02);
    for (const int lanes : available_lanes()) {
      for (const int threads : {1, 2, 3}) CHECK(same(run(shot, {precision, threads, lanes}), expected));
      const Skip nothing = {false, false, false, false, false};
      for (const Skip& skip :
           {Skip{.passes = false}, Skip{.range = false}, Skip{.colliders = false}, Skip{.resting = false}, nothing}) {
        const SolverOptions options = {.precision = precision, .lanes = lanes, .skip = skip};
        const auto solver = make_openmp_solver(shot.groom, plan_with(shot, skip), shot.head(0), options);
        CHECK(same(run(shot, *solver), expected));
      }
    }
  }
}

// In the air, as a sphere can let one go on this side and the other on that. Measured: 1.5e-6 m.
TEST_CASE("a rod in floats goes where one in doubles goes") {
  Shot shot;
  Random random(90);
  for (int s = 0; s < 24; ++s) {
    const Vector3d root = 0.1 * random.direction();
    add_strand(shot.groom, s % 2 == 0 ? curly(40, 0.25, 0.01, 5, root) : wavy(32, 0.3, 0.005, 3, root));
  }
  shot.region.method = "rod";
  shot.head = dance;
  shot.frames = 60;
  shot.region.rod.exact_lengths = GENERATE(true, false);
  const std::vector<Points> floats = run(shot, {}), doubles = run(shot, in_double());
  double farthest = 0;
  for (std::size_t f = 0; f < floats.size(); ++f)
    farthest = std::max(farthest, largest_distance(floats[f], doubles[f]));
  CAPTURE(shot.region.rod.exact_lengths, farthest);
  CHECK(farthest < 1e-5);
}

TEST_CASE("a rod that only its root holds does not move by a single bit under no force") {
  Shot shot;
  shot.groom = awkward_groom(GENERATE(Vector3d(0, 0, 0), Vector3d(3000, -70, 1e5)));
  shot.groom.pinned.clear();
  shot.gravity = {0, 0, 0};
  shot.frames = 20;
  shot.region.method = "rod";
  shot.region.global.stiffness = 0;
  SECTION("as it is") {}
  SECTION("many iterations, stiff, not damped") {
    shot.region.rod.iterations = 7;
    shot.region.rod.stiffness = 1e4;
    shot.region.damping = 0;
    shot.substeps_at = [](int frame) { return 1 + frame % 4; };
  }
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    for (const int lanes : available_lanes()) {
      const std::vector<Points> taken = run(shot, {precision, 1, lanes});
      for (const Points& frame : taken) REQUIRE(same_bits(frame, taken[0]));
    }
  }
}

// A pinned vertex, a goal and a length that is measured are a rounding beside where the walk along the strand comes to.
// Measured: 3.1e-6 m, 4.3e-15 m.
TEST_CASE("a rod that pins, a global shape or its stretch hold, too, moves by roundings") {
  Shot shot;
  shot.groom = awkward_groom({0, 0, 0});
  shot.gravity = {0, 0, 0};
  shot.frames = 50;
  shot.region.method = "rod";
  shot.region.rod.exact_lengths = GENERATE(true, false);
  shot.region.global.stiffness = GENERATE(0.0, 0.1);
  double farthest[2] = {0, 0};
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const std::vector<Points> taken = run(shot, {.precision = precision});
    for (const Points& frame : taken) {
      double& most = farthest[precision == Precision::Double];
      most = std::max(most, largest_distance(frame, taken[0]));
    }
  }
  CAPTURE(farthest[0], farthest[1]);
  CHECK(farthest[0] < 1e-5);
  CHECK(farthest[1] < 2e-14);
}

TEST_CASE("seven eighths of what a rod draws more than before are handed back, and nothing where that is not known") {
  const Vec none = {0, 0, 0}, before = {1e-3, -2e-3, 5e-4}, now = {2e-3, 1e-3, 0};
  const Vec back = drawn_return(now, before);
  CHECK((to_eigen(back) - 0.875 * to_eigen(now - before)).norm() < 1e-18);
  CHECK(to_eigen(drawn_return(now, none)).norm() == 0);
  CHECK(to_eigen(drawn_return(none, before)).norm() == 0);
  CHECK(drawn_scale(1.0) == 1);
  CHECK(drawn_scale(0.25) == 0.25);
  CHECK(drawn_scale(4.0) == 4);
  CHECK(drawn_scale(0.2) == 0);
  CHECK(drawn_scale(4.1) == 0);
}

TEST_CASE("a contact is a spring along the normal, and its length is that after the move") {
  Random random(71);
  for (int k = 0; k < 20; ++k) {
    const Vec center = random_vec(random, 1), p = center + to_vec(random.direction() * 0.0999);
    const Vector3d n = to_eigen(p - center).normalized();
    const Link<double> v = with_contact(no_link(0.0), p, 0.01, center, 0.1, 0.01);
    CHECK((to_eigen(v.A) - 100 * n * n.transpose()).norm() < 1e-10);
    CHECK((to_eigen(v.a) + 100 * 1e-4 * n).norm() < 1e-12);
    const Vec moved = random_vec(random, 1e-6);
    CHECK(contact_length(p, moved, center, 0.1, 0.01) ==
          Approx(to_eigen(p + moved - center).norm() - 0.1).margin(1e-10));
    // Farther inside than the edge is long it is driven by that much.
    CHECK(contact_length(p, {0, 0, 0}, center, 0.2, 0.01) == Approx(-0.01));
    CHECK((to_eigen(with_contact(no_link(0.0), p, 0.01, center, 0.2, 0.01).a) + n).norm() < 1e-12);
  }
}

// A contact that pulled would hold hair there, and the more so the more substeps there are.
TEST_CASE("a rod that touches a sphere falls from it as if it were not there") {
  Shot shot;
  add_strand(shot.groom, straight(24, 0.2, {0, 0, 0}, {1, 0, 0}));
  shot.region.method = "rod";
  shot.region.global.stiffness = 0;
  shot.substeps = GENERATE(1, 8, 64);
  shot.frames = 20;
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const Points alone = run(shot, {.precision = precision}).back();
  shot.spheres = [](double) { return std::vector<Sphere>{{{0.12, 0.05, 0}, 0.05}}; };
  const Points under = run(shot, {.precision = precision}).back();
  CAPTURE(shot.substeps);
  CHECK((alone.back() - shot.groom.position.back()).norm() > 0.02);
  CHECK(largest_distance(under, alone) < 1e-3);
}

TEST_CASE("a rod that rests on a sphere lies on its surface and does not tremble") {
  Shot shot;
  add_strand(shot.groom, straight(24, 0.2, {0, 0, 0}, {1, 0, 0}));
  shot.region.method = "rod";
  shot.region.global.stiffness = 0;
  shot.region.damping = 0.3;
  shot.substeps = GENERATE(1, 2, 8);
  shot.frames = 600;
  shot.spheres = [](double) { return std::vector<Sphere>{{{0.1, -0.06, 0}, 0.05}}; };
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const std::vector<Points> taken = run(shot, {.precision = precision});
    double nearest = 1;
    for (const Vector3d& p : taken.back()) nearest = std::min(nearest, (p - Vector3d(0.1, -0.06, 0)).norm() - 0.05);
    CAPTURE(shot.substeps, precision == Precision::Float);
    CHECK(std::abs(nearest) < 1e-6);
    // With 8 substeps, a float's rounding is 1e-3 of gravity.
    const double still = precision == Precision::Double ? 1e-11 : shot.substeps == 8 ? 2e-6 : 1e-6;
    CHECK(largest_distance(taken.back(), taken[taken.size() - 2]) < still);
  }
}

TEST_CASE("a rod that came to rest is left alone, and wakes as if it had not been") {
  Random random(14);
  long long rested = 0;  // floats seldom do
  for (int draw = 0; draw < 40; ++draw) {
    Shot shot;
    for (int s = 0; s < 4; ++s) {
      const Vector3d root = 0.1 * random.direction();
      const int n = random.integer(3, 6);
      add_strand(shot.groom,
                 draw % 2 == 0 ? straight(n, 0.003 * n, root, random.direction()) : rambling(random, n, root));
    }
    shot.region.method = "rod";
    shot.region.rod.stiffness = std::pow(10, random.integer(0, 6));
    shot.region.damping = random.uniform(0.4, 0.95);
    if (draw % 3 == 0) shot.gravity = {0, 0, 0};
    shot.region.global.stiffness = 0.3;
    shot.frames = 300;
    // Stands from 0.2 s to 4 s.
    shot.head = [](double time) { return dance(std::min(time, 0.2) + std::clamp(time - 4, 0.0, 0.2)); };
    for (const Precision precision : {Precision::Float, Precision::Double}) {
      const std::vector<Points> expected = run(shot, {.precision = precision, .skip = {.resting = false}});
      for (const int lanes : available_lanes()) {
        const SolverOptions options = {.precision = precision, .lanes = lanes};
        const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), options);
        CHECK(same(run(shot, *solver), expected));
        rested += solver->work().substeps_at_rest;
      }
    }
  }
  CHECK(rested > 1000);
}
