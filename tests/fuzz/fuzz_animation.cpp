// Any bytes as an animation file. glTF and BVH go all the way, since the guard leaves nothing to the importer's luck;
// FBX and Collada stop behind the guard, for beyond it one would find faults of assimp's parsers and not ours.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "formats/animation.h"
#include "formats/animation_guard.h"

namespace {

void demand(bool holds) {
  if (!holds) std::abort();
}

template <class T>
void check(const strandbake::Keys<T>& keys, double duration) {
  demand(keys.time.size() == keys.value.size());
  for (std::size_t k = 0; k < keys.time.size(); ++k) {
    demand(std::isfinite(keys.time[k]) && keys.time[k] <= duration);
    demand(k == 0 || keys.time[k - 1] < keys.time[k]);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace strandbake;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  Warnings warnings;
  try {
    const AnimationKind kind = guard_animation(bytes, "fuzz", warnings).kind;
    if (kind != AnimationKind::gltf && kind != AnimationKind::bvh) return 0;
    const Animation a = parse_animation(bytes, "fuzz", {"#1", "", ""}, warnings);
    for (std::size_t n = 0; n < a.nodes.size(); ++n) {
      const AnimationNode& node = a.nodes[n];
      demand(node.parent < static_cast<int>(n));
      check(node.translation, a.duration);
      check(node.rotation, a.duration);
      check(node.scale, a.duration);
      for (const auto& q : node.rotation.value) demand(std::abs(q.norm() - 1) < 1e-12);
    }
    // The last node has the longest way to the root more often than not.
    for (const double time : {-1.0, 0.0, 0.5 * a.duration, a.duration}) {
      demand(a.pose(a.nodes.size() - 1, time).matrix().allFinite());
    }
  } catch (const InputError&) {
    // how bad input is meant to end
  }
  return 0;
}
