#include "formats/groom_file.h"

#include <cerrno>
#include <cmath>
#include <fstream>
#include <limits>
#include <vector>

#include "formats/groom_parse.h"

namespace strandbake {
namespace {

std::string_view as_text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

std::vector<std::byte> read_bytes(const std::filesystem::path& path) {
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::status(path, error);
  if (!std::filesystem::exists(status)) throw InputError(fmt::format("{}: there is no such file", path.string()));
  if (!std::filesystem::is_regular_file(status)) throw InputError(fmt::format("{}: is not a file", path.string()));
  errno = 0;
  std::ifstream in(path, std::ios::binary | std::ios::ate);
  std::vector<std::byte> bytes;
  if (const std::streamoff size = in.tellg(); in && size > 0) {
    bytes.resize(static_cast<std::size_t>(size));
    in.seekg(0);
    in.read(reinterpret_cast<char*>(bytes.data()), size);
  }
  if (!in) throw InputError(fmt::format("{}: cannot be read: {}", path.string(), std::strerror(errno)));
  return bytes;
}

// True where float32 cannot tell the direction from a to b: they are within four of its steps in every coordinate.
bool coincide(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  const double step = std::numeric_limits<float>::epsilon() * a.cwiseAbs().cwiseMax(b.cwiseAbs()).maxCoeff();
  return (b - a).cwiseAbs().maxCoeff() <= 4 * step;
}

}  // namespace

void detail::require_two_vertices(const std::string& place, std::uint64_t strand, std::uint64_t vertices) {
  if (vertices < 2) {
    throw InputError(fmt::format("{}: strand {} has {}; a strand needs two vertices", place, strand,
                                 vertices == 0 ? "no vertex" : "one vertex"));
  }
}

void detail::warn_of_extra_bytes(const FileBytes& file, std::uint64_t end, Warnings& warnings) {
  if (end < file.size()) {
    warnings.push_back(fmt::format("{}: byte {}: the groom ends here; {} bytes behind it are left out", file.name(),
                                   end, file.size() - end));
  }
}

void detail::check_positions(Groom& groom, const std::string& name, Warnings& warnings) {
  std::uint64_t coincident = 0;
  std::uint64_t first_strand = 0;
  for (std::uint64_t strand = 0; strand < groom.strand_count(); ++strand) {
    for (std::uint64_t v = groom.offset[strand]; v < groom.offset[strand + 1]; ++v) {
      Eigen::Vector3d& p = groom.position[v];
      for (double& x : p) {
        if (!(std::abs(x) <= std::numeric_limits<float>::max())) {
          throw InputError(fmt::format("{}: strand {}, vertex {}: {} is no coordinate; a finite float32 is needed",
                                       name, strand, v - groom.offset[strand], x));
        }
        x += 0.0;  // -0 + 0 = 0
      }
      if (v > groom.offset[strand] && coincide(groom.position[v - 1], p)) {
        if (coincident == 0) first_strand = strand;
        ++coincident;
      }
    }
  }
  if (coincident != 0) {
    warnings.push_back(fmt::format(
        "{}: {} segments are shorter than float32 can tell, as their ends coincide; the first is in strand {}", name,
        coincident, first_strand));
  }
}

GroomFormat detect_groom_format(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  if (as_text(bytes).starts_with("HAIR")) return GroomFormat::Hair;
  std::string extension = path.extension().string();
  for (char& c : extension) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  if (extension == ".hair") return GroomFormat::Hair;
  if (extension == ".tfx") return GroomFormat::Tfx;
  if (extension == ".obj") return GroomFormat::Obj;
  throw InputError(fmt::format("{}: is no groom that can be read; .hair, .tfx and .obj files can", path.string()));
}

Groom parse_groom(GroomFormat format, std::span<const std::byte> bytes, const std::string& name, Warnings& warnings) {
  const detail::FileBytes file(bytes, name);
  Groom groom = format == GroomFormat::Hair  ? detail::parse_hair(file, warnings)
                : format == GroomFormat::Tfx ? detail::parse_tfx(file, warnings)
                                             : detail::parse_obj(as_text(bytes), name, warnings);
  detail::check_positions(groom, name, warnings);
  return groom;
}

Groom read_groom(const std::filesystem::path& path, Warnings& warnings) {
  const std::vector<std::byte> bytes = read_bytes(path);
  return parse_groom(detect_groom_format(path, bytes), bytes, path.string(), warnings);
}

}  // namespace strandbake
