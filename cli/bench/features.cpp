// What each thing that a scene can ask for costs, and what it costs when it is off.
#include <fmt/format.h>

#include <map>

#include "cli/bench/benchmarks.h"
#include "cli/bench/child.h"
#include "cli/bench/head_motion.h"
#include "cli/bench/scratch.h"
#include "cli/bench/workload.h"
#include "formats/groom_file.h"
#include "formats/procedural.h"

namespace strandbake {
namespace {

enum class State { On, Off, Unmentioned };

// Lines of a scene for each state; they go into the table of that name, or stand for themselves where it has none. Off:
// mentioned but of no effect. Unmentioned: as short as the scene can be without it.
//
// A shortcut that the solver takes, such as colliders that no strand can reach, is a line here too: `on` is a scene
// where the work is asked for and can be left out, so "alone" shows what is left of it.
struct Feature {
  const char* name;
  const char* table;
  const char* on;
  const char* off;
  const char* unmentioned;
};

constexpr const char* kSpheres =
    "[[collider]]\nsphere = {center = [0, 0, 0], radius = 0.098}\n"
    "[[collider]]\nsphere = {center = [-0.15, -0.2, 0], radius = 0.098}\n"
    "[[collider]]\nsphere = {center = [0.15, -0.2, 0], radius = 0.098}\n"
    "[[collider]]\nsphere = {center = [0, -0.1, -0.05], radius = 0.06}\n"
    "[[collider]]\nsphere = {center = [0.06, -0.1, -0.02], radius = 0.04}\n"
    "[[collider]]\nsphere = {center = [-0.06, -0.1, -0.02], radius = 0.04}\n";
constexpr const char* kFarSpheres =
    "[[collider]]\nsphere = {center = [2, 0, 0], radius = 0.098}\n"
    "[[collider]]\nsphere = {center = [2, -0.2, 0], radius = 0.098}\n"
    "[[collider]]\nsphere = {center = [2, -0.2, 1], radius = 0.098}\n"
    "[[collider]]\nsphere = {center = [2, -0.1, -1], radius = 0.06}\n"
    "[[collider]]\nsphere = {center = [2, -0.1, -2], radius = 0.04}\n"
    "[[collider]]\nsphere = {center = [2, -0.1, 2], radius = 0.04}\n";

constexpr Feature kFeatures[] = {
    {"head that moves", "", "[head]\nanimation = \"head.bvh\"\nnode = \"Head\"\nunits = \"m\"\n", "", ""},
    {"wind with gusts", "", "[wind]\nvelocity = [2, 0, 1]\ngust = 0.5\n", "[wind]\nvelocity = [0, 0, 0]\ngust = 0.5\n",
     ""},
    {"global shape", "region", "global = {stiffness = 0.02, range = 0.5}\n", "global = {stiffness = 0, range = 0.5}\n",
     "global = {range = 0}\n"},
    {"local shape", "region", "local = {stiffness = 0.9, iterations = 3, method = 1}\n",
     "local = {stiffness = 0, iterations = 3, method = 1}\n", "local = {iterations = 0}\n"},
    {"direct lengths", "region", "lengths = \"direct\"\n", "lengths = {iterations = 0}\n",
     "lengths = {iterations = 0}\n"},
    {"6 spheres in the hair", "", kSpheres, "", ""},
    {"6 spheres out of reach", "", kFarSpheres, "", ""},
    {"velocity", "cache", "velocity = true\n", "velocity = false\n", ""},
    {"stats", "cache", "stats = true\n", "stats = false\n", "stats = false\n"},
    {"deflate:1", "cache", "compression = \"deflate:1\"\n", "compression = \"none\"\n", "compression = \"none\"\n"},
    {"rounding to 1e-5 m", "cache", "precision = 1e-5\n", "precision = 0\n", ""},
};
constexpr std::size_t kCount = std::size(kFeatures);

std::string scene_of(const std::vector<State>& states, int frames) {
  std::string alone, region = "[[region]]\nname = \"hair\"\n", cache = "[cache]\n";
  for (std::size_t f = 0; f < kCount; ++f) {
    const Feature& feature = kFeatures[f];
    const std::string table = feature.table;
    std::string& to = table == "region" ? region : table == "cache" ? cache : alone;
    to += states[f] == State::On ? feature.on : states[f] == State::Off ? feature.off : feature.unmentioned;
  }
  return fmt::format("[bake]\nframes = \"1-{}\"\nfps = 24\nsubsteps = 4\n[groom]\nfiles = [\"hair.hair\"]\n", frames) +
         alone + region + cache;
}

}  // namespace

Report bench_features(const BenchOptions& options) {
  ProceduralParams hair = style_defaults("wavy");
  hair.strands = options.quick ? 1000 : 5000;
  hair.vertices = 24;
  const Groom groom = thinned(make_groom(hair), options.share);
  const int frames = options.quick ? 12 : 48;
  const Scratch folder(options.folder);
  write_hair(folder / "hair.hair", groom);
  write_text_file(folder / "head.bvh", swaying_head_bvh(frames, 24));

  Report report;
  report.benchmark = "features";
  report.what = fmt::format("whole bakes: {} strands of {} vertices, {} frames of 4 substeps, {} threads",
                            groom.strand_count(), groom.vertex_count(0), frames, options.threads);
  report.table.columns = {{"feature", "feature"},
                          {"all_ms", "all on [ms]"},
                          {"without_ms", "all but this [ms]"},
                          {"on_top_ms", "on top of all [ms]"},
                          {"bare_ms", "bare scene [ms]"},
                          {"alone_ms", "this alone [ms]"},
                          {"cost_alone_ms", "alone [ms]"},
                          {"off_ms", "this off [ms]"},
                          {"cost_off_ms", "when off [ms]"}};

  // The same scene text is run once, however many rows need it.
  std::vector<Turn> turns;
  std::map<std::string, std::size_t> known;
  const auto add = [&](const std::vector<State>& states) {
    const std::string text = scene_of(states, frames);
    const auto [at, added] = known.emplace(text, turns.size());
    if (added) {
      const std::filesystem::path scene = folder / fmt::format("{}.toml", turns.size());
      write_text_file(scene, text);
      turns.push_back([&folder, &options, scene](std::vector<double>& samples) {
        samples.push_back(run_child({"bake", scene.string(), "-o", (folder / "out.h5").string(), "--force", "--quiet",
                                     "--threads", fmt::format("{}", options.threads)})
                              .seconds);
      });
    }
    return at->second;
  };
  const auto but = [](State others, std::size_t feature, State own) {
    std::vector<State> states(kCount, others);
    states[feature] = own;
    return states;
  };
  const std::size_t all = add(std::vector<State>(kCount, State::On));
  const std::size_t bare = add(std::vector<State>(kCount, State::Unmentioned));
  std::vector<std::size_t> without, alone, off;
  for (std::size_t f = 0; f < kCount; ++f) {
    without.push_back(add(but(State::On, f, State::Unmentioned)));
    alone.push_back(add(but(State::Unmentioned, f, State::On)));
    off.push_back(add(but(State::Unmentioned, f, State::Off)));
  }
  const std::vector<Timing> timings = take_turns(turns, options.quick ? Effort{3, 4, 1} : Effort{31, 120});

  const auto ms = [&](std::size_t run) { return 1e3 * timings[run].median; };
  Panel panel;
  panel.title = "Milliseconds that each thing adds to a bake";
  panel.x = {"milliseconds"};
  panel.series = {{"on top of all others", {}}, {"alone", {}}, {"when off", {}}};
  for (std::size_t f = 0; f < kCount; ++f) {
    const bool can_be_off = off[f] != bare;
    report.table.add({{"feature", kFeatures[f].name},
                      {"all_ms", ms(all)},
                      {"without_ms", ms(without[f])},
                      {"on_top_ms", ms(all) - ms(without[f])},
                      {"bare_ms", ms(bare)},
                      {"alone_ms", ms(alone[f])},
                      {"cost_alone_ms", ms(alone[f]) - ms(bare)},
                      {"off_ms", can_be_off ? Cell(ms(off[f])) : Cell()},
                      {"cost_off_ms", can_be_off ? Cell(ms(off[f]) - ms(bare)) : Cell()}});
    const auto index = static_cast<double>(f);
    panel.names.emplace_back(kFeatures[f].name);
    panel.series[0].points.emplace_back(index, ms(all) - ms(without[f]));
    panel.series[1].points.emplace_back(index, ms(alone[f]) - ms(bare));
    if (can_be_off) panel.series[2].points.emplace_back(index, ms(off[f]) - ms(bare));
  }
  report.figure = {
      "What each thing costs", fmt::format("all on: {:.0f} ms, bare scene: {:.0f} ms", ms(all), ms(bare)), {panel}};
  report.notes = {
      "on top of all: all on, less all but this. alone: this alone, less a bare scene with hair in free flight.",
      "when off: in the bare scene, mentioned but switched off, less the bare scene, which does not mention it; empty "
      "where off and not mentioned are the same text. Differences within the noise can be below zero."};
  return report;
}

}  // namespace strandbake
