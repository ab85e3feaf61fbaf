#include "cli/checks.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <charconv>
#include <string>
#include <system_error>

#include "formats/error.h"

namespace strandbake {

void require_free(const std::filesystem::path& output, bool force, const std::filesystem::path& input) {
  std::error_code ignored;
  if (!std::filesystem::exists(output, ignored)) return;
  if (!std::filesystem::is_regular_file(output, ignored))
    throw DiskError(fmt::format("{}: is {}; name a file", output.string(),
                                std::filesystem::is_directory(output, ignored) ? "a folder" : "a device or a pipe"));
  if (!input.empty() && std::filesystem::equivalent(output, input, ignored))
    throw DiskError(fmt::format("{}: is the file that is read; name another", output.string()));
  if (!force)
    throw DiskError(fmt::format("{}: there is a file of this name already; --force replaces it", output.string()));
}

CLI::Validator number_between(double low, double high) {
  const auto check = [low, high](const std::string& text) -> std::string {
    double value = 0;
    const char* const end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data(), end, value);
    if (error == std::errc{} && stop == end && value >= low && value <= high) return {};
    return fmt::format("{} is not a number from {:g} to {:g}", text, low, high);
  };
  return CLI::Validator(check, fmt::format("FLOAT in [{:g} - {:g}]", low, high));
}

}  // namespace strandbake
