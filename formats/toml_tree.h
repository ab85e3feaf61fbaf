// A TOML text as a tree in which every value knows where it was written. Part of the scene reader.
#pragma once

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

namespace strandbake {

// Where something was written. Sorts the file before the overrides, and both from front to back.
struct Origin {
  int set = -1;  // index of the override that wrote it, -1: the file
  int line = 1;
  int column = 1;  // in characters, both from 1

  friend bool operator<(const Origin& a, const Origin& b) {
    return std::tie(a.set, a.line, a.column) < std::tie(b.set, b.line, b.column);
  }
};

struct TomlNode {
  enum class Kind { Text, Integer, Number, Switch, Time, List, Table };

  Kind kind = Kind::Table;
  Origin origin;
  std::string key;    // of an entry of a table
  Origin key_origin;  // of the same
  std::string text;
  std::int64_t integer = 0;
  double number = 0;
  bool on = false;
  std::vector<TomlNode> children;   // of a list in order, of a table sorted by key
  std::optional<std::string> bare;  // the value of an override as it was typed

  const TomlNode* find(std::string_view wanted) const;
  TomlNode* find(std::string_view wanted);
};

class TomlError : public std::runtime_error {
 public:
  TomlError(const Origin& at, const std::string& what) : std::runtime_error(what), origin(at) {}
  Origin origin;
};

// Throws TomlError at a fault of syntax, and where keys and brackets are nested deeper than a scene can need.
TomlNode parse_toml(std::string_view text);

}  // namespace strandbake
