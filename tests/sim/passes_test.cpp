// Each pass alone, against numbers worked out by hand. Inputs are chosen so that most results are exact in float.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>
#include <vector>

#include "sim/lanes.h"
#include "sim/passes/collide.h"
#include "sim/passes/edge_length.h"
#include "sim/passes/frame_scan.h"
#include "sim/passes/global_shape.h"
#include "sim/passes/integrate.h"
#include "sim/passes/local_shape.h"
#include "sim/passes/stiffness.h"
#include "sim/passes/wind.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using harness::Random;

namespace {

template <class Real>
Vec3<Real> vec(double x, double y, double z) {
  return {static_cast<Real>(x), static_cast<Real>(y), static_cast<Real>(z)};
}
template <class Real>
double distance(Vec3<Real> a, Vec3<Real> b) {
  return std::sqrt(static_cast<double>(inner(a - b, a - b)));
}
template <class Real>
bool same(Vec3<Real> a, Vec3<Real> b) {
  return std::memcmp(&a, &b, sizeof(a)) == 0;
}
template <class Real>
Vec3<Real> length_error(Vec3<Real> edge, Real rest_length) {
  return edge * relative_length_error(edge, rest_length);
}
template <class Real>
constexpr double kEpsilon = std::numeric_limits<Real>::epsilon();

}  // namespace

TEMPLATE_TEST_CASE("the small algebra is the usual one", "", float, double) {
  const auto a = vec<TestType>(1, 2, 3), b = vec<TestType>(4, -5, 6);
  CHECK(inner(a, b) == 12);
  CHECK(same(outer(a, b), vec<TestType>(27, 6, -13)));
  CHECK(same(a + b, vec<TestType>(5, -3, 9)));
  CHECK(same(a - b, vec<TestType>(-3, 7, -3)));
  CHECK(same(a * TestType(2), vec<TestType>(2, 4, 6)));
  // A quarter turn about Z takes X to Y.
  const auto x = vec<TestType>(0, -1, 0), y = vec<TestType>(1, 0, 0), z = vec<TestType>(0, 0, 1);
  CHECK(same(rotate_by_rows(x, y, z, vec<TestType>(1, 0, 0)), vec<TestType>(0, 1, 0)));
  CHECK(same(rotate_by_rows(x, y, z, vec<TestType>(2, 3, 4)), vec<TestType>(-3, 2, 4)));
}

TEMPLATE_TEST_CASE("integration adds what is kept of the velocity and the acceleration", "", float, double) {
  const auto p = vec<TestType>(1, 2, 3), q = vec<TestType>(0.5, 2, 4), accel = vec<TestType>(0, -0.25, 0);
  CHECK(same(integrate(p, q, TestType(0.5), accel), vec<TestType>(1.25, 1.75, 2.5)));
  CHECK(same(integrate(p, q, TestType(1), vec<TestType>(0, 0, 0)), vec<TestType>(1.5, 2, 2)));
  CHECK(same(integrate(p, q, TestType(0), vec<TestType>(0, 0, 0)), p));
  CHECK(same(integrate(p, p, TestType(0.9f), vec<TestType>(0, 0, 0)), p));
}

TEMPLATE_TEST_CASE("the global shape takes a share of the way to the goal", "", float, double) {
  const auto p = vec<TestType>(1, 2, 3), goal = vec<TestType>(3, 2, -1);
  CHECK(same(pull_to_goal(p, goal, TestType(0)), p));
  CHECK(same(pull_to_goal(p, goal, TestType(0.25)), vec<TestType>(1.5, 2, 2)));
  CHECK(same(pull_to_goal(p, goal, TestType(1)), goal));
  CHECK(same(pull_to_goal(p, p, TestType(0.3f)), p));
}

TEMPLATE_TEST_CASE("stiffness keeps its ends and its value at 1/60 s, and is a compliance between", "", float, double) {
  for (const double ratio2 : {0.25, 1.0, 4.0, 64.0, 1e6}) {
    CHECK(stiffness_at_step(TestType(0), static_cast<TestType>(ratio2)) == 0);
    CHECK(stiffness_at_step(TestType(1), static_cast<TestType>(ratio2)) == 1);
  }
  CHECK(stiffness_at_step(TestType(0.375), TestType(1)) == TestType(0.375));
  CHECK(stiffness_at_step(TestType(0.5), TestType(4)) == Approx(0.2));  // two substeps: 1 / (1 + 4)
  CHECK(stiffness_at_step(TestType(0.5), TestType(0.25)) == Approx(0.8));
  // The compliance (1 - S)/S h^2 is the same at any step.
  for (const double ratio2 : {2.0, 9.0, 100.0}) {
    const double at_step = static_cast<double>(stiffness_at_step(TestType(0.3f), static_cast<TestType>(ratio2)));
    CHECK((1 - at_step) / at_step / ratio2 == Approx(0.7 / 0.3).epsilon(1e-5));
  }
}

TEMPLATE_TEST_CASE("an edge is led back to its length along itself", "", float, double) {
  // 3-4-5: too long by 3 at rest length 2.
  CHECK(distance(length_error(vec<TestType>(3, 4, 0), TestType(2)), vec<TestType>(1.8, 2.4, 0)) <
        4 * kEpsilon<TestType>);
  CHECK(distance(length_error(vec<TestType>(0, 0, 2), TestType(4)), vec<TestType>(0, 0, -2)) == 0);
  CHECK(same(length_error(vec<TestType>(3, 4, 0), TestType(5)), vec<TestType>(0, 0, 0)));
  SECTION("an edge without direction is left alone") {
    CHECK(same(length_error(vec<TestType>(0, 0, 0), TestType(2)), vec<TestType>(0, 0, 0)));
    CHECK(distance(length_error(vec<TestType>(0, 1e-16, 0), TestType(2)), vec<TestType>(0, 0, 0)) == 0);
  }
  SECTION("an edge of a picometre is not") {
    CHECK(distance(length_error(vec<TestType>(0, 1e-12, 0), TestType(2)), vec<TestType>(0, -2, 0)) < 1e-6);
  }
}

TEMPLATE_TEST_CASE("the free ends of an edge share its correction", "", float, double) {
  CHECK(edge_share(TestType(1), TestType(1)) == TestType(0.5));
  CHECK(edge_share(TestType(1), TestType(0)) == 1);
  CHECK(edge_share(TestType(0), TestType(1)) == 0);
  CHECK(edge_share(TestType(0), TestType(0)) == 0);
}

TEMPLATE_TEST_CASE("a sphere sends a vertex to the nearest point of its surface", "", float, double) {
  const auto center = vec<TestType>(1, 2, 3);
  const TestType radius = 2;
  const auto push = [&](Vec3<TestType> p, double free = 1) {
    return push_out_of_sphere(p, center, radius, static_cast<TestType>(free));
  };
  CHECK(same(push(vec<TestType>(1.5, 2, 3)), vec<TestType>(3, 2, 3)));
  CHECK(same(push(vec<TestType>(1, 2, 2)), vec<TestType>(1, 2, 1)));
  CHECK(distance(push(vec<TestType>(1.3, 2.4, 3)), vec<TestType>(2.2, 3.6, 3)) < 8 * kEpsilon<TestType>);
  SECTION("outside and on the surface nothing happens") {
    CHECK(same(push(vec<TestType>(1, 5, 3)), vec<TestType>(1, 5, 3)));
    CHECK(same(push(vec<TestType>(3, 2, 3)), vec<TestType>(3, 2, 3)));
    CHECK(same(push(vec<TestType>(1e6, -7, 0.3)), vec<TestType>(1e6, -7, 0.3)));
  }
  SECTION("from the very centre it goes up") {
    CHECK(same(push(center), vec<TestType>(1, 4, 3)));
  }
  SECTION("a pinned vertex stays") {
    CHECK(same(push(vec<TestType>(1.5, 2, 3), 0), vec<TestType>(1.5, 2, 3)));
    CHECK(same(push(center, 0), center));
  }
  SECTION("a sphere without size pushes nothing") {
    CHECK(same(push_out_of_sphere(center, center, TestType(0), TestType(1)), center));
  }
}

TEMPLATE_TEST_CASE("wind pushes across a segment and slides off along it", "", float, double) {
  CHECK(same(wind_across(vec<TestType>(3, 4, 5), vec<TestType>(0, 0, 0.5)), vec<TestType>(3, 4, 0)));
  CHECK(same(wind_across(vec<TestType>(3, 4, 5), vec<TestType>(0, 0, -8)), vec<TestType>(3, 4, 0)));
  CHECK(same(wind_across(vec<TestType>(0, 2, 0), vec<TestType>(0, 0.25, 0)), vec<TestType>(0, 0, 0)));
  // (1, 0, 0) across (1, 1, 0): (1/2, -1/2, 0).
  CHECK(same(wind_across(vec<TestType>(1, 0, 0), vec<TestType>(1, 1, 0)), vec<TestType>(0.5, -0.5, 0)));
  SECTION("a segment without direction takes the whole wind") {
    CHECK(same(wind_across(vec<TestType>(3, 4, 5), vec<TestType>(0, 0, 0)), vec<TestType>(3, 4, 5)));
  }
}

TEMPLATE_TEST_CASE("a frame turns by the smallest rotation", "", float, double) {
  const Frame<TestType> start = {vec<TestType>(1, 0, 0), vec<TestType>(0, 1, 0)};
  SECTION("along itself it stays") {
    const auto f = turn_frame(start, vec<TestType>(0.25, 0, 0));
    CHECK(same(f.x, start.x));
    CHECK(same(f.y, start.y));
  }
  SECTION("a quarter turn about z takes y along") {
    const auto f = turn_frame(start, vec<TestType>(0, 0.5, 0));
    CHECK(same(f.x, vec<TestType>(0, 1, 0)));
    CHECK(same(f.y, vec<TestType>(-1, 0, 0)));
  }
  SECTION("a quarter turn about y leaves y") {
    const auto f = turn_frame(start, vec<TestType>(0, 0, -2));
    CHECK(same(f.x, vec<TestType>(0, 0, -1)));
    CHECK(same(f.y, vec<TestType>(0, 1, 0)));
  }
  SECTION("120 degrees about the z axis") {
    const auto f = turn_frame(start, vec<TestType>(-0.5, std::sqrt(0.75), 0));
    CHECK(distance(f.x, vec<TestType>(-0.5, std::sqrt(0.75), 0)) < 8 * kEpsilon<TestType>);
    CHECK(distance(f.y, vec<TestType>(-std::sqrt(0.75), -0.5, 0)) < 8 * kEpsilon<TestType>);
  }
  SECTION("where the strand folds back it is a half turn about y") {
    const auto f = turn_frame(start, vec<TestType>(-0.5, 0, 0));
    CHECK(same(f.x, vec<TestType>(-1, 0, 0)));
    CHECK(same(f.y, vec<TestType>(0, 1, 0)));
  }
  SECTION("just beside a fold, on either side of the threshold, it is still a frame") {
    for (const double degrees : {170.0, 179.0, 179.18, 179.2, 179.5, 179.999}) {
      CAPTURE(degrees);
      const double angle = degrees * std::numbers::pi / 180;
      for (const double twist : {0.0, 1.0, 2.5}) {
        const auto edge =
            vec<TestType>(std::cos(angle), std::sin(angle) * std::cos(twist), std::sin(angle) * std::sin(twist));
        const auto f = turn_frame(start, edge * TestType(0.0625));
        CHECK(distance(f.x, edge) < 4 * kEpsilon<TestType>);
        // Half the threshold of 1e-4 in the fold; beside it rounding, divided by the threshold.
        CHECK(std::abs(inner(f.y, f.y) - 1) < 2.1e-4 + 1e4 * kEpsilon<TestType>);
        CHECK(std::abs(inner(f.x, f.y)) < 1e4 * kEpsilon<TestType>);
      }
    }
  }
  SECTION("at a point it stays") {
    const auto f = turn_frame(start, vec<TestType>(0, 0, 0));
    CHECK(same(f.x, start.x));
    CHECK(same(f.y, start.y));
    const auto g = turn_frame(start, vec<TestType>(0, 1e-16, 0));
    CHECK(same(g.x, start.x));
    CHECK(same(g.y, start.y));
  }
  SECTION("the length of the edge does not matter") {
    for (const double scale : {1e-9, 1e-3, 1e6}) {
      const auto f = turn_frame(start, vec<TestType>(0.6 * scale, 0, 0.8 * scale));
      CHECK(distance(f.x, vec<TestType>(0.6, 0, 0.8)) < 4 * kEpsilon<TestType>);
      CHECK(distance(f.y, vec<TestType>(0, 1, 0)) < 4 * kEpsilon<TestType>);
    }
  }
}

TEMPLATE_TEST_CASE("an edge has a direction, and a point is given one", "", float, double) {
  const auto other = vec<TestType>(0, 0, 1);
  CHECK(same(direction_or(vec<TestType>(0, -0.25, 0), other), vec<TestType>(0, -1, 0)));
  CHECK(distance(direction_or(vec<TestType>(3e-9, 0, 4e-9), other), vec<TestType>(0.6, 0, 0.8)) <
        4 * kEpsilon<TestType>);
  CHECK(same(direction_or(vec<TestType>(0, 0, 0), other), other));
  CHECK(same(direction_or(vec<TestType>(0, 1e-16, 0), other), other));
}

TEMPLATE_TEST_CASE("every direction has a frame along it", "", float, double) {
  CHECK(same(frame_along(vec<TestType>(0, 0, 1)).y, vec<TestType>(1, 0, 0)));
  CHECK(same(frame_along(vec<TestType>(0, 0, -1)).y, vec<TestType>(1, 0, 0)));
  CHECK(same(frame_along(vec<TestType>(1, 0, 0)).y, vec<TestType>(0, 0, -1)));
  CHECK(same(frame_along(vec<TestType>(-1, 0, 0)).y, vec<TestType>(0, 0, 1)));
  CHECK(same(frame_along(vec<TestType>(0, -1, 0)).y, vec<TestType>(1, 0, 0)));
  Random random(9);
  double worst = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    Eigen::Vector3d direction = random.direction();
    // Where the sign of z decides, and at the poles.
    if (trial % 4 == 0) direction.z() *= 1e-9;
    if (trial % 4 == 1) direction = {1e-5 * direction.x(), 1e-5 * direction.y(), direction.z()};
    direction.normalize();
    const Frame<TestType> f = frame_along(vec<TestType>(direction.x(), direction.y(), direction.z()));
    worst = std::max(
        {worst, std::abs(static_cast<double>(inner(f.y, f.y)) - 1), std::abs(static_cast<double>(inner(f.x, f.y)))});
  }
  CHECK(worst < 4 * kEpsilon<TestType>);
}

TEMPLATE_TEST_CASE("a twist is what is left of a turn in the frame along the next edge", "", float, double) {
  const auto x = vec<TestType>(1, 0, 0), y = vec<TestType>(0, 1, 0), z = vec<TestType>(0, 0, 1);
  const auto between = [](Frame<TestType> before, Frame<TestType> here) { return twist_between(before, here); };
  const auto product = [](Twist<TestType> a, Twist<TestType> b) { return twist_product(a, b); };
  const auto is = [](Twist<TestType> t, double re, double im) {
    return t.re == static_cast<TestType>(re) && t.im == static_cast<TestType>(im);
  };
  CHECK(is(between({x, y}, {x, y}), 1, 0));
  CHECK(is(between({x, y}, {x, z}), 0, -1));  // y is a quarter turn before z, seen along x
  // A quarter turn about z carries y to -x.
  CHECK(is(between({x, y}, {y, z}), 0, -1));
  CHECK(is(between({x, y}, {y, x}), -1, 0));
  CHECK(is(between({x, z}, {y, z}), 1, 0));
  SECTION("where the strand folds back, y stays") {
    CHECK(is(between({x, y}, {vec<TestType>(-1, 0, 0), y}), 1, 0));
    CHECK(is(between({x, y}, {vec<TestType>(-1, 0, 0), z}), 0, 1));
  }
  SECTION("angles add up") {
    CHECK(is(product({TestType(0), TestType(1)}, {TestType(0), TestType(1)}), -1, 0));
    CHECK(is(product({TestType(2), TestType(3)}, {TestType(5), TestType(7)}), -11, 29));
  }
  SECTION("a frame is twisted about its x") {
    const auto f = twisted_frame(Frame<TestType>{x, y}, Twist<TestType>{TestType(0.6f), TestType(0.8f)});
    CHECK(same(f.x, x));
    CHECK(same(f.y, vec<TestType>(0, 0.6f, 0.8f)));
  }
}

TEMPLATE_TEST_CASE("vectors go into a frame and come back", "", float, double) {
  const Frame<TestType> f = {vec<TestType>(0, 1, 0), vec<TestType>(0, 0, 1)};  // z is (1, 0, 0)
  CHECK(same(into_frame(f, vec<TestType>(1, 2, 3)), vec<TestType>(2, 3, 1)));
  CHECK(same(from_frame(f, vec<TestType>(2, 3, 1)), vec<TestType>(1, 2, 3)));
}

TEMPLATE_TEST_CASE("the local error is the way from the edge to its goal", "", float, double) {
  const Frame<TestType> f = {vec<TestType>(0, 1, 0), vec<TestType>(0, 0, 1)};
  const auto none = vec<TestType>(0, 0, 0);
  CHECK(same(local_shape_error(f, vec<TestType>(2, 3, 1), none, vec<TestType>(0.5, 2, 5)), vec<TestType>(0.5, 0, -2)));
  CHECK(same(local_shape_error(f, vec<TestType>(2, 3, 1), vec<TestType>(0, 0, 0.25), vec<TestType>(1, 2, 3)),
             vec<TestType>(0, 0, 0.25)));
}

TEMPLATE_TEST_CASE("with its remainder any edge in any frame is at rest to the last bit", "", float, double) {
  Random random(7);
  for (int trial = 0; trial < 1000; ++trial) {
    const Eigen::Vector3d ex = random.direction(), ey = ex.cross(random.direction()).normalized();
    const Frame<TestType> f = {vec<TestType>(ex.x(), ex.y(), ex.z()), vec<TestType>(ey.x(), ey.y(), ey.z())};
    const Eigen::Vector3d e = random.in_cube(0.02);
    const auto edge = vec<TestType>(e.x(), e.y(), e.z());
    const auto local = into_frame(f, edge);
    const auto d = local_shape_error(f, local, edge - from_frame(f, local), edge);
    REQUIRE((d.x == 0 && d.y == 0 && d.z == 0));
  }
}

TEMPLATE_TEST_CASE("the reaction of a local shape leaves no couple but the twist", "", float, double) {
  Random random(9);
  for (int trial = 0; trial < 1000; ++trial) {
    const Eigen::Vector3d ex = random.direction(), ey = ex.cross(random.direction()).normalized();
    const Frame<TestType> f = {vec<TestType>(ex.x(), ex.y(), ex.z()), vec<TestType>(ey.x(), ey.y(), ey.z())};
    const Eigen::Vector3d e = random.in_cube(0.02), d = random.in_cube(0.01);
    const auto local = vec<TestType>(e.x(), e.y(), e.z()), move = vec<TestType>(d.x(), d.y(), d.z());
    const auto goal = from_frame(f, local);
    const double length = random.uniform(0.01, 0.02);
    const auto back = shape_reaction(f, local, move, TestType(1 / length));
    // About the vertex between: what moves the goal's end, and what moves the vertex before.
    const auto couple = outer(goal, move) + outer(f.x * TestType(length), back);
    REQUIRE(distance(couple, f.x * inner(f.x, outer(goal, move))) < 1e-3 * kEpsilon<TestType>);
  }
}

TEST_CASE("a local shape has a lever that is 1 over the length before, at most 4 over its own, and none on a point") {
  CHECK(shape_lever(0.5, 1.0) == 2);
  CHECK(shape_lever(0.125, 1.0) == 4);
  CHECK(shape_lever(0.5, 0.0) == 2);
  CHECK(shape_lever(0.0, 1.0) == 0);
  CHECK(shape_lever(1e-7, 0.02) == 200);
}

// Three free vertices in line with equal segments weigh 1, 4 and 1.
TEST_CASE("a local shape moves by the compliance of the paper, whatever its vertices weigh") {
  CHECK(shape_weight(1.0, 1.0, 1.0) == 4);
  CHECK(shape_weight(1.0, 0.0, 0.0) == -1);  // the root's: vertex i alone
  for (const double stiffness : {0.0, 0.1, 0.5, 0.9, 1.0}) {
    CHECK(shape_share(stiffness, 0.0) == stiffness / 2);  // the paper's two free vertices
    if (stiffness == 0) continue;
    for (const double weight : {-1.0, 4.0}) {
      const double compliance = 2 * (1 - stiffness) / stiffness;  // S / 2 = 1 / (2 + compliance)
      CHECK(shape_share(stiffness, weight) == Approx(1 / (weight + 2 + compliance)));
    }
  }
}

namespace {

// Every pass on one vector of inputs, all results in one list.
template <class Real>
std::vector<Real> every_pass(const std::vector<Real>& in) {
  std::vector<Real> out;
  const auto keep = [&out](Vec3<Real> v) {
    out.push_back(v.x);
    out.push_back(v.y);
    out.push_back(v.z);
  };
  const Vec3<Real> a = {in[0], in[1], in[2]}, b = {in[3], in[4], in[5]}, c = {in[6], in[7], in[8]};
  const Frame<Real> f = {{in[9], in[10], in[11]}, {in[12], in[13], in[14]}};
  const Real s = in[15], t = in[16];
  keep(integrate(a, b, s, c));
  keep(pull_to_goal(a, b, s));
  out.push_back(stiffness_at_step(s, t));
  keep((a - b) * relative_length_error(a - b, t));
  out.push_back(edge_share(s, t));
  keep(push_out_of_sphere(a, b, t, s));
  keep(wind_across(a, b - c));
  const Frame<Real> g = turn_frame(f, b - c);
  keep(g.x);
  keep(g.y);
  keep(into_frame(f, a));
  keep(from_frame(f, b));
  keep(local_shape_error(f, a, b, c));
  keep(direction_or(b - c, a));
  const Frame<Real> along = frame_along(f.x), next = frame_along(direction_or(b - c, f.y));
  keep(along.y);
  const Twist<Real> twist = twist_between(along, next), turned = twist_product(twist, Twist<Real>{s, t});
  out.insert(out.end(), {twist.re, twist.im, turned.re, turned.im});
  keep(twisted_frame(next, turned).y);
  return out;
}

template <class Scalar, int W>
void check_lanes() {
  using Wide = Lanes<Scalar, W>;
  Random random(8);
  for (int trial = 0; trial < 500; ++trial) {
    std::vector<std::vector<Scalar>> narrow;
    std::vector<Wide> wide(17);
    for (int lane = 0; lane < W; ++lane) {
      std::vector<double> in;
      for (int k = 0; k < 9; ++k) in.push_back(random.uniform(-0.1, 0.1));
      const Eigen::Vector3d x = random.direction(), y = x.cross(random.direction()).normalized();
      in.insert(in.end(), {x.x(), x.y(), x.z(), y.x(), y.y(), y.z(), random.uniform(0, 1), random.uniform(0.05, 1)});
      // Degenerate input in some lanes only.
      if (random.integer(0, 4) == 0)
        std::copy_n(in.begin() + 3, 3, in.begin());  // a = b: no edge, centre of the sphere
      if (random.integer(0, 4) == 0) std::copy_n(in.begin() + 6, 3, in.begin() + 3);  // b = c: no segment
      if (random.integer(0, 4) == 0) {                                                // b - c against the frame: folded
        for (int k = 0; k < 3; ++k) in[3 + k] = in[6 + k] - in[9 + k];
      }
      if (random.integer(0, 4) == 0) in[15] = random.integer(0, 1);
      narrow.emplace_back(in.begin(), in.end());
      for (std::size_t k = 0; k < 17; ++k) wide[k].v[lane] = narrow.back()[k];
    }
    const std::vector<Wide> together = every_pass(wide);
    for (int lane = 0; lane < W; ++lane) {
      const std::vector<Scalar> alone = every_pass(narrow[static_cast<std::size_t>(lane)]);
      for (std::size_t k = 0; k < alone.size(); ++k) {
        const Scalar in_lane = together[k].v[lane];
        CAPTURE(trial, lane, k, in_lane, alone[k]);
        REQUIRE(std::memcmp(&in_lane, &alone[k], sizeof(Scalar)) == 0);
      }
    }
  }
}

}  // namespace

TEST_CASE("a lane computes what a single number does, to the last bit") {
  SECTION("four floats") {
    check_lanes<float, 4>();
  }
  SECTION("two doubles") {
    check_lanes<double, 2>();
  }
}

TEST_CASE("a lane made of one number holds it in every place, minus zero and infinity too") {
  for (const float a :
       {1.5f, -0.0f, 0.0f, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::denorm_min()}) {
    const Lanes<float, 4> lanes(a);
    for (int lane = 0; lane < 4; ++lane) {
      const float in_lane = lanes.v[lane];
      CHECK(std::memcmp(&in_lane, &a, sizeof a) == 0);
    }
  }
}
