// What the guards of the formats share; see animation_guard.h.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <string_view>

#include "formats/animation_guard.h"

namespace strandbake {

GuardedFile guard_gltf(std::string_view bytes, const std::filesystem::path& path, Warnings& warnings);
void guard_bvh(std::string_view text, const std::string& name, Warnings& warnings);
void guard_fbx(std::string_view bytes, const std::string& name);
void guard_collada(std::string_view text, const std::string& name);

// The importer walks trees by recursion.
inline constexpr std::size_t deepest = 1000;
// Nodes of a tree in which parts are used several times.
inline constexpr std::uint64_t most_nodes = 1'000'000;

// Who is whose child, by id, where a file gives that as a list of pairs. A loop would keep the importer busy forever.
class Graph {
 public:
  void add(const std::string& parent, const std::string& child) { children_[parent].insert(child); }

  // What is wrong with it; empty where it is a tree, or parts that are shared but few.
  std::string fault() const;

 private:
  std::map<std::string, std::set<std::string>> children_;
};

inline std::string at_byte(std::size_t offset) {
  return " at byte " + std::to_string(offset);
}

inline std::uint32_t little32(std::string_view bytes, std::size_t at) {
  std::uint32_t value = 0;
  for (std::size_t k = 0; k < 4; ++k) {
    value |= static_cast<std::uint32_t>(static_cast<unsigned char>(bytes[at + k])) << (8 * k);
  }
  return value;
}

inline std::uint64_t little64(std::string_view bytes, std::size_t at) {
  return little32(bytes, at) | static_cast<std::uint64_t>(little32(bytes, at + 4)) << 32;
}

}  // namespace strandbake
