#include "cli/draw/raster.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

namespace strandbake {
namespace {

constexpr int tile_size = 16;  // [pixels] a side: its fragments stay in the cache
// The order of the segments in a tile follows the chunks of lines, so their number must not depend on the threads.
constexpr std::size_t chunk_count = 64;

inline bool drawable(const LinePoint& p) {
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

  // Both points must be drawable, and not the same in the picture.
  Span(const LinePoint& p, const LinePoint& q) {
    const float dx = q.x - p.x, dy = q.y - p.y;
    // Not simply the longer one: rounding would toss a coin for each piece of a line at 45 degrees.
    steep = std::abs(dy) > 1.01f * std::abs(dx);
    const float da = steep ? dy : dx, db = steep ? dx : dy;
    reversed = da < 0;
    const LinePoint& first = reversed ? q : p;
    const LinePoint& last = reversed ? p : q;
    a0 = steep ? first.y : first.x;
    a1 = steep ? last.y : last.x;
    b0 = steep ? first.x : first.y;
    slope = db / da;
    half_thickness = std::sqrt(dx * dx + dy * dy) / (2 * std::abs(da));
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

// The share of a pixel that lies between two parallel lines, `high` and `low` above its lower edge in its middle, that
// rise by `rise` within it: exact. `per_rise` is 1 / rise, or 0 where the rise is too small to divide by.
inline float share_between(float low, float high, float rise, float per_rise) {
  if (per_rise == 0) return std::clamp(high, 0.0f, 1.0f) - std::clamp(low, 0.0f, 1.0f);
  // What lies below a line is the mean of clamp(t, 0, 1) over the t that the line takes.
  const float half = rise / 2;
  const Eigen::Array4f t(high + half, high - half, low + half, low - half);
  const Eigen::Array4f inside = t.max(0.0f).min(1.0f);
  const Eigen::Array4f integral = 0.5f * inside * inside + (t - 1.0f).max(0.0f);
  return per_rise * ((integral[0] - integral[1]) - (integral[2] - integral[3]));
}

// What one line leaves in one pixel.
struct Fragment {
  Eigen::Vector4f light;  // colour and depth, times alpha
  float alpha;
  std::int32_t behind;  // the fragment of the pixel that was made before this one, or -1
};

struct Order {
  float depth;
  std::int32_t fragment;
};

// Segments of one line that follow each other in a tile.
struct Run {
  float depth;  // of its nearest point
  std::size_t first, end;
};

// Lines come from the front to the back, roughly: a run is put where its nearest point is. A pixel that lets nothing
// through any more is closed for all that lies behind what it has, and a tile of closed pixels is done: of thick hair
// most is never drawn.
class Tile {
 public:
  // Empties the tile and puts its top left corner at pixel x, y.
  void start(int x, int y, const Canvas& canvas) {
    x0_ = x;
    y0_ = y;
    x1_ = std::min(x + tile_size, canvas.image.width);
    y1_ = std::min(y + tile_size, canvas.image.height);
    std::fill(std::begin(pixels_), std::end(pixels_), Pixel());
    fragments_.clear();
    step_ = 0;
    open_ = (x1_ - x0_) * (y1_ - y0_);
    farthest_ = 0;
    for (int py = y0_; py < y1_; ++py) {
      for (int px = x0_; px < x1_; ++px) {
        const std::size_t index = canvas.image.index(px, py);
        if (canvas.image.pixel[index][3] >= 1) close(pixels_[slot(px, py)], canvas.depth[index]);
      }
    }
  }

  // Whether nothing from that depth on can be seen.
  bool is_done(float depth) const { return open_ == 0 && depth > farthest_; }

  // Those of a run one after the other; a new run begins with `is_new_line`.
  void add(std::span<const LinePoint> points, std::uint64_t segment, bool is_new_line) {
    step_ += is_new_line ? 2 : 1;
    const LinePoint& p = points[segment];
    const LinePoint& q = points[segment + 1];
    const Span s(p, q);
    const LinePoint& start = s.reversed ? q : p;
    const LinePoint& end = s.reversed ? p : q;
    const auto a_low = static_cast<float>(s.steep ? y0_ : x0_), a_high = static_cast<float>(s.steep ? y1_ : x1_);
    const auto b_low = static_cast<float>(s.steep ? x0_ : y0_), b_high = static_cast<float>(s.steep ? x1_ : y1_);
    if (!(s.a0 < a_high && s.a1 > a_low)) return;
    const int a_first = static_cast<int>(std::max(s.a0, a_low)),
              a_last = static_cast<int>(std::min(s.a1, a_high - 0.5f));
    const float per_length = 1 / (s.a1 - s.a0), per_slope = 1 / std::max(std::abs(s.slope), 1e-6f);
    const Eigen::Vector4f light(start.color.x(), start.color.y(), start.color.z(), start.depth);
    const Eigen::Vector4f light_step = Eigen::Vector4f(end.color.x(), end.color.y(), end.color.z(), end.depth) - light;
    for (int a = a_first; a <= a_last; ++a) {
      const float from = std::max(s.a0, static_cast<float>(a)), to = std::min(s.a1, static_cast<float>(a + 1));
      const float part = to - from;
      if (!(part > 0)) continue;
      const float middle = (from + to) / 2 - s.a0;
      const float t = middle * per_length;
      const Eigen::Vector4f here = light + t * light_step;
      const float b = s.b0 + s.slope * middle;
      const float half = s.half_thickness * (start.width + t * (end.width - start.width));
      const float rise = std::abs(s.slope) * part;
      const float per_rise = rise < 1e-3f ? 0 : part == 1 ? per_slope : 1 / rise;
      const float reach = half + rise / 2;
      const int b_first = static_cast<int>(std::max(b - reach, b_low));
      const int b_last = static_cast<int>(std::min(b + reach, b_high - 0.5f));
      for (int k = b_first; k <= b_last; ++k) {
        Pixel& pixel = pixels_[s.steep ? slot(k, a) : slot(a, k)];
        if (here[3] > pixel.closed) continue;
        const float at = b - static_cast<float>(k);
        const float alpha = part * share_between(at - half, at + half, rise, per_rise);
        if (alpha > 0) put(pixel, alpha, here);
      }
    }
  }

  void blend(Canvas& canvas, std::vector<Order>& order) {
    for (int y = y0_; y < y1_; ++y) {
      for (int x = x0_; x < x1_; ++x) {
        if (pixels_[slot(x, y)].alpha == 0) continue;
        keep(pixels_[slot(x, y)]);
        const std::int32_t top = pixels_[slot(x, y)].top;
        order.clear();
        for (std::int32_t f = top; f >= 0; f = fragments_[static_cast<std::size_t>(f)].behind) {
          const Fragment& fragment = fragments_[static_cast<std::size_t>(f)];
          order.push_back({fragment.light[3] / fragment.alpha, f});
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
          if (clear < opaque) break;
          const Fragment& fragment = fragments_[static_cast<std::size_t>(o.fragment)];
          // Segments of one line that meet in a pixel can overlap where it bends.
          const float alpha = std::min(fragment.alpha, 1.0f);
          const float share = clear * alpha / fragment.alpha;
          sum.head<3>() += share * fragment.light.head<3>();
          sum[3] += clear * alpha;
          clear *= 1 - alpha;
        }
        if (!solid_done) sum += clear * solid;
        canvas.image.pixel[pixel] = sum;
      }
    }
  }

 private:
  static constexpr float opaque = 2e-3f;  // what shows through less than this is not looked at

  struct Pixel {
    // What the last line has left in it, which its next segment may add to; alpha is 0 where there was none.
    Eigen::Vector4f light = Eigen::Vector4f::Zero();  // colour and depth, times alpha
    float alpha = 0;
    std::uint32_t step = 0;                                 // of the line's last segment in it: see add()
    std::int32_t top = -1;                                  // the last fragment of other lines
    float clear = 1;                                        // what all these fragments let through
    float far = 0;                                          // depth of the farthest of them
    float closed = std::numeric_limits<float>::infinity();  // what lies behind this is hidden
  };

  std::size_t slot(int x, int y) const {
    return static_cast<std::size_t>(y - y0_) * tile_size + static_cast<std::size_t>(x - x0_);
  }

  void close(Pixel& pixel, float depth) {
    if (std::isinf(pixel.closed)) --open_;
    pixel.closed = depth;
    farthest_ = std::max(farthest_, depth);
  }

  void put(Pixel& pixel, float alpha, const Eigen::Vector4f& light) {
    // The next segment of the same line: side by side they cover more, they do not lie over each other.
    if (pixel.alpha > 0 && step_ - pixel.step > 1) keep(pixel);
    pixel.light += alpha * light;
    pixel.alpha += alpha;
    pixel.step = step_;
  }

  // Makes a fragment of what the last line has left.
  void keep(Pixel& pixel) {
    fragments_.push_back({pixel.light, pixel.alpha, pixel.top});
    pixel.top = static_cast<std::int32_t>(fragments_.size() - 1);
    pixel.clear *= 1 - std::min(pixel.alpha, 1.0f);
    pixel.far = std::max(pixel.far, pixel.light[3] / pixel.alpha);
    if (pixel.clear < opaque && std::isinf(pixel.closed)) close(pixel, pixel.far);
    pixel.light.setZero();
    pixel.alpha = 0;
  }

  int x0_ = 0, y0_ = 0, x1_ = 0, y1_ = 0;
  Pixel pixels_[tile_size * tile_size];
  int open_ = 0;        // pixels that are not closed
  float farthest_ = 0;  // of the depths at which pixels were closed
  std::uint32_t step_ = 0;
  std::vector<Fragment> fragments_;
};

}  // namespace

void draw_lines(Canvas& canvas, std::span<const LinePoint> points, std::span<const std::uint64_t> offset, int threads) {
  if (offset.size() < 2 || canvas.image.pixel.empty()) return;
  const int width = canvas.image.width, height = canvas.image.height;
  const int columns = (width + tile_size - 1) / tile_size, rows = (height + tile_size - 1) / tile_size;
  const auto tile_count = static_cast<std::size_t>(columns) * static_cast<std::size_t>(rows);
  const std::size_t lines = offset.size() - 1;

  // Sort the segments into tiles: list them, count, make room, fill. Within a tile they keep their order.
  struct Segment {
    std::uint64_t first;  // of its points
    float depth;  // of the nearer one: a look at the points of all segments would take longer than all else here
  };
  struct Place {
    std::uint32_t tile;
    float depth;
    std::uint64_t segment;
  };
  std::vector<std::vector<Place>> listed(chunk_count);
  std::vector<std::size_t> place(chunk_count * tile_count, 0);  // [chunk][tile]: count, then where to write
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (std::size_t chunk = 0; chunk < chunk_count; ++chunk) {
    const std::size_t first_line = chunk * lines / chunk_count, end_line = (chunk + 1) * lines / chunk_count;
    listed[chunk].reserve(2 * (offset[end_line] - offset[first_line]));
    for (std::size_t line = first_line; line < end_line; ++line) {
      bool is_drawable = offset[line] < offset[line + 1] && drawable(points[offset[line]]);
      for (std::uint64_t p = offset[line]; p + 1 < offset[line + 1]; ++p) {
        const bool is_point = points[p].x == points[p + 1].x && points[p].y == points[p + 1].y;
        const bool was_drawable = std::exchange(is_drawable, drawable(points[p + 1]));
        if (!was_drawable || !is_drawable || is_point) continue;
        const Span s(points[p], points[p + 1]);
        const float depth = std::min(points[p].depth, points[p + 1].depth);
        visit_tiles(s, std::max(points[p].width, points[p + 1].width), columns, rows, [&](int column, int row) {
          const std::size_t tile = static_cast<std::size_t>(row) * static_cast<std::size_t>(columns) + column;
          listed[chunk].push_back({static_cast<std::uint32_t>(tile), depth, p});
          ++place[chunk * tile_count + tile];
        });
      }
    }
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
  std::vector<Segment> segments(total);
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (std::size_t chunk = 0; chunk < chunk_count; ++chunk) {
    for (const Place& p : listed[chunk]) segments[place[chunk * tile_count + p.tile]++] = {p.segment, p.depth};
    listed[chunk] = {};
  }

#pragma omp parallel num_threads(threads)
  {
    Tile tile;
    std::vector<Order> order;
    std::vector<Run> runs;
#pragma omp for schedule(dynamic)
    for (std::size_t t = 0; t < tile_count; ++t) {
      if (first[t] == first[t + 1]) continue;
      runs.clear();
      for (std::size_t k = first[t]; k < first[t + 1]; ++k) {
        // A line's last point begins no segment, so those of two lines do not follow each other.
        if (runs.empty() || segments[k].first != segments[k - 1].first + 1) {
          runs.push_back({segments[k].depth, k, k + 1});
        } else {
          runs.back().depth = std::min(runs.back().depth, segments[k].depth);
          runs.back().end = k + 1;
        }
      }
      std::sort(runs.begin(), runs.end(), [](const Run& l, const Run& r) {
        return l.depth < r.depth || (l.depth == r.depth && l.first < r.first);
      });
      tile.start(static_cast<int>(t % static_cast<std::size_t>(columns)) * tile_size,
                 static_cast<int>(t / static_cast<std::size_t>(columns)) * tile_size, canvas);
      for (std::size_t r = 0; r < runs.size(); ++r) {
        const Run& run = runs[r];
        if (tile.is_done(run.depth)) break;
        constexpr std::size_t kAhead = 8;  // points lie all over memory
        if (r + kAhead < runs.size()) __builtin_prefetch(&points[segments[runs[r + kAhead].first].first]);
        for (std::size_t k = run.first; k < run.end; ++k) tile.add(points, segments[k].first, k == run.first);
      }
      tile.blend(canvas, order);
    }
  }
}

}  // namespace strandbake
