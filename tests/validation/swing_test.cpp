// A vertex in free flight and a single segment that swings, against closed forms.
#include <complex>

#include "tests/validation/validation.h"

using namespace strandbake;
using namespace strandbake::validation;

namespace {

constexpr double kArm = 0.1, kGravity = 9.81;

// A strand of three vertices whose one free segment hangs at `angle` from straight down. Vertices 0 and 1 are held.
Groom one_segment(double angle, const Vector3d& root = {0, 0, 0}) {
  const Vector3d above = root + Vector3d(0, kArm, 0);
  const Vector3d tip = root + Vector3d(kArm * std::sin(angle), -kArm * std::cos(angle), 0);
  return groom_of({{above, root, tip}});
}

Shot pendulum(double angle, int substeps, const LengthParams& lengths) {
  Shot shot;
  shot.groom = one_segment(angle);
  shot.region = bare(lengths);
  shot.fps = 240;
  shot.substeps = substeps;
  shot.frames = 480;
  return shot;
}

std::vector<double> sideways(const std::vector<Points>& taken) {
  std::vector<double> x;
  for (const Points& now : taken) x.push_back(now[2].x());
  return x;
}

}  // namespace

// dv/dt = a - gamma v with gamma = -60 ln(1 - c), for constant a:
//   v(t) = a / gamma + (v0 - a / gamma) e,   x(t) = x0 + (a / gamma) t + (v0 - a / gamma) (1 - e) / gamma,   e =
//   exp(-gamma t)
// first with a strong pull aside, then with gravity alone. The discrete law v' = k v + a h, x' = x + h v' is followed
// to rounding.
TEST_CASE("a thrown vertex flies the damped parabola, at first order in the substep") {
  const double damping = 0.05, gamma = -60 * std::log(1 - damping);
  const Vector3d push(30, 40, -10), gravity(0, -kGravity, 0);
  const int pushed_frames = 6, frames = 60;
  std::vector<double> errors;
  for (const int substeps : {1, 2, 4, 8, 16}) {
    Shot shot;
    shot.groom = groom_of({straight(3, 0.1)});
    shot.region = bare(LengthParams::iterated(0));
    shot.region.damping = damping;
    shot.substeps = substeps;
    const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), in_double());
    const double h = 1 / (shot.fps * substeps), keep = std::pow(1 - damping, 60 * h);
    Vector3d x = shot.groom.position[2], v(0, 0, 0);  // discrete
    Points now(3);
    for (int frame = 1; frame <= frames; ++frame) {
      shot.gravity = frame <= pushed_frames ? push : gravity;
      solver->advance(frame_input(shot, frame));
      solver->read(now);
      for (int s = 0; s < substeps; ++s) {
        v = keep * v + h * shot.gravity;
        x += h * v;
      }
      // keep is rounded to float, 6e-8 of it, a thousand times.
      REQUIRE((now[2] - x).norm() < 1e-5);
    }
    const auto fly = [gamma](const Vector3d& x0, const Vector3d& v0, const Vector3d& a, double t) {
      const double e = std::exp(-gamma * t);
      return std::pair<Vector3d, Vector3d>(x0 + a / gamma * t + (v0 - a / gamma) * ((1 - e) / gamma),
                                           a / gamma + (v0 - a / gamma) * e);
    };
    const auto [thrown_from, velocity] = fly(shot.groom.position[2], {0, 0, 0}, push, pushed_frames / shot.fps);
    const Vector3d landed = fly(thrown_from, velocity, gravity, (frames - pushed_frames) / shot.fps).first;
    errors.push_back((now[2] - landed).norm());
  }
  for (std::size_t k = 1; k < errors.size(); ++k) {
    CAPTURE(k, errors[k - 1], errors[k]);
    CHECK(order(errors[k - 1], errors[k]) == Approx(1).margin(0.05));
  }
}

// A head that falls by the discrete law takes its hair along with no force in any segment; one that falls by t^2 / 2
// differs from it by h t / 2 and no more.
TEST_CASE("on a head in free fall hair is weightless") {
  Shot shot;
  shot.groom = mixed_groom(81, 20, 30);
  shot.region = bare();
  shot.fps = 60;
  shot.frames = 60;
  shot.substeps = 4;
  const double h = 1 / (shot.fps * shot.substeps);
  shot.head = [h, gravity = shot.gravity](double time) {
    const double n = std::round(time / h);
    return pose(Eigen::Matrix3d::Identity(), gravity * (h * h * n * (n + 1) / 2));
  };
  const std::vector<Points> taken = run(shot, in_double());
  for (std::size_t v = 0; v < shot.groom.vertex_count(); ++v)
    CHECK((taken.back()[v] - shot.head(1) * shot.groom.position[v]).norm() < 1e-10);
}

// Period 2 pi sqrt(L / g) / agm(1, cos(angle / 2)), the complete elliptic integral of the first kind by Gauss.
TEST_CASE("a segment swings with the period of the elliptic integral") {
  const LengthParams lengths = GENERATE(LengthParams{}, LengthParams::iterated(2));
  const auto errors_of = [&](double angle, const std::vector<int>& substeps) {
    const double expected = 2 * kPi * std::sqrt(kArm / kGravity) / agm(1, std::cos(angle / 2));
    std::vector<double> errors;
    for (const int count : substeps) {
      // One period from a quarter on: a swing loses height, and with it what makes its period long.
      std::vector<double> zeros = zeros_of(sideways(run(pendulum(angle, count, lengths), in_double())), 240);
      REQUIRE(zeros.size() >= 3);
      errors.push_back(std::abs((zeros[2] - zeros[0]) / expected - 1));
    }
    return errors;
  };
  CAPTURE(lengths.direct);
  SECTION("small: second order") {
    const std::vector<double> errors = errors_of(0.01, {2, 4, 8});
    CAPTURE(errors[0], errors[1], errors[2]);
    CHECK(errors[2] < 2e-5);
    CHECK(order(errors[0], errors[1]) == Approx(2).margin(0.1));
    CHECK(order(errors[1], errors[2]) == Approx(2).margin(0.2));
  }
  SECTION("large: the height that each step's projection takes makes it first order") {
    for (const double angle : {1.0, 2.0}) {
      const std::vector<double> errors = errors_of(angle, {16, 32, 64, 128});
      CAPTURE(angle, errors[0], errors[1], errors[2], errors[3]);
      CHECK(errors[3] < 0.01);
      CHECK(order(errors[1], errors[2]) == Approx(1).margin(0.15));
      CHECK(order(errors[2], errors[3]) == Approx(1).margin(0.1));
    }
  }
}

// Small swings, with w^2 = g / L: the free flight 2 x_n - x_{n-1} is led back to its circle, and direct lengths have
// handed back b = 15/16 w^2 h^2 of the last step's way before (passes/direct_length.h),
//   x_{n+1} = (2 x_n - x_{n-1} + b (x_n - x_{n-1})) / (1 + w^2 h^2)
// So a step takes the share z = ((1 + b) / (1 + w^2 h^2))^(1/2) of the height and turns the phase by
// acos((2 + b) / (2 z (1 + w^2 h^2))): what the scheme itself damps is known.
TEST_CASE("small swings follow the discrete law of the scheme, phase and height") {
  const double angle = 1e-4, w = std::sqrt(kGravity / kArm);
  const LengthParams lengths = GENERATE(LengthParams{}, LengthParams::iterated(2));
  for (const int substeps : {1, 4}) {
    const double h = 1.0 / (240 * substeps);
    const std::vector<double> x = sideways(run(pendulum(angle, substeps, lengths), in_double()));
    const double led_back = 1 + w * w * h * h, b = lengths.direct ? 15.0 / 16 * w * w * h * h : 0;
    const double share = std::sqrt((1 + b) / led_back), phase = std::acos((2 + b) / (2 * share * led_back));
    const double swing = x[0];
    // Of z = share exp(i phase): x_n = x_0 share^n (cos(n phase) - sine sin(n phase)) with x_{-1} = x_0.
    const double sine = (share - std::cos(phase)) / std::sin(phase);
    for (std::size_t f = 0; f < x.size(); ++f) {
      const double n = static_cast<double>(f) * substeps;
      const double expected = swing * std::pow(share, n) * (std::cos(n * phase) - sine * std::sin(n * phase));
      REQUIRE(std::abs(x[f] - expected) < 1e-4 * std::abs(swing));
    }
  }
}

// A root that goes round on a circle of radius R at W rad/s, above a segment of length L in still air. In the plane of
// the circle, as complex numbers that turn with the root: the tip at w, tension T per length and mass, drag gamma:
//   T (w - R) = -K w,   K = -W^2 + i gamma W,   T L cos(theta) = g,   |w - R| = L sin(theta)
// Without drag it is g tan(theta) = W^2 (R + L sin(theta)). The scheme has K = (1 - q) (1 - k q) / h^2, q = exp(-i W
// h), with the share k of the velocity that a step keeps, and B T (w - R) instead of T (w - R), B = 1 - 15/16 k q (1 -
// q), as it hands tension back.
namespace {

constexpr double kRadius = 0.08, kTurn = 7;
using Complex = std::complex<double>;

double steady_angle(Complex k, Complex b = 1) {
  const auto aside = [k, b](double theta) {  // |w - R| / L
    return kRadius * std::abs(k / (b * kGravity / (kArm * std::cos(theta)) + k)) / kArm;
  };
  return root_of([&](double theta) { return std::sin(theta) - aside(theta); }, 1e-3, 1.5);
}

double angle_of_scheme(double keep, int substeps) {
  const double h = 1 / (60.0 * substeps);
  const Complex q = std::polar(1.0, -kTurn * h);
  return steady_angle((1.0 - q) * (1.0 - keep * q) / (h * h), 1.0 - 15.0 / 16 * keep * q * (1.0 - q));
}

double angle_of(const Points& now) {
  return std::acos((now[1] - now[2]).y() / (now[1] - now[2]).norm());
}

Shot carousel(double theta, int substeps) {
  Shot shot;
  shot.groom = one_segment(theta, {kRadius, 0, 0});
  shot.region = bare();
  shot.head = [](double time) {
    return pose(Eigen::AngleAxisd(kTurn * time, Vector3d::UnitY()).toRotationMatrix(), {0, 0, 0});
  };
  shot.substeps = substeps;
  return shot;
}

}  // namespace

TEST_CASE("on a root in circular motion a segment stands at the steady angle, at first order in the substep") {
  const double damping = 0.1, gamma = -60 * std::log(1 - damping);
  const double theta = steady_angle({-kTurn * kTurn, gamma * kTurn});
  std::vector<double> errors;
  for (const int substeps : {4, 8, 16, 32}) {
    Shot shot = carousel(theta, substeps);
    shot.region.damping = damping;
    shot.frames = 400;
    const double angle = angle_of(run(shot, in_double()).back());
    const double keep = static_cast<float>(std::pow(1 - damping, 1.0 / substeps));
    CHECK(angle == Approx(angle_of_scheme(keep, substeps)).margin(1e-7));
    errors.push_back(std::abs(angle - theta));
  }
  CAPTURE(theta, errors[0], errors[1], errors[2], errors[3]);
  CHECK(errors[3] < 3e-3);
  for (std::size_t k = 1; k < errors.size(); ++k) CHECK(order(errors[k - 1], errors[k]) == Approx(1).margin(0.05));
}

// The damping that leads there goes to nothing over 30 s, so smoothly that nothing is left swinging.
TEST_CASE("without damping the steady angle is that of the conical pendulum, at second order") {
  const double theta =
      newton([](double t) { return kGravity * std::tan(t) - kTurn * kTurn * (kRadius + kArm * std::sin(t)); },
             [](double t) { return kGravity / (std::cos(t) * std::cos(t)) - kTurn * kTurn * kArm * std::cos(t); }, 0.5);
  CHECK(steady_angle({-kTurn * kTurn, 0}) == Approx(theta).epsilon(1e-12));
  std::vector<double> errors;
  for (const int substeps : {1, 2, 4}) {
    Shot shot = carousel(theta, substeps);
    shot.regions_at = [region = shot.region](int frame) {
      RegionParams now = region;
      now.damping = 0.1 * std::pow(std::max(0.0, 1 - frame / 1800.0), 4);
      return std::vector<RegionParams>{now};
    };
    shot.frames = 2400;
    const double angle = angle_of(run(shot, in_double()).back());
    CHECK(angle == Approx(angle_of_scheme(1, substeps)).margin(1e-5));
    errors.push_back(std::abs(angle - theta));
  }
  CAPTURE(theta, errors[0], errors[1], errors[2]);
  CHECK(errors[2] < 1e-3);
  for (std::size_t k = 1; k < errors.size(); ++k) CHECK(order(errors[k - 1], errors[k]) == Approx(2).margin(0.2));
}
