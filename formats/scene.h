// The scene: what a person wrote in TOML, read with positions, checked, and put into plain structs.
// Every parameter is declared once, in the fields() functions here and in sim/params.h; docs/SCENE.md is made from
// them.
#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "formats/error.h"
#include "sim/declare.h"
#include "sim/params.h"

namespace strandbake {

struct BakeParams {
  std::string frames = "1-24";
  double fps = 24;
  std::string quality = "none";
  std::optional<int> substeps = 4;  // none: "auto"
  double tolerance = 0.001;
  int preroll = 0;
};
template <class V>
void fields(V& v, BakeParams& p) {
  v("frames", p.frames, any_text(), "frame", "First and last frame, \"1-240\", or one frame, \"7\".");
  v("fps", p.fps, Range{0, 100000, true}, "1/s", "Frames a second.");
  v("quality", p.quality, one_of({"none", "draft", "normal", "fine"}), "",
    "A preset for what the scene leaves open: bake.substeps (1, 4, 16) and the local.method of each region (3, the "
    "fastest). docs/ACCURACY.md has the error and the time of each.");
  v("substeps", p.substeps, or_auto(between(1, 1000)), "1",
    "Steps of the simulation in a frame; head and colliders move in each. \"auto\": as many as the motion of head "
    "and colliders needs, in the frame and for as long as damping lets hair ring on, one where all is calm; wind, "
    "gravity and stiffness do not count.");
  v("tolerance", p.tolerance, Range{0, 1, true}, "m",
    "With substeps = \"auto\": how far a root may stray, in a substep, from going straight on. Half of it takes "
    "about 1.4 times as many substeps.");
  v("preroll", p.preroll, between(0, 100000), "frame",
    "Frames simulated before the first, with head and colliders held in their first pose, so that hair comes to rest.");
}

struct SolverParams {
  std::string precision = "float";
};
template <class V>
void fields(V& v, SolverParams& p) {
  v("precision", p.precision, one_of({"float", "double"}), "", "Numbers that the solver computes with.");
}

// One entry of groom.files. A plain string stands for {file = "..."}.
struct GroomFileParams {
  std::string file;
  std::string units;  // empty: groom.units
  std::string up;     // empty: groom.up
};
template <class V>
void fields(V& v, GroomFileParams& p) {
  v("file", p.file, any_text(), "path", "Required: a .hair, .tfx or .obj file.");
  v("units", p.units, any_text(), "", "Units of this file, in place of groom.units.");
  v("up", p.up, any_text(), "", "Up axis of this file, in place of groom.up.");
}

struct GroomParams {
  std::vector<GroomFileParams> files;  // read by hand: strings or tables
  std::string units = "m";
  std::string up = "+Y";
  std::string space = "world";
  double scale = 1;
  Eigen::Vector3d rotate{0, 0, 0};
  Eigen::Vector3d translate{0, 0, 0};
};
template <class V>
void fields(V& v, GroomParams& p) {
  v("files", p.files, "Required: the groom's files, in this order; texts, or tables with units and axes of their own.");
  v("units", p.units, any_text(), "",
    "Units of the files: \"m\", \"cm\", \"mm\", \"km\", \"in\", \"ft\", \"yd\" or metres per unit, \"0.01\".");
  v("up", p.up, any_text(), "", "Up axis of the files: \"+X\", \"-X\", \"+Y\", \"-Y\", \"+Z\" or \"-Z\".");
  v("space", p.space, one_of({"world", "head"}), "",
    "Where the groom was made: in the world at the rest frame, or in the head node's own axes (metres, node at the "
    "origin).");
  v("scale", p.scale, Range{0, 1e6, true}, "1", "Placement, done first: scales the groom about its origin.");
  v("rotate", p.rotate, any_number(), "degree", "Placement, done second: turns about x, then y, then z.");
  v("translate", p.translate, any_number(), "m", "Placement, done last: moves the groom.");
}

struct HeadParams {
  std::string animation;
  std::string clip;
  std::string node;
  std::string units;
  std::string up;
  std::optional<double> start;
  std::optional<double> rest_frame;
};
template <class V>
void fields(V& v, HeadParams& p) {
  v("animation", p.animation, any_text(), "path",
    "A glTF, GLB, FBX, BVH or Collada file. Without one the head stands still.");
  v("clip", p.clip, any_text(), "", "Name of the clip; may be left out where the file has only one.");
  v("node", p.node, any_text(), "", "Name or path of the node that carries the hair, \"Head\" or \"Neck/Head\".");
  v("units", p.units, any_text(), "",
    "Units of the file, as for groom.units; left out: what the file says, else metres.");
  v("up", p.up, any_text(), "", "Up axis of the file, as for groom.up; left out: what the file says, else +Y.");
  v("start", p.start, any_number(), "frame", "Frame at which the clip begins; left out: the first frame of the bake.");
  v("rest_frame", p.rest_frame, any_number(), "frame",
    "Frame at which the head stands as it did when the groom was made; left out: the first frame of the bake.");
}

struct BoxParams {
  Eigen::Vector3d min{-1e30, -1e30, -1e30};
  Eigen::Vector3d max{1e30, 1e30, 1e30};
};
template <class V>
void fields(V& v, BoxParams& p) {
  v("min", p.min, any_number(), "m", "Lower corner.");
  v("max", p.max, any_number(), "m", "Upper corner.");
}

// Which strands a region takes: those for which everything given holds. Nothing given: all that no other region takes.
struct StrandSelection {
  std::string file;
  std::string range;
  std::optional<BoxParams> box;
};
template <class V>
void fields(V& v, StrandSelection& p) {
  v("file", p.file, any_text(), "path", "Strands of this file, written as in groom.files.");
  v("range", p.range, any_text(), "strand",
    "Strands by number, \"0-99, 200\"; counted within `file` where that is given, else over the whole groom.");
  v("box", p.box, "Strands whose root lies in this box of the world at the rest frame.");
}

struct SphereParams {
  Eigen::Vector3d center{0, 0, 0};
  double radius = 0.1;
};
template <class V>
void fields(V& v, SphereParams& p) {
  v("center", p.center, any_number().keyed(), "m", "Centre, in the axes that `space` names.");
  v("radius", p.radius, between(0, 1e9).keyed(), "m", "Radius.");
}

struct ColliderParams {
  SphereParams sphere;
  std::string node;
  std::string space = "world";
};
template <class V>
void fields(V& v, ColliderParams& p) {
  v("sphere", p.sphere, "Required: the sphere that hair cannot enter.");
  v("node", p.node, any_text(), "",
    "Node of the head's animation that the collider rides; left out: fixed in the world.");
  v("space", p.space, one_of({"world", "node", "groom"}), "",
    "Axes and units of the numbers: the world at the rest frame in metres, the node's own axes in metres, or those "
    "of the groom's files (groom.units, groom.up and its placement).");
}

struct CacheParams {
  double precision = 0;
  std::string compression = "deflate:1";
  bool velocity = false;
  bool stats = true;
};
template <class V>
void fields(V& v, CacheParams& p) {
  v("precision", p.precision, between(0, 1), "m",
    "Positions are rounded to multiples of the largest power of two that is not above this, which packs far better. "
    "0: not rounded.");
  v("compression", p.compression, any_text(), "", "\"none\", or \"deflate:N\" with N from 1, fast, to 12, small.");
  v("velocity", p.velocity, Switch{}, "", "Also write velocities.");
  v("stats", p.stats, Switch{}, "",
    "Also write the largest stretch, the residual, the deepest penetration and the number of substeps of each frame.");
}

struct RegionScene {
  std::string name;
  StrandSelection strands;
  std::string hair = "medium";
  Animated<RegionParams> params;
};
template <class V>
void fields(V& v, RegionScene& r) {
  v("name", r.name, any_text(), "", "Required: a name of its own, for messages, overrides and the cache.");
  v("strands", r.strands, "The strands that the region takes; left out: all that no other region takes.");
  v("hair", r.hair, one_of({"fine", "medium", "coarse", "wet"}), "",
    "Human hair, for a rod: a preset for what the scene leaves open of rod.young (4e9; wet 1.6e9), rod.radius (25e-6, "
    "35e-6, 45e-6; wet 40e-6) and rod.density (1300; wet 1280).");
  fields(v, r.params.base);
}

// Tables of parameters that move over time are declared like those that do not.
template <class V, class Params>
void fields(V& v, Animated<Params>& a) {
  fields(v, a.base);
}

// Something wrong in a scene. `what` says in one sentence what was found and what would do.
struct Fault {
  std::string place;  // "scene.toml:14:3", or "--set bake.fps=0" where an override is at fault
  std::string what;
};
using Faults = std::vector<Fault>;

struct Scene {
  std::filesystem::path path;
  std::string text;                                // as read
  std::vector<std::string> overrides;              // "key=value", as given
  std::vector<std::filesystem::path> search_path;  // folders for files that are not beside the scene

  BakeParams bake;
  int first_frame = 1, last_frame = 24;  // from bake.frames
  SolverParams solver;
  GroomParams groom;
  HeadParams head;
  Animated<ForceParams> forces;  // table [forces]
  Animated<WindParams> wind;
  std::vector<RegionScene> regions;  // at least one: without [[region]], one named "hair" that takes all
  std::vector<Animated<ColliderParams>> colliders;
  CacheParams cache;
  int deflate_level = 1;  // from cache.compression, 0 for "none"

  // "scene.toml:14:3" for a dotted path like "region[1].strands.file", or "--set groom.units=cm" where an override
  // wrote it; the closest table above it where that key is not written.
  std::string place(std::string_view dotted_path) const;
  // Every declared parameter and table that is written somewhere, by dotted path: line and column in the scene, or the
  // index of the override that it came from.
  std::map<std::string, std::pair<int, int>, std::less<>> positions;
  std::map<std::string, std::size_t, std::less<>> overridden;
};
template <class V>
void fields(V& v, Scene& s) {
  v("bake", s.bake, "What is simulated.");
  v("solver", s.solver, "How it is computed.");
  v("groom", s.groom, "The hair, and how it is placed in the world at the rest frame: scaled, turned, then moved.");
  v("head", s.head, "The animation of the head. Without this table the head stands still.");
  v("forces", s.forces, "What acts on all hair.");
  v("wind", s.wind, "The wind, the same everywhere but for its gusts.");
  v("region", s.regions,
    "A part of the strands with parameters of its own; one table for each. Without any, one region named \"hair\" "
    "takes every strand.");
  v("collider", s.colliders, "A thing that hair cannot enter; one table for each.");
  v("cache", s.cache, "The file that is written.");
}

// Reads a scene and appends everything that is wrong with it to `faults`, in the order in which it is written,
// overrides last: unknown keys (with the closest known one), wrong types, values out of range, frames backwards,
// colliders that ride a node without an animation; of faults of syntax the first alone. With faults, the scene returned
// is as good as it could be made. The files that it names are not opened. Throws InputError only if the scene itself
// cannot be read at all. An empty text stands for a parameter that is left out. An override is "bake.fps=30",
// "region.tail.damping=0.2" (by the region's name), "region[0].damping=0.2" or "collider[0].sphere.radius=0.1"; its
// value is TOML, or bare text where the parameter is a text.
Scene read_scene(const std::filesystem::path& path, const std::vector<std::string>& overrides,
                 const std::vector<std::filesystem::path>& search_path, Faults& faults);
// The same from text; `name` stands for the file in messages, relative files are looked up in the current folder.
Scene parse_scene(const std::string& text, const std::string& name, const std::vector<std::string>& overrides,
                  const std::vector<std::filesystem::path>& search_path, Faults& faults);

// A file that the scene names: beside the scene, else in the first folder of the search path that has it; empty if
// nowhere.
std::filesystem::path find_input(const Scene& scene, const std::string& name);

// "1-240" or "7" to first and last frame. Throws std::invalid_argument with a sentence that says what would do.
std::pair<int, int> parse_frames(std::string_view text);
// "0-99, 200" to sorted, disjoint ranges, both ends included. Throws std::invalid_argument.
std::vector<std::pair<std::size_t, std::size_t>> parse_ranges(std::string_view text);

// Every parameter in force as dotted path and TOML value, in the order of declaration, key-frame tables included and
// what is left out omitted: the provenance of a cache. Holds nothing of the machine; files are named as the scene does.
std::vector<std::pair<std::string, std::string>> list_parameters(const Scene& scene);

// A parameter as docs/SCENE.md lists it; what does not apply is empty.
struct ParameterDescription {
  std::string key;  // within its table, "local.stiffness"
  std::string type, unit;
  std::string value;  // the default, as TOML
  std::string range;
  bool is_keyed = false;
  std::string help;
};
struct TableDescription {
  std::string name;
  bool is_list = false;  // [[name]]
  std::string help;
  std::vector<ParameterDescription> parameters;
};
std::vector<TableDescription> describe_scene();

// docs/SCENE.md, and a commented scene with every parameter at its default.
std::string scene_reference();
std::string default_scene();

}  // namespace strandbake
