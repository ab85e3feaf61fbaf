// The probes for avx512, in a file of its own because it is compiled with that instruction set switched on.
#include "cli/bench/probe_loops.h"

namespace strandbake {

extern const ProbeKernels kProbeAvx512 = probe_kernels<16>();

}  // namespace strandbake
