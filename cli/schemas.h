// What verbs print with --json. docs/schemas/ has a JSON Schema for each verb, which the build puts into the program.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <span>
#include <string_view>

namespace strandbake {

struct Schema {
  std::string_view verb;
  std::string_view id;  // "urn:strandbake:info:1"; the number grows when a field goes, or changes its meaning
  std::string_view text;
};
std::span<const Schema> schemas();
// Throws std::out_of_range for a verb that has none.
const Schema& schema_of(std::string_view verb);

// Prints `object` on a line of its own, or indented over several, with the verb's schema as its first field. Text that
// is no UTF-8, as names of files need not be, gets replacement characters. Throws std::system_error where a line cannot
// be written; a script may wait for each.
void print_json(std::string_view verb, const nlohmann::ordered_json& object);
void print_json_line(std::string_view verb, const nlohmann::ordered_json& object);

}  // namespace strandbake
