// The overrides of a command line, put into a scene before it is read. Part of the scene reader.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "formats/toml_tree.h"

namespace strandbake {

// Called with the index of the override at fault and a sentence.
using OverrideFault = std::function<void(std::size_t, const std::string&)>;

// Writes "bake.fps=30", "region.tail.damping=0.2" or "collider[0].sphere.radius=0.1" into the tree, the later one last.
// Keys that nobody knows are written too: the reader finds them. `lists` are the dotted paths that hold lists.
void apply_overrides(TomlNode& root, const std::vector<std::string>& overrides, const std::vector<std::string>& lists,
                     const OverrideFault& fault);

}  // namespace strandbake
