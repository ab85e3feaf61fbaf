// Which frames of a cache are meant.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <vector>

#include "formats/cache.h"

namespace strandbake {

// Indices of every Nth frame whose number is in `range`, "100-120" or "7"; empty: all. `path` stands for the cache in
// messages. Throws InputError where there is none.
std::vector<std::size_t> choose_frames(const CacheReader& cache, const std::filesystem::path& path,
                                       const std::string& range, int every);

}  // namespace strandbake
