#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <string_view>

#include "cli/command_line.h"

namespace strandbake {
namespace {

// What a shell can offer for a value.
enum class Offer { Nothing, Files, Folders, Choices, Keys };
Offer offer_of(const OptionDescription& option) {
  if (!option.choices.empty()) return Offer::Choices;
  if (option.value == "FILE") return Offer::Files;
  if (option.value == "FOLDER") return Offer::Folders;
  if (option.value == "KEY=VALUE") return Offer::Keys;
  return Offer::Nothing;
}

// How a help text begins; a list of options has no room for more.
std::string brief(const std::string& help) {
  std::size_t end = help.size();
  for (const char* const pause : {"; ", ". ", ": ", ", e.g."}) end = std::min(end, help.find(pause));
  return help.substr(0, end);
}

// 'text' for a shell. `within`: what takes the place of an apostrophe.
std::string quoted(std::string_view text, std::string_view within) {
  std::string out = "'";
  for (const char c : text) {
    if (c == '\'') {
      out += within;
    } else {
      out += c;
    }
  }
  return out + '\'';
}
std::string sh(std::string_view text) {
  return quoted(text, "'\\''");
}
std::string fish(std::string_view text) {
  return quoted(text, "\\'");
}

// Every command of the tree but the program itself.
void for_each_command(const CommandDescription& command, const std::function<void(const CommandDescription&)>& use) {
  for (const CommandDescription& sub : command.commands) {
    use(sub);
    for_each_command(sub, use);
  }
}

// "/bake" and "bench/table2": a command that has been found, and the next word of it.
std::vector<std::string> steps(const CommandDescription& program) {
  std::vector<std::string> out;
  for_each_command(program, [&](const CommandDescription& command) {
    const std::size_t space = command.name.rfind(' ');
    out.push_back(space == std::string::npos ? '/' + command.name
                                             : command.name.substr(0, space) + '/' + command.word());
  });
  return out;
}

std::vector<std::string> words_of(const CommandDescription& command) {
  std::vector<std::string> words;
  for (const CommandDescription& sub : command.commands) words.push_back(sub.word());
  return words;
}

std::vector<std::string> names_of(const CommandDescription& command) {
  std::vector<std::string> names;
  for (const OptionDescription& option : command.options)
    if (!option.is_positional) names.insert(names.end(), option.names.begin(), option.names.end());
  return names;
}

bool takes_files(const CommandDescription& command) {
  return std::any_of(command.options.begin(), command.options.end(), [](const OptionDescription& option) {
    return option.is_positional && offer_of(option) == Offer::Files;
  });
}

std::string bash_values(const CommandDescription& command) {
  std::string text;
  for (const OptionDescription& option : command.options) {
    if (option.is_positional || option.value.empty()) continue;
    std::string patterns;
    for (const std::string& name : option.names)
      patterns += (patterns.empty() ? "" : " | ") + sh(command.name + ' ' + name);
    std::string offer;
    switch (offer_of(option)) {
      case Offer::Nothing:
        break;
      case Offer::Files:
        offer = "_strandbake_paths -f; ";
        break;
      case Offer::Folders:
        offer = "_strandbake_paths -d; ";
        break;
      case Offer::Choices:
        offer = fmt::format("_strandbake_words {}; ", sh(fmt::format("{}", fmt::join(option.choices, " "))));
        break;
      case Offer::Keys:
        offer = "compopt -o nospace 2>/dev/null; _strandbake_words \"$keys\"; ";
        break;
    }
    text += fmt::format("    {}) {}return ;;\n", patterns, offer);
  }
  for (const CommandDescription& sub : command.commands) text += bash_values(sub);
  return text;
}

std::string zsh_escaped(const std::string& text, std::string_view special) {
  std::string out;
  for (const char c : text) {
    if (c == '\\' || special.find(c) != std::string_view::npos) out += '\\';
    out += c;
  }
  return out;
}

std::string zsh_argument(const OptionDescription& option) {
  std::string action;
  switch (offer_of(option)) {
    case Offer::Nothing:
      action = " ";
      break;
    case Offer::Files:
      action = "_files";
      break;
    case Offer::Folders:
      action = "_files -/";
      break;
    case Offer::Choices:
      action = fmt::format("({})", fmt::join(option.choices, " "));
      break;
    case Offer::Keys:
      action = "{compadd -S \"\" -- $keys}";
      break;
  }
  if (option.is_positional) return sh(fmt::format(":{}:{}", zsh_escaped(option.names.front(), ":"), action));
  const std::string help = '[' + zsh_escaped(brief(option.help), "[]") + ']';
  const std::string value = option.value.empty() ? "" : fmt::format(":{}:{}", zsh_escaped(option.value, ":"), action);
  std::string text;
  for (const std::string& name : option.names) {
    const std::string others = option.is_repeatable ? "*" : fmt::format("({})", fmt::join(option.names, " "));
    const std::string joined = option.value.empty() ? "" : name.size() == 2 ? "+" : "=";
    text += (text.empty() ? "" : " \\\n    ") + sh(others + name + joined + help + value);
  }
  return text;
}

// `locals`: what the function and those that it calls see.
void zsh_function(const CommandDescription& command, const std::string& locals, std::string& text) {
  std::string name = command.name;
  std::replace(name.begin(), name.end(), ' ', '_');
  const std::string function = "_strandbake" + (name.empty() ? "" : '_' + name);
  text += function + "() {\n" + locals;
  if (!command.commands.empty())
    text += "  local state line curcontext=\"$curcontext\"\n  local -a commands\n  typeset -A opt_args\n";
  text += command.commands.empty() ? "  _arguments -S" : "  _arguments -C";
  for (const OptionDescription& option : command.options) text += " \\\n    " + zsh_argument(option);
  if (!command.commands.empty()) {
    text += " \\\n    ': :->command' \\\n    '*:: :->arguments'\n  case $state in\n    command)\n      commands=(\n";
    for (const CommandDescription& sub : command.commands)
      text += "        " + sh(sub.word() + ':' + zsh_escaped(brief(sub.help), ":")) + '\n';
    text += "      )\n      _describe command commands ;;\n    arguments)\n";
    text += fmt::format("      (( $+functions[{0}_$words[1]] )) && {0}_$words[1] ;;\n  esac", function);
  }
  text += "\n}\n";
  for (const CommandDescription& sub : command.commands) zsh_function(sub, "", text);
}

std::string fish_options(const CommandDescription& command, const std::string& keys) {
  std::string text;
  const std::string at = "complete -c strandbake -n " + fish("__strandbake_at " + command.name);
  for (const CommandDescription& sub : command.commands)
    text += fmt::format("{} -a {} -d {}\n", at, sub.word(), fish(brief(sub.help)));
  if (takes_files(command)) text += at + " -F\n";
  for (const OptionDescription& option : command.options) {
    if (option.is_positional) continue;
    text += at;
    for (const std::string& name : option.names)
      text += name.size() == 2 ? " -s " + name.substr(1) : " -l " + name.substr(2);
    if (!option.value.empty()) {
      switch (offer_of(option)) {
        case Offer::Nothing:
          text += " -x";
          break;
        case Offer::Files:
          text += " -rF";
          break;
        case Offer::Folders:
          text += " -xa '(__fish_complete_directories)'";
          break;
        case Offer::Choices:
          text += " -xa " + fish(fmt::format("{}", fmt::join(option.choices, " ")));
          break;
        case Offer::Keys:
          text += " -xa " + fish(keys);
          break;
      }
    }
    text += " -d " + fish(brief(option.help)) + '\n';
  }
  for (const CommandDescription& sub : command.commands) text += fish_options(sub, keys);
  return text;
}

}  // namespace

std::string bash_completion(const CommandDescription& program, const std::vector<std::string>& keys) {
  std::string text = R"(# bash completion for strandbake, written by `strandbake docs --completion bash`.

_strandbake_words() {
  mapfile -t COMPREPLY < <(compgen -W "$1" -- "$word")
}

_strandbake_paths() {
  compopt -o filenames 2>/dev/null
  mapfile -t COMPREPLY < <(compgen "$1" -- "$word")
}

_strandbake() {
  local word=${COMP_WORDS[COMP_CWORD]} previous=${COMP_WORDS[COMP_CWORD - 1]} command='' words='' i
  COMPREPLY=()
  # bash parts "--frames=1-2" at the "=".
  if [[ $word == = ]]; then
    word=''
  elif [[ $previous == = ]]; then
    previous=${COMP_WORDS[COMP_CWORD - 2]}
  fi
  for ((i = 1; i < COMP_CWORD; i++)); do
    case "$command/${COMP_WORDS[i]}" in
)";
  text +=
      fmt::format("      {}) command=${{command:+$command }}${{COMP_WORDS[i]}} ;;\n", fmt::join(steps(program), " | "));
  text += "    esac\n  done\n";
  text += fmt::format("  local keys={}\n", sh(fmt::format("{}", fmt::join(keys, " "))));
  text += "  case \"$command $previous\" in\n" + bash_values(program) + "  esac\n";
  text += "  if [[ $word == -* ]]; then\n    case $command in\n";
  const auto add = [&](const CommandDescription& command, const std::vector<std::string>& words) {
    if (words.empty()) return;
    text += fmt::format("      {}) words={} ;;\n", sh(command.name), sh(fmt::format("{}", fmt::join(words, " "))));
  };
  const auto add_each = [&](auto&& what) {
    add(program, what(program));
    for_each_command(program, [&](const CommandDescription& command) { add(command, what(command)); });
  };
  add_each(names_of);
  text += "    esac\n  else\n    case $command in\n";
  add_each(words_of);
  for_each_command(program, [&](const CommandDescription& command) {
    if (takes_files(command)) text += fmt::format("      {}) _strandbake_paths -f; return ;;\n", sh(command.name));
  });
  text += "    esac\n  fi\n  _strandbake_words \"$words\"\n}\n\ncomplete -F _strandbake strandbake\n";
  return text;
}

std::string zsh_completion(const CommandDescription& program, const std::vector<std::string>& keys) {
  std::string text =
      "#compdef strandbake\n# zsh completion for strandbake, written by `strandbake docs --completion zsh`.\n\n";
  std::string locals = "  local -a keys=(";
  for (const std::string& key : keys) locals += ' ' + sh(key);
  zsh_function(program, locals + " )\n", text);
  return text + "\n_strandbake \"$@\"\n";
}

std::string fish_completion(const CommandDescription& program, const std::vector<std::string>& keys) {
  std::string text = R"(# fish completion for strandbake, written by `strandbake docs --completion fish`.

# Whether the words so far name just this command.
function __strandbake_at
  set -l command
  for word in (commandline -opc)[2..-1]
    switch "$command/$word"
)";
  std::string cases;
  for (const std::string& step : steps(program)) cases += ' ' + step;
  text += "      case" + cases + "\n        set command (string trim \"$command $word\")\n";
  text += "    end\n  end\n  test \"$command\" = \"$argv\"\nend\n\ncomplete -c strandbake -f\n";
  return text + fish_options(program, fmt::format("{}", fmt::join(keys, " ")));
}

}  // namespace strandbake
