// The rod (passes/rod_link.h) on one block of strands. Included by block_kernel.h alone.
#pragma once

#include "sim/block.h"
#include "sim/passes/collide.h"
#include "sim/passes/direct_length.h"
#include "sim/passes/rod_contact.h"
#include "sim/passes/rod_link.h"
#include "sim/passes/rod_return.h"

namespace strandbake {
namespace {

// A row of Workspace::rod.
template <class Real>
struct RodRow {
  JOINT_GAIN joint;
  STRETCH_GAIN stretch;  // where lengths are not exact
};

// Step: BlockStep. Where vertices would go on their own stands in q, and so does where they go in the end.
template <class Step, class Real, bool Masked>
struct RodStep {
  using Scalar = typename Real::Scalar;
  using Vec = Vec3<Real>;

  const Step& at;
  Vec* const q = at.q;
  Vec* const x = Step::vectors(at.workspace.edge);       // positions in the iteration
  Real* const weight = Step::reals(at.workspace.share);  // of vertices [m]
  Real* const length = Step::reals(at.workspace.error);  // of edges, now
  Real* const pressed = Step::reals(at.block.pressed);   // 1 where a sphere has pushed in the last iteration
  RodRow<Real>* const rows = reinterpret_cast<RodRow<Real>*>(at.workspace.rod);
  Vec* const frame_x = Step::vectors(at.block.frame_x);
  Vec* const frame_y = Step::vectors(at.block.frame_y);
  const int n = at.block.vertices;
  static_assert(sizeof(RodRow<Real>) == kRodRow * sizeof(Real));

  static STRANDBAKE_INLINE Vec chosen(typename Real::Mask m, Vec a, Vec b) {
    return {select(m, a.x, b.x), select(m, a.y, b.y), select(m, a.z, b.z)};
  }
  STRANDBAKE_INLINE FRAME frame(int i) const { return {frame_x[i], frame_y[i]}; }

  // Before vertices go on their own: q is still where they were a substep ago, and then from where they go on. Edges
  // between pinned vertices go with the root, see begin().
  STRANDBAKE_INLINE void turn_on(const Vec* p, Real keep) const {
    for (int i = 2; i < n; ++i) {
      const FRAME old = frame(i);
      const FRAME on = turned_frame(old, edge_turn(q[i] - q[i - 1], p[i] - p[i - 1]) * keep);
      frame_x[i] = at.where_swept(i, on.x, old.x);
      frame_y[i] = at.where_swept(i, on.y, old.y);
    }
    const Vec* const handed_back = Step::vectors(at.block.handed_back);
    for (int i = 2; i < n; ++i) q[i] = q[i] + handed_back[i];
  }

  // `p`: where vertices were. The root is where it is now, and edges between pinned vertices turn with it.
  STRANDBAKE_INLINE void begin(const Vec* p) const {
    const Real* const rest_length = Step::reals(at.block.length);
    const FRAME root_before = frame(1);
    const FRAME root = at.root_frame();
    frame_x[1] = root.x;
    frame_y[1] = root.y;
    const int pulled = at.region.global_shape ? at.block.global_end : 0;
    Vec end = q[1];
    for (int i = 2; i < n; ++i) {
      if constexpr (Masked) {
        const FRAME carried = carried_along(root_before, root, frame(i));
        frame_x[i] = at.where_swept(i, frame_x[i], carried.x);
        frame_y[i] = at.where_swept(i, frame_y[i], carried.y);
      }
      length[i] = rest_length[i];
      if (at.region.rod_stretch_h2 > 0) length[i] = segment_length(p[i] - p[i - 1]);
      end = end + frame_x[i] * length[i];
      x[i] = end;
      const Real after = i + 1 < n ? rest_length[i + 1] : Real(Scalar(0));
      Real share(Scalar(1));
      if (i < pulled) share = held_share(at.goal_stiffness(i));
      if constexpr (Masked) share = select(Step::reals(at.block.free)[i] > Real(Scalar(0)), share, Real(PINNED_SHARE));
      weight[i] = (rest_length[i] + after) * (Real(Scalar(0.5)) * share);
    }
  }

  // Whether a sphere may touch a vertex that is where `v` has it, or nearly so.
  STRANDBAKE_INLINE bool may_touch(const Vec* v, Real margin) const {
    if (at.now.sphere_count == 0) return false;
    if (!at.workspace.skip_colliders) return true;
    typename Step::Box box = {v[2], v[2]};
    Real longest = length[2];
    for (int i = 3; i < n; ++i) {
      box.add(v[i]);
      longest = Step::larger(length[i], longest);
    }
    for (int s = 0; s < at.now.sphere_count; ++s) {
      const Real near = touching_radius(Real(at.now.spheres[4 * s + 3]), longest, margin);
      if (any(squared_distance_to_box(box.low, box.high, Step::broadcast(at.now.spheres + 4 * s)) < near * near))
        return true;
    }
    return false;
  }

  // Strands with a free vertex in a sphere, 1 or 0.
  STRANDBAKE_INLINE Real inside() const {
    const Real zero(Scalar(0)), one(Scalar(1));
    Real found = zero;
    if (!may_touch(x, TOUCH_MARGIN)) return found;
    for (int s = 0; s < at.now.sphere_count; ++s) {
      const Vec center = Step::broadcast(at.now.spheres + 4 * s);
      const Real inner = missed_radius(Real(at.now.spheres[4 * s + 3]), Real(at.region.h2));
      for (int i = 2; i < n; ++i) {
        Real weight_inside = select(squared_distance(x[i], center) < inner * inner, one, zero);
        if constexpr (Masked) weight_inside = weight_inside * Step::reals(at.block.free)[i];
        found = Step::larger(weight_inside, found);
      }
    }
    return found;
  }

  // Vertices that count as touching the sphere, at x. `edge`: the length of that before it.
  STRANDBAKE_INLINE typename Real::Mask touches(int i, Vec center, Real radius, Real edge) const {
    const Real zero(Scalar(0)), one(Scalar(1));
    const Real distance2 = squared_distance(x[i], center);
    const Real near = touching_radius(radius, edge, TOUCH_MARGIN), inner = missed_radius(radius, Real(at.region.h2));
    Real counts = select(distance2 < near * near, pressed[i], zero);
    counts = select(distance2 < inner * inner, one, counts);
    if constexpr (Masked) counts = counts * Step::reals(at.block.free)[i];
    return counts > zero;
  }

  // Strands, 1 or 0: that a sphere touches, and that it has let go of somewhere.
  struct Contacts {
    Real touched, released;
  };

  // `counts`: strands that take part, 1 or 0; nullptr: all.
  STRANDBAKE_INLINE Contacts iterate(const Real* counts) const {
    const Real* const rest_length = Step::reals(at.block.length);
    const Vec* const rest_curvature = Step::vectors(at.block.rest_curvature);
    const Real bend(at.region.rod_bend_h2), twist(at.region.rod_twist_h2), stretch(at.region.rod_stretch_h2);
    const bool stretches = at.region.rod_stretch_h2 > 0;
    const int contacts = may_touch(x, TOUCH_MARGIN) ? at.now.sphere_count : 0;
    const Real zero(Scalar(0)), one(Scalar(1));
    Contacts found = {zero, zero};
    LINK link = no_link(zero);
    FRAME here = frame(n - 1);
    for (int i = n - 1; i >= 2; --i) {
      const FRAME before = frame(i - 1);
      const Vec edge = here.x * length[i];
      for (int s = 0; s < contacts; ++s) {
        const Vec center = Step::broadcast(at.now.spheres + 4 * s);
        const Real radius(at.now.spheres[4 * s + 3]);
        const auto does = touches(i, center, radius, length[i]);
        if (!any(does)) continue;
        const Real mass = select(does, weight[i], zero);
        found.touched = select(does, one, found.touched);
        link = with_contact(link, x[i], mass, center, radius, length[i]);
      }
      link = with_vertex(link, weight[i], x[i] - q[i], here.x, edge);
      if (stretches) {
        const Real stiffness = edge_stiffness(stretch, rest_length[i]);
        rows[i].stretch = stretch_gain(link, here.x, stiffness, length[i] - rest_length[i]);
        link = with_stretch(link, here.x, stiffness, rows[i].stretch);
      }
      link = at_near_end(link, edge);
      const Real inverse = inverse_joint_length(rest_length[i - 1], rest_length[i]);
      const JOINED joined =
          with_joint(link, rod_joint(before, here, rest_curvature[i], bend * inverse, twist * inverse));
      rows[i].joint = joined.gain;
      link = joined.link;
      here = before;
    }
    Vec turn = {zero, zero, zero}, moved = turn, end = q[1];
    for (int i = 2; i < n; ++i) {
      turn = turn + joint_turn(rows[i].joint, moved, turn);
      if (counts != nullptr) turn = turn * *counts;
      const FRAME old = frame(i);
      const FRAME now = turned_frame(old, turn);
      const Real old_length = length[i];
      moved = moved + outer(turn, old.x * old_length);
      if (stretches) {
        Real change = stretch_by(rows[i].stretch, moved, turn);
        if (counts != nullptr) change = change * *counts;
        moved = moved + old.x * change;
        length[i] = length[i] + change;
      }
      Real pushed = zero;
      for (int s = 0; s < contacts; ++s) {
        const Vec center = Step::broadcast(at.now.spheres + 4 * s);
        const Real radius(at.now.spheres[4 * s + 3]);
        const auto does = touches(i, center, radius, old_length);
        if (!any(does)) continue;
        const Real pushes = select(contact_length(x[i], moved, center, radius, old_length) < zero, one, zero);
        pushed = Step::larger(select(does, pushes, zero), pushed);
        found.released = Step::larger(select(does, one - pushes, zero), found.released);
      }
      if (counts != nullptr) pushed = select(*counts > zero, pushed, pressed[i]);
      pressed[i] = pushed;
      frame_x[i] = now.x;
      frame_y[i] = now.y;
      end = end + now.x * length[i];
      x[i] = end;
    }
    return found;
  }

  // Vertices inside spheres swing out of them, and what hangs on them goes along. What no sphere touches keeps its
  // bits.
  STRANDBAKE_INLINE void collide() const {
    const Substep<Scalar>& now = at.now;
    typename Step::Box box = {q[1], q[1]};
    if (at.workspace.skip_colliders) {
      for (int i = 2; i < n; ++i) box.add(q[i]);
    }
    at.workspace.work.spheres += now.sphere_count;
    bool reached = !at.workspace.skip_colliders;
    for (int s = 0; s < now.sphere_count && !reached; ++s) reached = at.reaches(s, box);
    if (!reached) {
      at.workspace.work.spheres_out_of_reach += now.sphere_count;
      return;
    }
    const Real zero(Scalar(0)), one(Scalar(1));
    Real touched = zero;
    for (int i = 2; i < n; ++i) {
      const Vec alone = q[i];
      const auto follows = touched > zero;
      const Vec direction = direction_or(alone - q[i - 1], frame_x[i]);
      Vec end = chosen(follows, at_length(q[i - 1], alone, direction, length[i]), alone);
      if constexpr (Masked) end = at.where_swept(i, end, alone);
      for (int s = 0; s < now.sphere_count; ++s) {
        const Vec center = Step::broadcast(now.spheres + 4 * s);
        const Real radius(now.spheres[4 * s + 3]);
        const auto inside = squared_distance(end, center) < radius * radius;
        if (!any(inside)) continue;
        touched = select(inside, one, touched);
        const Vec out = swing_out_of_sphere(end, q[i - 1], length[i], center, radius);
        if constexpr (Masked) {
          end = at.where_swept(i, out, push_out_of_sphere(end, center, radius, Step::reals(at.block.free)[i]));
        } else {
          end = out;
        }
      }
      q[i] = end;
      const FRAME turned = turn_frame(frame(i), end - q[i - 1]);
      frame_x[i] = chosen(touched > zero, turned.x, frame_x[i]);
      frame_y[i] = chosen(touched > zero, turned.y, frame_y[i]);
    }
  }

  // rod_return.h. Where vertices would go on their own stands in `own`. `scale`: drawn_scale().
  STRANDBAKE_INLINE void hand_back(const Vec* own, Real scale) const {
    Vec* const drawn = Step::vectors(at.block.drawn);
    Vec* const handed_back = Step::vectors(at.block.handed_back);
    const Real zero(Scalar(0)), one(Scalar(1));
    const int contacts = may_touch(q, BOUNCE_MARGIN) ? at.now.sphere_count : 0;
    Real counts(Scalar(1));
    for (int s = 0; s < contacts; ++s) {
      const Vec center = Step::broadcast(at.now.spheres + 4 * s);
      const Real radius(at.now.spheres[4 * s + 3]);
      for (int i = 2; i < n; ++i) {
        const Real near = touching_radius(radius, length[i], BOUNCE_MARGIN);
        const auto touches = squared_distance(q[i], center) < near * near;
        counts = select(touches, Masked ? counts * (one - Step::reals(at.block.free)[i]) : zero, counts);
      }
    }
    const Vec none = {zero, zero, zero};
    for (int i = 2; i < n; ++i) {
      const Vec now = chosen(counts > zero, at.where_swept(i, q[i] - own[i], none), none);
      handed_back[i] = drawn_return(now, drawn[i] * scale);
      drawn[i] = now;
    }
  }

  STRANDBAKE_INLINE void run(const Vec* p, Real scale) const {
    if (n < 3) return;
    begin(p);
    Real touched = iterate(nullptr).touched;
    for (int iteration = 1; iteration < at.region.rod_iterations; ++iteration) {
      const Real now = iterate(nullptr).touched;
      touched = Step::larger(now, touched);
    }
    if (at.now.sphere_count > 0) {
      Real asks = Step::larger(inside(), touched);
      for (int more = 0; more < CONTACT_ITERATIONS && any(asks > Real(Scalar(0))); ++more) {
        const Real released = iterate(&asks).released;
        asks = asks * Step::larger(inside(), released);
      }
    }
    Vec* const own = Step::vectors(at.workspace.frame_x);
    for (int i = 2; i < n; ++i) {
      own[i] = q[i];
      if constexpr (Masked) {
        // What hangs on a pinned vertex begins where that is, not where the iteration has left it.
        const Vec end = at.where_swept(i, q[i - 1] + frame_x[i] * length[i], x[i]);
        q[i] = chosen(Step::reals(at.block.free)[i] > Real(Scalar(0)), end, q[i]);
      } else {
        q[i] = x[i];
      }
    }
    if (at.now.sphere_count > 0) collide();
    hand_back(own, scale);
  }
};

}  // namespace
}  // namespace strandbake
