#include "formats/scene_words.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "formats/scene.h"

namespace strandbake {
namespace {

bool is_continuation(char c) {
  return (static_cast<unsigned char>(c) & 0xC0u) == 0x80u;
}

// A reader of short texts like "1-24" and "0-99, 200".
class Scanner {
 public:
  explicit Scanner(std::string_view text) : text_(text) {}

  bool at_end() {
    while (!text_.empty() && (text_.front() == ' ' || text_.front() == '\t')) text_.remove_prefix(1);
    return text_.empty();
  }
  bool take(char c) {
    if (at_end() || text_.front() != c) return false;
    text_.remove_prefix(1);
    return true;
  }
  template <class T>
  std::optional<T> number() {
    if (at_end()) return std::nullopt;
    T value{};
    const auto [end, error] = std::from_chars(text_.data(), text_.data() + text_.size(), value);
    if (error != std::errc{}) return std::nullopt;
    text_.remove_prefix(static_cast<std::size_t>(end - text_.data()));
    return value;
  }

 private:
  std::string_view text_;
};

}  // namespace

std::string toml_text(double value) {
  if (value == 0 && std::signbit(value)) return "-0.0";  // TOML reads -0 as a whole number, which has no sign
  return fmt::format("{}", value);
}
std::string toml_text(int value) {
  return fmt::format("{}", value);
}
std::string toml_text(bool value) {
  return value ? "true" : "false";
}

std::string toml_text(const std::optional<int>& value) {
  return value ? toml_text(*value) : toml_text(std::string_view("auto"));
}

std::string toml_text(std::string_view value) {
  std::string out = "\"";
  for (const char c : value) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      out += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string toml_text(const Eigen::Vector3d& value) {
  return fmt::format("[{}, {}, {}]", toml_text(value.x()), toml_text(value.y()), toml_text(value.z()));
}

std::string toml_text(const Curve& curve, bool scalar) {
  std::string out = "{";
  for (std::size_t k = 0; k < curve.frame.size(); ++k) {
    std::string key = toml_text(curve.frame[k]);
    if (key.find_first_of(".+") != std::string::npos) key = toml_text(key);
    if (k > 0) out += ", ";
    out += key + " = " + (scalar ? toml_text(curve.value[k].x()) : toml_text(curve.value[k]));
  }
  return out + "}";
}

std::string shortened(std::string_view text, std::size_t longest) {
  if (text.size() <= longest) return std::string(text);
  while (longest > 0 && is_continuation(text[longest])) --longest;
  return std::string(text.substr(0, longest)) + "...";
}

std::string in_quotes(std::string_view text) {
  return toml_text(shortened(text, 60));
}

std::string listed(const std::vector<std::string>& words) {
  std::string out;
  for (std::size_t k = 0; k < words.size(); ++k) {
    if (k > 0) out += k + 1 == words.size() ? " or " : ", ";
    out += in_quotes(words[k]);
  }
  return out;
}

std::string range_text(const Range& range) {
  constexpr double most = std::numeric_limits<double>::max();
  if (range.low <= -most && range.high >= most) return "a finite number";
  if (range.high >= most) return fmt::format("{} {}", range.low_open ? "more than" : "at least", range.low);
  if (range.low <= -most) return fmt::format("at most {}", range.high);
  if (range.low_open) return fmt::format("more than {} and at most {}", range.low, range.high);
  return fmt::format("from {} to {}", range.low, range.high);
}

std::pair<int, int> parse_frames(std::string_view text) {
  constexpr int most = 10'000'000;
  constexpr const char* would_do = "write first and last frame, \"1-240\", or one frame, \"7\"";
  Scanner scan(text);
  const auto first = scan.number<long long>();
  auto last = first;
  bool good = first.has_value();
  if (good && scan.take('-')) {
    last = scan.number<long long>();
    good = last.has_value();
  }
  if (!good || !scan.at_end()) throw std::invalid_argument(in_quotes(text) + " is not a range of frames: " + would_do);
  if (std::max(*first, *last) > most || std::min(*first, *last) < -most) {
    throw std::invalid_argument(
        fmt::format("{} goes beyond frame {}: frames are from -{} to {}", in_quotes(text), most, most, most));
  }
  if (*last < *first) {
    throw std::invalid_argument(
        fmt::format("{} runs backwards: write the first frame first, \"{}-{}\"", in_quotes(text), *last, *first));
  }
  return {static_cast<int>(*first), static_cast<int>(*last)};
}

std::vector<std::pair<std::size_t, std::size_t>> parse_ranges(std::string_view text) {
  constexpr const char* would_do = "write numbers and ranges from 0, \"0-99, 200\"";
  std::vector<std::pair<std::size_t, std::size_t>> ranges;
  Scanner scan(text);
  do {
    const auto first = scan.number<std::size_t>();
    auto last = first;
    if (first && scan.take('-')) last = scan.number<std::size_t>();
    if (!first || !last) throw std::invalid_argument(in_quotes(text) + " is not a list of numbers: " + would_do);
    if (*last < *first) {
      throw std::invalid_argument(fmt::format("{} holds {}-{}, which runs backwards: write {}-{}", in_quotes(text),
                                              *first, *last, *last, *first));
    }
    ranges.emplace_back(*first, *last);
  } while (scan.take(','));
  if (!scan.at_end()) throw std::invalid_argument(in_quotes(text) + " is not a list of numbers: " + would_do);

  std::sort(ranges.begin(), ranges.end());
  std::size_t kept = 0;
  for (std::size_t k = 1; k < ranges.size(); ++k) {
    if (ranges[k].first <= ranges[kept].second || ranges[k].first - 1 == ranges[kept].second) {
      ranges[kept].second = std::max(ranges[kept].second, ranges[k].second);
    } else {
      ranges[++kept] = ranges[k];
    }
  }
  ranges.resize(kept + 1);
  return ranges;
}

}  // namespace strandbake
