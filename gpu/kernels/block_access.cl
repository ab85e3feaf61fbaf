// How kernels reach the state of a block. WIDTH strands lie side by side: number k of a row belongs to lane k.
//
// Constants of the program, from the plan: REAL, REAL3, WIDTH, ITEM_GROUP, VERTEX_GROUP; HAS_MASKED, HAS_RIDES, HAS_WIND,
// HAS_GLOBAL_SHAPE, HAS_LOCAL_SHAPE, HAS_EDGE_LENGTHS, HAS_SPHERES where anything uses the pass; LOCAL_METHOD where all
// regions with a strand per work-item agree on it; VERTICES_METHOD_..., see vertex_per_item.cl, for what is in use.

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
static Real3 triple(const __global Real* v) {
  return (Real3)(v[0], v[1], v[2]);
}

#ifdef LOCAL_METHOD
#define LOCAL_METHOD_OF(counts) LOCAL_METHOD
#else
#define LOCAL_METHOD_OF(counts) (counts)[kLocalMethod]
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
static Real3 fall_of(const __global Real* substep, const __global Real* region, Real keep) {
  return triple(region + kGravityH2) + shift_by_origin(triple(substep + kMoves), triple(substep + kMovedBefore), keep);
}

static Real3 wind_of(const __global Real* substep, const __global Real* weight_lane, Real drag_h2) {
  Real3 wind = (Real3)(0);
  for (uint j = 0; j < 4; ++j) {
    wind = wind + triple(substep + kWindVelocity + 3 * j) * (read1(weight_lane, j) * drag_h2);
  }
  return wind;
}
