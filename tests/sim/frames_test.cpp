// The frames of local_shape.h against equation 1 and Algorithm 2 with quaternions.
#include <catch2/catch.hpp>
#include <limits>

#include "sim/passes/frame_scan.h"
#include "sim/passes/local_shape.h"
#include "tests/sim/harness.h"
#include "tests/sim/paper_reference.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

template <class Real>
Vec3<Real> vec(const Vector3d& v) {
  return {static_cast<Real>(v.x()), static_cast<Real>(v.y()), static_cast<Real>(v.z())};
}
template <class Real>
Vector3d eigen(Vec3<Real> v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}
template <class Real>
constexpr double kEpsilon = std::numeric_limits<Real>::epsilon();

// The nearest multiple of 2^-20 m: coordinates below 8 m and their differences are exact in float.
Vector3d on_lattice(const Vector3d& v) {
  return (v * 0x1p20).array().round() * 0x1p-20;
}

// Frames of the edges [1, n) of a strand by the rounds of frame_scan.h; entry 0 repeats the root's.
template <class Real>
std::vector<Frame<Real>> scanned_frames(const std::vector<Vec3<Real>>& p, Frame<Real> root) {
  const std::size_t n = p.size();
  std::vector<Frame<Real>> frames(n, root);
  std::vector<Twist<Real>> twist(n);
  for (std::size_t i = 2; i < n; ++i) {
    frames[i] = frame_along(direction_or(p[i] - p[i - 1], root.x));
    twist[i] = twist_between(frames[i - 1], frames[i]);
  }
  for (std::size_t d = 1; d < n; d *= 2) {
    const std::vector<Twist<Real>> old = twist;
    for (std::size_t i = 2 + d; i < n; ++i) twist[i] = twist_product(old[i], old[i - d]);
  }
  for (std::size_t i = 2; i < n; ++i) frames[i] = twisted_frame(frames[i], twist[i]);
  return frames;
}
template <class Real>
std::vector<Frame<Real>> walked_frames(const std::vector<Vec3<Real>>& p, Frame<Real> root) {
  std::vector<Frame<Real>> frames(p.size(), root);
  for (std::size_t i = 2; i < p.size(); ++i) frames[i] = turn_frame(frames[i - 1], p[i] - p[i - 1]);
  return frames;
}
template <class Real>
double largest_difference(const std::vector<Frame<Real>>& a, const std::vector<Frame<Real>>& b) {
  double largest = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    largest = std::max({largest, (eigen(a[i].x) - eigen(b[i].x)).norm(), (eigen(a[i].y) - eigen(b[i].y)).norm()});
  }
  return largest;
}
// Vertices on the lattice with bends of at most `widest` as 1 + cos, and the frame along the first edge.
template <class Real>
std::pair<std::vector<Vec3<Real>>, Frame<Real>> bent_strand(Random& random, std::size_t vertices, double widest) {
  Vector3d at = on_lattice(random.in_cube(0.1)), direction = random.direction();
  std::vector<Vec3<Real>> p = {vec<Real>(at)};
  while (p.size() < vertices) {
    at += on_lattice(direction * random.uniform(0.01, 0.03));
    p.push_back(vec<Real>(at));
    Vector3d next = random.direction();
    while (1 + next.dot(direction) < widest) next = random.direction();
    direction = next;
    if (at.norm() > 1) direction = -at.normalized();  // stay where differences are exact
  }
  const Vector3d x = (eigen(p[1]) - eigen(p[0])).normalized(), y = x.unitOrthogonal();
  return {p, {vec<Real>(x), vec<Real>(y)}};
}

// Largest of |x.x - 1|, |y.y - 1|, |x.y|.
template <class Real>
double departure_from_orthonormal(Frame<Real> f) {
  const Vector3d x = eigen(f.x), y = eigen(f.y);
  return std::max({std::abs(x.dot(x) - 1), std::abs(y.dot(y) - 1), std::abs(x.dot(y))});
}

}  // namespace

// Where the strand bends by the angle b, the turn divides by 1 + cos b, at most 2 here: a vertex adds a few epsilon to
// y, in random directions, and so does the reference.
TEMPLATE_TEST_CASE("the frames along a strand are those of the paper's quaternions", "", float, double) {
  Random random(11);
  double worst = 0, sharpest = 0;
  for (int strand = 0; strand < 3000; ++strand) {
    const auto vertices = static_cast<std::size_t>(random.integer(2, 60));
    Points p = {on_lattice(random.in_cube(0.1))};
    Vector3d direction = random.direction();
    while (p.size() < vertices) {
      p.push_back(p.back() + on_lattice(direction * random.uniform(0.01, 0.03)));
      Vector3d next = random.direction();
      while (next.dot(direction) < -0.5) next = random.direction();
      sharpest = std::min(sharpest, next.dot(direction));
      direction = next;
    }
    const std::vector<Eigen::Isometry3d> expected = paper::initialize_transforms(p);
    Frame<TestType> frame = {vec<TestType>(expected[0].linear().col(0)), vec<TestType>(expected[0].linear().col(1))};
    for (std::size_t i = 1; i < vertices; ++i) {
      frame = turn_frame(frame, vec<TestType>(p[i]) - vec<TestType>(p[i - 1]));
      worst = std::max({worst, (eigen(frame.x) - expected[i].linear().col(0)).norm(),
                        (eigen(frame.y) - expected[i].linear().col(1)).norm(),
                        (eigen(outer(frame.x, frame.y)) - expected[i].linear().col(2)).norm()});
    }
  }
  CHECK(sharpest < -0.49);
  INFO("worst " << worst / kEpsilon<TestType> << " epsilon");
  CHECK(worst < 80 * kEpsilon<TestType>);
}

// |y| keeps what rounding does to it, so over n vertices it walks by about epsilon sqrt(n); x and the right angle are
// made anew.
TEMPLATE_TEST_CASE("frames stay orthonormal along ten thousand vertices", "", float, double) {
  Random random(12);
  Frame<TestType> frame = {vec<TestType>({1, 0, 0}), vec<TestType>({0, 1, 0})};
  double worst = 0, worst_angle = 0;
  Vector3d direction = {1, 0, 0};
  for (int i = 0; i < 10000; ++i) {
    direction = (direction + 0.7 * random.direction()).normalized();
    frame = turn_frame(frame, vec<TestType>(Vector3d(0.01 * direction)));
    worst = std::max(worst, departure_from_orthonormal(frame));
    worst_angle = std::max(worst_angle, std::abs(eigen(frame.x).dot(eigen(frame.y))));
  }
  INFO("worst " << worst / kEpsilon<TestType> << " epsilon, right angle " << worst_angle / kEpsilon<TestType>);
  CHECK(worst < 1000 * kEpsilon<TestType>);
  CHECK(worst_angle < 4 * kEpsilon<TestType>);
}

TEMPLATE_TEST_CASE("frames survive folds and points among ten thousand vertices", "", float, double) {
  Random random(13);
  Frame<TestType> frame = {vec<TestType>({1, 0, 0}), vec<TestType>({0, 1, 0})};
  Vector3d direction = {1, 0, 0};
  for (int i = 0; i < 10000; ++i) {
    switch (random.integer(0, 9)) {
      case 0:
        direction = -direction;
        break;
      case 1:
        direction = Vector3d::Zero();
        break;
      default:
        direction = random.direction();
        break;
    }
    frame = turn_frame(frame, vec<TestType>(Vector3d(0.01 * direction)));
    if (direction.norm() == 0) direction = random.direction();
    REQUIRE(std::abs(eigen(frame.x).norm() - 1) < 4 * kEpsilon<TestType>);
    REQUIRE(std::isfinite(eigen(frame.y).norm()));
  }
  // Near a fold a rounding grows by up to 1 / 1e-4, and y keeps it.
  CHECK(departure_from_orthonormal(frame) < 1e5 * kEpsilon<TestType>);
}

TEMPLATE_TEST_CASE("the local rest edges rebuild the strand, exactly with their remainders", "", float, double) {
  Random random(14);
  for (int strand = 0; strand < 300; ++strand) {
    Points p = strand % 3 == 0   ? folded(30, 0.01, random.in_cube(0.1))
               : strand % 3 == 1 ? stuttering(random, 30, random.in_cube(0.1))
                                 : rambling(random, 30, random.in_cube(0.1));
    for (Vector3d& v : p) v = on_lattice(v);
    const Eigen::Matrix3d start = paper::root_transform(p[0], p[3]).linear();
    Frame<TestType> rest = {vec<TestType>(start.col(0)), vec<TestType>(start.col(1))}, now = rest;
    Vector3d walked = p[0];
    for (std::size_t i = 1; i < p.size(); ++i) {
      const Vec3<TestType> edge = vec<TestType>(p[i]) - vec<TestType>(p[i - 1]);
      const Vec3<TestType> local = into_frame(rest, edge);
      const Vec3<TestType> remainder = edge - from_frame(rest, local);
      const Vec3<TestType> none = local_shape_error(now, local, remainder, edge);
      REQUIRE((none.x == 0 && none.y == 0 && none.z == 0));
      // A few roundings of an edge, and what the frame lacks of a right angle.
      CAPTURE(strand, i);
      REQUIRE(eigen(remainder).norm() <= 30 * kEpsilon<TestType> * eigen(edge).norm());
      walked += eigen(from_frame(now, local));
      rest = turn_frame(rest, edge);
      now = turn_frame(now, edge);
    }
    CHECK((walked - p.back()).norm() < 30 * 30 * kEpsilon<TestType> * 0.02);
  }
}

// As for the quaternions above: a few epsilon a vertex, which add up at random.
TEMPLATE_TEST_CASE("frames of a scan are those of a walk", "", float, double) {
  Random random(15);
  double worst = 0;
  for (int strand = 0; strand < 3000; ++strand) {
    const auto [p, root] = bent_strand<TestType>(random, static_cast<std::size_t>(random.integer(2, 60)), 0.5);
    worst = std::max(worst, largest_difference(scanned_frames(p, root), walked_frames(p, root)));
  }
  INFO("worst " << worst / kEpsilon<TestType> << " epsilon");
  CHECK(worst < 80 * kEpsilon<TestType>);
}

// As along a walk, |y| keeps what rounding does to it: some epsilon a vertex, more where it bends to near a fold, times
// the 100 that random steps make of 10,000. A third of a thousandth in float is not worth a normalisation.
TEMPLATE_TEST_CASE("frames of a scan stay orthonormal along ten thousand vertices", "", float, double) {
  Random random(16);
  const auto [widest, tolerance] = GENERATE(table<double, double>({{1, 2000}, {0.02, 10000}}));
  const auto [p, root] = bent_strand<TestType>(random, 10000, widest);
  double worst = 0, worst_angle = 0;
  for (const Frame<TestType>& frame : scanned_frames(p, root)) {
    worst = std::max(worst, departure_from_orthonormal(frame));
    worst_angle = std::max(worst_angle, std::abs(eigen(frame.x).dot(eigen(frame.y))));
  }
  const double apart = largest_difference(scanned_frames(p, root), walked_frames(p, root));
  INFO("worst " << worst / kEpsilon<TestType> << " epsilon, right angle "
                << worst_angle / kEpsilon<TestType> << ", from a walk " << apart / kEpsilon<TestType>);
  CHECK(worst < tolerance * kEpsilon<TestType>);
  CHECK(apart < tolerance * kEpsilon<TestType>);
  CHECK(worst_angle < 4 * kEpsilon<TestType>);
}

TEMPLATE_TEST_CASE("frames of a scan do not depend on what comes after them", "", float, double) {
  Random random(17);
  const auto [p, root] = bent_strand<TestType>(random, 70, 0.1);
  const auto whole = scanned_frames(p, root);
  for (std::size_t vertices = 2; vertices < p.size(); ++vertices) {
    const std::vector<Vec3<TestType>> part(p.begin(), p.begin() + static_cast<std::ptrdiff_t>(vertices));
    const auto frames = scanned_frames(part, root);
    REQUIRE(std::memcmp(frames.data(), whole.data(), vertices * sizeof(frames[0])) == 0);
  }
}

TEMPLATE_TEST_CASE("frames of a scan survive folds and points among ten thousand vertices", "", float, double) {
  Random random(18);
  Vector3d at = Vector3d::Zero(), direction = {1, 0, 0};
  std::vector<Vec3<TestType>> p = {vec<TestType>(at)};
  for (int i = 1; i < 10000; ++i) {
    const int kind = i == 1 ? 9 : random.integer(0, 9);
    direction = kind == 0 ? Vector3d(-direction) : random.direction();
    if (kind != 1) at += on_lattice(0.01 * direction);
    p.push_back(vec<TestType>(at));
  }
  const Vector3d x = (eigen(p[1]) - eigen(p[0])).normalized();
  const auto frames = scanned_frames(p, {vec<TestType>(x), vec<TestType>(x.unitOrthogonal())});
  double worst = 0;
  for (const Frame<TestType>& frame : frames) {
    REQUIRE(std::abs(eigen(frame.x).norm() - 1) < 4 * kEpsilon<TestType>);
    worst = std::max(worst, departure_from_orthonormal(frame));
  }
  INFO("worst " << worst / kEpsilon<TestType> << " epsilon");
  CHECK(worst < 1e5 * kEpsilon<TestType>);  // as along a walk
}
