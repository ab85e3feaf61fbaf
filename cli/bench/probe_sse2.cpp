// The probes for sse2, in a file of its own because it is compiled with that instruction set switched on.
#include "cli/bench/probe_loops.h"

namespace strandbake {

extern const ProbeKernels kProbeSse2 = probe_kernels<4>();

}  // namespace strandbake
