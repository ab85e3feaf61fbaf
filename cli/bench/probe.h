// What the machine can do at most, measured in the same process as the figures that are held against it.
#pragma once

#include <utility>
#include <vector>

#include "sim/solver.h"

namespace strandbake {

// Operations a second on all threads together, each lane counted.
struct Arithmetic {
  double multiply_add = 0;  // multiplications and additions in equal parts, not fused
  double divide = 0;
  double root = 0;
};

struct Probes {
  int threads = 1;
  int lanes = 0;  // of the vectors that were used: the widest that the machine has
  Arithmetic single_precision, double_precision;
  double triad = 0;  // [bytes/s] out of memory, 12 bytes counted an element, as STREAM does
  // Working set of all threads together [bytes] and bytes a second, when four streams are read and one of them is
  // written, which is near to what the solver does. Increasing sizes.
  std::vector<std::pair<double, double>> update;

  // Of a working set of this size [bytes/s].
  double bandwidth(double working_set) const;
  const Arithmetic& arithmetic(Precision precision) const {
    return precision == Precision::Double ? double_precision : single_precision;
  }
};

// Takes about a second; `quick` a quarter of it.
Probes measure_probes(int threads, bool quick);

}  // namespace strandbake
