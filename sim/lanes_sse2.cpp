// The kernels for sse2, in a file of its own because it is compiled with that instruction set switched on.
#include "sim/block_kernel.h"

namespace strandbake {

extern const LaneKernels kLanesSse2 = {"sse2", 4, 2, advance_block<Lanes<float, 4>>, advance_block<Lanes<double, 2>>};

}  // namespace strandbake
