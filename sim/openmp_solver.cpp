#include <omp.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <new>
#include <numeric>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>

#include "sim/block.h"
#include "sim/gusts.h"
#include "sim/large_array.h"
#include "sim/parallel.h"
#include "sim/passes/edge_length.h"
#include "sim/passes/local_shape.h"
#include "sim/passes/stiffness.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

constexpr double kReferenceStep = 1.0 / 60;  // h0 [s]

std::vector<const LaneKernels*> available_kernels() {
  std::vector<const LaneKernels*> kernels = {&kLanesSse2};
#ifdef STRANDBAKE_X86
  if (__builtin_cpu_supports("avx2")) kernels.push_back(&kLanesAvx2);
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl")) {
    kernels.push_back(&kLanesAvx512);
  }
#endif
  return kernels;
}

const LaneKernels& choose_kernels(int lanes) {
  const auto kernels = available_kernels();
  if (lanes == 0) return *kernels.back();
  for (const LaneKernels* k : kernels) {
    if (k->width_float == lanes) return *k;
  }
  throw std::invalid_argument("this machine cannot run " + std::to_string(lanes) + " lanes");
}

template <class Scalar>
Vec3<Scalar> to_vec3(const Eigen::Vector3d& v) {
  // Adding +0 makes -0 to +0, which no later operation could tell from it but a comparison of bytes can.
  return {static_cast<Scalar>(v.x()) + 0, static_cast<Scalar>(v.y()) + 0, static_cast<Scalar>(v.z()) + 0};
}

template <class Scalar>
struct HeadTransform {
  Scalar rotation[9];
  Scalar translation[3];

  explicit HeadTransform(const Eigen::Isometry3d& head) {
    for (int row = 0; row < 3; ++row) {
      for (int column = 0; column < 3; ++column)
        rotation[3 * row + column] = static_cast<Scalar>(head.linear()(row, column));
      translation[row] = static_cast<Scalar>(head.translation()[row]) + 0;  // no -0, as in to_vec3
    }
  }
  Vec3<Scalar> turn(Vec3<Scalar> v) const {
    const Scalar* r = rotation;
    return rotate<Scalar>({r[0], r[1], r[2]}, {r[3], r[4], r[5]}, {r[6], r[7], r[8]}, v);
  }
  Vec3<Scalar> apply(Vec3<Scalar> v) const {
    return turn(v) + Vec3<Scalar>{translation[0], translation[1], translation[2]};
  }
};

// x along the first segment that has a direction, y across it along the axis that is farthest from it.
template <class Scalar>
Frame<Scalar> rest_root_frame(std::span<const Vec3<Scalar>> rest) {
  Vec3<Scalar> x = {1, 0, 0};
  for (std::size_t i = 1; i < rest.size(); ++i) {
    const Vec3<Scalar> edge = rest[i] - rest[i - 1];
    const Scalar length2 = inner(edge, edge);
    if (length2 > static_cast<Scalar>(1e-30f)) {
      x = edge * (1 / square_root(length2));
      break;
    }
  }
  const Scalar ax = std::abs(x.x), ay = std::abs(x.y), az = std::abs(x.z);
  Vec3<Scalar> axis = {0, 0, 1};
  if (ax <= ay && ax <= az) {
    axis = {1, 0, 0};
  } else if (ay <= az) {
    axis = {0, 1, 0};
  }
  const Vec3<Scalar> across = axis - x * inner(x, axis);
  return {x, across * (1 / square_root(inner(across, across)))};
}

// Spreads the low ten bits of v over every third bit.
std::uint32_t spread_bits(std::uint32_t v) {
  v = (v | (v << 16)) & 0x030000ff;
  v = (v | (v << 8)) & 0x0300f00f;
  v = (v | (v << 4)) & 0x030c30c3;
  return (v | (v << 2)) & 0x09249249;
}

// For each strand its root's place on a curve that keeps neighbours together (Morton's), so that the strands of a block
// are near each other and meet the same colliders.
std::vector<std::uint32_t> order_in_space(const Groom& groom) {
  const std::size_t strands = groom.strand_count();
  Eigen::AlignedBox3d box;
  for (std::size_t s = 0; s < strands; ++s) box.extend(groom.position[groom.offset[s]]);
  std::vector<std::uint32_t> place(strands, 0);
  for (std::size_t s = 0; s < strands; ++s) {
    const Eigen::Vector3d from_corner = groom.position[groom.offset[s]] - box.min();
    for (int axis = 0; axis < 3; ++axis) {
      const double size = box.sizes()[axis];
      const double share = size > 0 ? from_corner[axis] / size : 0;
      if (share > 0) place[s] |= spread_bits(static_cast<std::uint32_t>(std::min(share, 1.0) * 1023)) << axis;
    }
  }
  return place;
}

template <class Scalar>
struct Placed {  // a block and the strands in its lanes
  Block<Scalar> block;
  std::uint32_t region;
  std::size_t first;  // of `count` entries in Layout::strand_order
  int count;
};

// Which strands share a block, and the memory that the plan asks for.
template <class Scalar>
struct Layout {
  int width;
  std::vector<std::uint32_t> strand_order;
  std::vector<Placed<Scalar>> blocks;
  std::size_t longest = 0;  // vertices of the longest strand

  Layout(const Groom& groom, const Plan& plan, const SolverOptions& options);

  // Hands out memory from `base` on; returns how many numbers that takes. nullptr: only counts.
  std::size_t lay_out(const Plan& plan, Scalar* base);
};

// How far along a strand each vertex is, and the whole length [m].
struct ArcLength {
  std::vector<double> at;
  double total = 0;

  void measure(const Groom& groom, std::size_t strand) {
    const std::uint64_t begin = groom.offset[strand];
    at.assign(groom.vertex_count(strand), 0);
    for (std::size_t i = 1; i < at.size(); ++i) {
      at[i] = at[i - 1] + (groom.position[begin + i] - groom.position[begin + i - 1]).norm();
    }
    total = at.back();
  }
};

// Sorts strands into blocks of one region and nearly one length.
template <class Scalar>
Layout<Scalar>::Layout(const Groom& groom, const Plan& plan, const SolverOptions& options) {
  const LaneKernels& kernels = choose_kernels(options.lanes);
  width = sizeof(Scalar) == 4 ? kernels.width_float : kernels.width_double;
  const std::size_t strands = groom.strand_count();
  const auto region_of = [&](std::size_t strand) { return groom.region.empty() ? 0u : groom.region[strand]; };
  std::vector<std::uint8_t> extra_pins(strands, 0);
  for (std::size_t s = 0; s < strands; ++s) {
    if (groom.vertex_count(s) < 2) {
      throw std::invalid_argument("strand " + std::to_string(s) + " has fewer than two vertices");
    }
    if (region_of(s) >= plan.regions.size()) {
      throw std::invalid_argument("strand " + std::to_string(s) + " names a region that the plan does not have");
    }
    longest = std::max(longest, groom.vertex_count(s));
    if (!plan.regions[region_of(s)].simulated) {
      extra_pins[s] = options.skip.regions ? 0 : 1;
      continue;
    }
    for (std::uint64_t v = groom.offset[s] + 2; !groom.pinned.empty() && v < groom.offset[s + 1]; ++v) {
      if (groom.pinned[v]) extra_pins[s] = 1;
    }
  }
  strand_order.resize(strands);
  std::iota(strand_order.begin(), strand_order.end(), 0u);
  const std::vector<std::uint32_t> place = order_in_space(groom);
  const auto key = [&](std::uint32_t s) {
    return std::tuple(region_of(s), extra_pins[s], groom.vertex_count(s), place[s], s);
  };
  std::sort(strand_order.begin(), strand_order.end(),
            [&](std::uint32_t a, std::uint32_t b) { return key(a) < key(b); });

  const std::size_t w = static_cast<std::size_t>(width);
  for (std::size_t first = 0; first < strands;) {
    const std::uint32_t region = region_of(strand_order[first]);
    const std::uint8_t pins = extra_pins[strand_order[first]];
    std::size_t end = first;
    while (end < strands && end < first + w && region_of(strand_order[end]) == region &&
           extra_pins[strand_order[end]] == pins) {
      ++end;
    }
    const std::size_t shortest = groom.vertex_count(strand_order[first]);
    const std::size_t n = groom.vertex_count(strand_order[end - 1]);
    Placed<Scalar> placed{};
    placed.region = region;
    placed.first = first;
    placed.count = static_cast<int>(end - first);
    placed.block.vertices = static_cast<int>(n);
    placed.block.rides = options.skip.regions && !plan.regions[region].simulated;
    placed.block.masked = !placed.block.rides && (pins != 0 || shortest != n);
    blocks.push_back(placed);
    first = end;
  }
  // The range of the global shape: the longest reach of any lane.
  const auto block_count = static_cast<std::ptrdiff_t>(blocks.size());
#pragma omp parallel for num_threads(options.threads) schedule(dynamic, 64)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    Placed<Scalar>& placed = blocks[static_cast<std::size_t>(b)];
    const RegionPlan& region = plan.regions[placed.region];
    if (!region.global_shape || placed.block.rides) continue;
    placed.block.global_end = options.skip.range ? 0 : placed.block.vertices;
    ArcLength arc;
    for (int lane = 0; lane < placed.count && options.skip.range; ++lane) {
      arc.measure(groom, strand_order[placed.first + static_cast<std::size_t>(lane)]);
      for (std::size_t i = arc.at.size() - 1; i >= 1; --i) {
        if (arc.at[i] > region.global_range * arc.total) continue;
        placed.block.global_end = std::max(placed.block.global_end, static_cast<int>(i) + 1);
        break;
      }
    }
  }
}

template <class Scalar>
std::size_t Layout<Scalar>::lay_out(const Plan& plan, Scalar* base) {
  const std::size_t w = static_cast<std::size_t>(width);
  std::size_t used = 0;
  const auto take = [&](Scalar*& array, std::size_t count) {
    array = base == nullptr || count == 0 ? nullptr : base + used;
    used += count;
  };
  for (Placed<Scalar>& placed : blocks) {
    Block<Scalar>& b = placed.block;
    const RegionPlan& region = plan.regions[placed.region];
    const std::size_t n = static_cast<std::size_t>(b.vertices);
    take(b.position, 3 * n * w);
    if (b.rides) {
      b.previous = b.position;
      take(b.rest, 3 * n * w);
      b.rest_vertices = b.vertices;
      continue;
    }
    take(b.previous, 3 * n * w);
    const bool frames = region.local_shape && region.local_method != 3;
    const bool all_rest = b.masked || (region.local_shape && region.local_method == 3);
    b.rest_vertices = all_rest ? b.vertices : std::max(2, b.global_end);
    take(b.rest, 3 * static_cast<std::size_t>(b.rest_vertices) * w);
    take(b.root_frame, frames ? 6 * w : 0);
    take(b.local_edge, frames ? 3 * n * w : 0);
    take(b.remainder, frames ? 3 * n * w : 0);
    take(b.frame_x, frames && region.local_method == 2 ? 3 * n * w : 0);
    take(b.frame_y, frames && region.local_method == 2 ? 3 * n * w : 0);
    take(b.length, region.edge_lengths ? n * w : 0);
    take(b.fade, static_cast<std::size_t>(b.global_end) * w);
    take(b.free, b.masked ? n * w : 0);
    take(b.active, b.masked ? n * w : 0);
    take(b.wind_weight, region.wind ? 4 * w : 0);
  }
  return used;
}

void move_count(WorkCount& from, WorkCount& to) {
  to.substeps += from.substeps;
  to.substeps_at_rest += from.substeps_at_rest;
  to.spheres += from.spheres;
  to.spheres_out_of_reach += from.spheres_out_of_reach;
  from = {};
}

// What hair without velocity can tell apart.
template <class Scalar>
bool asks_the_same(const RegionStep<Scalar>& a, const RegionStep<Scalar>& b) {
  return std::equal(std::begin(a.gravity_h2), std::end(a.gravity_h2), b.gravity_h2) && a.drag_h2 == b.drag_h2 &&
         a.global_stiffness == b.global_stiffness && a.step_ratio2 == b.step_ratio2 &&
         a.half_local_stiffness == b.half_local_stiffness && a.local_iterations == b.local_iterations &&
         a.local_method == b.local_method && a.length_iterations == b.length_iterations;
}

// Whether no exponent of so many numbers is that of infinity and NaN.
template <class Scalar>
bool all_finite(const Scalar* numbers, std::size_t count) {
  using Bits = std::conditional_t<sizeof(Scalar) == 4, std::uint32_t, std::uint64_t>;
  constexpr Bits kExponent = std::bit_cast<Bits>(std::numeric_limits<Scalar>::infinity());
  Bits found = 0;
  // One more than a full exponent carries into the sign.
  for (std::size_t k = 0; k < count; ++k) {
    found |= (std::bit_cast<Bits>(numbers[k]) & kExponent) + (Bits{1} << (std::numeric_limits<Scalar>::digits - 1));
  }
  return found >> (8 * sizeof(Bits) - 1) == 0;
}

// Strands that are read together.
constexpr int kLanesAtOnce = 4;

// The first `count` vertices of four strands in neighbouring lanes, and + 0 as in read_block(). Writes one number
// beyond the last vertex, so that a vertex takes one store and not three.
void read_lanes(const float* rows, std::size_t width, float* const (&to)[kLanesAtOnce], std::size_t count) {
  typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
  const auto load = [](const float* p) { return *reinterpret_cast<const Four*>(p); };
  const auto store = [](float* p, Four v) { *reinterpret_cast<Four*>(p) = v; };
  float *a = to[0], *b = to[1], *c = to[2], *d = to[3];
  for (std::size_t i = 0; i < count; ++i, rows += 3 * width, a += 3, b += 3, c += 3, d += 3) {
    const Four x = load(rows) + 0.0f, y = load(rows + width) + 0.0f, z = load(rows + 2 * width) + 0.0f;
    const Four low = __builtin_shufflevector(x, y, 0, 4, 1, 5), high = __builtin_shufflevector(x, y, 2, 6, 3, 7);
    store(a, __builtin_shufflevector(low, z, 0, 1, 4, 4));
    store(b, __builtin_shufflevector(low, z, 2, 3, 5, 5));
    store(c, __builtin_shufflevector(high, z, 0, 1, 6, 6));
    store(d, __builtin_shufflevector(high, z, 2, 3, 7, 7));
  }
}

template <class Scalar>
class OpenMPSolver final : public Solver {
 public:
  OpenMPSolver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head, const SolverOptions& options);

  using Solver::advance;
  void advance(const FrameInput& input, std::span<Eigen::Vector3f> out, const Alongside& alongside) override;
  void read(std::span<Eigen::Vector3f> out) const override { read_as(out); }
  void read(std::span<Eigen::Vector3d> out) const override { read_as(out); }
  std::optional<NonFinite> find_non_finite() const override;
  std::size_t state_bytes() const override { return state_count_ * sizeof(Scalar); }
  WorkCount work() const override { return work_; }

 private:
  void fill(const Groom& groom, const HeadTransform<Scalar>& head, const Placed<Scalar>& placed) const;
  void check_against_plan(const FrameInput& input) const;
  RegionStep<Scalar> region_step(const RegionParams& params, const RegionPlan& plan, const FrameInput& input) const;
  void mark_repeats(std::vector<RegionStep<Scalar>>& regions, std::vector<Substep<Scalar>>& substeps);
  template <class Out>
  void read_as(std::span<Out> out) const;
  template <class Out>
  void read_block(const Placed<Scalar>& placed, const Scalar* now, std::span<Out> out) const;
  const Scalar* newest(const Placed<Scalar>& placed) const {
    return swapped_ ? placed.block.previous : placed.block.position;
  }

  std::size_t row_at(std::size_t vertex, int lane) const {
    return vertex * 3 * static_cast<std::size_t>(layout_.width) + static_cast<std::size_t>(lane);
  }
  void store(Scalar* array, std::size_t vertex, int lane, Vec3<Scalar> v) const {
    Scalar* row = array + row_at(vertex, lane);
    row[0] = v.x;
    row[layout_.width] = v.y;
    row[2 * layout_.width] = v.z;
  }
  void store(Scalar* array, std::size_t vertex, int lane, Scalar v) const {
    array[vertex * static_cast<std::size_t>(layout_.width) + static_cast<std::size_t>(lane)] = v;
  }

  Plan plan_;
  SolverOptions options_;
  AdvanceBlock<Scalar> advance_block_;
  std::vector<std::uint64_t> offset_;
  Layout<Scalar> layout_;
  std::size_t state_count_ = 0;
  LargeArray<Scalar> state_;
  LargeArray<Scalar> scratch_;                // of all threads
  std::vector<Workspace<Scalar>> workspace_;  // [threads]
  WorkCount work_;
  bool swapped_ = false;       // the newest positions stand in Block::previous
  bool all_finite_ = false;    // advance() has seen every position; false tells nothing
  double substep_before_ = 0;  // [s], 0 before the first frame
  // The last substep of the frame before and the regions in it: what they repeat, hair at rest need not go through.
  std::vector<RegionStep<Scalar>> regions_before_;
  Substep<Scalar> last_before_{};
  std::vector<Scalar> spheres_before_;
};

template <class Scalar>
OpenMPSolver<Scalar>::OpenMPSolver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                   const SolverOptions& options)
    : plan_(plan), options_(options), offset_(groom.offset), layout_(groom, plan, options) {
  const LaneKernels& kernels = choose_kernels(options.lanes);
  if constexpr (sizeof(Scalar) == 4) {
    advance_block_ = kernels.advance_float;
  } else {
    advance_block_ = kernels.advance_double;
  }
  state_count_ = layout_.lay_out(plan, nullptr);
  state_ = LargeArray<Scalar>(state_count_);
  layout_.lay_out(plan, state_.data());
  const HeadTransform<Scalar> start(head);
  const auto block_count = static_cast<std::ptrdiff_t>(layout_.blocks.size());
  FirstException failure;
#pragma omp parallel for num_threads(options.threads) schedule(dynamic, 8)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    failure.guard([&] { fill(groom, start, layout_.blocks[static_cast<std::size_t>(b)]); });
  }
  failure.rethrow();

  // A page or more apart, so that threads share no cache line.
  const std::size_t row = layout_.longest * static_cast<std::size_t>(layout_.width);
  const std::size_t per_thread = (10 * row + 1023) / 1024 * 1024;
  const auto threads = static_cast<std::size_t>(options.threads);
  scratch_ = LargeArray<Scalar>(threads * per_thread);
  workspace_.resize(threads);
  for (std::size_t t = 0; t < threads; ++t) {
    Scalar* const base = scratch_.data() + t * per_thread;
    workspace_[t].error = base;
    workspace_[t].edge = base + row;
    workspace_[t].frame_x = base + 4 * row;
    workspace_[t].frame_y = base + 7 * row;
    workspace_[t].skip_resting = options.skip.resting;
    workspace_[t].skip_colliders = options.skip.colliders;
  }
}

// Rest state of the strands of one block, in the solver's own arithmetic.
template <class Scalar>
void OpenMPSolver<Scalar>::fill(const Groom& groom, const HeadTransform<Scalar>& head,
                                const Placed<Scalar>& placed) const {
  const Block<Scalar>& b = placed.block;
  const RegionPlan& region = plan_.regions[placed.region];
  const std::size_t n = static_cast<std::size_t>(b.vertices);
  std::vector<Vec3<Scalar>> rest;
  ArcLength arc;
  for (int lane = 0; lane < layout_.width; ++lane) {
    // Lanes without a strand repeat the first.
    const std::size_t s = layout_.strand_order[placed.first + static_cast<std::size_t>(lane < placed.count ? lane : 0)];
    const std::size_t own = groom.vertex_count(s);
    rest.resize(own);
    for (std::size_t i = 0; i < own; ++i) rest[i] = to_vec3<Scalar>(groom.position[groom.offset[s] + i]);
    const auto rest_at = [&](std::size_t i) { return rest[std::min(i, own - 1)]; };

    for (std::size_t i = 0; i < n; ++i) {
      const Vec3<Scalar> start = head.apply(rest_at(i));
      store(b.position, i, lane, start);
      store(b.previous, i, lane, start);
    }
    for (std::size_t i = 0; i < static_cast<std::size_t>(b.rest_vertices); ++i) store(b.rest, i, lane, rest_at(i));
    if (b.local_edge != nullptr) {
      Frame<Scalar> frame = rest_root_frame<Scalar>(rest);
      store(b.root_frame, 0, lane, frame.x);
      store(b.root_frame, 1, lane, frame.y);
      for (std::size_t i = 1; i < n; ++i) {
        if (i >= 2 && i < own) {
          const Vec3<Scalar> edge = rest[i] - rest[i - 1];
          const Vec3<Scalar> local = into_frame(frame, edge);
          store(b.local_edge, i, lane, local);
          store(b.remainder, i, lane, edge - from_frame(frame, local));
          frame = turn_frame(frame, edge);
        }
        if (b.frame_x != nullptr) {
          store(b.frame_x, i, lane, head.turn(frame.x));
          store(b.frame_y, i, lane, head.turn(frame.y));
        }
      }
    }
    if (b.length != nullptr) {
      for (std::size_t i = 1; i < own; ++i) {
        const Vec3<Scalar> edge = rest[i] - rest[i - 1];
        store(b.length, i, lane, square_root(inner(edge, edge)));
      }
    }
    if (b.fade != nullptr) {
      arc.measure(groom, s);
      for (std::size_t i = 1; i < std::min(own, static_cast<std::size_t>(b.global_end)); ++i) {
        const double share = arc.total > 0 ? arc.at[i] / arc.total : 0;
        const bool reached = arc.at[i] <= region.global_range * arc.total;
        const double weight = reached ? 1 - region.global_fade * share / region.global_range : 0;
        store(b.fade, i, lane, static_cast<Scalar>(weight));
      }
    }
    if (b.masked) {
      for (std::size_t i = 0; i < n; ++i) {
        const bool pinned =
            i < 2 || i >= own || !region.simulated || (!groom.pinned.empty() && groom.pinned[groom.offset[s] + i] != 0);
        store(b.free, i, lane, static_cast<Scalar>(pinned ? 0 : 1));
        store(b.active, i, lane, static_cast<Scalar>(i < own ? 1 : 0));
      }
    }
    if (b.wind_weight != nullptr) {
      const auto weight = wind_weights(s);
      for (std::size_t j = 0; j < weight.size(); ++j) store(b.wind_weight, j, lane, static_cast<Scalar>(weight[j]));
    }
  }
}

template <class Scalar>
RegionStep<Scalar> OpenMPSolver<Scalar>::region_step(const RegionParams& params, const RegionPlan& plan,
                                                     const FrameInput& input) const {
  const double h = input.substep;
  RegionStep<Scalar> step{};
  // Rounded to float in both precisions: libraries differ in the last bits of pow, floats of it agree.
  const double keep = static_cast<float>(std::pow(1 - params.damping, h / kReferenceStep));
  step.keep = static_cast<Scalar>(keep);
  step.keep_first = static_cast<Scalar>(substep_before_ > 0 ? keep * (h / substep_before_) : keep);
  for (int axis = 0; axis < 3; ++axis) step.gravity_h2[axis] = static_cast<Scalar>(input.gravity[axis] * h * h);
  step.drag_h2 = static_cast<Scalar>(input.wind.empty() ? 0 : params.drag * h * h);
  const double ratio2 = (kReferenceStep / h) * (kReferenceStep / h);
  step.step_ratio2 = static_cast<Scalar>(ratio2);
  step.global_stiffness = static_cast<Scalar>(params.global.stiffness);
  step.half_local_stiffness = static_cast<Scalar>(0.5 * stiffness_at_step(params.local.stiffness, ratio2));
  const auto runs = [&](bool planned, Scalar amount) { return planned && (amount > 0 || !options_.skip.passes); };
  step.wind = runs(plan.wind, step.drag_h2);
  step.global_shape = runs(plan.global_shape, step.global_stiffness);
  step.local_shape = runs(plan.local_shape, step.half_local_stiffness);
  step.local_iterations = params.local.iterations;
  step.local_method = params.local.method;
  step.length_iterations = params.lengths.iterations;
  return step;
}

// What the plan left out has no memory to run on.
template <class Scalar>
void OpenMPSolver<Scalar>::check_against_plan(const FrameInput& input) const {
  const std::size_t count = input.substeps();
  bool fits = input.regions.size() == plan_.regions.size() &&
              (input.spheres.empty() || input.spheres.size() == count) &&
              (input.wind.empty() || input.wind.size() == count);
  for (std::size_t r = 0; fits && r < plan_.regions.size(); ++r) {
    const RegionParams& params = input.regions[r];
    const RegionPlan& planned = plan_.regions[r];
    fits = (planned.wind || input.wind.empty() || params.drag <= 0) &&
           (planned.edge_lengths || params.lengths.iterations <= 0) &&
           ((planned.local_shape && planned.local_method == params.local.method) || params.local.stiffness <= 0 ||
            params.local.iterations <= 0);
  }
  if (!fits) throw std::invalid_argument("the input of a frame asks for more than the plan has");
}

// Which substeps and regions ask for just what was asked before.
template <class Scalar>
void OpenMPSolver<Scalar>::mark_repeats(std::vector<RegionStep<Scalar>>& regions,
                                        std::vector<Substep<Scalar>>& substeps) {
  const auto same = [](const Substep<Scalar>& a, const Substep<Scalar>& b) {
    return std::equal(std::begin(a.rotation), std::end(a.rotation), b.rotation) &&
           std::equal(std::begin(a.translation), std::end(a.translation), b.translation) &&
           std::equal(std::begin(a.wind), std::end(a.wind), b.wind) && a.sphere_count == b.sphere_count &&
           std::equal(a.spheres, a.spheres + 4 * a.sphere_count, b.spheres);
  };
  const bool is_first = regions_before_.empty();
  const Substep<Scalar>* before = is_first ? nullptr : &last_before_;
  for (Substep<Scalar>& substep : substeps) {
    substep.repeats = before != nullptr && same(substep, *before);
    before = &substep;
  }
  for (std::size_t r = 0; r < regions.size(); ++r) {
    regions[r].repeats = !is_first && asks_the_same(regions[r], regions_before_[r]);
  }
  regions_before_ = regions;
  last_before_ = substeps.back();
  spheres_before_.assign(last_before_.spheres, last_before_.spheres + 4 * last_before_.sphere_count);
  last_before_.spheres = spheres_before_.data();
}

template <class Scalar>
void OpenMPSolver<Scalar>::advance(const FrameInput& input, std::span<Eigen::Vector3f> out,
                                   const Alongside& alongside) {
  check_against_plan(input);
  if (!out.empty() && out.size() != offset_.back()) {
    throw std::invalid_argument("positions are asked for in a place that does not hold one for each vertex");
  }
  std::vector<RegionStep<Scalar>> regions;
  for (const RegionParams& params : input.regions)
    regions.push_back(region_step(params, plan_.regions[regions.size()], input));

  const std::size_t count = input.substeps();
  std::vector<Substep<Scalar>> substeps(count);
  std::vector<Scalar> spheres;
  for (const auto& moment : input.spheres) {
    for (const Sphere& sphere : moment) {
      for (int axis = 0; axis < 3; ++axis) spheres.push_back(static_cast<Scalar>(sphere.center[axis]));
      spheres.push_back(static_cast<Scalar>(sphere.radius));
    }
  }
  std::size_t sphere_at = 0;
  for (std::size_t s = 0; s < count; ++s) {
    const HeadTransform<Scalar> head(input.head[s]);
    std::copy(std::begin(head.rotation), std::end(head.rotation), substeps[s].rotation);
    std::copy(std::begin(head.translation), std::end(head.translation), substeps[s].translation);
    for (int j = 0; !input.wind.empty() && j < 4; ++j) {
      for (int axis = 0; axis < 3; ++axis) {
        substeps[s].wind[3 * j + axis] = static_cast<Scalar>(input.wind[s][static_cast<std::size_t>(j)][axis]);
      }
    }
    substeps[s].sphere_count = input.spheres.empty() ? 0 : static_cast<int>(input.spheres[s].size());
    substeps[s].spheres = spheres.data() + sphere_at;
    sphere_at += 4 * static_cast<std::size_t>(substeps[s].sphere_count);
  }

  mark_repeats(regions, substeps);

  const bool ends_swapped = swapped_ != (count % 2 == 1);
  const auto block_count = static_cast<std::ptrdiff_t>(layout_.blocks.size());
  std::atomic<bool> finite = true;
  FirstException failure;
#pragma omp parallel num_threads(options_.threads)
  {
    if (alongside) failure.guard([&] { alongside(true); });
    Workspace<Scalar>& workspace = workspace_[static_cast<std::size_t>(omp_get_thread_num())];
#pragma omp for schedule(dynamic, 8) nowait
    for (std::ptrdiff_t b = 0; b < block_count; ++b) {
      Placed<Scalar>& placed = layout_.blocks[static_cast<std::size_t>(b)];
      Block<Scalar> block = placed.block;
      if (swapped_) std::swap(block.position, block.previous);
      advance_block_(block, regions[placed.region], substeps.data(), static_cast<int>(count), workspace);
      placed.block.at_rest = block.at_rest;
      const Scalar* const now = ends_swapped ? placed.block.previous : placed.block.position;
      if (!all_finite(now, row_at(static_cast<std::size_t>(block.vertices), 0))) {
        finite.store(false, std::memory_order_relaxed);
      }
      if (!out.empty()) read_block(placed, now, out);
    }
    if (alongside) failure.guard([&] { alongside(false); });
  }
  swapped_ = ends_swapped;
  all_finite_ = finite;
  substep_before_ = input.substep;
  for (Workspace<Scalar>& workspace : workspace_) move_count(workspace.work, work_);
  failure.rethrow();
}

template <class Scalar>
template <class Out>
void OpenMPSolver<Scalar>::read_as(std::span<Out> out) const {
  const auto block_count = static_cast<std::ptrdiff_t>(layout_.blocks.size());
#pragma omp parallel for num_threads(options_.threads) schedule(static)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    const Placed<Scalar>& placed = layout_.blocks[static_cast<std::size_t>(b)];
    read_block(placed, newest(placed), out);
  }
}

// Adding 0 makes -0 to 0: which of them it is may depend on what was skipped, and nothing else does.
template <class Scalar>
template <class Out>
void OpenMPSolver<Scalar>::read_block(const Placed<Scalar>& placed, const Scalar* now, std::span<Out> out) const {
  using Component = typename Out::Scalar;
  const auto width = static_cast<std::size_t>(layout_.width);
  for (int lane = 0; lane < placed.count; lane += kLanesAtOnce) {
    const int lanes = std::min(kLanesAtOnce, placed.count - lane);
    Component* to[kLanesAtOnce];
    std::size_t count[kLanesAtOnce];
    for (int k = 0; k < lanes; ++k) {
      const std::size_t strand = layout_.strand_order[placed.first + static_cast<std::size_t>(lane + k)];
      to[k] = out[offset_[strand]].data();
      count[k] = offset_[strand + 1] - offset_[strand];
    }
    std::size_t done = 0;
    if constexpr (sizeof(Scalar) == 4 && sizeof(Component) == 4) {
      if (lanes == kLanesAtOnce) {
        done = *std::min_element(std::begin(count), std::end(count)) - 1;
        read_lanes(now + lane, width, to, done);
      }
    }
    for (int k = 0; k < lanes; ++k) {
      for (std::size_t i = done; i < count[k]; ++i) {
        const Scalar* const row = now + row_at(i, lane + k);
        to[k][3 * i] = static_cast<Component>(row[0]) + 0;
        to[k][3 * i + 1] = static_cast<Component>(row[width]) + 0;
        to[k][3 * i + 2] = static_cast<Component>(row[2 * width]) + 0;
      }
    }
  }
}

template <class Scalar>
std::optional<NonFinite> OpenMPSolver<Scalar>::find_non_finite() const {
  std::optional<NonFinite> found;
  if (all_finite_) return found;
  for (const Placed<Scalar>& placed : layout_.blocks) {
    const Scalar* const now = newest(placed);
    // Padding may spoil a block whose strands are all well.
    if (all_finite(now, row_at(static_cast<std::size_t>(placed.block.vertices), 0))) continue;
    for (int lane = 0; lane < placed.count; ++lane) {
      const std::size_t strand = layout_.strand_order[placed.first + static_cast<std::size_t>(lane)];
      if (found && found->strand < strand) continue;
      // Free vertices first: a bad one spoils the pinned ones beside it.
      const std::size_t count = offset_[strand + 1] - offset_[strand];
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t i = (k + 2) % count;
        const Scalar* row = now + row_at(i, lane);
        if (!std::isfinite(row[0]) || !std::isfinite(row[layout_.width]) || !std::isfinite(row[2 * layout_.width])) {
          found = NonFinite{strand, i};
          break;
        }
      }
    }
  }
  return found;
}

}  // namespace

std::vector<int> available_lanes() {
  std::vector<int> widths;
  for (const LaneKernels* k : available_kernels()) widths.push_back(k->width_float);
  return widths;
}

std::unique_ptr<Solver> make_openmp_solver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                           const SolverOptions& options) {
  if (options.precision == Precision::Double) return std::make_unique<OpenMPSolver<double>>(groom, plan, head, options);
  return std::make_unique<OpenMPSolver<float>>(groom, plan, head, options);
}

std::size_t openmp_state_bytes(const Groom& groom, const Plan& plan, const SolverOptions& options) {
  if (options.precision == Precision::Double) {
    return Layout<double>(groom, plan, options).lay_out(plan, nullptr) * sizeof(double);
  }
  return Layout<float>(groom, plan, options).lay_out(plan, nullptr) * sizeof(float);
}

}  // namespace strandbake
