#include <fmt/format.h>
#include <libdeflate.h>
#include <nettle/base64.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <new>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "cli/checks.h"
#include "cli/console.h"
#include "cli/draw/camera.h"
#include "cli/draw/part_file.h"
#include "cli/draw/strands.h"
#include "cli/frames.h"
#include "cli/schemas.h"
#include "cli/solids.h"
#include "cli/verbs.h"
#include "cli/view/page.h"
#include "formats/cache.h"

namespace strandbake {
namespace {

struct ViewOptions {
  std::filesystem::path cache;
  std::filesystem::path output;
  std::string frames;
  int every = 1;
  std::uint64_t budget = 20'000'000;  // bytes of the page
  std::size_t strands = std::numeric_limits<std::size_t>::max();
  bool force = false;
  bool json = false;
};

// Moves what the head carries, or nothing where the cache does not hold a turn and a place.
Eigen::Isometry3d usable_head(const CacheReader& cache, std::size_t index) {
  const Eigen::Isometry3d head = cache.head(index);
  const Eigen::Matrix3d turn = head.linear();
  const bool is_rigid = head.matrix().allFinite() && (turn * turn.transpose()).isIdentity(1e-3) &&
                        head.translation().cwiseAbs().maxCoeff() <= farthest;
  return is_rigid ? head : Eigen::Isometry3d::Identity();
}

// All strands in an order of which any beginning is a fair choice: by chance, but one of each region first.
std::vector<std::size_t> shuffled_strands(const CacheHeader& header) {
  const auto chance = [](std::uint64_t strand) {  // splitmix64
    std::uint64_t h = strand + 0x9E3779B97F4A7C15;
    h = (h ^ h >> 30) * 0xBF58476D1CE4E5B9;
    h = (h ^ h >> 27) * 0x94D049BB133111EB;
    return h ^ h >> 31;
  };
  std::vector<std::size_t> order(header.region.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return chance(a) < chance(b); });
  std::vector<bool> seen(header.region_names.size(), false);
  std::stable_partition(order.begin(), order.end(), [&](std::size_t strand) {
    const bool is_first = !seen[header.region[strand]];
    seen[header.region[strand]] = true;
    return is_first;
  });
  return order;
}

// A shot on its way into a page: some strands, in the space of the head, where they move little and numbers need be
// small only.
class PageShot {
 public:
  PageShot(const CacheReader& cache, const ViewOptions& options)
      : cache_(cache),
        header_(cache.header()),
        name_(options.cache.filename().string()),
        fps_(header_.fps / options.every),
        frames_(choose_frames(cache, options.cache, options.frames, options.every)),
        order_(shuffled_strands(header_)) {
    for (const std::size_t frame : frames_) heads_.push_back(usable_head(cache, frame));
  }

  std::size_t frame_count() const { return frames_.size(); }
  std::vector<int> frame_numbers() const {
    std::vector<int> numbers;
    for (const std::size_t frame : frames_) numbers.push_back(cache_.frame_number(frame));
    return numbers;
  }
  // Of those that were read and are drawn.
  std::size_t strand_count() const { return strands_.size(); }
  // That were read and are not drawn.
  std::size_t lost_count() const { return lost_; }
  std::size_t whole_count() const { return order_.size(); }
  // Bytes of the positions of strands before they are packed.
  double plain_bytes(std::size_t strands) const {
    double vertices = 0;
    for (std::size_t k = 0; k < strands; ++k) vertices += static_cast<double>(size_of(order_[k]));
    return 6 * vertices * static_cast<double>(frames_.size());
  }

  // Takes the first strands of the order, but for those that are not finite or flew away in some frame.
  void read(std::size_t count) {
    std::vector<std::size_t> wanted(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(count));
    std::size_t vertices = 0;
    for (const std::size_t strand : wanted) vertices += size_of(strand);
    std::vector<Eigen::Vector3f> points(vertices * frames_.size());
    std::vector<Eigen::Vector3f> all(cache_.vertex_count());
    Eigen::AlignedBox3f box;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      cache_.read_position(frames_[f], all);
      const Eigen::Isometry3d back = heads_[f].inverse();
      const std::span<Eigen::Vector3f> now(&points[f * vertices], vertices);
      std::size_t to = 0;
      for (const std::size_t strand : wanted) {
        for (std::uint64_t v = header_.offset[strand]; v < header_.offset[strand + 1]; ++v)
          now[to++] = (back * all[v].cast<double>()).cast<float>();
      }
      box.extend(robust_bounds(now));
    }
    std::vector<bool> is_good(count, true);
    std::size_t at = 0;
    for (std::size_t k = 0; k < count; ++k) {
      for (std::size_t v = at; v < at + size_of(wanted[k]); ++v)
        for (std::size_t f = 0; f < frames_.size(); ++f)
          if (!box.contains(points[f * vertices + v])) is_good[k] = false;
      at += size_of(wanted[k]);
    }
    strands_.clear();
    first_.clear();
    at = 0;
    for (std::size_t k = 0; k < count; ++k) {
      if (is_good[k]) {
        strands_.push_back(wanted[k]);
        first_.push_back(at);
      }
      at += size_of(wanted[k]);
    }
    lost_ = count - strands_.size();
    points_ = std::move(points);
    vertices_ = vertices;
    box_ = box;
  }

  // The page with the first of the strands that were read.
  std::string page(std::size_t count) const {
    std::vector<std::size_t> taken(count);  // places in strands_, region by region
    std::iota(taken.begin(), taken.end(), std::size_t{0});
    std::sort(taken.begin(), taken.end(), [&](std::size_t a, std::size_t b) {
      const std::size_t s = strands_[a], t = strands_[b];
      return header_.region[s] != header_.region[t] ? header_.region[s] < header_.region[t] : s < t;
    });
    std::string text;
    for (std::string_view rest = view_page; !rest.empty();) {
      const std::size_t place = std::min(rest.find("@SHOT@"), rest.find("@POSITIONS@"));
      text += rest.substr(0, place);
      if (place >= rest.size()) break;
      const bool is_shot = rest[place + 1] == 'S';
      text += is_shot ? describe(taken) : pack(taken);
      rest.remove_prefix(place + (is_shot ? std::string_view("@SHOT@") : std::string_view("@POSITIONS@")).size());
    }
    return text;
  }

 private:
  std::size_t size_of(std::size_t strand) const {
    return static_cast<std::size_t>(header_.offset[strand + 1] - header_.offset[strand]);
  }

  // 14 bits along the longest side of the box, 0.06 mm of a metre: more is noise, which does not pack.
  float step() const {
    constexpr float kSteps = 16383;
    const float longest = box_.isEmpty() ? 0 : (box_.max() - box_.min()).maxCoeff();
    return longest > 0 ? longest / kSteps : 1;
  }

  // As page.html unpacks it, in base64.
  std::string pack(const std::vector<std::size_t>& taken) const {
    std::vector<std::size_t> vertex;
    for (const std::size_t k : taken)
      for (std::size_t v = 0; v < size_of(strands_[k]); ++v) vertex.push_back(first_[k] + v);
    const std::size_t count = vertex.size();
    std::vector<std::uint8_t> bytes(6 * count * frames_.size());
    const float per_step = 1 / step();
    const auto number = [&](std::size_t f, std::size_t v, int c) {
      const float steps = (points_[f * vertices_ + v][c] - box_.min()[c]) * per_step;
      return static_cast<std::int32_t>(std::lround(steps));
    };
    std::uint8_t* to = bytes.data();
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      for (int c = 0; c < 3; ++c, to += 2 * count) {
        std::int32_t before = 0;
        for (std::size_t v = 0; v < count; ++v) {
          const std::int32_t change = number(f, vertex[v], c) - (f == 0 ? 0 : number(f - 1, vertex[v], c));
          const std::int32_t more = change - std::exchange(before, change);
          const auto coded = static_cast<std::uint32_t>(more < 0 ? -2 * more - 1 : 2 * more);
          to[v] = static_cast<std::uint8_t>(coded);
          to[count + v] = static_cast<std::uint8_t>(coded >> 8);
        }
      }
    }
    constexpr int kLevel = 9;
    const std::unique_ptr<libdeflate_compressor, decltype(&libdeflate_free_compressor)> compressor(
        libdeflate_alloc_compressor(kLevel), libdeflate_free_compressor);
    if (compressor == nullptr) throw std::bad_alloc();
    std::vector<std::uint8_t> packed(libdeflate_zlib_compress_bound(compressor.get(), bytes.size()));
    packed.resize(libdeflate_zlib_compress(compressor.get(), bytes.data(), bytes.size(), packed.data(), packed.size()));
    std::string text(BASE64_ENCODE_RAW_LENGTH(packed.size()), '\0');
    base64_encode_raw(text.data(), packed.size(), packed.data());
    return text;
  }

  // What the page has to know, as JSON.
  std::string describe(const std::vector<std::size_t>& taken) const {
    using nlohmann::ordered_json;
    const auto list = [](const auto& vector) {
      ordered_json numbers = ordered_json::array();
      for (const auto& x : vector.reshaped()) numbers.push_back(x);
      return numbers;
    };
    std::vector<std::size_t> strands(header_.region_names.size(), 0);
    ordered_json counts = ordered_json::array();
    std::size_t vertices = 0;
    std::vector<Eigen::Vector3f> rest;
    std::vector<std::uint64_t> offset = {0};
    for (const std::size_t k : taken) {
      const std::size_t strand = strands_[k];
      ++strands[header_.region[strand]];
      counts.push_back(size_of(strand));
      vertices += size_of(strand);
      const auto begin = header_.rest_position.begin();
      rest.insert(rest.end(), begin + static_cast<std::ptrdiff_t>(header_.offset[strand]),
                  begin + static_cast<std::ptrdiff_t>(header_.offset[strand + 1]));
      offset.push_back(rest.size());
    }
    ordered_json regions = ordered_json::array();
    for (std::uint32_t r = 0; r < strands.size(); ++r) {
      regions.push_back({{"name", header_.region_names[r]}, {"color", list(region_color(r))}, {"strands", strands[r]}});
    }
    const Solids solids(cache_);
    const bool is_empty = box_.isEmpty();
    const Eigen::Vector3f low = is_empty ? Eigen::Vector3f::Zero().eval() : box_.min();
    const Eigen::Vector3f middle = is_empty ? low : Eigen::Vector3f(box_.min() / 2 + box_.max() / 2);
    ordered_json numbers = ordered_json::array(), heads = ordered_json::array(), spheres = ordered_json::array();
    Eigen::AlignedBox3d places;
    bool moves = false;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      numbers.push_back(cache_.frame_number(frames_[f]));
      heads.push_back(list(heads_[f].matrix()));
      places.extend(heads_[f] * middle.cast<double>());
      moves = moves || heads_[f].matrix() != heads_[0].matrix();
      ordered_json now = ordered_json::array();
      for (const Shape& shape : solids.at(frames_[f])) {
        const Eigen::Vector4f ball(shape.center.x(), shape.center.y(), shape.center.z(), shape.radius.x());
        if (ball.allFinite() && ball[3] > 0 && shape.center.cwiseAbs().maxCoeff() <= farthest)
          now.push_back(list(ball));
      }
      spheres.push_back(now);
    }
    const double size = is_empty ? 0.3 : std::max<double>(box_.diagonal().norm(), 1e-3);
    const ordered_json shot = {{"name", name_},
                               {"facts", fmt::format("{} of {} strands, {} frames, {:g} a second", taken.size(),
                                                     whole_count(), frames_.size(), fps_)},
                               {"fps", fps_},
                               {"numbers", numbers},
                               {"vertices", vertices},
                               {"counts", counts},
                               {"regions", regions},
                               {"low", list(low)},
                               {"step", step()},
                               {"middle", list(middle)},
                               {"size", size},
                               {"width", natural_width(rest, offset)},
                               {"heads", heads},
                               {"spheres", spheres},
                               {"moves", moves},
                               {"travels", places.diagonal().norm() > size}};
    // Names need not be UTF-8, but JSON must; and no name may end the script that it stands in.
    const std::string plain = shot.dump(-1, ' ', false, ordered_json::error_handler_t::replace);
    std::string safe;
    for (const char c : plain) {
      if (c == '<') {
        safe += "\\u003c";
      } else {
        safe += c;
      }
    }
    return safe;
  }

  const CacheReader& cache_;
  const CacheHeader& header_;
  std::string name_;
  double fps_;
  std::vector<std::size_t> frames_;
  std::vector<std::size_t> order_;
  std::vector<Eigen::Isometry3d> heads_;  // of each frame
  // What was read.
  std::vector<std::size_t> strands_;
  std::vector<std::size_t> first_;       // vertex of each of them in a frame of points_
  std::vector<Eigen::Vector3f> points_;  // [frames][vertices_], in the space of the head
  std::size_t vertices_ = 0;
  std::size_t lost_ = 0;
  Eigen::AlignedBox3f box_;
};

int run_view(const ViewOptions& options) {
  require_free(options.output, options.force, options.cache);
  const CacheReader cache(options.cache);
  PageShot shot(cache, options);
  const std::size_t most = std::min(options.strands, shot.whole_count());
  const auto budget = static_cast<double>(options.budget);

  // Some strands tell how well all will pack.
  constexpr std::size_t kSample = 256;
  std::size_t wanted = std::min(most, kSample);
  shot.read(wanted);
  std::string page = shot.page(shot.strand_count());
  if (wanted < most) {
    const double fixed = static_cast<double>(view_page.size());
    const double per_byte = (static_cast<double>(page.size()) - fixed) / std::max(shot.plain_bytes(wanted), 1.0);
    const auto fits = [&](std::size_t strands) {
      return fixed + per_byte * shot.plain_bytes(strands) <= 1.05 * budget;
    };
    std::size_t low = wanted, high = most;
    while (low < high) {
      const std::size_t middle = low + (high - low + 1) / 2;
      (fits(middle) ? low : high) = fits(middle) ? middle : middle - 1;
    }
    if (low > wanted) {
      wanted = low;
      shot.read(wanted);
      page = shot.page(shot.strand_count());
    }
  }
  std::size_t shown = shot.strand_count();
  if (shown == 0) {
    throw InputError(fmt::format("{}: no strand can be shown: all have vertices that are not finite or flew away",
                                 options.cache.string()));
  }
  while (static_cast<double>(page.size()) > budget && shown > 1) {
    const double share = 0.99 * budget / static_cast<double>(page.size());
    shown = std::clamp<std::size_t>(static_cast<std::size_t>(share * static_cast<double>(shown)), 1, shown - 1);
    page = shot.page(shown);
  }
  if (static_cast<double>(page.size()) > budget) {
    print_error(fmt::format(
        "--budget: the page takes {} with a single strand; give more, or take fewer frames (--frames, --every)",
        human_bytes(static_cast<double>(page.size()))));
    return kUsage;
  }
  if (shot.lost_count() > 0) {
    print_warning(fmt::format("{}: {} of {} strands left out, as they have vertices that are not finite or flew away",
                              options.cache.string(), shot.lost_count(), wanted));
  }
  PartFile file(options.output);
  file.write(page);
  file.finish();
  if (options.json) {
    print_json("view", {{"output", options.output.string()},
                        {"bytes", page.size()},
                        {"strands", shown},
                        {"all_strands", shot.whole_count()},
                        {"frames", shot.frame_numbers()}});
    return kGood;
  }
  fmt::print("{}: {} of {} strands, {} frame{}, {}\n", options.output.string(), shown, shot.whole_count(),
             shot.frame_count(), shot.frame_count() == 1 ? "" : "s", human_bytes(static_cast<double>(page.size())));
  return kGood;
}

}  // namespace

Verb add_view(CLI::App& app) {
  auto options = std::make_shared<ViewOptions>();
  app.add_option("cache", options->cache, "A cache, or the .part of one")->type_name("FILE")->required();
  app.add_option("-o,--output", options->output, "The page (.html); nothing else is needed to open it")
      ->type_name("FILE")
      ->check([](const std::string& name) {
        const std::string extension = std::filesystem::path(name).extension().string();
        return extension == ".html" || extension == ".htm" ? "" : fmt::format("\"{}\" is not a .html", name);
      })
      ->required();
  app.add_option("--budget", options->budget,
                 "How large the page may be; strands are left out by chance, and few are drawn thick")
      ->type_name("SIZE")
      ->transform(CLI::AsSizeValue(true))
      ->check(CLI::Range(std::uint64_t{1}, std::uint64_t{200'000'000}))
      ->default_str("20MB");
  app.add_option("--strands", options->strands, "Show so many strands at most")
      ->type_name("N")
      ->check(CLI::Range(std::size_t{1}, std::numeric_limits<std::size_t>::max()));
  app.add_option("--frames", options->frames, "Show these frames only, e.g. 100-120")
      ->type_name("A-B")
      ->check(check_frames);
  app.add_option("--every", options->every, "Take every Nth frame")->type_name("N")->check(CLI::Range(1, 1000000));
  app.add_flag("--force", options->force, "Replace an existing file");
  app.add_flag("--json", options->json, "Say what was written as one JSON object");
  return [options] { return run_view(*options); };
}

}  // namespace strandbake
