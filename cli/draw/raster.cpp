#include "cli/draw/raster.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace strandbake {
namespace {

constexpr int tile_size = 16;  // [pixels] a side: its fragments stay in the cache
// The order of the segments in a tile follows the chunks of lines, so their number must not depend on the threads.
constexpr std::size_t chunk_count = 64;

bool drawable(const LinePoint& p) {
  constexpr float far_away = 1e5f;
  return std::abs(p.x) < far_away && std::abs(p.y) < far_away && p.depth > 0 && std::isfinite(p.depth) && p.width > 0 &&
         p.width < far_away && p.color.allFinite();
}

// A segment seen along the axis in which it is longer (about): a is the place along that axis, b across it, a grows
// from start to end. It is the set of places with a between a0 and a1 and b within half_thickness of the line.
struct Span {
  bool steep;  // a is y, b is x
  float a0, a1, b0, slope;
  float half_thickness;  // along b [pixels], per pixel of width
  bool reversed;         // the start is the segment's second point

  static bool make(const LinePoint& p, const LinePoint& q, Span& s) {
    if (!drawable(p) || !drawable(q)) return false;
    const float dx = q.x - p.x, dy = q.y - p.y;
    // Not simply the longer one: rounding would toss a coin for each piece of a line at 45 degrees.
    s.steep = std::abs(dy) > 1.01f * std::abs(dx);
    const float da = s.steep ? dy : dx, db = s.steep ? dx : dy;
    if (da == 0) return false;
    s.reversed = da < 0;
    const LinePoint& first = s.reversed ? q : p;
    const LinePoint& last = s.reversed ? p : q;
    s.a0 = s.steep ? first.y : first.x;
    s.a1 = s.steep ? last.y : last.x;
    s.b0 = s.steep ? first.x : first.y;
    s.slope = db / da;
    s.half_thickness = std::sqrt(dx * dx + dy * dy) / (2 * std::abs(da));
    return true;
  }
};

// The tiles that a segment can touch: f(tile column, tile row), once each.
template <class F>
void visit_tiles(const Span& s, float width, int columns, int rows, F f) {
  const float reach = s.half_thickness * width + 1;
  const int a_tiles = s.steep ? rows : columns, b_tiles = s.steep ? columns : rows;
  const auto tile_of = [](float v) { return static_cast<int>(std::floor(v / tile_size)); };
  const int a_first = std::max(tile_of(s.a0), 0), a_last = std::min(tile_of(s.a1), a_tiles - 1);
  for (int a = a_first; a <= a_last; ++a) {
    const float from = std::max(s.a0, static_cast<float>(a * tile_size));
    const float to = std::min(s.a1, static_cast<float>((a + 1) * tile_size));
    const float b_from = s.b0 + s.slope * (from - s.a0), b_to = s.b0 + s.slope * (to - s.a0);
    const int b_first = std::max(tile_of(std::min(b_from, b_to) - reach), 0);
    const int b_last = std::min(tile_of(std::max(b_from, b_to) + reach), b_tiles - 1);
    for (int b = b_first; b <= b_last; ++b) {
      if (s.steep) {
        f(b, a);
      } else {
        f(a, b);
      }
    }
  }
}

// The share of the interval 0 .. 1 that lies below u + shift, averaged over shifts uniform in -rise / 2 .. rise / 2.
// With a line that rises by `rise` within a pixel column it is the exact area below the line in a pixel.
float share_below(float u, float rise) {
  const float low = u - rise / 2, high = u + rise / 2;
  if (low >= 1) return 1;
  if (high <= 0) return 0;
  if (rise < 1e-3f) return std::clamp(u, 0.0f, 1.0f);
  // The integral of clamp(t, 0, 1).
  const auto integral = [](float t) { return t <= 0 ? 0.0f : t < 1 ? t * t / 2 : t - 0.5f; };
  return (integral(high) - integral(low)) / rise;
}

// What one line leaves in one pixel.
struct Fragment {
  Eigen::Vector3f color;  // times alpha
  float alpha;
  float depth;            // times alpha
  std::uint64_t segment;  // the last one that is in it
  std::int32_t below;     // the fragment of the pixel before this one, or -1
};

struct Order {
  float depth;
  std::int32_t fragment;
};

class Tile {
 public:
  // Empties the tile and puts its top left corner at pixel x, y of a picture of that size.
  void start(int x, int y, int width, int height) {
    x0_ = x;
    y0_ = y;
    x1_ = std::min(x + tile_size, width);
    y1_ = std::min(y + tile_size, height);
    std::fill(std::begin(top_), std::end(top_), -1);
    fragments_.clear();
  }

  void add(std::span<const LinePoint> points, std::uint64_t segment) {
    const LinePoint& p = points[segment];
    const LinePoint& q = points[segment + 1];
    Span s;
    if (!Span::make(p, q, s)) return;
    const LinePoint& start = s.reversed ? q : p;
    const LinePoint& end = s.reversed ? p : q;
    const int a_low = s.steep ? y0_ : x0_, a_high = s.steep ? y1_ : x1_;
    const int b_low = s.steep ? x0_ : y0_, b_high = s.steep ? x1_ : y1_;
    const int a_first = std::max(static_cast<int>(std::floor(s.a0)), a_low);
    const int a_last = std::min(static_cast<int>(std::floor(s.a1)), a_high - 1);
    const float per_length = 1 / (s.a1 - s.a0);
    for (int a = a_first; a <= a_last; ++a) {
      const float from = std::max(s.a0, static_cast<float>(a)), to = std::min(s.a1, static_cast<float>(a + 1));
      const float part = to - from;
      if (!(part > 0)) continue;
      const float middle = (from + to) / 2 - s.a0;
      const float t = middle * per_length;
      const float b = s.b0 + s.slope * middle;
      const float half = s.half_thickness * (start.width + t * (end.width - start.width));
      const float rise = std::abs(s.slope) * part;
      const float reach = half + rise / 2;
      const int b_first = std::max(static_cast<int>(std::floor(b - reach)), b_low);
      const int b_last = std::min(static_cast<int>(std::floor(b + reach)), b_high - 1);
      if (b_first > b_last) continue;
      const Eigen::Vector3f color = start.color + t * (end.color - start.color);
      const float depth = start.depth + t * (end.depth - start.depth);
      for (int k = b_first; k <= b_last; ++k) {
        const float at = b - static_cast<float>(k);
        const float alpha = part * (share_below(at + half, rise) - share_below(at - half, rise));
        if (alpha > 0) put(s.steep ? k : a, s.steep ? a : k, alpha, color, depth, segment);
      }
    }
  }

  void blend(Canvas& canvas, std::vector<Order>& order) const {
    for (int y = y0_; y < y1_; ++y) {
      for (int x = x0_; x < x1_; ++x) {
        const std::int32_t top = top_[slot(x, y)];
        if (top < 0) continue;
        order.clear();
        for (std::int32_t f = top; f >= 0; f = fragments_[static_cast<std::size_t>(f)].below) {
          const Fragment& fragment = fragments_[static_cast<std::size_t>(f)];
          order.push_back({fragment.depth / fragment.alpha, f});
        }
        std::sort(order.begin(), order.end(), [](const Order& l, const Order& r) {
          return l.depth < r.depth || (l.depth == r.depth && l.fragment < r.fragment);
        });
        const std::size_t pixel = canvas.image.index(x, y);
        const Eigen::Vector4f solid = canvas.image.pixel[pixel];
        const float solid_depth = canvas.depth[pixel];
        Eigen::Vector4f sum = Eigen::Vector4f::Zero();
        float clear = 1;  // what still shows through
        bool solid_done = false;
        for (const Order& o : order) {
          if (!solid_done && solid_depth <= o.depth) {
            sum += clear * solid;
            clear *= 1 - solid[3];
            solid_done = true;
          }
          if (clear < 1e-3f) break;
          const Fragment& fragment = fragments_[static_cast<std::size_t>(o.fragment)];
          // Segments of one line that meet in a pixel can overlap where it bends.
          const float alpha = std::min(fragment.alpha, 1.0f);
          const float share = clear * alpha / fragment.alpha;
          sum.head<3>() += share * fragment.color;
          sum[3] += clear * alpha;
          clear *= 1 - alpha;
        }
        if (!solid_done) sum += clear * solid;
        canvas.image.pixel[pixel] = sum;
      }
    }
  }

 private:
  std::size_t slot(int x, int y) const {
    return static_cast<std::size_t>(y - y0_) * tile_size + static_cast<std::size_t>(x - x0_);
  }

  void put(int x, int y, float alpha, const Eigen::Vector3f& color, float depth, std::uint64_t segment) {
    std::int32_t& top = top_[slot(x, y)];
    if (top >= 0) {
      // The next segment of the same line: side by side they cover more, they do not lie over each other.
      Fragment& last = fragments_[static_cast<std::size_t>(top)];
      if (segment - last.segment <= 1) {
        last.color += alpha * color;
        last.alpha += alpha;
        last.depth += alpha * depth;
        last.segment = segment;
        return;
      }
    }
    fragments_.push_back({alpha * color, alpha, alpha * depth, segment, top});
    top = static_cast<std::int32_t>(fragments_.size() - 1);
  }

  int x0_ = 0, y0_ = 0, x1_ = 0, y1_ = 0;
  std::int32_t top_[tile_size * tile_size];
  std::vector<Fragment> fragments_;
};

}  // namespace

void draw_lines(Canvas& canvas, std::span<const LinePoint> points, std::span<const std::uint64_t> offset, int threads) {
  if (offset.size() < 2 || canvas.image.pixel.empty()) return;
  const int width = canvas.image.width, height = canvas.image.height;
  const int columns = (width + tile_size - 1) / tile_size, rows = (height + tile_size - 1) / tile_size;
  const auto tile_count = static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows);
  const std::size_t lines = offset.size() - 1;

  // Sort the segments into tiles: count, make room, fill. Within a tile they keep their order.
  const auto visit_chunk = [&](std::size_t chunk, auto f) {
    for (std::size_t line = chunk * lines / chunk_count; line < (chunk + 1) * lines / chunk_count; ++line) {
      for (std::uint64_t p = offset[line]; p + 1 < offset[line + 1]; ++p) {
        Span s;
        if (!Span::make(points[p], points[p + 1], s)) continue;
        visit_tiles(s, std::max(points[p].width, points[p + 1].width), columns, rows, [&](int column, int row) {
          f(static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + column, p);
        });
      }
    }
  };
  std::vector<std::size_t> place(chunk_count * tile_count, 0);  // [chunk][tile]: count, then where to write
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (std::size_t chunk = 0; chunk < chunk_count; ++chunk) {
    visit_chunk(chunk, [&](std::size_t tile, std::uint64_t) { ++place[chunk * tile_count + tile]; });
  }
  std::vector<std::size_t> first(tile_count + 1, 0);
  std::size_t total = 0;
  for (std::size_t tile = 0; tile < tile_count; ++tile) {
    first[tile] = total;
    for (std::size_t chunk = 0; chunk < chunk_count; ++chunk) {
      const std::size_t count = place[chunk * tile_count + tile];
      place[chunk * tile_count + tile] = total;
      total += count;
    }
  }
  first[tile_count] = total;
  std::vector<std::uint64_t> segments(total);
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (std::size_t chunk = 0; chunk < chunk_count; ++chunk) {
    visit_chunk(chunk, [&](std::size_t tile, std::uint64_t p) { segments[place[chunk * tile_count + tile]++] = p; });
  }

#pragma omp parallel num_threads(threads)
  {
    Tile tile;
    std::vector<Order> order;
#pragma omp for schedule(dynamic)
    for (std::size_t t = 0; t < tile_count; ++t) {
      if (first[t] == first[t + 1]) continue;
      tile.start(static_cast<int>(t % static_cast<std::size_t>(columns)) * tile_size,
                 static_cast<int>(t / static_cast<std::size_t>(columns)) * tile_size, width, height);
      for (std::size_t k = first[t]; k < first[t + 1]; ++k) tile.add(points, segments[k]);
      tile.blend(canvas, order);
    }
  }
}

}  // namespace strandbake
