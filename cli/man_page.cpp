#include <fmt/format.h>

#include <algorithm>
#include <map>

#include "cli/command_line.h"

namespace strandbake {
namespace {

// Text for roff, which reads backslashes, and dots and apostrophes at the start of a line; a plain '-' may become a
// hyphen.
std::string roff(const std::string& text) {
  std::string out;
  if (!text.empty() && (text.front() == '.' || text.front() == '\'')) out = "\\&";
  for (const char c : text) {
    if (c == '\\') {
      out += "\\e";
    } else if (c == '-') {
      out += "\\-";
    } else {
      out += c;
    }
  }
  return out;
}
std::string bold(const std::string& text) {
  return "\\fB" + roff(text) + "\\fR";
}
std::string italic(const std::string& text) {
  return "\\fI" + roff(text) + "\\fR";
}
std::string sentence(const std::string& text) {
  return text.empty() || text.back() == '.' ? text : text + '.';
}

// `only`: the commands that have it, where others beside them do not.
std::string option_entry(const OptionDescription& option, const std::string& only) {
  std::string names;
  for (const std::string& name : option.names) names += (names.empty() ? "" : ", ") + bold(name);
  if (option.is_positional) {
    names = italic(option.names.front());
  } else if (!option.value.empty()) {
    names += ' ' + italic(option.value);
  }
  std::string text = sentence(option.help);
  if (!only.empty()) text = only + ": " + text;
  if (!option.choices.empty()) text += fmt::format(" One of {}.", fmt::join(option.choices, ", "));
  if (!option.range.empty()) text += fmt::format(" From {}.", option.range);
  if (!option.default_value.empty()) text += fmt::format(" Default: {}.", option.default_value);
  if (option.is_required && !option.is_positional) text += " Must be given.";
  if (!option.environment.empty()) text += fmt::format(" Environment: {}.", option.environment);
  return fmt::format(".TP\n{}\n{}\n", names, roff(text));
}

std::string synopsis(const CommandDescription& command) {
  std::string text = bold("strandbake " + command.name);
  for (const OptionDescription& option : command.options) {
    if (option.is_positional) text += ' ' + italic(option.names.front());
  }
  if (!command.commands.empty()) text += ' ' + italic("name");
  return text + " [" + italic("options") + ']';
}

bool is_help(const OptionDescription& option) {
  return option.names.back() == "--help";
}

// The options of a command, or of all that are below it, each once. --help is told about once for all.
std::string options_text(const CommandDescription& command) {
  if (command.commands.empty()) {
    std::string arguments, text;
    for (const OptionDescription& option : command.options) {
      if (!is_help(option)) (option.is_positional ? arguments : text) += option_entry(option, "");
    }
    return arguments + text;
  }
  std::vector<const OptionDescription*> options;
  std::map<std::string, std::vector<std::string>> having;
  for (const CommandDescription& sub : command.commands) {
    for (const OptionDescription& option : sub.options) {
      if (is_help(option)) continue;
      std::vector<std::string>& commands = having[option.names.back()];
      if (commands.empty()) options.push_back(&option);
      commands.push_back(sub.word());
    }
  }
  std::string text;
  for (const OptionDescription* option : options) {
    const std::vector<std::string>& commands = having[option->names.back()];
    const bool is_common = commands.size() == command.commands.size();
    text += option_entry(*option, is_common ? "" : fmt::format("{}", fmt::join(commands, ", ")));
  }
  return text;
}

// The variables that stand for options.
std::map<std::string, std::string> environment_of(const CommandDescription& command) {
  std::map<std::string, std::string> found;
  for (const OptionDescription& option : command.options) {
    if (!option.environment.empty())
      found[option.environment] = fmt::format("{} of {}", option.names.back(), command.name);
  }
  for (const CommandDescription& sub : command.commands) {
    for (const auto& [name, use] : environment_of(sub)) {
      std::string& uses = found[name];
      uses += (uses.empty() ? "" : ", ") + use;
    }
  }
  return found;
}

}  // namespace

std::string man_page(const CommandDescription& program, const std::string& version) {
  std::string text = fmt::format(".TH STRANDBAKE 1 \"\" \"strandbake {}\" \"User Commands\"\n", version);
  text += ".SH NAME\nstrandbake \\- simulates hair offline\n.SH SYNOPSIS\n";
  std::vector<std::string> lines;
  for (const CommandDescription& command : program.commands) lines.push_back(synopsis(command) + '\n');
  text += fmt::format("{}", fmt::join(lines, ".br\n"));
  text += fmt::format(".SH DESCRIPTION\n{}\n", roff(program.help));
  for (const CommandDescription& command : program.commands) {
    text += fmt::format(".SS {}\n{}\n", synopsis(command), roff(sentence(command.help)));
    for (const CommandDescription& sub : command.commands)
      text += fmt::format(".TP\n{}\n{}\n", bold(sub.word()), roff(sentence(sub.help)));
    text += options_text(command);
  }
  text += ".SH OPTIONS\n";
  for (const OptionDescription& option : program.options)
    text += option_entry(option, is_help(option) ? "Also behind a verb" : "");
  text += fmt::format(".SH EXIT STATUS\n{}\n.SH ENVIRONMENT\n", roff(program.footer));
  for (const auto& [name, use] : environment_of(program))
    text += fmt::format(".TP\n{}\n{}\n", bold(name), roff(fmt::format("Stands for {} where that is not given.", use)));
  text += ".TP\n" + bold("STRANDBAKE_PATH") + "\n" + roff("Folders of --search, divided by ':'.") + '\n';
  text += ".SH SEE ALSO\n" + bold("strandbake docs") + " prints the reference of the scene file.\n";
  return text;
}

}  // namespace strandbake
