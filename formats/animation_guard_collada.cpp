#include <algorithm>
#include <charconv>
#include <cstring>
#include <system_error>
#include <utility>
#include <vector>

#include "formats/animation_guard_parts.h"

namespace strandbake {
namespace {

class ColladaGuard {
 public:
  ColladaGuard(std::string_view text, std::string name) : text_(text), name_(std::move(name)) {}

  void run() {
    std::size_t at = 0;
    while ((at = text_.find('<', at)) != std::string_view::npos) {
      if (skip(at, "<!--", "-->") || skip(at, "<![CDATA[", "]]>") || skip(at, "<?", "?>") || skip(at, "<!", ">")) {
        continue;
      }
      std::size_t end = at + 1;
      for (char quote = 0; end < text_.size() && (quote != 0 || text_[end] != '>'); ++end) {
        if (quote != 0) {
          if (text_[end] == quote) quote = 0;
        } else if (text_[end] == '"' || text_[end] == '\'') {
          quote = text_[end];
        }
      }
      if (end >= text_.size()) fail("is cut short in the middle of a tag", at);
      tag(text_.substr(at + 1, end - at - 1), at);
      at = end + 1;
    }
    if (!open_.empty()) fail("is cut short: <" + open_.back().name + "> is not closed", text_.size());
    check_accessors();
    const std::string fault = tree_.fault();
    if (!fault.empty()) throw InputError(name_ + ": " + fault);
  }

 private:
  struct Element {
    std::string name;
    std::string node;  // key of the <node> that this is or lies in
  };
  struct Accessor {
    std::string source;
    std::uint64_t count, stride, offset, params;
    std::size_t at;
  };

  [[noreturn]] void fail(const std::string& what, std::size_t at) const {
    const auto line = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at), '\n');
    throw InputError(name_ + ":" + std::to_string(line) + ": " + what);
  }

  bool skip(std::size_t& at, std::string_view from, std::string_view to) const {
    if (text_.substr(at, from.size()) != from) return false;
    const std::size_t end = text_.find(to, at + from.size());
    if (end == std::string_view::npos) fail("is cut short", at);
    at = end + to.size();
    return true;
  }

  static std::string attribute(std::string_view tag, std::string_view name) {
    for (std::size_t at = 0; (at = tag.find(name, at)) != std::string_view::npos; at += name.size()) {
      const std::string_view after = tag.substr(at + name.size());
      const std::size_t quote = after.find_first_of("\"'");
      if (at == 0 || std::strchr(" \t\r\n", tag[at - 1]) == nullptr || quote == std::string_view::npos ||
          after.substr(0, quote).find_first_not_of(" \t\r\n=") != std::string_view::npos) {
        continue;
      }
      const std::size_t end = after.find(after[quote], quote + 1);
      if (end != std::string_view::npos) return std::string(after.substr(quote + 1, end - quote - 1));
    }
    return "";
  }

  std::uint64_t number(std::string_view tag, std::string_view name, std::uint64_t missing, std::size_t at) const {
    const std::string value = attribute(tag, name);
    if (value.empty()) return missing;
    std::uint64_t result = 0;
    const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), result);
    if (error != std::errc() || end != value.data() + value.size() || result > UINT32_MAX) {
      fail(std::string(name) + "=\"" + value + "\" is not a whole number of 0 or more", at);
    }
    return result;
  }

  void tag(std::string_view tag, std::size_t at) {
    const bool closes = tag.starts_with('/');
    const bool empty = tag.ends_with('/');
    if (closes) tag.remove_prefix(1);
    const std::string name(tag.substr(0, tag.find_first_of(" \t\r\n/")));
    if (closes) {
      if (open_.empty() || open_.back().name != name) fail("has </" + name + "> without its beginning", at);
      open_.pop_back();
      return;
    }
    Element element{name, open_.empty() ? "" : open_.back().node};
    const std::string parent = open_.empty() ? "" : open_.back().name;
    if (name == "node") {
      const std::string id = attribute(tag, "id");
      const std::string around = element.node;
      element.node = id.empty() ? "node " + std::to_string(++nameless_) : "#" + id;
      tree_.add(around, element.node);
    } else if (name == "instance_node") {
      tree_.add(element.node, attribute(tag, "url"));
    } else if (name == "float_array") {
      const std::uint64_t count = number(tag, "count", 0, at);
      if (count > text_.size() / 2) {
        fail("has an array of " + std::to_string(count) + " numbers, more than fit in the file", at);
      }
      arrays_["#" + attribute(tag, "id")] = count;
    } else if (name == "accessor") {
      accessors_.push_back({attribute(tag, "source"), number(tag, "count", 0, at), number(tag, "stride", 1, at),
                            number(tag, "offset", 0, at), 0, at});
    } else if (name == "param" && parent == "accessor") {
      ++accessors_.back().params;
    }
    if (empty) return;
    open_.push_back(std::move(element));
    if (open_.size() > deepest) fail("nests its elements more than " + std::to_string(deepest) + " deep", at);
  }

  // The importer reads through accessors unchecked.
  void check_accessors() const {
    for (const Accessor& a : accessors_) {
      const auto array = arrays_.find(a.source);
      if (array == arrays_.end()) continue;
      if (a.stride > 16 || a.params > std::max<std::uint64_t>(1, a.stride) ||
          a.offset + a.count * a.stride > array->second) {
        fail("an accessor reaches beyond its array of " + std::to_string(array->second) + " numbers", a.at);
      }
    }
  }

  std::string_view text_;
  std::string name_;
  std::vector<Element> open_;
  std::size_t nameless_ = 0;
  Graph tree_;
  std::map<std::string, std::uint64_t> arrays_;
  std::vector<Accessor> accessors_;
};

}  // namespace

void guard_collada(std::string_view text, const std::string& name) {
  ColladaGuard(text, name).run();
}

}  // namespace strandbake
