// Algorithm 1 of the paper on one block of strands. Included by the files lanes_*.cpp alone, once per instruction set.
#pragma once

#include "sim/block.h"
#include "sim/lanes.h"
#include "sim/passes/collide.h"
#include "sim/passes/edge_length.h"
#include "sim/passes/global_shape.h"
#include "sim/passes/integrate.h"
#include "sim/passes/local_shape.h"
#include "sim/passes/stiffness.h"
#include "sim/passes/strand_math.h"
#include "sim/passes/wind.h"

#define STRANDBAKE_INLINE inline __attribute__((always_inline))

namespace strandbake {
namespace {

// One block in one substep. Real is Lanes<Scalar, W>; Masked: see Block::masked.
template <class Real, bool Masked>
struct BlockStep {
  using Scalar = typename Real::Scalar;
  using Vec = Vec3<Real>;

  const Block<Scalar>& block;
  const RegionStep<Scalar>& region;
  const Substep<Scalar>& now;
  Vec* p;  // positions of the substep before, then Q of the next
  Vec* q;  // positions before that; the new ones are written over them
  Vec row_x, row_y, row_z, translation;

  static STRANDBAKE_INLINE Vec* vectors(Scalar* data) { return reinterpret_cast<Vec*>(data); }
  static STRANDBAKE_INLINE Real* reals(Scalar* data) { return reinterpret_cast<Real*>(data); }
  static STRANDBAKE_INLINE Vec broadcast(const Scalar* v) { return {Real(v[0]), Real(v[1]), Real(v[2])}; }

  STRANDBAKE_INLINE BlockStep(const Block<Scalar>& b, const RegionStep<Scalar>& r, const Substep<Scalar>& s,
                              Vec* current, Vec* previous)
      : block(b), region(r), now(s), p(current), q(previous) {
    row_x = broadcast(s.rotation);
    row_y = broadcast(s.rotation + 3);
    row_z = broadcast(s.rotation + 6);
    translation = broadcast(s.translation);
  }

  STRANDBAKE_INLINE Vec with_head(int i) const {
    return rotate(row_x, row_y, row_z, vectors(block.rest)[i]) + translation;
  }
  // 1 where a vertex may move.
  STRANDBAKE_INLINE Real free(int i) const {
    if constexpr (Masked) return reals(block.free)[i];
    return Real(i < 2 ? Scalar(0) : Scalar(1));
  }
  // Leaves a correction out where the segment that ends at vertex i is padding.
  STRANDBAKE_INLINE Vec where_active(Vec d, int i) const {
    if constexpr (Masked) return d * reals(block.active)[i];
    return d;
  }
  // p0 -= d and p1 += d, each only where it is free; vertex i is the far end.
  STRANDBAKE_INLINE void part(Vec& p0, Vec& p1, Vec d, int i) const {
    if constexpr (Masked) {
      p0 = p0 - d * free(i - 1);
      p1 = p1 + d * free(i);
    } else {
      if (i > 2) p0 = p0 - d;
      p1 = p1 + d;
    }
  }

  STRANDBAKE_INLINE FRAME root_frame() const {
    const Vec* rest = vectors(block.root_frame);
    return {rotate(row_x, row_y, row_z, rest[0]), rotate(row_x, row_y, row_z, rest[1])};
  }

  // Forces, integration and global shape: one walk, old positions in p, new ones over q.
  STRANDBAKE_INLINE void integrate_and_pull(Real keep) {
    const Vec gravity = broadcast(region.gravity_h2);
    const bool windy = region.drag_h2 > 0;
    Vec wind = {Real(0), Real(0), Real(0)};
    if (windy) {
      for (int j = 0; j < 4; ++j) {
        wind = wind + broadcast(now.wind + 3 * j) * (reals(block.wind_weight)[j] * Real(region.drag_h2));
      }
    }
    const int global_end = region.global_stiffness > 0 ? block.global_end : 0;
    q[0] = with_head(0);
    q[1] = with_head(1);
    for (int i = 2; i < block.vertices; ++i) {
      Vec accel_h2 = gravity;
      if (windy) accel_h2 = accel_h2 + wind_across(wind, p[i] - p[i - 1]);
      Vec moved = integrate(p[i], q[i], keep, accel_h2);
      if (i < global_end) {
        const Real stiffness =
            stiffness_at_step(Real(region.global_stiffness) * reals(block.fade)[i], Real(region.step_ratio2));
        moved = pull_to_goal(moved, with_head(i), stiffness);
      }
      if constexpr (Masked) {
        const auto is_free = reals(block.free)[i] > Real(Scalar(0));
        const Vec pinned = with_head(i);
        moved = {select(is_free, moved.x, pinned.x), select(is_free, moved.y, pinned.y),
                 select(is_free, moved.z, pinned.z)};
      }
      q[i] = moved;
    }
  }

  // Method 1 (Algorithm 3): each constraint is followed by the update of the next frame.
  STRANDBAKE_INLINE void local_shape_exact() {
    const Real half(region.half_local_stiffness);
    FRAME frame = root_frame();
    Vec near = q[1];
    for (int i = 2; i < block.vertices; ++i) {
      Vec far = q[i];
      const Vec d =
          local_shape_error(frame, vectors(block.local_edge)[i], vectors(block.remainder)[i], far - near) * half;
      part(near, far, where_active(d, i), i);
      q[i - 1] = near;
      frame = turn_frame(frame, far - near);
      near = far;
    }
    q[block.vertices - 1] = near;
  }

  // Method 2 (Algorithm 4): constraints in two batches with the frames of the last iteration, then new frames.
  STRANDBAKE_INLINE void local_shape_lagged() {
    const Real half(region.half_local_stiffness);
    Vec* const frame_x = vectors(block.frame_x);
    Vec* const frame_y = vectors(block.frame_y);
    const FRAME root = root_frame();
    frame_x[1] = root.x;
    frame_y[1] = root.y;
    for (int batch = 2; batch <= 3; ++batch) {
      for (int i = batch; i < block.vertices; i += 2) {
        const FRAME frame = {frame_x[i - 1], frame_y[i - 1]};
        const Vec d =
            local_shape_error(frame, vectors(block.local_edge)[i], vectors(block.remainder)[i], q[i] - q[i - 1]) * half;
        part(q[i - 1], q[i], where_active(d, i), i);
      }
    }
    // From the tip, so that each new frame still sees the old one before it.
    for (int i = block.vertices - 1; i >= 2; --i) {
      const FRAME frame = turn_frame(FRAME{frame_x[i - 1], frame_y[i - 1]}, q[i] - q[i - 1]);
      frame_x[i] = frame.x;
      frame_y[i] = frame.y;
    }
  }

  // Method 3 (Algorithm 5): rest frames turned with the head, so the goal of an edge is the rest edge turned with the
  // head.
  STRANDBAKE_INLINE void local_shape_rest() {
    const Real half(region.half_local_stiffness);
    const Vec* const rest = vectors(block.rest);
    for (int batch = 2; batch <= 3; ++batch) {
      for (int i = batch; i < block.vertices; i += 2) {
        const Vec goal = rotate(row_x, row_y, row_z, rest[i] - rest[i - 1]);
        const Vec d = (goal - (q[i] - q[i - 1])) * half;
        part(q[i - 1], q[i], where_active(d, i), i);
      }
    }
  }

  STRANDBAKE_INLINE void edge_lengths() {
    for (int batch = 2; batch <= 3; ++batch) {
      for (int i = batch; i < block.vertices; i += 2) {
        const Vec error = where_active(edge_length_error(q[i] - q[i - 1], reals(block.length)[i]), i);
        const Real w0 = free(i - 1), w1 = free(i);
        q[i - 1] = q[i - 1] + error * edge_share(w0, w1);
        q[i] = q[i] - error * edge_share(w1, w0);
      }
    }
  }

  STRANDBAKE_INLINE void collide() {
    for (int i = 2; i < block.vertices; ++i) {
      Vec at = q[i];
      for (int s = 0; s < now.sphere_count; ++s) {
        const Scalar* sphere = now.spheres + 4 * s;
        at = push_out_of_sphere(at, broadcast(sphere), Real(sphere[3]), free(i));
      }
      q[i] = at;
    }
  }

  STRANDBAKE_INLINE void run(bool first) {
    integrate_and_pull(Real(first ? region.keep_first : region.keep));
    if (region.half_local_stiffness > 0) {
      for (int iteration = 0; iteration < region.local_iterations; ++iteration) {
        switch (region.local_method) {
          case 1:
            local_shape_exact();
            break;
          case 2:
            local_shape_lagged();
            break;
          default:
            local_shape_rest();
            break;
        }
      }
    }
    for (int iteration = 0; iteration < region.length_iterations; ++iteration) edge_lengths();
    if (now.sphere_count > 0) collide();
  }
};

template <class Real, bool Masked>
STRANDBAKE_INLINE void run_substeps(const Block<typename Real::Scalar>& block,
                                    const RegionStep<typename Real::Scalar>& region,
                                    const Substep<typename Real::Scalar>* substeps, int substep_count) {
  auto* p = reinterpret_cast<Vec3<Real>*>(block.position);
  auto* q = reinterpret_cast<Vec3<Real>*>(block.previous);
  for (int s = 0; s < substep_count; ++s) {
    BlockStep<Real, Masked>(block, region, substeps[s], p, q).run(s == 0);
    auto* const swapped = p;
    p = q;
    q = swapped;
  }
}

template <class Real>
void advance_block(const Block<typename Real::Scalar>& block, const RegionStep<typename Real::Scalar>& region,
                   const Substep<typename Real::Scalar>* substeps, int substep_count) {
  if (block.masked) {
    run_substeps<Real, true>(block, region, substeps, substep_count);
  } else {
    run_substeps<Real, false>(block, region, substeps, substep_count);
  }
}

}  // namespace
}  // namespace strandbake
