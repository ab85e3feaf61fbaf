// Names that someone may have meant who wrote another.
#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace strandbake {

// The names nearest to `word`, at most so many, best first: with the fewest wrong, missing, extra or swapped letters,
// where case does not count. Equally near ones stay in their order. Names of more than 200 bytes are left out.
std::vector<std::string> nearest(std::string_view word, const std::vector<std::string>& names, std::size_t most);

// The nearest name, where it is near enough for a slip of the pen.
std::optional<std::string> closest(std::string_view word, const std::vector<std::string>& names);

}  // namespace strandbake
