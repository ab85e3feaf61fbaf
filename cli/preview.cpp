#include <fmt/format.h>
#include <omp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cctype>
#include <charconv>
#include <chrono>
#include <cmath>
#include <csignal>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <utility>
#include <vector>

#include "cli/checks.h"
#include "cli/console.h"
#include "cli/draw/camera.h"
#include "cli/draw/clip.h"
#include "cli/draw/png.h"
#include "cli/draw/shape.h"
#include "cli/draw/sheet.h"
#include "cli/draw/strands.h"
#include "cli/frame_values.h"
#include "cli/frames.h"
#include "cli/schemas.h"
#include "cli/solids.h"
#include "cli/verbs.h"
#include "formats/cache.h"
#include "formats/scene.h"

namespace strandbake {
namespace {

struct PreviewOptions {
  std::filesystem::path cache;
  std::filesystem::path output;
  std::string color = "region";
  std::filesystem::path against;
  double scale = 0;  // 0: from the frames
  std::string frames;
  std::optional<int> count;
  int every = 1;
  std::string size;
  View view;
  std::string from, look_at;
  bool follow = false;
  bool hair_only = false;
  bool force = false;
  bool json = false;
};

Coloring coloring_of(const std::string& name) {
  if (name == "stretch") return Coloring::Stretch;
  if (name == "speed") return Coloring::Speed;
  return name == "error" ? Coloring::Error : Coloring::Region;
}

enum class Kind { Sheet, Gif, Mp4 };

Kind kind_of(const std::filesystem::path& output) {
  std::string extension = output.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  if (extension == ".png") return Kind::Sheet;
  if (extension == ".gif") return Kind::Gif;
  if (extension == ".mp4") return Kind::Mp4;
  throw std::invalid_argument("\"" + output.string() +
                              "\" is neither a .png, for a contact sheet, nor a .gif or .mp4, for a clip");
}

// Numbers with one of `between` between them; none where the text is anything else.
template <class T, std::size_t N>
std::optional<std::array<T, N>> parse_numbers(std::string_view text, char between) {
  std::array<T, N> numbers{};
  const char* at = text.data();
  const char* const end = at + text.size();
  for (std::size_t k = 0; k < N; ++k) {
    if (k > 0 && (at == end || *at++ != between)) return std::nullopt;
    const auto [stop, error] = std::from_chars(at, end, numbers[k]);
    if (error != std::errc{}) return std::nullopt;
    at = stop;
  }
  if (at != end) return std::nullopt;
  return numbers;
}

std::array<int, 2> parse_size(const std::string& text) {
  const auto size = parse_numbers<int, 2>(text, 'x');
  if (!size || *std::ranges::min_element(*size) < 32 || *std::ranges::max_element(*size) > 8192)
    throw std::invalid_argument("\"" + text + "\" is no size; write WIDTHxHEIGHT, each from 32 to 8192 pixels");
  return *size;
}

Eigen::Vector3f parse_place(const std::string& text) {
  const auto place = parse_numbers<float, 3>(text, ',');
  const auto is_far = [](float v) { return !(std::abs(v) <= farthest); };
  if (!place || std::ranges::any_of(*place, is_far))
    throw std::invalid_argument("\"" + text + "\" is no place; write X,Y,Z in metres");
  return {(*place)[0], (*place)[1], (*place)[2]};
}

// For a check of CLI11's: what a parser has to say.
template <class Parse>
auto checked_by(Parse parse) {
  return [parse](const std::string& text) -> std::string {
    try {
      parse(text);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return {};
  };
}

// Set by SIGINT and SIGTERM, read between frames. A second signal ends the program at once.
volatile std::sig_atomic_t stop_requested = 0;
void request_stop(int signal) {
  stop_requested = 1;
  std::signal(signal, SIG_DFL);
}
struct Interrupted {};

// `count` of them, the first and the last among them.
std::vector<std::size_t> spread(const std::vector<std::size_t>& frames, std::size_t count) {
  if (count >= frames.size()) return frames;
  std::vector<std::size_t> some;
  for (std::size_t k = 0; k < count; ++k)
    some.push_back(frames[count == 1 ? 0 : (frames.size() - 1) * k / (count - 1)]);
  return some;
}

Eigen::Vector3f middle_of(const Eigen::AlignedBox3f& box) {
  return box.isEmpty() ? Eigen::Vector3f(0, 0, 0) : Eigen::Vector3f(box.min() / 2 + box.max() / 2);
}

// The frames of a cache as they are drawn.
class ShotPictures {
 public:
  ShotPictures(const CacheReader& cache, const PreviewOptions& options)
      : cache_(cache),
        header_(cache.header()),
        name_(options.cache.string()),
        follows_(options.follow),
        middle_(middle_of(robust_bounds(cache.header().rest_position)).cast<double>()),
        coloring_(coloring_of(options.color)),
        values_(cache, coloring_, options.against),
        is_measured_(coloring_ != Coloring::Region),
        scale_(options.scale),
        position_(cache.vertex_count()) {
    draw_.threads = omp_get_max_threads();
    draw_.strand_width = natural_width(header_.rest_position, header_.offset);
    if (!options.hair_only) solids_.emplace(cache);
  }

  double seconds_a_frame() const { return seconds_ / std::max(drawn_, 1); }
  const DrawOptions& draw_options() const { return draw_; }

  // Looks at all frames: what the camera should see, and how large values become.
  void scan(const std::vector<std::size_t>& frames, Framing& framing) {
    double most = 0, largest = 0;
    std::vector<float> values;
    bool has_warned = false;
    for (const std::size_t frame : frames) {
      if (stop_requested) throw Interrupted();
      read(frame);
      frame_strands(view(), shift(frame), framing);
      if (const std::size_t lost = count_lost(); lost > 0 && !std::exchange(has_warned, true)) {
        print_warning(fmt::format(
            "{}: frame {}: {} strand{} not drawn: there are vertices that are not finite, or over 1000 km away", name_,
            cache_.frame_number(frame), lost, lost == 1 ? " is" : "s are"));
      }
      if (!is_measured_) continue;
      values = value_;
      std::erase_if(values, [](float v) { return !std::isfinite(v); });
      if (values.empty()) continue;
      const auto place = values.begin() + static_cast<std::ptrdiff_t>(99 * (values.size() - 1) / 100);
      std::nth_element(values.begin(), place, values.end());
      most = std::max<double>(most, *place);
      largest = std::max<double>(largest, *std::max_element(place, values.end()));
    }
    largest_ = largest;
    // A few vertices far beyond the others would leave those without colours.
    if (scale_ == 0) scale_ = round_up_scale(most > 0 ? most : largest);
  }

  Legend legend() const {
    Legend legend;
    if (is_measured_) {
      legend.title = values_.name();
      legend.low = "0";
      legend.high = values_.text(scale_) + (largest_ > scale_ ? " and more" : "");
    } else if (header_.region_names.size() > 1) {
      for (std::uint32_t r = 0; r < header_.region_names.size(); ++r)
        legend.entries.emplace_back(header_.region_names[r], region_color(r));
    }
    return legend;
  }

  Image draw(std::size_t frame, const Camera& camera) {
    if (stop_requested) throw Interrupted();
    const auto start = std::chrono::steady_clock::now();
    read(frame);
    for (float& value : value_) value = static_cast<float>(value / scale_);
    Image image = draw_strands(view(), camera.moved(shift(frame)), draw_);
    seconds_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    ++drawn_;
    return image;
  }

 private:
  void read(std::size_t frame) {
    cache_.read_position(frame, position_);
    if (is_measured_) values_.read(frame, position_, value_);
    if (solids_) shapes_ = solids_->at(frame);
  }

  StrandsView view() const { return {position_, header_.offset, header_.region, shapes_, value_}; }

  // How far the picture has moved with the head.
  Eigen::Vector3f shift(std::size_t frame) const {
    if (!follows_) return Eigen::Vector3f::Zero();
    const Eigen::Vector3f at = (cache_.head(frame) * middle_ - middle_).cast<float>();
    if (!at.allFinite())
      throw InputError(
          fmt::format("{}: frame {}: the head is nowhere; leave --follow out", name_, cache_.frame_number(frame)));
    return at;
  }

  std::size_t count_lost() const {
    std::size_t lost = 0;
    for (std::size_t s = 0; s + 1 < header_.offset.size(); ++s) {
      const auto strand = std::span(position_).subspan(header_.offset[s], header_.offset[s + 1] - header_.offset[s]);
      lost += !std::ranges::all_of(
          strand, [](const Eigen::Vector3f& p) { return p.allFinite() && p.cwiseAbs().maxCoeff() <= farthest; });
    }
    return lost;
  }

  const CacheReader& cache_;
  const CacheHeader& header_;
  std::string name_;
  bool follows_;
  Eigen::Vector3d middle_;  // of the groom at rest
  Coloring coloring_;
  FrameValues values_;
  bool is_measured_;
  double scale_, largest_ = 0;
  std::optional<Solids> solids_;
  DrawOptions draw_;
  std::vector<Eigen::Vector3f> position_;
  std::vector<float> value_;
  std::vector<Shape> shapes_;
  double seconds_ = 0;
  int drawn_ = 0;
};

int run_preview(const PreviewOptions& options) {
  const Kind kind = kind_of(options.output);
  const char* const default_size = kind == Kind::Sheet ? "480x480" : kind == Kind::Gif ? "640x360" : "1280x720";
  const auto [width, height] = parse_size(options.size.empty() ? default_size : options.size);
  const auto misuse = [](const std::string& why) {
    print_error(why);
    return kUsage;
  };
  if (coloring_of(options.color) == Coloring::Error && options.against.empty())
    return misuse("--color error wants --against GOLDEN, the cache to compare with");
  if (kind != Kind::Sheet && options.count) return misuse("--count is for a sheet; --every thins a clip out");
  if (coloring_of(options.color) != Coloring::Error && !options.against.empty())
    return misuse("--against is for --color error");
  if (kind == Kind::Mp4 && (width % 2 != 0 || height % 2 != 0))
    return misuse(fmt::format("--size {}x{}: an MP4 has an even number of pixels on each side", width, height));
  require_free(options.output, options.force, options.cache);
  const CacheReader cache(options.cache);
  const CacheHeader& header = cache.header();
  // Programs show frames of a GIF for 1/50 s at least.
  const int every =
      kind == Kind::Gif ? std::max(options.every, static_cast<int>(std::ceil(header.fps / 50))) : options.every;
  std::vector<std::size_t> frames = choose_frames(cache, options.cache, options.frames, every);
  constexpr int kOnSheet = 8;
  if (kind == Kind::Sheet && (options.count || options.every == 1))
    frames = spread(frames, static_cast<std::size_t>(options.count.value_or(kOnSheet)));
  constexpr double kMostPixels = 1 << 26;
  if (kind == Kind::Sheet && static_cast<double>(frames.size()) * width * height > kMostPixels) {
    return misuse(
        fmt::format("{} pictures of {} x {} make a sheet of over {} pixels; take fewer (--count) or smaller ones "
                    "(--size)",
                    frames.size(), width, height, kMostPixels));
  }
  std::signal(SIGINT, request_stop);
  std::signal(SIGTERM, request_stop);

  ShotPictures shot(cache, options);
  Framing framing(options.view, width, height);
  shot.scan(frames, framing);
  const Camera framed(framing);
  std::optional<Camera> placed;
  if (!options.from.empty()) {
    const Eigen::Vector3f at = options.look_at.empty() ? framing.middle() : parse_place(options.look_at);
    placed.emplace(parse_place(options.from), at, options.view.fov_deg, width, height);
  }
  const Camera& camera = placed ? *placed : framed;

  if (kind == Kind::Sheet) {
    std::vector<SheetTile> tiles;
    for (const std::size_t frame : frames) tiles.push_back({shot.draw(frame, camera), cache.frame_number(frame)});
    SheetOptions sheet;
    sheet.title = fmt::format("{}   {} strands   {} vertices   {} fps", options.cache.filename().string(),
                              header.offset.size() - 1, cache.vertex_count(), header.fps);
    sheet.legend = shot.legend();
    write_png(make_contact_sheet(tiles, sheet), options.output);
  } else {
    const int threads = shot.draw_options().threads;
    const Legend legend = shot.legend();
    const auto picture = [&](std::size_t frame) {
      Image image = shot.draw(frame, camera);
      annotate(image, cache.frame_number(frame), legend);
      return to_rgb8(image, threads);
    };
    const double fps = header.fps / every;
    std::unique_ptr<ClipWriter> clip;
    if (kind == Kind::Mp4) {
      clip = make_mp4(options.output, width, height, fps);
    } else {
      // One palette for the whole clip, from frames all over it.
      constexpr std::size_t kSamples = 5;
      std::vector<std::uint8_t> sample;
      for (const std::size_t frame : spread(frames, kSamples)) {
        const std::vector<std::uint8_t> rgb = picture(frame);
        sample.insert(sample.end(), rgb.begin(), rgb.end());
      }
      clip = make_gif(options.output, width, height, fps, sample);
    }
    Progress progress(Progress::choose(false), frames.size(), "frame");
    for (std::size_t k = 0; k < frames.size(); ++k) {
      clip->add(picture(frames[k]));
      progress.update(k + 1, options.output.string());
    }
    clip->finish();
  }
  if (options.json) {
    nlohmann::ordered_json numbers = nlohmann::ordered_json::array();
    for (const std::size_t frame : frames) numbers.push_back(cache.frame_number(frame));
    print_json("preview", {{"output", options.output.string()}, {"frames", numbers}});
    return kGood;
  }
  fmt::print("{}: {} frame{} of {} x {}, drawn in {:.2f} s each\n", options.output.string(), frames.size(),
             frames.size() == 1 ? "" : "s", width, height, shot.seconds_a_frame());
  return kGood;
}

}  // namespace

Verb add_preview(CLI::App& app) {
  auto options = std::make_shared<PreviewOptions>();
  app.add_option("cache", options->cache, "A cache, or the .part of one")->type_name("FILE")->required();
  app.add_option("-o,--output", options->output, "A contact sheet (.png) or a clip (.gif; .mp4, which takes ffmpeg)")
      ->type_name("FILE")
      ->check(checked_by([](const std::string& text) { kind_of(text); }))
      ->required();
  app.add_option("--color", options->color, "What strands are coloured by")
      ->type_name("WHAT")
      ->check(CLI::IsMember({"region", "stretch", "speed", "error"}))
      ->capture_default_str();
  app.add_option("--against", options->against, "The golden cache that --color error measures the distance to")
      ->type_name("FILE");
  app.add_option(
         "--scale", options->scale,
         "The value with the last colour, in m, m/s or as a share of the length; left out: that of nearly all vertices")
      ->type_name("VALUE")
      ->check(number_between(1e-9, 1e9));
  app.add_option("--frames", options->frames, "Choose among these frames only, e.g. 100-120")
      ->type_name("A-B")
      ->check(check_frames);
  app.add_option("--every", options->every, "Take every Nth frame")->type_name("N")->check(CLI::Range(1, 1000000));
  app.add_option("--count", options->count,
                 "How many frames to draw, spread evenly; left out: 8 on a sheet, all in a clip")
      ->type_name("N")
      ->check(CLI::Range(1, 1000000));
  app.add_option(
         "--size", options->size,
         "Size of a frame's picture in pixels; left out: 480x480 on a sheet, 640x360 in a .gif, 1280x720 in an .mp4")
      ->type_name("WxH")
      ->check(checked_by(parse_size));
  CLI::Option* const azimuth = app.add_option("--azimuth", options->view.azimuth_deg,
                                              "Where the camera stands, in degrees about +Y; 0 is in front (+Z)")
                                   ->check(number_between(-360, 360))
                                   ->capture_default_str();
  CLI::Option* const elevation =
      app.add_option("--elevation", options->view.elevation_deg, "Height of the camera above the horizon, in degrees")
          ->check(number_between(-89, 89))
          ->capture_default_str();
  app.add_option("--fov", options->view.fov_deg, "Vertical opening of the camera, in degrees")
      ->check(number_between(1, 120))
      ->capture_default_str();
  CLI::Option* const from =
      app.add_option("--from", options->from,
                     "Where the camera stands, in metres; left out: where it has all frames in its picture")
          ->type_name("X,Y,Z")
          ->check(checked_by(parse_place))
          ->excludes(azimuth)
          ->excludes(elevation);
  app.add_option("--look-at", options->look_at, "What it looks at, in metres; left out: the middle of the hair")
      ->type_name("X,Y,Z")
      ->check(checked_by(parse_place))
      ->needs(from);
  app.add_flag("--follow", options->follow, "The camera goes where the head goes");
  app.add_flag("--hair-only", options->hair_only,
               "Without colliders, and without the stand-in for a head that is none of them");
  app.add_flag("--force", options->force, "Replace an existing file");
  app.add_flag("--json", options->json, "Say what was drawn as one JSON object");
  return [options] {
    try {
      return run_preview(*options);
    } catch (const Interrupted&) {
      print_error("interrupted; nothing was written");
      return static_cast<int>(kInterrupted);
    }
  };
}

}  // namespace strandbake
