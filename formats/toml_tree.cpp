#include "formats/toml_tree.h"

#include <fmt/format.h>

// Some assertions of the parser fail on malformed texts ("[[ {") that it refuses properly in the next lines. As they
// are, they would end the program, or with NDEBUG tell the compiler to leave the refusal out.
#undef NDEBUG
#define TOML_ASSERT(expression) static_assert(true)
#include <toml++/toml.h>

namespace strandbake {
namespace {

// Dots and brackets around a value.
constexpr int max_depth = 64;

// Refuses what toml++ cannot be given: keys and brackets so deep that its recursion would overflow the stack (it limits
// brackets alone), and characters beyond ASCII outside of texts and comments, for which its search for white space is
// undefined. Understands no more of TOML than texts and comments; what it says after the first fault of syntax may be
// wrong, but toml++ reads no further than that.
class Precheck {
 public:
  explicit Precheck(std::string_view text) : text_(text) {}

  void run() {
    constexpr std::string_view byte_order_mark = "\xEF\xBB\xBF";
    if (text_.substr(0, byte_order_mark.size()) == byte_order_mark) at_ = byte_order_mark.size();
    while (at_ < text_.size()) {
      const char c = text_[at_];
      if (c == '"' || c == '\'') {
        skip_string(c);
        continue;
      }
      if (c == '#') {
        while (at_ < text_.size() && text_[at_] != '\n') step();
        continue;
      }
      follow(c);
      step();
    }
  }

 private:
  void follow(char c) {
    if (c == '.') {
      ++dots_.back();
      ++depth_;
    } else if (c == '[' || c == '{') {
      dots_.push_back(0);
      ++depth_;
    } else if ((c == ']' || c == '}') && dots_.size() > 1) {
      depth_ -= dots_.back() + 1;
      dots_.pop_back();
    } else if (c == ',' || (c == '\n' && dots_.size() == 1)) {
      depth_ -= dots_.back();
      dots_.back() = 0;
    }
    if (depth_ > max_depth) refuse(fmt::format("nested too deeply, more than {} levels are never needed", max_depth));
    if (static_cast<unsigned char>(c) >= 0x80)
      refuse("this character can only stand in a text in plain quotes or in a comment");
  }

  [[noreturn]] void refuse(const std::string& why) const { throw TomlError(Origin{-1, line_, column_}, why); }

  void step() {
    const char c = text_[at_++];
    if (c == '\n') {
      ++line_;
      column_ = 1;
    } else if ((static_cast<unsigned char>(c) & 0xC0u) != 0x80u) {
      ++column_;
    }
  }

  void step(std::size_t count) {
    for (; count > 0 && at_ < text_.size(); --count) step();
  }

  void skip_string(char quote) {
    const std::string three(3, quote);
    const bool long_form = text_.substr(at_, 3) == three;
    step(long_form ? 3 : 1);
    while (at_ < text_.size()) {
      const char c = text_[at_];
      if (!long_form && c == '\n') return;
      if (c == '\\' && quote == '"') {
        step(2);
      } else if (long_form && text_.substr(at_, 3) == three) {
        step(3);
        for (int extra = 0; extra < 2 && at_ < text_.size() && text_[at_] == quote; ++extra) step();  // """a quote""""
        return;
      } else {
        step();
        if (!long_form && c == quote) return;
      }
    }
  }

  std::string_view text_;
  std::size_t at_ = 0;
  int line_ = 1, column_ = 1;
  int depth_ = 0;
  std::vector<int> dots_ = {0};  // dots in force, for each open bracket
};

Origin origin_of(const toml::source_region& source) {
  Origin origin;
  if (source.begin) {
    origin.line = static_cast<int>(source.begin.line);
    origin.column = static_cast<int>(source.begin.column);
  }
  return origin;
}

TomlNode convert(const toml::node& from) {
  TomlNode node;
  node.origin = origin_of(from.source());
  switch (from.type()) {
    case toml::node_type::string:
      node.kind = TomlNode::Kind::Text;
      node.text = from.as_string()->get();
      break;
    case toml::node_type::integer:
      node.kind = TomlNode::Kind::Integer;
      node.integer = from.as_integer()->get();
      break;
    case toml::node_type::floating_point:
      node.kind = TomlNode::Kind::Number;
      node.number = from.as_floating_point()->get();
      break;
    case toml::node_type::boolean:
      node.kind = TomlNode::Kind::Switch;
      node.on = from.as_boolean()->get();
      break;
    case toml::node_type::array:
      node.kind = TomlNode::Kind::List;
      for (const toml::node& item : *from.as_array()) node.children.push_back(convert(item));
      break;
    case toml::node_type::table:
      node.kind = TomlNode::Kind::Table;
      for (auto&& [key, value] : *from.as_table()) {
        node.children.push_back(convert(value));
        node.children.back().key = key.str();
        node.children.back().key_origin = origin_of(key.source());
      }
      break;
    default:
      node.kind = TomlNode::Kind::Time;
  }
  return node;
}

}  // namespace

const TomlNode* TomlNode::find(std::string_view wanted) const {
  for (const TomlNode& child : children) {
    if (child.key == wanted) return &child;
  }
  return nullptr;
}

TomlNode* TomlNode::find(std::string_view wanted) {
  return const_cast<TomlNode*>(static_cast<const TomlNode*>(this)->find(wanted));
}

TomlNode parse_toml(std::string_view text) {
  Precheck(text).run();
  try {
    return convert(toml::parse(text));
  } catch (const toml::parse_error& error) {
    throw TomlError(origin_of(error.source()), std::string(error.description()));
  }
}

}  // namespace strandbake
