#include "cli/frames.h"

#include <fmt/format.h>

#include "formats/scene.h"

namespace strandbake {

std::vector<std::size_t> choose_frames(const CacheReader& cache, const std::filesystem::path& path,
                                       const std::string& range, int every) {
  if (cache.frame_count() == 0) throw InputError(fmt::format("{}: holds no frame yet", path.string()));
  std::size_t first = 0, last = cache.frame_count() - 1;
  if (!range.empty()) {
    const auto [low, high] = parse_frames(range);
    while (first < last && cache.frame_number(first) < low) ++first;
    while (last > first && cache.frame_number(last) > high) --last;
    if (cache.frame_number(first) < low || cache.frame_number(last) > high)
      throw InputError(fmt::format("{}: has no frame among {}", path.string(), range));
  }
  std::vector<std::size_t> chosen;
  for (std::size_t k = first; k <= last; k += static_cast<std::size_t>(every)) chosen.push_back(k);
  return chosen;
}

}  // namespace strandbake
