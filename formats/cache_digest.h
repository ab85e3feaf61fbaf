// A digest of a cache: a few lines of text a frame, small enough for version control, that a later bake is compared
// with. docs/CACHE.md describes the file.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "formats/cache.h"

namespace strandbake {

struct FrameDigest {
  int frame = 0;
  Eigen::Vector3f low{0, 0, 0}, high{0, 0, 0};  // bounds of all vertices, world [m]
  std::string rounded;                          // checksum of positions rounded to CacheDigest::step
  std::string exact;                            // checksum of the positions' bytes
};

// A checksum is the first half of a sha256, 32 hexadecimal digits, of little-endian numbers.
struct CacheDigest {
  double step = 0;  // a power of two [m]
  double fps = 0;
  std::size_t strands = 0, vertices = 0;
  std::string topology;  // checksum of offsets, regions and their names
  std::string rest;      // checksum of the groom at rest
  std::vector<FrameDigest> frames;
};

// Rounds to the largest power of two that is not above `step` [m, > 0]. Of `frames`, all where none are given; those
// that the cache has. Threads have no influence on the result. Throws InputError where the cache is damaged or a
// position is not finite; `name` stands for the cache there.
CacheDigest digest_cache(const CacheReader& cache, const std::string& name, double step,
                         const std::optional<std::pair<int, int>>& frames, int threads);

std::string digest_text(const CacheDigest& digest);
// Whether a file begins as a digest does. False where it cannot be read.
bool is_digest(const std::filesystem::path& path);
// Throws InputError with the line that is wrong.
CacheDigest read_digest(const std::filesystem::path& path);
CacheDigest parse_digest(const std::string& text, const std::string& name);

struct FrameAgreement {
  int frame = 0;
  // What is known about the largest distance between the two positions of a vertex [m].
  double at_least = 0;
  std::optional<double> at_most;  // none: the digests tell no bound
};

struct DigestComparison {
  std::vector<std::string> mismatches;  // what differs beside the positions, a sentence each
  std::vector<FrameAgreement> frames;   // that both have
};

DigestComparison compare_digests(const CacheDigest& golden, const CacheDigest& other,
                                 const std::optional<std::pair<int, int>>& frames);

}  // namespace strandbake
