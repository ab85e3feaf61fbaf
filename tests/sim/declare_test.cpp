#include "sim/declare.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>

#include "sim/params.h"

using namespace strandbake;

namespace {

Curve curve_of(std::vector<double> frame, const std::vector<double>& value) {
  Curve curve;
  curve.frame = std::move(frame);
  for (const double v : value) curve.value.emplace_back(v, -v, 2 * v);
  return curve;
}

}  // namespace

TEST_CASE("a curve runs straight between its keys and holds its ends") {
  const Curve curve = curve_of({1, 5, 7}, {10, 30, 20});
  CHECK(curve.at(-100).x() == 10);
  CHECK(curve.at(1).x() == 10);
  CHECK(curve.at(2).x() == 15);
  CHECK(curve.at(5).x() == 30);
  CHECK(curve.at(6.5) == Eigen::Vector3d(22.5, -22.5, 45));
  CHECK(curve.at(7).x() == 20);
  CHECK(curve.at(1e9).x() == 20);
}

TEST_CASE("a curve of one key is constant") {
  const Curve curve = curve_of({12}, {3});
  for (const double frame : {-1.0, 12.0, 13.0}) CHECK(curve.at(frame).x() == 3);
}

TEST_CASE("keyed parameters move, the others stay") {
  Animated<RegionParams> region;
  region.base.damping = 0.25;
  region.keys.emplace_back("local.stiffness", curve_of({1, 11}, {0, 1}));
  region.keys.emplace_back("global.stiffness", curve_of({1, 3}, {0.5, 0.25}));
  region.keys.emplace_back("drag", curve_of({0, 10}, {0, 20}));
  const RegionParams now = region.at(2);
  CHECK(now.local.stiffness == Approx(0.1));
  CHECK(now.global.stiffness == 0.375);
  CHECK(now.drag == 4);
  CHECK(now.damping == 0.25);
  CHECK(now.local.iterations == RegionParams{}.local.iterations);
  CHECK(now.global.range == RegionParams{}.global.range);
  CHECK(region.base.drag == RegionParams{}.drag);
}

TEST_CASE("a vector is keyed as a whole") {
  Animated<ForceParams> forces;
  forces.keys.emplace_back("gravity", curve_of({0, 2}, {0, 4}));
  CHECK(forces.at(1).gravity == Eigen::Vector3d(2, -2, 4));
}

TEST_CASE("a key goes to the field whose whole path it names") {
  Animated<RegionParams> region;
  region.keys.emplace_back("stiffness", curve_of({0}, {0.77}));
  region.keys.emplace_back("local", curve_of({0}, {0.77}));
  region.keys.emplace_back("loc.stiffness", curve_of({0}, {0.77}));
  region.keys.emplace_back("local.stiffnes", curve_of({0}, {0.77}));
  region.keys.emplace_back("local.iterations", curve_of({0}, {7}));  // not a number over time
  const RegionParams now = region.at(0);
  CHECK(now.local.stiffness == RegionParams{}.local.stiffness);
  CHECK(now.global.stiffness == RegionParams{}.global.stiffness);
  CHECK(now.local.iterations == RegionParams{}.local.iterations);
}

TEST_CASE("ranges hold their ends unless they are open, and never NaN") {
  CHECK(between(0, 1).contains(0));
  CHECK(between(0, 1).contains(1));
  CHECK_FALSE(between(0, 1).contains(std::nextafter(1.0, 2.0)));
  CHECK_FALSE(between(0, 1).contains(-0x1p-1074));
  CHECK_FALSE(more_than(0).contains(0));
  CHECK(more_than(0).contains(0x1p-1074));
  CHECK(at_least(0).contains(0));
  const double infinity = std::numeric_limits<double>::infinity();
  for (const Range range : {any_number(), at_least(0), more_than(0), between(0, 1)}) {
    CHECK_FALSE(range.contains(NAN));
    CHECK_FALSE(range.contains(infinity));
    CHECK_FALSE(range.contains(-infinity));
    CHECK_FALSE(range.is_keyed);
    CHECK(range.keyed().is_keyed);
    CHECK(range.keyed().contains(0.5) == range.contains(0.5));
  }
}

namespace {

// Walks the declarations of a struct and looks at its defaults.
struct CheckDefaults {
  int numbers = 0;

  void operator()(std::string_view name, double& field, const Range& range, const char* unit, const char* help) {
    look(name, range.contains(field), unit, help);
  }
  void operator()(std::string_view name, int& field, const Range& range, const char* unit, const char* help) {
    look(name, range.contains(field), unit, help);
  }
  void operator()(std::string_view name, Eigen::Vector3d& field, const Range& range, const char* unit,
                  const char* help) {
    look(name, range.contains(field.x()) && range.contains(field.y()) && range.contains(field.z()), unit, help);
  }
  void operator()(std::string_view name, std::string& field, const Text& text, const char*, const char* help) {
    CAPTURE(name);
    CHECK(std::count(text.choices.begin(), text.choices.end(), field) == 1);
    CHECK(std::string_view(help).back() == '.');
  }
  void operator()(std::string_view name, bool&, const Switch&, const char*, const char* help) {
    CAPTURE(name);
    CHECK(std::string_view(help).back() == '.');
  }
  template <class T>
  void operator()(std::string_view, T& nested, const char* help) {
    CHECK(std::string_view(help).back() == '.');
    fields(*this, nested);
  }
  void look(std::string_view name, bool is_inside, const char* unit, const char* help) {
    CAPTURE(name);
    CHECK(is_inside);
    CHECK_FALSE(std::string_view(unit).empty());
    CHECK(std::string_view(help).back() == '.');
    ++numbers;
  }
};

}  // namespace

TEST_CASE("every default lies in its range and has a unit and a line of help") {
  CheckDefaults check;
  RegionParams region;
  ForceParams forces;
  WindParams wind;
  fields(check, region);
  fields(check, forces);
  fields(check, wind);
  CHECK(check.numbers == 20);
}
