#include <fmt/format.h>
#include <omp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>
#include <vector>

#include "cli/checks.h"
#include "cli/console.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/cache.h"
#include "formats/cache_compare.h"
#include "formats/cache_digest.h"
#include "formats/scene.h"

namespace strandbake {
namespace {

struct CompareVerbOptions {
  std::filesystem::path golden, cache;
  double tolerance = 0;
  std::string frames;
  std::vector<std::string> regions;
  int threads = 0;
  bool table = false;
  bool json = false;
};

void print_line(std::string_view what, const std::string& value) {
  fmt::print("{:<14} {}\n", what, value);
}

// Errors over frames on a logarithmic scale, a column for one frame or several.
void print_plot(const std::vector<FrameDistances>& frames, double tolerance) {
  constexpr std::size_t kColumns = 64;
  constexpr int kRows = 8;
  const std::size_t columns = std::min(kColumns, frames.size());
  std::vector<double> column(columns, 0);
  for (std::size_t f = 0; f < frames.size(); ++f) {
    double& most = column[f * columns / frames.size()];
    most = std::max(most, frames[f].largest);
  }
  const double top = *std::ranges::max_element(column);
  double bottom = top / 10;
  for (const double value : column)
    if (value > 0) bottom = std::min(bottom, value);
  bottom = std::max(bottom, top * 1e-8);
  const auto row_of = [&](double value) {
    return std::clamp(static_cast<int>(std::floor(kRows * std::log(value / bottom) / std::log(top / bottom))), 0,
                      kRows - 1);
  };
  const int limit = tolerance >= bottom && tolerance < top ? row_of(tolerance) : -1;
  fmt::print("\nlargest distance [m]{}\n", limit < 0 ? "" : fmt::format(", --- the tolerance of {}", tolerance));
  for (int row = kRows - 1; row >= 0; --row) {
    std::string label, line;
    if (row == kRows - 1) label = fmt::format("{:.1e}", top);
    if (row == 0) label = fmt::format("{:.1e}", bottom);
    for (const double value : column) line += value > 0 && row_of(value) >= row ? '#' : row == limit ? '-' : ' ';
    fmt::print("{:>9} |{}\n", label, line.substr(0, line.find_last_not_of(' ') + 1));
  }
  const std::string first = fmt::format("{}", frames.front().frame), last = fmt::format("{}", frames.back().frame);
  fmt::print("{:>9} +{}\n", "", std::string(columns, '-'));
  if (first.size() + last.size() < columns) {
    fmt::print("{:>9}  {}{:>{}}\n", "frame", first, last, columns - first.size());
  } else {
    fmt::print("{:>9}  {} to {}\n", "frame", first, last);
  }
}

nlohmann::ordered_json distances_json(const Distances& distances) {
  return {{"largest", distances.largest},
          {"strand", distances.strand},
          {"vertex", distances.vertex},
          {"rms", distances.rms},
          {"percentile_99", distances.percentile_99},
          {"moved", distances.moved}};
}

// One sentence on what has failed.
int failed(const CompareVerbOptions& options, const std::vector<std::string>& differences) {
  std::string text;
  for (const std::string& difference : differences) text += (text.empty() ? "" : "; ") + difference;
  print_error(fmt::format("{} differs from {}: {}", options.cache.string(), options.golden.string(), text));
  return kInvalid;
}

CacheDigest digest_of(const std::filesystem::path& path, double step, const CompareOptions& options) {
  if (is_digest(path)) return read_digest(path);
  return digest_cache(CacheReader(path), path.string(), step, options.frames, options.threads);
}

// A digest in place of one cache or of both. Of frames that are not the same it knows little: whether they are nearer
// than its step, and how far the bounds have moved.
int run_compare_digests(const CompareVerbOptions& options, const CompareOptions& compare) {
  if (!options.regions.empty()) {
    print_error("--region is for caches; a digest knows no regions");
    return kUsage;
  }
  double step = 1;
  for (const std::filesystem::path& path : {options.cache, options.golden})
    if (is_digest(path)) step = read_digest(path).step;
  const CacheDigest golden = digest_of(options.golden, step, compare), cache = digest_of(options.cache, step, compare);
  const DigestComparison found = compare_digests(golden, cache, compare.frames);
  if (compare.frames && found.frames.empty() && found.mismatches.empty()) {
    throw InputError(fmt::format("{}: has no frame from {} to {}", options.golden.string(), compare.frames->first,
                                 compare.frames->second));
  }
  const FrameAgreement* worst = nullptr;
  std::size_t beyond = 0, same = 0;
  for (const FrameAgreement& frame : found.frames) {
    if (frame.at_most == 0) ++same;
    if (frame.at_most && *frame.at_most <= options.tolerance) continue;
    ++beyond;
    if (worst == nullptr || frame.at_least > worst->at_least) worst = &frame;
  }
  const bool is_good = found.mismatches.empty() && beyond == 0;

  if (options.json) {
    nlohmann::ordered_json out = {
        {"golden", options.golden.string()}, {"cache", options.cache.string()},          {"good", is_good},
        {"tolerance", options.tolerance},    {"mismatches", found.mismatches},           {"step", golden.step},
        {"frames_beyond", beyond},           {"frames", nlohmann::ordered_json::array()}};
    for (const FrameAgreement& frame : found.frames) {
      out["frames"].push_back({{"frame", frame.frame}, {"at_least", frame.at_least}});
      out["frames"].back()["at_most"] = frame.at_most ? nlohmann::ordered_json(*frame.at_most) : nullptr;
    }
    print_json("compare", out);
  } else {
    for (const std::string& mismatch : found.mismatches) print_line("differs", mismatch);
    if (!found.frames.empty()) {
      print_line("frames", fmt::format("{} to {}, {} in all", found.frames.front().frame, found.frames.back().frame,
                                       found.frames.size()));
      print_line("positions", same == found.frames.size()
                                  ? "the same"
                                  : fmt::format("the same in {} of {} frames", same, found.frames.size()));
    }
    if (options.table) {
      fmt::print("\n{:>7} {:>12} {:>12}\n", "frame", "at least [m]", "at most [m]");
      for (const FrameAgreement& frame : found.frames) {
        fmt::print("{:>7} {:>12.3g} {:>12}\n", frame.frame, frame.at_least,
                   frame.at_most ? fmt::format("{:.3g}", *frame.at_most) : "unknown");
      }
    }
  }
  if (is_good) return kGood;
  std::vector<std::string> differences;
  if (!found.mismatches.empty()) differences.push_back(found.mismatches.front());
  if (worst != nullptr && worst->at_most) {
    differences.push_back(fmt::format("frame {} agrees to {:.3g} m, which --tolerance {:.3g} takes", worst->frame,
                                      *worst->at_most, *worst->at_most * 1.01));
  } else if (worst != nullptr) {
    differences.push_back(fmt::format("frame {} is off{}; compare with the cache itself to see where", worst->frame,
                                      worst->at_least > 0 ? fmt::format(" by {:.3g} m or more", worst->at_least) : ""));
  }
  return failed(options, differences);
}

int run_compare(const CompareVerbOptions& options) {
  CompareOptions compare;
  if (!options.frames.empty()) compare.frames = parse_frames(options.frames);
  compare.regions = options.regions;
  compare.threads = options.threads > 0 ? options.threads : omp_get_max_threads();
  if (is_digest(options.golden) || is_digest(options.cache)) return run_compare_digests(options, compare);
  const CacheReader golden(options.golden), cache(options.cache);
  const Comparison found = compare_caches(golden, options.golden.string(), cache, options.cache.string(), compare);
  const auto is_beyond = [&](const Distances& distances) { return distances.largest > options.tolerance; };
  const auto beyond = static_cast<std::size_t>(std::ranges::count_if(found.frames, is_beyond));
  const bool rest_differs = found.rest && is_beyond(*found.rest);
  const bool is_good = found.mismatches.empty() && beyond == 0 && !rest_differs;
  const std::string region =
      found.frames.empty() ? "" : golden.header().region_names[golden.header().region[found.all.strand]];

  if (options.json) {
    nlohmann::ordered_json out = {
        {"golden", options.golden.string()}, {"cache", options.cache.string()}, {"good", is_good},
        {"tolerance", options.tolerance},    {"mismatches", found.mismatches},  {"vertices", found.vertices}};
    if (found.rest) out["rest"] = distances_json(*found.rest);
    if (!found.frames.empty()) {
      out["all"] = {{"frame", found.all.frame}, {"region", region}};
      out["all"].update(distances_json(found.all));
    }
    out["frames_beyond"] = beyond;
    out["frames"] = nlohmann::ordered_json::array();
    for (const FrameDistances& frame : found.frames) {
      out["frames"].push_back({{"frame", frame.frame}});
      out["frames"].back().update(distances_json(frame));
    }
    print_json("compare", out);
  } else {
    for (const std::string& mismatch : found.mismatches) print_line("differs", mismatch);
    if (found.rest && found.rest->moved > 0) {
      print_line("at rest", fmt::format("{:.3g} m at most, strand {}, vertex {}", found.rest->largest,
                                        found.rest->strand, found.rest->vertex));
    }
    if (!found.frames.empty()) {
      print_line("frames", fmt::format("{} to {}, {} in all, {} vertices each", found.frames.front().frame,
                                       found.frames.back().frame, found.frames.size(), found.vertices));
    }
    if (!found.frames.empty() && found.all.moved == 0) {
      print_line("positions", "the same");
    } else if (!found.frames.empty()) {
      print_line("largest", fmt::format("{:.3g} m: frame {}, strand {} (\"{}\"), vertex {}", found.all.largest,
                                        found.all.frame, found.all.strand, region, found.all.vertex));
      print_line("rms", fmt::format("{:.3g} m", found.all.rms));
      print_line("99 %", fmt::format("{:.3g} m or less", found.all.percentile_99));
      print_line("beyond", fmt::format("{} of {} frames are more than {} m apart", beyond, found.frames.size(),
                                       options.tolerance));
      if (options.table) {
        fmt::print("\n{:>7} {:>11} {:>9} {:>7} {:>11} {:>11} {:>9}\n", "frame", "largest [m]", "strand", "vertex",
                   "rms [m]", "99 % [m]", "moved");
        for (const FrameDistances& frame : found.frames) {
          fmt::print("{:>7} {:>11.3g} {:>9} {:>7} {:>11.3g} {:>11.3g} {:>9}\n", frame.frame, frame.largest,
                     frame.strand, frame.vertex, frame.rms, frame.percentile_99, frame.moved);
        }
      }
      print_plot(found.frames, options.tolerance);
    }
  }
  if (is_good) return kGood;
  std::vector<std::string> differences;
  if (!found.mismatches.empty()) differences.push_back(found.mismatches.front());
  if (rest_differs) differences.push_back(fmt::format("at rest it is up to {:.3g} m off", found.rest->largest));
  if (beyond > 0)
    differences.push_back(fmt::format("frame {} is up to {:.3g} m off", found.all.frame, found.all.largest));
  return failed(options, differences);
}

}  // namespace

Verb add_compare(CLI::App& app) {
  auto options = std::make_shared<CompareVerbOptions>();
  app.add_option("golden", options->golden, "The cache that is right, or its digest")->type_name("FILE")->required();
  app.add_option("cache", options->cache, "The cache, the .part of one, or a digest, that is compared with it")
      ->type_name("FILE")
      ->required();
  app.add_option("--tolerance", options->tolerance,
                 "How far a vertex may be from where it should be, in metres, e.g. 1e-5; left out: not at all")
      ->type_name("METRES")
      ->check(number_between(0, 1e9));
  app.add_option("--frames", options->frames, "Compare these frames only, e.g. 100-120")
      ->type_name("A-B")
      ->check(check_frames);
  app.add_option("--region", options->regions, "Compare this region only; may be given more than once")
      ->type_name("NAME")
      ->take_all()
      ->expected(1);
  app.add_option("--threads", options->threads, "Threads; left out: all cores. The result does not depend on it")
      ->check(CLI::Range(1, 4096));
  app.add_flag("--table", options->table, "A line for each frame");
  app.add_flag("--json", options->json, "As one JSON object, with a list of frames");
  return [options] { return run_compare(*options); };
}

}  // namespace strandbake
