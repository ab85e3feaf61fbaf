// Wavefront OBJ: vertices (v) and polyline elements (l). Everything else in the file has nothing to say about strands.
#include <charconv>
#include <optional>
#include <system_error>
#include <vector>

#include "formats/groom_parse.h"

namespace strandbake {
namespace {

constexpr std::string_view blanks = " \t\r\v\f";

// Cuts text into logical lines: a backslash at the end of a line joins the next one, comments are taken off.
class Lines {
 public:
  explicit Lines(std::string_view text) : rest_(text) {}

  // The next line; its number is number().
  std::optional<std::string_view> next() {
    if (rest_.empty()) return std::nullopt;
    number_ += lines_taken_;
    lines_taken_ = 0;
    std::string_view line = take();
    if (!continues(line)) return line;
    joined_.clear();
    while (continues(line)) {
      line.remove_suffix(1);
      joined_ += line;
      joined_ += ' ';
      line = rest_.empty() ? std::string_view() : take();
    }
    joined_ += line;
    return joined_;
  }
  std::uint64_t number() const { return number_; }

 private:
  static bool continues(std::string_view line) { return !line.empty() && line.back() == '\\'; }

  std::string_view take() {
    const std::size_t end = rest_.find('\n');
    std::string_view line = rest_.substr(0, end);
    rest_ = end == std::string_view::npos ? std::string_view() : rest_.substr(end + 1);
    ++lines_taken_;
    line = line.substr(0, line.find('#'));
    const std::size_t last = line.find_last_not_of(blanks);
    return line.substr(0, last == std::string_view::npos ? 0 : last + 1);
  }

  std::string_view rest_;
  std::string joined_;
  std::uint64_t number_ = 1;
  std::uint64_t lines_taken_ = 0;
};

// Takes the next word off the line; empty at its end.
std::string_view take_word(std::string_view& line) {
  const std::size_t first = line.find_first_not_of(blanks);
  if (first == std::string_view::npos) {
    line = {};
    return {};
  }
  line.remove_prefix(first);
  const std::string_view word = line.substr(0, line.find_first_of(blanks));
  line.remove_prefix(word.size());
  return word;
}

struct Element {
  std::uint64_t begin;  // of its corners
  std::uint64_t line;
};

class ObjParser {
 public:
  ObjParser(std::string_view text, const std::string& name, Warnings& warnings)
      : lines_(text), name_(name), warnings_(warnings) {}

  Groom parse() {
    while (const std::optional<std::string_view> line = lines_.next()) {
      std::string_view rest = *line;
      const std::string_view keyword = take_word(rest);
      if (keyword == "v") {
        read_vertex(rest);
      } else if (keyword == "l") {
        read_polyline(rest);
      } else if (keyword == "o" || keyword == "g") {
        chain_is_open_ = false;
      } else if (keyword == "f" || keyword == "p") {
        ++left_out_;
      } else if (keyword.find('\0') != std::string_view::npos) {
        fail(lines_.number(), "a zero byte stands here; an .obj file is text");
      }
    }
    if (elements_.empty()) {
      throw InputError(fmt::format("{}: has no polylines (lines that begin with \"l\"), so it has no strands", name_));
    }
    if (left_out_ != 0) {
      warnings_.push_back(
          fmt::format("{}: {} faces and points are left out; only polylines are strands", name_, left_out_));
    }
    return make_groom();
  }

 private:
  [[noreturn]] void fail(std::uint64_t line, std::string_view what) const {
    throw InputError(fmt::format("{}:{}: {}", name_, line, what));
  }

  void read_vertex(std::string_view rest) {
    Eigen::Vector3d p;
    for (int axis = 0; axis < 3; ++axis) {
      std::string_view word = take_word(rest);
      if (word.empty()) fail(lines_.number(), fmt::format("a vertex needs three coordinates, and there are {}", axis));
      const std::string_view written = word;
      if (word.front() == '+') word.remove_prefix(1);
      const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), p[axis]);
      if (error != std::errc() || end != word.data() + word.size()) {
        fail(lines_.number(), fmt::format("\"{}\" is no number that a coordinate can have", shown(written)));
      }
    }
    vertices_.push_back(p);
  }

  void read_polyline(std::string_view rest) {
    const std::uint64_t begin = corners_.size();
    while (true) {
      const std::string_view word = take_word(rest);
      if (word.empty()) break;
      corners_.push_back(read_corner(word));
    }
    const std::uint64_t count = corners_.size() - begin;
    if (count == 2 && chain_is_open_ && corners_[begin] == corners_[begin - 1]) {
      corners_.erase(corners_.end() - 2);  // the piece goes on where the last one ended
      return;
    }
    detail::require_two_vertices(fmt::format("{}:{}", name_, lines_.number()), elements_.size(), count);
    elements_.push_back({begin, lines_.number()});
    chain_is_open_ = count == 2;
  }

  // Index from 0 of a corner `i` or `i/t`.
  std::uint64_t read_corner(std::string_view word) const {
    std::int64_t index = 0;
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), index);
    const bool whole = end == word.data() + word.size() || *end == '/';
    if (error != std::errc() || !whole || index == 0) {
      fail(lines_.number(),
           fmt::format("\"{}\" is no vertex index: 1 is the first vertex, -1 the last one so far", shown(word)));
    }
    if (index > 0) return static_cast<std::uint64_t>(index) - 1;
    const std::uint64_t back = 0 - static_cast<std::uint64_t>(index);
    if (back > vertices_.size()) {
      fail(lines_.number(),
           fmt::format("vertex {} is asked for, but only {} vertices stand before this line", index, vertices_.size()));
    }
    return vertices_.size() - back;
  }

  Groom make_groom() const {
    Groom groom;
    groom.offset.reserve(elements_.size() + 1);
    groom.position.reserve(corners_.size());
    for (std::uint64_t strand = 0; strand < elements_.size(); ++strand) {
      const std::uint64_t end = strand + 1 < elements_.size() ? elements_[strand + 1].begin : corners_.size();
      for (std::uint64_t corner = elements_[strand].begin; corner < end; ++corner) {
        if (corners_[corner] >= vertices_.size()) {
          fail(elements_[strand].line, fmt::format("strand {} asks for vertex {}, but the file has {}", strand,
                                                   corners_[corner] + 1, vertices_.size()));
        }
        groom.position.push_back(vertices_[corners_[corner]]);
      }
      groom.offset.push_back(end);
    }
    return groom;
  }

  // A word of the file for a message: short, and printable.
  static std::string shown(std::string_view word) {
    std::string text;
    for (const char c : word.substr(0, 40)) text += c >= ' ' && c <= '~' ? c : '?';
    return text;
  }

  Lines lines_;
  const std::string& name_;
  Warnings& warnings_;
  std::vector<Eigen::Vector3d> vertices_;
  std::vector<std::uint64_t> corners_;  // of all elements, one after the other
  std::vector<Element> elements_;
  bool chain_is_open_ = false;  // the last element is made of two-index pieces and may go on
  std::uint64_t left_out_ = 0;
};

}  // namespace

Groom detail::parse_obj(std::string_view text, const std::string& name, Warnings& warnings) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);  // UTF-8 byte order mark
  return ObjParser(text, name, warnings).parse();
}

}  // namespace strandbake
