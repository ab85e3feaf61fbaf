// TressFX .tfx, versions 3.x and 4.x: strands of one vertex count, strand-major, root first. All offsets from the
// start.
//
//   4.x, 160 bytes: 0 f32 version  4 u32 strands  8 u32 vertices per strand  12 u32 offsets of positions (float4, w = 0
//        pinned), strand UV (f32[2]; 0 = none), vertex UV, thickness, colour  32 u32 reserved[32]
//   3.x, 296 bytes: 0 f32 version  4 u32 guides   8 u32 vertices per strand  12 u32 follow hairs per guide
//        16 u32 both ends fixed  20 u32 reserved[31]  144 u32 offsets of positions (float3), thickness, strand UV
//        (f32[2]; 0 = none), colour, guide index, vertex UV  168 u32 reserved[32]
#include <algorithm>
#include <cmath>
#include <vector>

#include "formats/groom_parse.h"

namespace strandbake {
namespace {

// What differs between the versions.
struct Layout {
  std::uint64_t header_size;
  std::uint64_t floats;     // per position
  std::uint64_t positions;  // where their offset is found, and so on
  std::uint64_t strand_uv;
  std::vector<std::uint64_t> unread;
};
const Layout version_3 = {296, 3, 144, 152, {148, 156, 160, 164}};
const Layout version_4 = {160, 4, 12, 16, {20, 24, 28}};

// Keeps `pinned` only where it says more than the first two of each strand, which are pinned in any case.
void keep_pinned_if_needed(Groom& groom, std::uint64_t vertices) {
  bool needed = false;
  for (std::uint64_t v = 0; v < groom.pinned.size(); ++v) {
    if (v % vertices < 2) {
      groom.pinned[v] = 1;
    } else if (groom.pinned[v]) {
      needed = true;
    }
  }
  if (!needed) groom.pinned = {};
}

}  // namespace

Groom detail::parse_tfx(const FileBytes& file, Warnings& warnings) {
  const auto version = file.get<float>(0);
  if (!(version >= 3 && version < 5)) {
    file.fail(0, fmt::format("a .tfx file begins with its version, 3.x or 4.x; this one begins with {}", version));
  }
  const bool is_3 = version < 4;
  const Layout& layout = is_3 ? version_3 : version_4;
  file.require(0, layout.header_size, 1, "the header");
  const auto strands = file.get<std::uint32_t>(4);
  const auto vertices = file.get<std::uint32_t>(8);
  if (strands == 0) file.fail(4, "the file has no strands");
  require_two_vertices(file.name(), 0, vertices);

  // Where the array starts that the header names at `field`.
  const auto start_of = [&](std::uint64_t field) {
    const std::uint64_t start = file.get<std::uint32_t>(field);
    if (start < layout.header_size || start > file.size()) {
      file.fail(field,
                fmt::format("an array is said to start at byte {}, but arrays lie between the end of the header at "
                            "byte {} and the end of the file at byte {}",
                            start, layout.header_size, file.size()));
    }
    return start;
  };
  const std::uint64_t count = std::uint64_t{strands} * vertices;
  const std::uint64_t stride = 4 * layout.floats;
  const std::uint64_t positions_at = start_of(layout.positions);
  std::uint64_t end = file.require(positions_at, count, stride, "the positions");

  Groom groom;
  groom.offset.reserve(std::uint64_t{strands} + 1);
  for (std::uint64_t strand = 1; strand <= strands; ++strand) groom.offset.push_back(strand * vertices);
  groom.position.reserve(count);
  for (std::uint64_t v = 0; v < count; ++v) {
    const std::uint64_t at = positions_at + v * stride;
    groom.position.emplace_back(file.get<float>(at), file.get<float>(at + 4), file.get<float>(at + 8));
  }

  if (is_3) {
    if (file.get<std::uint32_t>(16) != 0) {
      groom.pinned.assign(count, 0);
      for (std::uint64_t v = 0; v < count; ++v) groom.pinned[v] = v % vertices + 2 >= vertices;
    }
    if (const auto follow = file.get<std::uint32_t>(12)) {
      warnings.push_back(
          fmt::format("{}: {} follow hairs for each of the {} guides are left out, {} in all; only guides are read",
                      file.name(), follow, strands, std::uint64_t{follow} * strands));
    }
  } else {
    groom.pinned.reserve(count);
    for (std::uint64_t v = 0; v < count; ++v) {
      const std::uint64_t at = positions_at + v * stride + 12;
      const auto w = file.get<float>(at);
      if (!std::isfinite(w)) {
        file.fail(at, fmt::format("strand {}, vertex {}: w is {}; it says 0 for a pinned vertex and 1 for a free one",
                                  v / vertices, v % vertices, w));
      }
      groom.pinned.push_back(!(w > 0));
    }
  }
  keep_pinned_if_needed(groom, vertices);

  if (file.get<std::uint32_t>(layout.strand_uv) != 0) {
    const std::uint64_t uv_at = start_of(layout.strand_uv);
    end = std::max(end, file.require(uv_at, strands, 8, "the strand UVs"));
    groom.root_uv.reserve(strands);
    for (std::uint64_t strand = 0; strand < strands; ++strand) {
      const std::uint64_t at = uv_at + 8 * strand;
      const Eigen::Vector2f uv(file.get<float>(at), file.get<float>(at + 4));
      if (!uv.allFinite()) file.fail(at, fmt::format("the UV of strand {} is not a finite number", strand));
      groom.root_uv.push_back(uv);
    }
  }

  // Arrays that are not read may lie anywhere behind the header; only where there are none is the end of the file
  // known.
  bool has_unread = false;
  for (const std::uint64_t field : layout.unread) {
    if (file.get<std::uint32_t>(field) != 0) {
      start_of(field);
      has_unread = true;
    }
  }
  if (!has_unread) warn_of_extra_bytes(file, end, warnings);
  return groom;
}

}  // namespace strandbake
