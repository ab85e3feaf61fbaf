// Units and axes of an input, converted at the door: inside, everything is metres with +Y up.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>

namespace strandbake {

// Metres per unit for "m", "cm", "mm", "km", "in", "ft", "yd" or a positive number written as text ("0.01").
// Throws std::invalid_argument, whose text lists what would do.
double metres_per_unit(std::string_view unit);

// The rotation that takes coordinates whose up axis is "+X", "-X", "+Y", "-Y", "+Z" or "-Z" (the sign may be left out
// where it is +) to +Y up: a quarter turn about x for the z axes, about z for the x
// axes, and for "-Y" half a turn about x. "+Z": (x, y, z) becomes (x, z, -y). Exact: its entries are 0, 1 and -1, its
// determinant 1. Throws std::invalid_argument.
Eigen::Matrix3d to_y_up(std::string_view up);

}  // namespace strandbake
