#include "formats/animation_guard.h"

#include <algorithm>
#include <fstream>
#include <system_error>

#include "formats/animation_guard_parts.h"

namespace strandbake {
namespace {

std::string_view without_space(std::string_view text) {
  if (text.starts_with("\xEF\xBB\xBF")) text.remove_prefix(3);
  const std::size_t begin = text.find_first_not_of(" \t\r\n\f\v");
  return begin == std::string_view::npos ? std::string_view() : text.substr(begin);
}

}  // namespace

std::string Graph::fault() const {
  struct Extent {
    std::uint64_t size = 0;  // 0: being counted
    std::size_t height = 1;
  };
  std::map<std::string, Extent> known;
  for (const auto& entry : children_) {
    std::vector<std::string> open = {entry.first};
    while (!open.empty()) {
      const std::string id = open.back();
      static const std::set<std::string> none;
      const auto found = children_.find(id);
      const std::set<std::string>& children = found == children_.end() ? none : found->second;
      if (known.emplace(id, Extent{}).second) {
        for (const std::string& child : children) {
          const auto seen = known.find(child);
          if (seen == known.end()) {
            open.push_back(child);
          } else if (seen->second.size == 0) {
            return "has a node (" + child + ") that is its own ancestor";
          }
        }
        continue;
      }
      open.pop_back();
      Extent extent{1, 1};
      for (const std::string& child : children) {
        extent.size += known[child].size;
        extent.height = std::max(extent.height, known[child].height + 1);
      }
      if (extent.size > most_nodes) return "has more than " + std::to_string(most_nodes) + " nodes";
      if (extent.height > deepest) return "nests its nodes more than " + std::to_string(deepest) + " deep";
      known[id] = extent;
    }
  }
  return "";
}

GuardedFile guard_animation(std::string_view bytes, const std::filesystem::path& path, Warnings& warnings) {
  const std::string name = path.string();
  if (bytes.empty()) throw InputError(name + ": is empty; expected a glTF, GLB, FBX, BVH or Collada file");
  const std::string_view text = without_space(bytes);
  const std::string_view head = text.substr(0, 4096);
  if (bytes.starts_with("glTF") || text.starts_with('{')) {
    return guard_gltf(bytes.starts_with("glTF") ? bytes : text, path, warnings);
  }
  GuardedFile file;
  if (text.starts_with("HIERARCHY")) {
    file.kind = AnimationKind::bvh;
    guard_bvh(text, name, warnings);
    file.files.emplace_back("animation.bvh", text);
  } else if (bytes.starts_with("Kaydara FBX Binary") || head.find("FBXHeaderExtension") != std::string_view::npos) {
    file.kind = AnimationKind::fbx;
    guard_fbx(bytes, name);
    file.files.emplace_back("animation.fbx", bytes);
  } else if (text.starts_with('<') && head.find("<COLLADA") != std::string_view::npos) {
    file.kind = AnimationKind::collada;
    guard_collada(text, name);
    file.files.emplace_back("animation.dae", text);
  } else {
    throw InputError(name + ": is none of glTF, GLB, FBX, BVH and Collada, or cut short");
  }
  return file;
}

std::string read_bytes(const std::filesystem::path& path) {
  std::error_code error;
  const auto status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) throw InputError(path.string() + ": there is no such file");
  if (!std::filesystem::is_regular_file(status)) {
    throw InputError(path.string() + ": is not a file but a folder or device");
  }
  std::ifstream in(path, std::ios::binary);
  std::string bytes;
  const auto size = std::filesystem::file_size(path, error);
  if (in && !error) {
    bytes.resize(size);
    in.read(bytes.data(), static_cast<std::streamsize>(size));
  }
  if (!in || error) throw InputError(path.string() + ": cannot be read; check its permissions");
  return bytes;
}

}  // namespace strandbake
