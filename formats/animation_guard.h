// Looks an animation file over before the importer sees it. The importer trusts counts, offsets and nesting that a
// broken file can fake; what passes here is complete, of bounded depth and refers to nothing outside itself.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "formats/error.h"

namespace strandbake {

enum class AnimationKind { gltf, fbx, bvh, collada };

// Names of the nodes whose keys a clip of a glTF file gives in a way that the importer turns into straight lines.
struct FlattenedKeys {
  std::vector<std::string> step;
  std::vector<std::string> cubic_spline;
};

struct GuardedFile {
  AnimationKind kind = AnimationKind::gltf;
  // What the importer may open, by name; the animation itself first.
  std::vector<std::pair<std::string, std::string>> files;

  // Only for glTF, which is handed on without meshes, its node i called "i" and its clip i called "i": names in a file
  // need not be unique, and the importer keeps nothing else of a node's identity.
  std::vector<std::string> node_names;  // nodes without one are called "nodes[i]"
  std::vector<std::string> clip_names;
  std::vector<FlattenedKeys> flattened;  // one for each clip
};

// Throws InputError for bytes that are none of the formats, cut short, or would lead the importer astray.
GuardedFile guard_animation(std::string_view bytes, const std::filesystem::path& path, Warnings& warnings);

// A whole file. Throws InputError, for a folder or an empty file too.
std::string read_bytes(const std::filesystem::path& path);

}  // namespace strandbake
