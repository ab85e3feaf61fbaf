// Pictures: coverage, order of depth, the camera, captions, PNG files.
#include <png.h>
#include <stdlib.h>
#include <unistd.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>
#include <string>
#include <vector>

#include "cli/draw/camera.h"
#include "cli/draw/canvas.h"
#include "cli/draw/clip.h"
#include "cli/draw/font.h"
#include "cli/draw/legend.h"
#include "cli/draw/light.h"
#include "cli/draw/palette.h"
#include "cli/draw/part_file.h"
#include "cli/draw/png.h"
#include "cli/draw/raster.h"
#include "cli/draw/shape.h"
#include "cli/draw/sheet.h"
#include "cli/draw/strands.h"

namespace strandbake {
namespace {

using Eigen::Vector3f;
using Eigen::Vector4f;

// xorshift: the same numbers everywhere.
struct Random {
  std::uint32_t state = 2463534242u;
  float operator()(float low, float high) {
    state ^= state << 13;
    state ^= state >> 17;
    state ^= state << 5;
    return low + (high - low) * static_cast<float>(state >> 8) / 16777216.0f;
  }
};

LinePoint point(float x, float y, float width, float depth = 1, const Vector3f& color = {1, 1, 1}) {
  return {x, y, depth, width, color};
}

void draw_line(Canvas& canvas, const std::vector<LinePoint>& points) {
  const std::vector<std::uint64_t> offset = {0, points.size()};
  draw_lines(canvas, points, offset, 1);
}

double alpha_sum(const Image& image) {
  double sum = 0;
  for (const Vector4f& p : image.pixel) sum += p[3];
  return sum;
}

// Strands that leave a sphere about the origin and bend down.
struct TestGroom {
  std::vector<Vector3f> position;
  std::vector<std::uint64_t> offset = {0};
  std::vector<std::uint32_t> region;

  TestGroom(int strands, int vertices, float radius = 0.1f) {
    Random random;
    while (static_cast<int>(region.size()) < strands) {
      const Vector3f out(random(-1, 1), random(-1, 1), random(-1, 1));
      if (out.norm() > 1 || out.norm() < 0.1f || out.y() < 0) continue;
      for (int v = 0; v < vertices; ++v) {
        const float way = 0.15f * static_cast<float>(v) / static_cast<float>(vertices - 1);
        position.push_back(radius * out.normalized() + way * out.normalized() - 3 * way * way * Vector3f::UnitY());
      }
      offset.push_back(position.size());
      region.push_back(static_cast<std::uint32_t>(region.size()) % 3);
    }
  }
  StrandsView view(std::span<const Shape> shapes = {}) const { return {position, offset, region, shapes, {}}; }
};

Camera frame(const StrandsView& strands, const View& view, int width, int height) {
  Framing framing(view, width, height);
  frame_strands(strands, Vector3f::Zero(), framing);
  return Camera(framing);
}

Image draw(const StrandsView& strands, int threads = 1, int width = 160, int height = 120) {
  const View view;
  DrawOptions options;
  options.threads = threads;
  return draw_strands(strands, frame(strands, view, width, height), options);
}

bool same(const Image& a, const Image& b) {
  return a.width == b.width && a.height == b.height && a.pixel == b.pixel;
}

bool all_finite(const Image& image) {
  return std::all_of(image.pixel.begin(), image.pixel.end(), [](const Vector4f& p) { return p.allFinite(); });
}

// A folder that disappears with the test.
struct Folder {
  std::filesystem::path path;
  Folder() {
    std::string pattern = (std::filesystem::temp_directory_path() / "strandbake_draw_XXXXXX").string();
    REQUIRE(mkdtemp(pattern.data()) != nullptr);
    path = pattern;
  }
  ~Folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path, ignored);
  }
  // Where PartFile writes what is to become `name`.
  std::filesystem::path part(const std::string& name) const {
    return path / (name + "." + std::to_string(::getpid()) + ".part");
  }
  std::size_t entries() const {
    return static_cast<std::size_t>(std::distance(std::filesystem::directory_iterator(path), {}));
  }
};

TEST_CASE("the coverage of a line adds up to its area at any angle and width") {
  Random random;
  for (int trial = 0; trial < 200; ++trial) {
    const float x0 = random(20, 100), y0 = random(20, 80), x1 = random(20, 100), y1 = random(20, 80);
    const float width = random(0.02f, 6);
    Canvas canvas(120, 100);
    draw_line(canvas, {point(x0, y0, width), point(x1, y1, width)});
    const double area = std::hypot(x1 - x0, y1 - y0) * width;
    INFO("from " << x0 << ", " << y0 << " to " << x1 << ", " << y1 << ", width " << width);
    // Coordinates near 100 in float: 1e-5 of a pixel on each of the line's edges.
    CHECK(alpha_sum(canvas.image) == Approx(area).epsilon(1e-3).margin(1e-3));
  }
}

TEST_CASE("a line of many points covers no more and no less than one of two") {
  for (const float slope : {0.0f, 0.37f, 1.0f}) {
    Canvas whole(64, 64), pieces(64, 64);
    std::vector<LinePoint> points;
    for (int k = 0; k <= 97; ++k) {
      const float x = 5.3f + 50.0f * static_cast<float>(k) / 97;
      points.push_back(point(x, 6.1f + slope * (x - 5.3f), 1.7f));
    }
    draw_line(whole, {points.front(), points.back()});
    draw_line(pieces, points);
    for (std::size_t p = 0; p < whole.image.pixel.size(); ++p) {
      // 98 roundings of places near 64.
      CHECK(std::abs(whole.image.pixel[p][3] - pieces.image.pixel[p][3]) < 1e-3f);
    }
  }
}

TEST_CASE("a horizontal and a vertical line land on the predicted pixels") {
  Canvas canvas(16, 16);
  // Rows 4 and 5 in full, a quarter of row 3 and of row 6; columns 2 to 8 in full and half of column 9.
  draw_line(canvas, {point(2, 5, 2.5f), point(9.5f, 5, 2.5f)});
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 16; ++x) {
      const float row = y == 4 || y == 5 ? 1.0f : y == 3 || y == 6 ? 0.25f : 0.0f;
      const float column = x >= 2 && x <= 8 ? 1.0f : x == 9 ? 0.5f : 0.0f;
      INFO("pixel " << x << ", " << y);
      CHECK(canvas.image.at(x, y)[3] == Approx(row * column).margin(1e-6));
    }
  }
  Canvas upright(16, 16);
  draw_line(upright, {point(7.5f, 12, 0.25f), point(7.5f, 3, 0.25f)});
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 16; ++x) {
      const float expected = x == 7 && y >= 3 && y < 12 ? 0.25f : 0.0f;
      CHECK(upright.image.at(x, y)[3] == Approx(expected).margin(1e-6));
    }
  }
}

TEST_CASE("a nearer strand hides a farther one, whichever is drawn first") {
  const Vector3f red(1, 0, 0), green(0, 1, 0);
  for (const bool near_first : {true, false}) {
    std::vector<LinePoint> points = {point(2, 8, 3, 1, red), point(14, 8, 3, 1, red), point(8, 2, 3, 2, green),
                                     point(8, 14, 3, 2, green)};
    if (!near_first) std::rotate(points.begin(), points.begin() + 2, points.end());
    const std::vector<std::uint64_t> offset = {0, 2, 4};
    Canvas canvas(16, 16);
    draw_lines(canvas, points, offset, 1);
    CHECK(canvas.image.at(8, 8) == Vector4f(1, 0, 0, 1));
    CHECK(canvas.image.at(8, 4) == Vector4f(0, 1, 0, 1));
  }
}

TEST_CASE("a half covering strand lets half of what is behind it through, and a solid thing hides what is behind") {
  Canvas canvas(16, 16);
  canvas.image.at(8, 8) = {0, 0, 1, 1};
  canvas.depth[canvas.image.index(8, 8)] = 2;
  const std::vector<LinePoint> points = {point(2, 8.5f, 0.5f, 1, {1, 0, 0}), point(14, 8.5f, 0.5f, 1, {1, 0, 0}),
                                         point(8.5f, 2, 4, 3, {0, 1, 0}), point(8.5f, 14, 4, 3, {0, 1, 0})};
  const std::vector<std::uint64_t> offset = {0, 2, 4};
  draw_lines(canvas, points, offset, 1);
  CHECK(canvas.image.at(8, 8).isApprox(Vector4f(0.5f, 0, 0.5f, 1), 1e-5f));
  CHECK(canvas.image.at(9, 8).isApprox(Vector4f(0.5f, 0.5f, 0, 1), 1e-5f));
}

TEST_CASE("many layers blend as they would from the front to the back, in whatever order they are drawn") {
  Random random;
  struct Layer {
    float depth, alpha;
    Vector3f color;
  };
  for (int trial = 0; trial < 20; ++trial) {
    std::vector<Layer> layers;
    for (int k = 0; k < 60; ++k) {
      const Vector3f color(random(0, 1), random(0, 1), random(0, 1));
      layers.push_back({random(1, 2), random(0.1f, 0.9f), color});
    }
    std::vector<LinePoint> points;
    std::vector<std::uint64_t> offset = {0};
    for (const Layer& layer : layers) {
      points.push_back(point(2, 8.5f, layer.alpha, layer.depth, layer.color));
      points.push_back(point(14, 8.5f, layer.alpha, layer.depth, layer.color));
      offset.push_back(points.size());
    }
    Canvas canvas(16, 16);
    draw_lines(canvas, points, offset, 1);
    std::sort(layers.begin(), layers.end(), [](const Layer& a, const Layer& b) { return a.depth < b.depth; });
    Vector3f sum = Vector3f::Zero();
    float clear = 1;
    for (const Layer& layer : layers) {
      sum += clear * layer.alpha * layer.color;
      clear *= 1 - layer.alpha;
    }
    // What shows through less than 2/1000 is not looked at.
    CHECK((canvas.image.at(8, 8).head<3>() - sum).cwiseAbs().maxCoeff() < 2.1e-3f);
  }
}

TEST_CASE("lines that cross in depth are blended in their own order in each pixel") {
  const Vector3f red(1, 0, 0), green(0, 1, 0);
  // Red is nearer at the left, green at the right; many more behind both close the pixels.
  std::vector<LinePoint> points = {point(1, 8.5f, 1, 1, red), point(31, 8.5f, 1, 3, red), point(1, 8.5f, 1, 3, green),
                                   point(31, 8.5f, 1, 1, green)};
  std::vector<std::uint64_t> offset = {0, 2, 4};
  for (int k = 0; k < 30; ++k) {
    points.push_back(point(1, 8.5f, 1, 4, {0, 0, 1}));
    points.push_back(point(31, 8.5f, 1, 4, {0, 0, 1}));
    offset.push_back(points.size());
  }
  Canvas canvas(32, 16);
  draw_lines(canvas, points, offset, 1);
  CHECK(canvas.image.at(4, 8).isApprox(Vector4f(1, 0, 0, 1), 1e-5f));
  CHECK(canvas.image.at(27, 8).isApprox(Vector4f(0, 1, 0, 1), 1e-5f));
}

TEST_CASE("segments that cannot be drawn are left out, the others of their line are not") {
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  for (const LinePoint& bad : {point(nan, 8, 1), point(1e30f, 8, 1), point(8, -1e6f, 1), point(8, 8, nan),
                               point(8, 8, 1, -1), point(8, 8, 1, nan), point(8, 8, 1, 1, {nan, 0, 0})}) {
    Canvas canvas(16, 16);
    draw_line(canvas, {point(1, 4, 1), point(5, 4, 1), bad, point(9, 4, 1), point(12, 4, 1)});
    CHECK(alpha_sum(canvas.image) == Approx(7));
  }
}

TEST_CASE("a line that begins and ends far outside crosses the picture") {
  Canvas canvas(70, 40);
  draw_line(canvas, {point(-9000, 20.5f, 1), point(9000, 20.5f, 1)});
  CHECK(alpha_sum(canvas.image) == Approx(70).epsilon(1e-3));
  Canvas none(70, 40);
  draw_line(none, {point(-9000, 60, 1), point(9000, 60, 1)});
  CHECK(alpha_sum(none.image) == 0);
}

TEST_CASE("the picture does not depend on the number of threads") {
  const TestGroom groom(700, 9);
  const std::vector<Shape> shapes = {Shape::sphere({0, 0, 0}, 0.095f), Shape::sphere({0.1f, -0.05f, 0.1f}, 0.04f)};
  const Image one = draw(groom.view(shapes), 1);
  CHECK(same(one, draw(groom.view(shapes), 2)));
  CHECK(same(one, draw(groom.view(shapes), 3)));
  CHECK(all_finite(one));
}

TEST_CASE("the camera projects known points to known pixels") {
  View view;
  view.azimuth_deg = 0;
  view.elevation_deg = 0;
  view.fov_deg = 90;
  view.margin = 0;
  // With an opening of 90 degrees half the height is as large as the distance: the front face, 1 m from the middle,
  // fills the picture from 1 m away, so the eye is at z = 2.
  const Camera camera(Eigen::AlignedBox3f(Vector3f(-1, -1, -1), Vector3f(1, 1, 1)), view, 200, 200);
  CHECK(camera.eye().isApprox(Vector3f(0, 0, 2), 1e-6f));
  CHECK(camera.project({0, 0, 0}).isApprox(Vector3f(100, 100, 2), 1e-5f));
  CHECK(camera.project({1, 1, 1}).isApprox(Vector3f(200, 0, 1), 1e-5f));
  CHECK(camera.project({1, -1, 0}).isApprox(Vector3f(150, 150, 2), 1e-5f));
  CHECK(camera.ray(150, 150).isApprox(Vector3f(0.5f, -0.5f, -1).normalized(), 1e-5f));

  view.azimuth_deg = 90;  // from +X: -Z is at the right
  const Camera side(Eigen::AlignedBox3f(Vector3f(-1, -1, -1), Vector3f(1, 1, 1)), view, 200, 200);
  CHECK(side.project({1, 1, -1}).isApprox(Vector3f(200, 0, 1), 1e-5f));
}

TEST_CASE("the framed box is inside the picture and its margin, and touches it") {
  Random random;
  for (int trial = 0; trial < 100; ++trial) {
    View view;
    view.azimuth_deg = random(-180, 180);
    view.elevation_deg = random(-80, 80);
    view.fov_deg = random(10, 80);
    view.margin = random(0, 0.2f);
    const Vector3f low(random(-2, 2), random(-2, 2), random(-2, 2));
    const Eigen::AlignedBox3f box(low, low + Vector3f(random(0.05f, 2), random(0.05f, 2), random(0.05f, 2)));
    const int width = 320, height = 200;
    const Camera camera(box, view, width, height);
    float least = 1e9f;  // free space between the box and the margin
    for (int corner = 0; corner < 8; ++corner) {
      const Vector3f p =
          camera.project(view.axes().transpose() * box.corner(static_cast<Eigen::AlignedBox3f::CornerType>(corner)));
      const float free_x = width / 2.0f - std::abs(p.x() - width / 2.0f) - view.margin * width;
      const float free_y = height / 2.0f - std::abs(p.y() - height / 2.0f) - view.margin * height;
      least = std::min({least, free_x, free_y});
      CHECK(p.z() > camera.near_depth());
    }
    // A hundredth of a pixel for places in float.
    CHECK(least == Approx(0).margin(1e-2));
  }
}

TEST_CASE("a camera with a place of its own projects known points to known pixels") {
  const Camera camera(Vector3f(3, 1, 2), Vector3f(3, 1, 0), 90, 300, 200);
  CHECK(camera.project({3, 1, 0}).isApprox(Vector3f(150, 100, 2), 1e-5f));
  CHECK(camera.project({4, 1, 1}).isApprox(Vector3f(250, 100, 1), 1e-5f));
  CHECK(camera.project({3, 2, 0}).isApprox(Vector3f(150, 50, 2), 1e-5f));
  const Camera from_x(Vector3f(5, 0, 0), Vector3f(0, 0, 0), 90, 200, 200);  // -Z is at the right
  CHECK(from_x.project({4, 0, -1}).isApprox(Vector3f(200, 100, 1), 1e-5f));
  const Camera above(Vector3f(0, 2, 0), Vector3f(0, 0, 0), 90, 200, 200);  // -Z is at the top
  CHECK(above.project({0, 0, -1}).isApprox(Vector3f(100, 50, 2), 1e-5f));
  CHECK(Camera(Vector3f(1, 1, 1), Vector3f(1, 1, 1), 90, 200, 200)
            .project({1, 1, 0})
            .isApprox(Vector3f(100, 100, 1), 1e-5f));
  const Camera moved = camera.moved({0, 0, 7});
  CHECK(moved.project({3, 2, 7}).isApprox(camera.project({3, 2, 0}), 1e-5f));
}

TEST_CASE("everything that was added is in the picture, and something touches each pair of sides") {
  Random random;
  for (int trial = 0; trial < 50; ++trial) {
    View view;
    view.azimuth_deg = random(-180, 180);
    view.elevation_deg = random(-80, 80);
    view.fov_deg = random(10, 100);
    view.margin = random(0, 0.2f);
    const int width = 320, height = 200;
    std::vector<Vector3f> points;
    const Vector3f size(random(0.1f, 2), random(0.1f, 2), random(0.1f, 2));
    for (int k = 0; k < 40; ++k)
      points.push_back(size.cwiseProduct(Vector3f(random(-1, 1), random(-1, 1), random(-1, 1))));
    const Vector3f shift(random(-9, 9), 0, random(-9, 9)), center(random(-2, 2), random(-2, 2), random(-2, 2));
    const float radius = random(0.1f, 1);
    std::vector<Vector3f> moved;
    for (const Vector3f& p : points) moved.push_back(p + shift);
    Framing framing(view, width, height);
    framing.add(moved, shift);
    framing.add(center, radius * Eigen::Matrix3f::Identity());
    const Camera camera(framing);
    // Of the sphere many points stand for all.
    for (int k = 0; k < 20000; ++k) {
      const Vector3f out(random(-1, 1), random(-1, 1), random(-1, 1));
      if (out.norm() > 0.1f) points.emplace_back(center + radius * out.normalized());
    }
    float free_x = 1e9f, free_y = 1e9f;
    for (const Vector3f& p : points) {
      const Vector3f seen = camera.project(p);
      CHECK(seen.z() > camera.near_depth());
      free_x = std::min(free_x, width / 2.0f - std::abs(seen.x() - width / 2.0f) - view.margin * width);
      free_y = std::min(free_y, height / 2.0f - std::abs(seen.y() - height / 2.0f) - view.margin * height);
    }
    // 20,000 points miss the outermost of the sphere by a pixel at most; places in float by a hundredth.
    CHECK(free_x > -1e-2f);
    CHECK(free_y > -1e-2f);
    CHECK(std::min(free_x, free_y) < 1);
  }
}

TEST_CASE("bounds leave out what flew away, and nothing else") {
  const TestGroom groom(300, 8);
  Eigen::AlignedBox3f all;
  for (const Vector3f& p : groom.position) all.extend(p);
  CHECK(robust_bounds(groom.position).isApprox(all));

  std::vector<Vector3f> torn = groom.position;
  torn.push_back({50, 0, 0});
  torn.push_back({0, -1e30f, 0});
  torn.push_back({std::numeric_limits<float>::quiet_NaN(), 0, 0});
  torn.push_back({0, std::numeric_limits<float>::infinity(), 0});
  CHECK(robust_bounds(torn).isApprox(all));
  CHECK(robust_bounds({}).isEmpty());
}

TEST_CASE("values are seen in the colours of their scale") {
  // A wide strand across the picture, with 0 at one end and 1 at the other.
  const std::vector<Vector3f> line = {{-0.1f, 0, 0}, {0, 0, 0}, {0.1f, 0, 0}};
  const std::vector<std::uint64_t> offset = {0, 3};
  const std::vector<float> value = {0, 0.5f, 1};
  const Camera camera(Vector3f(0, 0, 0.5f), Vector3f(0, 0, 0), 30, 300, 200);
  DrawOptions options;
  options.strand_width = 0.05f;
  const Image image = draw_strands({line, offset, {}, {}, value}, camera, options);
  const Vector4f low = image.at(80, 100), middle = image.at(150, 100), high = image.at(220, 100);
  CHECK((low.z() > low.x() && low.z() > low.y()));              // blue
  CHECK((middle.y() > middle.x() && middle.y() > middle.z()));  // green
  CHECK((high.x() > 2 * high.y() && high.x() > 2 * high.z()));  // red
  CHECK_THROWS_AS(draw_strands({line, offset, {}, {}, std::span(value).first(2)}, camera, options),
                  std::invalid_argument);
  for (const float beyond :
       {1.0f, 7.0f, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN()})
    CHECK(scale_color(beyond) == scale_color(1));
  CHECK(scale_color(-1) == scale_color(0));
}

TEST_CASE("strands that are not finite are skipped and the others drawn as if alone") {
  TestGroom groom(60, 6);
  TestGroom torn = groom;
  // The last strand is torn, so that the others keep their numbers and with them their tones.
  torn.position[torn.position.size() - 3].y() = std::numeric_limits<float>::quiet_NaN();
  groom.offset.pop_back();
  groom.region.pop_back();
  const View view;
  const Camera camera = frame(groom.view(), view, 120, 120);
  DrawOptions options;
  options.strand_width = 0.002f;
  groom.position.resize(groom.offset.back());
  torn.position.resize(torn.offset.back());
  for (std::size_t v = groom.position.size(); v < torn.position.size(); ++v) {
    torn.position[v] = Vector3f::Constant(std::numeric_limits<float>::quiet_NaN());
  }
  CHECK(same(draw_strands(groom.view(), camera, options), draw_strands(torn.view(), camera, options)));
  for (Vector3f& p : torn.position) p.setConstant(std::numeric_limits<float>::infinity());
  CHECK(all_finite(draw(torn.view())));
}

TEST_CASE("no strand, one strand, and strands without size make a picture") {
  const Image empty = draw({});
  CHECK(all_finite(empty));
  CHECK(empty.at(80, 60)[3] == 1);

  const std::vector<std::uint64_t> offset = {0, 2};
  const std::vector<Vector3f> line = {{0, 1, 0}, {0, 1.2f, 0}};
  const Image one = draw({line, offset, {}, {}, {}});
  CHECK(all_finite(one));
  CHECK_FALSE(same(one, empty));

  const std::vector<Vector3f> heap(2, Vector3f(3, 2, 1));
  CHECK(all_finite(draw({heap, offset, {}, {}, {}})));
  const std::vector<std::uint64_t> short_strands = {0, 0, 1, 2};
  CHECK(all_finite(draw({heap, short_strands, {}, {}, {}})));

  const std::vector<Vector3f> huge = {{-3e38f, 0, 0}, {3e38f, 3e38f, 0}};
  CHECK(all_finite(draw({huge, offset, {}, {}, {}})));
}

TEST_CASE("spans that contradict each other are refused") {
  const std::vector<Vector3f> position(4, Vector3f::Zero());
  const std::vector<std::uint64_t> beyond = {0, 5}, backwards = {0, 3, 2}, good = {0, 2, 4};
  const std::vector<std::uint32_t> three_regions = {0, 0, 0};
  CHECK_THROWS_AS(draw({position, beyond, {}, {}, {}}), std::invalid_argument);
  CHECK_THROWS_AS(draw({position, backwards, {}, {}, {}}), std::invalid_argument);
  CHECK_THROWS_AS(draw({position, good, three_regions, {}, {}}), std::invalid_argument);
  CHECK_THROWS_AS(Camera(Eigen::AlignedBox3f(), View(), 0, 10), std::invalid_argument);
}

TEST_CASE("hair shades what lies behind it, seen from the lamp") {
  Occlusion space(Eigen::AlignedBox3f(Vector3f(-1, -1, -1), Vector3f(1, 1, 1)), 40);
  // A plate at y = 0 that blocks the way twice over.
  const float cell = space.cube();
  for (float x = -1; x <= 1; x += cell / 2) {
    for (float z = -1; z <= 1; z += cell / 2) space.add({x, 0, z}, 2 * cell * cell / 4);
  }
  space.fill({});
  const std::vector<float> from_above = space.depth_toward(Vector3f::UnitY());
  CHECK(space.sample(from_above, {0, 0.5f, 0}) == Approx(0).margin(1e-6));
  // Whole 1024ths are counted: eight parts of each of the four additions to a cube, half a unit each at most.
  CHECK(space.sample(from_above, {0, -0.5f, 0}) == Approx(2).margin(0.02));
  // At 45 degrees the way through the plate is longer by the square root of two.
  const std::vector<float> slanted = space.depth_toward(Vector3f(1, 1, 0).normalized());
  CHECK(space.sample(slanted, {-0.3f, -0.3f, 0}) == Approx(2 * std::sqrt(2.0)).margin(0.03));
}

TEST_CASE("a head is fitted to roots on a scalp and to nothing else") {
  const TestGroom groom(400, 5);
  std::vector<Vector3f> moved = groom.position;
  for (Vector3f& p : moved) p += Vector3f(3, 1.7f, -2);
  const auto head = fit_head(moved, groom.offset);
  REQUIRE(head);
  // Float positions near 3 m: 2e-7 m.
  CHECK(head->center.isApprox(Vector3f(3, 1.7f, -2), 1e-5f));
  CHECK(head->radius.x() == Approx(0.097).epsilon(1e-3));

  const TestGroom huge(400, 5, 2), tiny(400, 5, 0.01f), few(15, 5);
  CHECK_FALSE(fit_head(huge.position, huge.offset));
  CHECK_FALSE(fit_head(tiny.position, tiny.offset));
  CHECK_FALSE(fit_head(few.position, few.offset));
  CHECK_FALSE(fit_head({}, {}));

  TestGroom cloud(400, 5);
  Random random;
  for (Vector3f& p : cloud.position) p = Vector3f(random(-0.1f, 0.1f), random(-0.1f, 0.1f), random(-0.1f, 0.1f));
  CHECK_FALSE(fit_head(cloud.position, cloud.offset));

  TestGroom plane(400, 5);
  for (Vector3f& p : plane.position) p.y() = 0;
  CHECK_FALSE(fit_head(plane.position, plane.offset));
}

TEST_CASE("a shape covers its silhouette and knows how far away it is") {
  View view;
  view.azimuth_deg = 0;
  view.elevation_deg = 0;
  const Eigen::AlignedBox3f box(Vector3f(-0.2f, -0.2f, -0.2f), Vector3f(0.2f, 0.2f, 0.2f));
  const Camera camera(box, view, 200, 200);
  Occlusion nothing(box, 8);
  nothing.fill({});
  const Studio studio(camera, nothing, 1);
  Canvas canvas(200, 200);
  const std::vector<Shape> shapes = {Shape::sphere({0, 0, 0}, 0.1f)};
  draw_shapes(canvas, camera, shapes, studio, 1);
  const double distance = camera.eye().z();
  // The cone that touches the sphere has half the opening asin(r / distance).
  const double radius = camera.focal() * std::tan(std::asin(0.1 / distance));
  // 16 samples in each pixel of the edge.
  CHECK(alpha_sum(canvas.image) == Approx(std::numbers::pi * radius * radius).epsilon(2e-3));
  CHECK(canvas.depth[canvas.image.index(100, 100)] == Approx(distance - 0.1).epsilon(1e-4));
  CHECK(std::isinf(canvas.depth[0]));
}

TEST_CASE("few strands are drawn thick and many fine") {
  const TestGroom few(2000, 5), many(8000, 5);
  const float thick = natural_width(few.position, few.offset), fine = natural_width(many.position, many.offset);
  // A quarter of the scalp each is half the distance; the scalps are random.
  CHECK(thick / fine == Approx(2).epsilon(0.05));
  CHECK(natural_width({}, {}) > 0);
  const std::vector<Vector3f> heap(6, Vector3f(1, 1, 1));
  const std::vector<std::uint64_t> offset = {0, 2, 4, 6};
  CHECK(natural_width(heap, offset) > 0);
}

TEST_CASE("the screen curve is that of sRGB") {
  for (int k = 0; k <= 10000; ++k) {
    const double x = k / 10000.0;
    const double exact = x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055;
    CHECK(std::abs(srgb(static_cast<float>(x)) - exact) < 0.02 / 255);
  }
  CHECK(srgb(-1) == 0);
  CHECK(srgb(7) == 1);
  CHECK(srgb(std::numeric_limits<float>::quiet_NaN()) == 0);
}

TEST_CASE("tone mapping leaves dim colours alone and brings bright ones below one in their order") {
  const Vector3f dim(0.5f, 0.2f, 0.1f);
  CHECK(tone_map(dim) == dim);
  float before = 0;
  for (float x = 0.1f; x < 50; x *= 1.1f) {
    const Vector3f mapped = tone_map({x, 0.5f * x, 0.2f * x});
    CHECK(mapped.x() > before);
    CHECK(mapped.maxCoeff() < 1);
    CHECK(mapped.x() >= mapped.y());
    CHECK(mapped.y() >= mapped.z());
    before = mapped.x();
  }
}

// Sum of the light that a text adds to a rectangle of the page.
double ink(const Image& with, const Image& without, int left, int top, int width, int height) {
  double sum = 0;
  for (int y = top; y < top + height; ++y) {
    for (int x = left; x < left + width; ++x) sum += (with.at(x, y) - without.at(x, y)).head<3>().cwiseAbs().sum();
  }
  return sum;
}

TEST_CASE("each tile of a contact sheet shows its picture and its frame number") {
  std::vector<SheetTile> tiles;
  for (int k = 0; k < 5; ++k)
    tiles.push_back({Image(60, 50, Vector4f(0.1f * static_cast<float>(k), 0, 0, 1)), 10 * k + 7});
  SheetOptions options;
  options.columns = 3;
  const Image sheet = make_contact_sheet(tiles, options);
  CHECK(sheet.width == 3 * 60 + 4 * 4);
  CHECK(sheet.height == 2 * 50 + 3 * 4);
  for (int k = 0; k < 5; ++k) {
    CHECK(sheet.at(4 + k % 3 * 64 + 55, 4 + k / 3 * 54 + 5) == tiles[static_cast<std::size_t>(k)].image.at(55, 5));
  }
  // The same page but for the numbers: they differ in the lower left corner of each tile and nowhere else.
  std::vector<SheetTile> other = tiles;
  for (SheetTile& tile : other) tile.frame = 8;
  const Image numbered = make_contact_sheet(other, options);
  double in_corners = 0;
  for (int k = 0; k < 5; ++k) {
    const double corner = ink(sheet, numbered, 4 + k % 3 * 64, 4 + k / 3 * 54 + 25, 40, 25);
    CHECK(corner > 1);
    in_corners += corner;
  }
  CHECK(ink(sheet, numbered, 0, 0, sheet.width, sheet.height) == Approx(in_corners));

  options.title = std::string(500, 'W') + " is cut";
  const Image titled = make_contact_sheet(tiles, options);
  CHECK(titled.width == sheet.width);
  CHECK(titled.height > sheet.height);
  options.title.clear();
  options.columns = 0;
  CHECK(make_contact_sheet(tiles, options).width > 60);
}

TEST_CASE("a sheet without tiles or with tiles of different size is refused") {
  CHECK_THROWS_AS(make_contact_sheet({}, {}), std::invalid_argument);
  const std::vector<SheetTile> tiles = {{Image(8, 8), 1}, {Image(8, 9), 2}};
  CHECK_THROWS_AS(make_contact_sheet(tiles, {}), std::invalid_argument);
  const std::vector<SheetTile> one = {{Image(8, 8), 1}};
  SheetOptions negative;
  negative.columns = -1;
  CHECK_THROWS_AS(make_contact_sheet(one, negative), std::invalid_argument);
}

TEST_CASE("text can hang over every edge of a picture, and what the font lacks becomes a box") {
  Image image(20, 20);
  for (const float x : {-500.0f, -5.0f, 12.0f, 500.0f}) {
    for (const float y : {-500.0f, -5.0f, 12.0f, 500.0f}) draw_text(image, "Frame 0123456789", x, y, 12, {1, 1, 1});
  }
  CHECK(all_finite(image));
  CHECK(text_width("", 12) == 0);
  CHECK(text_width("\xc3\xa4", 12) == text_width("#", 12));  // one letter of two bytes
  CHECK(text_width("11", 24) == Approx(2 * text_width("11", 12)));
}

TEST_CASE("a legend is as wide as it says, and stands where there is room for it") {
  Legend legend;
  legend.title = "region";
  legend.entries = {{"top", region_color(0)}, {"tail", region_color(1)}};
  const Image black(400, 30, Vector4f(0, 0, 0, 1));
  Image image = black;
  draw_legend(image, legend, 50, 10, 10);
  const int width = static_cast<int>(std::ceil(legend_width(legend, 10)));
  CHECK(ink(image, black, 0, 0, 48, 30) == 0);
  CHECK(ink(image, black, 50 + width + 2, 0, 400 - 52 - width, 30) == 0);
  CHECK(ink(image, black, 50 + width - 10, 0, 12, 30) > 1);

  const std::vector<SheetTile> tiles = {{Image(200, 50), 1}};
  SheetOptions options;
  options.title = "a.h5";
  const int title_alone = make_contact_sheet(tiles, options).height;
  options.legend = legend;
  CHECK(make_contact_sheet(tiles, options).height == title_alone);
  options.title = "a name that leaves no room";
  CHECK(make_contact_sheet(tiles, options).height > title_alone);
  Legend scale;
  scale.low = "0";
  scale.high = "5 %";
  CHECK(legend_width(scale, 10) > 90);
}

TEST_CASE("a palette keeps few colours as they are, and mixes others from near ones") {
  std::vector<std::uint8_t> few;
  for (int k = 0; k < 6 * 6 * 6; ++k) {
    for (const int part : {k % 6 * 50, k / 6 % 6 * 50, k / 36 * 50}) few.push_back(static_cast<std::uint8_t>(part));
  }
  Palette exact(few);
  for (std::size_t p = 0; p < few.size(); p += 3) {
    const Rgb8 color = {few[p], few[p + 1], few[p + 2]};
    CHECK(exact.colors()[exact.index(color, static_cast<int>(p), 3)] == color);
  }
  // A ramp of greys, then a grey between two of four colours.
  std::vector<std::uint8_t> two;
  for (int k = 0; k < 3 * 100; ++k) two.push_back(k < 150 ? 100 : 140);
  Palette palette(two);
  double sum = 0;
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 4; ++x) sum += palette.colors()[palette.index({120, 120, 120}, x, y)][1];
  }
  CHECK(sum / 16 == Approx(120).margin(3));  // one pixel of 16 is 2.5
  CHECK(palette.index({120, 120, 120}, 1, 2) == palette.index({120, 120, 120}, 5, 6));
}

TEST_CASE("a file that is not finished leaves nothing behind") {
  const Folder folder;
  {
    PartFile file(folder.path / "a.txt");
    file.write("half of it");
    CHECK(folder.entries() == 1);
  }
  CHECK(folder.entries() == 0);
  const std::vector<std::uint8_t> rgb(3 * 32 * 32, 99);
  { make_gif(folder.path / "a.gif", 32, 32, 24, rgb)->add(rgb); }
  CHECK(folder.entries() == 0);
  const auto gif = make_gif(folder.path / "a.gif", 32, 32, 24, rgb);
  gif->add(rgb);
  gif->add(rgb);
  CHECK_THROWS_AS(gif->add(std::span(rgb).first(9)), std::invalid_argument);
  gif->finish();
  CHECK(folder.entries() == 1);
  CHECK_THROWS_AS(make_gif(folder.path / "none" / "a.gif", 32, 32, 24, rgb), DiskError);
  CHECK_THROWS_AS(make_gif(folder.path / "b.gif", 0, 32, 24, rgb), std::invalid_argument);
  CHECK_THROWS_AS(make_mp4(folder.path / "b.mp4", 33, 32, 24), std::invalid_argument);
  CHECK(folder.entries() == 1);
}

TEST_CASE("a GIF that meets a full disk says so") {
  if (!std::filesystem::exists("/dev/full")) {
    WARN("skipped: there is no /dev/full here");
    return;
  }
  const Folder folder;
  std::filesystem::create_symlink("/dev/full", folder.part("a.gif"));
  std::vector<std::uint8_t> noise(std::size_t{3} * 256 * 256);
  Random random;
  for (std::uint8_t& byte : noise) byte = static_cast<std::uint8_t>(random(0, 256));
  const auto write = [&] {
    const auto gif = make_gif(folder.path / "a.gif", 256, 256, 24, noise);
    gif->add(noise);
    gif->finish();
  };
  CHECK_THROWS_WITH(write(), Catch::Contains("a.gif: cannot write the file"));
  CHECK(folder.entries() == 0);
}

TEST_CASE("a PNG decodes to the pixels that were written, and twice to the same bytes") {
  const Folder folder;
  Image image(33, 17);
  Random random;
  for (Vector4f& p : image.pixel) p = {random(-0.1f, 1.2f), random(0, 1), random(0, 0.05f), 1};
  write_png(image, folder.path / "a.png");
  write_png(image, folder.path / "b.png");
  CHECK(folder.entries() == 2);

  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  REQUIRE(png_image_begin_read_from_file(&png, (folder.path / "a.png").c_str()));
  CHECK(png.width == 33);
  CHECK(png.height == 17);
  png.format = PNG_FORMAT_RGB;
  std::vector<std::uint8_t> decoded(PNG_IMAGE_SIZE(png));
  REQUIRE(png_image_finish_read(&png, nullptr, decoded.data(), 0, nullptr));
  CHECK(decoded == to_rgb8(image));

  const auto bytes = [&](const char* name) {
    std::ifstream in(folder.path / name, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  CHECK(bytes("a.png") == bytes("b.png"));
  CHECK_FALSE(bytes("a.png").empty());
}

TEST_CASE("a PNG that cannot be written says so and leaves nothing behind") {
  const Folder folder;
  const Image image(4, 4);
  CHECK_THROWS_AS(write_png(image, folder.path / "missing" / "a.png"), DiskError);
  CHECK_THROWS_AS(write_png(Image(), folder.path / "a.png"), DiskError);
  CHECK(folder.entries() == 0);

  // The name is taken by a folder: everything is written, only the last step fails.
  std::filesystem::create_directories(folder.path / "taken.png" / "inside");
  CHECK_THROWS_WITH(write_png(image, folder.path / "taken.png"), Catch::Contains("taken.png: cannot"));
  CHECK(folder.entries() == 1);
}

TEST_CASE("a PNG that meets a full disk says so") {
  // Under the name of the unfinished file stands a device that is always full.
  if (!std::filesystem::exists("/dev/full")) {
    WARN("skipped: there is no /dev/full here");
    return;
  }
  const Folder folder;
  std::filesystem::create_symlink("/dev/full", folder.part("a.png"));
  CHECK_THROWS_WITH(write_png(Image(64, 64), folder.path / "a.png"), Catch::Contains("cannot write the file"));
  CHECK(folder.entries() == 0);
}

}  // namespace
}  // namespace strandbake
