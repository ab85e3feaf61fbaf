#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/console.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/cache.h"

namespace strandbake {
namespace {

// The largest figure of all frames and the first frame that has it.
template <class T>
struct Most {
  T value = -1;
  int frame = 0;
  void add(T other, int its_frame) {
    if (other > value) *this = {other, its_frame};
  }
};

int run_info(const std::filesystem::path& path, bool json) {
  const CacheReader cache(path);
  const CacheHeader& header = cache.header();
  Most<double> stretch, residual, penetration;
  Most<int> substeps;
  int least_substeps = std::numeric_limits<int>::max();
  std::int64_t all_substeps = 0;
  bool has_stats = false;
  for (std::size_t f = 0; f < cache.frame_count(); ++f) {
    const auto stats = cache.stats(f);
    if (!stats) break;
    has_stats = true;
    const int frame = cache.frame_number(f);
    stretch.add(stats->largest_stretch, frame);
    residual.add(stats->residual, frame);
    penetration.add(stats->deepest_penetration, frame);
    substeps.add(stats->substeps, frame);
    all_substeps += stats->substeps;
    if (stats->substeps > 0) least_substeps = std::min(least_substeps, stats->substeps);
  }
  least_substeps = std::min(least_substeps, substeps.value);  // where no frame was simulated
  std::vector<std::size_t> strands(header.region_names.size(), 0);
  for (const std::uint32_t region : header.region) ++strands[region];
  const std::size_t frames = cache.frame_count();
  const double plain = 12.0 * static_cast<double>(cache.vertex_count()) * static_cast<double>(frames);

  if (json) {
    nlohmann::ordered_json out = {{"file", path.string()},
                                  {"complete", cache.complete()},
                                  {"version", header.program_version},
                                  {"fps", header.fps},
                                  {"frames", frames},
                                  {"strands", header.offset.size() - 1},
                                  {"vertices", cache.vertex_count()},
                                  {"precision", cache.options().precision},
                                  {"deflate", cache.options().deflate},
                                  {"velocity", cache.has_velocity()},
                                  {"position_bytes", cache.stored_bytes()}};
    if (frames > 0) {
      out["first_frame"] = cache.frame_number(0);
      out["last_frame"] = cache.frame_number(frames - 1);
    }
    out["regions"] = nlohmann::ordered_json::array();
    for (std::size_t r = 0; r < strands.size(); ++r) {
      out["regions"].push_back({{"name", header.region_names[r]}, {"strands", strands[r]}});
    }
    out["inputs"] = nlohmann::ordered_json::array();
    for (const auto& [name, sha256] : header.inputs) out["inputs"].push_back({{"name", name}, {"sha256", sha256}});
    if (has_stats) {
      out["largest_stretch"] = {{"value", stretch.value}, {"frame", stretch.frame}};
      out["residual"] = {{"value", residual.value}, {"frame", residual.frame}};
      out["deepest_penetration"] = {{"value", penetration.value}, {"frame", penetration.frame}};
      out["substeps"] = {
          {"least", least_substeps}, {"most", substeps.value}, {"frame", substeps.frame}, {"total", all_substeps}};
    }
    print_json("info", out);
    return kGood;
  }

  const auto line = [](std::string_view what, const std::string& value) { fmt::print("{:<14} {}\n", what, value); };
  line("cache", path.string() + (cache.complete() ? "" : " (not finished)"));
  line("made by", "strandbake " + header.program_version);
  line("frames", frames == 0 ? "none"
                             : fmt::format("{} to {}, {} in all, {} a second", cache.frame_number(0),
                                           cache.frame_number(frames - 1), frames, header.fps));
  line("strands", fmt::format("{}", header.offset.size() - 1));
  line("vertices", fmt::format("{}", cache.vertex_count()));
  for (std::size_t r = 0; r < strands.size(); ++r)
    line("region", fmt::format("\"{}\", {} strands", header.region_names[r], strands[r]));
  line("positions",
       fmt::format("{}, {:.2f} : 1, {}{}", human_bytes(static_cast<double>(cache.stored_bytes())),
                   cache.stored_bytes() == 0 ? 1.0 : plain / static_cast<double>(cache.stored_bytes()),
                   cache.options().deflate == 0 ? "not compressed" : "deflate",
                   cache.options().precision > 0 ? fmt::format(", rounded to {} m", cache.options().precision) : ""));
  line("velocities", cache.has_velocity() ? "yes" : "no");
  if (has_stats) {
    line("stretch", fmt::format("{:.3g} % at most, in frame {}", 100 * stretch.value, stretch.frame));
    if (residual.value > 0)
      line("residual",
           fmt::format("{:.3g} % at most between pinned vertices, in frame {}", 100 * residual.value, residual.frame));
    line("penetration", penetration.value > 0
                            ? fmt::format("{:.3g} m at most, in frame {}", penetration.value, penetration.frame)
                            : "none");
    line("substeps", least_substeps == substeps.value
                         ? fmt::format("{} a frame, {} in all", substeps.value, all_substeps)
                         : fmt::format("{} to {} a frame, {} in all, most in frame {}", least_substeps, substeps.value,
                                       all_substeps, substeps.frame));
  }
  for (const auto& [name, sha256] : header.inputs) line("input", fmt::format("{}  {}", sha256, name));
  return kGood;
}

}  // namespace

Verb add_info(CLI::App& app) {
  auto path = std::make_shared<std::filesystem::path>();
  auto json = std::make_shared<bool>(false);
  app.add_option("cache", *path, "A cache, or the .part of one")->type_name("FILE")->required();
  app.add_flag("--json", *json, "As one JSON object");
  return [path, json] { return run_info(*path, *json); };
}

}  // namespace strandbake
