#include <fmt/format.h>
#include <omp.h>

#include <CLI/CLI.hpp>
#include <array>
#include <cerrno>
#include <cmath>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <system_error>

#include "cli/checks.h"
#include "cli/console.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/cache.h"
#include "formats/cache_digest.h"
#include "formats/scene.h"

namespace strandbake {
namespace {

struct DigestOptions {
  std::filesystem::path cache, output;
  double step = 1e-4;
  std::string frames;
  int threads = 0;
  bool force = false;
  bool json = false;
};

nlohmann::ordered_json digest_json(const DigestOptions& options, const CacheDigest& digest) {
  nlohmann::ordered_json out = {{"cache", options.cache.string()}};
  if (!options.output.empty()) out["output"] = options.output.string();
  out.update({{"step", digest.step},
              {"fps", digest.fps},
              {"strands", digest.strands},
              {"vertices", digest.vertices},
              {"topology", digest.topology},
              {"rest", digest.rest},
              {"frames", nlohmann::ordered_json::array()}});
  const auto point = [](const Eigen::Vector3f& p) { return std::array{p.x(), p.y(), p.z()}; };
  for (const FrameDigest& frame : digest.frames) {
    out["frames"].push_back({{"frame", frame.frame},
                             {"low", point(frame.low)},
                             {"high", point(frame.high)},
                             {"rounded", frame.rounded},
                             {"exact", frame.exact}});
  }
  return out;
}

int run_digest(const DigestOptions& options) {
  // Pipes and devices are written to as they are.
  if (!options.output.empty() && !std::filesystem::is_other(options.output))
    require_free(options.output, options.force, options.cache);
  const CacheReader cache(options.cache);
  std::optional<std::pair<int, int>> frames;
  if (!options.frames.empty()) frames = parse_frames(options.frames);
  const int threads = options.threads > 0 ? options.threads : omp_get_max_threads();
  const CacheDigest digest = digest_cache(cache, options.cache.string(), options.step, frames, threads);
  if (frames && digest.frames.empty())
    throw InputError(fmt::format("{}: has no frame among {}", options.cache.string(), options.frames));
  const std::string text = digest_text(digest);
  if (!options.output.empty()) {
    std::ofstream file(options.output, std::ios::binary);
    file << text;
    file.close();
    if (!file) {
      throw DiskError(
          fmt::format("{}: cannot be written: {}", options.output.string(), std::generic_category().message(errno)));
    }
  }
  if (options.json) {
    print_json("digest", digest_json(options, digest));
  } else if (options.output.empty()) {
    fmt::print("{}", text);
  } else {
    fmt::print("{}: {} frame{}, {}\n", options.output.string(), digest.frames.size(),
               digest.frames.size() == 1 ? "" : "s", human_bytes(static_cast<double>(text.size())));
  }
  return kGood;
}

}  // namespace

Verb add_digest(CLI::App& app) {
  auto options = std::make_shared<DigestOptions>();
  app.add_option("cache", options->cache, "A cache, or the .part of one")->type_name("FILE")->required();
  app.add_option("-o,--output", options->output, "The digest; left out: standard output")->type_name("FILE");
  app.add_option("--step", options->step,
                 "Rounded positions are multiples of the largest power of two that is not above this, in metres")
      ->type_name("METRES")
      ->check([](const std::string& text) {
        char* end = nullptr;
        const double step = std::strtod(text.c_str(), &end);
        return *end == '\0' && step >= 1e-30 && step <= 1e9 ? "" : "must be a length from 1e-30 to 1e9";
      })
      ->capture_default_str();
  app.add_option("--frames", options->frames, "These frames only, e.g. 100-120")->type_name("A-B")->check(check_frames);
  app.add_option("--threads", options->threads, "Threads; left out: all cores. The digest does not depend on it")
      ->check(CLI::Range(1, 4096));
  app.add_flag("--force", options->force, "Replace an existing file");
  app.add_flag("--json", options->json, "Print the digest as one JSON object");
  return [options] { return run_digest(*options); };
}

}  // namespace strandbake
