// Algorithm 1 of the paper with a strand per work-item: the CPU's mapping. Methods 1 to 3 and the rod; right for many
// strands. A strand's work-item touches no other strand, so there is no barrier.
//
// `which`: the blocks to run, WIDTH work-items each.

#ifdef HAS_DIRECT_LENGTHS
// Hands back what tension will take, see passes/direct_length.h. Leaves T / L in the place of T.
static void return_tension(uint n, const __global Real* rest_length, __global Real* tension, Real scale,
                           const __global Real* p, __global Real* q) {
  Real3 q_near = read3(q, 1);
  Real3 moved = read3(p, 1) - q_near;
  Real3 here = (Real3)(0);  // of the segment before
  for (uint i = 2; i < n; ++i) {
    const Real ratio = tension_ratio(read1(tension, i), scale, read1(rest_length, i));
    write1(tension, i, ratio);
    const Real3 q_far = read3(q, i);
    const Real3 moved_far = read3(p, i) - q_far;
    const Real3 far = tension_return(ratio, moved_far - moved);
    if (i > 2) write3(q, i - 1, q_near - (here - far));
    q_near = q_far;
    moved = moved_far;
    here = far;
  }
  if (n > 2) write3(q, n - 1, q_near - here);
}

// Lets the tension act, see passes/direct_length.h. Finds T / L in the place of T and leaves a. `elimination`: c of each
// vertex from the third on.
static void apply_tension(Weights weights, uint n, __global Real* tension, __global Real* elimination,
                          __global Real* q) {
  Real3 done = read3(q, 1);
  Real ratio = 1;
  Real above = tension_pull(read1(tension, 2));
  for (uint i = 2; i < n; ++i) {
    const Real below = i + 1 < n ? tension_pull(read1(tension, i + 1)) : (Real)0;
    const Real free = free_weight(weights, i);
    const Real held = above * free * ratio;
    const Real inverse = tension_inverse(held, below * free);
    write1(elimination, kLengthRow * (i - 2), below * free * inverse);
    ratio = ((Real)1 + held) * inverse;
    done = (read3(q, i) + done * (above * free)) * inverse;
    write3(q, i, done);
    write1(tension, i, above);
    above = below;
  }
  for (uint i = n - 2; i >= 2; --i) {
    done = read3(q, i) + done * read1(elimination, kLengthRow * (i - 2));
    write3(q, i, done);
  }
}

// One round of passes/direct_length.h. `elimination`: b / m and g of each vertex from the third on.
static void solve_lengths(Weights weights, uint n, bool first, const __global Real* rest_length, __global Real* tension,
                          __global Real* elimination, __global Real* q) {
  Real3 near = read3(q, 1);
  Real3 before = near;  // no direction: its weight is 0
  Real inverse = 0, solved = 0;
  for (uint i = 2; i < n; ++i) {
    const Real3 far = read3(q, i);
    const Segment segment = segment_of(weights, i, read1(rest_length, i), near, far);
    if (first) write1(tension, i, tension_borne(read1(tension, i), segment.length, read1(rest_length, i)));
    const Real b = inner(before, segment.direction) * free_weight(weights, i - 1);
    const Real share = b * inverse;
    inverse = inverse_pivot(segment.diagonal, b, share);
    solved = (segment.error + b * solved) * inverse;
    write1(elimination, kLengthRow * (i - 2), share);
    write1(elimination, kLengthRow * (i - 2) + 1, solved);
    before = segment.direction;
    near = far;
  }
  Real lambda = 0;
  Real3 pull = (Real3)(0);  // of the segment after
  Real3 far = read3(q, n - 1);
  for (uint i = n - 1; i >= 2; --i) {
    near = read3(q, i - 1);
    const Real solved_here = read1(elimination, kLengthRow * (i - 2) + 1);
    lambda = i == n - 1 ? solved_here : solved_here + read1(elimination, kLengthRow * (i - 1)) * lambda;
    write1(tension, i, read1(tension, i) + lambda);
    const Real3 own = segment_of(weights, i, (Real)0, near, far).direction * lambda;
    write3(q, i, far - (own - pull) * free_weight(weights, i));
    pull = own;
    far = near;
  }
}

// The exact walk, clear of the spheres.
static void sweep_lengths(Weights weights, uint n, const __global Real* rest_length, __global Real* q,
                          const __global Real* spheres, int sphere_count) {
  Real3 at = read3(q, 1);
  Real3 direction = direction_or(at - read3(q, 0), (Real3)(0));
  for (uint i = 2; i < n; ++i) {
    at = walk_to(weights, i, read1(rest_length, i), at, read3(q, i), &direction, spheres, sphere_count);
    write3(q, i, at);
  }
}
#endif

__kernel __attribute__((reqd_work_group_size(ITEM_GROUP, 1, 1))) void advance_strands(
    __global Real* state, const __global BlockRow* blocks, const __global uint* which, uint which_count,
    const __global Real* region_reals, const __global int* region_ints, const __global Real* substep_reals,
    const __global int* substep_ints, const __global Real* spheres, uint substep_count, uint swapped) {
  const uint strand = get_global_id(0);
  const uint lane = strand % WIDTH;
  if (strand / WIDTH >= which_count) return;
  const BlockRow block = blocks[which[strand / WIDTH]];
  const uint n = block.vertices;
  __global Real* p = state + block.position + lane;
  const __global Real* const rest = state + block.rest + lane;

#ifdef HAS_RIDES
  if (block.rides) {
    const Head head = head_of(substep_reals + (substep_count - 1) * kSubstepReals);
    for (uint i = 0; i < n; ++i) write3(p, i, turn_with(head, read3(rest, i)));
    return;
  }
#endif

  __global Real* q = state + block.previous + lane;
  if (swapped) {
    __global Real* const other = p;
    p = q;
    q = other;
  }
  const __global Real* const region = region_reals + block.region * kRegionReals;
  const __global int* const counts = region_ints + block.region * kRegionInts;
  const Weights weights = weights_of(state, block, lane);

  for (uint s = 0; s < substep_count; ++s) {
    const __global Real* const substep = substep_reals + s * kSubstepReals;
    const Head head = head_of(substep);

    // Forces, integration and global shape: old positions in p, new ones over q.
    {
      const Real keep = region[s == 0 ? kKeepFirst : kKeep];
      const Real3 fall = fall_of(head, substep, region, keep);
#ifdef HAS_WIND
      const bool windy = counts[kWind];
      const Real3 wind = windy ? wind_of(substep, state + block.wind_weight + lane, region[kDragH2]) : (Real3)(0);
#endif
#ifdef HAS_GLOBAL_SHAPE
      const uint global_end = counts[kGlobalShape] ? block.global_end : 0;
#endif
#ifdef HAS_DIRECT_LENGTHS
      if (counts[kDirectLengths]) {
        return_tension(n, state + block.length + lane, state + block.tension + lane,
                       s == 0 ? region[kTensionFirst] : (Real)1, p, q);
      }
#endif
#ifdef HAS_ROD
      if (counts[kRod]) turn_on(rod_of(state, block, lane, weights, region, q), p, keep);
#endif
      write3(q, 0, turn_with(head, read3(rest, 0)));
      write3(q, 1, turn_with(head, read3(rest, 1)));
      Real3 before = read3(p, 1);
#ifdef HAS_SUPPORT
      Frame frame;  // before vertex i
      frame.x = frame.y = (Real3)(0);
      if (counts[kSupported]) {
        frame.x = turn_with(head, read3(state + block.root_frame + lane, 0));
        frame.y = turn_with(head, read3(state + block.root_frame + lane, 1));
      }
#endif
      for (uint i = 2; i < n; ++i) {
        const Real3 here = read3(p, i);
        Real3 accel_h2 = fall;
#ifdef HAS_WIND
        if (windy) accel_h2 = accel_h2 + wind_across(wind, here - before);
#endif
#ifdef HAS_SUPPORT
        if (counts[kSupported]) {
          if (LOCAL_METHOD_OF(counts) == 2) {
            frame.x = read3(state + block.frame_x + lane, i - 1);
            frame.y = read3(state + block.frame_y + lane, i - 1);
          }
          accel_h2 = accel_h2 + supported(frame, read3(state + block.support + lane, i), region[kH2]);
          if (LOCAL_METHOD_OF(counts) == 1) frame = turn_frame(frame, here - before);
        }
#endif
        Real3 moved = integrate(here, read3(q, i), keep, accel_h2);
#ifdef HAS_GLOBAL_SHAPE
        if (i < global_end) {
          const Real stiffness = region[kGlobalStiffness] * read1(state + block.fade + lane, i);
          moved = pull_to_goal(moved, turn_with(head, read3(rest, i)),
                               stiffness_at_step(stiffness, region[kStepRatio2]));
        }
#endif
#ifdef HAS_MASKED
        if (weights.masked && !(read1(weights.free, i) > (Real)0)) moved = turn_with(head, read3(rest, i));
#endif
        write3(q, i, moved);
        before = here;
      }
    }

#ifdef HAS_LOCAL_SHAPE
    if (counts[kLocalShape]) {
      const Real half_stiffness = (Real)0.5 * region[kLocalStiffness];
      const int method = LOCAL_METHOD_OF(counts);
      const __global Real* const local_edge = state + block.local_edge + lane;
      const __global Real* const remainder = state + block.remainder + lane;
      __global Real* const frame_x = state + block.frame_x + lane;
      __global Real* const frame_y = state + block.frame_y + lane;
      Frame root;
      root.x = root.y = (Real3)(0);
      if (method != 3) {
        const __global Real* const rest_frame = state + block.root_frame + lane;
        root.x = turn_with(head, read3(rest_frame, 0));
        root.y = turn_with(head, read3(rest_frame, 1));
      }
#ifdef HAS_REACTION
      const Real stiffness = region[kLocalStiffness];
      const __global Real* const lever = state + block.lever + lane;
      const __global Real* const rest_length = state + block.length + lane;
#endif
      for (int iteration = 0; iteration < counts[kLocalIterations]; ++iteration) {
#ifdef HAS_REACTION
        if (REACTS(counts) && method == 1) {
          Frame frame = root;
          Bend bend;
          bend.before = read3(q, 0);
          bend.near = read3(q, 1);
          for (uint i = 2; i < n; ++i) {
            bend.far = read3(q, i);
            react(weights, i, stiffness, frame, read3(local_edge, i), read3(remainder, i), read1(lever, i),
                  read1(rest_length, i), &bend);
            write3(q, i - 2, bend.before);
            frame = turn_frame(frame, bend.far - bend.near);
            bend.before = bend.near;
            bend.near = bend.far;
          }
          write3(q, n - 2, bend.before);
          write3(q, n - 1, bend.near);
          continue;
        }
#endif
        if (method == 1) {  // Algorithm 3
          Frame frame = root;
          Real3 near = read3(q, 1);
          for (uint i = 2; i < n; ++i) {
            Real3 far = read3(q, i);
            const Real3 d =
                local_shape_error(frame, read3(local_edge, i), read3(remainder, i), far - near) * half_stiffness;
            part(weights, i, d, &near, &far);
            write3(q, i - 1, near);
            frame = turn_frame(frame, far - near);
            near = far;
          }
          write3(q, n - 1, near);
          continue;
        }
        if (method == 2) {
          write3(frame_x, 1, root.x);
          write3(frame_y, 1, root.y);
        }
#ifdef HAS_REACTION
        for (uint batch = 2; batch <= 4 && REACTS(counts); ++batch) {
          for (uint i = batch; i < n; i += 3) {
            Frame frame;
            frame.x = read3(frame_x, i - 1);
            frame.y = read3(frame_y, i - 1);
            Bend bend;
            bend.before = read3(q, i - 2);
            bend.near = read3(q, i - 1);
            bend.far = read3(q, i);
            react(weights, i, stiffness, frame, read3(local_edge, i), read3(remainder, i), read1(lever, i),
                  read1(rest_length, i), &bend);
            write3(q, i - 2, bend.before);
            write3(q, i - 1, bend.near);
            write3(q, i, bend.far);
          }
        }
#endif
        for (uint batch = 2; batch <= 3 && !REACTS(counts); ++batch) {
          for (uint i = batch; i < n; i += 2) {
            Real3 near = read3(q, i - 1);
            Real3 far = read3(q, i);
            Real3 d;
            if (method == 2) {  // Algorithm 4
              Frame frame;
              frame.x = read3(frame_x, i - 1);
              frame.y = read3(frame_y, i - 1);
              d = local_shape_error(frame, read3(local_edge, i), read3(remainder, i), far - near) * half_stiffness;
            } else {  // Algorithm 5
              d = (turn_with(head, read3(rest, i) - read3(rest, i - 1)) - (far - near)) * half_stiffness;
            }
            part(weights, i, d, &near, &far);
            write3(q, i - 1, near);
            write3(q, i, far);
          }
        }
        // From the tip, so that each new frame still sees the old one before it.
        for (uint i = n - 1; method == 2 && i >= 2; --i) {
          Frame frame;
          frame.x = read3(frame_x, i - 1);
          frame.y = read3(frame_y, i - 1);
          frame = turn_frame(frame, read3(q, i) - read3(q, i - 1));
          write3(frame_x, i, frame.x);
          write3(frame_y, i, frame.y);
        }
      }
    }
#endif

#ifdef HAS_EDGE_LENGTHS
    for (int iteration = 0; iteration < counts[kLengthIterations]; ++iteration) {
      const __global Real* const length_of = state + block.length + lane;
      for (uint batch = 2; batch <= 3; ++batch) {
        for (uint i = batch; i < n; i += 2) {
          Real3 near = read3(q, i - 1);
          Real3 far = read3(q, i);
          hold_length(weights, i, read1(length_of, i), &near, &far);
          if (i > 2) write3(q, i - 1, near);
          write3(q, i, far);
        }
      }
    }
#endif

    const __global Real* const spheres_now = spheres + 4 * substep_ints[s * kSubstepInts + kSphereBegin];
    const int sphere_count = substep_ints[s * kSubstepInts + kSphereCount];
#ifdef HAS_DIRECT_LENGTHS
    if (counts[kDirectLengths]) {
      const __global Real* const length_of = state + block.length + lane;
      __global Real* const tension = state + block.tension + lane;
      __global Real* const elimination = state + block.elimination + lane;
      if (n > 2) apply_tension(weights, n, tension, elimination, q);
      for (int round = 0; round < LENGTH_ROUNDS && n > 2; ++round) {
        solve_lengths(weights, n, round == 0, length_of, tension, elimination, q);
      }
      sweep_lengths(weights, n, length_of, q, spheres_now, sphere_count);
    }
#endif

#ifdef HAS_ROD
    if (counts[kRod] && n > 2) {
      const __global Real* const rest_frame = state + block.root_frame + lane;
      Frame root;
      root.x = turn_with(head, read3(rest_frame, 0));
      root.y = turn_with(head, read3(rest_frame, 1));
      const Rod rod = rod_of(state, block, lane, weights, region, q);
      begin_rod(rod, root, p, region, state + block.fade + lane, counts[kGlobalShape] ? block.global_end : 0);
      run_rod(rod, counts[kRodIterations], spheres_now, sphere_count);
#ifdef HAS_SPHERES
      collide_rod(rod, spheres_now, sphere_count);
#endif
      hand_back(rod, drawn_scale(s == 0 ? region[kTensionFirst] : (Real)1), spheres_now, sphere_count);
    }
#endif

#ifdef HAS_SPHERES
    const int spheres_apart = counts[kDirectLengths] || counts[kRod] ? 0 : sphere_count;
    for (int k = 0; k < spheres_apart; ++k) {
      const __global Real* const sphere = spheres_now + 4 * k;
      for (uint i = 2; i < n; ++i) {
        const Real3 at = read3(q, i);
        if (!(squared_distance(at, triple(sphere)) < sphere[3] * sphere[3])) continue;
        write3(q, i, push_out_of_sphere(at, triple(sphere), sphere[3], free_weight(weights, i)));
      }
    }
#endif

    __global Real* const other = p;
    p = q;
    q = other;
  }
}
