// Solid things beside the hair: colliders and the stand-in for the head.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <span>

#include "cli/draw/camera.h"
#include "cli/draw/canvas.h"

namespace strandbake {

class Studio;

// An ellipsoid with a matte surface.
struct Shape {
  Eigen::Vector3f center{0, 0, 0};                     // world [m]
  Eigen::Vector3f radius{0, 0, 0};                     // [m], > 0 to be drawn
  Eigen::Matrix3f axes = Eigen::Matrix3f::Identity();  // columns: the directions of the three radii
  Eigen::Vector3f color{0.27f, 0.225f, 0.20f};         // linear light

  static Shape sphere(const Eigen::Vector3f& center, float radius);
  Shape moved(const Eigen::Isometry3f& by) const;
  // Its box along the rows of `in_axes`.
  Eigen::AlignedBox3f bounds(const Eigen::Matrix3f& in_axes) const;
};

// A head for hair that comes without one: the sphere that fits the roots best, a little smaller so that the roots lie
// outside. None where the roots do not look like a scalp: fewer than 16 of them, a radius outside 0.03 .. 0.4 m, or a
// root mean square distance to the sphere of a quarter of the radius and more. `position` in metres, `offset` as Groom.
std::optional<Shape> fit_head(std::span<const Eigen::Vector3f> position, std::span<const std::uint64_t> offset);

// Draws the shapes on an empty canvas: colour, coverage as alpha, depth. Edges are smooth. The bytes do not depend on
// the number of threads.
void draw_shapes(Canvas& canvas, const Camera& camera, std::span<const Shape> shapes, const Studio& studio,
                 int threads);

}  // namespace strandbake
