#include "cli/solids.h"

#include <algorithm>

namespace strandbake {

Solids::Solids(const CacheReader& cache)
    : cache_(cache), head_(fit_head(cache.header().rest_position, cache.header().offset)) {
  if (!head_ || cache.frame_count() == 0) return;
  const Eigen::Vector3d middle = cache.head(0) * head_->center.cast<double>();
  const auto is_head = [&](const Sphere& sphere) { return (sphere.center - middle).norm() < sphere.radius; };
  if (std::ranges::any_of(cache.colliders(0), is_head)) head_.reset();
}

std::vector<Shape> Solids::at(std::size_t index) const {
  constexpr double kShown = 0.98;
  std::vector<Shape> shapes;
  for (const Sphere& sphere : cache_.colliders(index))
    shapes.push_back(Shape::sphere(sphere.center.cast<float>(), static_cast<float>(kShown * sphere.radius)));
  if (head_) shapes.push_back(head_->moved(cache_.head(index).cast<float>()));
  return shapes;
}

}  // namespace strandbake
