// The loops of the probes, as the files that are compiled for one instruction set each hand them out. Like sim/block.h
// it shares no inline function with the rest of the program.
#pragma once

#include <cstddef>

namespace strandbake {

// Each runs `rounds` times and returns a number that depends on all it did. Called with 1 and 0.
using ArithmeticLoop = double (*)(long rounds, double one, double zero);
struct ArithmeticKernels {
  ArithmeticLoop multiply_add;
  ArithmeticLoop divide;
  ArithmeticLoop root;
  int operations;  // in a round, each lane counted
};

// Compiled once per instruction set (probe_loops.h). Arrays are aligned to 64 bytes, counts multiples of 16.
struct ProbeKernels {
  int lanes;  // floats in a vector
  ArithmeticKernels single_precision;
  ArithmeticKernels double_precision;
  void (*triad)(float* out, const float* a, const float* b, std::size_t count);                     // out = a + 3 b
  void (*update)(float* inout, const float* a, const float* b, const float* c, std::size_t count);  // reads 4, writes 1
};
extern const ProbeKernels kProbeSse2;
extern const ProbeKernels kProbeAvx2;
extern const ProbeKernels kProbeAvx512;

}  // namespace strandbake
