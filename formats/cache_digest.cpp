#include "formats/cache_digest.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <map>
#include <span>
#include <sstream>
#include <string_view>
#include <type_traits>

#include "formats/digest.h"
#include "formats/frame_list.h"
#include "sim/parallel.h"

namespace strandbake {

namespace {

constexpr std::string_view kFirstLine = "strandbake digest ";
constexpr int kVersion = 1;
constexpr std::size_t kDigits = 32;

static_assert(std::endian::native == std::endian::little, "checksums are of little-endian numbers");

std::string checksum(Sha256& sum) {
  return sum.finish().substr(0, kDigits);
}

std::string checksum_topology(const CacheHeader& header) {
  Sha256 sum;
  sum.add(std::as_bytes(std::span(header.offset)));
  sum.add(std::as_bytes(std::span(header.region)));
  for (const std::string& name : header.region_names) sum.add(std::as_bytes(std::span(name.c_str(), name.size() + 1)));
  return checksum(sum);
}

FrameDigest digest_frame(const CacheReader& cache, const std::string& name, std::size_t index, double step) {
  FrameDigest digest;
  digest.frame = cache.frame_number(index);
  Sha256 exact, rounded;
  const std::size_t vertices = cache.vertex_count(), block = cache.block_vertices();
  std::vector<Eigen::Vector3f> room(std::min(block, vertices));
  for (std::size_t first = 0; first < vertices; first += block) {
    const std::span<Eigen::Vector3f> positions(room.data(), std::min(block, vertices - first));
    cache.read_position(index, first, positions);
    exact.add(std::as_bytes(positions));
    if (first == 0) digest.low = digest.high = positions[0];
    for (Eigen::Vector3f& position : positions) {
      if (!position.allFinite()) {
        const auto& offset = cache.header().offset;
        const std::size_t vertex = first + static_cast<std::size_t>(&position - positions.data());
        const auto strand = static_cast<std::size_t>(std::ranges::upper_bound(offset, vertex) - offset.begin()) - 1;
        throw InputError(fmt::format("{}: frame {}: strand {}, vertex {} is not a finite number; bake it again", name,
                                     digest.frame, strand, vertex - offset[strand]));
      }
      digest.low = digest.low.cwiseMin(position);
      digest.high = digest.high.cwiseMax(position);
      for (float& number : position) number = round_to_precision(number, step) + 0.0F;  // -0 is 0
    }
    rounded.add(std::as_bytes(positions));
  }
  digest.exact = checksum(exact);
  digest.rounded = checksum(rounded);
  return digest;
}

// Reads a digest line by line: a word, then values.
class Lines {
 public:
  Lines(const std::string& text, const std::string& name) : text_(text), name_(name) {}

  [[noreturn]] void refuse(const std::string& what) const {
    throw InputError(fmt::format("{}:{}: {}; make it again with strandbake digest", name_, line_, what));
  }
  // Goes to the next line that is not empty.
  bool next() {
    std::string line;
    while (std::getline(text_, line)) {
      ++line_;
      words_.clear();
      std::istringstream stream(line);
      for (std::string word; stream >> word;) words_.push_back(word);
      if (!words_.empty()) return true;
    }
    ++line_;
    words_.clear();
    return false;
  }
  // The values of the next line, which must begin with `word`.
  std::span<const std::string> expect(std::string_view word, std::size_t count) {
    if (!next()) refuse(fmt::format("ends before \"{}\"", word));
    return values(word, count);
  }
  std::span<const std::string> values(std::string_view word, std::size_t count) const {
    if (words_[0] != word) refuse(fmt::format("\"{}\" where \"{}\" was expected", words_[0], word));
    if (words_.size() != count + 1)
      refuse(fmt::format("\"{}\" has {} values, but wants {}", word, words_.size() - 1, count));
    return std::span(words_).subspan(1);
  }
  template <class T>
  T number(const std::string& word) const {
    T value = {};
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    bool is_good = error == std::errc{} && end == word.data() + word.size();
    if constexpr (std::is_floating_point_v<T>) is_good = is_good && std::isfinite(value);
    if (!is_good) refuse(fmt::format("\"{}\" is not the number that was expected", word));
    return value;
  }
  Eigen::Vector3f vector(std::string_view word) {
    const auto words = expect(word, 3);
    return {number<float>(words[0]), number<float>(words[1]), number<float>(words[2])};
  }
  std::string sum(std::string_view word) {
    const std::string& digits = expect(word, 1)[0];
    if (digits.size() != kDigits || digits.find_first_not_of("0123456789abcdef") != std::string::npos)
      refuse(fmt::format("\"{}\" is not a checksum of {} digits", digits, kDigits));
    return digits;
  }

 private:
  std::istringstream text_;
  std::string name_;
  std::size_t line_ = 0;
  std::vector<std::string> words_;
};

std::map<int, const FrameDigest*> frames_of(const CacheDigest& digest,
                                            const std::optional<std::pair<int, int>>& range) {
  std::map<int, const FrameDigest*> frames;
  for (const FrameDigest& frame : digest.frames)
    if (!range || (frame.frame >= range->first && frame.frame <= range->second)) frames.emplace(frame.frame, &frame);
  return frames;
}

}  // namespace

CacheDigest digest_cache(const CacheReader& cache, const std::string& name, double step,
                         const std::optional<std::pair<int, int>>& frames, int threads) {
  const CacheHeader& header = cache.header();
  CacheDigest digest;
  digest.step = std::ldexp(1.0, std::ilogb(step));
  digest.fps = header.fps;
  digest.strands = header.region.size();
  digest.vertices = cache.vertex_count();
  digest.topology = checksum_topology(header);
  Sha256 rest;
  rest.add(std::as_bytes(std::span(header.rest_position)));
  digest.rest = checksum(rest);
  std::vector<std::size_t> indices;
  for (const auto& [number, index] : frames_of(cache, frames)) indices.push_back(index);
  digest.frames.resize(indices.size());
  FirstException failure;
#pragma omp parallel for num_threads(threads) schedule(dynamic, 1)
  for (std::size_t k = 0; k < indices.size(); ++k) {
    failure.guard([&] { digest.frames[k] = digest_frame(cache, name, indices[k], digest.step); });
  }
  failure.rethrow();
  return digest;
}

std::string digest_text(const CacheDigest& digest) {
  std::string text = fmt::format("{}{}\nstep {}\nfps {}\nstrands {}\nvertices {}\ntopology {}\nrest {}\nframes {}\n",
                                 kFirstLine, kVersion, digest.step, digest.fps, digest.strands, digest.vertices,
                                 digest.topology, digest.rest, digest.frames.size());
  for (const FrameDigest& frame : digest.frames) {
    text += fmt::format("\nframe {}\n  low {} {} {}\n  high {} {} {}\n  rounded {}\n  exact {}\n", frame.frame,
                        frame.low.x(), frame.low.y(), frame.low.z(), frame.high.x(), frame.high.y(), frame.high.z(),
                        frame.rounded, frame.exact);
  }
  return text;
}

bool is_digest(const std::filesystem::path& path) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(path, ignored)) return false;
  std::string start(kFirstLine.size(), '\0');
  std::ifstream file(path, std::ios::binary);
  return file.read(start.data(), static_cast<std::streamsize>(start.size())) && start == kFirstLine;
}

CacheDigest read_digest(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string text(std::istreambuf_iterator<char>(file), {});
  if (!file) throw InputError(fmt::format("{}: cannot be read", path.string()));
  return parse_digest(text, path.string());
}

CacheDigest parse_digest(const std::string& text, const std::string& name) {
  Lines lines(text, name);
  const auto first = lines.expect("strandbake", 2);
  if (first[0] != "digest") lines.refuse("is not a digest");
  if (const int version = lines.number<int>(first[1]); version > kVersion) {
    throw InputError(fmt::format("{}: has digest version {}, but this program reads up to {}; use a newer Strandbake",
                                 name, version, kVersion));
  } else if (version < 1) {
    lines.refuse(fmt::format("version {} has never been", version));
  }
  CacheDigest digest;
  digest.step = lines.number<double>(lines.expect("step", 1)[0]);
  if (!(digest.step > 0)) lines.refuse("the step must be above 0");
  digest.fps = lines.number<double>(lines.expect("fps", 1)[0]);
  digest.strands = lines.number<std::size_t>(lines.expect("strands", 1)[0]);
  digest.vertices = lines.number<std::size_t>(lines.expect("vertices", 1)[0]);
  digest.topology = lines.sum("topology");
  digest.rest = lines.sum("rest");
  const auto count = lines.number<std::size_t>(lines.expect("frames", 1)[0]);
  while (lines.next()) {
    FrameDigest frame;
    frame.frame = lines.number<int>(lines.values("frame", 1)[0]);
    if (!digest.frames.empty() && frame.frame <= digest.frames.back().frame)
      lines.refuse(fmt::format("frame {} comes after frame {}", frame.frame, digest.frames.back().frame));
    frame.low = lines.vector("low");
    frame.high = lines.vector("high");
    frame.rounded = lines.sum("rounded");
    frame.exact = lines.sum("exact");
    digest.frames.push_back(frame);
  }
  if (digest.frames.size() != count)
    lines.refuse(fmt::format("has {} frames, but announced {}", digest.frames.size(), count));
  return digest;
}

DigestComparison compare_digests(const CacheDigest& golden, const CacheDigest& other,
                                 const std::optional<std::pair<int, int>>& frames) {
  DigestComparison result;
  const auto expect = [&](const char* what, const auto& golden_value, const auto& value) {
    if (golden_value == value) return true;
    result.mismatches.push_back(fmt::format("{}: {} in place of {}", what, value, golden_value));
    return false;
  };
  const bool same_strands = expect("strands", golden.strands, other.strands);
  const bool same_vertices = expect("vertices", golden.vertices, other.vertices);
  const bool same_counts = same_strands && same_vertices;
  if (same_counts && golden.topology != other.topology)
    result.mismatches.emplace_back("strands: of another length, or in another region");
  expect("frames a second", golden.fps, other.fps);
  if (same_counts && golden.rest != other.rest) result.mismatches.emplace_back("the groom at rest is another");
  const auto of_golden = frames_of(golden, frames), of_other = frames_of(other, frames);
  compare_frame_lists(of_golden, of_other, result.mismatches);
  for (const auto& [number, a] : of_golden) {
    const auto found = of_other.find(number);
    if (found == of_other.end() || !same_counts) continue;
    const FrameDigest* const b = found->second;
    FrameAgreement agreement;
    agreement.frame = number;
    // The largest coordinate cannot change by more than a vertex moves.
    agreement.at_least = std::max((a->low.cast<double>() - b->low.cast<double>()).cwiseAbs().maxCoeff(),
                                  (a->high.cast<double>() - b->high.cast<double>()).cwiseAbs().maxCoeff());
    if (a->exact == b->exact) {
      agreement.at_most = 0;
    } else if (golden.step == other.step && a->rounded == b->rounded) {
      agreement.at_most = std::sqrt(3.0) * golden.step;  // opposite corners of one cell
    }
    result.frames.push_back(agreement);
  }
  return result;
}

}  // namespace strandbake
