#include <utility>
#include <vector>

#include "formats/animation_guard_parts.h"

namespace strandbake {
namespace {

class FbxGuard {
 public:
  FbxGuard(std::string_view bytes, std::string name) : bytes_(bytes), name_(std::move(name)) {}

  void run() {
    if (bytes_.starts_with("Kaydara FBX Binary")) {
      read_binary();
    } else {
      read_text();
    }
    if (!finished_) fail("is cut short: its records do not end");
    for (const char* section : {"FBXHeaderExtension", "Objects", "Connections"}) {
      if (!sections_.contains(section)) {
        fail("is cut short or no scene: it has no section \"" + std::string(section) + "\"");
      }
    }
    Graph tree;
    for (const auto& [child, parent] : links_) {
      if (models_.contains(child) && (models_.contains(parent) || parent == "0")) tree.add(parent, child);
    }
    const std::string fault = tree.fault();
    if (!fault.empty()) fail(fault);
  }

 private:
  struct Property {
    char type = 0;
    std::string text;  // of strings and whole numbers
  };

  [[noreturn]] void fail(const std::string& what) const { throw InputError(name_ + ": " + what); }

  // A record: where it ends, how many properties it has and how long they are, its name, the properties, records.
  void read_binary() {
    if (bytes_.size() < 27) fail("is cut short: an FBX file has at least 27 bytes");
    const bool wide = little32(bytes_, 23) >= 7500;
    const std::size_t header = wide ? 25 : 13;
    std::vector<std::pair<std::size_t, std::string>> open;  // end and name of the records around
    std::size_t at = 27;
    while (true) {
      while (!open.empty() && at == open.back().first) open.pop_back();
      const std::size_t limit = open.empty() ? bytes_.size() : open.back().first;
      if (at > limit || limit - at < header) fail("is cut short or damaged" + at_byte(at));
      const std::uint64_t end = wide ? little64(bytes_, at) : little32(bytes_, at);
      if (end == 0) {  // closes a list of records
        at += header;
        if (open.empty()) {
          finished_ = true;
          return;
        }
        if (at != open.back().first) fail("is damaged" + at_byte(at));
        continue;
      }
      const std::uint64_t count = wide ? little64(bytes_, at + 8) : little32(bytes_, at + 4);
      const std::uint64_t size = wide ? little64(bytes_, at + 16) : little32(bytes_, at + 8);
      const auto name_size = static_cast<unsigned char>(bytes_[at + header - 1]);
      const std::size_t body = at + header + name_size;
      if (end > limit || body > end || size > end - body) fail("is cut short or damaged" + at_byte(at));
      const std::string name(bytes_.substr(at + header, name_size));
      if (open.empty()) sections_.insert(name);
      record(name, open.empty() ? "" : open.back().second, read_properties(body, count, size));
      if (open.size() >= 100) fail("nests its records too deeply" + at_byte(at));
      open.emplace_back(end, name);
      at = body + size;
    }
  }

  std::vector<Property> read_properties(std::size_t at, std::uint64_t count, std::uint64_t size) const {
    const std::size_t begin = at;
    const std::size_t end = at + size;
    const auto need = [&](std::uint64_t more) {
      if (more > end - at) fail("is cut short or damaged" + at_byte(at));
    };
    std::vector<Property> properties;
    for (std::uint64_t k = 0; k < count; ++k) {
      need(1);
      Property p{bytes_[at++], ""};
      const std::size_t plain = p.type == 'C' || p.type == 'B'   ? 1
                                : p.type == 'Y'                  ? 2
                                : p.type == 'I' || p.type == 'F' ? 4
                                : p.type == 'D' || p.type == 'L' ? 8
                                                                 : 0;
      if (plain != 0) {
        need(plain);
        if (p.type == 'L') p.text = std::to_string(little64(bytes_, at));
        at += plain;
      } else if (p.type == 'S' || p.type == 'R') {
        need(4);
        const std::uint32_t length = little32(bytes_, at);
        at += 4;
        need(length);
        if (p.type == 'S') p.text = std::string(bytes_.substr(at, length));
        at += length;
      } else {
        const std::size_t element = p.type == 'f' || p.type == 'i'   ? 4
                                    : p.type == 'd' || p.type == 'l' ? 8
                                    : p.type == 'b' || p.type == 'c' ? 1
                                                                     : 0;
        if (element == 0) fail("has a property of unknown type" + at_byte(at - 1));
        need(12);
        const std::uint64_t full = std::uint64_t{little32(bytes_, at)} * element;
        const std::uint32_t packed = little32(bytes_, at + 4);
        const std::uint64_t length = little32(bytes_, at + 8);
        at += 12;
        need(length);
        // Deflate makes nothing smaller than about 1032 : 1.
        if (packed > 1 || (packed == 0 && full != length) || (packed == 1 && full > 1040 * length)) {
          fail("has an array that does not fit its size" + at_byte(at - 12));
        }
        at += length;
      }
      if (properties.size() < 3) properties.push_back(std::move(p));
    }
    if (at != begin + size) fail("is damaged" + at_byte(at));
    return properties;
  }

  void record(const std::string& name, const std::string& parent, const std::vector<Property>& p) {
    if (parent == "Objects" && name == "Model" && !p.empty()) models_.insert(p[0].text);
    if (parent == "Connections" && name == "C" && p.size() == 3 && p[0].text == "OO") {
      links_.emplace_back(p[1].text, p[2].text);
    }
  }

  // Text: `Name: value, value { records }`, strings in quotes, comments from a semicolon on.
  void read_text() {
    std::vector<std::string> open;
    std::string name;
    std::vector<Property> values;
    std::string value;
    bool quoted = false;
    const auto finish_value = [&] {
      if (!value.empty() && values.size() < 3) values.push_back({'S', value});
      value.clear();
    };
    const auto finish_record = [&] {
      finish_value();
      if (!name.empty()) record(name, open.empty() ? "" : open.back(), values);
      values.clear();
    };
    for (std::size_t at = 0; at < bytes_.size(); ++at) {
      const char c = bytes_[at];
      if (quoted) {
        if (c == '"') {
          quoted = false;
        } else {
          value += c;
        }
      } else if (c == '"') {
        quoted = true;
      } else if (c == ';') {
        while (at + 1 < bytes_.size() && bytes_[at + 1] != '\n') ++at;
      } else if (c == ':') {
        name = value;
        value.clear();
        values.clear();
      } else if (c == ',') {
        finish_value();
      } else if (c == '\n') {
        finish_record();
        name.clear();
      } else if (c == '{') {
        finish_record();
        if (open.empty()) sections_.insert(name);
        open.push_back(name);
        name.clear();
        if (open.size() > 100) fail("nests its records too deeply" + at_byte(at));
      } else if (c == '}') {
        finish_record();
        name.clear();
        if (open.empty()) fail("has a } too many" + at_byte(at));
        open.pop_back();
      } else if (c != ' ' && c != '\t' && c != '\r') {
        value += c;
      }
    }
    finished_ = open.empty() && !quoted && name.empty() && value.empty();
  }

  std::string_view bytes_;
  std::string name_;
  bool finished_ = false;
  std::set<std::string> sections_;  // at the top, with records in them
  std::set<std::string> models_;
  std::vector<std::pair<std::string, std::string>> links_;  // child, parent
};

}  // namespace

void guard_fbx(std::string_view bytes, const std::string& name) {
  FbxGuard(bytes, name).run();
}

}  // namespace strandbake
