#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <system_error>
#include <utility>
#include <vector>

#include "formats/animation_guard_parts.h"

namespace strandbake {
namespace {

class BvhGuard {
 public:
  BvhGuard(std::string_view text, std::string name) : text_(text), name_(std::move(name)) {}

  void run(Warnings& warnings) {
    expect("HIERARCHY");
    expect("ROOT");
    read_joints(warnings);
    expect("MOTION");
    expect("Frames:");
    const double frames = number();
    expect("Frame");
    expect("Time:");
    const double interval = number();
    if (!(interval > 0)) fail("has a frame time that is not more than 0");
    const std::size_t left = text_.size() - at_;
    if (!(frames >= 1) || frames != std::floor(frames)) fail("has a number of frames that is not 1 or more");
    // Every value takes two bytes at least; checked before anything is made as large as the file says.
    if (frames * static_cast<double>(std::max<std::size_t>(1, channels_)) > static_cast<double>(left)) {
      fail("is cut short: it has too few values for " + std::to_string(static_cast<long long>(frames)) + " frames");
    }
    const auto values = static_cast<std::uint64_t>(frames) * channels_;
    for (std::uint64_t value = 0; value < values; ++value) number();
  }

 private:
  [[noreturn]] void fail(const std::string& what) const {
    throw InputError(name_ + ":" + std::to_string(line_) + ": " + what);
  }

  // Words are split as the importer does it: a brace stands alone only at the start of a word.
  std::string_view word() {
    while (at_ < text_.size() && is_space(text_[at_])) line_ += text_[at_++] == '\n';
    const std::size_t begin = at_;
    while (at_ < text_.size() && !is_space(text_[at_])) {
      ++at_;
      if (at_ == begin + 1 && (text_[begin] == '{' || text_[begin] == '}')) break;
    }
    return text_.substr(begin, at_ - begin);
  }

  static bool is_space(char c) { return c == ' ' || (c >= '\t' && c <= '\r'); }

  static std::string shown(std::string_view word) {
    return word.empty() ? "the end of the file" : "\"" + std::string(word.substr(0, 40)) + "\"";
  }

  void expect(std::string_view wanted) {
    const std::string_view found = word();
    if (found != wanted) fail("expected \"" + std::string(wanted) + "\", found " + shown(found));
  }

  double number() {
    const std::string_view found = word();
    double value = 0;
    const char* begin = found.data() + (found.starts_with('+') ? 1 : 0);
    const auto [end, error] = std::from_chars(begin, found.data() + found.size(), value);
    if (found.empty() || error != std::errc() || end != found.data() + found.size() || !(std::abs(value) < 1e30)) {
      fail("expected a number, found " + shown(found));
    }
    return value;
  }

  void read_joints(Warnings& warnings) {
    std::vector<std::string> open = {read_name()};
    while (!open.empty()) {
      const std::string_view key = word();
      if (key == "OFFSET") {
        for (int k = 0; k < 3; ++k) number();
      } else if (key == "CHANNELS") {
        read_channels(open.back(), warnings);
      } else if (key == "JOINT") {
        open.push_back(read_name());
        if (open.size() > deepest) fail("nests its joints more than " + std::to_string(deepest) + " deep");
      } else if (key == "End") {
        expect("Site");
        expect("{");
        expect("OFFSET");
        for (int k = 0; k < 3; ++k) number();
        expect("}");
      } else if (key == "}") {
        open.pop_back();
      } else {
        fail("expected OFFSET, CHANNELS, JOINT, End Site or }, found " + shown(key));
      }
    }
  }

  std::string read_name() {
    std::string name(word());
    if (name.empty() || name == "{") fail("expected the name of a joint, found " + shown(name));
    expect("{");
    return name;
  }

  void read_channels(const std::string& joint, Warnings& warnings) {
    const double count = number();
    if (!(count >= 0 && count <= 6) || count != std::floor(count)) fail("expected a number of channels from 0 to 6");
    std::set<std::string> names;
    std::size_t positions = 0;
    for (int k = 0; k < count; ++k) {
      const std::string channel(word());
      if (channel.size() != 9 || channel[0] < 'X' || channel[0] > 'Z' ||
          (channel.substr(1) != "position" && channel.substr(1) != "rotation")) {
        fail("expected a channel such as Xrotation or Yposition, found " + shown(channel));
      }
      if (!names.insert(channel).second) fail("names the channel " + channel + " twice");
      positions += channel.ends_with("position");
    }
    if (positions != 0 && names.size() != 6) {
      warnings.push_back(name_ + ":" + std::to_string(line_) + ": joint \"" + joint +
                         "\" has positions but not all of 6 channels; its positions are left out");
    }
    channels_ += names.size();
  }

  std::string_view text_;
  std::string name_;
  std::size_t at_ = 0;
  std::size_t line_ = 1;
  std::size_t channels_ = 0;
};

}  // namespace

void guard_bvh(std::string_view text, const std::string& name, Warnings& warnings) {
  BvhGuard(text, name).run(warnings);
}

}  // namespace strandbake
