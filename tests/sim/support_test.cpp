// Sag-free hair: it rests where it was put, whatever the method, the substeps and the iterations.
#include <algorithm>
#include <catch2/catch.hpp>
#include <vector>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace harness;

namespace {

struct Settled {
  double drift = 0;   // from the first frame [m]
  double motion = 0;  // in the last frame [m]
};

Settled settle(const Shot& shot, const SolverOptions& options) {
  const std::vector<Points> taken = run(shot, options);
  Settled settled;
  for (const Points& frame : taken) settled.drift = std::max(settled.drift, largest_distance(frame, taken[0]));
  settled.motion = largest_distance(taken.back(), taken[taken.size() - 2]);
  return settled;
}

Shot hanging(int method) {
  Shot shot;
  Random random(70);
  for (int s = 0; s < 12; ++s) {
    const Vector3d root = Vector3d(0, 1.6, 0) + 0.1 * random.direction();
    add_strand(shot.groom, s % 3 == 0   ? curly(24, 0.25, 0.01, 3, root)
                           : s % 3 == 1 ? wavy(17, 0.2, 0.01, 2, root)
                                        : straight(12, 0.15, root, random.direction()));
  }
  shot.region.sag_free = true;
  shot.region.local.method = method;
  shot.frames = 60;
  return shot;
}

}  // namespace

// The rest pose is a stable equilibrium of every method: doubles stay within what they round, measured 1.3e-12 m. What
// floats round, 1e-8 m, is an acceleration of 2.6e-3 m/s^2 at seven substeps. Measured 0.05 mm and 0.004 mm a frame
// with one and two substeps, 0.63 mm and 0.05 mm with seven.
TEST_CASE("sag-free hair rests where it was put") {
  const int method = GENERATE(1, 2, 3, 4);
  Shot shot = hanging(method);
  shot.region.lengths = GENERATE(LengthParams{}, LengthParams::iterated(2));
  shot.substeps = GENERATE(1, 2, 7);
  shot.region.local.iterations = GENERATE(1, 3, 8);
  SECTION("on a head that is upright") {}
  SECTION("on a head that lies on its side") {
    shot.head = [](double) {
      return pose(Eigen::AngleAxisd(1.3, Vector3d(1, 2, -1).normalized()).toRotationMatrix(), {0.3, -0.2, 5});
    };
  }
  const Settled floats = settle(shot, {}), doubles = settle(shot, in_double());
  INFO("method " << method << ", " << shot.substeps << " substeps, " << shot.region.local.iterations
                 << " iterations, float: " << floats.drift << " m, " << floats.motion
                 << " m a frame, double: " << doubles.drift << " m");
  CHECK(doubles.drift < 1e-11);
  CHECK(doubles.motion < 1e-12);
  CHECK(floats.drift < (shot.substeps < 7 ? 1e-4 : 1.5e-3));
  CHECK(floats.motion < (shot.substeps < 7 ? 1e-5 : 1.5e-4));
  if (method == 3) CHECK(floats.motion < 4e-6);
}

TEST_CASE("without it hair sags") {
  Shot shot = hanging(GENERATE(1, 2, 3, 4));
  shot.region.sag_free = false;
  CHECK(settle(shot, {}).drift > 0.005);
}

TEST_CASE("sag-free hair without local shape is carried by the head") {
  Shot shot = hanging(1);
  shot.region.local.stiffness = 0;
  CHECK(settle(shot, {}).drift < 1e-4);
}

// Upside down, what held it up pulls it down as well: twice its weight, where frames go with the head.
TEST_CASE("what holds sag-free hair up turns with the head") {
  Shot shot = hanging(3);
  shot.region.global.stiffness = shot.region.local.stiffness = 0;
  shot.region.damping = 0;
  shot.region.lengths = LengthParams::iterated(0);
  shot.head = [](double time) {
    return time > 0 ? pose(Eigen::AngleAxisd(std::numbers::pi, Vector3d::UnitX()).toRotationMatrix(), {0, 0, 0})
                    : Isometry3d::Identity();
  };
  shot.frames = 10;
  const std::vector<Points> taken = run(shot, in_double());
  const double h = 1 / shot.fps, fall = 2 * 9.81 * h * h * 10 * 11 / 2;
  CHECK((taken[10][3] - taken[0][3]).y() == Approx(-fall).epsilon(1e-9));
}
