// A groom: every polyline of a hairstyle in one flat, strand-major array.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace strandbake {

struct Groom {
  // Vertices of strand s are offset[s] .. offset[s + 1] - 1, root first; size strands + 1, offset[0] = 0.
  std::vector<std::uint64_t> offset = {0};
  // Rest position of each vertex [m] in the world of the rest frame. (Readers of groom files fill in the file's own
  // units and axes; the scene converts.)
  std::vector<Eigen::Vector3d> position;
  // 1 where a vertex follows the head and is not simulated, else 0. Empty: the first two of each strand. The first two
  // are pinned in any case (paper, section 3.2).
  std::vector<std::uint8_t> pinned;
  // Scalp coordinates of each strand's root; empty where the source has none.
  std::vector<Eigen::Vector2f> root_uv;
  // Region of each strand, an index into the regions of the scene; empty: all in region 0.
  std::vector<std::uint32_t> region;

  std::size_t strand_count() const { return offset.size() - 1; }
  std::size_t vertex_count() const { return position.size(); }
  std::size_t vertex_count(std::size_t strand) const { return offset[strand + 1] - offset[strand]; }
};

}  // namespace strandbake
