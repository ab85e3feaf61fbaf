// The photographer's studio: three lamps and a soft sky, and how much of each the hair lets through.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "cli/draw/camera.h"
#include "cli/draw/shape.h"

namespace strandbake {

// What a box of space lets through: cubes that know how much hair and how much solid is in them.
class Occlusion {
 public:
  // Cubes such that the longest side of the box has `resolution` of them. The box may be empty or have no size.
  Occlusion(const Eigen::AlignedBox3f& box, int resolution);

  // Hair of that projected area [m^2] around a point.
  void add(const Eigen::Vector3f& point, float area);
  // What was added to another one of the same box. Sums are whole numbers, so their order does not matter.
  void add(const Occlusion& other);
  // Fills what lies inside the shapes. Call it after the last add().
  void fill(std::span<const Shape> shapes);
  // The same content in cubes of twice the side.
  Occlusion coarser() const;

  // How many times over the way from each cube to a light far away is blocked: 0 is clear. `toward_light` is a unit
  // vector. One number a cube, for sample().
  std::vector<float> depth_toward(const Eigen::Vector3f& toward_light) const;
  // The value of a field with one entry a cube, trilinear; places outside take the nearest cube.
  float sample(const std::vector<float>& field, const Eigen::Vector3f& point) const;
  Eigen::Vector4f sample(const std::vector<Eigen::Vector4f>& field, const Eigen::Vector3f& point) const;

  float cube() const { return cube_; }  // side [m]
  std::size_t size() const { return blocked_.size(); }

 private:
  Occlusion() = default;

  Eigen::Vector3f origin_{0, 0, 0};
  float cube_ = 1;
  Eigen::Vector3i count_{1, 1, 1};
  std::vector<std::uint32_t> added_;  // in 1/1024 of a cube's face
  std::vector<float> blocked_;        // optical depth of the way through a cube
};

struct Lamp {
  Eigen::Vector3f direction;  // unit vector toward it
  Eigen::Vector3f color;
};

// Optical depth toward each lamp, and the share of the sky that is open.
struct Visibility {
  Eigen::Vector4f depth;  // the fourth is not used
  float sky;
};

class Studio {
 public:
  // Lamps stand around the camera: key at the upper left, fill at the right, rim behind. `hair` holds all hair, and the
  // shapes.
  Studio(const Camera& camera, const Occlusion& hair, int threads);

  // All lamps at once, a row each; the fourth is dark.
  const Eigen::Matrix<float, 4, 3>& directions() const { return directions_; }
  const Eigen::Matrix<float, 4, 3>& colors() const { return colors_; }
  const Eigen::Vector3f& sky() const { return sky_; }
  Visibility visibility(const Eigen::Vector3f& point) const;
  // A matte surface.
  Eigen::Vector3f shade(const Eigen::Vector3f& point, const Eigen::Vector3f& normal, const Eigen::Vector3f& to_eye,
                        const Eigen::Vector3f& color) const;

 private:
  std::array<Lamp, 3> lamps_;
  Eigen::Matrix<float, 4, 3> directions_, colors_;
  Eigen::Vector3f sky_;
  const Occlusion* hair_;
  Occlusion coarse_;
  std::vector<Eigen::Vector4f> toward_lamp_;  // of hair_: key, fill, rim, and nothing
  std::vector<float> open_sky_;
};

// exp(-x) for x >= 0 within 0.02, without a call that machines round differently.
inline float fade(float x) {
  return 1 / (1 + x * (1 + x * (0.5f + x * (1.0f / 6 + x / 24))));
}
inline Eigen::Array4f fade(const Eigen::Array4f& x) {
  return (1 + x * (1 + x * (0.5f + x * (1.0f / 6 + x / 24)))).inverse();
}

}  // namespace strandbake
