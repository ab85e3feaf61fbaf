#include "cli/draw/light.h"

#include <algorithm>
#include <cmath>

namespace strandbake {
namespace {

constexpr float unit = 1024;  // of added_

// The eight cubes around a point and their weights; f(index, weight).
template <class F>
void visit_corners(const Eigen::Vector3f& place, const Eigen::Vector3i& count, F f) {
  std::size_t near[3], far[3];  // parts of the index
  float part[3];
  std::size_t stride = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const float v = std::clamp(place[axis], 0.0f, static_cast<float>(count[axis] - 1));
    const int low = static_cast<int>(v);
    part[axis] = v - static_cast<float>(low);
    near[axis] = static_cast<std::size_t>(low) * stride;
    far[axis] = low + 1 < count[axis] ? near[axis] + stride : near[axis];
    stride *= static_cast<std::size_t>(count[axis]);
  }
  for (int corner = 0; corner < 8; ++corner) {
    const bool x = corner & 1, y = corner & 2, z = corner & 4;
    f((x ? far[0] : near[0]) + (y ? far[1] : near[1]) + (z ? far[2] : near[2]),
      (x ? part[0] : 1 - part[0]) * (y ? part[1] : 1 - part[1]) * (z ? part[2] : 1 - part[2]));
  }
}

}  // namespace

Occlusion::Occlusion(const Eigen::AlignedBox3f& box, int resolution) {
  if (!box.isEmpty()) {
    const Eigen::Vector3f middle = box.min() / 2 + box.max() / 2;
    const float least = std::max(1e-6f, 1e-5f * middle.cwiseAbs().maxCoeff());
    cube_ = std::max((box.max() - box.min()).maxCoeff() / static_cast<float>(resolution), least);
    for (int axis = 0; axis < 3; ++axis) {
      // A free cube on each side, so that light comes in unhindered.
      count_[axis] = static_cast<int>(std::ceil((box.max()[axis] - box.min()[axis]) / cube_)) + 3;
    }
    origin_ = middle - cube_ / 2 * (count_.cast<float>() - Eigen::Vector3f::Ones());
  }
  const std::size_t cubes = static_cast<std::size_t>(count_.x()) * count_.y() * count_.z();
  added_.assign(cubes, 0);
  blocked_.assign(cubes, 0);
}

void Occlusion::add(const Eigen::Vector3f& point, float area) {
  const Eigen::Vector3f place = (point - origin_) / cube_;
  if (!((place.array() >= 0).all() && (place.array() <= (count_.array() - 1).cast<float>()).all())) return;
  const float amount = unit * std::min(area / (cube_ * cube_), 8.0f);
  visit_corners(place, count_, [&](std::size_t index, float weight) {
    const auto whole = static_cast<std::uint32_t>(weight * amount + 0.5f);
    added_[index] += whole;
  });
}

void Occlusion::add(const Occlusion& other) {
  for (std::size_t c = 0; c < added_.size(); ++c) added_[c] += other.added_[c];
}

void Occlusion::fill(std::span<const Shape> shapes) {
  constexpr float solid = 3;
  for (std::size_t c = 0; c < blocked_.size(); ++c) blocked_[c] = static_cast<float>(added_[c]) / unit;
  for (const Shape& shape : shapes) {
    if (!(shape.radius.minCoeff() > 0) || !shape.radius.allFinite()) continue;
    const Eigen::Matrix3f to_ball = shape.radius.cwiseInverse().asDiagonal() * shape.axes.transpose();
    const float softness = 2 * shape.radius.minCoeff() / cube_;
    std::size_t index = 0;
    for (int z = 0; z < count_.z(); ++z) {
      for (int y = 0; y < count_.y(); ++y) {
        for (int x = 0; x < count_.x(); ++x, ++index) {
          const Eigen::Vector3f place(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z));
          const float inside = 1 - (to_ball * (origin_ + cube_ * place - shape.center)).norm();
          if (inside > 0) blocked_[index] += solid * std::min(inside * softness, 1.0f);
        }
      }
    }
  }
}

Occlusion Occlusion::coarser() const {
  Occlusion half;
  half.cube_ = 2 * cube_;
  half.count_ = (count_.array() + 1) / 2;
  half.origin_ = origin_ + Eigen::Vector3f::Constant(cube_ / 2);
  half.blocked_.assign(static_cast<std::size_t>(half.count_.x()) * half.count_.y() * half.count_.z(), 0);
  std::size_t index = 0;
  for (int z = 0; z < count_.z(); ++z) {
    for (int y = 0; y < count_.y(); ++y) {
      for (int x = 0; x < count_.x(); ++x, ++index) {
        // Four ways of two cubes side by side make one way.
        const std::size_t to = (static_cast<std::size_t>(z / 2) * half.count_.y() + y / 2) * half.count_.x() + x / 2;
        half.blocked_[to] += blocked_[index] / 4;
      }
    }
  }
  return half;
}

std::vector<float> Occlusion::depth_toward(const Eigen::Vector3f& toward_light) const {
  // Slice by slice away from the light, along the axis that it is closest to: what a cube sees of the slice before it
  // is interpolated between four cubes, and the shift is the same for the whole slice.
  int along = 0;
  toward_light.cwiseAbs().maxCoeff(&along);
  const int u = (along + 1) % 3, v = (along + 2) % 3;
  const std::array<std::size_t, 3> stride = {1, static_cast<std::size_t>(count_.x()),
                                             static_cast<std::size_t>(count_.x()) * count_.y()};
  const float step = std::abs(toward_light[along]);
  const bool light_is_up = toward_light[along] > 0;
  const float way = 1 / step;  // through one slice, in cubes
  const float shift_u = toward_light[u] / step, shift_v = toward_light[v] / step;
  const int low_u = static_cast<int>(std::floor(shift_u)), low_v = static_cast<int>(std::floor(shift_v));
  const float part_u = shift_u - static_cast<float>(low_u), part_v = shift_v - static_cast<float>(low_v);

  std::vector<float> depth(blocked_.size(), 0);
  const int nu = count_[u], nv = count_[v];
  const int slices = count_[along];
  for (int k = 1; k < slices; ++k) {
    const int slice = light_is_up ? slices - 1 - k : k;
    const int before = light_is_up ? slice + 1 : slice - 1;
    const auto seen = [&](int at_u, int at_v) {
      if (at_u < 0 || at_v < 0 || at_u >= nu || at_v >= nv) return 0.0f;
      const std::size_t index = static_cast<std::size_t>(before) * stride[static_cast<std::size_t>(along)] +
                                static_cast<std::size_t>(at_u) * stride[static_cast<std::size_t>(u)] +
                                static_cast<std::size_t>(at_v) * stride[static_cast<std::size_t>(v)];
      return depth[index] + way * blocked_[index];
    };
    for (int b = 0; b < nv; ++b) {
      for (int a = 0; a < nu; ++a) {
        const std::size_t index = static_cast<std::size_t>(slice) * stride[static_cast<std::size_t>(along)] +
                                  static_cast<std::size_t>(a) * stride[static_cast<std::size_t>(u)] +
                                  static_cast<std::size_t>(b) * stride[static_cast<std::size_t>(v)];
        const float near_v = (1 - part_u) * seen(a + low_u, b + low_v) + part_u * seen(a + low_u + 1, b + low_v);
        const float far_v = (1 - part_u) * seen(a + low_u, b + low_v + 1) + part_u * seen(a + low_u + 1, b + low_v + 1);
        depth[index] = (1 - part_v) * near_v + part_v * far_v;
      }
    }
  }
  return depth;
}

float Occlusion::sample(const std::vector<float>& field, const Eigen::Vector3f& point) const {
  float sum = 0;
  visit_corners((point - origin_) / cube_, count_,
                [&](std::size_t index, float weight) { sum += weight * field[index]; });
  return sum;
}

Eigen::Vector4f Occlusion::sample(const std::vector<Eigen::Vector4f>& field, const Eigen::Vector3f& point) const {
  Eigen::Vector4f sum = Eigen::Vector4f::Zero();
  visit_corners((point - origin_) / cube_, count_,
                [&](std::size_t index, float weight) { sum += weight * field[index]; });
  return sum;
}

Studio::Studio(const Camera& camera, const Occlusion& hair, int threads) : hair_(&hair), coarse_(hair.coarser()) {
  const auto lamp = [&](float right, float up, float back, const Eigen::Vector3f& color) {
    return Lamp{camera.axes().transpose() * Eigen::Vector3f(right, up, back).normalized(), color};
  };
  lamps_ = {lamp(-0.60f, 0.75f, 0.60f, {3.00f, 2.85f, 2.65f}), lamp(0.85f, 0.05f, 0.60f, {0.62f, 0.72f, 0.88f}),
            lamp(0.55f, 0.55f, -0.75f, {2.20f, 2.30f, 2.50f})};
  directions_.setZero();
  colors_.setZero();
  for (Eigen::Index l = 0; l < 3; ++l) {
    directions_.row(l) = lamps_[static_cast<std::size_t>(l)].direction;
    colors_.row(l) = lamps_[static_cast<std::size_t>(l)].color;
  }
  sky_ = {0.62f, 0.66f, 0.72f};

  // The sky: six sides and eight corners, brighter from above.
  std::vector<Eigen::Vector3f> sides;
  for (int axis = 0; axis < 3; ++axis) {
    sides.push_back(Eigen::Vector3f::Unit(axis));
    sides.push_back(-Eigen::Vector3f::Unit(axis));
  }
  for (int corner = 0; corner < 8; ++corner) {
    sides.push_back(
        Eigen::Vector3f(corner & 1 ? 1.0f : -1.0f, corner & 2 ? 1.0f : -1.0f, corner & 4 ? 1.0f : -1.0f).normalized());
  }
  std::vector<std::vector<float>> depth(sides.size()), lamp_depth(lamps_.size());
  const int lamp_count = static_cast<int>(lamps_.size()), side_count = static_cast<int>(sides.size());
#pragma omp parallel for schedule(dynamic) num_threads(threads)
  for (int d = 0; d < lamp_count + side_count; ++d) {
    if (d < lamp_count) {
      lamp_depth[static_cast<std::size_t>(d)] = hair.depth_toward(lamps_[static_cast<std::size_t>(d)].direction);
    } else {
      const auto side = static_cast<std::size_t>(d - lamp_count);
      depth[side] = coarse_.depth_toward(sides[side]);
    }
  }
  toward_lamp_.resize(hair.size());
  for (std::size_t c = 0; c < hair.size(); ++c) {
    toward_lamp_[c] = {lamp_depth[0][c], lamp_depth[1][c], lamp_depth[2][c], 0};
  }
  float whole = 0;
  open_sky_.assign(coarse_.size(), 0);
  for (std::size_t side = 0; side < sides.size(); ++side) {
    const float brightness = 1 + 0.7f * sides[side].y();
    whole += brightness;
    for (std::size_t c = 0; c < open_sky_.size(); ++c) open_sky_[c] += brightness * fade(0.8f * depth[side][c]);
  }
  for (float& open : open_sky_) open /= whole;
}

Visibility Studio::visibility(const Eigen::Vector3f& point) const {
  return {hair_->sample(toward_lamp_, point), coarse_.sample(open_sky_, point)};
}

Eigen::Vector3f Studio::shade(const Eigen::Vector3f& point, const Eigen::Vector3f& normal,
                              const Eigen::Vector3f& to_eye, const Eigen::Vector3f& color) const {
  const Visibility seen = visibility(point + 1.5f * hair_->cube() * normal);
  Eigen::Vector3f light = sky_ * seen.sky * (0.75f + 0.25f * normal.y());
  for (std::size_t l = 0; l < lamps_.size(); ++l) {
    const float facing = std::max(0.0f, (normal.dot(lamps_[l].direction) + 0.15f) / 1.15f);
    light += lamps_[l].color * (0.5f * facing * fade(seen.depth[static_cast<Eigen::Index>(l)]));
  }
  // A little sheen where the surface turns away.
  const float grazing = 1 - std::max(0.0f, normal.dot(to_eye));
  const float sheen = 0.08f * grazing * grazing * grazing * seen.sky;
  return color.cwiseProduct(light) + Eigen::Vector3f::Constant(sheen);
}

}  // namespace strandbake
