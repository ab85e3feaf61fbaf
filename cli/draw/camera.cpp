#include "cli/draw/camera.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>
#include <string>
#include <vector>

namespace strandbake {
namespace {

constexpr double degree = std::numbers::pi / 180;

bool in_reach(const Eigen::Vector3f& p) {
  return p.allFinite() && p.cwiseAbs().maxCoeff() <= farthest;
}

}  // namespace

Eigen::Matrix3f View::axes() const {
  const double azimuth = azimuth_deg * degree;
  const double elevation = std::clamp(static_cast<double>(elevation_deg), -89.0, 89.0) * degree;
  const double ca = std::cos(azimuth), sa = std::sin(azimuth), ce = std::cos(elevation), se = std::sin(elevation);
  Eigen::Matrix3d rows;
  rows << ca, 0, -sa, -sa * se, ce, -ca * se, sa * ce, se, ca * ce;
  return rows.cast<float>();
}

Camera::Camera(const Eigen::AlignedBox3f& box, const View& view, int width, int height)
    : width_(width), height_(height), axes_(view.axes()) {
  if (width <= 0 || height <= 0) {
    throw std::invalid_argument("a picture of " + std::to_string(width) + " x " + std::to_string(height) +
                                " pixels cannot be drawn: both sides must be positive");
  }
  const double half_fov = std::clamp(static_cast<double>(view.fov_deg), 1.0, 120.0) * degree / 2;
  focal_ = static_cast<float>(height / 2.0 / std::tan(half_fov));

  Eigen::AlignedBox3f seen = box;
  if (seen.isEmpty()) seen = Eigen::AlignedBox3f(Eigen::Vector3f::Constant(-0.15f), Eigen::Vector3f::Constant(0.15f));
  const Eigen::Vector3f middle = seen.min() / 2 + seen.max() / 2;
  Eigen::Vector3f half = seen.max() / 2 - seen.min() / 2;
  // A thousandth of its distance from the origin keeps a box without size away from the rounding of its own place.
  half = half.cwiseMax(std::max(1e-3f, 1e-3f * middle.cwiseAbs().maxCoeff()));

  // A corner at (x, y, z) in camera axes about the middle lands inside when |x| focal / (distance - z) <= free half
  // side.
  const float keep = 1 - 2 * std::clamp(view.margin, 0.0f, 0.45f);
  const float free_x = keep * static_cast<float>(width) / 2, free_y = keep * static_cast<float>(height) / 2;
  float distance = 0, nearest = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3f c((corner & 1 ? 1.0f : -1.0f) * half.x(), (corner & 2 ? 1.0f : -1.0f) * half.y(),
                            (corner & 4 ? 1.0f : -1.0f) * half.z());
    distance = std::max(distance, c.z() + focal_ * std::max(std::abs(c.x()) / free_x, std::abs(c.y()) / free_y));
    nearest = std::max(nearest, c.z());
  }
  near_ = 0.05f * (distance - nearest);
  eye_ = axes_.transpose() * (middle + distance * Eigen::Vector3f::UnitZ());
}

Eigen::Vector3f Camera::project(const Eigen::Vector3f& point) const {
  const Eigen::Vector3f c = axes_ * (point - eye_);
  const float depth = -c.z();
  const float scale = focal_ / depth;
  return {static_cast<float>(width_) / 2 + scale * c.x(), static_cast<float>(height_) / 2 - scale * c.y(), depth};
}

Eigen::Vector3f Camera::ray(float x, float y) const {
  const Eigen::Vector3f c((x - static_cast<float>(width_) / 2) / focal_, (static_cast<float>(height_) / 2 - y) / focal_,
                          -1);
  return axes_.transpose() * c.normalized();
}

Eigen::AlignedBox3f robust_bounds(std::span<const Eigen::Vector3f> points, const Eigen::Matrix3f& axes) {
  // Quartiles need no more than a sample.
  const std::size_t stride = points.size() / 65536 + 1;
  std::vector<float> values[3];
  for (std::size_t p = 0; p < points.size(); p += stride) {
    if (!in_reach(points[p])) continue;
    const Eigen::Vector3f q = axes * points[p];
    for (int axis = 0; axis < 3; ++axis) values[axis].push_back(q[axis]);
  }
  Eigen::AlignedBox3f fence;
  if (!values[0].empty()) {
    Eigen::Vector3f low, high;
    const auto quarter = static_cast<std::ptrdiff_t>(values[0].size() / 4);
    for (int axis = 0; axis < 3; ++axis) {
      auto& v = values[axis];
      std::nth_element(v.begin(), v.begin() + quarter, v.end());
      low[axis] = v[static_cast<std::size_t>(quarter)];
      std::nth_element(v.begin(), v.end() - 1 - quarter, v.end());
      high[axis] = v[v.size() - 1 - static_cast<std::size_t>(quarter)];
    }
    const float reach = 3 * (high - low).maxCoeff();
    fence = Eigen::AlignedBox3f(low - Eigen::Vector3f::Constant(reach), high + Eigen::Vector3f::Constant(reach));
  }
  Eigen::AlignedBox3f box;
  for (const Eigen::Vector3f& p : points) {
    if (!in_reach(p)) continue;
    const Eigen::Vector3f q = axes * p;
    if (fence.contains(q)) box.extend(q);
  }
  return box;
}

}  // namespace strandbake
