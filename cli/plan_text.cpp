#include "cli/plan_text.h"

#include <fmt/format.h>

#include "cli/console.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

std::string local_shape(const RegionPlan& plan, const RegionParams& p) {
  if (plan.local_shape) return fmt::format("runs, method {}, {} iterations", p.local.method, p.local.iterations);
  return p.local.iterations == 0 ? "skipped, iterations = 0" : "skipped, stiffness = 0 in every frame";
}

std::string global_shape(const RegionPlan& plan, const RegionParams& p) {
  if (plan.global_shape) return fmt::format("runs on {:.0f} % of each strand from the root", 100 * p.global.range);
  return p.global.range == 0 ? "skipped, range = 0" : "skipped, stiffness = 0 in every frame";
}

std::string edge_lengths(const RegionPlan& plan, const RegionParams& p) {
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

  for (std::size_t r = 0; r < scene.regions.size(); ++r) {
    std::size_t strands = 0, vertices = 0;
    for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
      if (shot.groom.region[s] != r) continue;
      ++strands;
      vertices += shot.groom.vertex_count(s);
    }
    text += fmt::format("region \"{}\"\n", scene.regions[r].name);
    line("strands", fmt::format("{} with {} vertices", strands, vertices));
    if (!shot.plan.regions[r].simulated) {
      line("all passes", "skipped, simulate = false: hair rides on the head");
      continue;
    }
    line("wind", wind(shot.plan.regions[r], params[r]));
    line("global shape", global_shape(shot.plan.regions[r], params[r]));
    line("local shape", local_shape(shot.plan.regions[r], params[r]));
    line("edge lengths", edge_lengths(shot.plan.regions[r], params[r]));
    if (backend.device) {
      const Mapping mapping = mapping_of(shot.plan.regions[r], backend.opencl.mapping, shot.groom.strand_count());
      line("mapping", mapping == Mapping::Strands ? "a strand per work-item" : "a vertex per work-item");
    }
  }
  const auto frames = static_cast<double>(written.second) - written.first + 1;
  const double frame_bytes = 12.0 * static_cast<double>(shot.groom.vertex_count());
  text += "bake\n";
  const int before = written.first - scene.first_frame + scene.bake.preroll;
  line("frames", fmt::format("{} to {}, {} a second, {}{}", written.first, written.second, scene.bake.fps,
                             substeps(shot, written.second),
                             before > 0 ? fmt::format(", after {} that are simulated but not written", before) : ""));
  SolverOptions solver;
  solver.precision = precision_of(scene);
  solver.threads = threads;
  line("solver", describe_backend(backend, solver));
  if (!backend.device) line("at rest", "strands are skipped while nothing about them changes");
  const int arrays = scene.cache.velocity ? 2 : 1;
  line("velocity", scene.cache.velocity ? "written" : "skipped, cache.velocity = false");
  line("stats", scene.cache.stats ? "written" : "skipped, cache.stats = false");
  const std::size_t state_bytes = openmp_state_bytes(shot.groom, shot.plan, solver);
  line("memory", fmt::format("about {}: solver {}, frame {}",
                             human_bytes(static_cast<double>(state_bytes) + 2 * arrays * frame_bytes),
                             human_bytes(static_cast<double>(state_bytes)), human_bytes(2 * arrays * frame_bytes)));
  line("disk", fmt::format("{}{}", scene.deflate_level == 0 ? "" : "less than about ",
                           human_bytes(frames * arrays * frame_bytes)));
  return text;
}

}  // namespace strandbake
