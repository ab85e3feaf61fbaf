// Node animation: a tree of nodes, one clip of keys, and exact sampling. Plain data; animation_assimp.cpp fills it from
// files.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "formats/error.h"

namespace strandbake {

template <class T>
struct Keys {
  std::vector<double> time;  // [s] from the start of the clip, strictly increasing
  std::vector<T> value;
};

struct AnimationNode {
  std::string name;
  int parent = -1;  // index of the parent, always smaller than the node's own; -1 for the root
  Eigen::Matrix4d local = Eigen::Matrix4d::Identity();  // transform to the parent where the clip has no keys for it
  bool animated = false;                                // keys replace `local`; an empty track is 0, no turn, 1
  Keys<Eigen::Vector3d> translation;
  Keys<Eigen::Quaterniond> rotation;  // unit length
  Keys<Eigen::Vector3d> scale;
};

struct Animation {
  std::string source;                                // name of the file, for messages
  std::string clip;                                  // name of the clip, may be empty
  double duration = 0;                               // [s] time of the last key
  double rate = 0;                                   // ticks a second as the file has it, 0 where unknown
  double unit = 1;                                   // metres per unit of the file
  Eigen::Matrix3d up = Eigen::Matrix3d::Identity();  // axes of the file to +Y up
  std::vector<AnimationNode> nodes;                  // parents before children

  // The node of that name, or of that path ("Neck/Head": a Head whose parent is a Neck; any number of leading parts may
  // be left out, and a / in front means the root). Nodes without a name are passed over, in a path as well.
  // Throws InputError if there is none (with the closest names) or several (with their paths).
  std::size_t find_node(std::string_view name_or_path) const;

  // World matrix of a node at a time [s] of the clip, in the file's own units and axes: linear translation and scale,
  // shortest-arc slerp, keys held outside their range.
  Eigen::Matrix4d world(std::size_t node, double time) const;

  // The rigid part of world(), from the node's own axes (as the file has them) to the world in metres with +Y up. The
  // rotation is the one nearest to world() (polar decomposition: scale and shear are gone); a mirrored matrix is first
  // turned inside out, so that pose(t) * pose(rest)^-1 is the motion in that case too.
  // Throws InputError where the node is squashed flat or not finite.
  Eigen::Isometry3d pose(std::size_t node, double time) const;
};

struct AnimationOptions {
  // Name of the clip, or a part of it between separators ("Dance" for "Robot_Dance") if only one clip has it, or its
  // number from 1 ("#2"); empty: the only one (an ambiguity is an error, none at all leaves every node at rest).
  std::string clip;
  std::string units;  // as metres_per_unit(); empty: what the file says, else metres
  std::string up;     // as to_y_up(); empty: what the file says, else +Y
};

// Reads glTF 2.0 (text and GLB), FBX, BVH and Collada through assimp; the content decides, not the name.
// Units and axes: glTF is metres, +Y up; FBX and Collada say theirs; BVH says nothing and counts as metres, +Y up.
// Warns where key types were flattened (STEP and CUBICSPLINE of glTF), where the file has no frame rate (25 ticks a
// second are assumed) or no units, where a file has no clip, where keys had to be sorted, dropped or could not be
// placed. Throws InputError for files that are missing or cannot be read, for keys that are not finite, for a clip that
// is not there (with the clips that are).
Animation read_animation(const std::filesystem::path& path, const AnimationOptions& options, Warnings& warnings);

// The same from the bytes of a file; buffers that a glTF keeps in other files are looked up beside `path`.
Animation parse_animation(std::string_view bytes, const std::filesystem::path& path, const AnimationOptions& options,
                          Warnings& warnings);

}  // namespace strandbake
