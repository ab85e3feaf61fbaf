// What the strands of a picture are coloured by.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "formats/cache.h"

namespace strandbake {

enum class Coloring { Region, Stretch, Speed, Error };

// A value for each vertex of a frame.
class FrameValues {
 public:
  // `golden` is opened for Error, and for nothing else. Throws InputError where it cannot be used or has other strands.
  FrameValues(const CacheReader& cache, Coloring coloring, const std::filesystem::path& golden);

  // Stretch: the largest |length / rest length - 1| of the segments at a vertex, of those that are 1e-5 m long or more
  // at rest. Speed [m/s]: of the frame's velocities; where the cache has none, from where the vertex was a frame before
  // (in the first: where it is a frame later). Error [m]: the distance to the golden cache's vertex in the frame of
  // that number; throws InputError where it has no such frame. `position` is the frame as the cache has it.
  void read(std::size_t index, std::span<const Eigen::Vector3f> position, std::vector<float>& out);

  std::string name() const;
  // "5 %", "0.02 m", "1.5 m/s"
  std::string text(double value) const;

 private:
  const CacheReader& cache_;
  Coloring coloring_;
  std::filesystem::path golden_path_;
  std::optional<CacheReader> golden_;
  std::vector<Eigen::Vector3f> other_;  // velocities, or positions that the frame's are compared with
};

// The end of a scale for values up to about `most`: 1, 2 or 5 times a power of ten, not below it. 1 for what is not
// above 0.
double round_up_scale(double most);

}  // namespace strandbake
