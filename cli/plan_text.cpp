#include "cli/plan_text.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>
#include <vector>

#include "cli/console.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

std::string rod(const RegionPlan& plan, const RegionParams& p) {
  if (!plan.rod) return "skipped, method = \"shape\"";
  return fmt::format("runs, {} iteration{}, {}", p.rod.iterations, p.rod.iterations == 1 ? "" : "s",
                     p.rod.exact_lengths ? "lengths are exact" : "hair stretches as Young's modulus has it");
}

std::string local_shape(const RegionPlan& plan, const RegionParams& p) {
  if (plan.rod) return "skipped, method = \"rod\"";
  if (plan.local_shape) return fmt::format("runs, method {}, {} iterations", p.local.method, p.local.iterations);
  return p.local.iterations == 0 ? "skipped, iterations = 0" : "skipped, stiffness = 0 in every frame";
}

std::string global_shape(const RegionPlan& plan, const RegionParams& p) {
  if (plan.global_shape) return fmt::format("runs on {:.0f} % of each strand from the root", 100 * p.global.range);
  return p.global.range == 0 ? "skipped, range = 0" : "skipped, stiffness = 0 in every frame";
}

std::string edge_lengths(const RegionPlan& plan, const RegionParams& p) {
  if (plan.rod) return "skipped, method = \"rod\"";
  if (plan.direct_lengths) return "runs, directly";
  return plan.edge_lengths ? fmt::format("runs, {} iterations", p.lengths.iterations) : "skipped, iterations = 0";
}

std::string wind(const RegionPlan& plan, const RegionParams& p) {
  if (plan.wind) return "runs";
  return p.drag == 0 ? "skipped, drag = 0" : "skipped, there is no wind in any frame";
}

std::string substeps(const Shot& shot, int last_frame) {
  const BakeParams& bake = shot.scene.bake;
  if (bake.substeps) return fmt::format("{} substeps each", *bake.substeps);
  const Shot::Substeps count = shot.count_substeps(last_frame);
  return fmt::format("{}{} substeps each, {} in all (auto, tolerance {} m)",
                     count.least < count.most ? fmt::format("{} to ", count.least) : "", count.most, count.total,
                     bake.tolerance);
}

// Strands and vertices of each region.
std::vector<std::pair<std::size_t, std::size_t>> count_regions(const Shot& shot) {
  std::vector<std::pair<std::size_t, std::size_t>> counts(shot.scene.regions.size());
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
    auto& [strands, vertices] = counts[shot.groom.region[s]];
    ++strands;
    vertices += shot.groom.vertex_count(s);
  }
  return counts;
}

struct Sizes {
  double solver, frame, disk;  // [bytes]
};
Sizes sizes(const Shot& shot, std::pair<int, int> written, const SolverOptions& solver) {
  const auto frames = static_cast<double>(written.second) - written.first + 1;
  const int arrays = shot.scene.cache.velocity ? 2 : 1;
  const double frame = 12.0 * arrays * static_cast<double>(shot.groom.vertex_count());
  return {static_cast<double>(openmp_state_bytes(shot.groom, shot.plan, solver)), 2 * frame, frames * frame};
}

int frames_before(const Shot& shot, std::pair<int, int> written) {
  return written.first - shot.scene.first_frame + shot.scene.bake.preroll;
}

}  // namespace

std::string describe_plan(const Shot& shot, std::pair<int, int> written, const Backend& backend, int threads) {
  const Scene& scene = shot.scene;
  const std::vector<RegionParams> params = shot.regions(scene.first_frame);
  std::string text;
  const auto line = [&](std::string_view what, const std::string& value) {
    text += fmt::format("  {:<14} {}\n", what, value);
  };

  text += "groom\n";
  line("strands", fmt::format("{}", shot.groom.strand_count()));
  line("vertices", fmt::format("{}", shot.groom.vertex_count()));
  text += "head\n";
  line("motion", shot.animation.nodes.empty()
                     ? "skipped, there is no animation: the head stands still"
                     : fmt::format("node \"{}\" of {}, clip \"{}\", {:.3g} s", scene.head.node, scene.head.animation,
                                   shot.animation.clip, shot.animation.duration));
  line("collisions",
       scene.colliders.empty()
           ? "skipped, there are no colliders"
           : fmt::format("runs, {} sphere{}{}", scene.colliders.size(), scene.colliders.size() == 1 ? "" : "s",
                         backend.device ? "" : ", each where strands are in its reach"));

  const auto counts = count_regions(shot);
  for (std::size_t r = 0; r < scene.regions.size(); ++r) {
    text += fmt::format("region \"{}\"\n", scene.regions[r].name);
    line("strands", fmt::format("{} with {} vertices", counts[r].first, counts[r].second));
    if (!shot.plan.regions[r].simulated) {
      line("all passes", "skipped, simulate = false: hair rides on the head");
      continue;
    }
    line("wind", wind(shot.plan.regions[r], params[r]));
    line("global shape", global_shape(shot.plan.regions[r], params[r]));
    line("rod", rod(shot.plan.regions[r], params[r]));
    line("local shape", local_shape(shot.plan.regions[r], params[r]));
    line("edge lengths", edge_lengths(shot.plan.regions[r], params[r]));
    if (backend.device) {
      const Mapping mapping = mapping_of(shot.plan.regions[r], backend.opencl.mapping, shot.groom.strand_count());
      line("mapping", mapping == Mapping::Strands ? "a strand per work-item" : "a vertex per work-item");
    }
  }
  text += "bake\n";
  const int before = frames_before(shot, written);
  line("frames", fmt::format("{} to {}, {} a second, {}{}", written.first, written.second, scene.bake.fps,
                             substeps(shot, written.second),
                             before > 0 ? fmt::format(", after {} that are simulated but not written", before) : ""));
  SolverOptions solver;
  solver.precision = precision_of(scene);
  solver.threads = threads;
  line("solver", describe_backend(backend, solver));
  if (!backend.device) line("at rest", "strands are skipped while nothing about them changes");
  line("velocity", scene.cache.velocity ? "written" : "skipped, cache.velocity = false");
  line("stats", scene.cache.stats ? "written" : "skipped, cache.stats = false");
  const Sizes bytes = sizes(shot, written, solver);
  line("memory", fmt::format("about {}: solver {}, frame {}", human_bytes(bytes.solver + bytes.frame),
                             human_bytes(bytes.solver), human_bytes(bytes.frame)));
  line("disk", fmt::format("{}{}", scene.deflate_level == 0 ? "" : "less than about ", human_bytes(bytes.disk)));
  return text;
}

nlohmann::ordered_json plan_json(const Shot& shot, std::pair<int, int> written, const Backend& backend, int threads) {
  using Json = nlohmann::ordered_json;
  const Scene& scene = shot.scene;
  const std::vector<RegionParams> params = shot.regions(scene.first_frame);
  const auto counts = count_regions(shot);
  Json regions = Json::array();
  for (std::size_t r = 0; r < scene.regions.size(); ++r) {
    const RegionPlan& plan = shot.plan.regions[r];
    Json passes = Json::array();
    const auto add = [&](const char* name, bool runs, const std::string& how) {
      passes.push_back({{"pass", name}, {"runs", runs}, {"how", how}});
    };
    if (plan.simulated) {
      add("wind", plan.wind, wind(plan, params[r]));
      add("global shape", plan.global_shape, global_shape(plan, params[r]));
      add("rod", plan.rod, rod(plan, params[r]));
      add("local shape", plan.local_shape, local_shape(plan, params[r]));
      add("edge lengths", plan.direct_lengths || plan.edge_lengths, edge_lengths(plan, params[r]));
    }
    regions.push_back({{"name", scene.regions[r].name},
                       {"strands", counts[r].first},
                       {"vertices", counts[r].second},
                       {"simulated", plan.simulated},
                       {"passes", passes}});
  }
  SolverOptions solver;
  solver.precision = precision_of(scene);
  solver.threads = threads;
  const Sizes bytes = sizes(shot, written, solver);
  const Shot::Substeps substeps = shot.count_substeps(written.second);
  return {{"strands", shot.groom.strand_count()},
          {"vertices", shot.groom.vertex_count()},
          {"head_moves", !shot.animation.nodes.empty()},
          {"spheres", scene.colliders.size()},
          {"regions", regions},
          {"first_frame", written.first},
          {"last_frame", written.second},
          {"frames_before", frames_before(shot, written)},
          {"fps", scene.bake.fps},
          {"substeps", {{"least", substeps.least}, {"most", substeps.most}, {"total", substeps.total}}},
          {"solver", describe_backend(backend, solver)},
          {"threads", threads},
          {"velocity", scene.cache.velocity},
          {"stats", scene.cache.stats},
          {"memory_bytes", bytes.solver + bytes.frame},
          {"disk_bytes", bytes.disk}};
}

}  // namespace strandbake
