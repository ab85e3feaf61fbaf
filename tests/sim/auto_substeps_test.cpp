// The number of substeps against motions whose acceleration is known.
#include "sim/auto_substeps.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <vector>

using namespace strandbake;
using Eigen::Isometry3d;
using Eigen::Vector3d;

namespace {

constexpr double kTolerance = 0.001;
constexpr double kFrame = 1.0 / 24;
const HairExtent kPoint = {Eigen::AlignedBox3d(Vector3d(0, 0, 0)), 0.3};

Motion moved(const Vector3d& by) {
  Motion motion;
  motion.head.translation() = by;
  return motion;
}

// What frame `frame` needs of a motion over seconds.
MotionNeed need_of(const std::function<Motion(double)>& at, int frame = 1, const HairExtent& hair = kPoint) {
  std::vector<Motion> path;
  for (int s = -1; s <= kMotionSamples; ++s)
    path.push_back(at((frame - 1 + static_cast<double>(s) / kMotionSamples) * kFrame));
  return motion_need(path, hair);
}

double substeps_of(const MotionNeed& need, double tolerance = kTolerance) {
  return SubstepCounter(tolerance, 1 / kFrame).next(need, 0.1);
}

// A sphere that moves while the head does not.
Motion with_sphere(const Vector3d& center, double radius) {
  Motion motion;
  motion.spheres = {{center, radius}};
  return motion;
}

}  // namespace

TEST_CASE("a head that stands or goes straight on takes one substep") {
  const auto still = [](double) { return moved({1, 2, 3}); };
  CHECK(need_of(still).bend == 0);
  CHECK(substeps_of(need_of(still), 1e-300) == 1);
  for (const double far : {0.0, 1e5}) {
    const auto straight = [far](double t) { return moved(Vector3d(far, 1, 0) + t * Vector3d(3, -40, 11)); };
    CHECK(substeps_of(need_of(straight, 7)) == 1);
  }
}

TEST_CASE("a constant acceleration takes the smallest number that the tolerance allows") {
  for (const double tolerance : {1e-2, 1e-3, 1e-5}) {
    for (const int n : {1, 2, 7, 100}) {
      const auto falling = [&](double share) {
        const Vector3d a = Vector3d(2, -3, 6) / 7 * share * tolerance * n * n / (kFrame * kFrame);
        return [a](double t) { return moved(Vector3d(0.5, 1.5, 0) + t * Vector3d(1, 0, 0) + a * t * t / 2); };
      };
      CAPTURE(tolerance, n);
      CHECK(substeps_of(need_of(falling(1), 3), tolerance) == n);
      CHECK(substeps_of(need_of(falling(1.001), 3), tolerance) == n + 1);
      CHECK(substeps_of(need_of(falling(0.999), 3), tolerance) == n);
    }
  }
}

TEST_CASE("turning accelerates a root towards the axis, the more the farther out it is") {
  // omega^2 r, for the corner of the box that is farthest from the axis; by the chord it is less by (omega d)^2 / 12.
  const HairExtent hair = {Eigen::AlignedBox3d(Vector3d(-0.1, 0, -0.02), Vector3d(0.06, 0.3, 0.08)), 0.3};
  const double r = std::hypot(0.1, 0.08);
  for (const double omega : {1.0, 10.0, 60.0}) {
    const auto turning = [&](double t) {
      Motion motion;
      motion.head.linear() = Eigen::AngleAxisd(omega * t, Vector3d::UnitY()).toRotationMatrix();
      return motion;
    };
    const double d = kFrame / kMotionSamples;
    const double expected = omega * omega * r * kFrame * kFrame;
    CAPTURE(omega);
    CHECK(need_of(turning, 2, hair).bend == Approx(expected).epsilon(omega * omega * d * d / 12 + 1e-9));
    CHECK(need_of(turning, 2, hair).bend <= expected * (1 + 1e-9));
  }
}

TEST_CASE("a jump of the velocity counts in the frame that begins with it") {
  // Starts at the end of the first frame with 1 m/s, and so strays by d from standing still.
  const auto starts = [](double t) { return moved(std::max(t - kFrame, 0.0) * Vector3d(1, 0, 0)); };
  CHECK(need_of(starts, 1).bend == 0);
  CHECK(need_of(starts, 2).bend == Approx(kMotionSamples * kFrame));
  CHECK(need_of(starts, 3).bend == Approx(0).margin(1e-12));
}

TEST_CASE("after a motion the number falls as damping takes the hair's velocity, down to one") {
  SubstepCounter counter(kTolerance, 24);
  CHECK(counter.next({0.09, 0}, 0.1) == 10);  // sqrt(90)
  const double stays = std::pow(0.9, 60.0 / 24);
  double before = 10;
  for (int frame = 1; frame < 20; ++frame) {
    const double now = counter.next({}, 0.1);
    CAPTURE(frame);
    CHECK(now == std::max(1.0, std::ceil(std::sqrt(90 * std::pow(stays, frame)))));
    CHECK(now <= before);
    before = now;
  }
  CHECK(before == 1);
  CHECK(counter.next({0.09, 0}, 0.1) == 10);
  CHECK(counter.next({0.004, 0}, 1) == 2);  // full damping: only what moves now
  CHECK(counter.next({}, 1) == 1);
  CHECK(counter.next({0.09, 0}, 0) == 10);
  for (int frame = 0; frame < 100; ++frame) CHECK(counter.next({}, 0) == 10);  // none: it rings on
}

TEST_CASE("a sphere moves by at most half its radius in a substep") {
  const auto flying = [](double speed, double radius) {
    return need_of([=](double t) { return with_sphere({0.1 + speed * t, 0, 0}, radius); });
  };
  // 2.4 m/s are 0.1 m in a frame.
  CHECK(flying(2.4, 0.1).bend == Approx(0).margin(1e-12));
  CHECK(substeps_of(flying(2.4, 0.2)) == 1);
  CHECK(substeps_of(flying(2.4, 0.1)) == 2);
  CHECK(substeps_of(flying(2.4, 0.02)) == 10);
  CHECK(substeps_of(flying(2.4 * 1.001, 0.02)) == 11);
  CHECK(substeps_of(flying(0, 0.02)) == 1);
  CHECK(substeps_of(flying(2.4, 0)) == 1);  // a point holds no vertex

  // It is the motion against the head that counts.
  const auto riding = [](double t) {
    Motion motion = with_sphere({2.4 * t, 0, 0}, 0.02);
    motion.head.translation() = Vector3d(2.4 * t, 0, 0);
    return motion;
  };
  CHECK(substeps_of(need_of(riding)) == 1);
  const auto standing = [](double t) {
    Motion motion = with_sphere({0.1, 0, 0}, 0.02);
    motion.head.translation() = Vector3d(2.4 * t, 0, 0);
    return motion;
  };
  CHECK(substeps_of(need_of(standing)) == 10);
  // It does not ring on.
  SubstepCounter counter(kTolerance, 24);
  CHECK(counter.next(flying(2.4, 0.02), 0.1) == 10);
  CHECK(counter.next({}, 0.1) == 1);
}

TEST_CASE("a sphere that speeds up counts as a root does") {
  const double a = 9 * kTolerance / (kFrame * kFrame);
  const auto pushed = [a](double t) { return with_sphere({0, a * t * t / 2, 0}, 0.1); };
  CHECK(substeps_of(need_of(pushed)) == 3);
}

TEST_CASE("spheres that hair cannot reach do not count, unless they come by within a frame") {
  const auto flying = [](double from, double speed) {
    return substeps_of(need_of([=](double t) { return with_sphere({from, speed * t, 0}, 0.02); }));
  };
  CHECK(flying(0.31, 2.4) == 10);  // strands of 0.3 m
  CHECK(flying(0.33, 2.4) == 1);
  CHECK(flying(-0.33, 2.4) == 1);
  // 10 m a sample, from one side to the other.
  const double speed = 10 * kMotionSamples / kFrame;
  CHECK(substeps_of(need_of([=](double t) { return with_sphere({-85 + speed * t, 0, 0}, 1); })) == 320);
  CHECK(substeps_of(need_of([=](double t) { return with_sphere({-85 + speed * t, 20, 0}, 1); })) == 1);
}

TEST_CASE("where motion jumps the number is beyond any limit, and never less than one") {
  CHECK(substeps_of(need_of([](double t) { return moved({t > 0.02 ? 1e9 : 0, 0, 0}); })) > 1e6);
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  CHECK(substeps_of({kInfinity, 0}) == kInfinity);
  CHECK(substeps_of({0, kInfinity}) == kInfinity);
  CHECK(substeps_of(need_of([](double t) { return with_sphere({t > 0.02 ? 1e308 : -1e308, 0, 0}, 1); })) >= 1);
  // One frame in an age, and the other way round.
  CHECK(SubstepCounter(kTolerance, 5e-324).next({}, 0.1) == 1);
  CHECK(SubstepCounter(kTolerance, 5e-324).next({0.09, 0}, 0) == 10);
  CHECK(SubstepCounter(5e-324, 24).next({}, 0.1) == 1);
}

TEST_CASE("hair begins at the pinned vertices of the strands that are simulated") {
  Groom groom;
  groom.position = {{0, 0, 0}, {0, 1, 0}, {0, 2, 2}, {5, 5, 5}, {6, 5, 5}, {1, 0, 0}, {1, 0, 1}, {1, 0, 2}};
  groom.offset = {0, 3, 5, 8};
  groom.region = {0, 1, 0};
  Plan plan;
  plan.regions.resize(2);
  plan.regions[1].simulated = false;
  HairExtent hair = hair_extent(groom, plan);
  CHECK(hair.roots.min() == Vector3d(0, 0, 0));
  CHECK(hair.roots.max() == Vector3d(1, 1, 1));
  CHECK(hair.reach == Approx(1 + std::sqrt(5)));
  groom.pinned = {0, 0, 0, 0, 0, 0, 0, 1};
  CHECK(hair_extent(groom, plan).roots.max() == Vector3d(1, 1, 2));
  groom.region.clear();
  CHECK(hair_extent(groom, plan).roots.max() == Vector3d(6, 5, 5));
  plan.regions[0].simulated = false;
  hair = hair_extent(groom, plan);
  CHECK(hair.roots.isEmpty());
  CHECK(substeps_of(need_of([](double t) { return moved({1e3 * t * t, 0, 0}); }, 5, hair)) == 1);
}
