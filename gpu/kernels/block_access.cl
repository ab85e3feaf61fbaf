// How kernels reach the state of a block. WIDTH strands lie side by side: number k of a row belongs to lane k.
//
// Constants of the program, from the plan: REAL, REAL3, WIDTH, ITEM_GROUP, VERTEX_GROUP; where anything uses the pass,
// HAS_MASKED, HAS_RIDES, HAS_WIND, HAS_SUPPORT, HAS_GLOBAL_SHAPE, HAS_LOCAL_SHAPE, HAS_REACTION (ALL_REACT: wherever
// there are local constraints), HAS_EDGE_LENGTHS (iterated), HAS_DIRECT_LENGTHS, HAS_ROD, HAS_ROD_STRETCH, HAS_SPHERES;
// HAS_FIGURES where frames are measured; LOCAL_METHOD where all regions with a strand per work-item agree on it;
// VERTICES_METHOD_..., see vertex_per_item.cl, for what is in use.

#define ROW (3 * WIDTH)

static Real3 read3(const __global Real* lane, uint i) {
  lane += (size_t)i * ROW;
  return (Real3)(lane[0], lane[WIDTH], lane[2 * WIDTH]);
}
static void write3(__global Real* lane, uint i, Real3 v) {
  lane += (size_t)i * ROW;
  lane[0] = v.x;
  lane[WIDTH] = v.y;
  lane[2 * WIDTH] = v.z;
}
static Real read1(const __global Real* lane, uint i) {
  return lane[(size_t)i * WIDTH];
}
static void write1(__global Real* lane, uint i, Real v) {
  lane[(size_t)i * WIDTH] = v;
}
static Real3 triple(const __global Real* v) {
  return (Real3)(v[0], v[1], v[2]);
}

#ifdef LOCAL_METHOD
#define LOCAL_METHOD_OF(counts) LOCAL_METHOD
#else
#define LOCAL_METHOD_OF(counts) (counts)[kLocalMethod]
#endif
#if !defined(HAS_REACTION)
#define REACTS(counts) 0
#elif defined(ALL_REACT)
#define REACTS(counts) 1
#else
#define REACTS(counts) (counts)[kReacts]
#endif

// The head of a substep.
typedef struct {
  Real3 row_x, row_y, row_z;
} Head;

static Head head_of(const __global Real* substep) {
  Head head;
  head.row_x = triple(substep + kRotation);
  head.row_y = triple(substep + kRotation + 3);
  head.row_z = triple(substep + kRotation + 6);
  return head;
}
static Real3 turn_with(Head head, Real3 v) {
  return rotate_by_rows(head.row_x, head.row_y, head.row_z, v);
}

// What a free vertex gains in a substep beside its velocity and the wind.
static Real3 fall_of(Head head, const __global Real* substep, const __global Real* region, Real keep) {
  return triple(region + kGravityH2) + shift_by_origin(triple(substep + kMoves), triple(substep + kMovedBefore), keep) +
         turn_with(head, triple(region + kSupportH2));
}

static Real3 wind_of(const __global Real* substep, const __global Real* weight_lane, Real drag_h2) {
  Real3 wind = (Real3)(0);
  for (uint j = 0; j < 4; ++j) {
    wind = wind + triple(substep + kWindVelocity + 3 * j) * (read1(weight_lane, j) * drag_h2);
  }
  return wind;
}

// Who is free in a masked block, and which segments exist; without it, all but the first two vertices, and all
// segments.
typedef struct {
  const __global Real *free, *active, *swept;
  bool masked;
} Weights;

static Weights weights_of(const __global Real* state, BlockRow block, uint lane) {
  Weights weights;
  weights.free = state + block.free + lane;
  weights.active = state + block.active + lane;
  weights.swept = state + block.swept + lane;
  weights.masked = block.masked != 0;
  return weights;
}

// A constraint between two vertices, with its corrections d for free ones.
static void part(Weights weights, uint i, Real3 d, Real3* near, Real3* far) {
#ifdef HAS_MASKED
  if (weights.masked) {
    d = d * read1(weights.active, i);
    *near = *near - d * read1(weights.free, i - 1);
    *far = *far + d * read1(weights.free, i);
    return;
  }
#endif
  if (i > 2) *near = *near - d;
  *far = *far + d;
}

static Real free_weight(Weights weights, uint i) {
#ifdef HAS_MASKED
  if (weights.masked) return read1(weights.free, i);
#endif
  return i < 2 ? (Real)0 : (Real)1;
}

#if defined(HAS_DIRECT_LENGTHS) || defined(HAS_ROD)
static bool is_swept(Weights weights, uint i) {
#ifdef HAS_MASKED
  if (weights.masked) return read1(weights.swept, i) > (Real)0;
#endif
  return true;
}
#endif

#ifdef HAS_REACTION
// The local constraint of vertex i with its reaction, on the three vertices that end there.
typedef struct {
  Real3 before, near, far;
} Bend;

static void react(Weights weights, uint i, Real stiffness, Frame frame, Real3 local_edge, Real3 remainder, Real lever,
                  Real length, Bend* bend) {
  const Real w_before = free_weight(weights, i - 2), w_near = free_weight(weights, i - 1);
  const Real share = shape_share(stiffness, shape_weight(lever * length, w_near, w_before));
  Real3 move = local_shape_error(frame, local_edge, remainder, bend->far - bend->near) * share;
#ifdef HAS_MASKED
  if (weights.masked) move = move * read1(weights.active, i);
#endif
  const Real3 back = shape_reaction(frame, local_edge, move, lever);
  bend->before = bend->before - back * w_before;
  bend->near = bend->near + (back - move) * w_near;
  bend->far = bend->far + move * free_weight(weights, i);
}
#endif

#ifdef HAS_EDGE_LENGTHS
// The iterated constraint on segment i.
static void hold_length(Weights weights, uint i, Real rest_length, Real3* near, Real3* far) {
  const Real3 edge = *far - *near;
  const Real w0 = free_weight(weights, i - 1), w1 = free_weight(weights, i);
  Real error = relative_length_error(edge, rest_length);
#ifdef HAS_MASKED
  if (weights.masked) error = error * read1(weights.active, i);
#endif
  *near = *near + edge * (error * edge_share(w0, w1));
  *far = *far - edge * (error * edge_share(w1, w0));
}
#endif

#ifdef HAS_DIRECT_LENGTHS
// Segment i in the equations of passes/direct_length.h.
typedef struct {
  Real3 direction;
  Real length, error, diagonal;
} Segment;

static Segment segment_of(Weights weights, uint i, Real rest_length, Real3 near, Real3 far) {
  Segment segment;
  const Real3 edge = far - near;
  const Real length = segment_length(edge);
  segment.length = length;
  segment.direction = segment_direction(edge, length);
  segment.error = length_error(length, rest_length);
  segment.diagonal = i == 2 ? (Real)1 : (Real)2;
#ifdef HAS_MASKED
  if (weights.masked) {
    const Real active = read1(weights.active, i);
    segment.direction = segment.direction * active;
    segment.error = segment.error * active;
    segment.diagonal =
        segment_diagonal(read1(weights.free, i - 1), read1(weights.free, i), active - read1(weights.swept, i));
  }
#endif
  return segment;
}

// One step of the exact walk: from `before` to vertex i, which the rounds have left at `far`; clear of the spheres.
static Real3 walk_to(Weights weights, uint i, Real rest_length, Real3 before, Real3 far, Real3* direction,
                     const __global Real* spheres, int sphere_count) {
  const bool swept = is_swept(weights, i);
  *direction = direction_or(far - before, *direction);
  Real3 at = far;
  if (swept) at = at_length(before, far, *direction, rest_length);
#ifdef HAS_SPHERES
  for (int k = 0; k < sphere_count; ++k) {
    const __global Real* const sphere = spheres + 4 * k;
    const Real3 center = triple(sphere);
    if (!(squared_distance(at, center) < sphere[3] * sphere[3])) continue;
    at = swept ? swing_out_of_sphere(at, before, rest_length, center, sphere[3])
               : push_out_of_sphere(at, center, sphere[3], free_weight(weights, i));
  }
#endif
  return at;
}
#endif
