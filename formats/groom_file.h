// Groom files: Cem Yuksel .hair, TressFX .tfx 3.x and 4.x, OBJ polylines.
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>

#include "formats/error.h"
#include "sim/groom.h"

namespace strandbake {

enum class GroomFormat { Hair, Tfx, Obj };

// By the file's first bytes where they tell (.hair), else by its extension. Throws InputError for any other file.
GroomFormat detect_groom_format(const std::filesystem::path& path, std::span<const std::byte> bytes);

// Reads a groom in the file's own units and axes. `region` stays empty.
//   .tfx  vertices with w = 0 (4.x) or both ends of each strand (3.x, where the file says so) are `pinned`; strand UVs
//         become `root_uv`. Follow hairs are not made; a warning tells how many the file asks for.
//   .obj  a polyline element is a strand. Two-index elements that follow each other end to start (l 1 2, l 2 3) are one
//         strand, unless an `o` or `g` stands between them. Faces and points are left out, with a warning.
// Throws InputError for a file that is missing, truncated, foreign or lying about its counts, for a file without
// strands, for a strand of fewer than two vertices (with its number, counted from 0), and for a NaN, an infinity or a
// coordinate beyond float32 (with strand and vertex). Coincident neighbours are kept; a warning counts them. So are
// bytes after the end of the groom.
Groom read_groom(const std::filesystem::path& path, Warnings& warnings);

// The same from bytes; `name` stands for the file in messages. For tests and fuzzing.
Groom parse_groom(GroomFormat format, std::span<const std::byte> bytes, const std::string& name, Warnings& warnings);

// Writes `.hair`: positions as float32, segment counts as u16; `pinned`, `root_uv` and `region` have no place in it.
// Replaces `path` only once the file is complete; on failure the old file stays and nothing is left beside it.
// Throws DiskError; InputError for a groom that the format cannot say or read_groom() would refuse: no strands, a
// strand of fewer than 2 or more than 65,536 vertices, more than 4,294,967,295 vertices in all, a coordinate beyond
// float32.
void write_hair(const std::filesystem::path& path, const Groom& groom);

}  // namespace strandbake
