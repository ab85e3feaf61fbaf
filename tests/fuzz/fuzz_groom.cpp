// libFuzzer target for the groom readers. The first byte picks the format, the rest is the file.
#include <cmath>
#include <cstdlib>
#include <span>

#include "formats/groom_file.h"

// What the rest of the program relies on in a groom that was read.
static bool is_sound(const strandbake::Groom& groom) {
  if (groom.strand_count() == 0 || groom.offset.front() != 0 || groom.offset.back() != groom.vertex_count())
    return false;
  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    if (groom.offset[strand + 1] < groom.offset[strand] + 2) return false;
  }
  for (const Eigen::Vector3d& p : groom.position) {
    if (!p.cast<float>().allFinite()) return false;
  }
  return (groom.pinned.empty() || groom.pinned.size() == groom.vertex_count()) &&
         (groom.root_uv.empty() || groom.root_uv.size() == groom.strand_count()) && groom.region.empty();
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const auto format = static_cast<strandbake::GroomFormat>(data[0] % 3);
  strandbake::Warnings warnings;
  try {
    if (!is_sound(strandbake::parse_groom(format, std::as_bytes(std::span(data + 1, size - 1)), "fuzz", warnings)))
      std::abort();
  } catch (const strandbake::InputError&) {
  }
  return 0;
}
