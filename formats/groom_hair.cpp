// Cem Yuksel's .hair, http://www.cemyuksel.com/research/hairmodels/: a header of 128 bytes, then an array per flag.
//
//   0 char[4] "HAIR"     4 u32 strands             8 u32 points      12 u32 flags
//   16 u32 default segments   20 f32 thickness   24 f32 transparency   28 f32[3] colour   40 char[88] info
//   u16 segments[strands]  f32 points[3 points]  f32 thickness[points]  f32 transparency[points]  f32 colours[3 points]
#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <limits>
#include <vector>

#include "formats/groom_file.h"
#include "formats/groom_parse.h"

namespace strandbake {
namespace {

constexpr std::uint64_t header_size = 128;
constexpr std::uint32_t has_segments = 1, has_points = 2, has_thickness = 4, has_transparency = 8, has_colours = 16;

void append(std::vector<char>& bytes, const void* data, std::size_t size) {
  const char* first = static_cast<const char*>(data);
  bytes.insert(bytes.end(), first, first + size);
}
template <class T>
void append(std::vector<char>& bytes, T value) {
  append(bytes, &value, sizeof(value));
}

std::vector<char> hair_bytes(const Groom& groom, const std::string& name) {
  if (groom.strand_count() == 0) throw InputError(fmt::format("{}: a groom without strands is not written", name));
  if (groom.vertex_count() > std::numeric_limits<std::uint32_t>::max()) {
    throw InputError(fmt::format("{}: .hair holds at most 4294967295 vertices, and the groom has {}; split it", name,
                                 groom.vertex_count()));
  }
  std::vector<char> bytes;
  bytes.reserve(header_size + 2 * groom.strand_count() + 12 * groom.vertex_count());
  append(bytes, "HAIR", 4);
  append(bytes, static_cast<std::uint32_t>(groom.strand_count()));
  append(bytes, static_cast<std::uint32_t>(groom.vertex_count()));
  append(bytes, has_segments | has_points);
  append(bytes, std::uint32_t{0});                                   // default segments: each strand has its own
  for (const float v : {1.f, 0.f, 1.f, 1.f, 1.f}) append(bytes, v);  // thickness, transparency, colour
  char info[88] = "Strandbake";
  append(bytes, info, sizeof(info));

  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    const std::size_t vertices = groom.vertex_count(strand);
    detail::require_two_vertices(name, strand, vertices);
    if (vertices > 65536) {
      throw InputError(fmt::format("{}: strand {} has {} vertices, and .hair holds at most 65536 in a strand; cut it",
                                   name, strand, vertices));
    }
    append(bytes, static_cast<std::uint16_t>(vertices - 1));
  }
  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    for (std::size_t vertex = groom.offset[strand]; vertex < groom.offset[strand + 1]; ++vertex) {
      for (const double x : groom.position[vertex]) {
        if (!(std::abs(x) <= std::numeric_limits<float>::max())) {
          throw InputError(fmt::format("{}: strand {}, vertex {}: {} is no coordinate that .hair can hold", name,
                                       strand, vertex - groom.offset[strand], x));
        }
        append(bytes, static_cast<float>(x));
      }
    }
  }
  return bytes;
}

// A file under a name of its own that becomes `target` with commit(), or disappears.
class TemporaryFile {
 public:
  explicit TemporaryFile(const std::filesystem::path& target)
      : target_(target), path_(target.string() + "." + std::to_string(::getpid()) + ".part") {
    descriptor_ = ::open(path_.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (descriptor_ < 0) fail("created");
  }
  ~TemporaryFile() {
    if (descriptor_ >= 0) ::close(descriptor_);
    if (!committed_) ::unlink(path_.c_str());
  }
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;

  void write(std::span<const char> bytes) {
    while (!bytes.empty()) {
      const ssize_t written = ::write(descriptor_, bytes.data(), bytes.size());
      if (written < 0 && errno == EINTR) continue;
      if (written < 0) fail("written");
      bytes = bytes.subspan(static_cast<std::size_t>(written));
    }
  }

  void commit() {
    if (::fsync(descriptor_) != 0) fail("written");
    const int closed = ::close(descriptor_);
    descriptor_ = -1;
    if (closed != 0) fail("written");
    if (::rename(path_.c_str(), target_.c_str()) != 0) fail("put in its place");
    committed_ = true;
  }

 private:
  [[noreturn]] void fail(const char* deed) {
    const std::string reason = std::strerror(errno);
    throw DiskError(fmt::format("{}: cannot be {}: {}", target_.string(), deed, reason));
  }

  std::filesystem::path target_;
  std::string path_;
  int descriptor_ = -1;
  bool committed_ = false;
};

}  // namespace

Groom detail::parse_hair(const FileBytes& file, Warnings& warnings) {
  const std::string_view magic = "HAIR";
  for (std::uint64_t k = 0; k < magic.size(); ++k) {
    if (file.get<char>(k) != magic[k])
      file.fail(k, "a .hair file begins with the letters HAIR; this is another format");
  }
  file.require(0, header_size, 1, "the header");
  const auto strands = file.get<std::uint32_t>(4);
  const auto points = file.get<std::uint32_t>(8);
  const auto flags = file.get<std::uint32_t>(12);
  const std::uint64_t default_segments = file.get<std::uint32_t>(16);
  if (strands == 0) file.fail(4, "the file has no strands");
  if ((flags & has_points) == 0) file.fail(12, "the flags name no points, so there is nothing to read");

  std::uint64_t end = header_size;
  const std::uint64_t segments_at = end;
  if (flags & has_segments) end = file.require(end, strands, 2, "the segment counts");
  const std::uint64_t points_at = end;
  end = file.require(end, points, 12, "the points");
  if (flags & has_thickness) end = file.require(end, points, 4, "the thickness");
  if (flags & has_transparency) end = file.require(end, points, 4, "the transparency");
  if (flags & has_colours) end = file.require(end, points, 12, "the colours");

  const auto segments = [&](std::uint64_t strand) {
    return flags & has_segments ? file.get<std::uint16_t>(segments_at + 2 * strand) : default_segments;
  };
  // Without counts in the file nothing bounds `strands` yet, so the sum is a product (below 2^64) and not a loop.
  std::uint64_t sum = strands * (default_segments + 1);
  if (flags & has_segments) {
    sum = 0;
    for (std::uint64_t strand = 0; strand < strands; ++strand) {
      require_two_vertices(file.name(), strand, segments(strand) + 1);
      sum += segments(strand) + 1;
    }
  } else {
    require_two_vertices(file.name(), 0, default_segments + 1);
  }
  if (sum != points) {
    file.fail(8,
              fmt::format("the file has {} points, but the segments of its {} strands make {}", points, strands, sum));
  }

  Groom groom;
  groom.offset.reserve(std::uint64_t{strands} + 1);
  for (std::uint64_t strand = 0; strand < strands; ++strand) {
    groom.offset.push_back(groom.offset.back() + segments(strand) + 1);
  }
  groom.position.reserve(points);
  for (std::uint64_t at = points_at; groom.position.size() < points; at += 12) {
    groom.position.emplace_back(file.get<float>(at), file.get<float>(at + 4), file.get<float>(at + 8));
  }
  warn_of_extra_bytes(file, end, warnings);
  return groom;
}

void write_hair(const std::filesystem::path& path, const Groom& groom) {
  const std::vector<char> bytes = hair_bytes(groom, path.string());
  std::error_code error;
  // A link keeps pointing at what it names; a device or a folder is not replaced by a file.
  const std::filesystem::path linked = std::filesystem::canonical(path, error);
  const std::filesystem::path target = error ? path : linked;
  if (std::filesystem::exists(target, error) && !std::filesystem::is_regular_file(target, error)) {
    throw DiskError(fmt::format("{}: is not a file that can be replaced; name another", path.string()));
  }
  TemporaryFile file(target);
  file.write(bytes);
  file.commit();
}

}  // namespace strandbake
