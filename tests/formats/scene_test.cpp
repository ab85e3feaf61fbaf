// The scene reader: every fault at its place, every parameter read, overrides, key frames, and the page made from it
// all.
#include "formats/scene.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "formats/hair_presets.h"

namespace {

using namespace strandbake;
namespace fs = std::filesystem;

const std::string groom = "[groom]\nfiles = [\"a.hair\"]\n";

struct Read {
  Scene scene;
  Faults faults;
};

Read read(const std::string& text, const std::vector<std::string>& overrides = {}) {
  Read result;
  result.scene = parse_scene(text, "scene.toml", overrides, {}, result.faults);
  return result;
}

std::string lines_of(const Faults& faults) {
  std::string lines;
  for (const Fault& fault : faults) lines += fault.place + ": " + fault.what + "\n";
  return lines;
}

Scene read_good(const std::string& text, const std::vector<std::string>& overrides = {}) {
  Read result = read(text, overrides);
  INFO(text.substr(0, 2000));
  CHECK(lines_of(result.faults) == "");
  return result.scene;
}

// A place is one line of a readable length.
std::string shown_place(std::string at) {
  if (at.rfind("--set", 0) != 0) return "scene.toml:" + at;
  std::replace(at.begin(), at.end(), '\n', ' ');
  const std::size_t longest = std::string("--set ").size() + 200;
  return at.size() > longest ? at.substr(0, longest) + "..." : at;
}

// The one fault of a scene. `at` is "line:column", or the override.
void check_fault(const std::string& text, const std::string& at, const std::vector<std::string>& words,
                 const std::vector<std::string>& overrides = {}) {
  const Read result = read(text, overrides);
  INFO(text.substr(0, 2000));
  INFO(lines_of(result.faults));
  REQUIRE(result.faults.size() == 1);
  CHECK(result.faults[0].place == (shown_place(at)));
  for (const std::string& word : words) {
    INFO(word);
    CHECK(result.faults[0].what.find(word) != std::string::npos);
  }
  CHECK(result.faults[0].what.find('\n') == std::string::npos);
}

// A fault in the third line, under the groom.
void check_fault_below(const std::string& text, const std::string& at, const std::vector<std::string>& words) {
  check_fault(groom + text, at, words);
}

// Every declared parameter and table, by its dotted path in a scene with one file, one region and one collider.
struct Declared {
  enum class Kind { Number, Int, Vector, Optional, Text, Switch };
  struct Parameter {
    std::string path;
    Kind kind;
    Range range;
    bool has_choices;
  };
  std::vector<Parameter> parameters;
  std::vector<std::string> tables;
  std::string prefix = {};

  void add(const std::string& name, Kind kind, const Range& range = {}, bool has_choices = false) {
    parameters.push_back({prefix + name, kind, range, has_choices});
  }
  void operator()(const char* n, double&, const Range& r, const char*, const char*) { add(n, Kind::Number, r); }
  void operator()(const char* n, int&, const Range& r, const char*, const char*) { add(n, Kind::Int, r); }
  void operator()(const char* n, Eigen::Vector3d&, const Range& r, const char*, const char*) {
    add(n, Kind::Vector, r);
  }
  void operator()(const char* n, std::optional<double>&, const Range& r, const char*, const char*) {
    add(n, Kind::Optional, r);
  }
  void operator()(const char* n, std::optional<int>&, const RangeOrAuto& a, const char*, const char*) {
    add(n, Kind::Int, a.range);
  }
  void operator()(const char* n, std::string&, const Text& t, const char*, const char*) {
    add(n, Kind::Text, {}, !t.choices.empty());
  }
  void operator()(const char* n, bool&, const Switch&, const char*, const char*) { add(n, Kind::Switch); }
  template <class T>
  void operator()(const std::string& name, T& nested, const char*) {
    const std::string outer = prefix;
    tables.push_back(prefix + name);
    prefix += name + ".";
    fields(*this, nested);
    prefix = outer;
  }
  template <class T>
  void operator()(const std::string& name, std::optional<T>&, const char* help) {
    T inner;
    (*this)(name, inner, help);
  }
  template <class T>
  void operator()(const std::string& name, std::vector<T>&, const char* help) {
    T item;
    (*this)(name + "[0]", item, help);
  }
};

Declared declared() {
  Declared all;
  Scene scene;
  fields(all, scene);
  return all;
}

// A scene in which every declared path can be overridden without another fault.
const std::string full =
    "[groom]\nfiles = [{file = \"a.hair\"}]\n"
    "[head]\nanimation = \"a.glb\"\nnode = \"Head\"\n"
    "[[region]]\nname = \"a\"\n"
    "[[collider]]\nsphere = {radius = 0.1}\nnode = \"Head\"\n";

std::string number(double value) {
  std::ostringstream out;
  out.precision(17);
  out << value;
  return out.str();
}

TEST_CASE("a scene with nothing but a groom has every parameter at its default") {
  const Scene scene = read_good(groom);
  CHECK(scene.first_frame == 1);
  CHECK(scene.last_frame == 24);
  CHECK(scene.bake.fps == 24);
  CHECK(scene.bake.substeps == 4);
  CHECK(scene.bake.tolerance == 0.001);
  CHECK(scene.bake.preroll == 0);
  CHECK(scene.solver.precision == "float");
  REQUIRE(scene.groom.files.size() == 1);
  CHECK(scene.groom.files[0].file == "a.hair");
  CHECK(scene.groom.files[0].units == "");
  CHECK(scene.groom.units == "m");
  CHECK(scene.groom.up == "+Y");
  CHECK(scene.groom.space == "world");
  CHECK(scene.groom.scale == 1);
  CHECK(scene.head.animation == "");
  CHECK(!scene.head.start);
  CHECK(!scene.head.rest_frame);
  CHECK(scene.forces.base.gravity == Eigen::Vector3d(0, -9.81, 0));
  CHECK(scene.wind.base.velocity == Eigen::Vector3d(0, 0, 0));
  REQUIRE(scene.regions.size() == 1);
  CHECK(scene.regions[0].name == "hair");
  CHECK(scene.regions[0].params.base.local.method == 1);
  CHECK(scene.regions[0].params.keys.empty());
  CHECK(scene.colliders.empty());
  CHECK(scene.cache.compression == "deflate:1");
  CHECK(scene.deflate_level == 1);
  CHECK(!scene.cache.velocity);
  CHECK(scene.cache.stats);
}

TEST_CASE("every parameter that a scene writes arrives") {
  const Scene scene = read_good(R"([bake]
frames = "10-20"
fps = 29.97
substeps = 8
tolerance = 2e-4
preroll = 12
[solver]
precision = "double"
[groom]
files = ["top.tfx", {file = "tail.hair", units = "m", up = "+Z"}]
units = "cm"
up = "-Z"
space = "head"
scale = 2
rotate = [0, 90, 0.5]
translate = [1, 2, 3]
[head]
animation = "dance.glb"
clip = "Dance"
node = "Neck/Head"
units = "mm"
up = "Z"
start = 5
rest_frame = 1.5
[forces]
gravity = [0, 0, -1]
[wind]
velocity = [3, 0, 0]
gust = 0.4
period = 2
[[region]]
name = "tail"
strands = {file = "tail.hair", range = "0-99, 200", box = {min = [0, 0, 0]}}
damping = 0.2
drag = 3
local = {stiffness = 0.3, iterations = 5, method = 2}
global.stiffness = 0.25
global.range = 0.5
global.fade = 0.75
[region.lengths]
iterations = 7
[[region]]
name = "rest"
[[collider]]
sphere = {center = [0, 0.92, 0.099], radius = 0.265}
node = "Neck/Head"
space = "node"
[cache]
precision = 1e-5
compression = "deflate:12"
velocity = true
stats = false
)");
  CHECK(scene.first_frame == 10);
  CHECK(scene.last_frame == 20);
  CHECK(scene.bake.fps == 29.97);
  CHECK(scene.bake.substeps == 8);
  CHECK(scene.bake.tolerance == 2e-4);
  CHECK(scene.bake.preroll == 12);
  CHECK(scene.solver.precision == "double");
  REQUIRE(scene.groom.files.size() == 2);
  CHECK(scene.groom.files[0].file == "top.tfx");
  CHECK(scene.groom.files[1].file == "tail.hair");
  CHECK(scene.groom.files[1].units == "m");
  CHECK(scene.groom.files[1].up == "+Z");
  CHECK(scene.groom.units == "cm");
  CHECK(scene.groom.up == "-Z");
  CHECK(scene.groom.space == "head");
  CHECK(scene.groom.scale == 2);
  CHECK(scene.groom.rotate == Eigen::Vector3d(0, 90, 0.5));
  CHECK(scene.groom.translate == Eigen::Vector3d(1, 2, 3));
  CHECK(scene.head.animation == "dance.glb");
  CHECK(scene.head.clip == "Dance");
  CHECK(scene.head.node == "Neck/Head");
  CHECK(scene.head.units == "mm");
  CHECK(scene.head.up == "Z");
  CHECK(scene.head.start == 5.0);
  CHECK(scene.head.rest_frame == 1.5);
  CHECK(scene.forces.base.gravity == Eigen::Vector3d(0, 0, -1));
  CHECK(scene.wind.base.velocity == Eigen::Vector3d(3, 0, 0));
  CHECK(scene.wind.base.gust == 0.4);
  CHECK(scene.wind.base.period == 2);
  REQUIRE(scene.regions.size() == 2);
  const RegionScene& tail = scene.regions[0];
  CHECK(tail.name == "tail");
  CHECK(tail.strands.file == "tail.hair");
  CHECK(tail.strands.range == "0-99, 200");
  REQUIRE(tail.strands.box);
  CHECK(tail.strands.box->min == Eigen::Vector3d(0, 0, 0));
  CHECK(tail.strands.box->max == BoxParams{}.max);
  CHECK(tail.params.base.damping == 0.2);
  CHECK(tail.params.base.drag == 3);
  CHECK(tail.params.base.local.stiffness == 0.3);
  CHECK(tail.params.base.local.iterations == 5);
  CHECK(tail.params.base.local.method == 2);
  CHECK(tail.params.base.global.stiffness == 0.25);
  CHECK(tail.params.base.global.range == 0.5);
  CHECK(tail.params.base.global.fade == 0.75);
  CHECK(tail.params.base.lengths.iterations == 7);
  CHECK_FALSE(tail.params.base.lengths.direct);
  CHECK(scene.regions[1].name == "rest");
  CHECK(!scene.regions[1].strands.box);
  REQUIRE(scene.colliders.size() == 1);
  CHECK(scene.colliders[0].base.sphere.center == Eigen::Vector3d(0, 0.92, 0.099));
  CHECK(scene.colliders[0].base.sphere.radius == 0.265);
  CHECK(scene.colliders[0].base.node == "Neck/Head");
  CHECK(scene.colliders[0].base.space == "node");
  CHECK(scene.cache.precision == 1e-5);
  CHECK(scene.deflate_level == 12);
  CHECK(scene.cache.velocity);
  CHECK(!scene.cache.stats);
}

TEST_CASE("a preset sets what the scene leaves open, and nothing else") {
  const Scene draft = read_good(std::string("bake.quality = \"draft\"\n") + groom);
  CHECK(draft.bake.substeps == 1);
  CHECK(draft.regions.at(0).params.base.local.method == 3);
  const Scene own = read_good(std::string("bake = {quality = \"fine\", substeps = \"auto\"}\n") + groom +
                              "[[region]]\nname = \"a\"\nlocal.method = 1\nstrands.file = \"a.hair\"\n"
                              "[[region]]\nname = \"b\"\nlocal.stiffness = 0.25\n");
  CHECK(!own.bake.substeps);
  CHECK(own.regions.at(0).params.base.local.method == 1);
  CHECK(own.regions.at(1).params.base.local.method == 3);
  CHECK(own.regions.at(1).params.base.local.stiffness == 0.25);
  CHECK(read_good(std::string("bake.quality = \"fine\"\n") + groom, {"bake.substeps=8"}).bake.substeps == 8);
  CHECK(read_good(groom).regions.at(0).params.base.local.method == 1);
}

TEST_CASE("hair is a preset for the rod's numbers that are left open") {
  for (const HairPreset& hair : kHairPresets) {
    const std::string region = std::string("[[region]]\nname = \"a\"\nhair = \"") + hair.name + "\"\n";
    const RodParams own = read_good(groom + region).regions.at(0).params.base.rod;
    CHECK(own.young == hair.young);
    CHECK(own.radius == hair.radius);
    CHECK(own.density == hair.density);
    const RodParams set = read_good(groom + region + "rod = {radius = 6e-5}\n").regions.at(0).params.base.rod;
    CHECK(set.young == hair.young);
    CHECK(set.radius == 6e-5);
    CHECK(set.density == hair.density);
    // The solver's defaults are those of the scene's.
    const RodParams defaults;
    if (std::string(hair.name) != "medium") continue;
    CHECK(defaults.young == hair.young);
    CHECK(defaults.radius == hair.radius);
    CHECK(defaults.density == hair.density);
    CHECK(read_good(groom).regions.at(0).hair == "medium");
  }
}

TEST_CASE("the groom's files can be one text, texts, or tables") {
  CHECK(read_good("groom.files = \"a.hair\"").groom.files.at(0).file == "a.hair");
  CHECK(read_good("groom.files = [\"a.hair\", \"b.obj\"]").groom.files.at(1).file == "b.obj");
  const Scene scene =
      read_good("[[groom.files]]\nfile = \"a.hair\"\n[[groom.files]]\nfile = \"b.tfx\"\nunits = \"cm\"\n");
  REQUIRE(scene.groom.files.size() == 2);
  CHECK(scene.groom.files[1].units == "cm");
}

TEST_CASE("byte order marks, carriage returns and a missing last line break are read") {
  CHECK(read_good("\xEF\xBB\xBF[groom]\r\nfiles = [\"a.hair\"]\r\n[bake]\r\nfps = 30").bake.fps == 30);
  check_fault("\xEF\xBB\xBF[groom]\r\nfiles = [\"a.hair\"]\r\n[bake]\r\nfps = 0\r\n", "4:7", {"bake.fps"});
}

TEST_CASE("an empty scene says that it has no groom") {
  check_fault("", "1:1", {"no groom", "groom.files"});
  check_fault("# nothing\n", "1:1", {"no groom"});
  check_fault("[groom]\nunits = \"cm\"\n", "1:1", {"no groom"});
  check_fault("\n  [groom]\n  files = []\n", "3:11", {"no groom"});
}

TEST_CASE("a fault of syntax is reported where it stands") {
  check_fault("[bake]\nfps = \n", "2:7", {"not TOML"});
  check_fault("[bake]\nfps = 1\nfps = 2\n", "3:7", {"not TOML", "fps"});
  check_fault("[bake]\n[bake]\n", "2:1", {"not TOML", "bake"});
  check_fault("a = \"\xff\"\n", "1:5", {"not TOML", "utf-8"});
  check_fault("bake.\xC3\xA9 = 1\n", "1:6", {"not TOML", "plain quotes"});
  check_fault(
      "\xEF\xBB\xBF# \xC3\xA9\nbake.frames = \xE2\x80\x9C"
      "1\xE2\x80\x9D\n",
      "2:15", {"not TOML", "plain quotes"});
  check_fault("bake.\"\xC3\xA9\" = 1\n" + groom, "1:6", {"\"\xC3\xA9\": unknown key"});
  check_fault("[[ {}\n", "1:4", {"not TOML"});
  check_fault("bake.substeps = 99999999999999999999\n", "1:37", {"not TOML", "64 bits"});
}

TEST_CASE("unknown keys are faults with the closest known key") {
  check_fault_below("[wind]\ncompliace = 1\n", "4:1",
                    {"\"compliace\": unknown key, \"wind\" can have \"velocity\", \"gust\" or"});
  check_fault_below("[wind]\n  gsut = 1\n", "4:3", {"\"gsut\": unknown key, did you mean \"gust\"?"});
  check_fault_below("[wnid]\n", "3:2", {"\"wnid\": unknown key, did you mean \"wind\"?"});
  check_fault_below("[[regions]]\nname = \"a\"\n", "3:3", {"\"regions\": unknown key, did you mean \"region\"?"});
  check_fault_below("[[region]]\nname = \"a\"\nlocal = {stifness = 1}\n", "5:10",
                    {"\"stifness\"", "did you mean \"stiffness\"?"});
  check_fault_below(
      "[[region]]\nname = \"a\"\nmethod = 1\n", "5:10",
      {"\"region[0].method\" is the number 1, but must be \"shape\" or \"rod\"", "did you mean \"local.method\"?"});
  check_fault_below("gravity = 1\n", "3:1", {"\"gravity\": unknown key, \"groom\" can have"});
  check_fault("gravity = 1\n" + groom, "1:1", {"did you mean \"forces.gravity\"?"});
  check_fault("nonsense = 1\n" + groom, "1:1", {"\"nonsense\": unknown key, a scene can have \"bake\", "});
  check_fault("\"a\\nb\" = 1\n" + groom, "1:1", {"a\\u000ab"});
}

TEST_CASE("wrong types say what was found and what would do") {
  check_fault_below("[bake]\nfps = \"fast\"\n", "4:7", {"\"bake.fps\" is the text \"fast\"", "a number", "fps = 24"});
  check_fault_below("[bake]\nsubsteps = 4.0\n", "4:12", {"the number 4", "a whole number or \"auto\"", "substeps = 4"});
  check_fault_below("[bake]\nsubsteps = \"fast\"\n", "4:12",
                    {"\"bake.substeps\" is the text \"fast\", but must be a whole number or \"auto\", for example"});
  check_fault_below("[bake]\nsubsteps = \"atuo\"\n", "4:12", {"a whole number or \"auto\"; did you mean \"auto\"?"});
  check_fault_below("[bake]\nsubsteps = [\"auto\"]\n", "4:12", {"a list of 1", "a whole number or \"auto\""});
  check_fault_below("[bake]\nframes = 7\n", "4:10", {"\"bake.frames\" is the number 7", "a text", "frames = \"1-24\""});
  check_fault_below("[solver]\nprecision = 32\n", "4:13", {"the number 32", "\"float\" or \"double\""});
  check_fault_below("[solver]\nprecision = \"flaot\"\n", "4:13",
                    {"\"flaot\"", "\"float\" or \"double\"", "did you mean \"float\"?"});
  check_fault_below("[cache]\nvelocity = 1\n", "4:12",
                    {"\"cache.velocity\" is the number 1", "true or false", "velocity = false"});
  check_fault_below("[cache]\nprecision = true\n", "4:13", {"\"cache.precision\" is true", "a number"});
  check_fault_below("[head]\nstart = 1979-05-27\n", "4:9", {"\"head.start\" is a date or time", "a number"});
  check_fault_below("[forces]\ngravity = -9.81\n", "4:11",
                    {"\"forces.gravity\" is the number -9.81", "3 numbers", "gravity = [0, -9.81, 0]", "{1 = "});
  check_fault_below("[forces]\ngravity = [0, 1]\n", "4:11", {"a list of 2", "3 numbers"});
  check_fault_below("[forces]\ngravity = [0, \"x\", 0]\n", "4:15", {"holds the text \"x\"", "3 numbers"});
  check_fault_below("rotate = {1 = [0, 0, 0]}\n", "3:10", {"\"groom.rotate\" is a table", "a list of 3 numbers, for"});
  check_fault("bake = 3\n" + groom, "1:8", {"\"bake\" is the number 3", "a table", "bake = {frames = \"1-24\"}"});
  check_fault("groom = 3\n", "1:9", {"\"groom\" is the number 3", "groom = {files = [\"a.hair\"]}"});
  check_fault("[groom]\nfiles = 3\n", "2:9", {"\"groom.files\" is the number 3", "a list of files"});
  check_fault("[groom]\nfiles = [3]\n", "2:10", {"\"groom.files[0]\" is the number 3", "a text or a table"});
  check_fault("[groom]\nfiles = {file = \"a.hair\"}\n", "2:9", {"a list of files"});
  check_fault("region = 3\n" + groom, "1:10", {"\"region\" is the number 3", "[[region]]"});
  check_fault("region = [3]\n" + groom, "1:11", {"\"region[0]\" is the number 3", "a table", "{name = "});
  check_fault_below("[region]\nname = \"a\"\n", "3:1", {"\"region\" is a table", "a list of tables", "[[region]]"});
  check_fault_below("[[collider]]\nsphere = 0.1\n", "4:10",
                    {"\"collider[0].sphere\"", "sphere = {center = [0, 0, 0]}"});
  check_fault_below("[[region]]\nname = \"a\"\nstrands = \"a.hair\"\n", "5:11",
                    {"\"region[0].strands\" is the text \"a.hair\"", "strands = {file = "});
}

TEST_CASE("values out of range say the value, the range and the unit") {
  check_fault_below("[bake]\nfps = 0\n", "4:7", {"\"bake.fps\" is 0", "more than 0 and at most 100000 (1/s)"});
  check_fault_below("[bake]\nfps = -24.5\n", "4:7", {"-24.5"});
  check_fault_below("[bake]\nsubsteps = 0\n", "4:12",
                    {"\"bake.substeps\" is 0, but must be from 1 to 1000, or \"auto\""});
  check_fault_below("[bake]\nsubsteps = 1001\n", "4:12", {"from 1 to 1000"});
  check_fault_below("[bake]\nsubsteps = 9223372036854775807\n", "4:12", {"9223372036854775807", "from 1 to 1000"});
  check_fault_below("[bake]\npreroll = 4294967297\n", "4:11", {"4294967297", "from 0 to 100000 (frame)"});
  check_fault_below("[[collider]]\nsphere.radius = -0.5\n", "4:17",
                    {"\"collider[0].sphere.radius\" is -0.5", "from 0 to 1000000000 (m)"});
  check_fault_below("[[region]]\nname = \"a\"\nlocal.stiffness = 1.5\n", "5:19",
                    {"\"region[0].local.stiffness\" is 1.5", "from 0 to 1"});
  check_fault_below("[forces]\ngravity = [0, nan, 0]\n", "4:15",
                    {"\"forces.gravity\" (y) is nan", "a finite number (m/s^2)"});
  check_fault_below("[head]\nstart = inf\n", "4:9", {"\"head.start\" is inf", "a finite number (frame)"});
  check_fault_below("[head]\nclip = \"a\\u0000b\"\n", "4:8", {"\"head.clip\"", "zero byte"});
}

TEST_CASE("values at the edge of their range are good") {
  const Scene scene =
      read_good(groom +
                "[bake]\nfps = 5e-324\nsubsteps = 1000\npreroll = 100000\n"
                "[[region]]\nname = \"a\"\ndamping = 1\nlocal = {stiffness = 0, iterations = 0, method = 3}\n"
                "[[collider]]\nsphere = {radius = 0}\n");
  CHECK(scene.bake.fps == 5e-324);
  CHECK(scene.bake.substeps == 1000);
  CHECK(scene.regions[0].params.base.damping == 1);
  CHECK(scene.regions[0].params.base.local.method == 3);
  CHECK(scene.colliders[0].base.sphere.radius == 0);
}

TEST_CASE("what belongs together is checked together") {
  check_fault("[groom]\nfiles = [\"\"]\n", "2:10", {"\"groom.files[0]\" names no file"});
  check_fault("[groom]\nfiles = [\"a.hair\", {units = \"cm\"}]\n", "2:20", {"\"groom.files[1]\" names no file"});
  check_fault_below("space = \"head\"\n", "3:9", {"\"groom.space\" is \"head\"", "head.node"});
  check_fault_below("[head]\nnode = \"Head\"\n", "4:8", {"\"head.node\" is \"Head\"", "no animation", "animation = "});
  check_fault_below("[head]\nanimation = \"a.glb\"\n", "4:13", {"\"head.animation\" is \"a.glb\"", "node = \"Head\""});
  check_fault_below("[[collider]]\n", "3:1", {"\"collider[0]\" has no shape", "sphere = {"});
  check_fault_below("[[collider]]\nsphere.radius = 1\nnode = \"Head\"\n", "5:8",
                    {"\"collider[0].node\" is \"Head\"", "no animation"});
  check_fault_below("[[collider]]\nsphere.radius = 1\nspace = \"node\"\n", "5:9",
                    {"\"collider[0].space\" is \"node\"", "node = \"Head\""});
  check_fault_below("[[region]]\ndamping = 0\n", "3:1", {"\"region[0]\" has no name", "name = "});
  check_fault_below("[[region]]\nname = \"\"\n", "4:8", {"\"region[0]\" has no name"});
  check_fault_below("[[region]]\nname = \"a\"\n[[region]]\nname = \"a\"\nstrands.range = \"0\"\n", "6:8",
                    {"\"region[0]\" and \"region[1]\"", "named \"a\""});
  check_fault_below(
      "[[region]]\nname = \"a\"\n[[region]]\nname = \"b\"\nstrands = {}\n", "7:11",
      {"\"region[0]\" and \"region[1]\" both take the strands that no other region takes", "strands = {file"});
  check_fault_below("[[region]]\nname = \"a\"\nstrands.box = {min = [0, 2, 0], max = [1, 1, 1]}\n", "5:15",
                    {"\"region[0].strands.box\"", "[0, 2, 0]", "[1, 1, 1]", "min must not be more than max"});
  check_fault_below("[[region]]\nname = \"a\"\nstrands.range = \"5-2\"\n", "5:17",
                    {"\"region[0].strands.range\"", "backwards", "2-5"});
  check_fault_below("[[region]]\nname = \"a\"\nstrands.range = \"first\"\n", "5:17", {"\"first\"", "0-99, 200"});
  check_fault_below("[[region]]\nname = \"a\"\nstrands.file = \"a.hiar\"\n", "5:16",
                    {"\"region[0].strands.file\" is \"a.hiar\"", "not in groom.files", "did you mean \"a.hair\"?"});
  check_fault_below("[[region]]\nname = \"a\"\nstrands.file = \"tail.tfx\"\n", "5:16",
                    {"not in groom.files", "file = \"a.hair\""});
}

TEST_CASE("texts with a grammar of their own are checked") {
  check_fault_below("[bake]\nframes = \"24-1\"\n", "4:10", {"\"bake.frames\"", "backwards", "\"1-24\""});
  check_fault_below("[bake]\nframes = \"all\"\n", "4:10", {"\"all\"", "\"1-240\""});
  check_fault_below("[bake]\nframes = \"\"\n", "4:10", {"\"bake.frames\""});
  check_fault_below("units = \"parsec\"\n", "3:9", {"\"groom.units\"", "parsec", "cm"});
  check_fault_below("units = \"a\\nb\"\n", "3:9", {"\"groom.units\"", "a b"});
  check_fault_below("units = \"\"\n", "3:9", {"\"groom.units\""});
  check_fault_below("up = \"+W\"\n", "3:6", {"\"groom.up\"", "+W", "+Z"});
  check_fault("[groom]\nfiles = [{file = \"a\", units = \"-1\", up = \"Y\"}]\n", "2:31",
              {"\"groom.files[0].units\"", "-1"});
  check_fault("[groom]\nfiles = [{file = \"a\", up = \"down\"}]\n", "2:28", {"\"groom.files[0].up\"", "down"});
  check_fault_below("[head]\nunits = \"px\"\n", "4:9", {"\"head.units\"", "px"});
  check_fault_below("[head]\nup = \"U\"\n", "4:6", {"\"head.up\"", "\"U\""});
  for (const char* text :
       {"gzip", "deflate", "deflate:", "deflate:0", "deflate:13", "deflate:1x", "deflate:-1", "deflate: 1", ""}) {
    check_fault_below("[cache]\ncompression = \"" + std::string(text) + "\"\n", "4:15",
                      {"\"cache.compression\"", "none", "deflate:12"});
  }
  CHECK(read_good(groom + "[cache]\ncompression = \"none\"\n").deflate_level == 0);
}

TEST_CASE("all faults of a scene are reported at once, in the order in which they stand") {
  const Read result = read(R"([bake]
fps = 0
frames = "9-1"
speed = 2
[cache]
velocity = 1
[[collider]]
node = "Head"
[head]
up = "?"
[[region]]
damping = {1 = 2, "x" = 3}
[groom]
scale = -1
)",
                           {"bake.substeps=0", "wind.gust=-1"});
  std::vector<std::string> places;
  for (const Fault& fault : result.faults) places.push_back(fault.place);
  CHECK(places == std::vector<std::string>{"scene.toml:2:7", "scene.toml:3:10", "scene.toml:4:1", "scene.toml:6:12",
                                           "scene.toml:7:1", "scene.toml:8:8", "scene.toml:10:6", "scene.toml:11:1",
                                           "scene.toml:12:16", "scene.toml:12:19", "scene.toml:13:1", "scene.toml:14:9",
                                           "--set bake.substeps=0", "--set wind.gust=-1"});
  INFO(lines_of(result.faults));
  CHECK(result.faults[4].what.find("no shape") != std::string::npos);
  CHECK(result.faults[7].what.find("no name") != std::string::npos);
  CHECK(result.faults[10].what.find("no groom") != std::string::npos);
}

TEST_CASE("every declared number is read: a value below its range is one fault that names it") {
  for (const Declared::Parameter& p : declared().parameters) {
    using Kind = Declared::Kind;
    if (p.kind == Kind::Text || p.kind == Kind::Switch) continue;
    const double infinity = std::numeric_limits<double>::infinity();
    const bool bounded = p.range.low > -std::numeric_limits<double>::max();
    std::vector<std::string> bad = {p.kind == Kind::Int ? number(p.range.low - 1)
                                    : !bounded          ? "-inf"
                                    : p.range.low_open  ? number(p.range.low)
                                                        : number(std::nextafter(p.range.low, -infinity))};
    if (p.kind == Kind::Int) {
      bad.push_back(number(p.range.high + 1));
      bad.push_back("9223372036854775807");
    } else {
      bad.insert(bad.end(), {"nan", "inf"});
    }
    for (const std::string& value : bad) {
      std::vector<std::string> forms = {value};
      if (p.kind == Kind::Vector) forms = {"[0, 0, " + value + "]", "[" + value + ", 0, 0]"};
      if (p.range.is_keyed) forms.push_back("{1 = " + forms[0] + "}");
      for (const std::string& form : forms) {
        const std::string override = p.path + "=" + form;
        check_fault(full, "--set " + override, {"\"" + p.path + "\"", "must be "}, {override});
      }
    }
  }
}

TEST_CASE("every declared parameter is read: a value of a wrong type is one fault that names it") {
  for (const Declared::Parameter& p : declared().parameters) {
    const bool is_text = p.kind == Declared::Kind::Text;
    if (is_text && !p.has_choices) continue;
    check_fault(full, "--set " + p.path + "=wrong", {"\"" + p.path + "\" is ", "must be "}, {p.path + "=wrong"});
  }
}

TEST_CASE("every declared text without choices is read") {
  for (const Declared::Parameter& p : declared().parameters) {
    if (p.kind != Declared::Kind::Text || p.has_choices) continue;
    const std::string override = p.path + "=\"\\u0000\"";
    const Read result = read(full, {override});
    INFO(lines_of(result.faults));
    CHECK(std::any_of(result.faults.begin(), result.faults.end(), [&](const Fault& f) {
      return f.place == "--set " + override && f.what.find('"' + p.path + '"') == 0;
    }));
  }
}

TEST_CASE("an unknown key beside any declared one is one fault that suggests it") {
  const Declared all = declared();
  std::vector<std::string> paths = all.tables;
  for (const Declared::Parameter& p : all.parameters) paths.push_back(p.path);
  for (std::string path : paths) {
    if (path.back() == ']') path.resize(path.rfind('['));
    const std::string key = path.substr(path.find_last_of('.') + 1);
    const std::string override = path + "x=1";
    check_fault(full, "--set " + override, {"\"" + key + "x\": unknown key, did you mean \"" + key + "\"?"},
                {override});
  }
}

TEST_CASE("every declared parameter is in the list of parameters once it has a value") {
  for (const Declared::Parameter& p : declared().parameters) {
    const std::string value = p.path == "head.start" || p.path == "head.rest_frame" ? "7" : "";
    Read result =
        read(full, value.empty() ? std::vector<std::string>{} : std::vector<std::string>{p.path + "=" + value});
    if (p.kind == Declared::Kind::Text) continue;
    if (p.path.find(".box.") != std::string::npos) result.scene.regions[0].strands.box.emplace();
    const auto list = list_parameters(result.scene);
    INFO(p.path);
    CHECK(std::count_if(list.begin(), list.end(), [&](const auto& entry) { return entry.first == p.path; }) == 1);
  }
}

TEST_CASE("key frames are sorted, interpolated, and held outside") {
  const Scene scene = read_good(groom + R"([[region]]
name = "a"
damping = {48 = 0.8, -2 = 0.2, "0.5" = 0.4, 1e2 = 1}
local = {stiffness = {1 = 0.3, 49 = 0.9}}
[forces]
gravity = {1 = [0, 0, 0], 25 = [3, -6, 12]}
[[collider]]
sphere = {center = {10 = [0, 1, 0], 20 = [1, 1, 0]}, radius = {1 = 1}}
)");
  const Animated<RegionParams>& region = scene.regions[0].params;
  REQUIRE(region.keys.size() == 2);
  CHECK(region.keys[0].first == "damping");
  CHECK(region.keys[0].second.frame == std::vector<double>{-2, 0.5, 48, 100});
  CHECK(region.keys[1].first == "local.stiffness");
  CHECK(region.base.damping == 0.2);
  CHECK(region.base.local.stiffness == 0.3);
  CHECK(region.at(-10).damping == 0.2);
  CHECK(region.at(0.5).damping == 0.4);
  CHECK(region.at(1000).damping == 1);
  CHECK(region.at(0).local.stiffness == 0.3);
  CHECK(region.at(25).local.stiffness == Approx(0.6).epsilon(1e-15));
  CHECK(region.at(60).local.stiffness == 0.9);
  CHECK(region.at(25).local.iterations == 3);
  CHECK(scene.forces.at(1).gravity == Eigen::Vector3d(0, 0, 0));
  CHECK(scene.forces.at(13).gravity == Eigen::Vector3d(1.5, -3, 6));
  CHECK(scene.forces.at(99).gravity == Eigen::Vector3d(3, -6, 12));
  CHECK(scene.colliders[0].at(15).sphere.center == Eigen::Vector3d(0.5, 1, 0));
  CHECK(scene.colliders[0].at(-15).sphere.radius == 1);
  CHECK(scene.colliders[0].keys[0].first == "sphere.center");
}

TEST_CASE("faulty key frames are reported at their place") {
  const auto check = [](const std::string& table, const std::string& at, const std::vector<std::string>& words) {
    check_fault_below("[[region]]\nname = \"a\"\ndamping = " + table + "\n", at, words);
  };
  check("{}", "5:11", {"\"region[0].damping\" is an empty table", "damping = {1 = 0.1, 24 = 0.1}"});
  check("{one = 0.1}", "5:12", {"has the key \"one\"", "frames"});
  check("{\"+1\" = 0.1}", "5:12", {"has the key \"+1\""});
  check("{\"1 \" = 0.1}", "5:12", {"has the key \"1 \""});
  check("{nan = 0.1}", "5:12", {"has the key \"nan\""});
  check("{inf = 0.1}", "5:12", {"has the key \"inf\""});
  check("{1 = 0.1, 01 = 0.2}", "5:21", {"\"region[0].damping\" has frame 1 twice"});
  check("{\"1.0\" = 0.1, 2 = 0.1, 1 = 0.2}", "5:34", {"has frame 1 twice"});
  check("{1.5 = 0.1}", "5:12", {"in quotes, \"1.5\""});
  check("{1 = 0.1, 24 = 1.5}", "5:26", {"\"region[0].damping\" at frame 24 is 1.5", "from 0 to 1"});
  check("{1 = true}", "5:16", {"\"region[0].damping\" at frame 1 is true", "a number"});
  check_fault_below("[wind]\nvelocity = {1 = 3}\n", "4:17",
                    {"\"wind.velocity\" at frame 1 is the number 3", "3 numbers"});
  check_fault_below("[wind]\nperiod = {1 = 3}\n", "4:10",
                    {"\"wind.period\" is a table", "a number, for example period = 1"});
}

TEST_CASE("overrides go through the same checks as the scene") {
  const std::string text = groom +
                           "[[region]]\nname = \"fringe\"\nstrands.range = \"0-9\"\n[[region]]\nname = \"the "
                           "tail\"\ndamping = 0.5\n[[collider]]\nsphere.radius = 1\n";
  const Scene scene = read_good(
      text,
      {"bake.fps=30", " bake.frames = 5-9 ", "region.fringe.damping=0.2", "region[1].local.stiffness=0.25",
       "region.\"the tail\".damping={1 = 0.1, 3 = 0.3}", "collider[0].sphere.center=[1, 2, 3]", "head={clip = \"A\"}",
       "groom.files=[\"a.hair\", \"b.hair\"]", "groom.files[1]=c.tfx", "cache.velocity=true", "head.units='cm'",
       "solver.precision=double", "bake.fps=25", "head.clip=true", "groom.units=0.01"});
  CHECK(scene.bake.fps == 25);
  CHECK(scene.first_frame == 5);
  CHECK(scene.regions[0].params.base.damping == 0.2);
  CHECK(scene.regions[1].params.base.local.stiffness == 0.25);
  CHECK(scene.regions[1].params.at(2).damping == Approx(0.2).epsilon(1e-15));
  CHECK(scene.colliders[0].base.sphere.center == Eigen::Vector3d(1, 2, 3));
  CHECK(scene.colliders[0].base.sphere.radius == 1);
  REQUIRE(scene.groom.files.size() == 2);
  CHECK(scene.groom.files[1].file == "c.tfx");
  CHECK(scene.cache.velocity);
  CHECK(scene.head.units == "cm");
  CHECK(scene.head.clip == "true");
  CHECK(scene.solver.precision == "double");
  CHECK(scene.groom.units == "0.01");
  CHECK(read_good("", {"groom.files=a.hair"}).groom.files.at(0).file == "a.hair");
  CHECK(read_good("", {"groom.files=7"}).groom.files.at(0).file == "7");
  CHECK(read_good(groom, {"head.clip="}).head.clip == "");
  CHECK(read_good(groom, {"bake.frames=7"}).last_frame == 7);
}

TEST_CASE("lengths are solved directly unless iterations are asked for") {
  const auto lengths = [](const std::string& value, const std::vector<std::string>& overrides = {}) {
    return read_good(groom + "[[region]]\nname = \"a\"\n" + value, overrides).regions[0].params.base.lengths;
  };
  for (const char* direct :
       {"", "lengths = \"direct\"", "lengths = {}", "lengths.direct = true", "lengths = {direct = true}"}) {
    CHECK(lengths(direct).direct);
    CHECK(lengths(direct).iterations == 0);
  }
  for (const char* two :
       {"lengths = {iterations = 2}", "lengths.iterations = 2", "lengths = {direct = false, iterations = 2}"}) {
    CHECK_FALSE(lengths(two).direct);
    CHECK(lengths(two).iterations == 2);
  }
  CHECK_FALSE(lengths("lengths = {iterations = 0}").direct);
  CHECK(lengths("lengths = {iterations = 2}", {"region.a.lengths=direct"}).direct);
  CHECK(lengths("", {"region.a.lengths={iterations = 3}"}).iterations == 3);
  const auto fault = [](const std::string& value, const std::string& at, const std::vector<std::string>& words) {
    check_fault(groom + "[[region]]\nname = \"a\"\n" + value, at, words);
  };
  fault("lengths = \"straight\"\n", "5:11",
        {"\"region[0].lengths\" is the text \"straight\"", "\"direct\" or a table", "{iterations = 2}"});
  fault("lengths = 2\n", "5:11", {"must be \"direct\" or a table"});
  fault("lengths = {direct = true, iterations = 2}\n", "5:40",
        {"\"region[0].lengths.iterations\" is 2", "leave out one"});
}

TEST_CASE("the number of substeps can be left to the program, and taken back") {
  const auto listed = [](const Scene& scene) {
    for (const auto& [key, value] : list_parameters(scene)) {
      if (key == "bake.substeps") return value;
    }
    return std::string();
  };
  const std::string text = groom + "[bake]\nsubsteps = \"auto\"\n";
  CHECK_FALSE(read_good(text).bake.substeps);
  CHECK(listed(read_good(text)) == "\"auto\"");
  CHECK(read_good(text, {"bake.substeps=3"}).bake.substeps == 3);
  for (const char* override : {"bake.substeps=auto", "bake.substeps=\"auto\"", "bake.substeps = 'auto'"}) {
    CHECK_FALSE(read_good(groom, {override}).bake.substeps);
  }
  check_fault(groom, "--set bake.substeps=Auto", {"\"bake.substeps\" is the text \"Auto\""}, {"bake.substeps=Auto"});
}

TEST_CASE("a scene without regions can have its only one overridden") {
  for (const char* override : {"region.hair.damping=0.2", "region[0].damping=0.2"}) {
    const Scene scene = read_good(groom, {override});
    REQUIRE(scene.regions.size() == 1);
    CHECK(scene.regions[0].name == "hair");
    CHECK(scene.regions[0].params.base.damping == 0.2);
  }
}

TEST_CASE("faulty overrides name themselves") {
  const std::string text = groom + "[[region]]\nname = \"tail\"\n";
  const auto check = [&](const std::string& override, const std::vector<std::string>& words) {
    check_fault(text, "--set " + override, words, {override});
  };
  check("bake.fps=0", {"\"bake.fps\" is 0", "more than 0"});
  check("bake.fps=fast", {"\"bake.fps\" is the text \"fast\""});
  check("bake.fps=", {"\"bake.fps\" is the text \"\""});
  check("bake.fps=30\nbake.substeps=2", {"is the text \"30\\u000abake.substeps=2\""});
  for (const char* value : {"\"a\xe2", "a\xff.hair", "[\"a.\xbb"}) {
    check(std::string("groom.files=") + value, {"not a text in UTF-8"});
  }
  check("bake.fsp=30", {"\"fsp\": unknown key, did you mean \"fps\"?"});
  check("bkae.fps=30", {"\"bkae\": unknown key, did you mean \"bake\"?"});
  check("colider[0].sphere.radius=1", {"\"colider\" is not a list, did you mean \"collider\"?"});
  check("collider[0].sphere.radius=1", {"there is no \"collider[0]\"", "no entries"});
  check("region[1].damping=1", {"there is no \"region[1]\"", "entries 0 to 0"});
  check("region[99999999999999999999].damping=1", {"whole number"});
  check("region[-1].damping=1", {"whole number"});
  check("region.tial.damping=1", {"no region is named \"tial\", did you mean \"tail\"?"});
  check("region.zzz.damping=1", {"no region is named \"zzz\", the scene has \"tail\""});
  check("groom.files.a=1", {"\"groom.files\" is a list", "groom.files[0]"});
  check("nothing.there[0]=1", {"\"nothing.there\" is not a list"});
  check("bake[0].fps=1", {"\"bake\" is not a list"});
  check("region.tail.damping.x.y=1", {"\"x\""});
  check("region.tail.damping=1.5", {"\"region[0].damping\" is 1.5"});
  check("bake", {"no \"=\"", "key=value"});
  check("", {"no \"=\""});
  check("=1", {"an empty part"});
  check("bake..fps=1", {"an empty part"});
  check("bake.fps 1=1", {"followed by \"1\""});
  check("bake.\"fps=1", {"a quote is not closed"});
  check("a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a.a=1", {"too many parts"});
  check_fault("[groom]\nfiles = \"a.hair\"\n", "--set groom.files[0]=b", {"\"groom.files\" is not a list"},
              {"groom.files[0]=b"});
  check_fault(groom + "[bake]\nfps = 30\n", "--set bake.fps.x=1", {"\"bake.fps\" is not a table"}, {"bake.fps.x=1"});
}

TEST_CASE("later stages can ask for the place of any parameter") {
  const Scene scene = read_good(
      groom + "[bake]\nfps = 30\n[[region]]\nname = \"a\"\nlocal = {stiffness = 1}\n[[collider]]\nsphere.radius = 1\n",
      {"cache.velocity=true", "region.a.damping=0.5"});
  CHECK(scene.place("bake.fps") == "scene.toml:4:7");
  CHECK(scene.place("bake.substeps") == "scene.toml:3:1");
  CHECK(scene.place("groom.files[0]") == "scene.toml:2:10");
  CHECK(scene.place("groom.files[0].file") == "scene.toml:2:10");
  CHECK(scene.place("region[0]") == "scene.toml:5:1");
  CHECK(scene.place("region[0].local.stiffness") == "scene.toml:7:22");
  CHECK(scene.place("region[0].local.method") == "scene.toml:7:9");
  CHECK(scene.place("region[0].strands.file") == "scene.toml:5:1");
  CHECK(scene.place("region[0].damping") == "--set region.a.damping=0.5");
  CHECK(scene.place("cache.velocity") == "--set cache.velocity=true");
  CHECK(scene.place("wind.gust") == "scene.toml:1:1");
  CHECK(scene.place("") == "scene.toml:1:1");
}

TEST_CASE("deep nesting is refused before it can overflow the stack") {
  const auto repeat = [](const std::string& piece, int count) {
    std::string out;
    for (int k = 0; k < count; ++k) out += piece;
    return out;
  };
  const int deep = 200000;
  check_fault("[" + repeat("a.", deep) + "a]\n", "1:129", {"nested too deeply"});
  check_fault(repeat("a.", deep) + "a = 1\n", "1:130", {"nested too deeply"});
  check_fault("x = " + repeat("[", deep), "1:69", {"nested too deeply"});
  check_fault("x = " + repeat("{a.a.a.a=", deep), "1:149", {"nested too deeply"});
  check_fault("\"é\" = 1\n" + repeat("\"a\" . ", deep) + "a = 1\n", "2:389", {"nested too deeply"});
  check_fault(groom, "--set bake.fps=" + repeat("[", deep), {"\"bake.fps\" is the text"},
              {"bake.fps=" + repeat("[", deep)});
  // Dots in strings, comments and numbers are no depth.
  const std::string dots(1000, '.');
  read_good("# " + dots + "\n" + groom + "[head]\nclip = \"\\\"" + dots + "\"\nunits = 'm'\n[[region]]\nname = '''" +
            dots + "''''\n[region.strands]\nfile = \"\"\"a.hair\"\"\" # \"" + dots + "\n" + repeat("# 0.5\n", 500));
  std::string keys;
  for (int k = 0; k < 500; ++k) keys += std::to_string(k) + " = 0.5, ";
  read_good(groom + "[wind]\ngust = {" + keys + "\"500.5\" = 0.5}\n");
}

TEST_CASE("a range of frames is read in all its forms") {
  CHECK(parse_frames("1-240") == std::pair(1, 240));
  CHECK(parse_frames("7") == std::pair(7, 7));
  CHECK(parse_frames("7-7") == std::pair(7, 7));
  CHECK(parse_frames(" 1 - 24 ") == std::pair(1, 24));
  CHECK(parse_frames("-10--1") == std::pair(-10, -1));
  CHECK(parse_frames("-10-5") == std::pair(-10, 5));
  CHECK(parse_frames("0001-0002") == std::pair(1, 2));
  CHECK(parse_frames("-10000000-10000000") == std::pair(-10000000, 10000000));
  for (const char* text : {"", " ", "-", "1-", "1-2-3", "a", "1.5", "1,2", "5-2", "1 2", "--1", "10000001",
                           "-10000001-0", "99999999999999999999", "+1"}) {
    INFO(text);
    CHECK_THROWS_AS(parse_frames(text), std::invalid_argument);
  }
}

TEST_CASE("ranges of strands come out sorted and disjoint") {
  using Ranges = std::vector<std::pair<std::size_t, std::size_t>>;
  constexpr std::size_t most = std::numeric_limits<std::size_t>::max();
  CHECK(parse_ranges("0-99, 200") == Ranges{{0, 99}, {200, 200}});
  CHECK(parse_ranges("200,0-99") == Ranges{{0, 99}, {200, 200}});
  CHECK(parse_ranges(" 5 ") == Ranges{{5, 5}});
  CHECK(parse_ranges("0-9,5-20,30") == Ranges{{0, 20}, {30, 30}});
  CHECK(parse_ranges("0-9,10-20") == Ranges{{0, 20}});
  CHECK(parse_ranges("0-100,5-6,7") == Ranges{{0, 100}});
  CHECK(parse_ranges("3,3,3") == Ranges{{3, 3}});
  CHECK(parse_ranges("18446744073709551615, 0-18446744073709551615") == Ranges{{0, most}});
  for (const char* text : {"", ",", "1,", ",1", "1-", "-1", "5-2", "a", "1 2", "1.5", "18446744073709551616", "1--2"}) {
    INFO(text);
    CHECK_THROWS_AS(parse_ranges(text), std::invalid_argument);
  }
}

// A folder that is removed in the end.
struct Folder {
  fs::path path;
  explicit Folder(const std::string& name) : path(fs::temp_directory_path() / name) {
    fs::remove_all(path);
    fs::create_directories(path);
  }
  ~Folder() { fs::remove_all(path); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  fs::path write(const std::string& name, const std::string& text) const {
    fs::create_directories((path / name).parent_path());
    std::ofstream(path / name, std::ios::binary) << text;
    return path / name;
  }
};

TEST_CASE("files are looked for beside the scene, then along the search path") {
  const Folder folder("strandbake_scene_test_search");
  const fs::path file = folder.write("shot/scene.toml", groom);
  folder.write("shot/near.hair", "");
  folder.write("one/near.hair", "");
  folder.write("one/far.hair", "");
  folder.write("two/far.hair", "");
  folder.write("two/sub/deep.hair", "");
  fs::create_directories(folder.path / "one/sub/deep.hair");  // a folder is no input
  Faults faults;
  const Scene scene = read_scene(file, {}, {folder.path / "one", folder.path / "two"}, faults);
  CHECK(lines_of(faults) == "");
  CHECK(scene.text == groom);
  CHECK(find_input(scene, "near.hair") == folder.path / "shot/near.hair");
  CHECK(find_input(scene, "far.hair") == folder.path / "one/far.hair");
  CHECK(find_input(scene, "sub/deep.hair") == folder.path / "two/sub/deep.hair");
  CHECK(find_input(scene, (folder.path / "two/far.hair").string()) == folder.path / "two/far.hair");
  CHECK(find_input(scene, (folder.path / "two/none.hair").string()).empty());
  CHECK(find_input(scene, "none.hair").empty());
  CHECK(find_input(scene, "").empty());
}

TEST_CASE("faults name the scene as the user gave it") {
  const Folder folder("strandbake_scene_test_name");
  const fs::path file = folder.write("a scene.toml", "[bake]\nfps = 0\n" + groom);
  Faults faults;
  read_scene(file, {}, {}, faults);
  REQUIRE(faults.size() == 1);
  CHECK(faults[0].place == file.string() + ":2:7");
}

TEST_CASE("a scene that cannot be read at all is an error") {
  const Folder folder("strandbake_scene_test_missing");
  Faults faults;
  CHECK_THROWS_AS(read_scene(folder.path / "none.toml", {}, {}, faults), InputError);
  CHECK_THROWS_AS(read_scene(folder.path, {}, {}, faults), InputError);
  CHECK(faults.empty());
}

std::string text_of(const std::vector<std::pair<std::string, std::string>>& list) {
  std::string text;
  for (const auto& [key, value] : list) text += key + " = " + value + "\n";
  return text;
}

TEST_CASE("the list of parameters is in the order of declaration and reads back to the same") {
  const Scene scene = read_good(groom + R"([bake]
fps = 29.97
substeps = "auto"
[head]
clip = "a \"b\"\n"
start = 0.1
[[region]]
name = "a"
damping = {-1 = 0.1, "1.5" = 0.3}
strands = {box = {min = [0, 1e-7, -0.0]}}
[[collider]]
sphere.center = {1 = [0, 1, 2]}
)");
  const auto list = list_parameters(scene);
  CHECK(text_of(list) == R"(bake.frames = "1-24"
bake.fps = 29.97
bake.quality = "none"
bake.substeps = "auto"
bake.tolerance = 0.001
bake.preroll = 0
solver.precision = "float"
groom.files[0].file = "a.hair"
groom.units = "m"
groom.up = "+Y"
groom.space = "world"
groom.scale = 1
groom.rotate = [0, 0, 0]
groom.translate = [0, 0, 0]
head.clip = "a \"b\"\u000a"
head.start = 0.1
forces.gravity = [0, -9.81, 0]
wind.velocity = [0, 0, 0]
wind.gust = 0
wind.period = 1
region[0].name = "a"
region[0].strands.box.min = [0, 1e-07, -0.0]
region[0].strands.box.max = [1e+30, 1e+30, 1e+30]
region[0].hair = "medium"
region[0].simulate = true
region[0].sag_free = false
region[0].damping = {-1 = 0.1, "1.5" = 0.3}
region[0].drag = 1
region[0].method = "shape"
region[0].local.stiffness = 0.5
region[0].local.iterations = 3
region[0].local.method = 1
region[0].local.reaction = true
region[0].global.stiffness = 0.1
region[0].global.range = 0.3
region[0].global.fade = 1
region[0].lengths.direct = true
region[0].lengths.iterations = 0
region[0].rod.young = 4000000000
region[0].rod.poisson = 0.3
region[0].rod.shear = 0
region[0].rod.radius = 3.5e-05
region[0].rod.density = 1300
region[0].rod.stiffness = 1
region[0].rod.iterations = 1
region[0].rod.exact_lengths = true
collider[0].sphere.center = {1 = [0, 1, 2]}
collider[0].sphere.radius = 0.1
collider[0].space = "world"
cache.precision = 0
cache.compression = "deflate:1"
cache.velocity = false
cache.stats = true
)");

  std::vector<std::string> overrides;
  for (const auto& [key, value] : list) overrides.push_back(key + "=" + value);
  const std::string same_shape = "[groom]\nfiles = [{}]\n[[region]]\nname = \"a\"\n[[collider]]\nsphere = {}\n";
  CHECK(text_of(list_parameters(read_good(same_shape, overrides))) == text_of(list));
}

TEST_CASE("the default scene has every parameter at its default") {
  std::string text = default_scene();
  const std::string files = "files = []";
  const std::size_t at = text.find(files);
  REQUIRE(at != std::string::npos);
  const std::string line = std::to_string(std::count(text.begin(), text.begin() + static_cast<long>(at), '\n') + 1);
  check_fault(text, line + ":9", {"no groom"});
  text.replace(at, files.size(), "files = [\"a.hair\"]");
  CHECK(text_of(list_parameters(read_good(text))) == text_of(list_parameters(read_good(groom))));

  // What is commented out is good too, and then nothing declared is missing.
  std::string all;
  std::istringstream lines(text);
  for (std::string one; std::getline(lines, one);) {
    const bool is_setting = one.size() > 1 && one[0] == '#' && one[1] != ' ';
    all += (is_setting ? one.substr(1) : one) + "\n";
  }
  const Scene scene = read_good(all);
  for (const Declared::Parameter& p : declared().parameters) {
    INFO(p.path);
    if (p.path.find("groom.files") == std::string::npos) CHECK(scene.positions.count(p.path) == 1);
  }
}

TEST_CASE("the example of the scene's page is a good scene") {
  const std::string page = scene_reference();
  const std::string fence = "```toml\n";
  const std::size_t begin = page.rfind(fence) + fence.size();
  const Scene scene = read_good(page.substr(begin, page.find("```", begin) - begin));
  CHECK(scene.regions.size() == 2);
  CHECK(scene.colliders.size() == 1);
}

TEST_CASE("the scene's page names every parameter and is the committed one") {
  const std::string page = scene_reference();
  for (const Declared::Parameter& p : declared().parameters) {
    const std::string key = p.path.substr(p.path.rfind('.') + 1);
    INFO(p.path);
    CHECK((page.find("| `" + key + "` |") != std::string::npos || page.find('.' + key + "` |") != std::string::npos));
  }
  const fs::path file = fs::path(__FILE__).parent_path() / "../../docs/SCENE.md";
  std::ostringstream committed;
  committed << std::ifstream(file, std::ios::binary).rdbuf();
  INFO("docs/SCENE.md is not what the declarations say: run `strandbake docs > docs/SCENE.md`");
  CHECK((committed.str() == page));
}

}  // namespace
