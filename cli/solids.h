// What hair lies on, as pictures show it.
#pragma once

#include <cstddef>
#include <optional>
#include <vector>

#include "cli/draw/shape.h"
#include "formats/cache.h"

namespace strandbake {

// The colliders of a cache, and a stand-in for the head where no collider is there.
class Solids {
 public:
  // The cache must outlive it.
  explicit Solids(const CacheReader& cache);
  // A little smaller than they are: hair that lies on a sphere goes straight from vertex to vertex, a little through
  // it.
  std::vector<Shape> at(std::size_t index) const;

 private:
  const CacheReader& cache_;
  std::optional<Shape> head_;  // at rest
};

}  // namespace strandbake
