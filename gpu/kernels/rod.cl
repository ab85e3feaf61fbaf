// The rod (passes/rod_link.h) of one strand, operation by operation as sim/rod_block.h has it on a block. Where
// vertices would go on their own stands in q, and so does where they go in the end.
#ifdef HAS_ROD
typedef struct {
  uint n;
  Weights weights;
  const __global Real *rest_length, *rest_curvature;
  __global Real *q, *frame_x, *frame_y, *drawn, *handed_back, *pressed;
  __global Real* rows;  // of vertices from the third on, see RodScratch
  uint row;             // numbers of one
  Real bend, twist, stretch, h2;
} Rod;

static __global Real* rod_row(Rod rod, uint i) {
  return rod.rows + (size_t)(i - 2) * rod.row * WIDTH;
}
static Real3 row3(const __global Real* row, uint at) {
  return read3(row + at * WIDTH, 0);
}
static void set_row3(__global Real* row, uint at, Real3 v) {
  write3(row + at * WIDTH, 0, v);
}
static Matrix row_matrix(const __global Real* row, uint at) {
  Matrix m;
  m.x = row3(row, at);
  m.y = row3(row, at + 3);
  m.z = row3(row, at + 6);
  return m;
}
static void set_row_matrix(__global Real* row, uint at, Matrix m) {
  set_row3(row, at, m.x);
  set_row3(row, at + 3, m.y);
  set_row3(row, at + 6, m.z);
}

static JointGain joint_gain_of(const __global Real* row) {
  JointGain gain;
  const Real3 below = row3(row, kRodFactors);
  gain.factors.yx = below.x;
  gain.factors.zx = below.y;
  gain.factors.zy = below.z;
  gain.factors.inverse = row3(row, kRodFactors + 3);
  gain.by_x = row_matrix(row, kRodByX);
  gain.by_w = row_matrix(row, kRodByW);
  gain.offset = row3(row, kRodOffset);
  return gain;
}
static void set_joint_gain(__global Real* row, JointGain gain) {
  set_row3(row, kRodFactors, make_vec3(gain.factors.yx, gain.factors.zx, gain.factors.zy));
  set_row3(row, kRodFactors + 3, gain.factors.inverse);
  set_row_matrix(row, kRodByX, gain.by_x);
  set_row_matrix(row, kRodByW, gain.by_w);
  set_row3(row, kRodOffset, gain.offset);
}

static Frame rod_frame(Rod rod, uint i) {
  Frame frame;
  frame.x = read3(rod.frame_x, i);
  frame.y = read3(rod.frame_y, i);
  return frame;
}
static void set_rod_frame(Rod rod, uint i, Frame frame) {
  write3(rod.frame_x, i, frame.x);
  write3(rod.frame_y, i, frame.y);
}

// Of an edge, now.
static Real rod_length(Rod rod, uint i) {
#ifdef HAS_ROD_STRETCH
  if (rod.stretch > (Real)0) return read1(rod_row(rod, i), kRodLength);
#endif
  return read1(rod.rest_length, i);
}

static Rod rod_of(__global Real* state, BlockRow block, uint lane, Weights weights, const __global Real* region,
                  __global Real* q) {
  Rod rod;
  rod.n = block.vertices;
  rod.weights = weights;
  rod.rest_length = state + block.length + lane;
  rod.rest_curvature = state + block.rest_curvature + lane;
  rod.q = q;
  rod.frame_x = state + block.frame_x + lane;
  rod.frame_y = state + block.frame_y + lane;
  rod.drawn = state + block.drawn + lane;
  rod.handed_back = state + block.handed_back + lane;
  rod.pressed = state + block.pressed + lane;
  rod.rows = state + block.elimination + lane;
  rod.bend = region[kRodBendH2];
  rod.h2 = region[kH2];
  rod.twist = region[kRodTwistH2];
  rod.stretch = region[kRodStretchH2];
  rod.row = rod.stretch > (Real)0 ? kRodStretchRow : kRodExactRow;
  return rod;
}

// Before vertices go on their own: q is still where they were a substep ago, and then from where they go on. Edges
// between pinned vertices go with the root, see begin_rod().
static void turn_on(Rod rod, const __global Real* p, Real keep) {
  Real3 p_near = read3(p, 1);
  Real3 q_near = read3(rod.q, 1);
  for (uint i = 2; i < rod.n; ++i) {
    const Real3 p_far = read3(p, i);
    const Real3 q_far = read3(rod.q, i);
    if (is_swept(rod.weights, i)) {
      set_rod_frame(rod, i, turned_frame(rod_frame(rod, i), edge_turn(q_far - q_near, p_far - p_near) * keep));
    }
    write3(rod.q, i, q_far + read3(rod.handed_back, i));
    p_near = p_far;
    q_near = q_far;
  }
}

// `p`: where vertices were. The root is where it is now, and edges between pinned vertices turn with it. `fade`,
// `pulled`: of the global shape, and how far it reaches.
static void begin_rod(Rod rod, Frame root, const __global Real* p, const __global Real* region,
                      const __global Real* fade, uint pulled) {
  const Frame root_before = rod_frame(rod, 1);
  set_rod_frame(rod, 1, root);
  Real3 end = read3(rod.q, 1);
  for (uint i = 2; i < rod.n; ++i) {
    __global Real* const row = rod_row(rod, i);
    if (!is_swept(rod.weights, i)) set_rod_frame(rod, i, carried_along(root_before, root, rod_frame(rod, i)));
#ifdef HAS_ROD_STRETCH
    if (rod.stretch > (Real)0) write1(row, kRodLength, segment_length(read3(p, i) - read3(p, i - 1)));
#endif
    end = end + read3(rod.frame_x, i) * rod_length(rod, i);
    set_row3(row, kRodX, end);
    const Real after = i + 1 < rod.n ? read1(rod.rest_length, i + 1) : (Real)0;
    Real share = 1;
#ifdef HAS_GLOBAL_SHAPE
    if (i < pulled) {
      share = held_share(stiffness_at_step(region[kGlobalStiffness] * read1(fade, i), region[kStepRatio2]));
    }
#endif
    if (!(free_weight(rod.weights, i) > (Real)0)) share = PINNED_SHARE;
    write1(row, kRodWeight, (read1(rod.rest_length, i) + after) * ((Real)0.5 * share));
  }
}

#ifdef HAS_SPHERES
// Whether the vertex counts as touching the sphere, where the iteration has it. `edge`: the length of that before it.
static bool rod_touches(Rod rod, uint i, Real3 at, const __global Real* sphere, Real edge) {
  if (!(free_weight(rod.weights, i) > (Real)0)) return false;
  const Real distance2 = squared_distance(at, triple(sphere));
  const Real near = touching_radius(sphere[3], edge, TOUCH_MARGIN);
  const Real inner = missed_radius(sphere[3], rod.h2);
  if (distance2 < inner * inner) return true;
  return distance2 < near * near && read1(rod.pressed, i) > (Real)0;
}
#endif

// Whether a sphere touches the strand, and has let go of it somewhere.
typedef struct {
  bool touched, released;
} RodContacts;

static RodContacts iterate_rod(Rod rod, const __global Real* spheres, int sphere_count) {
  RodContacts found;
  found.touched = false;
  found.released = false;
  Link link = no_link((Real)0);
  Frame here = rod_frame(rod, rod.n - 1);
  for (uint i = rod.n - 1; i >= 2; --i) {
    __global Real* const row = rod_row(rod, i);
    const Frame before = rod_frame(rod, i - 1);
    const Real3 edge = here.x * rod_length(rod, i);
#ifdef HAS_SPHERES
    for (int k = 0; k < sphere_count; ++k) {
      const __global Real* const sphere = spheres + 4 * k;
      const Real3 at = row3(row, kRodX);
      if (!rod_touches(rod, i, at, sphere, rod_length(rod, i))) continue;
      found.touched = true;
      link = with_contact(link, at, read1(row, kRodWeight), triple(sphere), sphere[3], rod_length(rod, i));
    }
#endif
    link = with_vertex(link, read1(row, kRodWeight), row3(row, kRodX) - read3(rod.q, i), here.x, edge);
#ifdef HAS_ROD_STRETCH
    if (rod.stretch > (Real)0) {
      const Real stiffness = edge_stiffness(rod.stretch, read1(rod.rest_length, i));
      const StretchGain gain =
          stretch_gain(link, here.x, stiffness, rod_length(rod, i) - read1(rod.rest_length, i));
      link = with_stretch(link, here.x, stiffness, gain);
      set_row3(row, kStretchByX, gain.by_x);
      set_row3(row, kStretchByW, gain.by_w);
      write1(row, kStretchOffset, gain.offset);
    }
#endif
    link = at_near_end(link, edge);
    const Real inverse = inverse_joint_length(read1(rod.rest_length, i - 1), read1(rod.rest_length, i));
    const Joined joined = with_joint(
        link, rod_joint(before, here, read3(rod.rest_curvature, i), rod.bend * inverse, rod.twist * inverse));
    set_joint_gain(row, joined.gain);
    link = joined.link;
    here = before;
  }
  Real3 turn = (Real3)(0);
  Real3 moved = (Real3)(0);
  Real3 end = read3(rod.q, 1);
  for (uint i = 2; i < rod.n; ++i) {
    __global Real* const row = rod_row(rod, i);
    turn = turn + joint_turn(joint_gain_of(row), moved, turn);
    const Frame old = rod_frame(rod, i);
    const Frame now = turned_frame(old, turn);
    const Real old_length = rod_length(rod, i);
    Real length = old_length;
    moved = moved + outer(turn, old.x * old_length);
#ifdef HAS_ROD_STRETCH
    if (rod.stretch > (Real)0) {
      StretchGain gain;
      gain.by_x = row3(row, kStretchByX);
      gain.by_w = row3(row, kStretchByW);
      gain.offset = read1(row, kStretchOffset);
      const Real change = stretch_by(gain, moved, turn);
      moved = moved + old.x * change;
      length = length + change;
      write1(row, kRodLength, length);
    }
#endif
#ifdef HAS_SPHERES
    Real pressed = 0;
    for (int k = 0; k < sphere_count; ++k) {
      const __global Real* const sphere = spheres + 4 * k;
      const Real3 at = row3(row, kRodX);
      if (!rod_touches(rod, i, at, sphere, old_length)) continue;
      if (contact_length(at, moved, triple(sphere), sphere[3], old_length) < (Real)0) {
        pressed = 1;
      } else {
        found.released = true;
      }
    }
    write1(rod.pressed, i, pressed);
#endif
    set_rod_frame(rod, i, now);
    end = end + now.x * length;
    set_row3(row, kRodX, end);
  }
  return found;
}

#ifdef HAS_SPHERES
// Whether a free vertex is in a sphere.
static bool rod_is_inside(Rod rod, const __global Real* spheres, int sphere_count) {
  for (uint i = 2; i < rod.n; ++i) {
    if (!(free_weight(rod.weights, i) > (Real)0)) continue;
    const Real3 at = row3(rod_row(rod, i), kRodX);
    for (int k = 0; k < sphere_count; ++k) {
      const __global Real* const sphere = spheres + 4 * k;
      const Real inner = missed_radius(sphere[3], rod.h2);
      if (squared_distance(at, triple(sphere)) < inner * inner) return true;
    }
  }
  return false;
}

// Vertices inside spheres swing out of them, and what hangs on them goes along. What no sphere touches keeps its bits.
static void collide_rod(Rod rod, const __global Real* spheres, int sphere_count) {
  bool touched = false;
  Real3 near = read3(rod.q, 1);
  for (uint i = 2; i < rod.n; ++i) {
    const Real length = rod_length(rod, i);
    const bool swept = is_swept(rod.weights, i);
    Real3 end = read3(rod.q, i);
    if (touched && swept) end = at_length(near, end, direction_or(end - near, read3(rod.frame_x, i)), length);
    for (int k = 0; k < sphere_count; ++k) {
      const __global Real* const sphere = spheres + 4 * k;
      const Real3 center = triple(sphere);
      if (!(squared_distance(end, center) < sphere[3] * sphere[3])) continue;
      touched = true;
      end = swept ? swing_out_of_sphere(end, near, length, center, sphere[3])
                  : push_out_of_sphere(end, center, sphere[3], free_weight(rod.weights, i));
    }
    if (touched) {
      write3(rod.q, i, end);
      set_rod_frame(rod, i, turn_frame(rod_frame(rod, i), end - near));
    }
    near = end;
  }
}
#endif

static void run_rod(Rod rod, int iterations, const __global Real* spheres, int sphere_count) {
  bool touched = false;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    if (iterate_rod(rod, spheres, sphere_count).touched) touched = true;
  }
#ifdef HAS_SPHERES
  bool asks = touched || rod_is_inside(rod, spheres, sphere_count);
  for (int more = 0; more < CONTACT_ITERATIONS && asks; ++more) {
    asks = iterate_rod(rod, spheres, sphere_count).released || rod_is_inside(rod, spheres, sphere_count);
  }
#endif
  // What hangs on a pinned vertex begins where that is, not where the iteration has left it.
  Real3 end = read3(rod.q, 1);
  for (uint i = 2; i < rod.n; ++i) {
    set_row3(rod_row(rod, i), kRodOwn, read3(rod.q, i));
    const Real3 walked = end + read3(rod.frame_x, i) * rod_length(rod, i);
    end = !(free_weight(rod.weights, i) > (Real)0) ? read3(rod.q, i)
          : is_swept(rod.weights, i)               ? walked
                                                   : row3(rod_row(rod, i), kRodX);
    write3(rod.q, i, end);
  }
}

// passes/rod_return.h. `scale`: drawn_scale().
static void hand_back(Rod rod, Real scale, const __global Real* spheres, int sphere_count) {
  bool touched = false;
#ifdef HAS_SPHERES
  for (int k = 0; k < sphere_count && !touched; ++k) {
    const __global Real* const sphere = spheres + 4 * k;
    for (uint i = 2; i < rod.n && !touched; ++i) {
      const Real near = touching_radius(sphere[3], rod_length(rod, i), BOUNCE_MARGIN);
      touched = free_weight(rod.weights, i) > (Real)0 &&
                squared_distance(read3(rod.q, i), triple(sphere)) < near * near;
    }
  }
#endif
  for (uint i = 2; i < rod.n; ++i) {
    const bool counts = !touched && is_swept(rod.weights, i);
    const Real3 now = counts ? read3(rod.q, i) - row3(rod_row(rod, i), kRodOwn) : (Real3)(0);
    write3(rod.handed_back, i, drawn_return(now, read3(rod.drawn, i) * scale));
    write3(rod.drawn, i, now);
  }
}
#endif
