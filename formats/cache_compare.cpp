#include "formats/cache_compare.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <span>

#include "formats/frame_list.h"
#include "formats/quoted_list.h"
#include "sim/parallel.h"

namespace strandbake {

namespace {

// Distances counted by the first bits of the float above them: bins of a width of 1/128 of the distance.
class Histogram {
 public:
  void add(double distance) { ++bins_[bin_of(distance)]; }
  void add_zeros(std::size_t count) { bins_[0] += count; }
  void add(const Histogram& other) { std::ranges::transform(bins_, other.bins_, bins_.begin(), std::plus()); }
  // The upper end of the bin that brings the count to 99 %.
  double percentile_99() const {
    std::uint64_t all = 0, below = 0;
    for (const std::uint64_t count : bins_) all += count;
    std::size_t bin = 0;
    while (bin + 1 < bins_.size() && (below += bins_[bin]) < all - all / 100) ++bin;
    return bin == 0 ? 0 : static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(bin) << kShift));
  }

 private:
  static constexpr int kShift = 16;
  // A bin ends where the next begins: 0 holds 0 alone.
  static std::size_t bin_of(double distance) {
    const auto bits = std::bit_cast<std::uint32_t>(
        static_cast<float>(std::min(distance, static_cast<double>(std::numeric_limits<float>::max()))));
    return (bits + ((1U << kShift) - 1)) >> kShift;
  }
  std::vector<std::uint64_t> bins_ = std::vector<std::uint64_t>((std::size_t{1} << (32 - kShift - 1)) + 1);
};

// What a block of vertices adds to the distances of a frame.
struct Sum {
  double squares = 0;
  double largest = -1;  // squared
  std::size_t vertex = 0;
  std::size_t moved = 0;
};

// Sums up distances; blocks in order, so that threads leave no mark.
struct Total {
  double squares = 0, largest = -1;
  std::size_t vertex = 0, moved = 0, count = 0;
  int frame = 0;
  Histogram histogram;

  void add(const Sum& sum, int its_frame) {
    squares += sum.squares;
    moved += sum.moved;
    if (sum.largest > largest) {
      largest = sum.largest;
      vertex = sum.vertex;
      frame = its_frame;
    }
  }
  FrameDistances distances(const std::vector<std::uint64_t>& offset) const {
    FrameDistances found;
    if (count == 0) return found;
    const auto strand = std::ranges::upper_bound(offset, vertex) - offset.begin() - 1;
    found.largest = std::sqrt(largest);
    found.strand = static_cast<std::size_t>(strand);
    found.vertex = vertex - offset[found.strand];
    found.rms = std::sqrt(squares / static_cast<double>(count));
    found.percentile_99 = std::min(histogram.percentile_99(), found.largest);
    found.moved = moved;
    found.frame = frame;
    return found;
  }
};

std::string name_vertex(const std::vector<std::uint64_t>& offset, std::size_t vertex) {
  const auto strand = std::ranges::upper_bound(offset, vertex) - offset.begin() - 1;
  return fmt::format("strand {}, vertex {}", strand, vertex - offset[static_cast<std::size_t>(strand)]);
}

bool same_strands(const CacheHeader& a, const CacheHeader& b) {
  return a.offset == b.offset;
}

class Comparer {
 public:
  Comparer(const CacheReader& golden, const std::string& golden_name, const CacheReader& cache,
           const std::string& cache_name, const CompareOptions& options)
      : golden_(golden), golden_name_(golden_name), cache_(cache), cache_name_(cache_name), options_(options) {
    block_ = golden.block_vertices();
    const std::size_t blocks = (golden.vertex_count() + block_ - 1) / block_;
    sums_.resize(blocks);
    choose_vertices();
  }

  std::size_t count() const { return count_; }
  const std::vector<std::uint64_t>& offset() const { return golden_.header().offset; }

  // Adds a frame, by its index in both caches, to `total`.
  void add_frame(std::size_t golden_index, std::size_t cache_index, int frame, Total& total) {
    const auto read_golden = [&](std::size_t first, std::span<Eigen::Vector3f> out) {
      golden_.read_position(golden_index, first, out);
    };
    const auto read_cache = [&](std::size_t first, std::span<Eigen::Vector3f> out) {
      cache_.read_position(cache_index, first, out);
    };
    add(read_golden, read_cache, fmt::format("frame {}", frame), frame, total);
  }

  void add_rest(Total& total) {
    const auto copy = [](const CacheReader& cache) {
      return [&cache](std::size_t first, std::span<Eigen::Vector3f> out) {
        std::copy_n(cache.header().rest_position.begin() + static_cast<std::ptrdiff_t>(first), out.size(), out.begin());
      };
    };
    add(copy(golden_), copy(cache_), "at rest", 0, total);
  }

 private:
  using Read = std::function<void(std::size_t first, std::span<Eigen::Vector3f> out)>;

  void choose_vertices() {
    const CacheHeader& header = golden_.header();
    count_ = golden_.vertex_count();
    if (options_.regions.empty()) return;
    std::vector<bool> is_wanted(header.region_names.size());
    for (const std::string& region : options_.regions) {
      const auto found = std::ranges::find(header.region_names, region);
      if (found == header.region_names.end())
        throw InputError(
            fmt::format("{}: has no region \"{}\"; it has {}", golden_name_, region, quoted_list(header.region_names)));
      is_wanted[static_cast<std::size_t>(found - header.region_names.begin())] = true;
    }
    wanted_.resize(golden_.vertex_count());
    for (std::size_t strand = 0; strand < header.region.size(); ++strand) {
      if (is_wanted[header.region[strand]])
        std::fill(wanted_.begin() + static_cast<std::ptrdiff_t>(header.offset[strand]),
                  wanted_.begin() + static_cast<std::ptrdiff_t>(header.offset[strand + 1]), std::uint8_t{1});
    }
    count_ = static_cast<std::size_t>(std::ranges::count(wanted_, std::uint8_t{1}));
  }

  void add(const Read& read_golden, const Read& read_cache, const std::string& what, int frame, Total& total) {
    FirstException failure;
    const auto blocks = static_cast<std::ptrdiff_t>(sums_.size());
    std::vector<Histogram> histograms(static_cast<std::size_t>(options_.threads));
#pragma omp parallel num_threads(options_.threads)
    {
      std::vector<Eigen::Vector3f> a(block_), b(block_);
      Histogram histogram;
#pragma omp for schedule(dynamic, 1)
      for (std::ptrdiff_t block = 0; block < blocks; ++block) {
        failure.guard([&] {
          const std::size_t first = static_cast<std::size_t>(block) * block_;
          const std::size_t count = std::min(block_, golden_.vertex_count() - first);
          Sum& sum = sums_[static_cast<std::size_t>(block)];
          sum = {};
          if (!wanted_.empty() && std::find(&wanted_[first], &wanted_[first] + count, 1) == &wanted_[first] + count)
            return;
          const std::span<Eigen::Vector3f> golden(a.data(), count), cache(b.data(), count);
          read_golden(first, golden);
          read_cache(first, cache);
          measure(golden, cache, first, what, sum, histogram);
        });
      }
#pragma omp critical
      total.histogram.add(histogram);
    }
    failure.rethrow();
    for (const Sum& sum : sums_) total.add(sum, frame);
    total.count += count_;
  }

  void measure(std::span<const Eigen::Vector3f> golden, std::span<const Eigen::Vector3f> cache, std::size_t first,
               const std::string& what, Sum& sum, Histogram& histogram) const {
    require_finite(golden, first, what, golden_name_);
    if (wanted_.empty() && std::memcmp(golden.data(), cache.data(), golden.size_bytes()) == 0) {
      sum.largest = 0;
      sum.vertex = first;
      histogram.add_zeros(golden.size());
      return;
    }
    require_finite(cache, first, what, cache_name_);
    std::size_t same = 0;
    for (std::size_t v = 0; v < golden.size(); ++v) {
      if (!wanted_.empty() && wanted_[first + v] == 0) continue;
      const double square = (golden[v].cast<double>() - cache[v].cast<double>()).squaredNorm();
      if (square > sum.largest) {
        sum.largest = square;
        sum.vertex = first + v;
      }
      if (square == 0) {
        ++same;
        continue;
      }
      sum.squares += square;
      histogram.add(std::sqrt(square));
      ++sum.moved;
    }
    histogram.add_zeros(same);
  }

  void require_finite(std::span<const Eigen::Vector3f> vectors, std::size_t first, const std::string& what,
                      const std::string& name) const {
    const float* const numbers = vectors.data()->data();
    unsigned bad = 0;
    for (std::size_t k = 0; k < 3 * vectors.size(); ++k)
      bad |= static_cast<unsigned>(!(std::abs(numbers[k]) <= std::numeric_limits<float>::max()));
    if (bad == 0) return;
    const auto worst =
        std::ranges::find_if(vectors, [](const Eigen::Vector3f& position) { return !position.allFinite(); });
    throw InputError(fmt::format("{}: {}: {} is not a finite number; bake it again", name, what,
                                 name_vertex(offset(), first + static_cast<std::size_t>(worst - vectors.begin()))));
  }

  const CacheReader& golden_;
  const std::string& golden_name_;
  const CacheReader& cache_;
  const std::string& cache_name_;
  const CompareOptions& options_;
  std::size_t block_ = 0;             // vertices
  std::vector<Sum> sums_;             // [blocks]
  std::vector<std::uint8_t> wanted_;  // [vertices]; empty: all
  std::size_t count_ = 0;             // of them
};

}  // namespace

std::vector<std::string> compare_shapes(const CacheReader& golden, const CacheReader& cache,
                                        const CompareOptions& options) {
  std::vector<std::string> mismatches;
  const CacheHeader& a = golden.header();
  const CacheHeader& b = cache.header();
  const auto expect = [&](const std::string& what, const auto& golden_value, const auto& value) {
    if (golden_value != value) mismatches.push_back(fmt::format("{}: {} in place of {}", what, value, golden_value));
    return golden_value == value;
  };
  if (expect("strands", a.region.size(), b.region.size()) &&
      expect("vertices", golden.vertex_count(), cache.vertex_count()) && !same_strands(a, b)) {
    const auto [end, other] = std::ranges::mismatch(a.offset, b.offset);
    const auto strand = static_cast<std::size_t>(end - a.offset.begin()) - 1;
    expect(fmt::format("vertices of strand {}", strand), *end - a.offset[strand], *other - b.offset[strand]);
  }
  if (a.region_names != b.region_names) {
    mismatches.push_back(
        fmt::format("regions: {} in place of {}", quoted_list(b.region_names), quoted_list(a.region_names)));
  } else if (a.region.size() == b.region.size() && a.region != b.region) {
    const auto [region, other] = std::ranges::mismatch(a.region, b.region);
    expect(fmt::format("region of strand {}", region - a.region.begin()), a.region_names[*region],
           b.region_names[*other]);
  }
  expect("frames a second", a.fps, b.fps);
  compare_frame_lists(frames_of(golden, options.frames), frames_of(cache, options.frames), mismatches);
  return mismatches;
}

Comparison compare_caches(const CacheReader& golden, const std::string& golden_name, const CacheReader& cache,
                          const std::string& cache_name, const CompareOptions& options) {
  Comparison result;
  const auto of_golden = frames_of(golden, options.frames), of_cache = frames_of(cache, options.frames);
  if (options.frames && of_golden.empty())
    throw InputError(
        fmt::format("{}: has no frame from {} to {}", golden_name, options.frames->first, options.frames->second));
  result.mismatches = compare_shapes(golden, cache, options);
  Comparer comparer(golden, golden_name, cache, cache_name, options);
  if (!same_strands(golden.header(), cache.header())) return result;
  result.vertices = comparer.count();
  Total rest;
  comparer.add_rest(rest);
  result.rest = rest.distances(comparer.offset());
  Total all;
  for (const auto& [number, golden_index] : of_golden) {
    const auto found = of_cache.find(number);
    if (found == of_cache.end()) continue;
    Total frame;
    comparer.add_frame(golden_index, found->second, number, frame);
    result.frames.push_back(frame.distances(comparer.offset()));
    result.frames.back().frame = number;
    all.histogram.add(frame.histogram);
    all.add({frame.squares, frame.largest, frame.vertex, frame.moved}, number);
    all.count += frame.count;
  }
  result.all = all.distances(comparer.offset());
  return result;
}

}  // namespace strandbake
