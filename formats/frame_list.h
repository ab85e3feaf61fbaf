// Frames of a cache by their numbers.
#pragma once

#include <fmt/format.h>

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "formats/cache.h"

namespace strandbake {

// Index of each frame that lies within the range; all where none is given.
inline std::map<int, std::size_t> frames_of(const CacheReader& cache, const std::optional<std::pair<int, int>>& range) {
  std::map<int, std::size_t> frames;
  for (std::size_t index = 0; index < cache.frame_count(); ++index) {
    const int number = cache.frame_number(index);
    if (!range || (number >= range->first && number <= range->second)) frames.emplace(number, index);
  }
  return frames;
}

// "1-3, 7 and 9 more"
inline std::string list_frames(const std::vector<int>& frames) {
  constexpr int kMostRuns = 5;
  std::string text;
  std::size_t told = 0;
  for (int runs = 0; told < frames.size() && runs < kMostRuns; ++runs) {
    std::size_t last = told;
    while (last + 1 < frames.size() && frames[last + 1] == frames[last] + 1) ++last;
    text += text.empty() ? "" : ", ";
    text += last == told ? fmt::format("{}", frames[told]) : fmt::format("{}-{}", frames[told], frames[last]);
    told = last + 1;
  }
  if (told < frames.size()) text += fmt::format(" and {} more", frames.size() - told);
  return text;
}

// Appends which frames only one of the two has; both map the number of a frame to something.
template <class A, class B>
void compare_frame_lists(const std::map<int, A>& golden, const std::map<int, B>& other,
                         std::vector<std::string>& mismatches) {
  std::vector<int> missing, more;
  for (const auto& entry : golden)
    if (!other.contains(entry.first)) missing.push_back(entry.first);
  for (const auto& entry : other)
    if (!golden.contains(entry.first)) more.push_back(entry.first);
  if (!missing.empty()) mismatches.push_back(fmt::format("frames that are missing: {}", list_frames(missing)));
  if (!more.empty()) mismatches.push_back(fmt::format("frames that are too many: {}", list_frames(more)));
}

}  // namespace strandbake
