#include "cli/draw/shape.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "cli/draw/light.h"

namespace strandbake {
namespace {

// A shape as a ray meets it: a unit ball in the space where `to_ball` leads.
struct Ball {
  Eigen::Matrix3f to_ball;
  Eigen::Vector3f eye;  // in the ball's space
  const Shape* shape;
};

struct Hit {
  int ball = -1;
  float distance = std::numeric_limits<float>::infinity();
};

Hit first_hit(const std::vector<Ball>& balls, const Eigen::Vector3f& ray, float nearest) {
  Hit hit;
  for (std::size_t b = 0; b < balls.size(); ++b) {
    const Eigen::Vector3f d = balls[b].to_ball * ray;
    const float a = d.squaredNorm(), half_b = d.dot(balls[b].eye), c = balls[b].eye.squaredNorm() - 1;
    const float root2 = half_b * half_b - a * c;
    if (!(root2 > 0)) continue;
    const float t = (-half_b - std::sqrt(root2)) / a;
    if (t > nearest && t < hit.distance) hit = {static_cast<int>(b), t};
  }
  return hit;
}

}  // namespace

Shape Shape::sphere(const Eigen::Vector3f& center, float radius) {
  Shape shape;
  shape.center = center;
  shape.radius = Eigen::Vector3f::Constant(radius);
  return shape;
}

Shape Shape::moved(const Eigen::Isometry3f& by) const {
  Shape shape = *this;
  shape.center = by * center;
  shape.axes = by.linear() * axes;
  return shape;
}

Eigen::AlignedBox3f Shape::bounds(const Eigen::Matrix3f& in_axes) const {
  const Eigen::Vector3f half = (in_axes * axes * radius.asDiagonal()).rowwise().norm();
  const Eigen::Vector3f middle = in_axes * center;
  return {middle - half, middle + half};
}

std::optional<Shape> fit_head(std::span<const Eigen::Vector3f> position, std::span<const std::uint64_t> offset) {
  std::vector<Eigen::Vector3d> roots;
  for (std::size_t s = 0; s + 1 < offset.size(); ++s) {
    if (offset[s] < offset[s + 1] && position[offset[s]].allFinite()) {
      roots.push_back(position[offset[s]].cast<double>());
    }
  }
  if (roots.size() < 16) return std::nullopt;
  const auto count = static_cast<double>(roots.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& r : roots) mean += r;
  mean /= count;

  // |p|^2 = 2 c.p + k is linear in the centre c and in k = r^2 - |c|^2; about the mean of the roots it is well
  // conditioned.
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  for (const auto& r : roots) {
    const Eigen::Vector3d p = r - mean;
    const Eigen::Vector4d row(2 * p.x(), 2 * p.y(), 2 * p.z(), 1);
    normal += row * row.transpose();
    right += row * p.squaredNorm();
  }
  const Eigen::Vector4d fit = normal.ldlt().solve(right);
  const Eigen::Vector3d center = fit.head<3>();
  const double radius = std::sqrt(fit[3] + center.squaredNorm());
  if (!(radius >= 0.03 && radius <= 0.4)) return std::nullopt;
  double sum2 = 0;
  for (const auto& r : roots) {
    const double off = (r - mean - center).norm() - radius;
    sum2 += off * off;
  }
  const double rms = std::sqrt(sum2 / count);
  if (!(rms < 0.25 * radius)) return std::nullopt;
  return Shape::sphere((center + mean).cast<float>(), static_cast<float>(std::max(0.97 * radius - rms, 0.8 * radius)));
}

void draw_shapes(Canvas& canvas, const Camera& camera, std::span<const Shape> shapes, const Studio& studio,
                 int threads) {
  std::vector<Ball> balls;
  for (const Shape& shape : shapes) {
    if (!(shape.radius.minCoeff() > 0) || !shape.radius.allFinite() || !shape.center.allFinite()) continue;
    const Eigen::Matrix3f to_ball = shape.radius.cwiseInverse().asDiagonal() * shape.axes.transpose();
    balls.push_back({to_ball, to_ball * (camera.eye() - shape.center), &shape});
  }
  if (balls.empty()) return;
  const Eigen::Vector3f forward = -camera.axes().row(2).transpose();

  const int width = camera.width(), height = camera.height();
  // Only the part of the picture where the shapes are; all of it where one reaches behind the eye.
  Eigen::AlignedBox2f place;
  for (const Ball& ball : balls) {
    const Eigen::AlignedBox3f bounds = ball.shape->bounds(camera.axes());
    for (int corner = 0; corner < 8; ++corner) {
      const Eigen::Vector3f world =
          camera.axes().transpose() * bounds.corner(static_cast<Eigen::AlignedBox3f::CornerType>(corner));
      const Eigen::Vector3f seen = camera.project(world);
      if (seen.z() > camera.near_depth() && seen.allFinite()) {
        place.extend(seen.head<2>());
      } else {
        place.extend(Eigen::Vector2f(0, 0));
        place.extend(Eigen::Vector2f(static_cast<float>(width), static_cast<float>(height)));
      }
    }
  }
  const auto clip = [](float v, int side) { return static_cast<int>(std::clamp(v, 0.0f, static_cast<float>(side))); };
  const int left = clip(place.min().x() - 1, width), right = clip(place.max().x() + 2, width);
  const int top = clip(place.min().y() - 1, height), bottom = clip(place.max().y() + 2, height);
#pragma omp parallel for schedule(dynamic, 8) num_threads(threads)
  for (int y = top; y < bottom; ++y) {
    for (int x = left; x < right; ++x) {
      // The corners tell whether an edge crosses the pixel; only then it takes 16 rays instead of one.
      const auto fx = static_cast<float>(x), fy = static_cast<float>(y);
      const Hit middle = first_hit(balls, camera.ray(fx + 0.5f, fy + 0.5f), camera.near_depth());
      bool edge = false;
      for (int corner = 0; corner < 4 && !edge; ++corner) {
        const Eigen::Vector3f ray =
            camera.ray(fx + static_cast<float>(corner & 1), fy + static_cast<float>(corner >> 1));
        edge = first_hit(balls, ray, camera.near_depth()).ball != middle.ball;
      }
      if (!edge && middle.ball < 0) continue;

      const int side = edge ? 4 : 1;
      Eigen::Vector3f color = Eigen::Vector3f::Zero();
      float depth = 0;
      int hits = 0;
      for (int sample = 0; sample < side * side; ++sample) {
        const int column = sample % side, row = sample / side;
        const float u = (static_cast<float>(column) + 0.5f) / static_cast<float>(side);
        const float v = (static_cast<float>(row) + 0.5f) / static_cast<float>(side);
        const Eigen::Vector3f ray = camera.ray(fx + u, fy + v);
        const Hit hit = first_hit(balls, ray, camera.near_depth());
        if (hit.ball < 0) continue;
        const Ball& ball = balls[static_cast<std::size_t>(hit.ball)];
        const Eigen::Vector3f normal =
            (ball.to_ball.transpose() * (ball.eye + hit.distance * (ball.to_ball * ray))).normalized();
        color += studio.shade(camera.eye() + hit.distance * ray, normal, -ray, ball.shape->color);
        depth += hit.distance * ray.dot(forward);
        ++hits;
      }
      if (hits == 0) continue;
      const float share = 1 / static_cast<float>(side * side);
      const std::size_t pixel = canvas.image.index(x, y);
      color *= share;
      canvas.image.pixel[pixel] = {color.x(), color.y(), color.z(), static_cast<float>(hits) * share};
      canvas.depth[pixel] = depth / static_cast<float>(hits);
    }
  }
}

}  // namespace strandbake
