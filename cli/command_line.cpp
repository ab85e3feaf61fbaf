#include "cli/command_line.h"

#include <CLI/CLI.hpp>
#include <string_view>

namespace strandbake {
namespace {

std::vector<std::string> split(std::string_view text, char at) {
  std::vector<std::string> parts;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find(at), text.size());
    parts.emplace_back(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return parts;
}

// "METRES:FLOAT in [0 - 1]", as CLI11 puts a value and what is asked of it.
void describe_value(const std::string& text, OptionDescription& option) {
  option.value = text.substr(0, text.find(':'));
  const auto between = [&](const char* open, char close) {
    const std::size_t at = text.find(open);
    if (at == std::string::npos) return std::string();
    const std::size_t begin = at + std::string_view(open).size();
    return text.substr(begin, text.find(close, begin) - begin);
  };
  option.choices = split(between(":{", '}'), ',');
  option.range = between(" in [", ']');
  if (const std::size_t dash = option.range.find(" - "); dash != std::string::npos)
    option.range.replace(dash, 3, " to ");
}

OptionDescription describe_option(const CLI::Option& option) {
  OptionDescription out;
  out.help = option.get_description();
  out.is_positional = option.get_positional();
  out.is_required = option.get_required();
  out.default_value = option.get_default_str();
  out.environment = option.get_envname();
  if (out.is_positional) {
    out.names = {option.get_name()};
  } else {
    for (const std::string& name : option.get_snames()) out.names.push_back('-' + name);
    for (const std::string& name : option.get_lnames()) out.names.push_back("--" + name);
  }
  if (option.get_type_size() > 0) {
    describe_value(option.get_type_name(), out);
    out.is_repeatable =
        option.get_expected_max() > 1 || option.get_multi_option_policy() == CLI::MultiOptionPolicy::TakeAll;
  }
  return out;
}

CommandDescription describe_command(const CLI::App& app, const std::string& name) {
  CommandDescription command;
  command.name = name;
  command.help = app.get_description();
  command.footer = app.get_footer();
  for (const CLI::Option* option : app.get_options()) command.options.push_back(describe_option(*option));
  for (const CLI::App* sub : app.get_subcommands([](const CLI::App*) { return true; })) {
    command.commands.push_back(describe_command(*sub, name.empty() ? sub->get_name() : name + ' ' + sub->get_name()));
  }
  return command;
}

}  // namespace

CommandDescription describe_command_line(const CLI::App& app) {
  return describe_command(app, "");
}

}  // namespace strandbake
