// What moves, turns, mirrors or scales the scene does the same to the result; and how far apart precisions and methods
// are.
#include "tests/validation/validation.h"

using namespace strandbake;
using namespace strandbake::validation;

namespace {

// A scene in other units: lengths times `scale`, times times the root of it, so that gravity stays what it is. What is
// given per 1/60 s is mapped to the same share of a step of the other length.
struct Units {
  double scale = 1;
  double time() const { return std::sqrt(scale); }

  double damping(double c) const { return 1 - std::pow(1 - c, 1 / time()); }
  // passes/stiffness.h: (1 - S) / S is a compliance in units of the reference step squared.
  double stiffness(double s) const { return s > 0 ? 1 / (1 + scale * (1 - s) / s) : 0; }
};

Shot seen_from(const Shot& shot, const Eigen::Affine3d& move, const Units& units) {
  Shot seen = shot;
  for (Vector3d& p : seen.groom.position) p = move * p;
  const Eigen::Matrix3d turn = move.linear() / units.scale;
  seen.gravity = turn * shot.gravity;
  seen.wind.velocity = turn * shot.wind.velocity * units.time();
  seen.wind.period = shot.wind.period * units.time();
  seen.region.drag = shot.region.drag / units.time();
  seen.region.damping = units.damping(shot.region.damping);
  seen.region.local.stiffness = units.stiffness(shot.region.local.stiffness);
  seen.region.global.stiffness = units.stiffness(shot.region.global.stiffness);
  seen.fps = shot.fps / units.time();
  seen.head = [head = shot.head, move, units](double time) {
    const Eigen::Affine3d to = move * Eigen::Affine3d(head(time / units.time()).matrix()) * move.inverse();
    return pose(to.linear(), to.translation());
  };
  if (shot.spheres) {
    seen.spheres = [spheres = shot.spheres, move, units](double time) {
      std::vector<Sphere> all = spheres(time / units.time());
      for (Sphere& sphere : all) sphere = {move * sphere.center, units.scale * sphere.radius};
      return all;
    };
  }
  return seen;
}

Shot everything_at_once(int method, const LengthParams& lengths) {
  Shot shot;
  // One in which no strand folds back on itself: where one does, frames may turn either way, and rounding decides.
  shot.groom = mixed_groom(110, 30, 40);
  shot.region.local.method = method;
  shot.region.damping = 0.2;
  shot.region.global.fade = 0;  // the share of a stiffness is not the stiffness of a share
  shot.region.lengths = lengths;
  shot.wind.velocity = {2, 0.3, 1};
  shot.head = dance;
  shot.spheres = [](double time) { return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.05, 0), 0.08}}; };
  shot.substeps = 4;
  shot.frames = 20;
  return shot;
}

double largest_distance(const std::vector<Points>& a, const std::vector<Points>& b) {
  double largest = 0;
  for (std::size_t frame = 0; frame < a.size(); ++frame)
    largest = std::max(largest, harness::largest_distance(a[frame], b[frame]));
  return largest;
}

}  // namespace

// Measured, as shares of the scale: at worst 9e-15; 5e-10 at 1e5 m, where the world rounds to 1.5e-11 m before the
// solver sees it.
TEST_CASE("what is done to the scene is done to the result") {
  const int method = GENERATE(1, 2, 3, 4);
  const LengthParams lengths = GENERATE(LengthParams{}, LengthParams::iterated(3));
  const Shot shot = everything_at_once(method, lengths);
  Random random(92);
  Eigen::Affine3d move = Eigen::Affine3d::Identity();
  Units units;
  double bound = 1e-9;
  SECTION("turned") {
    move.linear() = random.rotation();
  }
  SECTION("mirrored") {
    const Vector3d across = random.direction();
    move.linear() = Eigen::Matrix3d::Identity() - 2 * across * across.transpose();
  }
  SECTION("a hundred kilometres away") {
    move.translation() = 1e5 * random.direction();
    bound = 1e-5;
  }
  SECTION("all three") {
    move.linear() = -random.rotation();
    move.translation() = 1e5 * random.direction();
    bound = 1e-5;
  }
  SECTION("four times as large, and twice as slow") {
    units.scale = 4;
    move.linear() *= units.scale;
  }
  SECTION("a hundredth of the size, and ten times as fast") {
    units.scale = 0.01;
    move.linear() *= units.scale;
  }
  const std::vector<Points> here = run(shot, in_double()), there = run(seen_from(shot, move, units), in_double());
  std::vector<Points> expected = here;
  for (Points& frame : expected) {
    for (Vector3d& p : frame) p = move * p;
  }
  const double away = largest_distance(there, expected) / units.scale;
  CAPTURE(method, lengths.direct, 1e9 * away);
  CHECK(away < bound);
  CHECK(harness::largest_distance(here.back(), here.front()) > 0.05);
}

// Rounding grows with the motion, so the bound is for a third of a second. Measured 6e-7 m (root mean square) and 6e-6
// m (largest).
TEST_CASE("float stays near double") {
  const int method = GENERATE(1, 2, 3, 4);
  const LengthParams lengths = GENERATE(LengthParams{}, LengthParams::iterated(3));
  const Shot shot = everything_at_once(method, lengths);
  const std::vector<Points> in_float = run(shot, SolverOptions{}), exact = run(shot, in_double());
  const double rms = rms_distance(in_float, exact), largest = largest_distance(in_float, exact);
  CAPTURE(method, lengths.direct, 1e6 * rms, 1e6 * largest);
  CHECK(rms < 1e-5);
  CHECK(largest < 1e-3);
}

// Both have exact frames; method 4 has them from before each iteration and goes in batches. The stiffness of a step
// goes with its square, so with shorter ones both do the same: measured 1.3, 0.15, 0.01 mm apart with 2, 8, 32
// substeps, where method 3 stays 20 mm away.
TEST_CASE("method 4 tends to method 1 with shorter substeps, and method 3 does not") {
  Shot shot;
  Random random(93);
  for (int s = 0; s < 12; ++s)
    add_strand(shot.groom, curly(16, 0.3, 0.02, random.uniform(1, 3), 0.1 * random.direction()));
  shot.region.damping = 0.2;
  shot.head = dance;
  shot.frames = 20;
  std::vector<double> apart, rest_frames;
  for (const int substeps : {2, 8, 32}) {
    shot.substeps = substeps;
    std::vector<std::vector<Points>> taken;
    for (const int method : {1, 3, 4}) {
      shot.region.local.method = method;
      taken.push_back(run(shot, in_double()));
    }
    rest_frames.push_back(rms_distance(taken[0], taken[1]));
    apart.push_back(rms_distance(taken[0], taken[2]));
  }
  CAPTURE(1e3 * apart[0], 1e3 * apart[1], 1e3 * apart[2], 1e3 * rest_frames[0], 1e3 * rest_frames[2]);
  CHECK(apart[1] < apart[0] / 2);
  CHECK(apart[2] < apart[1] / 2);
  CHECK(rest_frames[2] > 10 * apart[2]);
}
