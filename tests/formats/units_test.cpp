#include "formats/units.h"

#include <Eigen/LU>
#include <catch2/catch.hpp>
#include <stdexcept>

using Eigen::Matrix3d;
using Eigen::Vector3d;
using strandbake::metres_per_unit;
using strandbake::to_y_up;

TEST_CASE("unit names and numbers are metres per unit") {
  CHECK(metres_per_unit("m") == 1);
  CHECK(metres_per_unit("cm") == 0.01);
  CHECK(metres_per_unit("mm") == 0.001);
  CHECK(metres_per_unit("km") == 1000);
  CHECK(metres_per_unit("in") == 0.0254);
  CHECK(metres_per_unit("ft") == 0.3048);
  CHECK(metres_per_unit("yd") == 0.9144);
  CHECK(metres_per_unit("0.01") == 0.01);
  CHECK(metres_per_unit("2.5e-3") == 0.0025);
}

TEST_CASE("a unit that is neither a name nor a positive number is refused with what would do") {
  for (const char* unit : {"", "M", "metre", "0", "-1", "nan", "inf", "1e999", "0.01 m", " 1", "0x10"}) {
    INFO(unit);
    CHECK_THROWS_AS(metres_per_unit(unit), std::invalid_argument);
    CHECK_THROWS_WITH(metres_per_unit(unit), Catch::Contains("cm") && Catch::Contains(unit));
  }
}

TEST_CASE("an up axis is turned to +Y by an exact rotation") {
  const struct {
    const char* name;
    Vector3d up;
  } cases[] = {{"+X", {1, 0, 0}},  {"-X", {-1, 0, 0}}, {"+Y", {0, 1, 0}},
               {"-Y", {0, -1, 0}}, {"+Z", {0, 0, 1}},  {"-Z", {0, 0, -1}}};
  for (const auto& [name, up] : cases) {
    INFO(name);
    const Matrix3d turn = to_y_up(name);
    CHECK(turn * up == Vector3d::UnitY());
    CHECK(turn * turn.transpose() == Matrix3d::Identity());
    CHECK(turn.determinant() == 1);
    if (name[0] == '+') CHECK(to_y_up(name + 1) == turn);
  }
  CHECK(to_y_up("Z") * Vector3d(1, 2, 3) == Vector3d(1, 3, -2));
  CHECK(to_y_up("Y") == Matrix3d::Identity());
}

TEST_CASE("an up axis that is none is refused with what would do") {
  for (const char* up : {"", "W", "y", "+", "++Y", "YY", "Y+", " Y"}) {
    INFO(up);
    CHECK_THROWS_AS(to_y_up(up), std::invalid_argument);
    CHECK_THROWS_WITH(to_y_up(up), Catch::Contains("+X, -X, +Y, -Y, +Z, -Z"));
  }
}
