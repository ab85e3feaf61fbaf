// Two chains of operations that depend on nothing of each other, written as one number: while the processor waits for
// the one it works on the other. The second may be a pair again.
//
// Included by the files lanes_*.cpp alone, like lanes.h.
#pragma once

#include "sim/passes/strand_math.h"

namespace strandbake {

#define STRANDBAKE_PAIR_FN friend inline __attribute__((always_inline))

template <class First, class Second = First>
struct Pair {
  using Scalar = typename First::Scalar;
  using Behind = Second;
  struct Mask {
    typename First::Mask first;
    typename Second::Mask second;
  };
  First first;
  Second second;

  Pair() = default;
  inline __attribute__((always_inline)) Pair(Scalar a) : first(a), second(a) {}
  inline __attribute__((always_inline)) Pair(First a, Second b) : first(a), second(b) {}

  STRANDBAKE_PAIR_FN Pair operator+(Pair a, Pair b) { return {a.first + b.first, a.second + b.second}; }
  STRANDBAKE_PAIR_FN Pair operator-(Pair a, Pair b) { return {a.first - b.first, a.second - b.second}; }
  STRANDBAKE_PAIR_FN Pair operator*(Pair a, Pair b) { return {a.first * b.first, a.second * b.second}; }
  STRANDBAKE_PAIR_FN Pair operator/(Pair a, Pair b) { return {a.first / b.first, a.second / b.second}; }
  STRANDBAKE_PAIR_FN Mask operator<(Pair a, Pair b) { return {a.first < b.first, a.second < b.second}; }
  STRANDBAKE_PAIR_FN Mask operator>(Pair a, Pair b) { return {a.first > b.first, a.second > b.second}; }
  STRANDBAKE_PAIR_FN Pair select(Mask m, Pair a, Pair b) {
    return {select(m.first, a.first, b.first), select(m.second, a.second, b.second)};
  }
  STRANDBAKE_PAIR_FN Pair square_root(Pair a) { return {square_root(a.first), square_root(a.second)}; }
};

#undef STRANDBAKE_PAIR_FN

}  // namespace strandbake
