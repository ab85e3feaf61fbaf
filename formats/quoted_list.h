// Names in a message.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace strandbake {

// "a", "b", "c" and 4 more
inline std::string quoted_list(const std::vector<std::string>& names, std::size_t most = 8) {
  std::string text;
  for (std::size_t k = 0; k < names.size() && k < most; ++k) text += (k ? ", \"" : "\"") + names[k] + "\"";
  if (names.size() > most) text += " and " + std::to_string(names.size() - most) + " more";
  return text;
}

}  // namespace strandbake
