#include "cli/schemas.h"

#include <fmt/format.h>

#include <cerrno>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <system_error>

namespace strandbake {
namespace {

std::string text_of(std::string_view verb, const nlohmann::ordered_json& object, int indent) {
  nlohmann::ordered_json out = {{"schema", schema_of(verb).id}};
  out.update(object);
  return out.dump(indent, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

}  // namespace

const Schema& schema_of(std::string_view verb) {
  for (const Schema& schema : schemas())
    if (schema.verb == verb) return schema;
  throw std::out_of_range(fmt::format("{} has no schema", verb));
}

void print_json(std::string_view verb, const nlohmann::ordered_json& object) {
  fmt::print("{}\n", text_of(verb, object, 2));
}

void print_json_line(std::string_view verb, const nlohmann::ordered_json& object) {
  fmt::print("{}\n", text_of(verb, object, -1));
  if (std::fflush(stdout) != 0) throw std::system_error(errno, std::generic_category(), "standard output");
}

}  // namespace strandbake
