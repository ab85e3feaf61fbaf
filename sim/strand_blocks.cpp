#include "sim/strand_blocks.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <tuple>

#include "sim/gusts.h"
#include "sim/parallel.h"
#include "sim/passes/frame_scan.h"
#include "sim/passes/local_shape.h"
#include "sim/passes/rod_bend.h"
#include "sim/passes/stiffness.h"

namespace strandbake {
namespace {

constexpr double kReferenceStep = 1.0 / 60;  // h0 [s]

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

// The frames of a rest pose: in method 4 those of the scan, to the bit, else those of one walk.
template <class Scalar>
std::vector<Frame<Scalar>> rest_frames(std::span<const Vec3<Scalar>> rest, const Frame<Scalar>& root, int method) {
  std::vector<Frame<Scalar>> frames(rest.size(), root);
  if (method != 4) {
    for (std::size_t i = 2; i < rest.size(); ++i) frames[i] = turn_frame(frames[i - 1], rest[i] - rest[i - 1]);
    return frames;
  }
  std::vector<Twist<Scalar>> twist(rest.size());
  for (std::size_t i = 2; i < rest.size(); ++i) {
    frames[i] = frame_along(direction_or(rest[i] - rest[i - 1], root.x));
    twist[i] = twist_between(frames[i - 1], frames[i]);
  }
  for (std::size_t d = 1; d + 2 < rest.size(); d *= 2) {
    for (std::size_t i = rest.size() - 1; i >= 2 + d; --i) twist[i] = twist_product(twist[i], twist[i - d]);
  }
  for (std::size_t i = 2; i < rest.size(); ++i) frames[i] = twisted_frame(frames[i], twist[i]);
  return frames;
}

// kappa0 of each joint, by the vertex after it: that of the rest pose, and what bears the weight [m/s^2] there.
// A pinned vertex hangs on nothing.
template <class Scalar, class IsPinned>
std::vector<Vec3<Scalar>> rod_rest_curvature(std::span<const Vec3<Scalar>> rest, std::span<const Frame<Scalar>> frames,
                                             const RegionPlan& plan, Vec3<Scalar> weight, const IsPinned& is_pinned) {
  const std::size_t n = rest.size();
  std::vector<Vec3<Scalar>> curvature(n, Vec3<Scalar>{0, 0, 0});
  const auto length = [&](std::size_t i) {
    const Vec3<Scalar> edge = rest[i] - rest[i - 1];
    return square_root(inner(edge, edge));
  };
  const bool bears = inner(weight, weight) > 0;
  Vec3<Scalar> pull = {0, 0, 0}, couple = {0, 0, 0};  // on the near end of what hangs there
  for (std::size_t i = n - 1; i >= 2; --i) {
    const Scalar after = i + 1 < n ? length(i + 1) : 0;
    if (is_pinned(i)) {
      pull = couple = {0, 0, 0};
    } else {
      pull = pull + weight * (Scalar(0.5) * (length(i) + after));
    }
    couple = couple + outer(rest[i] - rest[i - 1], pull);
    const Vec3<Scalar> k = rod_curvature(frames[i - 1], frames[i]);
    const Scalar inverse = inverse_joint_length(length(i - 1), length(i));
    curvature[i] = k;
    if (bears && inverse > 0) {
      curvature[i] =
          curvature_that_bears(k, into_frame(frames[i - 1], couple), static_cast<Scalar>(plan.rod_bend) * inverse,
                               static_cast<Scalar>(plan.rod_twist) * inverse);
    }
  }
  return curvature;
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

// Near the middle of the groom, on a grid as coarse as the groom is large: so positions with few digits, as files have
// them, lose none when it is taken away and added again.
Eigen::Vector3d coarse_center(const Groom& groom) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : groom.position) box.extend(p);
  if (box.isEmpty()) return Eigen::Vector3d::Zero();
  int exponent = 0;
  std::frexp(box.diagonal().norm(), &exponent);
  const double grid = std::ldexp(1.0, exponent);
  return (box.center() / grid).array().round() * grid;
}

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

}  // namespace

// Sorts strands into blocks of one region and nearly one length.
template <class Scalar>
StrandBlocks<Scalar>::StrandBlocks(const Groom& groom, const Plan& plan, int strands_in_a_block, int threads,
                                   const Skip& skip)
    : width(strands_in_a_block) {
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
      extra_pins[s] = skip.regions ? 0 : 1;
      continue;
    }
    for (std::uint64_t v = groom.offset[s] + 2; !groom.pinned.empty() && v < groom.offset[s + 1]; ++v) {
      if (groom.pinned[v]) extra_pins[s] = 1;
    }
  }
  strand_order.resize(strands);
  std::iota(strand_order.begin(), strand_order.end(), 0u);
  center = coarse_center(groom);
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
    placed.block.rides = skip.regions && !plan.regions[region].simulated;
    placed.block.masked = !placed.block.rides && (pins != 0 || shortest != n);
    blocks.push_back(placed);
    first = end;
  }
  // The range of the global shape: the longest reach of any lane.
  const auto block_count = static_cast<std::ptrdiff_t>(blocks.size());
  const auto find_global_end = [&](Placed<Scalar>& placed) {
    const RegionPlan& region = plan.regions[placed.region];
    if (!region.global_shape || placed.block.rides) return;
    placed.block.global_end = skip.range ? 0 : placed.block.vertices;
    ArcLength arc;
    for (int lane = 0; lane < placed.count && skip.range; ++lane) {
      arc.measure(groom, strand_order[placed.first + static_cast<std::size_t>(lane)]);
      for (std::size_t i = arc.at.size() - 1; i >= 1; --i) {
        if (arc.at[i] > region.global_range * arc.total) continue;
        placed.block.global_end = std::max(placed.block.global_end, static_cast<int>(i) + 1);
        break;
      }
    }
  };
  FirstException failure;
#pragma omp parallel for num_threads(threads) schedule(dynamic, 64)
  for (std::ptrdiff_t b = 0; b < block_count; ++b) {
    failure.guard([&] { find_global_end(blocks[static_cast<std::size_t>(b)]); });
  }
  failure.rethrow();
}

template <class Scalar>
std::size_t StrandBlocks<Scalar>::lay_out(const Plan& plan, const std::vector<std::size_t>& scratch, Scalar* base) {
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
    const bool rod = region.rod;
    const bool all_rest = b.masked || (region.local_shape && region.local_method == 3);
    b.rest_vertices = all_rest ? b.vertices : std::max(2, b.global_end);
    take(b.rest, 3 * static_cast<std::size_t>(b.rest_vertices) * w);
    take(b.root_frame, frames || rod ? 6 * w : 0);
    take(b.local_edge, frames ? 3 * n * w : 0);
    take(b.remainder, frames ? 3 * n * w : 0);
    const bool reacts = frames && region.reacts;
    take(b.lever, reacts ? n * w : 0);
    const bool keeps_frames =
        rod || (frames && (region.local_method == 2 || (region.local_method == 4 && region.sag_free)));
    take(b.frame_x, keeps_frames ? 3 * n * w : 0);
    take(b.frame_y, keeps_frames ? 3 * n * w : 0);
    take(b.support, frames && region.sag_free ? 3 * n * w : 0);
    take(b.length, region.edge_lengths || plan.measured || reacts || rod ? n * w : 0);
    take(b.tension, region.direct_lengths ? n * w : 0);
    take(b.rest_curvature, rod ? 3 * n * w : 0);
    take(b.drawn, rod ? 3 * n * w : 0);
    take(b.handed_back, rod ? 3 * n * w : 0);
    take(b.pressed, rod ? n * w : 0);
    take(b.fade, static_cast<std::size_t>(b.global_end) * w);
    take(b.free, b.masked ? n * w : 0);
    take(b.active, b.masked ? n * w : 0);
    take(b.swept, b.masked && (region.direct_lengths || rod || plan.measured) ? n * w : 0);
    take(b.elimination, scratch.empty() ? 0 : scratch[placed.region] * (n - 2) * w);
    take(b.wind_weight, region.wind ? 4 * w : 0);
  }
  return used;
}

template <class Scalar>
void StrandBlocks<Scalar>::fill(const Groom& groom, const Plan& plan, const HeadTurn<Scalar>& head,
                                const Eigen::Vector3d& rest_weight, const Placed<Scalar>& placed) const {
  const auto w = static_cast<std::size_t>(width);
  const auto store = [&](Scalar* array, std::size_t vertex, int lane, Vec3<Scalar> v) {
    Scalar* const row = array + row_at(vertex, lane);
    row[0] = v.x;
    row[w] = v.y;
    row[2 * w] = v.z;
  };
  const auto store_number = [&](Scalar* array, std::size_t vertex, int lane, Scalar v) {
    array[vertex * w + static_cast<std::size_t>(lane)] = v;
  };
  const Block<Scalar>& b = placed.block;
  const RegionPlan& region = plan.regions[placed.region];
  const std::size_t n = static_cast<std::size_t>(b.vertices);
  std::vector<Vec3<Scalar>> rest;
  ArcLength arc;
  for (int lane = 0; lane < width; ++lane) {
    // Lanes without a strand repeat the first.
    const std::size_t s = strand_order[placed.first + static_cast<std::size_t>(lane < placed.count ? lane : 0)];
    const std::size_t own = groom.vertex_count(s);
    rest.resize(own);
    for (std::size_t i = 0; i < own; ++i) rest[i] = to_vec3<Scalar>(groom.position[groom.offset[s] + i] - center);
    const auto rest_at = [&](std::size_t i) { return rest[std::min(i, own - 1)]; };

    for (std::size_t i = 0; i < n; ++i) {
      const Vec3<Scalar> start = head.turn(rest_at(i));
      store(b.position, i, lane, start);
      store(b.previous, i, lane, start);
    }
    for (std::size_t i = 0; i < static_cast<std::size_t>(b.rest_vertices); ++i) store(b.rest, i, lane, rest_at(i));
    if (b.local_edge != nullptr) {
      const Frame<Scalar> root = rest_root_frame<Scalar>(rest);
      store(b.root_frame, 0, lane, root.x);
      store(b.root_frame, 1, lane, root.y);
      const std::vector<Frame<Scalar>> frames = rest_frames<Scalar>(rest, root, region.local_method);
      for (std::size_t i = 2; i < own; ++i) {
        const Vec3<Scalar> edge = rest[i] - rest[i - 1];
        const Vec3<Scalar> local = into_frame(frames[i - 1], edge);
        store(b.local_edge, i, lane, local);
        store(b.remainder, i, lane, edge - from_frame(frames[i - 1], local));
      }
      const Vec3<Scalar> weight = to_vec3<Scalar>(rest_weight);
      for (std::size_t i = 2; i < own && b.support != nullptr; ++i) {
        store(b.support, i, lane, into_frame(frames[i - 1], weight) * Scalar(-1));
      }
      for (std::size_t i = 1; i < n && b.frame_x != nullptr; ++i) {
        const Frame<Scalar>& frame = frames[std::min(i, own - 1)];
        store(b.frame_x, i, lane, head.turn(frame.x));
        store(b.frame_y, i, lane, head.turn(frame.y));
      }
    }
    const auto length = [&](std::size_t i) {
      const Vec3<Scalar> edge = rest[i] - rest[i - 1];
      return square_root(inner(edge, edge));
    };
    const auto is_pinned = [&](std::size_t i) {
      return i < 2 || !region.simulated || (!groom.pinned.empty() && groom.pinned[groom.offset[s] + i] != 0);
    };
    if (b.rest_curvature != nullptr) {
      const Frame<Scalar> root = rest_root_frame<Scalar>(rest);
      store(b.root_frame, 0, lane, root.x);
      store(b.root_frame, 1, lane, root.y);
      const std::vector<Frame<Scalar>> frames = rest_frames<Scalar>(rest, root, 1);
      Vec3<Scalar> at = head.turn(rest_at(1));
      for (std::size_t i = 1; i < n; ++i) {
        const Frame<Scalar>& frame = frames[std::min(i, own - 1)];
        const Vec3<Scalar> x = head.turn(frame.x);
        store(b.frame_x, i, lane, x);
        store(b.frame_y, i, lane, head.turn(frame.y));
        store(b.drawn, i, lane, {0, 0, 0});
        store(b.handed_back, i, lane, {0, 0, 0});
        store_number(b.pressed, i, lane, 0);
        if (i < 2 || i >= own) continue;
        // Where a step that changes nothing puts it, to the bit.
        at = at + x * length(i);
        if (is_pinned(i)) continue;
        store(b.position, i, lane, at);
        store(b.previous, i, lane, at);
      }
      const std::vector<Vec3<Scalar>> curvature = rod_rest_curvature<Scalar>(
          rest, frames, region, region.sag_free ? to_vec3<Scalar>(rest_weight) : Vec3<Scalar>{0, 0, 0}, is_pinned);
      for (std::size_t i = 2; i < own; ++i) store(b.rest_curvature, i, lane, curvature[i]);
    }
    if (b.length != nullptr) {
      for (std::size_t i = 1; i < own; ++i) {
        store_number(b.length, i, lane, length(i));
        if (b.tension != nullptr) store_number(b.tension, i, lane, 0);
      }
    }
    if (b.lever != nullptr) {
      for (std::size_t i = 2; i < own; ++i) {
        store_number(b.lever, i, lane, shape_lever(length(i - 1), length(i)));
      }
    }
    if (b.fade != nullptr) {
      arc.measure(groom, s);
      for (std::size_t i = 1; i < std::min(own, static_cast<std::size_t>(b.global_end)); ++i) {
        const double share = arc.total > 0 ? arc.at[i] / arc.total : 0;
        const bool reached = arc.at[i] <= region.global_range * arc.total;
        const double weight = reached ? 1 - region.global_fade * share / region.global_range : 0;
        store_number(b.fade, i, lane, static_cast<Scalar>(weight));
      }
    }
    if (b.masked) {
      for (std::size_t i = 0; i < n; ++i) {
        store_number(b.free, i, lane, static_cast<Scalar>(i >= own || is_pinned(i) ? 0 : 1));
        store_number(b.active, i, lane, static_cast<Scalar>(i < own ? 1 : 0));
      }
    }
    if (b.swept != nullptr) {
      bool pinned_after = false;
      for (std::size_t i = own; i-- > 2;) {
        pinned_after |= is_pinned(i);
        store_number(b.swept, i, lane, static_cast<Scalar>(pinned_after ? 0 : 1));
      }
    }
    if (b.wind_weight != nullptr) {
      const auto weight = wind_weights(s);
      for (std::size_t j = 0; j < weight.size(); ++j)
        store_number(b.wind_weight, j, lane, static_cast<Scalar>(weight[j]));
    }
  }
}

template <class Scalar>
RegionStep<Scalar> region_step(const RegionParams& params, const RegionPlan& plan, const Eigen::Vector3d& rest_weight,
                               const FrameInput& input, double substep_before, const Skip& skip) {
  const double h = input.substep;
  RegionStep<Scalar> step{};
  // Rounded to float in both precisions: libraries differ in the last bits of pow, floats of it agree.
  const double keep = static_cast<float>(std::pow(1 - params.damping, h / kReferenceStep));
  step.keep = static_cast<Scalar>(keep);
  const double longer = substep_before > 0 ? h / substep_before : 1;
  step.keep_first = static_cast<Scalar>(keep * longer);
  step.tension_first = static_cast<Scalar>(longer * longer);
  for (int axis = 0; axis < 3; ++axis) step.gravity_h2[axis] = static_cast<Scalar>(input.gravity[axis] * h * h);
  step.drag_h2 = static_cast<Scalar>(input.wind.empty() ? 0 : params.drag * h * h);
  const double ratio2 = (kReferenceStep / h) * (kReferenceStep / h);
  step.step_ratio2 = static_cast<Scalar>(ratio2);
  step.global_stiffness = static_cast<Scalar>(params.global.stiffness);
  step.local_stiffness = static_cast<Scalar>(stiffness_at_step(params.local.stiffness, ratio2));
  const auto runs = [&](bool planned, Scalar amount) { return planned && (amount > 0 || !skip.passes); };
  step.wind = runs(plan.wind, step.drag_h2);
  step.global_shape = runs(plan.global_shape, step.global_stiffness);
  step.local_shape = runs(plan.local_shape, step.local_stiffness) && params.local.iterations > 0;
  step.supported = plan.sag_free && step.local_shape && params.local.method != 3;
  for (int axis = 0; axis < 3; ++axis) {
    step.support_h2[axis] =
        static_cast<Scalar>(plan.sag_free && !plan.rod && !step.supported ? -rest_weight[axis] * h * h : 0);
  }
  step.h2 = static_cast<Scalar>(h * h);
  step.local_iterations = params.local.iterations;
  step.local_method = params.local.method;
  step.reacts = plan.reacts;
  step.direct_lengths = plan.direct_lengths;
  step.length_iterations = plan.direct_lengths || plan.rod ? 0 : params.lengths.iterations;
  step.rod = plan.rod;
  step.rod_bend_h2 = static_cast<Scalar>(plan.rod_bend * h * h);
  step.rod_twist_h2 = static_cast<Scalar>(plan.rod_twist * h * h);
  step.rod_stretch_h2 = static_cast<Scalar>(plan.rod_stretch * h * h);
  step.rod_iterations = params.rod.iterations;
  return step;
}

void check_against_plan(const Plan& plan, const FrameInput& input) {
  const std::size_t count = input.substeps();
  bool fits = input.regions.size() == plan.regions.size() && (input.spheres.empty() || input.spheres.size() == count) &&
              (input.wind.empty() || input.wind.size() == count);
  for (const auto& spheres : input.spheres) fits = fits && (plan.colliders || spheres.empty());
  for (std::size_t r = 0; fits && r < plan.regions.size(); ++r) {
    const RegionParams& params = input.regions[r];
    const RegionPlan& planned = plan.regions[r];
    fits = (planned.wind || input.wind.empty() || params.drag <= 0) && planned.rod == params.is_rod() &&
           (planned.rod || (planned.edge_lengths && planned.direct_lengths == params.lengths.direct) ||
            (!params.lengths.direct && params.lengths.iterations <= 0)) &&
           (planned.global_shape || params.global.stiffness <= 0 || params.global.range <= 0) &&
           (planned.rod ||
            (planned.local_shape && planned.local_method == params.local.method &&
             planned.reacts == (params.local.reaction && params.local.method != 3)) ||
            params.local.stiffness <= 0 || params.local.iterations <= 0);
    if (!planned.rod || !fits) continue;
    const RegionPlan again = plan_region(std::span(&params, 1), false);
    fits = planned.rod_bend == again.rod_bend && planned.rod_twist == again.rod_twist &&
           planned.rod_stretch == again.rod_stretch;
  }
  if (!fits) throw std::invalid_argument("the input of a frame asks for more than the plan has");
}

void check_measured(const Plan& plan) {
  if (!plan.measured) throw std::invalid_argument("figures are asked for, but the plan has nothing measured");
}

template <class Scalar>
void append_spheres(std::span<const Sphere> spheres, const Eigen::Vector3d& origin, std::vector<Scalar>& numbers) {
  for (const Sphere& sphere : spheres) {
    const Eigen::Vector3d center = sphere.center - origin;
    for (int axis = 0; axis < 3; ++axis) numbers.push_back(static_cast<Scalar>(center[axis]));
    numbers.push_back(static_cast<Scalar>(sphere.radius));
  }
}

template <class Scalar>
FrameSteps<Scalar> frame_steps(const FrameInput& input, Origin& origin) {
  FrameSteps<Scalar> steps;
  const std::size_t count = input.substeps();
  std::vector<Substep<Scalar>>& substeps = steps.substeps;
  substeps.resize(count);
  std::vector<Scalar>& spheres = steps.spheres;
  for (std::size_t s = 0; s < count; ++s) {
    const HeadTurn<Scalar> head(input.head[s]);
    std::copy(std::begin(head.rotation), std::end(head.rotation), substeps[s].rotation);
    const Eigen::Vector3d moved_before = origin.moved();
    origin.follow(input.head[s]);
    for (int axis = 0; axis < 3; ++axis) {
      substeps[s].moves[axis] = static_cast<Scalar>(origin.moved()[axis]);
      substeps[s].moved_before[axis] = static_cast<Scalar>(moved_before[axis]);
    }
    for (int j = 0; !input.wind.empty() && j < 4; ++j) {
      for (int axis = 0; axis < 3; ++axis) {
        substeps[s].wind[3 * j + axis] = static_cast<Scalar>(input.wind[s][static_cast<std::size_t>(j)][axis]);
      }
    }
    substeps[s].sphere_count = input.spheres.empty() ? 0 : static_cast<int>(input.spheres[s].size());
    if (!input.spheres.empty()) append_spheres<Scalar>(input.spheres[s], origin.now(), spheres);
  }
  std::size_t sphere_at = 0;
  for (Substep<Scalar>& substep : substeps) {
    substep.spheres = spheres.data() + sphere_at;
    sphere_at += 4 * static_cast<std::size_t>(substep.sphere_count);
  }
  return steps;
}

template struct StrandBlocks<float>;
template struct StrandBlocks<double>;
template RegionStep<float> region_step(const RegionParams&, const RegionPlan&, const Eigen::Vector3d&,
                                       const FrameInput&, double, const Skip&);
template RegionStep<double> region_step(const RegionParams&, const RegionPlan&, const Eigen::Vector3d&,
                                        const FrameInput&, double, const Skip&);
template void append_spheres(std::span<const Sphere>, const Eigen::Vector3d&, std::vector<float>&);
template void append_spheres(std::span<const Sphere>, const Eigen::Vector3d&, std::vector<double>&);
template FrameSteps<float> frame_steps(const FrameInput&, Origin&);
template FrameSteps<double> frame_steps(const FrameInput&, Origin&);

}  // namespace strandbake
