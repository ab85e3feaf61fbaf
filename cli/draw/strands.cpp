#include "cli/draw/strands.h"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

#include "cli/draw/light.h"
#include "cli/draw/raster.h"

namespace strandbake {
namespace {

constexpr int grid_resolution = 96;
constexpr float curve_error = 0.12f;  // [pixels] that a piece is off the curve, about
constexpr float most_pixels = 32;     // a piece is about so long at most, as light is interpolated along it
constexpr int most_pieces = 12;       // per segment

// 0 .. 1, different for each strand and each use.
float chance(std::uint64_t strand, std::uint32_t use) {
  std::uint32_t h = static_cast<std::uint32_t>(strand ^ strand >> 32) * 2654435769u + use * 2246822519u;
  h ^= h >> 16;
  h *= 2146121005u;
  h ^= h >> 15;
  h *= 2221713035u;
  h ^= h >> 16;
  return static_cast<float>(h >> 8) / 16777216.0f;
}

Eigen::Vector3f unit_or(const Eigen::Vector3f& v, const Eigen::Vector3f& otherwise) {
  const float length = v.norm();
  return length > 0 && std::isfinite(length) ? Eigen::Vector3f(v / length) : otherwise;
}

// A bell of that width about 0, as a Gaussian near its middle.
Eigen::Array4f bell(const Eigen::Array4f& x, float width) {
  const Eigen::Array4f u = x / width;
  return (1 + u.square() / 8).square().square().inverse();
}

Eigen::Vector3f square_root(const Eigen::Vector3f& c) {
  return c.cwiseMax(0.0f).cwiseSqrt();
}

struct StrandLook {
  Eigen::Vector3f color;
  float tilt;       // of its cuticle: moves the highlights along the strand
  float gloss = 1;  // of the highlights
};

StrandLook look_of(std::uint64_t strand, std::uint32_t region) {
  const float tone = 0.72f + 0.56f * chance(strand, 1);
  const float warmth = chance(strand, 2) - 0.5f;
  const Eigen::Vector3f shift(1 + 0.16f * warmth, 1, 1 - 0.24f * warmth);
  return {tone * region_color(region).cwiseProduct(shift), 0.10f * (chance(strand, 3) - 0.5f)};
}

// Light that a strand sends to the eye. Lobes as Marschner et al. 2003 name them: R off the surface, TT through the
// fibre, TRT off its far side; `along` runs 0 .. 1 from root to tip.
Eigen::Vector3f shade(const Studio& studio, const Visibility& seen, const Eigen::Vector3f& tangent,
                      const Eigen::Vector3f& to_eye, const StrandLook& look, float along) {
  const Eigen::Vector3f base = look.color;
  const Eigen::Vector3f bright = square_root(base);
  const float eye_along = tangent.dot(to_eye);
  const Eigen::Vector3f eye_across = to_eye - eye_along * tangent;
  const float eye_sine = std::sqrt(std::max(1 - eye_along * eye_along, 1e-4f));
  Eigen::Vector3f sum = studio.sky().cwiseProduct(base) * (0.55f * seen.sky * seen.sky + 0.25f * seen.sky);
  // A lane is a lamp.
  const Eigen::Array4f light_along = studio.directions() * tangent;
  const Eigen::Array4f light_sine = (1 - light_along.square()).max(1e-4f).sqrt();
  const Eigen::Array4f turn =
      (studio.directions() * eye_across).array() / (eye_sine * light_sine);  // cosine between the two, seen along t
  const Eigen::Array4f front = ((1 + turn) / 2).max(0.0f).min(1.0f), behind = 1 - front;
  const Eigen::Array4f middle = (light_along + eye_along) / 2 + look.tilt;
  const Eigen::Array4f r = 0.10f * look.gloss * front.sqrt() * bell(middle + 0.07f, 0.085f);
  const Eigen::Array4f trt = 1.9f * look.gloss * front.square() * bell(middle - 0.09f, 0.14f);
  const Eigen::Array4f tt = 1.5f * look.gloss * behind.square().square() * bell(middle - 0.03f, 0.22f);
  const Eigen::Array4f scattered = 0.24f * light_sine * (0.45f + 0.55f * front);
  // Light that wanders through hair takes on its colour: dark deep down, but warm.
  constexpr std::array<float, 3> density = {0.85f, 0.98f, 1.08f};
  for (Eigen::Index c = 0; c < 3; ++c) {
    const Eigen::Array4f through =
        studio.colors().col(c).array() * fade(density[static_cast<std::size_t>(c)] * seen.depth.array());
    sum[c] += (through * (base[c] * scattered + r + (bright[c] * base[c]) * (trt + tt))).sum();
  }
  // Roots lie in the shade of the hair that grows around them.
  const float root = 1 - std::min(along / 0.25f, 1.0f);
  return sum * (1 - 0.45f * root * root);
}

// A strand is fine at its tip, and a little at its root.
float taper(float along) {
  const float tip = std::max(0.0f, (along - 0.55f) / 0.45f);
  const float root = std::max(0.0f, 1 - along / 0.08f);
  return (1 - 0.65f * tip * tip) * (1 - 0.25f * root);
}

// The pieces into which each segment is cut, and the direction of the curve at each vertex.
struct Curve {
  std::vector<Eigen::Vector3f> tangent;  // [vertices of the strand]
  std::vector<int> pieces;               // [segments]
  std::vector<float> length;             // [segments] [m]
  float total = 0;                       // [m]

  void fit(std::span<const Eigen::Vector3f> p, const Camera& camera) {
    const std::size_t n = p.size();
    tangent.resize(n);
    pieces.resize(n - 1);
    length.resize(n - 1);
    total = 0;
    Eigen::Vector3f before = Eigen::Vector3f::Zero();
    for (std::size_t i = 0; i + 1 < n; ++i) {
      const Eigen::Vector3f edge = p[i + 1] - p[i];
      length[i] = edge.norm();
      total += length[i];
      const Eigen::Vector3f direction = unit_or(edge, before);
      tangent[i] = unit_or(before + direction, direction);
      before = direction;
    }
    tangent[n - 1] = before;
    for (std::size_t i = 0; i + 1 < n; ++i) {
      const float depth = std::max(-(camera.axes().row(2).dot(p[i] - camera.eye())), camera.near_depth());
      const float pixels = length[i] * camera.focal() / depth;
      // An arc of that length and turn is length * turn / 8 off its chord, and k chords are so k * k times less.
      const float turn = (tangent[i + 1] - tangent[i]).norm();
      const float wanted = std::max(std::sqrt(pixels * turn / (8 * curve_error)), pixels / most_pixels);
      pieces[i] = static_cast<int>(std::clamp(wanted + 0.8f, 1.0f, static_cast<float>(most_pieces)));
    }
  }

  std::uint64_t point_count() const {
    std::uint64_t count = 1;
    for (int k : pieces) count += static_cast<std::uint64_t>(k);
    return count;
  }
};

bool is_drawn(std::span<const Eigen::Vector3f> p) {
  if (p.size() < 2) return false;
  return std::all_of(p.begin(), p.end(),
                     [](const Eigen::Vector3f& v) { return v.allFinite() && v.cwiseAbs().maxCoeff() <= farthest; });
}

void check(const StrandsView& strands) {
  const auto& offset = strands.offset;
  const bool sorted = std::is_sorted(offset.begin(), offset.end());
  if (!offset.empty() && (!sorted || offset.back() > strands.position.size())) {
    throw std::invalid_argument("the offsets of the strands do not fit their " +
                                std::to_string(strands.position.size()) + " vertices");
  }
  const std::size_t count = offset.empty() ? 0 : offset.size() - 1;
  if (!strands.value.empty() && strands.value.size() != strands.position.size()) {
    throw std::invalid_argument(std::to_string(strands.value.size()) + " values were given for " +
                                std::to_string(strands.position.size()) + " vertices");
  }
  if (!strands.region.empty() && strands.region.size() != count) {
    throw std::invalid_argument(std::to_string(strands.region.size()) + " regions were given for " +
                                std::to_string(count) + " strands");
  }
}

// Whether a camera should have it in its picture, and light has to take care of it.
bool is_seen(const Shape& shape, const Eigen::AlignedBox3f& hair) {
  if (!shape.center.allFinite() || !shape.radius.allFinite() || !shape.axes.allFinite()) return false;
  const Eigen::AlignedBox3f bounds = shape.bounds(Eigen::Matrix3f::Identity());
  const bool usable = bounds.min().minCoeff() >= -farthest && bounds.max().maxCoeff() <= farthest;
  return usable && (hair.isEmpty() || bounds.diagonal().norm() < 3 * hair.diagonal().norm());
}

// A wall behind the hair, lighter behind its middle, and a hint of a floor below the horizon.
Eigen::Vector3f backdrop(const Camera& camera, float x, float y) {
  const auto width = static_cast<float>(camera.width()), height = static_cast<float>(camera.height());
  const float u = (x - 0.5f * width) / height, v = (y - 0.42f * height) / height;
  const float glow = 1 / (1 + 3.2f * (u * u + v * v) + 4 * (u * u + v * v) * (u * u + v * v));
  const Eigen::Vector3f wall = Eigen::Vector3f(0.020f, 0.024f, 0.032f) + glow * Eigen::Vector3f(0.150f, 0.175f, 0.205f);
  const float down = std::clamp((y / height - 0.72f) / 0.28f, 0.0f, 1.0f);
  const float floor = down * down * (3 - 2 * down);
  return wall * (1 - 0.55f * floor);
}

}  // namespace

Image draw_strands(const StrandsView& strands, const Camera& camera, const DrawOptions& options) {
  check(strands);
  const std::size_t count = strands.offset.empty() ? 0 : strands.offset.size() - 1;
  const int threads = std::max(options.threads, 1);
  const float width = options.strand_width > 0 ? options.strand_width : natural_width(strands.position, strands.offset);
  const auto vertices = [&](std::size_t s) {
    return strands.position.subspan(strands.offset[s], strands.offset[s + 1] - strands.offset[s]);
  };

  const Eigen::AlignedBox3f hair = robust_bounds(strands.position);
  Eigen::AlignedBox3f box = hair;
  for (const Shape& shape : strands.shapes) {
    if (is_seen(shape, hair)) box.extend(shape.bounds(Eigen::Matrix3f::Identity()));
  }
  Occlusion occlusion(box, grid_resolution);
  // Each thread adds to one of its own, of which there must not be too many.
  const int adding = std::min(threads, 8);
#pragma omp parallel num_threads(adding)
  {
    Occlusion own(box, grid_resolution);
#pragma omp for schedule(static) nowait
    for (std::size_t s = 0; s < count; ++s) {
      const auto p = vertices(s);
      if (!is_drawn(p)) continue;
      for (std::size_t i = 0; i + 1 < p.size(); ++i) {
        const float length = (p[i + 1] - p[i]).norm();
        const int samples = static_cast<int>(std::clamp(0.7f * length / occlusion.cube(), 0.0f, 31.0f)) + 1;
        for (int k = 0; k < samples; ++k) {
          const float t = (static_cast<float>(k) + 0.5f) / static_cast<float>(samples);
          own.add(p[i] + t * (p[i + 1] - p[i]), width * length / static_cast<float>(samples));
        }
      }
    }
#pragma omp critical
    occlusion.add(own);
  }
  occlusion.fill(strands.shapes);
  const Studio studio(camera, occlusion, threads);

  std::vector<std::uint64_t> offset(count + 1, 0);
#pragma omp parallel num_threads(threads)
  {
    Curve curve;
#pragma omp for schedule(static)
    for (std::size_t s = 0; s < count; ++s) {
      const auto p = vertices(s);
      if (!is_drawn(p)) continue;
      curve.fit(p, camera);
      offset[s + 1] = curve.point_count();
    }
  }
  for (std::size_t s = 0; s < count; ++s) offset[s + 1] += offset[s];

  std::vector<LinePoint> points(offset.back());
#pragma omp parallel num_threads(threads)
  {
    Curve curve;
#pragma omp for schedule(dynamic, 64)
    for (std::size_t s = 0; s < count; ++s) {
      if (offset[s] == offset[s + 1]) continue;
      const auto p = vertices(s);
      curve.fit(p, camera);
      StrandLook look = look_of(s, strands.region.empty() ? 0 : strands.region[s]);
      if (!strands.value.empty()) look.gloss = 0.3f;  // colours must be told apart
      LinePoint* to = &points[offset[s]];
      float before = 0;
      Visibility light_at_end = studio.visibility(p[0]);
      for (std::size_t i = 0; i + 1 < p.size(); ++i) {
        // A cubic whose tangents are as long as the segment: it never overshoots, and a straight strand stays straight.
        const int pieces = curve.pieces[i];
        const bool last = i + 2 == p.size();
        // Light changes slowly along a segment.
        const Visibility light_at_start = light_at_end;
        light_at_end = studio.visibility(p[i + 1]);
        for (int k = 0; k < pieces + (last ? 1 : 0); ++k) {
          const float t = static_cast<float>(k) / static_cast<float>(pieces);
          const float t2 = t * t, t3 = t2 * t;
          const Eigen::Vector3f m0 = curve.length[i] * curve.tangent[i], m1 = curve.length[i] * curve.tangent[i + 1];
          const Eigen::Vector3f at =
              (2 * t3 - 3 * t2 + 1) * p[i] + (t3 - 2 * t2 + t) * m0 + (3 * t2 - 2 * t3) * p[i + 1] + (t3 - t2) * m1;
          const Eigen::Vector3f slope =
              (6 * t2 - 6 * t) * (p[i] - p[i + 1]) + (3 * t2 - 4 * t + 1) * m0 + (3 * t2 - 2 * t) * m1;
          const float along = curve.total > 0 ? (before + t * curve.length[i]) / curve.total : 0;
          if (!strands.value.empty()) {
            const float* const value = &strands.value[strands.offset[s] + i];
            look.color = scale_color(value[0] + t * (value[1] - value[0]));
          }
          const Visibility light = {light_at_start.depth + t * (light_at_end.depth - light_at_start.depth),
                                    light_at_start.sky + t * (light_at_end.sky - light_at_start.sky)};
          const Eigen::Vector3f seen = camera.project(at);
          *to++ = {seen.x(), seen.y(), seen.z() > camera.near_depth() ? seen.z() : 0,
                   width * taper(along) * camera.focal() / seen.z(),
                   shade(studio, light, unit_or(slope, curve.tangent[i]),
                         unit_or(camera.eye() - at, Eigen::Vector3f::UnitY()), look, along)};
        }
        before += curve.length[i];
      }
    }
  }

  Canvas canvas(camera.width(), camera.height());
  draw_shapes(canvas, camera, strands.shapes, studio, threads);
  draw_lines(canvas, points, offset, threads);
#pragma omp parallel for schedule(static) num_threads(threads)
  for (int y = 0; y < camera.height(); ++y) {
    for (int x = 0; x < camera.width(); ++x) {
      Eigen::Vector4f& pixel = canvas.image.at(x, y);
      const Eigen::Vector3f behind = backdrop(camera, static_cast<float>(x) + 0.5f, static_cast<float>(y) + 0.5f);
      const Eigen::Vector3f color = tone_map(pixel.head<3>() + (1 - pixel[3]) * behind);
      pixel = {color.x(), color.y(), color.z(), 1};
    }
  }
  return std::move(canvas.image);
}

float natural_width(std::span<const Eigen::Vector3f> position, std::span<const std::uint64_t> offset) {
  constexpr float share = 0.24f;  // of the distance between two roots
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Matrix3d square = Eigen::Matrix3d::Zero();
  double count = 0;
  Eigen::Vector3d first = Eigen::Vector3d::Zero();
  for (std::size_t s = 0; s + 1 < offset.size(); ++s) {
    if (offset[s] == offset[s + 1] || !position[offset[s]].allFinite()) continue;
    const Eigen::Vector3d root = position[offset[s]].cast<double>();
    if (count == 0) first = root;
    ++count;
    mean += root - first;
    square += (root - first) * (root - first).transpose();
  }
  const Eigen::AlignedBox3f box = robust_bounds(position);
  const float size = box.isEmpty() ? 0.0f : box.diagonal().norm();
  const float widest = size > 0 ? size / 250 : 1e-3f;
  if (count < 3) return widest;
  mean /= count;
  // Uniform on a disc of radius R the two large variances are R^2 / 4, on a sphere all three are R^2 / 3: the area is
  // 12.6 or 37.7 times the product of two deviations. A scalp is half way.
  const Eigen::Vector3d variance =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(square / count - mean * mean.transpose()).eigenvalues();
  const double area = 25 * std::sqrt(std::max(variance[1], 0.0) * std::max(variance[2], 0.0));
  const auto spacing = static_cast<float>(std::sqrt(area / count));
  return spacing > 0 && std::isfinite(spacing) ? std::min(share * spacing, widest) : widest;
}

void frame_strands(const StrandsView& strands, const Eigen::Vector3f& shift, Framing& framing) {
  framing.add(strands.position, shift);
  const Eigen::AlignedBox3f hair = robust_bounds(strands.position);
  for (const Shape& shape : strands.shapes) {
    if (is_seen(shape, hair)) framing.add(shape.center - shift, shape.axes * shape.radius.asDiagonal());
  }
}

Eigen::Vector3f region_color(std::uint32_t region) {
  static const std::array<Eigen::Vector3f, 8> palette = {{
      {0.160f, 0.082f, 0.046f},  // chestnut
      {0.480f, 0.300f, 0.135f},  // honey
      {0.330f, 0.085f, 0.030f},  // copper
      {0.080f, 0.045f, 0.028f},  // espresso
      {0.480f, 0.350f, 0.215f},  // ash blond
      {0.230f, 0.030f, 0.035f},  // burgundy
      {0.330f, 0.315f, 0.300f},  // silver
      {0.035f, 0.032f, 0.040f},  // raven
  }};
  return palette[region % palette.size()];
}

Eigen::Vector3f scale_color(float value) {
  static const std::array<Eigen::Vector3f, 6> colors = {{
      {0.030f, 0.055f, 0.220f},  // indigo
      {0.020f, 0.190f, 0.420f},  // blue
      {0.020f, 0.380f, 0.260f},  // sea green
      {0.330f, 0.520f, 0.060f},  // leaf
      {0.900f, 0.480f, 0.040f},  // amber
      {0.800f, 0.045f, 0.030f},  // red
  }};
  constexpr auto pieces = static_cast<float>(colors.size() - 1);
  if (!(value < 1)) return colors.back();
  const float place = std::max(value, 0.0f) * pieces;
  const auto low = static_cast<std::size_t>(place);
  return colors[low] + (place - static_cast<float>(low)) * (colors[low + 1] - colors[low]);
}

}  // namespace strandbake
