// How far two caches are apart. Both are read block by block, so neither has to fit into memory.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "formats/cache.h"

namespace strandbake {

// Distances between the two positions of each vertex [m].
struct Distances {
  double largest = 0;
  std::size_t strand = 0, vertex = 0;  // where: the first of them; the vertex counts from the root
  double rms = 0;
  // 99 % of the vertices are not farther apart than this; at most 1 % too large, never too small.
  double percentile_99 = 0;
  std::size_t moved = 0;  // vertices that are not in the same place
};

struct FrameDistances : Distances {
  int frame = 0;
};

struct Comparison {
  // What differs beside the positions, a sentence each. Where strands are not the same, distances are left out.
  std::vector<std::string> mismatches;
  std::size_t vertices = 0;  // that were compared in each frame
  std::optional<Distances> rest;
  std::vector<FrameDistances> frames;  // that both have
  FrameDistances all;                  // over all of these
};

struct CompareOptions {
  std::optional<std::pair<int, int>> frames;  // none: all
  std::vector<std::string> regions;           // none: all
  int threads = 1;                            // no influence on the result
};

// What is not the same about strands, regions, frame rate and frames.
std::vector<std::string> compare_shapes(const CacheReader& golden, const CacheReader& cache,
                                        const CompareOptions& options);

// The names stand for the caches in messages. Throws InputError where a cache is damaged, holds a number that is not
// finite, or where there is no such region or frame.
Comparison compare_caches(const CacheReader& golden, const std::string& golden_name, const CacheReader& cache,
                          const std::string& cache_name, const CompareOptions& options);

}  // namespace strandbake
