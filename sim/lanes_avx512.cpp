// The kernels for avx512, in a file of its own because it is compiled with that instruction set switched on.
#include "sim/block_kernel.h"

namespace strandbake {

extern const LaneKernels kLanesAvx512 = {"avx512", 16, 8, advance_block<Lanes<float, 16>>,
                                         advance_block<Lanes<double, 8>>};

}  // namespace strandbake
