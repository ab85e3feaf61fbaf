// What the tests against closed forms share.
#pragma once

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>

#include "tests/sim/harness.h"

namespace strandbake::validation {

using namespace strandbake::harness;

constexpr double kPi = std::numbers::pi;

// Lengths and forces alone: no damping, no shape.
inline RegionParams bare(const LengthParams& lengths = {}) {
  RegionParams region;
  region.damping = 0;
  region.local.stiffness = 0;
  region.global.stiffness = 0;
  region.lengths = lengths;
  return region;
}

// Exponent of h in the error, from errors of which each but the first is made with half the substep of the one before.
inline double order(double coarse, double fine) {
  return std::log2(coarse / fine);
}

// Where `f` vanishes between `low` and `high`, at which its signs differ.
template <class Function>
double root_of(const Function& f, double low, double high) {
  const bool rises = f(high) > 0;
  for (int k = 0; k < 200; ++k) {
    const double middle = (low + high) / 2;
    ((f(middle) > 0) == rises ? high : low) = middle;
  }
  return (low + high) / 2;
}

// Newton's method from `x`; `derivative` is that of `f`.
template <class Function, class Derivative>
double newton(const Function& f, const Derivative& derivative, double x) {
  for (int k = 0; k < 100; ++k) x -= f(x) / derivative(x);
  return x;
}

// Arithmetic-geometric mean.
inline double agm(double a, double b) {
  while (std::abs(a - b) > 1e-15 * a) {
    const double mean = (a + b) / 2;
    b = std::sqrt(a * b);
    a = mean;
  }
  return a;
}

// Times [s] at which samples, one a frame, change their sign; a straight line between frames.
inline std::vector<double> zeros_of(const std::vector<double>& samples, double fps) {
  std::vector<double> zeros;
  for (std::size_t f = 1; f < samples.size(); ++f) {
    const double before = samples[f - 1], after = samples[f];
    if ((before > 0) != (after > 0)) zeros.push_back((static_cast<double>(f) - after / (after - before)) / fps);
  }
  return zeros;
}

// Period [s] of an oscillation about 0, from its first passage to the last that is whole periods later.
inline double period_of(const std::vector<double>& samples, double fps) {
  const std::vector<double> zeros = zeros_of(samples, fps);
  REQUIRE(zeros.size() >= 3);
  const std::size_t last = (zeros.size() - 1) / 2 * 2;
  return (zeros[last] - zeros[0]) / (static_cast<double>(last) / 2);
}

// Of vertices in all frames but the first [m].
inline double rms_distance(const std::vector<Points>& a, const std::vector<Points>& b) {
  double sum = 0, count = 0;
  for (std::size_t frame = 1; frame < a.size(); ++frame) {
    for (std::size_t v = 0; v < a[frame].size(); ++v) sum += (a[frame][v] - b[frame][v]).squaredNorm();
    count += static_cast<double>(a[frame].size());
  }
  return std::sqrt(sum / count);
}

}  // namespace strandbake::validation
