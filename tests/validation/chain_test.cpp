// Many segments at once: a hanging chain that swings, and one that hangs from both ends.
#include "tests/validation/validation.h"

using namespace strandbake;
using namespace strandbake::validation;

namespace {

constexpr double kGravity = 9.81;

// Laguerre's polynomials L_0 .. L_n at x, by their recurrence.
std::vector<double> laguerre(int n, double x) {
  std::vector<double> values = {1, 1 - x};
  for (int m = 1; m < n; ++m) {
    const auto k = static_cast<std::size_t>(m);
    values.push_back(((2 * m + 1 - x) * values[k] - m * values[k - 1]) / (m + 1));
  }
  return values;
}

// Equal masses on segments of length l, the lowest one at the tip: mode shapes L_m(x) at the m-th mass from the tip,
// where L_n(x) = 0 at the support, and frequencies w^2 = x g / l. (Bernoulli 1733; the zeros tend to j_k^2 / (4 n +
// 2).)
double laguerre_zero(int n, double bessel_zero) {
  const double near = bessel_zero * bessel_zero / (4 * n + 2);
  return root_of([n](double x) { return laguerre(n, x)[static_cast<std::size_t>(n)]; }, 0.95 * near, 1.05 * near);
}

constexpr double kBesselZeros[] = {2.404825557695773, 5.520078110286311, 8.653727912911013};

// A chain of `masses` free vertices and segments, let go from a small swing in one of its modes.
struct Chain {
  Shot shot;
  std::vector<double> mode;  // by mass, from the root on
  double discrete;           // w [rad/s] of so many masses
  double continuous;         // w of a heavy string of the same length
  double periods = 3;

  Chain(int masses, double length, std::size_t k, int substeps) {
    const double segment = length / masses, x = laguerre_zero(masses, kBesselZeros[k]);
    discrete = std::sqrt(x * kGravity / segment);
    continuous = kBesselZeros[k] / 2 * std::sqrt(kGravity / length);
    const std::vector<double> from_tip = laguerre(masses, x);
    Points p = {{0, segment, 0}, {0, 0, 0}};
    for (int i = 1; i <= masses; ++i) {
      mode.push_back(from_tip[static_cast<std::size_t>(masses - i)]);
      const double aside = 1e-4 * length * mode.back(), before = p.back().x();
      const double across = aside - before;
      p.push_back({aside, p.back().y() - std::sqrt(segment * segment - across * across), 0});
    }
    shot.groom = groom_of({p});
    shot.region = bare();
    shot.fps = 60 * std::ceil(discrete / 5);
    shot.substeps = substeps;
    shot.frames = static_cast<int>(std::ceil((periods + 0.5) * 2 * kPi / discrete * shot.fps));
  }

  // How much of the mode each frame has in it, 1 at the start.
  std::vector<double> amplitude() const {
    std::vector<double> along;
    for (const Points& now : run(shot, in_double())) {
      double sum = 0, norm = 0;
      for (std::size_t m = 0; m < mode.size(); ++m) {
        sum += now[m + 2].x() * mode[m];
        norm += mode[m] * mode[m];
      }
      along.push_back(sum / norm);
    }
    return along;
  }
  double frequency() const { return 2 * kPi / period_of(amplitude(), shot.fps); }
};

}  // namespace

// Few enough masses that no tension acts implicitly (passes/direct_length.h): that is of first order, but in damping.
TEST_CASE("a hanging chain swings with the frequencies of its masses, at second order in the substep") {
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<double> errors;
    for (const int substeps : {2, 4, 8}) {
      const Chain chain(12, 0.3, k, substeps);
      errors.push_back(std::abs(chain.frequency() / chain.discrete - 1));
    }
    CAPTURE(k, errors[0], errors[1], errors[2]);
    CHECK(errors[2] < 3e-5);
    CHECK(order(errors[0], errors[1]) == Approx(2).margin(0.3));
  }
}

// Measured: 1.4e-3 with one substep, 8e-5 with four.
TEST_CASE("where tension acts implicitly, a hanging chain swings with nearly the same frequencies") {
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<double> errors;
    for (const int substeps : {1, 2, 4}) {
      const Chain chain(64, 0.3, k, substeps);
      errors.push_back(chain.frequency() / chain.discrete - 1);
    }
    CAPTURE(k, errors[0], errors[1], errors[2]);
    CHECK(std::abs(errors[0]) < 2e-3);
    CHECK(std::abs(errors[2]) < 1.5e-4);
  }
}

// A chain of n masses is a heavy string of n + 1/2 segments: with the length as it is the error is of first order in
// the segment, with half a segment more of second.
TEST_CASE("with more segments it tends to a heavy string's, the zeros of J0") {
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<double> errors, shifted;
    for (const int masses : {16, 32, 64}) {
      const Chain chain(masses, 0.3, k, 64);
      const double measured = chain.frequency();
      errors.push_back(std::abs(measured / chain.continuous - 1));
      shifted.push_back(std::abs(measured / (chain.continuous / std::sqrt(1 + 0.5 / masses)) - 1));
    }
    CAPTURE(k, errors[0], errors[1], errors[2], shifted[0], shifted[1], shifted[2]);
    CHECK(errors[2] < 0.005);
    CHECK(order(errors[0], errors[1]) == Approx(1).margin(0.2));
    CHECK(order(errors[1], errors[2]) == Approx(1).margin(0.1));
    CHECK(shifted[2] < 2e-4);
    CHECK(order(shifted[0], shifted[1]) == Approx(2).margin(0.2));
    CHECK(order(shifted[1], shifted[2]) == Approx(2).margin(0.4));
  }
}

namespace {

constexpr double kSpan = 0.2, kLength = 0.3;

// A chain of equal segments between vertex 1 and the last, both held, on a level; at rest it lies on an arc.
Shot held_at_both_ends(std::size_t segments, int substeps) {
  // n chords of length L / n that turn by `turn` in all: the chord of the whole is L / n sin(turn / 2) / sin(turn /
  // 2n).
  const double n = static_cast<double>(segments), chord = kLength / n;
  const double turn =
      root_of([&](double t) { return chord * std::sin(t / 2) / std::sin(t / (2 * n)) - kSpan; }, 0.1, 6);
  Points p = {{0, 0.01, 0}, {0, 0, 0}};
  for (std::size_t i = 0; i < segments; ++i) {
    const double angle = -turn / 2 + turn * (static_cast<double>(i) + 0.5) / n;
    p.push_back(p.back() + chord * Vector3d(std::cos(angle), std::sin(angle), 0));
  }
  Shot shot;
  shot.groom = groom_of({p});
  pin(shot.groom, 0, segments + 1);
  shot.region = bare();
  shot.region.damping = 0.1;
  shot.substeps = substeps;
  shot.frames = 360;
  return shot;
}

}  // namespace

// y = a cosh((x - span / 2) / a) - a cosh(span / 2a), with 2 a sinh(span / 2a) = length. Residuals of the lengths are
// far below: 1e-5.
TEST_CASE("hair that is held at both ends hangs in a catenary, at second order in its segments") {
  const double a = root_of([](double b) { return 2 * b * std::sinh(kSpan / (2 * b)) - kLength; }, 0.01, 10);
  const double sag = a * (std::cosh(kSpan / (2 * a)) - 1);
  std::vector<double> errors;
  for (const std::size_t segments : {std::size_t{8}, std::size_t{16}, std::size_t{32}}) {
    const std::vector<Points> taken = run(held_at_both_ends(segments, 16), in_double());
    const Points& hanging = taken.back();
    CHECK(largest_distance(taken[taken.size() - 30], hanging) < 1e-5);  // at rest
    double length = 0, farthest = 0;
    for (std::size_t i = 1; i < hanging.size(); ++i) {
      if (i > 1) length += (hanging[i] - hanging[i - 1]).norm();
      const double y = a * std::cosh((hanging[i].x() - kSpan / 2) / a) - a * std::cosh(kSpan / (2 * a));
      farthest = std::max(farthest, std::abs(hanging[i].y() - y) / sag);
      CHECK(std::abs(hanging[i].z()) < 1e-12);
    }
    CHECK(length == Approx(kLength).epsilon(1e-5));
    errors.push_back(farthest);
  }
  CAPTURE(errors[0], errors[1], errors[2]);
  CHECK(errors[2] < 2e-3);
  CHECK(order(errors[0], errors[1]) == Approx(2).margin(0.2));
  CHECK(order(errors[1], errors[2]) == Approx(2).margin(0.2));
}
