// The probes for avx2, in a file of its own because it is compiled with that instruction set switched on.
#include "cli/bench/probe_loops.h"

namespace strandbake {

extern const ProbeKernels kProbeAvx2 = probe_kernels<8>();

}  // namespace strandbake
