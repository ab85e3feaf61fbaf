#include <fmt/format.h>
#include <omp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "cli/console.h"
#include "cli/draw/camera.h"
#include "cli/draw/png.h"
#include "cli/draw/shape.h"
#include "cli/draw/sheet.h"
#include "cli/draw/strands.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/cache.h"
#include "formats/scene.h"

namespace strandbake {
namespace {

struct PreviewOptions {
  std::filesystem::path cache;
  std::filesystem::path output;
  std::string frames;
  int count = 8;
  int tile = 480;
  View view;
  bool no_head = false;
  bool force = false;
  bool json = false;
};

// `count` frames spread evenly, the first and the last among them.
std::vector<std::size_t> choose_frames(const CacheReader& cache, const PreviewOptions& options) {
  std::size_t first = 0, last = cache.frame_count() - 1;
  if (!options.frames.empty()) {
    const auto [low, high] = parse_frames(options.frames);
    while (first < last && cache.frame_number(first) < low) ++first;
    while (last > first && cache.frame_number(last) > high) --last;
    if (cache.frame_number(first) < low || cache.frame_number(last) > high) {
      throw InputError(fmt::format("{}: has no frame among {}", options.cache.string(), options.frames));
    }
  }
  const auto count = std::min<std::size_t>(static_cast<std::size_t>(options.count), last - first + 1);
  std::vector<std::size_t> chosen;
  for (std::size_t k = 0; k < count; ++k)
    chosen.push_back(count == 1 ? first : first + (last - first) * k / (count - 1));
  return chosen;
}

int run_preview(const PreviewOptions& options) {
  if (std::filesystem::exists(options.output) && !options.force) {
    throw DiskError(
        fmt::format("{}: there is a file of this name already; --force replaces it", options.output.string()));
  }
  const CacheReader cache(options.cache);
  if (cache.frame_count() == 0) throw InputError(fmt::format("{}: holds no frame yet", options.cache.string()));
  const CacheHeader& header = cache.header();
  const std::vector<std::size_t> frames = choose_frames(cache, options);

  std::optional<Shape> head;
  if (!options.no_head) head = fit_head(header.rest_position, header.offset);
  DrawOptions draw;
  draw.threads = omp_get_max_threads();
  draw.strand_width = natural_width(header.rest_position, header.offset);

  std::vector<Eigen::Vector3f> position(cache.vertex_count());
  const auto draw_frame = [&](std::size_t frame, auto&& use) {
    cache.read_position(frame, position);
    std::vector<Shape> shapes;
    if (head) shapes.push_back(head->moved(cache.head(frame).cast<float>()));
    use(StrandsView{position, header.offset, header.region, shapes});
  };
  // One camera for the whole sheet, so that motion shows.
  Eigen::AlignedBox3f box;
  for (const std::size_t frame : frames) {
    draw_frame(frame, [&](const StrandsView& strands) { box.extend(frame_bounds(strands, options.view.axes())); });
  }
  const Camera camera(box, options.view, options.tile, options.tile);
  std::vector<SheetTile> tiles;
  for (const std::size_t frame : frames) {
    draw_frame(frame, [&](const StrandsView& strands) {
      tiles.push_back({draw_strands(strands, camera, draw), cache.frame_number(frame)});
    });
  }
  SheetOptions sheet;
  sheet.title = fmt::format("{}   {} strands   {} vertices   {} fps", options.cache.filename().string(),
                            header.offset.size() - 1, cache.vertex_count(), header.fps);
  write_png(make_contact_sheet(tiles, sheet), options.output);
  if (options.json) {
    nlohmann::ordered_json numbers = nlohmann::ordered_json::array();
    for (const std::size_t frame : frames) numbers.push_back(cache.frame_number(frame));
    print_json("preview", {{"output", options.output.string()}, {"frames", numbers}});
    return kGood;
  }
  fmt::print("{}: {} frame{}\n", options.output.string(), frames.size(), frames.size() == 1 ? "" : "s");
  return kGood;
}

}  // namespace

Verb add_preview(CLI::App& app) {
  auto options = std::make_shared<PreviewOptions>();
  app.add_option("cache", options->cache, "A cache, or the .part of one")->type_name("FILE")->required();
  app.add_option("-o,--output", options->output, "The picture (PNG)")->type_name("FILE")->required();
  app.add_option("--frames", options->frames, "Choose among these frames only, e.g. 100-120")
      ->type_name("A-B")
      ->check(check_frames);
  app.add_option("--count", options->count, "How many frames to draw")
      ->check(CLI::Range(1, 256))
      ->capture_default_str();
  app.add_option("--tile", options->tile, "Width and height of a frame's picture in pixels")
      ->check(CLI::Range(32, 4096))
      ->capture_default_str();
  app.add_option("--azimuth", options->view.azimuth_deg,
                 "Where the camera stands, in degrees about +Y; 0 is in front (+Z)")
      ->capture_default_str();
  app.add_option("--elevation", options->view.elevation_deg, "Height of the camera above the horizon, in degrees")
      ->check(CLI::Range(-89, 89))
      ->capture_default_str();
  app.add_flag("--no-head", options->no_head, "Without the stand-in for the head");
  app.add_flag("--force", options->force, "Replace an existing file");
  app.add_flag("--json", options->json, "Say what was drawn as one JSON object");
  return [options] { return run_preview(*options); };
}

}  // namespace strandbake
