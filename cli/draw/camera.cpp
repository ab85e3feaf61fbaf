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

float focal_length(float fov_deg, int height) {
  const double half_fov = std::clamp(static_cast<double>(fov_deg), 1.0, 120.0) * degree / 2;
  return static_cast<float>(height / 2.0 / std::tan(half_fov));
}

void require_size(int width, int height) {
  if (width > 0 && height > 0) return;
  throw std::invalid_argument("a picture of " + std::to_string(width) + " x " + std::to_string(height) +
                              " pixels cannot be drawn: both sides must be positive");
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

Framing::Framing(const View& view, int width, int height)
    : width_(width), height_(height), axes_(view.axes()), focal_(focal_length(view.fov_deg, height)) {
  require_size(width, height);
  const float keep = 1 - 2 * std::clamp(view.margin, 0.0f, 0.45f);
  free_ = keep / 2 * Eigen::Vector2f(static_cast<float>(width), static_cast<float>(height));
}

void Framing::add(std::span<const Eigen::Vector3f> points, const Eigen::Vector3f& shift) {
  Eigen::AlignedBox3f box = robust_bounds(points, axes_);
  if (box.isEmpty()) return;
  const Eigen::Vector3f moved = axes_ * shift;
  for (const Eigen::Vector3f& p : points) {
    const Eigen::Vector3f q = axes_ * p;
    if (box.contains(q)) add_extent(q - moved, Eigen::Matrix3f::Zero());
  }
}

void Framing::add(const Eigen::Vector3f& middle, const Eigen::Matrix3f& radii) {
  add_extent(axes_ * middle, axes_ * radii);
}

void Framing::add_extent(const Eigen::Vector3f& middle, const Eigen::Matrix3f& radii) {
  const Eigen::Vector3f half = radii.rowwise().norm();
  bounds_.extend(middle - half);
  bounds_.extend(middle + half);
  // A point q is inside for an eye e where focal |q - e|x <= free_x (e - q)z, and so with y: planes that move with e.
  for (int side = 0; side < 4; ++side) {
    Eigen::Vector3f normal(0, 0, free_[side / 2]);
    normal[side / 2] = side % 2 == 0 ? focal_ : -focal_;
    reach_[side] = std::max(reach_[side], normal.dot(middle) + (radii.transpose() * normal).norm());
  }
}

Eigen::Vector3f Framing::middle() const {
  if (bounds_.isEmpty()) return Eigen::Vector3f::Zero();
  return axes_.transpose() * (bounds_.min() / 2 + bounds_.max() / 2);
}

Camera::Camera(const Framing& framing)
    : width_(framing.width_), height_(framing.height_), focal_(framing.focal_), axes_(framing.axes_) {
  Framing seen = framing;
  if (seen.bounds_.isEmpty()) seen.add({0, 0, 0}, 0.15f * Eigen::Matrix3f::Identity());
  const Eigen::Vector3f middle = seen.bounds_.min() / 2 + seen.bounds_.max() / 2;
  const Eigen::Vector3f half = seen.bounds_.max() / 2 - seen.bounds_.min() / 2;
  // A thousandth of its distance from the origin keeps what has no size away from the rounding of its own place.
  const float least = std::max(1e-3f, 1e-3f * middle.cwiseAbs().maxCoeff());
  if (half.minCoeff() < least) seen.add_extent(middle, half.cwiseMax(least).asDiagonal());

  // The planes of two opposite sides meet in a line; the eye is where the farther one of the two lines is.
  const Eigen::Vector4f& reach = seen.reach_;
  const float distance =
      std::max((reach[0] + reach[1]) / (2 * seen.free_.x()), (reach[2] + reach[3]) / (2 * seen.free_.y()));
  near_ = 0.05f * (distance - seen.bounds_.max().z());
  eye_ = axes_.transpose() *
         Eigen::Vector3f((reach[0] - reach[1]) / (2 * focal_), (reach[2] - reach[3]) / (2 * focal_), distance);
}

Camera::Camera(const Eigen::AlignedBox3f& box, const View& view, int width, int height)
    : Camera([&] {
        Framing framing(view, width, height);
        for (int corner = 0; corner < 8 && !box.isEmpty(); ++corner) {
          framing.add_extent(box.corner(static_cast<Eigen::AlignedBox3f::CornerType>(corner)), Eigen::Matrix3f::Zero());
        }
        return framing;
      }()) {}

Camera::Camera(const Eigen::Vector3f& from, const Eigen::Vector3f& at, float fov_deg, int width, int height)
    : width_(width), height_(height), focal_(focal_length(fov_deg, height)), eye_(from) {
  require_size(width, height);
  const float distance = (from - at).norm();
  near_ = distance > 0 ? 0.01f * distance : 1e-3f;
  const Eigen::Vector3f back = distance > 0 ? Eigen::Vector3f((from - at) / distance) : Eigen::Vector3f::UnitZ();
  Eigen::Vector3f right = Eigen::Vector3f::UnitY().cross(back);
  right = right.norm() > 1e-4f ? right.normalized() : Eigen::Vector3f::UnitX();
  axes_.row(0) = right;
  axes_.row(1) = back.cross(right);
  axes_.row(2) = back;
}

Camera Camera::moved(const Eigen::Vector3f& by) const {
  Camera camera = *this;
  camera.eye_ += by;
  return camera;
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
