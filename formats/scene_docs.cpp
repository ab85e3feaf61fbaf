// docs/SCENE.md and the default scene, written from the declarations.
#include <fmt/format.h>

#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "formats/scene.h"
#include "formats/scene_words.h"

namespace strandbake {
namespace {

constexpr const char* intro = R"(# The scene file

<!-- Generated from the declarations in formats/scene.h and sim/params.h by `strandbake docs > docs/SCENE.md`. -->

A scene is a [TOML](https://toml.io) file. It names the groom, the animation of the head, and every parameter that is not at
its default. `strandbake check scene.toml` lists everything that is wrong with a scene, each fault with file, line and column.
A key that is not listed here is a fault. A text without a default may be left out, or be empty, which is the same.

**Units.** Metres, kilograms, seconds; +Y is up. Files in other units or axes are converted as they are read: see `units` and
`up`. Stiffness and damping are given per step of 1/60 s and mean the same at any number of substeps.

**Files** are looked for beside the scene, then in the folders of the search path: `--search` and the environment variable
`STRANDBAKE_PATH` (folders divided by `:`).

**Placement of the groom.** Points of its files are first converted to metres with +Y up, then scaled, turned about x, then y,
then z, and moved. The result is the groom in the world as it stands at the rest frame (`head.rest_frame`), or, with
`space = "head"`, in the axes of the head node.

**Values over time.** A parameter with "yes" under *keyed* can be a table over frames in place of one value: straight lines
between the frames given, the first and last value held outside them. Frames are those of `bake.frames`; negative ones are
allowed, and fractions are written in quotes.

```toml
damping = {1 = 0.1, 48 = 0.4, "60.5" = 0.1}
gravity = {1 = [0, -9.81, 0], 24 = [3, -9.81, 0]}
```

**From the command line.** `--set KEY=VALUE` overrides one parameter, or adds it. Regions go by name or number, other lists by
number from 0. Values are TOML; where the parameter is a text the quotes may be left out.

```sh
strandbake bake scene.toml --set bake.fps=30 --set region.tail.local.stiffness=0.4 \
  --set 'region[0].damping={1 = 0.1, 48 = 0.4}' --set 'collider[0].sphere.radius=0.11' --set head.clip=Walk
```

Nested tables can be written in place, `local = {stiffness = 0.3}`, with dotted keys, `local.stiffness = 0.3`, or under a
heading of their own, `[region.local]`.
)";

// Parsed in a test.
constexpr const char* example = R"(
## An example

```toml
[bake]
frames = "1-240"
fps = 24
substeps = 8
preroll = 12

[groom]
files = ["top.tfx", {file = "tail.hair", units = "m"}]
units = "cm"
rotate = [0, 90, 0]

[head]
animation = "dance.glb"
clip = "Dance"
node = "Neck/Head"

[wind]
velocity = {1 = [0, 0, 0], 24 = [3, 0, 0]}
gust = 0.4

[[region]]
name = "tail"
strands = {file = "tail.hair"}
damping = 0.1
local = {stiffness = {1 = 0.3, 48 = 0.8}, iterations = 3, method = 1}
global = {stiffness = 0.1, range = 0.3}

[[region]]
name = "rest"

[[collider]]
sphere = {center = [0, 1.7, 0.02], radius = 0.1}
node = "Neck/Head"

[cache]
precision = 1e-5
```
)";

std::string unit_text(const std::string& unit) {
  return unit == "1" ? std::string() : unit;
}

// What a row or a comment says about one parameter.
struct Description {
  std::string type;
  std::string value;  // default, empty where it has none
  std::string range;
  bool is_keyed = false;
};

const char* number_type(const double&) {
  return "number";
}
const char* number_type(const int&) {
  return "whole number";
}
const char* number_type(const Eigen::Vector3d&) {
  return "3 numbers";
}

template <class T>
Description describe(const T& field, const Range& range) {
  constexpr double most = std::numeric_limits<double>::max();
  const bool is_free = range.low <= -most && range.high >= most;
  return {number_type(field), toml_text(field), is_free ? "any" : range_text(range), range.is_keyed};
}
Description describe(const std::optional<double>&, const Range& range) {
  Description description = describe(0.0, range);
  description.value.clear();
  return description;
}
Description describe(const std::optional<int>& field, const RangeOrAuto& allowed) {
  return {"whole number", toml_text(field), range_text(allowed.range) + ", or \"auto\"", false};
}
Description describe(const bool& field, const Switch&) {
  return {"switch", toml_text(field), "true or false", false};
}
Description describe(const std::string& field, const Text& text) {
  return {"text", field.empty() ? std::string() : toml_text(field),
          text.choices.empty() ? std::string() : listed({text.choices.begin(), text.choices.end()}), false};
}

// The parameters of one table, those of nested structs with dotted keys.
class Parameters {
 public:
  Parameters(std::vector<ParameterDescription>& out, std::string prefix) : out_(out), prefix_(std::move(prefix)) {}

  template <class T, class Allowed>
  void operator()(const char* name, T& field, const Allowed& allowed, const char* unit, const char* help) {
    const Description d = describe(field, allowed);
    out_.push_back({prefix_ + name, d.type, unit_text(unit), d.value, d.range, d.is_keyed, help});
  }
  template <class T>
  void operator()(const char* name, T& field, const char* help) {
    nest(name, "table", "", field, help);
  }
  template <class T>
  void operator()(const char* name, std::optional<T>&, const char* help) {
    T inner;
    nest(name, "table", "", inner, help);
  }
  template <class T>
  void operator()(const char* name, std::vector<T>&, const char* help) {
    T item;
    nest(name, "list", "[]", item, help);
  }

 private:
  template <class T>
  void nest(const char* name, const char* type, const char* suffix, T& field, const char* help) {
    out_.push_back({prefix_ + name, type, "", "", "", false, help});
    Parameters inner(out_, prefix_ + name + suffix + '.');
    fields(inner, field);
  }

  std::vector<ParameterDescription>& out_;
  std::string prefix_;
};

class Tables {
 public:
  explicit Tables(std::vector<TableDescription>& out) : out_(out) {}

  template <class T>
  void operator()(const char* name, T& field, const char* help) {
    add(name, false, field, help);
  }
  template <class T>
  void operator()(const char* name, std::vector<T>&, const char* help) {
    T item;
    add(name, true, item, help);
  }

 private:
  template <class T>
  void add(const char* name, bool is_list, T& field, const char* help) {
    out_.push_back({name, is_list, help, {}});
    Parameters parameters(out_.back().parameters, "");
    fields(parameters, field);
  }

  std::vector<TableDescription>& out_;
};

// The lines of the default scene. What has no default is commented out.
class DefaultLines {
 public:
  DefaultLines(std::string& out, std::string prefix, std::string comment)
      : out_(out), prefix_(std::move(prefix)), comment_(std::move(comment)) {}

  template <class T, class Allowed>
  void operator()(const char* name, T& field, const Allowed& allowed, const char* unit, const char* help) {
    const Description d = describe(field, allowed);
    write_help(unit_text(unit).empty() ? help : fmt::format("{} [{}]", help, unit));
    const bool is_text = std::is_same_v<T, std::string>;
    const bool has_value = !d.value.empty() || is_text;
    out_ += fmt::format("{}{}{}{} = {}\n", comment_, has_value ? "" : "#", prefix_, name,
                        !d.value.empty() ? d.value
                        : is_text        ? "\"\""
                                         : "1");
  }
  template <class T>
  void operator()(const char* name, T& field, const char* help) {
    write_help(help);
    DefaultLines inner(out_, prefix_ + name + '.', comment_);
    fields(inner, field);
  }
  template <class T>
  void operator()(const char* name, std::optional<T>&, const char* help) {
    write_help(help);
    T field;
    DefaultLines inner(out_, prefix_ + name + '.', "#");
    fields(inner, field);
  }
  template <class T>
  void operator()(const char* name, std::vector<T>&, const char* help) {
    write_help(help);
    out_ += fmt::format("{}{} = []\n", prefix_, name);
  }

 private:
  // Words on comment lines of a readable width.
  void write_help(const std::string& help) {
    constexpr std::size_t width = 100;
    for (std::size_t at = 0; at < help.size();) {
      std::size_t end = help.size();
      if (end - at > width) end = help.rfind(' ', at + width);
      out_ += "# " + help.substr(at, end - at) + '\n';
      at = end + 1;
    }
  }

  std::string& out_;
  std::string prefix_;
  std::string comment_;
};

class DefaultTables {
 public:
  explicit DefaultTables(std::string& out) : out_(out) {}

  template <class T>
  void operator()(const char* name, T& field, const char*) {
    out_ += fmt::format("\n[{}]\n", name);
    DefaultLines lines(out_, "", "");
    fields(lines, field);
  }
  void operator()(const char* name, std::vector<RegionScene>&, const char*) {
    out_ += fmt::format("\n[[{}]]\n", name);
    RegionScene only;
    only.name = "hair";
    DefaultLines lines(out_, "", "");
    fields(lines, only);
  }
  // A scene has none unless it says so.
  template <class T>
  void operator()(const char* name, std::vector<T>&, const char*) {
    out_ += fmt::format("\n#[[{}]]\n", name);
    T item;
    DefaultLines lines(out_, "", "#");
    fields(lines, item);
  }

 private:
  std::string& out_;
};

}  // namespace

std::vector<TableDescription> describe_scene() {
  std::vector<TableDescription> out;
  Scene defaults;
  Tables tables(out);
  fields(tables, defaults);
  return out;
}

std::string scene_reference() {
  std::string out = intro;
  for (const TableDescription& table : describe_scene()) {
    const std::string heading = fmt::format(fmt::runtime(table.is_list ? "[[{}]]" : "[{}]"), table.name);
    out += fmt::format("\n## `{}`\n\n{}\n\n", heading, table.help);
    out += "| key | type | unit | default | range | keyed | what it does |\n|---|---|---|---|---|---|---|\n";
    for (const ParameterDescription& p : table.parameters) {
      const std::string value = p.value.empty() ? std::string() : '`' + p.value + '`';
      out += fmt::format("| `{}` | {} | {} | {} | {} | {} | {} |\n", p.key, p.type, p.unit, value, p.range,
                         p.is_keyed ? "yes" : "", p.help);
    }
  }
  out += example;
  return out;
}

std::string default_scene() {
  std::string out =
      "# Every parameter at its default; docs/SCENE.md has their ranges. Name the groom's files to make it a scene.\n";
  Scene defaults;
  DefaultTables tables(out);
  fields(tables, defaults);
  return out;
}

}  // namespace strandbake
