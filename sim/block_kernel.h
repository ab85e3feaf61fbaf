// Algorithm 1 of the paper on one block of strands. Included by the files lanes_*.cpp alone, once per instruction set.
#pragma once

#include <type_traits>

#include "sim/block.h"
#include "sim/lanes.h"
#include "sim/pair.h"
#include "sim/passes/collide.h"
#include "sim/passes/direct_length.h"
#include "sim/passes/edge_length.h"
#include "sim/passes/frame_scan.h"
#include "sim/passes/global_shape.h"
#include "sim/passes/integrate.h"
#include "sim/passes/local_shape.h"
#include "sim/passes/stiffness.h"
#include "sim/passes/strand_math.h"
#include "sim/passes/support.h"
#include "sim/passes/wind.h"

#define STRANDBAKE_INLINE inline __attribute__((always_inline))

#include "sim/rod_block.h"

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
  Workspace<Scalar>& workspace;
  Vec* p;  // positions of the substep before, then Q of the next
  Vec* q;  // positions before that; the new ones are written over them
  Vec row_x, row_y, row_z;

  static STRANDBAKE_INLINE Vec* vectors(Scalar* data) { return reinterpret_cast<Vec*>(data); }
  static STRANDBAKE_INLINE Real* reals(Scalar* data) { return reinterpret_cast<Real*>(data); }
  static STRANDBAKE_INLINE Vec broadcast(const Scalar* v) { return {Real(v[0]), Real(v[1]), Real(v[2])}; }

  STRANDBAKE_INLINE BlockStep(const Block<Scalar>& b, const RegionStep<Scalar>& r, const Substep<Scalar>& s,
                              Workspace<Scalar>& w, Vec* current, Vec* previous)
      : block(b), region(r), now(s), workspace(w), p(current), q(previous) {
    row_x = broadcast(s.rotation);
    row_y = broadcast(s.rotation + 3);
    row_z = broadcast(s.rotation + 6);
  }

  STRANDBAKE_INLINE Vec with_head(int i) const { return rotate_by_rows(row_x, row_y, row_z, vectors(block.rest)[i]); }
  STRANDBAKE_INLINE FRAME root_frame() const {
    const Vec* rest = vectors(block.root_frame);
    return {rotate_by_rows(row_x, row_y, row_z, rest[0]), rotate_by_rows(row_x, row_y, row_z, rest[1])};
  }

  // A constraint between two vertices, with its corrections d_near and d_far for free ones. `First`: the near one is
  // vertex 1. In masked blocks weights say who is free, and leave out segments that are padding.
  template <bool First>
  STRANDBAKE_INLINE void part(Vec& near, Vec& far, Vec d, int i) const {
    if constexpr (Masked) {
      d = d * reals(block.active)[i];
      near = near - d * reals(block.free)[i - 1];
      far = far + d * reals(block.free)[i];
    } else {
      if constexpr (!First) near = near - d;
      far = far + d;
    }
  }

  // Applies a constraint to all even segments, then to all odd ones, in one walk: an odd segment follows the even ones
  // on both sides of it. constraint.template apply<First>(near, far, i).
  template <class Constraint>
  STRANDBAKE_INLINE void sweep(const Constraint& constraint) const {
    const int n = block.vertices;
    if (n < 3) return;
    Vec left = q[1];
    Vec right = q[2];
    constraint.template apply<true>(left, right, 2);
    q[1] = left;
    left = right;
    int i = 4;
    for (; i < n; i += 2) {
      Vec near = q[i - 1];
      right = q[i];
      constraint.template apply<false>(near, right, i);
      constraint.template apply<false>(left, near, i - 1);
      q[i - 2] = left;
      q[i - 1] = near;
      left = right;
    }
    if (i == n) {  // the last segment is odd
      right = q[n - 1];
      constraint.template apply<false>(left, right, n - 1);
      q[n - 1] = right;
    }
    q[i - 2] = left;
  }

  // The frame before vertex i, in positions of the substep before, given that before vertex i - 1.
  STRANDBAKE_INLINE FRAME frame_before(int i, FRAME last) const {
    if (region.local_method == 1) return i == 2 ? last : turn_frame(last, p[i - 1] - p[i - 2]);
    if (region.local_method == 4 && i == 2) return last;
    return {vectors(block.frame_x)[i - 1], vectors(block.frame_y)[i - 1]};
  }

  // Of the global shape, where it reaches.
  STRANDBAKE_INLINE Real goal_stiffness(int i) const {
    return stiffness_at_step(Real(region.global_stiffness) * reals(block.fade)[i], Real(region.step_ratio2));
  }

  // `frame`: before vertex begin - 1, then before end - 1; the root's to begin with.
  STRANDBAKE_INLINE void integrate_and_pull(int begin, int end, bool pulled, Real keep, bool windy, Vec wind,
                                            FRAME& frame) const {
    const Vec fall = broadcast(region.gravity_h2) +
                     shift_by_origin(broadcast(now.moves), broadcast(now.moved_before), keep) +
                     rotate_by_rows(row_x, row_y, row_z, broadcast(region.support_h2));
    for (int i = begin; i < end; ++i) {
      Vec accel_h2 = fall;
      if (windy) accel_h2 = accel_h2 + wind_across(wind, p[i] - p[i - 1]);
      if (region.supported) {
        frame = frame_before(i, frame);
        accel_h2 = accel_h2 + supported(frame, vectors(block.support)[i], Real(region.h2));
      }
      Vec moved = integrate(p[i], q[i], keep, accel_h2);
      if (pulled) {
        moved = pull_to_goal(moved, with_head(i), goal_stiffness(i));
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

  // Hair of a region that is not simulated.
  STRANDBAKE_INLINE void ride() const {
    for (int i = 0; i < block.vertices; ++i) q[i] = with_head(i);
  }

  // Forces, integration and global shape: old positions in p, new ones over q.
  STRANDBAKE_INLINE void integrate_and_pull(Real keep) const {
    const bool windy = region.wind;
    Vec wind = {Real(0), Real(0), Real(0)};
    if (windy) {
      for (int j = 0; j < 4; ++j) {
        wind = wind + broadcast(now.wind + 3 * j) * (reals(block.wind_weight)[j] * Real(region.drag_h2));
      }
    }
    q[0] = with_head(0);
    q[1] = with_head(1);
    const int global_end = region.global_shape && block.global_end > 2 ? block.global_end : 2;
    FRAME frame = {wind, wind};  // any, where nothing asks for it
    if (region.supported) frame = root_frame();
    integrate_and_pull(2, global_end, true, keep, windy, wind, frame);
    integrate_and_pull(global_end, block.vertices, false, keep, windy, wind, frame);
  }

  STRANDBAKE_INLINE Real half_stiffness() const { return Real(Scalar(0.5) * region.local_stiffness); }

  // Method 1 (Algorithm 3): each constraint is followed by the update of the next frame. The chain of operations is
  // serial and long, but an iteration can follow the one before it two vertices behind; so two of them walk down the
  // strand side by side.
  template <class R>
  struct Walk {
    Frame<R> frame;  // of the segment that ends at `near`
    Vec3<R> near;
  };
  template <class R>
  static STRANDBAKE_INLINE Vec3<Pair<Real, R>> both(Vec a, Vec3<R> b) {
    return {{a.x, b.x}, {a.y, b.y}, {a.z, b.z}};
  }
  template <class R>
  static STRANDBAKE_INLINE Vec ahead(Vec3<Pair<Real, R>> v) {
    return {v.x.first, v.y.first, v.z.first};
  }
  template <class R>
  static STRANDBAKE_INLINE Vec3<R> behind(Vec3<Pair<Real, R>> v) {
    return {v.x.second, v.y.second, v.z.second};
  }

  template <bool First>
  STRANDBAKE_INLINE void step(Walk<Real>& walk, int i, Real half) const {
    Vec far = q[i];
    const Vec d =
        local_shape_error(walk.frame, vectors(block.local_edge)[i], vectors(block.remainder)[i], far - walk.near) *
        half;
    part<First>(walk.near, far, d, i);
    q[i - 1] = walk.near;
    walk.frame = turn_frame(walk.frame, far - walk.near);
    walk.near = far;
  }
  STRANDBAKE_INLINE void step(Walk<Pair<Real>>& walk, int i, Real half) const {
    const Vec* const local_edge = vectors(block.local_edge);
    const Vec* const remainder = vectors(block.remainder);
    Vec3<Pair<Real>> far = both(q[i], q[i - 2]);
    Vec3<Pair<Real>> d = local_shape_error(walk.frame, both(local_edge[i], local_edge[i - 2]),
                                           both(remainder[i], remainder[i - 2]), far - walk.near) *
                         Pair<Real>(half, half);
    if constexpr (Masked) {
      const Real* const free = reals(block.free);
      d = d * Pair<Real>(reals(block.active)[i], reals(block.active)[i - 2]);
      walk.near = walk.near - d * Pair<Real>(free[i - 1], free[i - 3]);
      far = far + d * Pair<Real>(free[i], free[i - 2]);
    } else {
      walk.near = walk.near - d;
      far = far + d;
    }
    q[i - 1] = ahead(walk.near);
    q[i - 3] = behind(walk.near);
    walk.frame = turn_frame(walk.frame, far - walk.near);
    walk.near = far;
  }
  STRANDBAKE_INLINE void local_shape_exact() const {
    const Real half = half_stiffness();
    Walk<Real> walk = {root_frame(), q[1]};
    if (block.vertices > 2) step<true>(walk, 2, half);
    for (int i = 3; i < block.vertices; ++i) step<false>(walk, i, half);
    q[block.vertices - 1] = walk.near;
  }
  STRANDBAKE_INLINE void local_shape_exact_twice() const {  // needs five vertices
    const Real half = half_stiffness();
    const int n = block.vertices;
    Walk<Real> one = {root_frame(), q[1]};
    Walk<Real> two = one;
    step<true>(one, 2, half);
    step<false>(one, 3, half);
    step<false>(one, 4, half);
    step<true>(two, 2, half);
    Walk<Pair<Real>> together = {{both(one.frame.x, two.frame.x), both(one.frame.y, two.frame.y)},
                                 both(one.near, two.near)};
    for (int i = 5; i < n; ++i) step(together, i, half);
    q[n - 1] = ahead(together.near);
    two = {{behind(together.frame.x), behind(together.frame.y)}, behind(together.near)};
    step<false>(two, n - 2, half);
    step<false>(two, n - 1, half);
    q[n - 1] = two.near;
  }

  // With a reaction: how far constraints move, for all iterations of a substep.
  STRANDBAKE_INLINE void find_shape_shares() const {
    const Real* const lever = reals(block.lever);
    const Real* const length = reals(block.length);
    const Real stiffness(region.local_stiffness);
    for (int i = 2; i < block.vertices; ++i) {
      const Real near = Masked ? reals(block.free)[i - 1] : Real(Scalar(i > 2 ? 1 : 0));
      const Real before = Masked ? reals(block.free)[i - 2] : Real(Scalar(i > 3 ? 1 : 0));
      reals(workspace.share)[i] = shape_share(stiffness, shape_weight(lever[i] * length[i], near, before));
    }
  }

  // Row i of an array; as a pair rows i and i + gap, and so on.
  template <class R, class T>
  static STRANDBAKE_INLINE auto rows(const T* a, int i, int gap) {
    if constexpr (std::is_same_v<R, Real>) {
      return a[i];
    } else if constexpr (std::is_same_v<T, Real>) {
      return R(a[i], rows<typename R::Behind>(a, i + gap, gap));
    } else {
      return both(a[i], rows<typename R::Behind>(a, i + gap, gap));
    }
  }
  template <class R>
  static STRANDBAKE_INLINE void set_rows(Vec* a, int i, int gap, Vec3<R> v) {
    if constexpr (std::is_same_v<R, Real>) {
      a[i] = v;
    } else {
      a[i] = ahead(v);
      set_rows(a, i + gap, gap, behind(v));
    }
  }
  // v with the chain that is farthest behind taken from `other`.
  template <class R>
  static STRANDBAKE_INLINE Vec3<R> with_last_of(Vec3<R> v, Vec3<R> other) {
    if constexpr (std::is_same_v<R, Real>) {
      return other;
    } else {
      return both(ahead(v), with_last_of(behind(v), behind(other)));
    }
  }

  // The constraint at vertex i, or those at i and i + gap, with the reaction.
  template <class R>
  struct Bend {
    Vec3<R> before, near, far;
  };
  template <class R>
  STRANDBAKE_INLINE void react(const Frame<R>& frame, int i, int gap, Bend<R>& at) const {
    const Vec3<R> local = rows<R>(vectors(block.local_edge), i, gap);
    Vec3<R> move = local_shape_error(frame, local, rows<R>(vectors(block.remainder), i, gap), at.far - at.near) *
                   rows<R>(reals(workspace.share), i, gap);
    if constexpr (Masked) move = move * rows<R>(reals(block.active), i, gap);
    const Vec3<R> back = shape_reaction(frame, local, move, rows<R>(reals(block.lever), i, gap));
    if constexpr (Masked) {
      at.before = at.before - back * rows<R>(reals(block.free), i - 2, gap);
      at.near = at.near + (back - move) * rows<R>(reals(block.free), i - 1, gap);
      at.far = at.far + move * rows<R>(reals(block.free), i, gap);
    } else {
      at.before = at.before - back;
      at.near = at.near + (back - move);
      at.far = at.far + move;
    }
  }
  // Method 1 so. An iteration can follow the one before it three vertices behind, so three of them walk side by side.
  template <class R>
  struct ReactingWalk {
    Frame<R> frame;  // of the segment from `before` to `near`
    Vec3<R> before, near;
  };
  // `Last`: the vertex at which the last of them is, where it is one that follows a held one.
  template <int Last, class R>
  STRANDBAKE_INLINE void step(ReactingWalk<R>& walk, int i) const {
    Bend<R> at = {walk.before, walk.near, rows<R>(q, i, -3)};
    react(walk.frame, i, -3, at);
    if constexpr (!Masked && Last > 0) at.before = with_last_of(at.before, walk.before);
    if constexpr (!Masked && Last == 2) at.near = with_last_of(at.near, walk.near);
    set_rows(q, i - 2, -3, at.before);
    walk.frame = turn_frame(walk.frame, at.far - at.near);
    walk.before = at.near;
    walk.near = at.far;
  }
  // From vertex `begin`, where the last of them is at vertex 2.
  template <class R>
  STRANDBAKE_INLINE void start(ReactingWalk<R>& walk, int begin, int end) const {
    step<2>(walk, begin);
    step<3>(walk, begin + 1);
    for (int i = begin + 2; i < end; ++i) step<0>(walk, i);
  }
  template <class R>
  static STRANDBAKE_INLINE ReactingWalk<Pair<Real, R>> both(const ReactingWalk<Real>& a, const ReactingWalk<R>& b) {
    return {{both(a.frame.x, b.frame.x), both(a.frame.y, b.frame.y)}, both(a.before, b.before), both(a.near, b.near)};
  }
  template <class R>
  static STRANDBAKE_INLINE ReactingWalk<Real> ahead(const ReactingWalk<Pair<Real, R>>& walk) {
    return {{ahead(walk.frame.x), ahead(walk.frame.y)}, ahead(walk.before), ahead(walk.near)};
  }
  template <class R>
  static STRANDBAKE_INLINE ReactingWalk<R> behind(const ReactingWalk<Pair<Real, R>>& walk) {
    return {{behind(walk.frame.x), behind(walk.frame.y)}, behind(walk.before), behind(walk.near)};
  }
  // The first of them is at the tip; the others walk on.
  STRANDBAKE_INLINE void end(const ReactingWalk<Real>& walk) const {
    q[block.vertices - 2] = walk.before;
    q[block.vertices - 1] = walk.near;
  }
  template <class R>
  STRANDBAKE_INLINE void end(const ReactingWalk<Pair<Real, R>>& walk) const {
    end(ahead(walk));
    ReactingWalk<R> others = behind(walk);
    for (int i = block.vertices - 3; i < block.vertices; ++i) step<0>(others, i);
    end(others);
  }
  // As many iterations as there is room for on the strand, `most` at most. How many.
  STRANDBAKE_INLINE int reacting_shape_exact(int most) const {
    const int n = block.vertices;
    const ReactingWalk<Real> root = {root_frame(), q[0], q[1]};
    ReactingWalk<Real> one = root;
    if (n == 3) {
      step<2>(one, 2);
      end(one);
      return 1;
    }
    if (most == 1 || n < 7) {
      start(one, 2, n);
      end(one);
      return 1;
    }
    start(one, 2, 5);
    ReactingWalk<Pair<Real>> two = both(one, root);
    if (most == 2 || n < 10) {
      start(two, 5, n);
      end(two);
      return 2;
    }
    start(two, 5, 8);
    ReactingWalk<Pair<Real, Pair<Real>>> three = both(ahead(two), both(behind(two), root));
    start(three, 8, n);
    end(three);
    return 3;
  }

  // Frame(i, gap): before vertex i, or before vertices i and i + gap.
  template <class R, class FrameBefore>
  STRANDBAKE_INLINE void bend(const FrameBefore& frame, int i) const {
    Bend<R> at = {rows<R>(q, i - 2, 3), rows<R>(q, i - 1, 3), rows<R>(q, i, 3)};
    react(frame.template before<R>(i, 3), i, 3, at);
    set_rows(q, i - 2, 3, at.before);
    set_rows(q, i - 1, 3, at.near);
    set_rows(q, i, 3, at.far);
  }
  // The three batches; two constraints of one at a time.
  template <class FrameBefore>
  STRANDBAKE_INLINE void reacting_sweep(const FrameBefore& frame) const {
    const int n = block.vertices;
    const Vec root = q[0], second = q[1];
    for (int batch = 2; batch <= 4; ++batch) {
      int i = batch;
      for (; i + 3 < n; i += 6) bend<Pair<Real>>(frame, i);
      if (i < n) bend<Real>(frame, i);
      q[0] = root;  // which no constraint moves
      q[1] = second;
    }
  }

  struct LaggedFrames {
    const Vec *x, *y;
    template <class R>
    STRANDBAKE_INLINE Frame<R> before(int i, int gap) const {
      return {rows<R>(x, i - 1, gap), rows<R>(y, i - 1, gap)};
    }
  };

  // Method 2 (Algorithm 4): constraints in two batches, or three, with the frames of the last iteration, then new
  // frames.
  struct LaggedShape {
    const BlockStep& at;
    const Vec *frame_x, *frame_y, *local_edge, *remainder;
    Real half;
    template <bool First>
    STRANDBAKE_INLINE void apply(Vec& near, Vec& far, int i) const {
      const FRAME frame = {frame_x[i - 1], frame_y[i - 1]};
      at.template part<First>(near, far, local_shape_error(frame, local_edge[i], remainder[i], far - near) * half, i);
    }
  };
  STRANDBAKE_INLINE void local_shape_lagged() const {
    Vec* const frame_x = vectors(block.frame_x);
    Vec* const frame_y = vectors(block.frame_y);
    const FRAME root = root_frame();
    frame_x[1] = root.x;
    frame_y[1] = root.y;
    if (region.reacts) {
      reacting_sweep(LaggedFrames{frame_x, frame_y});
    } else {
      sweep(
          LaggedShape{*this, frame_x, frame_y, vectors(block.local_edge), vectors(block.remainder), half_stiffness()});
    }
    // From the tip, so that each new frame still sees the old one before it; two at a time, as in method 1.
    int i = block.vertices - 1;
    for (; i >= 3; i -= 2) {
      const Frame<Pair<Real>> old = {both(frame_x[i - 1], frame_x[i - 2]), both(frame_y[i - 1], frame_y[i - 2])};
      const Frame<Pair<Real>> frame = turn_frame(old, both(q[i], q[i - 1]) - both(q[i - 1], q[i - 2]));
      frame_x[i] = ahead(frame.x);
      frame_y[i] = ahead(frame.y);
      frame_x[i - 1] = behind(frame.x);
      frame_y[i - 1] = behind(frame.y);
    }
    if (i == 2) {
      const FRAME frame = turn_frame(root, q[2] - q[1]);
      frame_x[2] = frame.x;
      frame_y[2] = frame.y;
    }
  }

  // Method 3 (Algorithm 5): rest frames turned with the head, so the goal of an edge is the rest edge turned with the
  // head.
  struct RestShape {
    const BlockStep& at;
    const Vec* edge;
    Real half;
    template <bool First>
    STRANDBAKE_INLINE void apply(Vec& near, Vec& far, int i) const {
      at.template part<First>(near, far, (edge[i] - (far - near)) * half, i);
    }
  };
  STRANDBAKE_INLINE void turn_rest_edges() const {
    const Vec* const rest = vectors(block.rest);
    Vec* const edge = vectors(workspace.edge);
    for (int i = 2; i < block.vertices; ++i) edge[i] = rotate_by_rows(row_x, row_y, row_z, rest[i] - rest[i - 1]);
  }
  STRANDBAKE_INLINE void local_shape_rest() const {
    sweep(RestShape{*this, vectors(workspace.edge), half_stiffness()});
  }

  // Method 4: in each iteration the exact frames of the whole strand (passes/frame_scan.h), then constraints in
  // batches with them.
  struct ScannedShape {
    const BlockStep& at;
    FRAME root;
    const Vec *frame_x, *frame_y;
    const TWIST* twist;
    const Vec *local_edge, *remainder;
    Real half;
    STRANDBAKE_INLINE FRAME frame_before(int i) const {
      return twisted_frame({frame_x[i - 1], frame_y[i - 1]}, twist[i - 1]);
    }
    template <class R>
    STRANDBAKE_INLINE Frame<R> before(int i, int gap) const {
      if constexpr (std::is_same_v<R, Real>) {
        return i == 2 ? root : frame_before(i);
      } else {
        const FRAME one = before<Real>(i, gap), two = frame_before(i + gap);
        return {both(one.x, two.x), both(one.y, two.y)};
      }
    }
    template <bool First>
    STRANDBAKE_INLINE void apply(Vec& near, Vec& far, int i) const {
      FRAME frame = root;
      if constexpr (!First) frame = frame_before(i);
      at.template part<First>(near, far, local_shape_error(frame, local_edge[i], remainder[i], far - near) * half, i);
    }
  };
  // Frames along the edges that end at vertices 2 to n - 2, and how they are twisted against those that travel.
  STRANDBAKE_INLINE void scan_frames(FRAME root) const {
    const int n = block.vertices;
    Vec* const frame_x = vectors(workspace.frame_x);
    Vec* const frame_y = vectors(workspace.frame_y);
    TWIST* const twist = reinterpret_cast<TWIST*>(workspace.twist);
    // The first two rounds, d = 1 and 2, while what they need is in registers.
    FRAME before = root;
    TWIST start_before, once_before, once_before_that;
    for (int i = 2; i < n - 1; ++i) {
      const FRAME here = frame_along(direction_or(q[i] - q[i - 1], root.x));
      const TWIST start = twist_between(before, here);
      const TWIST once = i >= 3 ? twist_product(start, start_before) : start;
      twist[i] = i >= 4 ? twist_product(once, once_before_that) : once;
      frame_x[i] = here.x;
      frame_y[i] = here.y;
      before = here;
      start_before = start;
      once_before_that = once_before;
      once_before = once;
    }
    for (int d = 4; d < n - 3; d *= 2) {
      for (int i = n - 2; i >= 2 + d; --i) twist[i] = twist_product(twist[i], twist[i - d]);
    }
  }
  STRANDBAKE_INLINE void local_shape_scanned() const {
    const FRAME root = root_frame();
    scan_frames(root);
    const ScannedShape shape{*this,
                             root,
                             vectors(workspace.frame_x),
                             vectors(workspace.frame_y),
                             reinterpret_cast<const TWIST*>(workspace.twist),
                             vectors(block.local_edge),
                             vectors(block.remainder),
                             half_stiffness()};
    if (region.reacts) {
      reacting_sweep(shape);
    } else {
      sweep(shape);
    }
  }

  STRANDBAKE_INLINE void keep_scanned_frames() const {
    for (int i = 2; i < block.vertices - 1; ++i) {
      const FRAME frame = twisted_frame({vectors(workspace.frame_x)[i], vectors(workspace.frame_y)[i]},
                                        reinterpret_cast<const TWIST*>(workspace.twist)[i]);
      vectors(block.frame_x)[i] = frame.x;
      vectors(block.frame_y)[i] = frame.y;
    }
  }

  STRANDBAKE_INLINE void local_shape() const {
    const int iterations = region.local_iterations;
    int done = 0;
    if (region.reacts) find_shape_shares();
    switch (region.local_method) {
      case 1:
        if (region.reacts) {
          while (done < iterations && block.vertices > 2) done += reacting_shape_exact(iterations - done);
          break;
        }
        for (; iterations - done >= 2 && block.vertices >= 5; done += 2) local_shape_exact_twice();
        for (; done < iterations; ++done) local_shape_exact();
        break;
      case 2:
        for (; done < iterations; ++done) local_shape_lagged();
        break;
      case 4:
        for (; done < iterations; ++done) local_shape_scanned();
        if (block.frame_x != nullptr) keep_scanned_frames();
        break;
      default:
        turn_rest_edges();
        for (; done < iterations; ++done) local_shape_rest();
        break;
    }
  }

  // In each batch first all errors, whose divisions and square roots then overlap, then all corrections.
  STRANDBAKE_INLINE void edge_lengths() const {
    const int n = block.vertices;
    const Real* const length = reals(block.length);
    Real* const error = reals(workspace.error);
    for (int batch = 2; batch <= 3; ++batch) {
      for (int i = batch; i < n; i += 2) error[i] = relative_length_error(q[i] - q[i - 1], length[i]);
      int i = batch;
      if constexpr (!Masked) {
        if (i == 2 && n > 2) {
          q[2] = q[2] - (q[2] - q[1]) * error[2];
          i = 4;
        }
      }
      for (; i < n; i += 2) {
        const Vec edge = q[i] - q[i - 1];
        if constexpr (Masked) {
          const Real w0 = reals(block.free)[i - 1], w1 = reals(block.free)[i];
          const Real active_error = error[i] * reals(block.active)[i];
          q[i - 1] = q[i - 1] + edge * (active_error * edge_share(w0, w1));
          q[i] = q[i] - edge * (active_error * edge_share(w1, w0));
        } else {
          const Vec share = edge * (error[i] * Real(Scalar(0.5)));
          q[i - 1] = q[i - 1] + share;
          q[i] = q[i] - share;
        }
      }
    }
  }

  static STRANDBAKE_INLINE Real smaller(Real a, Real b) { return select(a < b, a, b); }
  static STRANDBAKE_INLINE Real larger(Real a, Real b) { return select(a > b, a, b); }

  // direct_length.h: hands back what tension will take, with `scale` as there. Leaves T / L in the place of T.
  STRANDBAKE_INLINE void return_tension(Real scale) const {
    const Real* const length = reals(block.length);
    Real* const tension = reals(block.tension);
    Vec moved = p[1] - q[1];
    Vec here = moved;  // of the segment before, from the second on
    for (int i = 2; i < block.vertices; ++i) {
      tension[i] = tension_ratio(tension[i], scale, length[i]);
      const Vec moved_far = p[i] - q[i];
      const Vec far = tension_return(tension[i], moved_far - moved);
      if (i > 2) q[i - 1] = q[i - 1] - (here - far);
      moved = moved_far;
      here = far;
    }
    const int tip = block.vertices - 1;
    if (tip >= 2) q[tip] = q[tip] - here;
  }

  // direct_length.h: lets the tension act. Finds T / L in the place of T and leaves a.
  STRANDBAKE_INLINE void apply_tension() const {
    const int n = block.vertices;
    if (n < 3) return;
    Real* const tension = reals(block.tension);
    Real* const share = reals(workspace.share);
    const Real one(Scalar(1));
    Real most(Scalar(0));
    for (int i = 2; i < n; ++i) {
      tension[i] = tension_pull(tension[i]);
      most = larger(tension[i], most);
    }
    if (!any(most > Real(Scalar(0)))) return;
    Vec done = q[1];
    Real ratio = one;
    for (int i = 2; i < n; ++i) {
      const Real above = tension[i];
      const Real below = i + 1 < n ? tension[i + 1] : Real(Scalar(0));
      const Real free = Masked ? reals(block.free)[i] : one;
      const Real pull = Masked ? above * free : above;
      const Real pull_below = Masked ? below * free : below;
      const Real held = pull * ratio;
      const Real inverse = tension_inverse(held, pull_below);
      share[i] = pull_below * inverse;
      ratio = (one + held) * inverse;
      done = (q[i] + done * pull) * inverse;
      q[i] = done;
    }
    for (int i = n - 2; i >= 2; --i) {
      done = q[i] + done * share[i];
      q[i] = done;
    }
  }

  // One round of direct_length.h.
  STRANDBAKE_INLINE void solve_lengths(bool first) const {
    const int n = block.vertices;
    const Real* const rest_length = reals(block.length);
    Vec* const direction = vectors(workspace.edge);
    Real* const share = reals(workspace.share);
    Real* const solved = reals(workspace.error);
    Real* const tension = reals(block.tension);
    Vec near = q[1];
    Vec before = near;  // no direction: its weight is 0
    Real inverse(Scalar(0)), solved_before(Scalar(0));
    for (int i = 2; i < n; ++i) {
      const Vec far = q[i];
      const Vec edge = far - near;
      const Real length = segment_length(edge);
      Vec u = segment_direction(edge, length);
      Real error = length_error(length, rest_length[i]);
      if (first) tension[i] = tension_borne(tension[i], length, rest_length[i]);
      Real diagonal = i == 2 ? Real(Scalar(1)) : Real(Scalar(2));
      if constexpr (Masked) {
        const Real active = reals(block.active)[i];
        u = u * active;
        error = error * active;
        diagonal = segment_diagonal(reals(block.free)[i - 1], reals(block.free)[i], active - reals(block.swept)[i]);
      }
      Real b(Scalar(0));
      if (Masked || i > 2) b = inner(before, u);
      if constexpr (Masked) b = b * reals(block.free)[i - 1];
      share[i] = b * inverse;
      inverse = inverse_pivot(diagonal, b, share[i]);
      solved_before = (error + b * solved_before) * inverse;
      solved[i] = solved_before;
      direction[i] = u;
      before = u;
      near = far;
    }
    Real lambda(Scalar(0));
    Vec pull = {lambda, lambda, lambda};  // of the segment after
    for (int i = n - 1; i >= 2; --i) {
      lambda = i == n - 1 ? solved[i] : solved[i] + share[i + 1] * lambda;
      tension[i] = tension[i] + lambda;
      const Vec own = direction[i] * lambda;
      Vec move = own - pull;
      if constexpr (Masked) move = move * reals(block.free)[i];
      q[i] = q[i] - move;
      pull = own;
    }
  }

  struct Box {
    Vec low, high;
    // NaN leaves the box as it is: it is never inside a sphere.
    STRANDBAKE_INLINE void add(Vec v) {
      low = {smaller(v.x, low.x), smaller(v.y, low.y), smaller(v.z, low.z)};
      high = {larger(v.x, high.x), larger(v.y, high.y), larger(v.z, high.z)};
    }
  };
  STRANDBAKE_INLINE bool reaches(int sphere, const Box& box) const {
    const Real radius(now.spheres[4 * sphere + 3]);
    return any(squared_distance_to_box(box.low, box.high, broadcast(now.spheres + 4 * sphere)) < radius * radius);
  }
  // Spheres act one after the other, each on all vertices. The box of what each lane's strand reaches tells which
  // spheres can touch nothing.
  STRANDBAKE_INLINE void collide() const {
    const int n = block.vertices;
    Box box = {q[n - 1], q[n - 1]};
    if (workspace.skip_colliders) {
      for (int i = 2; i < n - 1; ++i) box.add(q[i]);
    }
    workspace.work.spheres += now.sphere_count;
    for (int s = 0; s < now.sphere_count; ++s) {
      if (workspace.skip_colliders && !reaches(s, box)) {
        ++workspace.work.spheres_out_of_reach;
        continue;
      }
      const Vec center = broadcast(now.spheres + 4 * s);
      const Real radius(now.spheres[4 * s + 3]);
      for (int i = 2; i < n; ++i) {
        if (!any(squared_distance(q[i], center) < radius * radius)) continue;
        q[i] = push_out_of_sphere(q[i], center, radius, Masked ? reals(block.free)[i] : Real(Scalar(1)));
        box.add(q[i]);
      }
    }
  }

  STRANDBAKE_INLINE Vec where_swept(int i, Vec swept, Vec other) const {
    if constexpr (Masked) {
      const auto is_swept = reals(block.swept)[i] > Real(Scalar(0));
      return {select(is_swept, swept.x, other.x), select(is_swept, swept.y, other.y),
              select(is_swept, swept.z, other.z)};
    }
    return swept;
  }

  // One step of the walk that makes lengths exact: from `before` to vertex i, which the rounds have left at `far`.
  STRANDBAKE_INLINE Vec walk_to(int i, Vec before, Vec far, Vec& direction) const {
    direction = direction_or(far - before, direction);
    return where_swept(i, at_length(before, far, direction, reals(block.length)[i]), far);
  }

  // The whole walk; then, where a sphere may be in reach, once more with the spheres.
  STRANDBAKE_INLINE void sweep_lengths() const {
    const int n = block.vertices;
    const Real* const length = reals(block.length);
    Vec* const unswept = vectors(workspace.edge);
    const bool boxed = now.sphere_count > 0 && workspace.skip_colliders;
    const Vec none = {Real(Scalar(0)), Real(Scalar(0)), Real(Scalar(0))};
    const Vec pinned = direction_or(q[1] - q[0], none);
    Vec direction = pinned;
    Box box = {q[1], q[1]};
    for (int i = 2; i < n; ++i) {
      if (now.sphere_count > 0) unswept[i] = q[i];
      q[i] = walk_to(i, q[i - 1], q[i], direction);
      if (boxed) box.add(q[i]);
    }
    workspace.work.spheres += now.sphere_count;
    bool touched = now.sphere_count > 0 && !workspace.skip_colliders;
    for (int s = 0; s < now.sphere_count && !touched; ++s) touched = reaches(s, box);
    if (!touched) {
      workspace.work.spheres_out_of_reach += now.sphere_count;
      return;
    }
    direction = pinned;
    for (int i = 2; i < n; ++i) {
      Vec at = walk_to(i, q[i - 1], unswept[i], direction);
      for (int s = 0; s < now.sphere_count; ++s) {
        const Vec center = broadcast(now.spheres + 4 * s);
        const Real radius(now.spheres[4 * s + 3]);
        if (!any(squared_distance(at, center) < radius * radius)) continue;
        const Vec out = swing_out_of_sphere(at, q[i - 1], length[i], center, radius);
        if constexpr (Masked) {
          at = where_swept(i, out, push_out_of_sphere(at, center, radius, reals(block.free)[i]));
        } else {
          at = out;
        }
      }
      q[i] = at;
    }
  }

  STRANDBAKE_INLINE void run(bool first) const {
    if (region.rod) {
      const Real keep(first ? region.keep_first : region.keep);
      const RodStep<BlockStep, Real, Masked> rod{*this};
      rod.turn_on(p, keep);
      integrate_and_pull(keep);
      rod.run(p, drawn_scale(Real(first ? region.tension_first : Scalar(1))));
      return;
    }
    if (region.direct_lengths) return_tension(Real(first ? region.tension_first : Scalar(1)));
    integrate_and_pull(Real(first ? region.keep_first : region.keep));
    if (region.local_shape) local_shape();
    if (region.direct_lengths) {
      apply_tension();
      for (int round = 0; round < LENGTH_ROUNDS; ++round) solve_lengths(round == 0);
      sweep_lengths();
      return;
    }
    for (int iteration = 0; iteration < region.length_iterations; ++iteration) edge_lengths();
    if (now.sphere_count > 0) collide();
  }
};

// Are the first `vertices` vectors of both arrays the same bits? Asked of moving hair too, so it starts at the tip.
template <class Vec>
STRANDBAKE_INLINE bool same_bits(const Vec* a, const Vec* b, int vertices) {
  for (int i = vertices - 1; i >= 0; --i) {
    if (__builtin_memcmp(a + i, b + i, sizeof(Vec)) != 0) return false;
  }
  return true;
}

// Is nothing handed back to a rod?
template <class Real>
STRANDBAKE_INLINE bool all_zero(const Vec3<Real>* v, int vertices) {
  const Real zero(typename Real::Scalar(0));
  for (int i = vertices - 1; i >= 0; --i) {
    if (any(v[i].x > zero) || any(v[i].y > zero) || any(v[i].z > zero)) return false;
    if (any(v[i].x < zero) || any(v[i].y < zero) || any(v[i].z < zero)) return false;
  }
  return true;
}

template <class Real, bool Masked>
STRANDBAKE_INLINE void run_substeps(Block<typename Real::Scalar>& block,
                                    const RegionStep<typename Real::Scalar>& region,
                                    const Substep<typename Real::Scalar>* substeps, int substep_count,
                                    Workspace<typename Real::Scalar>& workspace) {
  using Vec = Vec3<Real>;
  using Step = BlockStep<Real, Masked>;
  auto* p = Step::vectors(block.position);
  auto* q = Step::vectors(block.previous);
  const int n = block.vertices;
  const bool has_frames = block.frame_x != nullptr;
  Vec* const frame_x = Step::vectors(block.frame_x);
  Vec* const frame_y = Step::vectors(block.frame_y);
  Real* const kept = Step::reals(block.tension != nullptr ? block.tension : block.pressed);
  const Vec* const handed_back = Step::vectors(block.handed_back);
  if (block.rides) {
    Step(block, region, substeps[substep_count - 1], workspace, p, q).ride();
    return;
  }
  workspace.work.substeps += substep_count;
  for (int s = 0; s < substep_count; ++s) {
    if (block.at_rest && substeps[s].repeats && (s > 0 || region.repeats)) {
      ++workspace.work.substeps_at_rest;  // p and q are the same bits
    } else {
      // A substep that finds no velocity and leaves everything as it was is a fixed point.
      bool rest = workspace.skip_resting && same_bits(p, q, n) && (handed_back == nullptr || all_zero(handed_back, n));
      if (rest && has_frames) {
        __builtin_memcpy(workspace.old_frame_x, frame_x, sizeof(Vec) * static_cast<unsigned long>(n));
        __builtin_memcpy(workspace.old_frame_y, frame_y, sizeof(Vec) * static_cast<unsigned long>(n));
      }
      if (rest && kept != nullptr) {
        __builtin_memcpy(workspace.old_tension, kept, sizeof(Real) * static_cast<unsigned long>(n));
      }
      Step(block, region, substeps[s], workspace, p, q).run(s == 0);
      rest = rest && same_bits(p, q, n);
      if (rest && has_frames) {
        rest = same_bits(frame_x, Step::vectors(workspace.old_frame_x), n) &&
               same_bits(frame_y, Step::vectors(workspace.old_frame_y), n);
      }
      if (rest && kept != nullptr) rest = same_bits(kept, Step::reals(workspace.old_tension), n);
      // What its rod draws is the same then in the next one, too.
      if (rest && handed_back != nullptr) rest = all_zero(handed_back, n);
      block.at_rest = rest;
    }
    auto* const swapped = p;
    p = q;
    q = swapped;
  }
}

template <class Real>
void advance_block(Block<typename Real::Scalar>& block, const RegionStep<typename Real::Scalar>& region,
                   const Substep<typename Real::Scalar>* substeps, int substep_count,
                   Workspace<typename Real::Scalar>& workspace) {
  if (block.masked) {
    run_substeps<Real, true>(block, region, substeps, substep_count, workspace);
  } else {
    run_substeps<Real, false>(block, region, substeps, substep_count, workspace);
  }
}

}  // namespace
}  // namespace strandbake
