#include "formats/units.h"

#include <charconv>
#include <cmath>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace strandbake {

double metres_per_unit(std::string_view unit) {
  static constexpr std::pair<std::string_view, double> units[] = {
      {"m", 1}, {"cm", 0.01}, {"mm", 0.001}, {"km", 1000}, {"in", 0.0254}, {"ft", 0.3048}, {"yd", 0.9144}};
  for (const auto& [name, metres] : units) {
    if (unit == name) return metres;
  }
  double metres = 0;
  const auto [end, error] = std::from_chars(unit.data(), unit.data() + unit.size(), metres);
  if (error != std::errc() || end != unit.data() + unit.size() || !(metres > 0) || !std::isfinite(metres)) {
    throw std::invalid_argument(
        "unit \"" + std::string(unit) +
        "\" is none of m, cm, mm, km, in, ft, yd, nor a positive number of metres such as 0.01");
  }
  return metres;
}

Eigen::Matrix3d to_y_up(std::string_view up) {
  const bool has_sign = up.size() == 2 && (up[0] == '+' || up[0] == '-');
  const char axis = up.size() == 1 ? up[0] : has_sign ? up[1] : '?';
  const double sign = has_sign && up[0] == '-' ? -1 : 1;
  Eigen::Matrix3d turn;
  switch (axis) {
    case 'X':
      turn << 0, -sign, 0, sign, 0, 0, 0, 0, 1;
      break;
    case 'Y':
      turn << 1, 0, 0, 0, sign, 0, 0, 0, sign;
      break;
    case 'Z':
      turn << 1, 0, 0, 0, 0, sign, 0, -sign, 0;
      break;
    default:
      throw std::invalid_argument("up axis \"" + std::string(up) + "\" is none of +X, -X, +Y, -Y, +Z, -Z");
  }
  return turn;
}

}  // namespace strandbake
