#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/command_line.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "cli/version.h"
#include "formats/scene.h"

namespace strandbake {
namespace {

struct DocsOptions {
  bool example = false, man = false, json = false;
  std::string schema, shell;
};

nlohmann::ordered_json reference_json() {
  nlohmann::ordered_json tables = nlohmann::ordered_json::array();
  for (const TableDescription& table : describe_scene()) {
    nlohmann::ordered_json parameters = nlohmann::ordered_json::array();
    for (const ParameterDescription& p : table.parameters) {
      parameters.push_back({{"key", p.key},
                            {"type", p.type},
                            {"unit", p.unit},
                            {"default", p.value},
                            {"range", p.range},
                            {"keyed", p.is_keyed},
                            {"help", p.help}});
    }
    tables.push_back({{"name", table.name}, {"list", table.is_list}, {"help", table.help}, {"parameters", parameters}});
  }
  return {{"tables", tables}};
}

// What --set takes, but for what is counted within a list.
std::vector<std::string> override_keys() {
  std::vector<std::string> keys;
  for (const TableDescription& table : describe_scene()) {
    for (const ParameterDescription& p : table.parameters) {
      if (p.type == "table" || p.type == "list" || p.key.find("[]") != std::string::npos) continue;
      keys.push_back(fmt::format("{}{}.{}=", table.name, table.is_list ? "[0]" : "", p.key));
    }
  }
  return keys;
}

int run_docs(const DocsOptions& options, const CLI::App& program) {
  if (options.json) {
    print_json("docs", reference_json());
  } else if (options.example) {
    fmt::print("{}", default_scene());
  } else if (!options.schema.empty()) {
    fmt::print("{}", schema_of(options.schema).text);
  } else if (options.man) {
    fmt::print("{}", man_page(describe_command_line(program), STRANDBAKE_VERSION));
  } else if (!options.shell.empty()) {
    const auto write = options.shell == "bash"  ? bash_completion
                       : options.shell == "zsh" ? zsh_completion
                                                : fish_completion;
    fmt::print("{}", write(describe_command_line(program), override_keys()));
  } else {
    fmt::print("{}", scene_reference());
  }
  return kGood;
}

}  // namespace

Verb add_docs(CLI::App& app) {
  auto options = std::make_shared<DocsOptions>();
  std::vector<std::string> verbs;
  for (const Schema& schema : schemas()) verbs.emplace_back(schema.verb);
  app.add_flag("--json", options->json, "The reference as one JSON object");
  app.add_flag("--example", options->example,
               "A commented scene with every parameter at its default, in place of the reference");
  app.add_option("--schema", options->schema, "The JSON Schema of what this verb prints with --json")
      ->type_name("VERB")
      ->check(CLI::IsMember(verbs));
  app.add_flag("--man", options->man, "The manual page strandbake(1), as roff");
  app.add_option("--completion", options->shell, "Completion for this shell")
      ->type_name("SHELL")
      ->check(CLI::IsMember({"bash", "zsh", "fish"}));
  app.require_option(0, 1);
  return [options, &app] { return run_docs(*options, *app.get_parent()); };
}

}  // namespace strandbake
