// The figures of a frame (sim/measure.h): largest stretch, residual, deepest penetration. Numbers from 0 on are in the
// order of their bits, so a maximum does not depend on who comes first.
#ifdef HAS_FIGURES
static void raise(__global uint* figure, float value) {
  const uint bits = as_uint(value);
  if (value > 0 && bits > *figure) atomic_max(figure, bits);  // most find that there is nothing to do
}

static float largest_error(Real least, Real most) {
  const float shrunk = (float)((Real)1 - sqrt(least));
  const float grown = (float)(sqrt(most) - (Real)1);
  return shrunk > grown ? shrunk : grown;
}

__kernel void measure(const __global Real* state, const __global BlockRow* blocks, const __global Target* targets,
                      uint swapped, const __global Real* spheres, uint sphere_begin, uint sphere_count,
                      __global uint* figures) {
  const uint strand = get_global_id(0);
  const BlockRow block = blocks[strand / WIDTH];
  if (!block.simulated) return;
  const uint lane = strand % WIDTH;
  const uint count = targets[strand].count;
  const __global Real* const p = state + (swapped ? block.previous : block.position) + lane;
  const __global Real* const rest_length = state + block.length + lane;
  const Weights weights = weights_of(state, block, lane);
  Real least = 1, most = 1, held_least = 1, held_most = 1;
  float depth = 0;
  for (uint i = 1 + get_global_id(1); i < count; i += get_global_size(1)) {
    const Real3 here = read3(p, i);
    const Real ratio2 = squared_length_ratio(here - read3(p, i - 1), read1(rest_length, i));
    least = ratio2 < least ? ratio2 : least;
    most = ratio2 > most ? ratio2 : most;
    if (i < 2) continue;
#ifdef HAS_MASKED
    if (weights.masked && !(read1(weights.swept, i) > (Real)0)) {
      held_least = ratio2 < held_least ? ratio2 : held_least;
      held_most = ratio2 > held_most ? ratio2 : held_most;
    }
#endif
#ifdef HAS_SPHERES
    for (uint k = 0; k < sphere_count && free_weight(weights, i) > (Real)0; ++k) {
      const __global Real* const sphere = spheres + 4 * (sphere_begin + k);
      const Real distance2 = squared_distance(here, triple(sphere));
      if (!(distance2 < sphere[3] * sphere[3])) continue;
      const float deep = (float)(sphere[3] - sqrt(distance2));
      depth = deep > depth ? deep : depth;
    }
#endif
  }
  raise(figures, largest_error(least, most));
  raise(figures + 1, largest_error(held_least, held_most));
  raise(figures + 2, depth);
}
#endif
