// How the scene reader says things: values as TOML, ranges in words. Part of the scene reader.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "sim/declare.h"

namespace strandbake {

// Values as TOML, numbers as the shortest text that reads back to the same bits; the same in every locale.
std::string toml_text(double value);
std::string toml_text(int value);
std::string toml_text(bool value);
std::string toml_text(const std::optional<int>& value);  // none: "auto"
std::string toml_text(std::string_view value);
inline std::string toml_text(const std::string& value) {
  return toml_text(std::string_view(value));
}
std::string toml_text(const Eigen::Vector3d& value);
// A key-frame table: {1 = 0.3, 48 = 0.8}; `scalar` writes x alone.
std::string toml_text(const Curve& curve, bool scalar);

// Not much longer than so many bytes, with "..." where something was cut off.
std::string shortened(std::string_view text, std::size_t longest);
// A piece of input in quotes for a message: one line, shortened.
std::string in_quotes(std::string_view text);
// "a", "b" or "c"
std::string listed(const std::vector<std::string>& words);

// "from 0 to 1", "more than 0", "at least 0", "a finite number"
std::string range_text(const Range& range);

}  // namespace strandbake
