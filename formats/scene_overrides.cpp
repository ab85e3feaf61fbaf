#include "formats/scene_overrides.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>

#include "formats/scene_words.h"
#include "formats/similar_names.h"

namespace strandbake {
namespace {

struct Step {
  std::string name;
  std::optional<std::size_t> index;  // "[0]": then there is no name
};

constexpr const char* would_do = "write key=value, for example bake.fps=30 or region.tail.damping=0.2";

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

// The key of an override, up to its "=": a.b[0]."a name with a dot". Takes what it reads from the front of `rest`.
// Throws std::invalid_argument.
std::vector<Step> parse_key(std::string_view& rest) {
  constexpr std::size_t most_steps = 16;  // twice as deep as any parameter lies
  std::vector<Step> steps;
  const auto refuse = [](const std::string& why) { throw std::invalid_argument(why + ": " + would_do); };
  bool wants_name = true;
  for (;;) {
    while (!rest.empty() && (rest.front() == ' ' || rest.front() == '\t')) rest.remove_prefix(1);
    if (rest.empty()) refuse("there is no \"=\"");
    const char c = rest.front();
    if (steps.size() == most_steps) refuse("the key has too many parts");
    if (wants_name) {
      std::size_t end = rest.find_first_of(".[]=\"' \t");
      if (c == '"' || c == '\'') {
        end = rest.find(c, 1);
        if (end == std::string_view::npos) refuse("a quote is not closed");
        steps.push_back({std::string(rest.substr(1, end - 1)), std::nullopt});
        ++end;
      } else {
        if (end == std::string_view::npos) refuse("there is no \"=\"");
        if (end == 0) refuse("the key has an empty part");
        steps.push_back({std::string(rest.substr(0, end)), std::nullopt});
      }
      rest.remove_prefix(end);
      wants_name = false;
    } else if (c == '.') {
      rest.remove_prefix(1);
      wants_name = true;
    } else if (c == '[') {
      std::size_t index = 0;
      const auto [end, error] = std::from_chars(rest.data() + 1, rest.data() + rest.size(), index);
      if (error != std::errc{} || end == rest.data() + rest.size() || *end != ']') {
        refuse("the number between \"[\" and \"]\" is not a whole number from 0");
      }
      steps.push_back({{}, index});
      rest.remove_prefix(static_cast<std::size_t>(end - rest.data()) + 1);
    } else if (c == '=') {
      rest.remove_prefix(1);
      return steps;
    } else {
      refuse("the key is followed by " + in_quotes(rest.substr(0, 1)));
    }
  }
}

void set_origin(TomlNode& node, const Origin& origin) {
  node.origin = node.key_origin = origin;
  for (TomlNode& child : node.children) set_origin(child, origin);
}

// TOML, or the text as it stands where it is not TOML. Throws std::invalid_argument for what no TOML text can hold: the
// provenance of a cache could not be read again.
TomlNode parse_value(std::string_view text, const Origin& origin) {
  TomlNode value;
  value.kind = TomlNode::Kind::Text;
  value.text = text;
  try {
    TomlNode document = parse_toml("value = " + std::string(text));
    if (document.children.size() == 1 && document.children[0].key == "value") value = std::move(document.children[0]);
  } catch (const TomlError&) {
    // A bare text: the reader says so where it does not want one.
    try {
      parse_toml("value = " + toml_text(text));
    } catch (const TomlError&) {
      throw std::invalid_argument("the value is not a text in UTF-8");
    }
  }
  set_origin(value, origin);
  value.bare = text;
  return value;
}

TomlNode make_node(TomlNode::Kind kind, const std::string& key, const Origin& origin) {
  TomlNode node;
  node.kind = kind;
  node.key = key;
  node.origin = node.key_origin = origin;
  return node;
}

// Follows the steps of one override from the root.
class Walk {
 public:
  Walk(TomlNode& root, const Origin& origin, const std::vector<std::string>& lists)
      : node_(&root), origin_(origin), lists_(lists) {}

  void take(const Step& step, bool goes_on) {
    if (step.index) {
      take_index(*step.index);
    } else if (node_->kind == TomlNode::Kind::List) {
      take_named_item(step.name);
    } else {
      take_name(step.name, goes_on);
    }
  }

  // Takes back what the way added, so that a faulty override leaves nothing behind.
  void undo() {
    if (grown_) grown_->children.pop_back();
  }

  void put(TomlNode value) {
    value.key = node_->key;
    *node_ = std::move(value);
  }

 private:
  void take_index(std::size_t index) {
    if (node_->kind != TomlNode::Kind::List) {
      const auto slip = closest(path_, lists_);
      throw std::invalid_argument(in_quotes(path_) + " is not a list" +
                                  (slip && *slip != path_ ? ", did you mean " + in_quotes(*slip) + "?" : ""));
    }
    if (index >= node_->children.size()) {
      throw std::invalid_argument(fmt::format(
          "there is no {}: {} has {}", in_quotes(fmt::format("{}[{}]", path_, index)), in_quotes(path_),
          node_->children.empty() ? "no entries" : fmt::format("entries 0 to {}", node_->children.size() - 1)));
    }
    path_ += fmt::format("[{}]", index);
    node_ = &node_->children[index];
  }

  void take_named_item(const std::string& name) {
    if (path_ != "region") {
      throw std::invalid_argument(
          fmt::format("{} is a list: write {} for its first entry", in_quotes(path_), in_quotes(path_ + "[0]")));
    }
    std::vector<std::string> names;
    for (TomlNode& region : node_->children) {
      const TomlNode* its_name = region.find("name");
      if (!its_name || its_name->kind != TomlNode::Kind::Text) continue;
      if (its_name->text == name) {
        path_ += '.' + name;
        node_ = &region;
        return;
      }
      names.push_back(its_name->text);
    }
    const auto slip = closest(name, names);
    throw std::invalid_argument(fmt::format("no region is named {}{}", in_quotes(name),
                                            slip            ? fmt::format(", did you mean {}?", in_quotes(*slip))
                                            : names.empty() ? std::string()
                                                            : fmt::format(", the scene has {}", listed(names))));
  }

  void take_name(const std::string& name, bool goes_on) {
    if (node_->kind != TomlNode::Kind::Table) {
      throw std::invalid_argument(fmt::format("{} is not a table, so it has no {}", in_quotes(path_), in_quotes(name)));
    }
    if (!path_.empty()) path_ += '.';
    path_ += name;
    TomlNode* child = node_->find(name);
    if (!child) {
      if (!grown_) grown_ = node_;
      node_->children.push_back(make_node(TomlNode::Kind::Table, name, origin_));
      child = &node_->children.back();
      if (goes_on && std::find(lists_.begin(), lists_.end(), path_) != lists_.end()) {
        child->kind = TomlNode::Kind::List;
        if (path_ == "region") child->children.push_back(only_region());
      }
    }
    node_ = child;
  }

  // What a scene without regions has.
  TomlNode only_region() const {
    TomlNode region = make_node(TomlNode::Kind::Table, "", origin_);
    region.children.push_back(make_node(TomlNode::Kind::Text, "name", origin_));
    region.children.back().text = "hair";
    return region;
  }

  TomlNode* node_;
  TomlNode* grown_ = nullptr;  // the first table that got a new entry
  Origin origin_;
  const std::vector<std::string>& lists_;
  std::string path_;
};

}  // namespace

void apply_overrides(TomlNode& root, const std::vector<std::string>& overrides, const std::vector<std::string>& lists,
                     const OverrideFault& fault) {
  for (std::size_t k = 0; k < overrides.size(); ++k) {
    const Origin origin{static_cast<int>(k), 1, 1};
    Walk walk(root, origin, lists);
    try {
      std::string_view rest = overrides[k];
      const std::vector<Step> steps = parse_key(rest);
      for (std::size_t s = 0; s < steps.size(); ++s) walk.take(steps[s], s + 1 < steps.size());
      walk.put(parse_value(trimmed(rest), origin));
    } catch (const std::invalid_argument& error) {
      walk.undo();
      fault(k, error.what());
    }
  }
}

}  // namespace strandbake
