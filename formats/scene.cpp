// Reads a scene: TOML into a tree, overrides into the tree, then one visitor walks the declarations over it; last come
// the checks that concern more than one parameter.
#include "formats/scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <set>
#include <stdexcept>
#include <system_error>
#include <tuple>
#include <type_traits>

#include "formats/hair_presets.h"
#include "formats/quality.h"
#include "formats/scene_overrides.h"
#include "formats/scene_words.h"
#include "formats/similar_names.h"
#include "formats/toml_tree.h"
#include "formats/units.h"

namespace strandbake {
namespace {

using Kind = TomlNode::Kind;
using Curves = std::vector<std::pair<std::string, Curve>>;

constexpr std::size_t most_bytes = 64u << 20;  // a scene of this size is something else by mistake

std::string index_path(std::string_view path, std::size_t index) {
  return fmt::format("{}[{}]", path, index);
}
std::string join(const std::string& path, std::string_view name) {
  return path.empty() ? std::string(name) : fmt::format("{}.{}", path, name);
}

// "the text "fast"", as it stands in "is the text "fast", but must be a number".
std::string describe(const TomlNode& node) {
  switch (node.kind) {
    case Kind::Text:
      return "the text " + in_quotes(node.text);
    case Kind::Integer:
      return fmt::format("the number {}", node.integer);
    case Kind::Number:
      return fmt::format("the number {}", node.number);
    case Kind::Switch:
      return node.on ? "true" : "false";
    case Kind::Time:
      return "a date or time";
    case Kind::List:
      return fmt::format("a list of {}", node.children.size());
    case Kind::Table:
      return "a table";
  }
  return {};
}

// The path of the table or list around a key, empty at the top.
std::string_view parent(std::string_view path) {
  const std::size_t end = path.find_last_of(".[");
  return end == std::string_view::npos ? std::string_view() : path.substr(0, end);
}

// Where a key was written, or the closest table above it that was.
Origin find_origin(const Scene& scene, std::string_view path) {
  for (; !path.empty(); path = parent(path)) {
    if (const auto set = scene.overridden.find(path); set != scene.overridden.end()) {
      return {static_cast<int>(set->second), 1, 1};
    }
    if (const auto at = scene.positions.find(path); at != scene.positions.end()) {
      return {-1, at->second.first, at->second.second};
    }
  }
  return {};
}

std::string one_line(std::string text) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < ' ') c = ' ';
  }
  return text;
}

std::string place_text(const Scene& scene, const Origin& origin) {
  if (origin.set >= 0) {
    return "--set " + one_line(shortened(scene.overrides[static_cast<std::size_t>(origin.set)], 200));
  }
  return fmt::format("{}:{}:{}", scene.path.string(), origin.line, origin.column);
}

// Everything known while a scene is read.
class Reading {
 public:
  explicit Reading(Scene& scene) : scene_(scene) {}

  void add(const Origin& origin, const std::string& path, std::string what) {
    if (!path.empty()) faulty_.insert(path);
    faults_.emplace_back(origin, std::move(what));
  }
  // For the checks after reading: at a path, unless it has a fault already.
  void add(const std::string& path, std::string what) {
    if (!is_faulty(path)) add(find_origin(scene_, path), path, std::move(what));
  }
  // Whether there is a fault at the path or at a table around it, so that its value is a default without meaning.
  bool is_faulty(std::string_view path) const {
    for (; !path.empty(); path = parent(path)) {
      if (faulty_.count(path) > 0) return true;
    }
    return false;
  }

  void write_down(const std::string& path, const TomlNode& node) {
    if (node.origin.set >= 0) {
      scene_.overridden[path] = static_cast<std::size_t>(node.origin.set);
    } else {
      scene_.positions[path] = {node.origin.line, node.origin.column};
    }
  }
  bool is_written(const std::string& path) const {
    return scene_.positions.count(path) > 0 || scene_.overridden.count(path) > 0;
  }

  // In the order of their places.
  void report(Faults& faults) {
    std::stable_sort(faults_.begin(), faults_.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
    for (auto& [origin, what] : faults_) faults.push_back({place_text(scene_, origin), one_line(std::move(what))});
  }

 private:
  Scene& scene_;
  std::vector<std::pair<Origin, std::string>> faults_;
  std::set<std::string, std::less<>> faulty_;
};

// The names that a struct declares, for suggestions.
class Names {
 public:
  std::vector<std::string> keys;    // its own
  std::vector<std::string> nested;  // dotted, those of the structs in it
  std::vector<std::string> lists;   // dotted, those that hold lists
  std::string example;              // the first key with a value that would do

  void operator()(const char* name, std::optional<double>&, const Range&, const char*, const char*) { add(name, "1"); }
  void operator()(const char* name, std::string& field, const Text&, const char*, const char*) {
    add(name, toml_text(field.empty() ? "..." : field));
  }
  template <class T, class Allowed>
  void operator()(const char* name, T& field, const Allowed&, const char*, const char*) {
    add(name, toml_text(field));
  }
  template <class T>
  void operator()(const char* name, T& field, const char*) {
    go_down(name, field);
  }
  template <class T>
  void operator()(const char* name, std::optional<T>&, const char*) {
    T inner;
    go_down(name, inner);
  }
  template <class T>
  void operator()(const char* name, std::vector<T>&, const char*) {
    add(name, "[\"a.hair\"]");  // the one list that lies in a table is groom.files
    lists.emplace_back(name);
  }

 private:
  void add(const std::string& name, const std::string& value) {
    keys.push_back(name);
    if (example.empty()) example = name + " = " + value;
  }
  template <class T>
  void go_down(const char* name, T& field) {
    Names inner;
    fields(inner, field);
    add(name, '{' + inner.example + '}');
    for (const auto* names : {&inner.keys, &inner.nested}) {
      for (const std::string& key : *names) nested.push_back(join(name, key));
    }
    for (const std::string& list : inner.lists) lists.push_back(join(name, list));
  }
};

template <class T>
Names names_of(T defaults) {
  Names names;
  fields(names, defaults);
  return names;
}

// Where the key frames of a struct's parameters go; none: those of the struct around it.
template <class T>
Curves* curves_of(T&) {
  return nullptr;
}
template <class T>
Curves* curves_of(Animated<T>& animated) {
  return &animated.keys;
}
Curves* curves_of(RegionScene& region) {
  return &region.params.keys;
}

// The visitor: reads one table into the struct that declares it.
class TableReader {
 public:
  // `curves` take key frames under names that begin with `prefix`.
  TableReader(Reading& reading, const TomlNode& table, Names names, std::string path, Curves* curves,
              std::string prefix)
      : reading_(reading),
        table_(table),
        names_(std::move(names)),
        path_(std::move(path)),
        curves_(curves),
        prefix_(std::move(prefix)) {}

  template <class T>
  static void read(Reading& reading, const TomlNode& table, const std::string& path, T& target, Curves* curves,
                   const std::string& prefix) {
    Curves* own = curves_of(target);
    TableReader reader(reading, table, names_of(T{}), path, own ? own : curves, own ? std::string() : prefix);
    fields(reader, target);
    reader.refuse_unknown();
  }

  void operator()(const char* name, double& field, const Range& range, const char* unit, const char*) {
    read_keyable(name, field, range, unit);
  }
  void operator()(const char* name, Eigen::Vector3d& field, const Range& range, const char* unit, const char*) {
    read_keyable(name, field, range, unit);
  }

  void operator()(const char* name, std::optional<double>& field, const Range& range, const char* unit, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    double value = 1;
    if (value_of(*node, name, in_quotes(join(path_, name)), value, range, unit)) field = value;
  }

  void operator()(const char* name, int& field, const Range& range, const char* unit, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    if (node->kind != Kind::Integer) {
      refuse_type(*node, path, in_quotes(path), "a whole number", fmt::format("{} = {}", name, field));
      return;
    }
    const bool fits =
        node->integer >= std::numeric_limits<int>::min() && node->integer <= std::numeric_limits<int>::max();
    if (!fits || !range.contains(static_cast<double>(node->integer))) {
      refuse_range(*node, path, in_quotes(path), fmt::format("{}", node->integer), range, unit);
    } else {
      field = static_cast<int>(node->integer);
    }
  }

  void operator()(const char* name, std::optional<int>& field, const RangeOrAuto& allowed, const char*, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    if (node->kind == Kind::Text && node->text == "auto") {
      field.reset();
    } else if (node->kind != Kind::Integer) {
      const bool is_slip = node->kind == Kind::Text && closest(node->text, {"auto"});
      reading_.add(node->origin, path,
                   fmt::format("{} is {}, but must be a whole number or \"auto\"{}", in_quotes(path), describe(*node),
                               is_slip ? "; did you mean \"auto\"?"
                                       : fmt::format(", for example {} = {}", name, toml_text(field))));
    } else if (!allowed.range.contains(static_cast<double>(node->integer))) {
      reading_.add(node->origin, path,
                   fmt::format("{} is {}, but must be {}, or \"auto\"", in_quotes(path), node->integer,
                               range_text(allowed.range)));
    } else {
      field = static_cast<int>(node->integer);  // the range is one of ints
    }
  }

  void operator()(const char* name, bool& field, const Switch&, const char*, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    if (node->kind == Kind::Switch) {
      field = node->on;
    } else {
      refuse_type(*node, path, in_quotes(path), "true or false", fmt::format("{} = {}", name, toml_text(field)));
    }
  }

  void operator()(const char* name, std::string& field, const Text& allowed, const char*, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    const std::vector<std::string> choices(allowed.choices.begin(), allowed.choices.end());
    if (node->kind != Kind::Text && !node->bare) {
      const auto inside = nested_name(name);
      refuse_type(*node, path, in_quotes(path), choices.empty() ? "a text" : listed(choices),
                  fmt::format("{} = {}{}", name, toml_text(field.empty() ? "..." : field),
                              inside ? fmt::format("; did you mean {}?", in_quotes(*inside)) : ""));
      return;
    }
    const std::string& text = node->kind == Kind::Text ? node->text : *node->bare;
    if (!choices.empty() && std::find(choices.begin(), choices.end(), text) == choices.end()) {
      const auto slip = closest(text, choices);
      reading_.add(node->origin, path,
                   fmt::format("{} is {}, but must be {}{}", in_quotes(path), in_quotes(text), listed(choices),
                               slip ? fmt::format("; did you mean {}?", in_quotes(*slip)) : ""));
    } else if (text.find('\0') != std::string::npos) {
      reading_.add(node->origin, path, fmt::format("{} holds a zero byte, which no name can have", in_quotes(path)));
    } else {
      field = text;
    }
  }

  template <class T>
  void operator()(const char* name, T& field, const char*) {
    if (const TomlNode* node = take(name))
      read_table(*node, name, join(path_, name), fmt::format("{} = ", name), field);
  }
  template <class T>
  void operator()(const char* name, std::optional<T>& field, const char*) {
    if (const TomlNode* node = take(name))
      read_table(*node, name, join(path_, name), fmt::format("{} = ", name), field.emplace());
  }

  // lengths = "direct" or {iterations = 2}
  void operator()(const char* name, LengthParams& field, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    const std::string* const text = node->kind == Kind::Text ? &node->text : nullptr;
    if (text && *text == "direct") {
      field = {};
    } else if (node->kind != Kind::Table) {
      refuse_type(*node, path, in_quotes(path), "\"direct\" or a table", "lengths = {iterations = 2}");
    } else {
      read(reading_, *node, path, field, nullptr, "");
      const TomlNode* const iterations = node->find("iterations");
      if (iterations && !node->find("direct")) field.direct = false;
      if (field.direct && field.iterations > 0) {
        reading_.add(iterations->origin, join(path, "iterations"),
                     fmt::format("{} is {}, but lengths are solved directly: leave out one of the two",
                                 in_quotes(join(path, "iterations")), field.iterations));
      }
    }
  }

  // A list of tables, written as [[name]] or in place.
  template <class T>
  void operator()(const char* name, std::vector<T>& field, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    if (node->kind != Kind::List) {
      refuse_type(*node, path, in_quotes(path), "a list of tables", fmt::format("[[{}]] over each", path));
      return;
    }
    for (std::size_t k = 0; k < node->children.size(); ++k) {
      const TomlNode& item = node->children[k];
      reading_.write_down(index_path(path, k), item);
      read_table(item, name, index_path(path, k), "", field.emplace_back());
    }
  }

  // The same, but a plain text stands for a file, and one text for a list of one.
  void operator()(const char* name, std::vector<GroomFileParams>& field, const char*) {
    const TomlNode* node = take(name);
    if (!node) return;
    const std::string path = join(path_, name);
    if (node->kind == Kind::Text || (node->bare && node->kind != Kind::List)) {
      add_file(*node, index_path(path, 0), field);
      return;
    }
    if (node->kind != Kind::List) {
      refuse_type(*node, path, in_quotes(path), "a list of files", fmt::format("{} = [\"a.hair\", \"b.hair\"]", name));
      return;
    }
    for (std::size_t k = 0; k < node->children.size(); ++k) add_file(node->children[k], index_path(path, k), field);
  }

 private:
  const TomlNode* take(const char* name) {
    const TomlNode* node = table_.find(name);
    if (node) reading_.write_down(join(path_, name), *node);
    return node;
  }

  template <class T>
  void read_table(const TomlNode& node, const char* name, const std::string& path, const std::string& lead, T& target) {
    if (node.kind == Kind::Table) {
      read(reading_, node, path, target, curves_, prefix_ + name + '.');
    } else {
      refuse_type(node, path, in_quotes(path), "a table", fmt::format("{}{{{}}}", lead, names_of(T{}).example));
    }
  }

  void add_file(const TomlNode& node, const std::string& path, std::vector<GroomFileParams>& files) {
    reading_.write_down(path, node);
    GroomFileParams& file = files.emplace_back();
    if (node.kind == Kind::Table) {
      read(reading_, node, path, file, nullptr, "");
    } else if (node.kind == Kind::Text || node.bare) {
      TomlNode table;
      table.origin = node.origin;
      table.children.push_back(node);
      table.children.back().key = "file";
      read(reading_, table, path, file, nullptr, "");
    } else {
      refuse_type(node, path, in_quotes(path), "a text or a table",
                  "\"a.hair\" or {file = \"a.hair\", units = \"cm\"}");
    }
  }

  void refuse_type(const TomlNode& node, const std::string& path, const std::string& label, const std::string& wanted,
                   const std::string& example) {
    reading_.add(node.origin, path,
                 fmt::format("{} is {}, but must be {}, for example {}", label, describe(node), wanted, example));
  }
  void refuse_range(const TomlNode& node, const std::string& path, const std::string& label, const std::string& found,
                    const Range& range, const std::string& unit) {
    reading_.add(node.origin, path,
                 fmt::format("{} is {}, but must be {}{}", label, found, range_text(range),
                             unit.empty() || unit == "1" ? "" : fmt::format(" ({})", unit)));
  }

  // These take the default in `out`, for the example in a fault, and leave it where there is one.
  bool value_of(const TomlNode& node, const char* name, const std::string& label, double& out, const Range& range,
                const char* unit) {
    const std::string path = join(path_, name);
    if (node.kind != Kind::Integer && node.kind != Kind::Number) {
      refuse_type(node, path, label, range.is_keyed ? "a number or a table of numbers over frames" : "a number",
                  example(name, out, range));
      return false;
    }
    const double value = node.kind == Kind::Integer ? static_cast<double>(node.integer) : node.number;
    if (!range.contains(value)) {
      refuse_range(node, path, label, toml_text(value), range, unit);
      return false;
    }
    out = value;
    return true;
  }
  bool value_of(const TomlNode& node, const char* name, const std::string& label, Eigen::Vector3d& out,
                const Range& range, const char* unit) {
    const std::string path = join(path_, name);
    const auto is_number = [](const TomlNode& n) { return n.kind == Kind::Integer || n.kind == Kind::Number; };
    if (node.kind != Kind::List || node.children.size() != 3 ||
        !std::all_of(node.children.begin(), node.children.end(), is_number)) {
      const auto odd = std::find_if_not(node.children.begin(), node.children.end(), is_number);
      const bool has_odd = node.kind == Kind::List && odd != node.children.end();
      reading_.add(has_odd ? odd->origin : node.origin, path,
                   fmt::format("{} {} {}, but must be {}, for example {}", label, has_odd ? "holds" : "is",
                               has_odd ? describe(*odd) : describe(node),
                               range.is_keyed ? "a list of 3 numbers or a table of such lists over frames"
                                              : "a list of 3 numbers",
                               example(name, out, range)));
      return false;
    }
    Eigen::Vector3d value;
    for (int axis = 0; axis < 3; ++axis) {
      value[axis] = out[axis];
      const std::string of_axis = fmt::format("{} ({})", label, "xyz"[axis]);
      if (!value_of(node.children[static_cast<std::size_t>(axis)], name, of_axis, value[axis], range, unit)) {
        return false;
      }
    }
    out = value;
    return true;
  }
  template <class T>
  static std::string example(const char* name, const T& value, const Range& range) {
    const std::string text = toml_text(value);
    if (!range.is_keyed) return fmt::format("{} = {}", name, text);
    return fmt::format("{} = {} or {} = {{1 = {}, 24 = {}}}", name, text, name, text, text);
  }

  template <class T>
  void read_keyable(const char* name, T& field, const Range& range, const char* unit) {
    const TomlNode* node = take(name);
    if (!node) return;
    if (node->kind == Kind::Table && range.is_keyed && curves_) {
      read_keys(*node, name, field, range, unit);
    } else {
      value_of(*node, name, in_quotes(join(path_, name)), field, range, unit);
    }
  }

  static Eigen::Vector3d as_vector(double value) { return {value, 0, 0}; }
  static Eigen::Vector3d as_vector(const Eigen::Vector3d& value) { return value; }

  // {1 = 0.3, 48 = 0.8}
  template <class T>
  void read_keys(const TomlNode& table, const char* name, T& field, const Range& range, const char* unit) {
    struct Key {
      double frame;
      Origin origin;
      T value;
    };
    const std::string path = join(path_, name);
    std::vector<Key> keys;
    bool good = true;
    for (const TomlNode& child : table.children) {
      Key key{0, child.key_origin, field};
      if (const auto frame = parse_frame(child.key)) {
        key.frame = *frame;
      } else {
        reading_.add(child.key_origin, path,
                     fmt::format("{} has the key {}, but keys must be frames, for example {}", in_quotes(path),
                                 in_quotes(child.key), example(name, field, range)));
        good = false;
        continue;
      }
      if (child.kind == Kind::Table) {
        reading_.add(child.key_origin, path,
                     fmt::format("{} has a table at frame {}: write a fraction of a frame in quotes, \"1.5\" = {}",
                                 in_quotes(path), child.key, toml_text(field)));
        good = false;
        continue;
      }
      const std::string label = fmt::format("{} at frame {}", in_quotes(path), child.key);
      good = value_of(child, name, label, key.value, range, unit) && good;
      keys.push_back(key);
    }
    if (table.children.empty()) {
      reading_.add(table.origin, path,
                   fmt::format("{} is an empty table, but must hold a key frame or more, for example {}",
                               in_quotes(path), example(name, field, range)));
      return;
    }

    std::sort(keys.begin(), keys.end(),
              [](const Key& a, const Key& b) { return a.frame != b.frame ? a.frame < b.frame : a.origin < b.origin; });
    for (std::size_t k = 1; k < keys.size(); ++k) {
      if (keys[k].frame == keys[k - 1].frame) {
        reading_.add(keys[k].origin, path,
                     fmt::format("{} has frame {} twice, but one value a frame would do", in_quotes(path),
                                 toml_text(keys[k].frame)));
        good = false;
      }
    }
    if (!good) return;
    Curve curve;
    for (const Key& key : keys) {
      curve.frame.push_back(key.frame);
      curve.value.push_back(as_vector(key.value));
    }
    field = keys.front().value;
    curves_->emplace_back(prefix_ + name, std::move(curve));
  }

  static std::optional<double> parse_frame(const std::string& text) {
    double frame = 0;
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data(), end, frame);
    if (error != std::errc{} || stop != end || !std::isfinite(frame)) return std::nullopt;
    return frame;
  }

  // "local.method" for "method", in a table that has it.
  std::optional<std::string> nested_name(const std::string& name) const {
    for (const std::string& dotted : names_.nested) {
      if (dotted.substr(dotted.rfind('.') + 1) == name) return dotted;
    }
    return std::nullopt;
  }

  void refuse_unknown() {
    for (const TomlNode& child : table_.children) {
      if (std::find(names_.keys.begin(), names_.keys.end(), child.key) != names_.keys.end()) continue;
      std::string hint;
      if (const auto slip = closest(child.key, names_.keys)) {
        hint = ", did you mean " + in_quotes(*slip) + "?";
      } else if (const auto inside = nested_name(child.key)) {
        hint = ", did you mean " + in_quotes(*inside) + "?";
      } else {
        hint = fmt::format(", {} can have {}", path_.empty() ? "a scene" : in_quotes(path_), listed(names_.keys));
      }
      reading_.add(child.key_origin, "", in_quotes(child.key) + ": unknown key" + hint);
    }
  }

  Reading& reading_;
  const TomlNode& table_;
  Names names_;
  std::string path_;
  Curves* curves_;
  std::string prefix_;
};

// The checks that concern more than one parameter, and texts with a grammar of their own.
class SceneCheck {
 public:
  SceneCheck(Scene& scene, Reading& reading) : scene_(scene), reading_(reading) {}

  void run() {
    check_text("bake.frames", scene_.bake.frames,
               [this](const std::string& t) { std::tie(scene_.first_frame, scene_.last_frame) = parse_frames(t); });
    check_groom();
    check_head();
    check_regions();
    check_colliders();
    check_compression();
  }

 private:
  template <class Parse>
  void check_text(const std::string& path, const std::string& text, Parse parse) {
    try {
      parse(text);
    } catch (const std::invalid_argument& error) {
      reading_.add(path, in_quotes(path) + ": " + error.what());
    }
  }
  // Where both may be left out.
  void check_units(const std::string& path, const std::string& units, const std::string& up) {
    if (!units.empty()) check_text(path + ".units", units, metres_per_unit);
    if (!up.empty()) check_text(path + ".up", up, to_y_up);
  }

  void check_groom() {
    const GroomParams& groom = scene_.groom;
    if (groom.files.empty()) {
      reading_.add(
          "groom.files",
          "the scene has no groom: \"groom.files\" must name a file or more, for example files = [\"a.hair\"]");
    }
    check_text("groom.units", groom.units, metres_per_unit);
    check_text("groom.up", groom.up, to_y_up);
    for (std::size_t k = 0; k < groom.files.size(); ++k) {
      const std::string path = index_path("groom.files", k);
      if (groom.files[k].file.empty() && !reading_.is_faulty(path)) {
        reading_.add(path + ".file",
                     fmt::format("{} names no file: give one, for example file = \"a.hair\"", in_quotes(path)));
      }
      check_units(path, groom.files[k].units, groom.files[k].up);
    }
    if (groom.space == "head" && !reading_.is_written("head.node")) {
      reading_.add("groom.space",
                   "\"groom.space\" is \"head\", but the head has no node: give head.animation and head.node, or write "
                   "space = \"world\"");
    }
  }

  bool is_given(const std::string& path, const std::string& text) const {
    return !text.empty() || reading_.is_faulty(path);
  }

  void check_head() {
    const HeadParams& head = scene_.head;
    const bool has_animation = is_given("head.animation", head.animation);
    const bool has_node = is_given("head.node", head.node);
    if (has_node && !has_animation) {
      reading_.add("head.node",
                   fmt::format("\"head.node\" is {}, but there is no animation with nodes: give its file, for example "
                               "animation = \"dance.glb\", or leave the node out",
                               in_quotes(head.node)));
    }
    if (has_animation && !has_node) {
      reading_.add("head.animation",
                   fmt::format("\"head.animation\" is {}, but no node of it carries the hair: name one, for example "
                               "node = \"Head\"",
                               in_quotes(head.animation)));
    }
    check_units("head", head.units, head.up);
  }

  void check_regions() {
    std::map<std::string, std::size_t> names;
    std::optional<std::size_t> rest;
    for (std::size_t k = 0; k < scene_.regions.size(); ++k) {
      const RegionScene& region = scene_.regions[k];
      const std::string path = index_path("region", k);
      if (reading_.is_faulty(path)) continue;
      check_name(path, region.name, k, names);
      check_strands(path + ".strands", region.strands);
      check_rod(path + ".rod", region.params.base.rod);
      const bool takes_rest = region.strands.file.empty() && region.strands.range.empty() && !region.strands.box;
      if (!takes_rest || has_fault_in_strands(path)) continue;
      if (rest) {
        reading_.add(path + ".strands",
                     fmt::format("{} and {} both take the strands that no other region takes: give one of them "
                                 "strands, for example strands = {{file = \"a.hair\"}}",
                                 in_quotes(index_path("region", *rest)), in_quotes(path)));
      }
      rest = rest.value_or(k);
    }
  }

  // Beyond, floats cannot tell bending from twist.
  void check_rod(const std::string& path, const RodParams& rod) {
    if (rod.shear == 0 || reading_.is_faulty(path + ".young")) return;
    const double ratio = rod.shear / rod.young;
    if (ratio >= 0.01 && ratio <= 100) return;
    reading_.add(path + ".shear",
                 fmt::format("\"shear\" is {0} Pa, but must be from 0.01 to 100 times \"young\", which is {1} "
                             "Pa; 0 makes it from young and poisson",
                             toml_text(rod.shear), toml_text(rod.young)));
  }

  void check_name(const std::string& path, const std::string& name, std::size_t index,
                  std::map<std::string, std::size_t>& names) {
    if (reading_.is_faulty(path + ".name")) return;
    if (name.empty()) {
      reading_.add(path + ".name",
                   fmt::format("{} has no name: give it one, for example name = \"fringe\"", in_quotes(path)));
      return;
    }
    const auto [twin, is_new] = names.emplace(name, index);
    if (!is_new) {
      reading_.add(path + ".name",
                   fmt::format("{} and {} are both named {}, but each must have a name of its own",
                               in_quotes(index_path("region", twin->second)), in_quotes(path), in_quotes(name)));
    }
  }

  bool has_fault_in_strands(const std::string& path) const {
    for (const char* key : {".strands", ".strands.file", ".strands.range", ".strands.box"}) {
      if (reading_.is_faulty(path + key)) return true;
    }
    return false;
  }

  void check_strands(const std::string& path, const StrandSelection& strands) {
    if (!strands.range.empty()) check_text(path + ".range", strands.range, parse_ranges);
    const auto& files = scene_.groom.files;
    const auto is_it = [&](const GroomFileParams& f) { return f.file == strands.file; };
    if (!strands.file.empty() && !files.empty() && std::none_of(files.begin(), files.end(), is_it)) {
      std::vector<std::string> known;
      known.reserve(files.size());
      for (const GroomFileParams& f : files) known.push_back(f.file);
      const auto slip = closest(strands.file, known);
      reading_.add(
          path + ".file",
          fmt::format("{} is {}, which is not in groom.files{}", in_quotes(path + ".file"), in_quotes(strands.file),
                      slip ? fmt::format(", did you mean {}?", in_quotes(*slip))
                           : ": write it as it stands there, for example file = " + in_quotes(known[0])));
    }
    if (strands.box && (strands.box->min.array() > strands.box->max.array()).any()) {
      reading_.add(path + ".box",
                   fmt::format("{} has min = {} and max = {}, but min must not be more than max on any axis",
                               in_quotes(path + ".box"), toml_text(strands.box->min), toml_text(strands.box->max)));
    }
  }

  void check_colliders() {
    for (std::size_t k = 0; k < scene_.colliders.size(); ++k) {
      const ColliderParams& collider = scene_.colliders[k].base;
      const std::string path = index_path("collider", k);
      if (reading_.is_faulty(path)) continue;
      if (!reading_.is_written(path + ".sphere")) {
        reading_.add(path + ".sphere", fmt::format("{} has no shape: give it a sphere, for example sphere = {{center = "
                                                   "[0, 1.7, 0], radius = 0.1}}",
                                                   in_quotes(path)));
      }
      const bool has_node = is_given(path + ".node", collider.node);
      if (has_node && !is_given("head.animation", scene_.head.animation)) {
        reading_.add(path + ".node",
                     fmt::format("{} is {}, but there is no animation with nodes: give head.animation, or leave the "
                                 "node out",
                                 in_quotes(path + ".node"), in_quotes(collider.node)));
      }
      if (collider.space == "node" && !has_node) {
        reading_.add(path + ".space",
                     fmt::format("{} is \"node\", but the collider has none: name one, for example node = "
                                 "\"Head\", or write space = \"world\"",
                                 in_quotes(path + ".space")));
      }
    }
  }

  void check_compression() {
    check_text("cache.compression", scene_.cache.compression, [this](const std::string& text) {
      constexpr std::string_view deflate = "deflate:";
      int level = 0;
      if (text != "none") {
        const char* end = text.data() + text.size();
        const bool starts = text.compare(0, deflate.size(), deflate) == 0;
        const auto [stop, error] = std::from_chars(starts ? text.data() + deflate.size() : end, end, level);
        if (!starts || error != std::errc{} || stop != end || level < 1 || level > 12) {
          throw std::invalid_argument(in_quotes(text) +
                                      " is not a compression: write \"none\", or \"deflate:1\" to \"deflate:12\"");
        }
      }
      scene_.deflate_level = level;
    });
  }

  Scene& scene_;
  Reading& reading_;
};

// Lists what is in force. The declarations hand out references, so it walks over a copy.
class ParameterList {
 public:
  using Entries = std::vector<std::pair<std::string, std::string>>;

  explicit ParameterList(Entries& out) : out_(out) {}

  template <class T, class Allowed>
  void operator()(const char* name, T& field, const Allowed&, const char*, const char*) {
    const Curve* curve = find_curve(prefix_ + name);
    if constexpr (std::is_same_v<T, std::string>) {
      if (field.empty()) return;
    }
    out_.emplace_back(join(path_, name), curve ? toml_text(*curve, std::is_same_v<T, double>) : toml_text(field));
  }
  template <class Allowed>
  void operator()(const char* name, std::optional<double>& field, const Allowed&, const char*, const char*) {
    if (field) out_.emplace_back(join(path_, name), toml_text(*field));
  }
  template <class T>
  void operator()(const char* name, T& field, const char*) {
    go_down(join(path_, name), prefix_ + name + '.', field);
  }
  template <class T>
  void operator()(const char* name, std::optional<T>& field, const char*) {
    if (field) go_down(join(path_, name), prefix_ + name + '.', *field);
  }
  template <class T>
  void operator()(const char* name, std::vector<T>& field, const char*) {
    for (std::size_t k = 0; k < field.size(); ++k) go_down(index_path(join(path_, name), k), "", field[k]);
  }

 private:
  const Curve* find_curve(const std::string& name) const {
    if (!curves_) return nullptr;
    for (const auto& [key, curve] : *curves_) {
      if (key == name) return &curve;
    }
    return nullptr;
  }
  template <class T>
  void go_down(const std::string& path, const std::string& prefix, T& field) {
    ParameterList inner(out_);
    Curves* own = curves_of(field);
    inner.path_ = path;
    inner.curves_ = own ? own : curves_;
    inner.prefix_ = own ? std::string() : prefix;
    fields(inner, field);
  }

  Entries& out_;
  std::string path_;
  const Curves* curves_ = nullptr;
  std::string prefix_;
};

// Presets say nothing about what is written.
void apply_quality(Scene& scene, const Reading& reading) {
  for (const Quality& quality : kQualities) {
    if (scene.bake.quality != quality.name) continue;
    if (!reading.is_written("bake.substeps")) scene.bake.substeps = quality.substeps;
    for (std::size_t r = 0; r < scene.regions.size(); ++r) {
      if (reading.is_written(join(index_path("region", r), "local.method"))) continue;
      scene.regions[r].params.base.local.method = quality.local_method;
    }
  }
}

void apply_hair(Scene& scene, const Reading& reading) {
  for (std::size_t r = 0; r < scene.regions.size(); ++r) {
    RodParams& rod = scene.regions[r].params.base.rod;
    const auto set = [&](const char* name, double& field, double value) {
      if (!reading.is_written(join(join(index_path("region", r), "rod"), name))) field = value;
    };
    for (const HairPreset& hair : kHairPresets) {
      if (scene.regions[r].hair != hair.name) continue;
      set("young", rod.young, hair.young);
      set("radius", rod.radius, hair.radius);
      set("density", rod.density, hair.density);
    }
  }
}

std::string read_text(const std::filesystem::path& path) {
  std::error_code ignored;
  if (std::filesystem::is_directory(path, ignored)) {
    throw InputError(path.string() + ": this is a folder, but a scene file is needed");
  }
  std::ifstream in(path, std::ios::binary);
  if (!in) throw InputError(path.string() + ": the scene cannot be opened, is the name right?");
  std::string text;
  std::vector<char> block(1u << 16);
  while (in.read(block.data(), static_cast<std::streamsize>(block.size())) || in.gcount() > 0) {
    text.append(block.data(), static_cast<std::size_t>(in.gcount()));
    if (text.size() > most_bytes) {
      throw InputError(fmt::format("{}: more than {} MiB, which is no scene", path.string(), most_bytes >> 20));
    }
  }
  if (in.bad()) throw InputError(path.string() + ": the scene cannot be read to its end");
  return text;
}

}  // namespace

Scene parse_scene(const std::string& text, const std::string& name, const std::vector<std::string>& overrides,
                  const std::vector<std::filesystem::path>& search_path, Faults& faults) {
  Scene scene;
  scene.path = name;
  scene.text = text;
  scene.overrides = overrides;
  scene.search_path = search_path;
  Reading reading(scene);
  try {
    TomlNode root = parse_toml(text);
    apply_overrides(root, overrides, names_of(Scene{}).lists, [&](std::size_t index, const std::string& what) {
      reading.add(Origin{static_cast<int>(index), 1, 1}, "", what);
    });
    TableReader::read(reading, root, "", scene, nullptr, "");
    apply_hair(scene, reading);
    SceneCheck(scene, reading).run();
  } catch (const TomlError& error) {
    reading.add(error.origin, "", std::string("this is not TOML: ") + error.what());
  }
  if (scene.regions.empty()) scene.regions.emplace_back().name = "hair";
  apply_quality(scene, reading);
  reading.report(faults);
  return scene;
}

Scene read_scene(const std::filesystem::path& path, const std::vector<std::string>& overrides,
                 const std::vector<std::filesystem::path>& search_path, Faults& faults) {
  return parse_scene(read_text(path), path.string(), overrides, search_path, faults);
}

std::string Scene::place(std::string_view dotted_path) const {
  return place_text(*this, find_origin(*this, dotted_path));
}

std::filesystem::path find_input(const Scene& scene, const std::string& name) {
  if (name.empty()) return {};
  const auto is_there = [](const std::filesystem::path& file) {
    std::error_code error;
    return std::filesystem::exists(file, error) && !std::filesystem::is_directory(file, error);
  };
  std::filesystem::path beside = scene.path.parent_path() / name;  // the name itself where it is absolute
  if (is_there(beside)) return beside;
  for (const std::filesystem::path& folder : scene.search_path) {
    std::filesystem::path file = folder / name;
    if (is_there(file)) return file;
  }
  return {};
}

std::vector<std::pair<std::string, std::string>> list_parameters(const Scene& scene) {
  ParameterList::Entries out;
  Scene copy = scene;
  ParameterList list(out);
  fields(list, copy);
  return out;
}

}  // namespace strandbake
