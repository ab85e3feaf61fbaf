// Positions in the world, in the order of the groom, from blocks of strands. `origin_`: without -0. `not_finite`
// becomes 1 where a number is none.
__kernel void gather(const __global Real* state, const __global BlockRow* blocks, const __global Target* targets,
                     uint swapped, Real origin_x, Real origin_y, Real origin_z, __global float* out,
                     __global uint* not_finite) {
  const uint strand = get_global_id(0);
  const BlockRow block = blocks[strand / WIDTH];
  const Target target = targets[strand];
  const uint now = swapped && !block.rides ? block.previous : block.position;
  const __global Real* const p = state + now + strand % WIDTH;
  for (uint i = get_global_id(1); i < target.count; i += get_global_size(1)) {
    const Real3 v = read3(p, i);
    __global float* const to = out + 3 * ((size_t)target.first + i);
    to[0] = (float)(v.x + origin_x);
    to[1] = (float)(v.y + origin_y);
    to[2] = (float)(v.z + origin_z);
    if (!(isfinite(v.x) && isfinite(v.y) && isfinite(v.z))) atomic_or(not_finite, 1u);
  }
}
