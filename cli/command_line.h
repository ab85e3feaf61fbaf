// The command line as it is declared to CLI11, in plain structs, and what is written from them for others than the
// program itself: a man page and the completion of shells.
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace strandbake {

struct OptionDescription {
  std::vector<std::string> names;  // "-o", "--output"; of a positional its name alone
  std::string help;
  std::string value;                 // "FILE"; empty: a flag
  std::vector<std::string> choices;  // what the value can be, where it is one of a few
  std::string range;                 // "1 to 4096"
  std::string default_value, environment;
  bool is_positional = false, is_required = false, is_repeatable = false;
};

struct CommandDescription {
  std::string name;  // "bench table2" below the program, which has none
  std::string help;
  std::string footer;
  std::vector<OptionDescription> options;
  std::vector<CommandDescription> commands;

  std::string word() const { return name.substr(name.rfind(' ') + 1); }
};

// Of the whole program.
CommandDescription describe_command_line(const CLI::App& app);

// roff, for man(1).
std::string man_page(const CommandDescription& program, const std::string& version);

// `keys` are those that --set takes.
std::string bash_completion(const CommandDescription& program, const std::vector<std::string>& keys);
std::string zsh_completion(const CommandDescription& program, const std::vector<std::string>& keys);
std::string fish_completion(const CommandDescription& program, const std::vector<std::string>& keys);

}  // namespace strandbake
