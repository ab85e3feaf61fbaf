// Run time against error: how far each setting is from the hair that its method would make of endless substeps.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>
#include <string>
#include <vector>

#include "cli/bench/benchmarks.h"
#include "cli/bench/method.h"
#include "cli/bench/timing.h"
#include "formats/procedural.h"
#include "formats/quality.h"
#include "samples/shots.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

using Eigen::Vector3d;
using Path = std::vector<std::vector<Vector3d>>;  // [frames][vertices]

constexpr double kFps = 60;

// ---- what moves ----

Eigen::Isometry3d turned(double angle, const Vector3d& axis, const Vector3d& place) {
  Eigen::Isometry3d head = Eigen::Isometry3d::Identity();
  head.rotate(Eigen::AngleAxisd(angle, axis));
  head.pretranslate(place);
  return head;
}
// Looks around, once in four seconds.
Eigen::Isometry3d calm(double t) {
  return turned(0.3 * std::sin(0.5 * std::numbers::pi * t), Vector3d::UnitY(), Vector3d::Zero());
}
// Two steps a second: up and down twice, a nod and a sway.
Eigen::Isometry3d walking(double t) {
  const double step = 2 * std::numbers::pi * t;
  return turned(0.06 * std::sin(2 * step), Vector3d::UnitX(),
                {0.03 * std::sin(step), 0.025 * (std::cos(2 * step) - 1), 1.4 * t});
}
// No, no, no: sixty degrees to each side, twice a second.
Eigen::Isometry3d shaking(double t) {
  const double turn = 4 * std::numbers::pi * t;
  return turned(std::numbers::pi / 3 * std::sin(turn), Vector3d::UnitY(), Vector3d::Zero());
}
using Motion = Eigen::Isometry3d (*)(double time);
constexpr Motion kMotions[] = {calm, walking, shaking};

struct Scene {
  Groom groom;
  Motion motion;
  bool spheres = false;
};
struct Group {
  std::string name;
  std::vector<Scene> scenes;
};

Group group_of(const char* name, const std::vector<std::string>& styles, int vertices, int strands, bool spheres) {
  Group group{name, {}};
  for (const std::string& style : styles) {
    ProceduralParams hair = style_defaults(style);
    hair.strands = strands;
    hair.vertices = vertices;
    hair.length_variation = 0.1;
    for (const Motion motion : kMotions) group.scenes.push_back({make_groom(hair), motion, spheres});
  }
  return group;
}

// ---- how it is solved ----

struct Setting {
  int method;
  LengthParams lengths;
  int substeps;
  Precision precision = Precision::Float;
  int local_iterations = 3;
  bool reaction = true;

  bool is_rod() const { return method == samples::kRod; }
  // Other iterations make other hair, but of the rod.
  bool has_own_iterations() const {
    return local_iterations == (is_rod() ? RodParams().iterations : LocalShapeParams().iterations);
  }
  std::string lengths_name() const {
    if (is_rod()) return "rod";
    return lengths.direct ? "direct" : fmt::format("{} it.", lengths.iterations);
  }
};

RegionParams params_of(const Setting& setting) {
  RegionParams params;
  params.damping = 0.12;
  params.drag = 0;
  params.local = {0.3, setting.local_iterations, 1, setting.reaction};
  samples::set_method(params, setting.method);
  params.rod.iterations = setting.local_iterations;
  params.global = {0.05, 0.3, 1};
  params.lengths = setting.lengths;
  return params;
}

struct Ran {
  Path path;
  double seconds = 0;
};

Ran run(const Scene& scene, const Setting& setting, int frames, int threads) {
  const RegionParams params = params_of(setting);
  Plan plan;
  plan.regions = {plan_region(std::span(&params, 1), false)};
  plan.colliders = scene.spheres;
  const auto solver =
      make_openmp_solver(scene.groom, plan, scene.motion(0), {.precision = setting.precision, .threads = threads});
  Ran ran;
  for (int frame = 0; frame < frames; ++frame) {
    FrameInput input;
    input.substep = 1 / (kFps * setting.substeps);
    input.gravity = {0, -9.81, 0};
    input.regions = {params};
    for (int s = 1; s <= setting.substeps; ++s) {
      input.head.push_back(scene.motion((frame + static_cast<double>(s) / setting.substeps) / kFps));
      if (scene.spheres) input.spheres.push_back({{input.head.back() * Vector3d::Zero(), 0.98 * head_radius}});
    }
    const auto start = Clock::now();
    solver->advance(input);
    ran.seconds += seconds_since(start);
    ran.path.emplace_back(scene.groom.vertex_count());
    solver->read(ran.path.back());
  }
  return ran;
}

struct Distance {
  double square_sum = 0, largest = 0;
  std::size_t count = 0;

  void add(const Path& a, const Path& b) {
    for (std::size_t frame = 0; frame < a.size(); ++frame) {
      for (std::size_t v = 0; v < a[frame].size(); ++v) {
        const double square = (a[frame][v] - b[frame][v]).squaredNorm();
        square_sum += square;
        // Not std::max: that would lose a NaN.
        if (!(std::sqrt(square) <= largest)) largest = std::sqrt(square);
      }
      count += a[frame].size();
    }
  }
  double rms() const { return std::sqrt(square_sum / static_cast<double>(count)); }
};

double largest_stretch_of(const Groom& groom, const Path& path) {
  double largest = 0;
  for (const std::vector<Vector3d>& now : path) {
    for (std::size_t s = 0; s < groom.strand_count(); ++s) {
      for (std::size_t v = groom.offset[s] + 2; v < groom.offset[s + 1]; ++v) {
        const double rest = (groom.position[v] - groom.position[v - 1]).norm();
        largest = std::max(largest, std::abs((now[v] - now[v - 1]).norm() / rest - 1));
      }
    }
  }
  return largest;
}

struct Result {
  Setting setting;
  Distance own, to_method_1;
  double stretch = 0, seconds = 0;
};

std::vector<Setting> settings_of(int method, bool quick) {
  std::vector<Setting> settings;
  const std::vector<int> direct = quick ? std::vector{1, 4} : std::vector{1, 2, 4, 8, 16, 32};
  const std::vector<int> iterated = quick ? std::vector{1} : std::vector{1, 2, 4, 8};
  if (method == samples::kRod) {
    for (const int substeps : direct) settings.push_back({method, {}, substeps, Precision::Float, 1});
    for (const int substeps : quick ? std::vector{1} : std::vector{1, 8})
      settings.push_back({method, {}, substeps, Precision::Double, 1});
    for (const int substeps : quick ? std::vector{1} : std::vector{1, 4})
      settings.push_back({method, {}, substeps, Precision::Float, 3});
    return settings;
  }
  for (const int substeps : direct) settings.push_back({method, {}, substeps});
  // The paper's constraints: methods 1 and 2 without a reaction.
  for (const int iterations : quick ? std::vector{2} : std::vector{2, 8, 32}) {
    for (const int substeps : iterated) {
      settings.push_back({method, LengthParams::iterated(iterations), substeps, Precision::Float, 3, false});
    }
  }
  for (const int substeps : quick ? std::vector{1} : std::vector{1, 8}) {
    settings.push_back({method, {}, substeps, Precision::Double});
  }
  if (!quick) {
    for (const int iterations : {1, 8}) settings.push_back({method, {}, 4, Precision::Float, iterations});
  }
  if (method == 3) return settings;
  for (const int substeps : quick ? std::vector{1} : std::vector{1, 4, 32}) {
    settings.push_back({method, {}, substeps, Precision::Float, 3, false});
  }
  return settings;
}

// The name of bake.quality that stands for it, or nothing.
std::string preset_of(const Setting& s) {
  if (!s.lengths.direct || s.precision != Precision::Float || !s.has_own_iterations() || !s.reaction) return "";
  for (const Quality& quality : kQualities) {
    if (quality.substeps == s.substeps && quality.local_method == s.method) return quality.name;
  }
  return "";
}

bool is_papers(const Setting& s) {
  return s.method <= 3 && s.substeps == 1 && !s.lengths.direct && s.lengths.iterations == 2;
}

// Those that nothing else beats in both, from the fastest on.
std::vector<std::pair<double, double>> front_of(std::vector<std::pair<double, double>> points) {
  std::sort(points.begin(), points.end());
  std::vector<std::pair<double, double>> front;
  for (const auto& point : points) {
    if (front.empty() || point.second < front.back().second) front.push_back(point);
  }
  return front;
}

}  // namespace

Report bench_error(const BenchOptions& options) {
  const int strands = std::max(1, static_cast<int>(std::lround(24 * options.share)));
  const int frames = options.quick ? 20 : 90;
  const int finest = options.quick ? 32 : 256;
  const int repeats = options.quick ? 1 : 3;
  std::vector<Group> groups;
  if (!options.quick) groups.push_back(group_of("11 vertices", {"straight", "wavy", "curly"}, 11, strands, false));
  groups.push_back(group_of("32 vertices", {"straight", "wavy", "curly"}, 32, strands, false));
  if (!options.quick) {
    groups.push_back(group_of("64 vertices", {"straight", "wavy", "curly"}, 64, strands, false));
    groups.push_back(group_of("ponytail, a sphere", {"ponytail"}, 32, strands, true));
  }

  Report report;
  report.benchmark = "error";
  report.what = fmt::format(
      "run time against error: {} strands of 0.25 m a scene, straight, wavy and curly, on a head that looks around, "
      "walks and shakes; {} frames at 60/s; the error is the distance to the same method in double with direct lengths "
      "and {} substeps a frame",
      strands, frames, finest);
  report.table.columns = {{"group", "group"},
                          {"method", "method"},
                          {"lengths", "lengths"},
                          {"local_iterations", "local it."},
                          {"reaction", "reaction"},
                          {"precision", "precision"},
                          {"substeps", "substeps"},
                          {"rms_mm", "rms [mm]"},
                          {"largest_mm", "largest [mm]"},
                          {"rms_to_method_1_mm", "to method 1 [mm]"},
                          {"stretch_percent", "stretch [%]"},
                          {"ns_per_vertex_and_frame", "ns/vertex"},
                          {"mark", ""}};
  report.figure.title = "Run time against error";
  report.figure.note = "a line is a method and how it holds lengths, at 1, 2, 4, ... substeps a frame; one thread";
  for (const Group& group : groups) {
    std::vector<Result> results;
    std::size_t vertices = 0;
    std::vector<std::vector<Path>> reference(samples::kRod);  // [methods][scenes]
    for (int method = 1; method <= samples::kRod; ++method) {
      Distance coarse, fine;
      std::vector<Result> of_method;
      for (const Setting& setting : settings_of(method, options.quick)) of_method.push_back({setting, {}, {}});
      for (std::size_t k = 0; k < group.scenes.size(); ++k) {
        const Scene& scene = group.scenes[k];
        const auto converging = [&](int substeps) {
          const int iterations = method == samples::kRod ? RodParams().iterations : LocalShapeParams().iterations;
          return run(scene, {method, {}, substeps, Precision::Double, iterations}, frames, options.threads).path;
        };
        const Path eighth = converging(finest / 8), half = converging(finest / 2);
        auto& own = reference[static_cast<std::size_t>(method - 1)];
        own.push_back(converging(finest));
        coarse.add(converging(finest / 16), eighth);
        fine.add(half, own[k]);
        if (method == 1) vertices += scene.groom.vertex_count();
        for (Result& result : of_method) {
          std::vector<double> seconds;
          for (int repeat = 0; repeat < repeats; ++repeat) {
            const Ran ran = run(scene, result.setting, frames, 1);
            seconds.push_back(ran.seconds);
            if (repeat > 0) continue;
            result.own.add(ran.path, own[k]);
            result.to_method_1.add(ran.path, reference[0][k]);
            result.stretch = std::max(result.stretch, largest_stretch_of(scene.groom, ran.path));
          }
          result.seconds += timing_of(seconds).median;
        }
      }
      const double order = std::log2(coarse.rms() / fine.rms()) / 3;
      report.notes.push_back(fmt::format("{}, {}: from {} to {} substeps {:.3g} mm, from {} to {} {:.3g} mm: {}.",
                                         group.name, name_of(method), finest / 16, finest / 8, 1e3 * coarse.rms(),
                                         finest / 2, finest, 1e3 * fine.rms(),
                                         order < 0.1 ? "DOES NOT CONVERGE" : fmt::format("order {:.1f}", order)));
      results.insert(results.end(), of_method.begin(), of_method.end());
    }

    const auto cost = [&](const Result& r) { return 1e9 * r.seconds / (static_cast<double>(vertices) * frames); };
    std::vector<std::pair<double, double>> points;
    for (const Result& r : results) {
      if (r.setting.has_own_iterations() || r.setting.is_rod()) points.emplace_back(cost(r), 1e3 * r.own.rms());
    }
    const auto front = front_of(points);
    Panel panel;
    panel.title = group.name;
    panel.x = {"nanoseconds a vertex and frame", true};
    panel.y = {"rms distance to the converged hair [mm]", true};
    panel.series = {{"front", front}, {"paper", {}}};
    std::map<std::string, Series> lines;
    for (const Result& r : results) {
      const Setting& s = r.setting;
      const std::pair<double, double> point{cost(r), 1e3 * r.own.rms()};
      const bool on_front =
          (s.has_own_iterations() || s.is_rod()) && std::find(front.begin(), front.end(), point) != front.end();
      std::string mark = is_papers(s) ? "the paper's" : on_front ? "front" : "";
      if (const std::string preset = preset_of(s); !preset.empty()) mark += (mark.empty() ? "" : ", ") + preset;
      report.table.add({{"group", group.name},
                        {"method", method_cell(s.method)},
                        {"lengths", s.lengths_name()},
                        {"local_iterations", static_cast<double>(s.local_iterations)},
                        {"reaction", s.method == 3 || s.is_rod() ? ""
                                     : s.reaction                ? "yes"
                                                                 : "no"},
                        {"precision", s.precision == Precision::Float ? "float" : "double"},
                        {"substeps", static_cast<double>(s.substeps)},
                        {"rms_mm", point.second},
                        {"largest_mm", 1e3 * r.own.largest},
                        {"rms_to_method_1_mm", 1e3 * r.to_method_1.rms()},
                        {"stretch_percent", 100 * r.stretch},
                        {"ns_per_vertex_and_frame", point.first},
                        {"mark", mark}});
      if (is_papers(s)) panel.series[1].points.push_back(point);
      if (s.precision != Precision::Float || !s.has_own_iterations()) continue;
      if (s.lengths.direct && !s.reaction) continue;
      if (!s.lengths.direct && (s.lengths.iterations != 2 || s.method > 1)) continue;
      const std::string name = s.is_rod() ? "rod" : fmt::format("{} {}", s.method, s.lengths_name());
      lines[name].name = name;
      lines[name].points.push_back(point);
    }
    for (auto& [name, line] : lines) panel.series.push_back(std::move(line));
    report.figure.panels.push_back(std::move(panel));
  }
  report.notes.push_back(
      "The distance goes to the method's own converged hair with 3 local iterations; \"to method 1\": to that of "
      "method 1. Other local iterations make other hair, and lie off the front for that reason. Where lengths are "
      "iterated the local shape is the paper's, without a reaction. draft, normal and fine: bake.quality. Of the rod: "
      "Newton iterations, which make the same hair.");
  report.notes.push_back("stretch: of the worst segment in any frame. Times: one thread, median of runs.");
  return report;
}

}  // namespace strandbake
