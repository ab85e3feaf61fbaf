#include <algorithm>
#include <cmath>
#include <cstring>
#include <new>
#include <numeric>
#include <stdexcept>
#include <string>

#include "sim/block.h"
#include "sim/gusts.h"
#include "sim/passes/edge_length.h"
#include "sim/passes/local_shape.h"
#include "sim/passes/stiffness.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

constexpr double kReferenceStep = 1.0 / 60;  // h0 [s]
constexpr std::size_t kAlignment = 64;       // of every row of lanes: a cache line, and the widest register

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

struct AlignedDelete {
  void operator()(void* p) const { ::operator delete (p, std::align_val_t{kAlignment}); }
};
template <class Scalar>
using AlignedArray = std::unique_ptr<Scalar[], AlignedDelete>;
template <class Scalar>
AlignedArray<Scalar> make_aligned(std::size_t count) {
  auto* p = static_cast<Scalar*>(::operator new (count * sizeof(Scalar), std::align_val_t{kAlignment}));
  std::memset(p, 0, count * sizeof(Scalar));
  return AlignedArray<Scalar>(p);
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

template <class Scalar>
class OpenMPSolver final : public Solver {
 public:
  OpenMPSolver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head, const SolverOptions& options);

  void advance(const FrameInput& input) override;
  void read(std::span<Eigen::Vector3f> out) const override { read_as(out); }
  void read(std::span<Eigen::Vector3d> out) const override { read_as(out); }
  std::optional<NonFinite> find_non_finite() const override;
  std::size_t state_bytes() const override { return state_count_ * sizeof(Scalar); }

 private:
  struct Placed {  // a block and the strands in its lanes
    Block<Scalar> block;
    std::uint32_t region;
    std::size_t first;  // of `count` entries in strand_order_
    int count;
  };

  void arrange(const Groom& groom, const Plan& plan);
  void fill(const Groom& groom, const Plan& plan, const HeadTransform<Scalar>& head, const Placed& placed);
  void check_against_plan(const FrameInput& input) const;
  RegionStep<Scalar> region_step(const RegionParams& params, const FrameInput& input) const;
  template <class Out>
  void read_as(std::span<Out> out) const;

  Scalar* vector_row(Scalar* array, std::size_t vertex, int lane) const { return array + vertex * 3 * width_ + lane; }
  void store(Scalar* array, std::size_t vertex, int lane, Vec3<Scalar> v) const {
    Scalar* row = vector_row(array, vertex, lane);
    row[0] = v.x;
    row[width_] = v.y;
    row[2 * width_] = v.z;
  }

  Plan plan_;
  int width_;
  int threads_;
  AdvanceBlock<Scalar> advance_block_;
  std::vector<std::uint64_t> offset_;
  std::vector<std::uint32_t> strand_order_;
  std::vector<Placed> blocks_;
  AlignedArray<Scalar> state_;
  std::size_t state_count_ = 0;
  bool swapped_ = false;       // the newest positions stand in Block::previous
  double substep_before_ = 0;  // [s], 0 before the first frame
};

template <class Scalar>
OpenMPSolver<Scalar>::OpenMPSolver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                   const SolverOptions& options)
    : plan_(plan), threads_(options.threads), offset_(groom.offset) {
  const LaneKernels& kernels = choose_kernels(options.lanes);
  if constexpr (sizeof(Scalar) == 4) {
    width_ = kernels.width_float;
    advance_block_ = kernels.advance_float;
  } else {
    width_ = kernels.width_double;
    advance_block_ = kernels.advance_double;
  }
  arrange(groom, plan);
  const HeadTransform<Scalar> start(head);
  const auto block_count = static_cast<std::ptrdiff_t>(blocks_.size());
#pragma omp parallel for num_threads(threads_) schedule(dynamic, 8)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) fill(groom, plan, start, blocks_[static_cast<std::size_t>(b)]);
}

// Sorts strands into blocks of one region and nearly one length, and lays out the memory that the plan asks for.
template <class Scalar>
void OpenMPSolver<Scalar>::arrange(const Groom& groom, const Plan& plan) {
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
    for (std::uint64_t v = groom.offset[s] + 2; !groom.pinned.empty() && v < groom.offset[s + 1]; ++v) {
      if (groom.pinned[v]) extra_pins[s] = 1;
    }
  }
  strand_order_.resize(strands);
  std::iota(strand_order_.begin(), strand_order_.end(), 0u);
  const auto key = [&](std::uint32_t s) { return std::tuple(region_of(s), extra_pins[s], groom.vertex_count(s), s); };
  std::sort(strand_order_.begin(), strand_order_.end(),
            [&](std::uint32_t a, std::uint32_t b) { return key(a) < key(b); });

  const std::size_t w = static_cast<std::size_t>(width_);
  for (std::size_t first = 0; first < strands;) {
    const std::uint32_t region = region_of(strand_order_[first]);
    const std::uint8_t pins = extra_pins[strand_order_[first]];
    std::size_t end = first;
    while (end < strands && end < first + w && region_of(strand_order_[end]) == region &&
           extra_pins[strand_order_[end]] == pins) {
      ++end;
    }
    const std::size_t shortest = groom.vertex_count(strand_order_[first]);
    const std::size_t n = groom.vertex_count(strand_order_[end - 1]);
    Placed placed{};
    placed.region = region;
    placed.first = first;
    placed.count = static_cast<int>(end - first);
    placed.block.vertices = static_cast<int>(n);
    placed.block.masked = pins != 0 || shortest != n;
    if (plan.regions[region].global_shape) {
      // The longest reach of any lane, by arc length.
      for (int lane = 0; lane < placed.count; ++lane) {
        const std::size_t s = strand_order_[placed.first + static_cast<std::size_t>(lane)];
        double total = 0;
        for (std::uint64_t v = groom.offset[s] + 1; v < groom.offset[s + 1]; ++v) {
          total += (groom.position[v] - groom.position[v - 1]).norm();
        }
        double along = 0;
        for (std::uint64_t v = groom.offset[s] + 1; v < groom.offset[s + 1]; ++v) {
          along += (groom.position[v] - groom.position[v - 1]).norm();
          if (along <= plan.regions[region].global_range * total) {
            placed.block.global_end = std::max(placed.block.global_end, static_cast<int>(v - groom.offset[s]) + 1);
          }
        }
      }
    }
    blocks_.push_back(placed);
    first = end;
  }
  // Once to count, once more when the memory is there.
  const auto lay_out = [&](Scalar* base) {
    std::size_t used = 0;
    const auto take = [&](Scalar*& array, std::size_t count) {
      array = base == nullptr || count == 0 ? nullptr : base + used;
      used += count;
    };
    for (Placed& placed : blocks_) {
      Block<Scalar>& b = placed.block;
      const RegionPlan& region = plan.regions[placed.region];
      const std::size_t n = static_cast<std::size_t>(b.vertices);
      const bool frames = region.local_shape && region.local_method != 3;
      const bool all_rest = b.masked || (region.local_shape && region.local_method == 3);
      const std::size_t rest = all_rest ? n : std::max<std::size_t>(2, static_cast<std::size_t>(b.global_end));
      take(b.position, 3 * n * w);
      take(b.previous, 3 * n * w);
      take(b.rest, 3 * rest * w);
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
  };
  state_count_ = lay_out(nullptr);
  state_ = make_aligned<Scalar>(state_count_);
  lay_out(state_.get());
}

// Rest state of the strands of one block, in the solver's own arithmetic.
template <class Scalar>
void OpenMPSolver<Scalar>::fill(const Groom& groom, const Plan& plan, const HeadTransform<Scalar>& head,
                                const Placed& placed) {
  const Block<Scalar>& b = placed.block;
  const RegionPlan& region = plan.regions[placed.region];
  const std::size_t n = static_cast<std::size_t>(b.vertices);
  std::vector<Vec3<Scalar>> rest;
  for (int lane = 0; lane < width_; ++lane) {
    // Lanes without a strand repeat the first.
    const std::size_t s = strand_order_[placed.first + static_cast<std::size_t>(lane < placed.count ? lane : 0)];
    const std::size_t own = groom.vertex_count(s);
    rest.resize(own);
    for (std::size_t i = 0; i < own; ++i) rest[i] = to_vec3<Scalar>(groom.position[groom.offset[s] + i]);
    const auto rest_at = [&](std::size_t i) { return rest[std::min(i, own - 1)]; };

    for (std::size_t i = 0; i < n; ++i) {
      const Vec3<Scalar> start = head.apply(rest_at(i));
      store(b.position, i, lane, start);
      store(b.previous, i, lane, start);
    }
    const bool frames = b.local_edge != nullptr;
    const std::size_t rest_count = b.masked || (region.local_shape && !frames)
                                       ? n
                                       : std::max<std::size_t>(2, static_cast<std::size_t>(b.global_end));
    for (std::size_t i = 0; i < rest_count; ++i) store(b.rest, i, lane, rest_at(i));
    if (frames) {
      Frame<Scalar> frame = rest_root_frame<Scalar>(rest);
      store(b.root_frame, 0, lane, frame.x);
      store(b.root_frame, 1, lane, frame.y);
      for (std::size_t i = 1; i < own; ++i) {
        const Vec3<Scalar> edge = rest[i] - rest[i - 1];
        if (i >= 2) {
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
        b.length[i * static_cast<std::size_t>(width_) + static_cast<std::size_t>(lane)] =
            square_root(inner(edge, edge));
      }
    }
    if (b.fade != nullptr) {
      double total = 0;
      for (std::size_t i = 1; i < own; ++i) {
        total += (groom.position[groom.offset[s] + i] - groom.position[groom.offset[s] + i - 1]).norm();
      }
      double along = 0;
      for (std::size_t i = 1; i < std::min(own, static_cast<std::size_t>(b.global_end)); ++i) {
        along += (groom.position[groom.offset[s] + i] - groom.position[groom.offset[s] + i - 1]).norm();
        const double share = total > 0 ? along / total : 0;
        const double weight =
            along <= region.global_range * total ? 1 - region.global_fade * share / region.global_range : 0;
        b.fade[i * static_cast<std::size_t>(width_) + static_cast<std::size_t>(lane)] = static_cast<Scalar>(weight);
      }
    }
    if (b.masked) {
      for (std::size_t i = 0; i < n; ++i) {
        const bool pinned = i < 2 || i >= own || (!groom.pinned.empty() && groom.pinned[groom.offset[s] + i] != 0);
        const std::size_t at = i * static_cast<std::size_t>(width_) + static_cast<std::size_t>(lane);
        b.free[at] = static_cast<Scalar>(pinned ? 0 : 1);
        b.active[at] = static_cast<Scalar>(i < own ? 1 : 0);
      }
    }
    if (b.wind_weight != nullptr) {
      const auto weight = wind_weights(s);
      for (std::size_t j = 0; j < weight.size(); ++j) {
        b.wind_weight[j * static_cast<std::size_t>(width_) + static_cast<std::size_t>(lane)] =
            static_cast<Scalar>(weight[j]);
      }
    }
  }
}

template <class Scalar>
RegionStep<Scalar> OpenMPSolver<Scalar>::region_step(const RegionParams& params, const FrameInput& input) const {
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

template <class Scalar>
void OpenMPSolver<Scalar>::advance(const FrameInput& input) {
  check_against_plan(input);
  std::vector<RegionStep<Scalar>> regions;
  for (const RegionParams& params : input.regions) regions.push_back(region_step(params, input));

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

  const auto block_count = static_cast<std::ptrdiff_t>(blocks_.size());
#pragma omp parallel for num_threads(threads_) schedule(dynamic, 8)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    const Placed& placed = blocks_[static_cast<std::size_t>(b)];
    Block<Scalar> block = placed.block;
    if (swapped_) std::swap(block.position, block.previous);
    advance_block_(block, regions[placed.region], substeps.data(), static_cast<int>(count));
  }
  if (count % 2 == 1) swapped_ = !swapped_;
  substep_before_ = input.substep;
}

template <class Scalar>
template <class Out>
void OpenMPSolver<Scalar>::read_as(std::span<Out> out) const {
  const auto block_count = static_cast<std::ptrdiff_t>(blocks_.size());
#pragma omp parallel for num_threads(threads_) schedule(static)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    const Placed& placed = blocks_[static_cast<std::size_t>(b)];
    Scalar* const newest = swapped_ ? placed.block.previous : placed.block.position;
    for (int lane = 0; lane < placed.count; ++lane) {
      const std::size_t strand = strand_order_[placed.first + static_cast<std::size_t>(lane)];
      for (std::uint64_t v = offset_[strand]; v < offset_[strand + 1]; ++v) {
        const Scalar* row = vector_row(newest, v - offset_[strand], lane);
        using Component = typename Out::Scalar;
        out[v] = Out(static_cast<Component>(row[0]), static_cast<Component>(row[width_]),
                     static_cast<Component>(row[2 * width_]));
      }
    }
  }
}

template <class Scalar>
std::optional<NonFinite> OpenMPSolver<Scalar>::find_non_finite() const {
  std::optional<NonFinite> found;
  for (const Placed& placed : blocks_) {
    Scalar* const newest = swapped_ ? placed.block.previous : placed.block.position;
    for (int lane = 0; lane < placed.count; ++lane) {
      const std::size_t strand = strand_order_[placed.first + static_cast<std::size_t>(lane)];
      if (found && found->strand < strand) continue;
      // Free vertices first: a bad one spoils the pinned ones beside it.
      const std::size_t count = offset_[strand + 1] - offset_[strand];
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t i = (k + 2) % count;
        const Scalar* row = vector_row(newest, i, lane);
        // The sum of three numbers is not finite if one of them is not.
        if (!std::isfinite(row[0] + row[width_] + row[2 * width_])) {
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

}  // namespace strandbake
