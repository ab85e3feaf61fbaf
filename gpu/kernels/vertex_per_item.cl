// Algorithm 1 with a block of strands per work-group and a vertex per work-item: the paper's mapping (its section 5),
// for methods 2 to 4; right for few or long strands. Vertices of the block lie in memory that the group shares;
// constraints run in two batches, or three with a reaction, with barriers between them. Where a block has more vertices than work-items, an item
// takes every `rows`-th.
//
// This text is compiled for each METHOD in use (0: no local shape), with SHARED as __local, or as __global for strands
// too long for it; NAME(x) tells the results apart. A barrier stands under no condition but those of loops, so that all
// items come to it and compilers need not wonder.
// `shared` holds rows of 3 WIDTH numbers for each of `capacity` vertices: p, q, with methods 2 and 4 x and y of the
// frames, and one more with method 4, for the products of the scan, and where lengths are solved directly.
// `shared_stride`: numbers from one group's to the next's.

static Real3 NAME(read_shared)(const SHARED Real* lane, uint i) {
  lane += (size_t)i * ROW;
  return (Real3)(lane[0], lane[WIDTH], lane[2 * WIDTH]);
}
static void NAME(write_shared)(SHARED Real* lane, uint i, Real3 v) {
  lane += (size_t)i * ROW;
  lane[0] = v.x;
  lane[WIDTH] = v.y;
  lane[2 * WIDTH] = v.z;
}

#if METHOD == 4
static Twist NAME(read_twist)(const SHARED Real* lane, uint i) {
  lane += (size_t)i * ROW;
  Twist twist;
  twist.re = lane[0];
  twist.im = lane[WIDTH];
  return twist;
}
static void NAME(write_twist)(SHARED Real* lane, uint i, Twist twist) {
  lane += (size_t)i * ROW;
  lane[0] = twist.re;
  lane[WIDTH] = twist.im;
}
#endif

// The hint keeps Intel's runtime for CPUs from making vectors of work-items, which it gets wrong where one of them
// walks along a strand (tests/gpu/intel_test.sh); other compilers do not mind it.
__kernel __attribute__((reqd_work_group_size(VERTEX_GROUP, 1, 1), vec_type_hint(float4))) void NAME(advance_vertices)(
    __global Real* state, const __global BlockRow* blocks, const __global uint* which,
    const __global Real* region_reals, const __global int* region_ints, const __global Real* substep_reals,
    const __global int* substep_ints, const __global Real* spheres, uint substep_count, uint swapped,
    SHARED Real* shared_base, uint capacity, uint shared_stride) {
  const BlockRow block = blocks[which[get_group_id(0)]];
  const uint lane = get_local_id(0) % WIDTH;
  const uint row = get_local_id(0) / WIDTH;
  const uint rows = VERTEX_GROUP / WIDTH;
  const uint n = block.vertices;
  const __global Real* const rest = state + block.rest + lane;

  SHARED Real* const shared = shared_base + get_group_id(0) * (size_t)shared_stride + lane;
  SHARED Real* p = shared;
  SHARED Real* q = shared + (size_t)capacity * ROW;
#if METHOD == 2 || METHOD == 4
  SHARED Real* const frame_x = shared + (size_t)2 * capacity * ROW;
  SHARED Real* const frame_y = shared + (size_t)3 * capacity * ROW;
  SHARED Real* const more = shared + (size_t)4 * capacity * ROW;
#else
  SHARED Real* const more = shared + (size_t)2 * capacity * ROW;
#endif
  __global Real* const p_state = state + (swapped ? block.previous : block.position) + lane;
  __global Real* const q_state = state + (swapped ? block.position : block.previous) + lane;
  const __global Real* const region = region_reals + block.region * kRegionReals;
  const __global int* const counts = region_ints + block.region * kRegionInts;
  const Weights weights = weights_of(state, block, lane);
#if METHOD == 2 || METHOD == 4
  const uint chunks = (n + rows - 1) / rows;
#endif

  for (uint i = row; i < n; i += rows) {
    NAME(write_shared)(p, i, read3(p_state, i));
    NAME(write_shared)(q, i, read3(q_state, i));
#if METHOD == 2 || METHOD == 4
    if (block.frame_x != kAbsent) {
      NAME(write_shared)(frame_x, i, read3(state + block.frame_x + lane, i));
      NAME(write_shared)(frame_y, i, read3(state + block.frame_y + lane, i));
    }
#endif
  }
  SHARED_BARRIER;

  for (uint s = 0; s < substep_count; ++s) {
    const __global Real* const substep = substep_reals + s * kSubstepReals;
    const Head head = head_of(substep);

#ifdef HAS_DIRECT_LENGTHS
    // What tension will take is handed back (passes/direct_length.h). The tension of a segment is its item's alone.
    const __global Real* const length_of = state + block.length + lane;
    __global Real* const tension = state + block.tension + lane;
    const Real tension_scale = s == 0 ? region[kTensionFirst] : (Real)1;
    for (uint i = row; i < n; i += rows) {
      if (i < 2 || !counts[kDirectLengths]) continue;
      const Real ratio = tension_ratio(read1(tension, i), tension_scale, read1(length_of, i));
      write1(tension, i, ratio);
      NAME(write_shared)(more, i,
                         tension_return(ratio, (NAME(read_shared)(p, i) - NAME(read_shared)(q, i)) -
                                                   (NAME(read_shared)(p, i - 1) - NAME(read_shared)(q, i - 1))));
    }
    SHARED_BARRIER;
#endif

    // Forces, integration and global shape: old positions in p, new ones over q.
    {
      const Real keep = region[s == 0 ? kKeepFirst : kKeep];
      const Real3 fall = fall_of(head, substep, region, keep);
#ifdef HAS_WIND
      const bool windy = counts[kWind];
      const Real3 wind = windy ? wind_of(substep, state + block.wind_weight + lane, region[kDragH2]) : (Real3)(0);
#endif
      for (uint i = row; i < n; i += rows) {
        if (i < 2) {
          NAME(write_shared)(q, i, turn_with(head, read3(rest, i)));
          continue;
        }
        const Real3 here = NAME(read_shared)(p, i);
        Real3 accel_h2 = fall;
#ifdef HAS_WIND
        if (windy) accel_h2 = accel_h2 + wind_across(wind, here - NAME(read_shared)(p, i - 1));
#endif
#if defined(HAS_SUPPORT) && (METHOD == 2 || METHOD == 4)
        if (counts[kSupported]) {
          Frame frame;  // before vertex i
          frame.x = NAME(read_shared)(frame_x, i - 1);
          frame.y = NAME(read_shared)(frame_y, i - 1);
          if (METHOD == 4 && i == 2) {
            frame.x = turn_with(head, read3(state + block.root_frame + lane, 0));
            frame.y = turn_with(head, read3(state + block.root_frame + lane, 1));
          }
          accel_h2 = accel_h2 + supported(frame, read3(state + block.support + lane, i), region[kH2]);
        }
#endif
        Real3 before = NAME(read_shared)(q, i);
#ifdef HAS_DIRECT_LENGTHS
        if (counts[kDirectLengths]) {
          const Real3 returned = NAME(read_shared)(more, i);
          before = before - (i + 1 < n ? returned - NAME(read_shared)(more, i + 1) : returned);
        }
#endif
        Real3 moved = integrate(here, before, keep, accel_h2);
#ifdef HAS_GLOBAL_SHAPE
        if (counts[kGlobalShape] && i < block.global_end) {
          const Real stiffness = region[kGlobalStiffness] * read1(state + block.fade + lane, i);
          moved = pull_to_goal(moved, turn_with(head, read3(rest, i)),
                               stiffness_at_step(stiffness, region[kStepRatio2]));
        }
#endif
#ifdef HAS_MASKED
        if (weights.masked && !(read1(weights.free, i) > (Real)0)) moved = turn_with(head, read3(rest, i));
#endif
        NAME(write_shared)(q, i, moved);
      }
    }
    SHARED_BARRIER;

#if METHOD > 0
    {
      const Real half_stiffness = (Real)0.5 * region[kLocalStiffness];
#if METHOD == 2 || METHOD == 4
      const __global Real* const local_edge = state + block.local_edge + lane;
      const __global Real* const remainder = state + block.remainder + lane;
      const __global Real* const rest_frame = state + block.root_frame + lane;
#ifdef HAS_REACTION
      const __global Real* const lever = state + block.lever + lane;
      const __global Real* const rest_length = state + block.length + lane;
#endif
      Frame root;
      root.x = turn_with(head, read3(rest_frame, 0));
      root.y = turn_with(head, read3(rest_frame, 1));
      if (row == 0 && counts[kLocalShape]) {  // which reads it in the first batch; others do after a barrier
        NAME(write_shared)(frame_x, 1, root.x);
        NAME(write_shared)(frame_y, 1, root.y);
      }
#endif
      const int iterations = counts[kLocalShape] ? counts[kLocalIterations] : 0;
      for (int iteration = 0; iteration < iterations; ++iteration) {
#if METHOD == 4
        // The frames of the whole strand (passes/frame_scan.h).
        for (uint i = row; i < n; i += rows) {
          if (i < 2) continue;
          const Frame along =
              frame_along(direction_or(NAME(read_shared)(q, i) - NAME(read_shared)(q, i - 1), root.x));
          NAME(write_shared)(frame_x, i, along.x);
          NAME(write_shared)(frame_y, i, along.y);
        }
        SHARED_BARRIER;
        for (uint i = row; i < n; i += rows) {
          if (i < 2) continue;
          Frame before, here;
          before.x = NAME(read_shared)(frame_x, i - 1);
          before.y = NAME(read_shared)(frame_y, i - 1);
          here.x = NAME(read_shared)(frame_x, i);
          here.y = NAME(read_shared)(frame_y, i);
          NAME(write_twist)(more, i, twist_between(before, here));
        }
        SHARED_BARRIER;
        // From the tip, so that each round sees what the one before it has left.
        for (uint d = 1; d + 2 < n; d *= 2) {
          for (uint chunk = chunks; chunk-- > 0;) {
            const uint i = chunk * rows + row;
            const bool turns = i >= 2 + d && i < n;
            Twist product;
            product.re = product.im = (Real)0;
            if (turns) product = twist_product(NAME(read_twist)(more, i), NAME(read_twist)(more, i - d));
            SHARED_BARRIER;
            if (turns) NAME(write_twist)(more, i, product);
            SHARED_BARRIER;
          }
        }
        for (uint i = row; i < n; i += rows) {
          if (i < 2) continue;
          Frame along;
          along.x = NAME(read_shared)(frame_x, i);
          along.y = NAME(read_shared)(frame_y, i);
          NAME(write_shared)(frame_y, i, twisted_frame(along, NAME(read_twist)(more, i)).y);
        }
        SHARED_BARRIER;
#endif
#if METHOD != 3 && defined(HAS_REACTION)
        const uint reacting_batches = REACTS(counts) ? 3 : 0, plain_batches = REACTS(counts) ? 0 : 2;
        for (uint batch = 2; batch < 2 + reacting_batches; ++batch) {
          for (uint i = batch + 3 * row; i < n; i += 3 * rows) {
            Frame frame = root;
            if (i > 2) {
              frame.x = NAME(read_shared)(frame_x, i - 1);
              frame.y = NAME(read_shared)(frame_y, i - 1);
            }
            Bend bend;
            bend.before = NAME(read_shared)(q, i - 2);
            bend.near = NAME(read_shared)(q, i - 1);
            bend.far = NAME(read_shared)(q, i);
            react(weights, i, region[kLocalStiffness], frame, read3(local_edge, i), read3(remainder, i),
                  read1(lever, i), read1(rest_length, i), &bend);
            NAME(write_shared)(q, i - 2, bend.before);
            NAME(write_shared)(q, i - 1, bend.near);
            NAME(write_shared)(q, i, bend.far);
          }
          SHARED_BARRIER;
        }
#else
        const uint plain_batches = 2;
#endif
        for (uint batch = 2; batch < 2 + plain_batches; ++batch) {
          for (uint i = batch + 2 * row; i < n; i += 2 * rows) {
            Real3 near = NAME(read_shared)(q, i - 1);
            Real3 far = NAME(read_shared)(q, i);
#if METHOD == 3  // Algorithm 5
            const Real3 d = (turn_with(head, read3(rest, i) - read3(rest, i - 1)) - (far - near)) * half_stiffness;
#else  // Algorithm 4, with frames of the iteration before or of this one
            Frame frame;
            frame.x = NAME(read_shared)(frame_x, i - 1);
            frame.y = NAME(read_shared)(frame_y, i - 1);
            const Real3 d =
                local_shape_error(frame, read3(local_edge, i), read3(remainder, i), far - near) * half_stiffness;
#endif
            part(weights, i, d, &near, &far);
            NAME(write_shared)(q, i - 1, near);
            NAME(write_shared)(q, i, far);
          }
          SHARED_BARRIER;
        }
#if METHOD == 2
        // From the tip, so that each new frame still sees the old one before it.
        for (uint chunk = chunks; chunk-- > 0;) {
          const uint i = chunk * rows + row;
          Frame frame = root;
          if (i >= 2 && i < n) {
            frame.x = NAME(read_shared)(frame_x, i - 1);
            frame.y = NAME(read_shared)(frame_y, i - 1);
            frame = turn_frame(frame, NAME(read_shared)(q, i) - NAME(read_shared)(q, i - 1));
          }
          SHARED_BARRIER;
          if (i >= 2 && i < n) {
            NAME(write_shared)(frame_x, i, frame.x);
            NAME(write_shared)(frame_y, i, frame.y);
          }
          SHARED_BARRIER;
        }
#endif
      }
    }
#endif

#ifdef HAS_EDGE_LENGTHS
    for (int iteration = 0; iteration < counts[kLengthIterations]; ++iteration) {
      for (uint batch = 2; batch <= 3; ++batch) {
        for (uint i = batch + 2 * row; i < n; i += 2 * rows) {
          Real3 near = NAME(read_shared)(q, i - 1);
          Real3 far = NAME(read_shared)(q, i);
          hold_length(weights, i, read1(state + block.length + lane, i), &near, &far);
          if (i > 2) NAME(write_shared)(q, i - 1, near);
          NAME(write_shared)(q, i, far);
        }
        SHARED_BARRIER;
      }
    }
#endif

    const __global Real* const spheres_now = spheres + 4 * substep_ints[s * kSubstepInts + kSphereBegin];
    const int sphere_count = substep_ints[s * kSubstepInts + kSphereCount];
#ifdef HAS_DIRECT_LENGTHS
    // What runs along a strand, one item does for it; all else is done by vertex.
    const int rounds = counts[kDirectLengths] ? LENGTH_ROUNDS : 0;
    for (uint i = row; i < n; i += rows) {
      if (i < 2 || !counts[kDirectLengths]) continue;
      NAME(write_shared)(more, i, (Real3)(tension_pull(read1(tension, i))));
    }
    SHARED_BARRIER;
    if (row == 0 && counts[kDirectLengths]) {
      Real3 done = NAME(read_shared)(q, 1);
      Real ratio = 1;
      for (uint i = 2; i < n; ++i) {
        const Real above = NAME(read_shared)(more, i).x;
        const Real below = i + 1 < n ? NAME(read_shared)(more, i + 1).x : (Real)0;
        const Real free = free_weight(weights, i);
        const Real held = above * free * ratio;
        const Real inverse = tension_inverse(held, below * free);
        NAME(write_shared)(more, i, (Real3)(above, below * free * inverse, (Real)0));
        ratio = ((Real)1 + held) * inverse;
        done = (NAME(read_shared)(q, i) + done * (above * free)) * inverse;
        NAME(write_shared)(q, i, done);
      }
      for (uint i = n - 2; i >= 2; --i) {
        done = NAME(read_shared)(q, i) + done * NAME(read_shared)(more, i).y;
        NAME(write_shared)(q, i, done);
      }
    }
    SHARED_BARRIER;
    for (int round = 0; round < rounds; ++round) {
      for (uint i = row; i < n; i += rows) {
        if (i < 2) continue;
        const Real3 near = NAME(read_shared)(q, i - 1);
        const Segment segment = segment_of(weights, i, read1(length_of, i), near, NAME(read_shared)(q, i));
        if (round == 0) {
          write1(tension, i, tension_borne(NAME(read_shared)(more, i).x, segment.length, read1(length_of, i)));
        }
        Real b = 0;
        if (i > 2) {
          b = inner(segment_of(weights, i - 1, (Real)0, NAME(read_shared)(q, i - 2), near).direction,
                    segment.direction) *
              free_weight(weights, i - 1);
        }
        NAME(write_shared)(more, i, (Real3)(segment.error, segment.diagonal, b));
      }
      SHARED_BARRIER;
      if (row == 0) {
        Real inverse = 0, solved = 0;
        for (uint i = 2; i < n; ++i) {
          const Real3 equation = NAME(read_shared)(more, i);
          const Real share = equation.z * inverse;
          inverse = inverse_pivot(equation.y, equation.z, share);
          solved = (equation.x + equation.z * solved) * inverse;
          NAME(write_shared)(more, i, (Real3)(solved, share, (Real)0));
        }
        Real share_after = 0;
        Real lambda = 0;
        for (uint i = n - 1; i >= 2; --i) {
          const Real3 equation = NAME(read_shared)(more, i);
          lambda = i == n - 1 ? equation.x : equation.x + share_after * lambda;
          share_after = equation.y;
          NAME(write_shared)(more, i, (Real3)(lambda));
        }
      }
      SHARED_BARRIER;
      for (uint i = row; i < n; i += rows) {
        if (i < 2) continue;
        const Real3 direction =
            segment_of(weights, i, (Real)0, NAME(read_shared)(q, i - 1), NAME(read_shared)(q, i)).direction;
        const Real lambda = NAME(read_shared)(more, i).x;
        write1(tension, i, read1(tension, i) + lambda);
        NAME(write_shared)(more, i, direction * lambda);
      }
      SHARED_BARRIER;
      for (uint i = row; i < n; i += rows) {
        if (i < 2) continue;
        const Real3 pull = i == n - 1 ? (Real3)(0) : NAME(read_shared)(more, i + 1);
        const Real3 move = (NAME(read_shared)(more, i) - pull) * free_weight(weights, i);
        NAME(write_shared)(q, i, NAME(read_shared)(q, i) - move);
      }
      SHARED_BARRIER;
    }
    if (row == 0 && counts[kDirectLengths]) {
      Real3 at = NAME(read_shared)(q, 1);
      Real3 direction = direction_or(at - NAME(read_shared)(q, 0), (Real3)(0));
      for (uint i = 2; i < n; ++i) {
        at = walk_to(weights, i, read1(length_of, i), at, NAME(read_shared)(q, i), &direction, spheres_now,
                     sphere_count);
        NAME(write_shared)(q, i, at);
      }
    }
    SHARED_BARRIER;
#endif

#ifdef HAS_SPHERES
    const int spheres_apart = counts[kDirectLengths] ? 0 : sphere_count;
    for (uint i = row; i < n; i += rows) {
      if (i < 2) continue;
      Real3 at = NAME(read_shared)(q, i);
      for (int k = 0; k < spheres_apart; ++k) {
        const __global Real* const sphere = spheres_now + 4 * k;
        at = push_out_of_sphere(at, triple(sphere), sphere[3], free_weight(weights, i));
      }
      NAME(write_shared)(q, i, at);
    }
    SHARED_BARRIER;
#endif

    SHARED Real* const other = p;
    p = q;
    q = other;
  }

  // The state keeps what is newest where the number of substeps says.
  const bool ends_swapped = (substep_count % 2 != 0);
  __global Real* const p_to = ends_swapped ? q_state : p_state;
  __global Real* const q_to = ends_swapped ? p_state : q_state;
  for (uint i = row; i < n; i += rows) {
    write3(p_to, i, NAME(read_shared)(p, i));
    write3(q_to, i, NAME(read_shared)(q, i));
#if METHOD == 2 || METHOD == 4
    if (block.frame_x != kAbsent) {
      write3(state + block.frame_x + lane, i, NAME(read_shared)(frame_x, i));
      write3(state + block.frame_y + lane, i, NAME(read_shared)(frame_y, i));
    }
#endif
  }
}
