#include <omp.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <limits>
#include <new>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "sim/block.h"
#include "sim/large_array.h"
#include "sim/parallel.h"
#include "sim/plan.h"
#include "sim/solver.h"
#include "sim/solver_state.h"
#include "sim/strand_blocks.h"

namespace strandbake {
namespace {

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
StrandBlocks<Scalar> make_blocks(const Groom& groom, const Plan& plan, const SolverOptions& options) {
  const LaneKernels& kernels = choose_kernels(options.lanes);
  const int width = sizeof(Scalar) == 4 ? kernels.width_float : kernels.width_double;
  return StrandBlocks<Scalar>(groom, plan, width, options.threads, options.skip);
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
  return std::equal(std::begin(a.gravity_h2), std::end(a.gravity_h2), b.gravity_h2) &&
         std::equal(std::begin(a.support_h2), std::end(a.support_h2), b.support_h2) && a.supported == b.supported &&
         a.drag_h2 == b.drag_h2 && a.global_stiffness == b.global_stiffness && a.step_ratio2 == b.step_ratio2 &&
         a.local_stiffness == b.local_stiffness && a.local_iterations == b.local_iterations &&
         a.local_method == b.local_method && a.reacts == b.reacts && a.direct_lengths == b.direct_lengths &&
         a.length_iterations == b.length_iterations && a.rod_bend_h2 == b.rod_bend_h2 &&
         a.rod_iterations == b.rod_iterations;
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

// The first `count` vertices of four strands in neighbouring lanes, from `origin`. Writes one number
// beyond the last vertex, so that a vertex takes one store and not three.
void read_lanes(const float* rows, std::size_t width, const Eigen::Vector3d& origin, float* const (&to)[kLanesAtOnce],
                std::size_t count) {
  typedef float Four __attribute__((vector_size(16), aligned(4), may_alias));
  const auto load = [](const float* p) { return *reinterpret_cast<const Four*>(p); };
  const auto store = [](float* p, Four v) { *reinterpret_cast<Four*>(p) = v; };
  const auto [ox, oy, oz] = to_vec3<float>(origin);
  float *a = to[0], *b = to[1], *c = to[2], *d = to[3];
  for (std::size_t i = 0; i < count; ++i, rows += 3 * width, a += 3, b += 3, c += 3, d += 3) {
    const Four x = load(rows) + ox, y = load(rows + width) + oy, z = load(rows + 2 * width) + oz;
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
  void advance(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures,
               const Alongside& alongside) override;
  Figures measure_at_start(std::span<const Sphere> spheres) override;
  void read(std::span<Eigen::Vector3f> out) const override { read_as(out); }
  void read(std::span<Eigen::Vector3d> out) const override { read_as(out); }
  std::optional<NonFinite> find_non_finite() const override;
  void save(const Sink& out) const override { save_state(strands_, offset_, swapped_, origin_, substep_before_, out); }
  void load(const Source& in) override;
  std::size_t state_bytes() const override { return state_count_ * sizeof(Scalar); }
  WorkCount work() const override { return work_; }

 private:
  void mark_repeats(std::vector<RegionStep<Scalar>>& regions, std::vector<Substep<Scalar>>& substeps);
  Figures measured(const Placed<Scalar>& placed, const Scalar* now, const Scalar* spheres, int sphere_count) const;
  template <class Out>
  void read_as(std::span<Out> out) const;
  template <class Out>
  void read_block(const Placed<Scalar>& placed, const Scalar* now, std::span<Out> out) const;
  const Scalar* newest(const Placed<Scalar>& placed) const {
    return swapped_ ? placed.block.previous : placed.block.position;
  }

  Plan plan_;
  SolverOptions options_;
  AdvanceBlock<Scalar> advance_block_;
  std::vector<std::uint64_t> offset_;
  StrandBlocks<Scalar> strands_;
  Origin origin_;
  Eigen::Vector3d rest_weight_;  // gravity that sag-free hair is in balance with, in the rest frame [m/s^2]
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
    : plan_(plan),
      options_(options),
      offset_(groom.offset),
      strands_(make_blocks<Scalar>(groom, plan, options)),
      origin_(strands_.center, head),
      rest_weight_(head.linear().transpose() * plan.gravity_at_rest) {
  const LaneKernels& kernels = choose_kernels(options.lanes);
  if constexpr (sizeof(Scalar) == 4) {
    advance_block_ = kernels.advance_float;
  } else {
    advance_block_ = kernels.advance_double;
  }
  state_count_ = strands_.lay_out(plan, {}, nullptr);
  state_ = LargeArray<Scalar>(state_count_);
  strands_.lay_out(plan, {}, state_.data());
  const HeadTurn<Scalar> start(head);
  const auto block_count = static_cast<std::ptrdiff_t>(strands_.blocks.size());
  FirstException failure;
#pragma omp parallel for num_threads(options.threads) schedule(dynamic, 8)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    failure.guard(
        [&] { strands_.fill(groom, plan, start, rest_weight_, strands_.blocks[static_cast<std::size_t>(b)]); });
  }
  failure.rethrow();

  // A page or more apart, so that threads share no cache line.
  const std::size_t row = strands_.longest * static_cast<std::size_t>(strands_.width);
  const bool has_rods = std::ranges::any_of(plan.regions, &RegionPlan::rod);
  const std::size_t per_thread = ((has_rods ? 20 + kRodRow : 20) * row + 1023) / 1024 * 1024;
  const auto threads = static_cast<std::size_t>(options.threads);
  scratch_ = LargeArray<Scalar>(threads * per_thread);
  workspace_.resize(threads);
  for (std::size_t t = 0; t < threads; ++t) {
    Scalar* const base = scratch_.data() + t * per_thread;
    workspace_[t].error = base;
    workspace_[t].edge = base + row;
    workspace_[t].frame_x = base + 4 * row;
    workspace_[t].frame_y = base + 7 * row;
    workspace_[t].twist = base + 10 * row;
    workspace_[t].share = base + 12 * row;
    workspace_[t].old_frame_x = base + 13 * row;
    workspace_[t].old_frame_y = base + 16 * row;
    workspace_[t].old_tension = base + 19 * row;
    workspace_[t].rod = has_rods ? base + 20 * row : nullptr;
    workspace_[t].skip_resting = options.skip.resting;
    workspace_[t].skip_colliders = options.skip.colliders;
  }
}

// Which substeps and regions ask for just what was asked before.
template <class Scalar>
void OpenMPSolver<Scalar>::mark_repeats(std::vector<RegionStep<Scalar>>& regions,
                                        std::vector<Substep<Scalar>>& substeps) {
  const auto same = [](const Substep<Scalar>& a, const Substep<Scalar>& b) {
    return std::equal(std::begin(a.rotation), std::end(a.rotation), b.rotation) &&
           std::equal(std::begin(a.wind), std::end(a.wind), b.wind) && a.sphere_count == b.sphere_count &&
           std::equal(a.spheres, a.spheres + 4 * a.sphere_count, b.spheres);
  };
  const auto is_zero = [](const Scalar(&v)[3]) { return v[0] == 0 && v[1] == 0 && v[2] == 0; };
  const bool is_first = regions_before_.empty();
  const Substep<Scalar>* before = is_first ? nullptr : &last_before_;
  for (Substep<Scalar>& substep : substeps) {
    substep.repeats =
        before != nullptr && same(substep, *before) && is_zero(substep.moves) && is_zero(substep.moved_before);
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
void OpenMPSolver<Scalar>::advance(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures,
                                   const Alongside& alongside) {
  check_against_plan(plan_, input);
  if (figures != nullptr) check_measured(plan_);
  if (!out.empty() && out.size() != offset_.back()) {
    throw std::invalid_argument("positions are asked for in a place that does not hold one for each vertex");
  }
  std::vector<RegionStep<Scalar>> regions;
  for (const RegionParams& params : input.regions) {
    regions.push_back(region_step<Scalar>(params, plan_.regions[regions.size()], rest_weight_, input, substep_before_,
                                          options_.skip));
  }
  FrameSteps<Scalar> steps = frame_steps<Scalar>(input, origin_);
  std::vector<Substep<Scalar>>& substeps = steps.substeps;
  const std::size_t count = substeps.size();
  mark_repeats(regions, substeps);

  const bool ends_swapped = swapped_ != (count % 2 == 1);
  const auto block_count = static_cast<std::ptrdiff_t>(strands_.blocks.size());
  std::atomic<bool> finite = true;
  if (figures != nullptr) *figures = {};
  FirstException failure;
#pragma omp parallel num_threads(options_.threads)
  {
    if (alongside) failure.guard([&] { alongside(true); });
    Figures own;
    Workspace<Scalar>& workspace = workspace_[static_cast<std::size_t>(omp_get_thread_num())];
#pragma omp for schedule(dynamic, 8) nowait
    for (std::ptrdiff_t b = 0; b < block_count; ++b) {
      Placed<Scalar>& placed = strands_.blocks[static_cast<std::size_t>(b)];
      Block<Scalar> block = placed.block;
      if (swapped_) std::swap(block.position, block.previous);
      advance_block_(block, regions[placed.region], substeps.data(), static_cast<int>(count), workspace);
      placed.block.at_rest = block.at_rest;
      const Scalar* const now = ends_swapped ? placed.block.previous : placed.block.position;
      if (!all_finite(now, strands_.row_at(static_cast<std::size_t>(block.vertices), 0))) {
        finite.store(false, std::memory_order_relaxed);
      }
      if (!out.empty()) read_block(placed, now, out);
      if (figures != nullptr) own.include(measured(placed, now, substeps.back().spheres, substeps.back().sphere_count));
    }
    if (figures != nullptr) {
#pragma omp critical
      figures->include(own);
    }
    if (alongside) failure.guard([&] { alongside(false); });
  }
  swapped_ = ends_swapped;
  all_finite_ = finite && origin_.now().allFinite();
  substep_before_ = input.substep;
  for (Workspace<Scalar>& workspace : workspace_) move_count(workspace.work, work_);
  failure.rethrow();
}

template <class Scalar>
void OpenMPSolver<Scalar>::load(const Source& in) {
  substep_before_ = load_state(strands_, offset_, origin_, in);
  swapped_ = all_finite_ = false;
  regions_before_.clear();
}

template <class Scalar>
Figures OpenMPSolver<Scalar>::measured(const Placed<Scalar>& placed, const Scalar* now, const Scalar* spheres,
                                       int sphere_count) const {
  if (!plan_.regions[placed.region].simulated) return {};
  return measure_block(placed.block, now, strands_.width, spheres, sphere_count);
}

template <class Scalar>
Figures OpenMPSolver<Scalar>::measure_at_start(std::span<const Sphere> spheres) {
  check_measured(plan_);
  std::vector<Scalar> numbers;
  append_spheres<Scalar>(spheres, origin_.now(), numbers);
  Figures found;
  for (const Placed<Scalar>& placed : strands_.blocks) {
    found.include(measured(placed, newest(placed), numbers.data(), static_cast<int>(spheres.size())));
  }
  return found;
}

template <class Scalar>
template <class Out>
void OpenMPSolver<Scalar>::read_as(std::span<Out> out) const {
  const auto block_count = static_cast<std::ptrdiff_t>(strands_.blocks.size());
#pragma omp parallel for num_threads(options_.threads) schedule(static)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    const Placed<Scalar>& placed = strands_.blocks[static_cast<std::size_t>(b)];
    read_block(placed, newest(placed), out);
  }
}

template <class Scalar>
template <class Out>
void OpenMPSolver<Scalar>::read_block(const Placed<Scalar>& placed, const Scalar* now, std::span<Out> out) const {
  using Component = typename Out::Scalar;
  const auto width = static_cast<std::size_t>(strands_.width);
  const Eigen::Vector3d& origin = origin_.now();
  for (int lane = 0; lane < placed.count; lane += kLanesAtOnce) {
    const int lanes = std::min(kLanesAtOnce, placed.count - lane);
    Component* to[kLanesAtOnce];
    std::size_t count[kLanesAtOnce];
    for (int k = 0; k < lanes; ++k) {
      const std::size_t strand = strands_.strand_order[placed.first + static_cast<std::size_t>(lane + k)];
      to[k] = out[offset_[strand]].data();
      count[k] = offset_[strand + 1] - offset_[strand];
    }
    std::size_t done = 0;
    if constexpr (sizeof(Scalar) == 4 && sizeof(Component) == 4) {
      if (lanes == kLanesAtOnce) {
        done = *std::min_element(std::begin(count), std::end(count)) - 1;
        read_lanes(now + lane, width, origin, to, done);
      }
    }
    for (int k = 0; k < lanes; ++k) {
      for (std::size_t i = done; i < count[k]; ++i) {
        const Scalar* const row = now + strands_.row_at(i, lane + k);
        to[k][3 * i] = in_world<Component>(row[0], origin.x());
        to[k][3 * i + 1] = in_world<Component>(row[width], origin.y());
        to[k][3 * i + 2] = in_world<Component>(row[2 * width], origin.z());
      }
    }
  }
}

template <class Scalar>
std::optional<NonFinite> OpenMPSolver<Scalar>::find_non_finite() const {
  std::optional<NonFinite> found;
  if (all_finite_) return found;
  // Free vertices first: a bad one spoils the pinned ones beside it.
  if (!origin_.now().allFinite() && offset_.size() > 1)
    return NonFinite{0, 2 % static_cast<std::size_t>(offset_[1]), 0};
  for (const Placed<Scalar>& placed : strands_.blocks) {
    const Scalar* const now = newest(placed);
    // Padding may spoil a block whose strands are all well.
    if (all_finite(now, strands_.row_at(static_cast<std::size_t>(placed.block.vertices), 0))) continue;
    for (int lane = 0; lane < placed.count; ++lane) {
      const std::size_t strand = strands_.strand_order[placed.first + static_cast<std::size_t>(lane)];
      if (found && found->strand < strand) continue;
      const std::size_t count = offset_[strand + 1] - offset_[strand];
      for (std::size_t k = 0; k < count; ++k) {
        const std::size_t i = (k + 2) % count;
        const Scalar* row = now + strands_.row_at(i, lane);
        if (!std::isfinite(row[0]) || !std::isfinite(row[strands_.width]) || !std::isfinite(row[2 * strands_.width])) {
          found = NonFinite{strand, i, placed.block.masked ? static_cast<std::size_t>(placed.block.vertices) : 0};
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
    return make_blocks<double>(groom, plan, options).lay_out(plan, {}, nullptr) * sizeof(double);
  }
  return make_blocks<float>(groom, plan, options).lay_out(plan, {}, nullptr) * sizeof(float);
}

}  // namespace strandbake
