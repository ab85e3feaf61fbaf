// What the processor can do at most: loops that are nothing but one operation, in lanes of one width. Included by the
// files probe_*.cpp alone, once per instruction set, as the solver's kernels are.
#pragma once

#include "cli/bench/probe_kernels.h"
#include "sim/lanes.h"

namespace strandbake {
namespace {

// Independent chains, enough to fill two pipes of four cycles each, with registers left for the operands (SSE2 has 16).
constexpr int kChains = 12;

template <class Real>
double sum_of(const Real* chains) {
  double sum = 0;
  for (int c = 0; c < kChains; ++c) {
    for (int lane = 0; lane < Real::width; ++lane) sum += static_cast<double>(chains[c].v[lane]);
  }
  return sum;
}

// Half of the chains multiply, half add, as the solver's passes do; `one` and `zero` keep the values as they are, which
// the compiler does not know.
template <class Real>
double multiply_add(long rounds, double one, double zero) {
  using Scalar = typename Real::Scalar;
  const Real factor(static_cast<Scalar>(one)), term(static_cast<Scalar>(zero));
  Real chains[kChains];
#pragma GCC unroll 12
  for (int c = 0; c < kChains; ++c) chains[c] = Real(static_cast<Scalar>(1 + c));
  for (long round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
    for (int c = 0; c < kChains; ++c) chains[c] = c % 2 == 0 ? chains[c] * factor : chains[c] + term;
  }
  return sum_of(chains);
}

template <class Real>
double divide(long rounds, double one, double) {
  using Scalar = typename Real::Scalar;
  const Real dividend(static_cast<Scalar>(1.37 * one));
  Real chains[kChains];
#pragma GCC unroll 12
  for (int c = 0; c < kChains; ++c) chains[c] = Real(static_cast<Scalar>(1.1 + c));
  for (long round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
    for (int c = 0; c < kChains; ++c) chains[c] = dividend / chains[c];
  }
  return sum_of(chains);
}

// The addition keeps the numbers away from 1 and runs in a pipe of its own.
template <class Real>
double root(long rounds, double one, double) {
  using Scalar = typename Real::Scalar;
  const Real term(static_cast<Scalar>(0.37 * one));
  Real chains[kChains];
#pragma GCC unroll 12
  for (int c = 0; c < kChains; ++c) chains[c] = Real(static_cast<Scalar>(1.1 + c));
  for (long round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
    for (int c = 0; c < kChains; ++c) chains[c] = square_root(chains[c] + term);
  }
  return sum_of(chains);
}

template <class Real>
void triad(float* out, const float* a, const float* b, std::size_t count) {
  auto* to = reinterpret_cast<Real*>(out);
  const auto *first = reinterpret_cast<const Real*>(a), *second = reinterpret_cast<const Real*>(b);
  const Real factor(3.0f);
  for (std::size_t i = 0; i < count / Real::width; ++i) to[i] = first[i] + second[i] * factor;
}

template <class Real>
void update(float* inout, const float* a, const float* b, const float* c, std::size_t count) {
  auto* to = reinterpret_cast<Real*>(inout);
  const auto *first = reinterpret_cast<const Real*>(a), *second = reinterpret_cast<const Real*>(b),
             *third = reinterpret_cast<const Real*>(c);
  for (std::size_t i = 0; i < count / Real::width; ++i) to[i] = (first[i] + second[i]) + (third[i] - to[i]);
}

template <int W>
constexpr ProbeKernels probe_kernels() {
  using Single = Lanes<float, W>;
  using Double = Lanes<double, W / 2>;
  return {W,
          {multiply_add<Single>, divide<Single>, root<Single>, W * kChains},
          {multiply_add<Double>, divide<Double>, root<Double>, W / 2 * kChains},
          triad<Single>,
          update<Single>};
}

}  // namespace
}  // namespace strandbake
