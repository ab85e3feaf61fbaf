#include "cli/bench/floor.h"

#include <algorithm>

#include "sim/passes/direct_length.h"

namespace strandbake {

Work Work::operator+(const Work& other) const {
  return {read + other.read, written + other.written, operations + other.operations, divisions + other.divisions,
          roots + other.roots};
}

Work Work::repeated(double times) const {
  return {read, written, operations * times, divisions * times, roots * times};
}

// How these are counted:
//   read and written   the arrays of sim/block.h that the pass walks over for a block that is not masked, 3 numbers a
//                      vector. Each is counted at the pass that needs it; positions belong to the integration.
//   operations         + - * and comparisons in the text of sim/passes, for a free vertex between free vertices, with
//                      what does not differ between vertices taken out, a common expression counted once and the two
//                      halves of a shared correction as one. Selects are free.
// An inner product is 5 operations, an outer product 9, a rotation 15, a vector sum or scaling 3.
namespace work {

Work integrate() {
  // Reads P and Q, writes P' over Q. p - q 3, keep 3, two sums 6.
  return {6, 3, 12, 0, 0};
}

Work wind() {
  // Edge 3, two inner products 10, comparison 1, along the edge 3, across it 3, sum 3.
  return {0, 0, 23, 1, 0};
}

Work global_shape() {
  // Reads P0 and the fade. Stiffness at the step 4, goal 15 + 3, pull 9.
  return {4, 0, 31, 1, 0};
}

Work local_shape(int method, int iterations, bool reacts) {
  // Method 3 reads P0: once a substep it turns the rest edges with the head, 3 + 15. A sweep has the edge 3, its error
  // 3, half the stiffness 3, share 6.
  if (method == 3) return Work{3, 0, 18, 0, 0} + Work{0, 0, 15, 0, 0}.repeated(iterations);
  // Reads l and what rounding leaves of it. Edge 3, goal 24, error 6, half the stiffness 3, share 6; the new edge 3;
  // the turn of the frame: length 6, k 6, two comparisons 2, r 1, x 4, y 18. Method 2 also keeps x and y of each frame.
  // With a reaction: once a substep reads the lever and L, rho 1 and weight and share 7; then the projection 5, of the
  // goal 3, of the move 3, difference 3, lever 3, and 6 more for the vertex before.
  const Work once = reacts ? Work{2, 0, 8, 1, 0} : Work{};
  const double operations = 3 + 24 + 6 + 3 + 6 + 3 + 37 + (reacts ? 23 : 0);
  if (method == 2) return once + Work{12, 6, operations, 1, 1}.repeated(iterations);
  // Method 4: the constraint as above; edge 3, its direction 9, the frame along it 8, the twist between two 37, the
  // frame 9 that comes of it. Of the products 6, one a vertex: with the rounds of a scan come log2 n, but a walk has no
  // more.
  const double scanned = 3 + 24 + 6 + 3 + 6 + 3 + 9 + 8 + 37 + 9 + 6 + (reacts ? 23 : 0);
  if (method == 4) return once + Work{6, 0, scanned, 3, 1}.repeated(iterations);
  return once + Work{6, 0, operations, 1, 1}.repeated(iterations);
}

Work edge_lengths() {
  // Reads L. Edge 3, length 6, difference 1, error 3, half of it 3, share 6.
  return {1, 0, 22, 1, 1};
}

Work direct_lengths() {
  // Reads L and T, writes T. T handed back: ratio 2, its bound 1, difference 3, share 4, difference 3, sum 3. T where
  // it does not act 5, and what is added to it 4. A round: edge 3, length 6, direction 3, error 1, b 5, share 1, pivot
  // 3, solved 3, lambda 2, pull 3, move 6. The walk: edge 3, direction 8, step 6.
  const Work round = {0, 0, 36, 2, 1};
  return Work{2, 1, 42, 3, 1} + round.repeated(LENGTH_ROUNDS);
}

Work rod(int iterations) {
  // Reads kappa0, L and x and y of each frame, writes those. A substep: P where it begins 6, weight 2. Of an iteration
  // rod_joint has z 9, kappa 55, and 123 more; with_vertex 75, at_near_end 114, with_joint 230; the way back 164.
  return Work{10, 6, 8, 0, 0} + Work{0, 0, 9 + 55 + 123 + 6 + 75 + 114 + 230 + 164, 7, 1}.repeated(iterations);
}

Work sphere() {
  // What it takes to know that a vertex is outside: distance 3 + 5, comparison 1. Few are inside.
  return {0, 0, 9, 0, 0};
}

Work read() {
  return {3, 3, 0, 0, 0};
}

Work non_finite() {
  return {3, 0, 3, 0, 0};
}

}  // namespace work

Work work_of(const Workload& workload) {
  const RegionPlan plan = workload.plan().regions.front();
  const RegionParams& params = workload.params;
  Work sum = work::integrate();
  if (plan.wind) sum = sum + work::wind();
  if (plan.global_shape) {
    const Work in_range = work::global_shape();
    const double share = plan.global_range;
    sum = sum + Work{in_range.read * share, 0, in_range.operations * share, in_range.divisions * share, 0};
  }
  if (plan.local_shape) sum = sum + work::local_shape(plan.local_method, params.local.iterations, plan.reacts);
  if (plan.rod) sum = sum + work::rod(params.rod.iterations);
  if (plan.edge_lengths) {
    sum =
        sum + (plan.direct_lengths ? work::direct_lengths() : work::edge_lengths().repeated(params.lengths.iterations));
  }
  return sum + work::sphere().repeated(workload.spheres);
}

double floor_seconds(const Work& work, double vertices, int substeps, Precision precision, const Probes& probes) {
  const double size = precision == Precision::Double ? sizeof(double) : sizeof(float);
  const double in_memory = work.read * size * vertices;
  const double memory = (work.read + work.written) * size * vertices / probes.bandwidth(in_memory);
  const Arithmetic& peak = probes.arithmetic(precision);
  // Multiplications and additions run beside the one unit that divides and takes roots.
  const double simple = work.operations / peak.multiply_add;
  const double hard = work.divisions / peak.divide + work.roots / peak.root;
  return std::max(memory, std::max(simple, hard) * vertices * substeps);
}

}  // namespace strandbake
