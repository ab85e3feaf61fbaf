// The kernels for avx2, in a file of its own because it is compiled with that instruction set switched on.
#include "sim/block_kernel.h"

namespace strandbake {

extern const LaneKernels kLanesAvx2 = {"avx2", 8, 4, advance_block<Lanes<float, 8>>, advance_block<Lanes<double, 4>>};

}  // namespace strandbake
