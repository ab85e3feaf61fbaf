// A lane is a strand: W numbers that are always treated alike, in one or more vector registers.
//
// A small type of our own on the compilers' vector extension: the passes below need + - * / sqrt, three comparisons and
// a select, and with it they read the same for float, double and lanes. Every operation is rounded by itself (IEEE
// 754), so a strand's result does not depend on W.
//
// Files that are compiled for an instruction set beyond the machine's least (lanes_*.cpp here, the probes of the
// benchmarks) must not share any inline function with the rest of the program; all of this one's are always inlined.
#pragma once

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace strandbake {

// Vectors of W numbers and of the masks that comparing them gives.
template <class Scalar, int W>
struct VectorOf;
template <int W>
struct VectorOf<float, W> {
  typedef float Numbers __attribute__((vector_size(W * sizeof(float))));
  typedef int Masks __attribute__((vector_size(W * sizeof(int))));
};
template <int W>
struct VectorOf<double, W> {
  typedef double Numbers __attribute__((vector_size(W * sizeof(double))));
  typedef long long Masks __attribute__((vector_size(W * sizeof(long long))));
};

template <class Scalar, int W>
struct LaneMask {
  using Masks = typename VectorOf<Scalar, W>::Masks;
  Masks v;

  // Does the comparison hold in any lane?
  friend inline __attribute__((always_inline)) bool any(LaneMask m) {
#if defined(__AVX512F__)
    if constexpr (sizeof(Masks) == 64) return _mm512_test_epi32_mask((__m512i)m.v, (__m512i)m.v) != 0;
#endif
#if defined(__AVX__)
    if constexpr (sizeof(Masks) == 32) return _mm256_movemask_ps((__m256)m.v) != 0;
#endif
#if defined(__SSE2__)
    if constexpr (sizeof(Masks) == 16) return _mm_movemask_ps((__m128)m.v) != 0;
#endif
    bool found = false;
    for (int lane = 0; lane < W; ++lane) found |= m.v[lane] != 0;
    return found;
  }
};

#define STRANDBAKE_LANE_FN friend inline __attribute__((always_inline))

template <class Scalar_, int W>
struct Lanes {
  using Scalar = Scalar_;
  static constexpr int width = W;
  using Vector = typename VectorOf<Scalar, W>::Numbers;
  using Mask = LaneMask<Scalar, W>;

  Vector v;

  Lanes() = default;
  inline __attribute__((always_inline)) Lanes(Scalar a) : v(a - Vector{}) {}  // a - 0 is a, bit for bit
  inline __attribute__((always_inline)) explicit Lanes(Vector a) : v(a) {}

  STRANDBAKE_LANE_FN Lanes operator+(Lanes a, Lanes b) { return Lanes(a.v + b.v); }
  STRANDBAKE_LANE_FN Lanes operator-(Lanes a, Lanes b) { return Lanes(a.v - b.v); }
  STRANDBAKE_LANE_FN Lanes operator*(Lanes a, Lanes b) { return Lanes(a.v * b.v); }
  STRANDBAKE_LANE_FN Lanes operator/(Lanes a, Lanes b) { return Lanes(a.v / b.v); }
  STRANDBAKE_LANE_FN Mask operator<(Lanes a, Lanes b) { return Mask{a.v < b.v}; }
  STRANDBAKE_LANE_FN Mask operator>(Lanes a, Lanes b) { return Mask{a.v > b.v}; }
  STRANDBAKE_LANE_FN Lanes select(Mask m, Lanes a, Lanes b) { return Lanes(m.v ? a.v : b.v); }
  STRANDBAKE_LANE_FN Lanes square_root(Lanes a) {
    // By intrinsics: compilers do not reliably make a vector of a loop of square roots. (The zeroing form of AVX-512 is
    // the plain one to the processor; GCC 12 warns about the plain one.)
#if defined(__AVX512F__)
    if constexpr (sizeof(Vector) == 64 && sizeof(Scalar) == 4)
      return Lanes((Vector)_mm512_maskz_sqrt_ps(0xffff, (__m512)a.v));
    if constexpr (sizeof(Vector) == 64 && sizeof(Scalar) == 8)
      return Lanes((Vector)_mm512_maskz_sqrt_pd(0xff, (__m512d)a.v));
#endif
#if defined(__AVX__)
    if constexpr (sizeof(Vector) == 32 && sizeof(Scalar) == 4) return Lanes((Vector)_mm256_sqrt_ps((__m256)a.v));
    if constexpr (sizeof(Vector) == 32 && sizeof(Scalar) == 8) return Lanes((Vector)_mm256_sqrt_pd((__m256d)a.v));
#endif
#if defined(__SSE2__)
    if constexpr (sizeof(Vector) == 16 && sizeof(Scalar) == 4) return Lanes((Vector)_mm_sqrt_ps((__m128)a.v));
    if constexpr (sizeof(Vector) == 16 && sizeof(Scalar) == 8) return Lanes((Vector)_mm_sqrt_pd((__m128d)a.v));
#endif
    Lanes r = a;
    for (int lane = 0; lane < W; ++lane) {
      if constexpr (sizeof(Scalar) == 4) {
        r.v[lane] = __builtin_sqrtf(a.v[lane]);
      } else {
        r.v[lane] = __builtin_sqrt(a.v[lane]);
      }
    }
    return r;
  }
};

#undef STRANDBAKE_LANE_FN

}  // namespace strandbake
