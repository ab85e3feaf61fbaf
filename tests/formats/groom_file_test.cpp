#include "formats/groom_file.h"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <catch2/catch.hpp>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <optional>
#include <string>
#include <vector>

using namespace strandbake;
namespace fs = std::filesystem;

namespace {

constexpr float nan_value = std::numeric_limits<float>::quiet_NaN();
constexpr float infinity = std::numeric_limits<float>::infinity();

// A file under construction.
class Bytes {
 public:
  Bytes() = default;
  Bytes(const std::string& text) { add(text.data(), text.size()); }
  Bytes(const char* text) : Bytes(std::string(text)) {}

  template <class T>
  Bytes& operator<<(T value) {
    add(&value, sizeof(value));
    return *this;
  }
  Bytes& zeros(std::size_t count) {
    bytes_.resize(bytes_.size() + count);
    return *this;
  }
  template <class T>
  Bytes& at(std::size_t offset, T value) {
    std::memcpy(bytes_.data() + offset, &value, sizeof(value));
    return *this;
  }
  std::size_t size() const { return bytes_.size(); }
  // In memory of its own, so that a sanitizer sees any read past the end.
  std::vector<std::byte> first(std::size_t count) const {
    return {bytes_.begin(), bytes_.begin() + static_cast<std::ptrdiff_t>(count)};
  }

 private:
  void add(const void* data, std::size_t size) {
    const auto* first = static_cast<const std::byte*>(data);
    bytes_.insert(bytes_.end(), first, first + size);
  }
  std::vector<std::byte> bytes_;
};

Groom parse(GroomFormat format, const Bytes& file, Warnings& warnings) {
  return parse_groom(format, file.first(file.size()), "x", warnings);
}
// For files that give no cause for a warning.
Groom parse(GroomFormat format, const Bytes& file) {
  Warnings warnings;
  Groom groom = parse(format, file, warnings);
  CHECK(warnings.empty());
  return groom;
}

// The message with which a file is refused; empty where it is not.
std::string refusal(GroomFormat format, const Bytes& file) {
  Warnings warnings;
  try {
    parse(format, file, warnings);
  } catch (const InputError& error) {
    return error.what();
  }
  return {};
}

using Catch::Contains;
using Points = std::vector<Eigen::Vector3d>;
using Offsets = std::vector<std::uint64_t>;

// Two strands of 2 and 3 vertices, all arrays.
Bytes hair_file() {
  Bytes file("HAIR");
  file << 2u << 5u << 31u << 0u << 1.f << 0.f << 1.f << 1.f << 1.f;
  file.zeros(88) << std::uint16_t{1} << std::uint16_t{2};
  for (int k = 0; k < 15; ++k) file << static_cast<float>(k) * 0.5f;
  return file.zeros(5 * 4 + 5 * 4 + 5 * 12);
}
constexpr std::size_t hair_points_at = 128 + 4;

// Two strands of three vertices with UVs.
Bytes tfx4_file() {
  Bytes file;
  file << 4.f << 2u << 3u << 160u << 256u << 0u << 0u << 0u;
  file.zeros(128);
  for (int v = 0; v < 6; ++v) {
    file << static_cast<float>(v) << 1.f << 2.f << (v % 3 < 2 ? 0.f : 1.f);
  }
  return file << 0.25f << 0.5f << 0.75f << 1.f;
}

// Two guides of five vertices with UVs.
Bytes tfx3_file() {
  Bytes file;
  file << 3.f << 2u << 5u << 0u << 0u;
  file.zeros(124) << 296u << 0u << 416u << 0u << 0u << 0u;
  file.zeros(128);
  for (int v = 0; v < 10; ++v) file << static_cast<float>(v) << 1.f << 2.f;
  return file << 0.25f << 0.5f << 0.75f << 1.f;
}

// A folder of its own that is gone at the end.
class Folder {
 public:
  Folder() {
    std::string name = (fs::temp_directory_path() / "strandbake-XXXXXX").string();
    REQUIRE(mkdtemp(name.data()) != nullptr);
    path_ = name;
  }
  ~Folder() { fs::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;
  fs::path operator/(const char* name) const { return path_ / name; }
  std::size_t entries() const {
    return static_cast<std::size_t>(std::distance(fs::directory_iterator(path_), fs::directory_iterator()));
  }

 private:
  fs::path path_;
};

std::string content(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Groom small_groom() {
  Groom groom;
  groom.offset = {0, 2, 5};
  groom.position = {{0, 0, 0}, {0, 1, 0}, {0.5, 0, 0}, {0.5, 1, 0}, {0.5, 1, 0.25}};
  return groom;
}

// The folder of real grooms, if there is one.
std::optional<fs::path> assets() {
  fs::path folder;
  if (const char* name = std::getenv("STRANDBAKE_ASSETS")) {
    folder = name;
  } else {
#ifdef STRANDBAKE_ASSETS
    folder = STRANDBAKE_ASSETS;
#endif
  }
  if (!folder.empty() && fs::is_directory(folder)) return folder;
  WARN("skipped: the folder of real grooms is not here; STRANDBAKE_ASSETS can name it");
  return std::nullopt;
}

}  // namespace

TEST_CASE("a .hair file with every array is read") {
  const Groom groom = parse(GroomFormat::Hair, hair_file());
  CHECK(groom.offset == Offsets{0, 2, 5});
  CHECK(groom.position == Points{{0, 0.5, 1}, {1.5, 2, 2.5}, {3, 3.5, 4}, {4.5, 5, 5.5}, {6, 6.5, 7}});
  CHECK(groom.pinned.empty());
  CHECK(groom.root_uv.empty());
  CHECK(groom.region.empty());
}

TEST_CASE("a .hair file without segment counts uses the default") {
  Bytes file("HAIR");
  file << 3u << 6u << 2u << 1u;
  file.zeros(108);
  for (int k = 0; k < 18; ++k) file << static_cast<float>(k);
  CHECK(parse(GroomFormat::Hair, file).offset == Offsets{0, 2, 4, 6});
}

TEST_CASE("a .hair file without points is refused") {
  Bytes file = hair_file();
  CHECK_THAT(refusal(GroomFormat::Hair, file.at(12, 1u)), Contains("x: byte 12") && Contains("points"));
}

TEST_CASE("a .hair file whose counts disagree is refused") {
  SECTION("points") {
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(8, 4u)), Contains("4 points") && Contains("make 5"));
  }
  SECTION("strands") {
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(4, 1u)), Contains("byte 8"));
  }
  SECTION("segments") {
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(128, std::uint16_t{65535})), Contains("make 65539"));
  }
  SECTION("no strands") {
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(4, 0u)), Contains("byte 4") && Contains("no strands"));
  }
}

TEST_CASE("counts far beyond the file are refused before memory is taken") {
  for (const std::uint32_t huge : {0x10000u, 0x7fffffffu, 0x80000000u, 0xffffffffu}) {
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(4, huge)),
               Contains("x: byte 128") && Contains("ends at byte"));
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(8, huge)),
               Contains("x: byte 132") && Contains("ends at byte"));
    for (const std::uint32_t other : {3u, huge}) {
      CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(4, huge).at(8, other)), Contains("x: byte 160"));
      CHECK_THAT(refusal(GroomFormat::Tfx, tfx3_file().at(4, huge).at(8, other)), Contains("x: byte 296"));
      CHECK_THAT(refusal(GroomFormat::Tfx, tfx3_file().at(4, other).at(8, huge)), Contains("x: byte 296"));
    }
    // Without segment counts there is no array to compare the strands with. A loop over them would take minutes.
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(4, huge).at(12, 2u).at(16, 1u)), Contains("x: byte 8"));
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(4, huge).at(12, 2u).at(16, huge)), Contains("x: byte 8"));
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(12, 2u).at(16, huge)), Contains("x: byte 8"));
  }
}

TEST_CASE("a .tfx 4.x file is read") {
  const Groom groom = parse(GroomFormat::Tfx, tfx4_file());
  CHECK(groom.offset == Offsets{0, 3, 6});
  CHECK(groom.position == Points{{0, 1, 2}, {1, 1, 2}, {2, 1, 2}, {3, 1, 2}, {4, 1, 2}, {5, 1, 2}});
  CHECK(groom.pinned.empty());  // as the first two of each strand
  REQUIRE(groom.root_uv.size() == 2);
  CHECK(groom.root_uv[1] == Eigen::Vector2f(0.75f, 1));
  CHECK(parse(GroomFormat::Tfx, tfx4_file().at(0, 4.1f)).position == groom.position);
}

TEST_CASE("w of a .tfx 4.x file pins beyond the first two vertices") {
  const std::vector<std::uint8_t> pinned = {1, 1, 0, 1, 1, 1};
  CHECK(parse(GroomFormat::Tfx, tfx4_file().at(160 + 5 * 16 + 12, 0.f)).pinned == pinned);
  // A file that leaves the second vertex free says nothing that matters: it is pinned in any case.
  CHECK(parse(GroomFormat::Tfx, tfx4_file().at(160 + 16 + 12, 1.f)).pinned.empty());
  CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(160 + 4 * 16 + 12, nan_value)),
             Contains("strand 1, vertex 1") && Contains("byte 236"));
}

TEST_CASE("a .tfx 4.x file without strand UVs has none") {
  const Bytes file = Bytes(tfx4_file()).at(16, 0u);
  Warnings warnings;
  CHECK(parse(GroomFormat::Tfx, file, warnings).root_uv.empty());
  CHECK(warnings.size() == 1);  // the UVs are extra bytes now
}

TEST_CASE("a .tfx 3.x file is read") {
  const Groom groom = parse(GroomFormat::Tfx, tfx3_file());
  CHECK(groom.offset == Offsets{0, 5, 10});
  CHECK(groom.position.front() == Eigen::Vector3d(0, 1, 2));
  CHECK(groom.position.back() == Eigen::Vector3d(9, 1, 2));
  CHECK(groom.pinned.empty());
  REQUIRE(groom.root_uv.size() == 2);
  CHECK(groom.root_uv[0] == Eigen::Vector2f(0.25f, 0.5f));
}

TEST_CASE("both ends fixed pins the last two vertices as well as the first two") {
  const std::vector<std::uint8_t> pinned = {1, 1, 0, 1, 1, 1, 1, 0, 1, 1};
  CHECK(parse(GroomFormat::Tfx, tfx3_file().at(16, 1u)).pinned == pinned);
}

TEST_CASE("follow hairs are left out with a warning that counts them") {
  Warnings warnings;
  CHECK(parse(GroomFormat::Tfx, tfx3_file().at(12, 4u), warnings).strand_count() == 2);
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings[0], Contains("4 follow hairs") && Contains("8 in all"));
}

TEST_CASE("a .tfx file of another version is refused") {
  for (const float version : {0.f, 2.9f, 5.f, -3.f, nan_value, infinity}) {
    CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(0, version)), Contains("x: byte 0") && Contains("3.x or 4.x"));
  }
}

TEST_CASE("a .tfx array that starts in the header or behind the file is refused") {
  for (const std::uint32_t start : {0u, 12u, 159u, 5000u, 0xffffffffu}) {
    INFO(start);
    CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(12, start)), Contains("x: byte 12"));
    if (start != 0) {
      CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(16, start)), Contains("x: byte 16"));
      CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(24, start)), Contains("x: byte 24"));
    }
    CHECK_THAT(refusal(GroomFormat::Tfx, tfx3_file().at(144, start)), Contains("x: byte 144"));
  }
}

TEST_CASE("an OBJ polyline of many indices is a strand") {
  const Groom groom = parse(GroomFormat::Obj, "# hair\nv 0 0 0\nv 0 1 0 1.0\n\nv 0 2.5e0 +1 0.1 0.2 0.3\nl 1 2 3\n");
  CHECK(groom.offset == Offsets{0, 3});
  CHECK(groom.position == Points{{0, 0, 0}, {0, 1, 0}, {0, 2.5, 1}});
  CHECK(groom.root_uv.empty());
}

TEST_CASE("OBJ indices may be negative, carry a texture index, come before their vertices and share them") {
  const Groom groom = parse(GroomFormat::Obj, "v 0 0 0\nv 1 0 0\nl -1 -2\nv 2 0 0\nl 1/7 3/8 4/9\nl 1 -1 4\nv 3 0 0\n");
  CHECK(groom.offset == Offsets{0, 2, 5, 8});
  CHECK(groom.position ==
        Points{{1, 0, 0}, {0, 0, 0}, {0, 0, 0}, {2, 0, 0}, {3, 0, 0}, {0, 0, 0}, {2, 0, 0}, {3, 0, 0}});
}

TEST_CASE("two-index OBJ elements that follow end to start are one strand") {
  const std::string vertices = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 0\n";
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2\nl 2 3\nl 3 4\n").offset == Offsets{0, 4});
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2\nl 3 4\n").offset == Offsets{0, 2, 4});
  CHECK(parse(GroomFormat::Obj, vertices + "l 2 1\nl 3 2\n").offset == Offsets{0, 2, 4});
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2\no b\nl 2 3\n").offset == Offsets{0, 2, 4});
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2\ng b\nl 2 3\n").offset == Offsets{0, 2, 4});
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2 3\nl 3 4\n").offset == Offsets{0, 3, 5});
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2\nl 2 3 4\n").offset == Offsets{0, 2, 5});
  CHECK(parse(GroomFormat::Obj, vertices + "l 1 2\n# and on\nv 9 9 9\nl 2 3\n").offset == Offsets{0, 3});
}

TEST_CASE("OBJ lines may be continued, end in CRLF, hold tabs and comments, and lack the last line end") {
  const Groom groom =
      parse(GroomFormat::Obj,
            "\xEF\xBB\xBFv 0 \\\r\n 0\\\n 0\r\n\tv\t1 0 0 # root\r\n#c:\\\r\nv 2 0 0\r\nl 1 \\\r\n2\\\r\n 3");
  CHECK(groom.position == Points{{0, 0, 0}, {1, 0, 0}, {2, 0, 0}});
}

TEST_CASE("OBJ faces and points are left out with one warning, other keywords without") {
  Warnings warnings;
  const Groom groom =
      parse(GroomFormat::Obj,
            "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nvn 0 0 1\nvt 0 0\nf 1 2 1\nf 1 1 2\np 1\ns off\nlod 3\nl 1 2\n", warnings);
  CHECK(groom.strand_count() == 1);
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings[0], Contains("3 faces and points"));
}

TEST_CASE("a fault of an OBJ file is told with its line") {
  const auto refused = [](const std::string& text) { return refusal(GroomFormat::Obj, text); };
  CHECK_THAT(refused("v 0 0\n"), Contains("x:1:") && Contains("three coordinates"));
  CHECK_THAT(refused("v 0 \\\n0 0\nv 0 0 zero\n"), Contains("x:3:") && Contains("\"zero\""));
  CHECK_THAT(refused("v 1e999 0 0\n"), Contains("x:1:") && Contains("1e999"));
  CHECK_THAT(refused("v 0 0 0\nv 1 0 0\nl 1 0\n"), Contains("x:3:") && Contains("\"0\""));
  CHECK_THAT(refused("v 0 0 0\nl 1 1.5\n"), Contains("x:2:"));
  CHECK_THAT(refused("v 0 0 0\nl 1 -2\n"), Contains("x:2:") && Contains("only 1 vertices"));
  CHECK_THAT(refused("v 0 0 0\nl 1 3\n"), Contains("x:2:") && Contains("vertex 3"));
  CHECK_THAT(refused("v 0 0 0\nl 1 9223372036854775807\n"), Contains("x:2:"));
  CHECK_THAT(refused("v 0 0 0\nl 1 -9223372036854775808\n"), Contains("x:2:"));
  CHECK_THAT(refused("v 0 0 0\nl 1 99999999999999999999\n"), Contains("x:2:"));
  CHECK_THAT(refused("v 0 0 0\nl 1\n"), Contains("x:2:") && Contains("strand 0 has one vertex"));
  CHECK_THAT(refused("v 0 0 0\nl\n"), Contains("x:2:") && Contains("no vertex"));
  CHECK_THAT(refused("v 0 0 0\n"), Contains("x:") && Contains("no polylines"));
  CHECK_THAT(refused(""), Contains("no polylines"));
  CHECK_THAT(refused(std::string("a\nb\0c", 5)), Contains("x:2:") && Contains("text"));
}

TEST_CASE("a truncated .hair file is refused at every length") {
  const Bytes file = hair_file();
  Warnings warnings;
  for (std::size_t length = 0; length < file.size(); ++length) {
    INFO(length);
    CHECK_THROWS_AS(parse_groom(GroomFormat::Hair, file.first(length), "x", warnings), InputError);
  }
}

TEST_CASE("a truncated .tfx file is refused at every length") {
  Warnings warnings;
  for (const Bytes& file : {tfx3_file(), tfx4_file()}) {
    for (std::size_t length = 0; length < file.size(); ++length) {
      INFO(length);
      CHECK_THROWS_AS(parse_groom(GroomFormat::Tfx, file.first(length), "x", warnings), InputError);
    }
  }
}

TEST_CASE("an OBJ file cut anywhere gives a groom or one sentence") {
  const Bytes file("v 0 0 0\nv 1 0 0\nv 2 0 0\nl -3/1 -2/2 -1/3\nl 1 2\nl 2 \\\r\n3");
  Warnings warnings;
  for (std::size_t length = 0; length < file.size(); ++length) {
    INFO(length);
    try {
      const Groom groom = parse_groom(GroomFormat::Obj, file.first(length), "x", warnings);
      CHECK(groom.vertex_count() >= 2);
    } catch (const InputError& error) {
      CHECK_THAT(error.what(), Contains("x:"));
    }
  }
}

TEST_CASE("bytes behind the groom are left out with a warning") {
  const auto extra = [](GroomFormat format, Bytes file, const std::string& place) {
    Warnings warnings;
    const Groom groom = parse(format, file);
    CHECK(parse(format, file.zeros(3), warnings).position == groom.position);
    REQUIRE(warnings.size() == 1);
    CHECK_THAT(warnings[0], Contains(place) && Contains("3 bytes"));
  };
  extra(GroomFormat::Hair, hair_file(), "byte 292");
  extra(GroomFormat::Tfx, tfx3_file(), "byte 432");
  extra(GroomFormat::Tfx, tfx4_file(), "byte 272");
}

TEST_CASE("foreign files are refused") {
  const std::string png("\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\1\0\0\0\1\x08\6\0\0\0", 29);
  const std::string foreign[] = {"",
                                 "H",
                                 "HAIL",
                                 png,
                                 "{\"asset\": {\"version\": \"2.0\"}}\n",
                                 std::string(4096, '\0'),
                                 std::string(4096, '\xff'),
                                 "The quick brown fox\njumps over\n"};
  for (const std::string& text : foreign) {
    INFO(text);
    for (const GroomFormat format : {GroomFormat::Hair, GroomFormat::Tfx, GroomFormat::Obj}) {
      CHECK_THAT(refusal(format, text), Contains("x:"));
    }
  }
}

TEST_CASE("a coordinate that is no finite float32 is refused with strand and vertex") {
  const auto place = Contains("strand 1, vertex 2");
  for (const float bad : {nan_value, infinity, -infinity}) {
    CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(hair_points_at + 4 * 14, bad)), place);
    CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(160 + 16 * 5 + 8, bad)), place);
    CHECK_THAT(refusal(GroomFormat::Tfx, tfx3_file().at(296 + 12 * 7, bad)), place);
  }
  for (const char* bad : {"nan", "inf", "-inf", "3.5e38"}) {
    const std::string text = "v 0 0 0\nv 1 0 0\nv 2 0 " + std::string(bad) + "\nl 1 2\nl 1 2 3\n";
    CHECK_THAT(refusal(GroomFormat::Obj, text), place);
  }
  CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(256 + 12, nan_value)),
             Contains("byte 264") && Contains("UV of strand 1"));
}

TEST_CASE("a one-vertex strand is refused with its number") {
  CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(130, std::uint16_t{0})), Contains("strand 1 has one vertex"));
  CHECK_THAT(refusal(GroomFormat::Hair, hair_file().at(12, 2u).at(16, 0u)), Contains("strand 0 has one vertex"));
  CHECK_THAT(refusal(GroomFormat::Tfx, tfx4_file().at(8, 1u)), Contains("strand 0 has one vertex"));
  CHECK_THAT(refusal(GroomFormat::Tfx, tfx3_file().at(8, 0u)), Contains("strand 0 has no vertex"));
  CHECK_THAT(refusal(GroomFormat::Obj, "v 0 0 0\nv 1 0 0\nl 1 2\nl 1\n"), Contains("strand 1 has one vertex"));
}

TEST_CASE("minus zero is read as zero") {
  const Groom binary = parse(GroomFormat::Hair, hair_file().at(hair_points_at, -0.f));
  CHECK(!std::signbit(binary.position[0].x()));
  CHECK(!std::signbit(parse(GroomFormat::Obj, "v -0 0 0\nv 1 0 0\nl 1 2\n").position[0].x()));
}

TEST_CASE("coincident neighbours are kept with one warning that counts them") {
  Warnings warnings;
  // One float32 step apart at 100 m counts as coincident; a micrometre at the origin does not.
  const Groom groom =
      parse(GroomFormat::Obj, "v 0 0 0\nv 0 1e-6 0\nv 100 0 0\nv 100.00001 0 0\nl 1 2\nl 2 3 3 4\nl 1 1\n", warnings);
  CHECK(groom.vertex_count() == 8);
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings[0], Contains("x: 3 segments") && Contains("strand 1"));
}

TEST_CASE("the format of a groom is told by its first bytes, then by its extension") {
  const std::vector<std::byte> hair = Bytes("HAIR").first(4);
  CHECK(detect_groom_format("a.bin", hair) == GroomFormat::Hair);
  CHECK(detect_groom_format("a.hair", {}) == GroomFormat::Hair);
  CHECK(detect_groom_format("a.tfx", {}) == GroomFormat::Tfx);
  CHECK(detect_groom_format("dir.obj/a.TFX", {}) == GroomFormat::Tfx);
  CHECK(detect_groom_format("a.Obj", {}) == GroomFormat::Obj);
  for (const char* name : {"a", "a.abc", "tfx", ".obj", "a.obj.gz"}) {
    CHECK_THROWS_WITH(detect_groom_format(name, {}), Contains(name) && Contains(".hair, .tfx and .obj"));
  }
}

TEST_CASE("a groom file that is missing or a folder is refused by name") {
  const Folder folder;
  Warnings warnings;
  CHECK_THROWS_WITH(read_groom(folder / "no.hair", warnings), Contains("no.hair") && Contains("no such file"));
  fs::create_directory(folder / "dir.hair");
  CHECK_THROWS_WITH(read_groom(folder / "dir.hair", warnings), Contains("dir.hair") && Contains("not a file"));
  std::ofstream(folder / "empty.hair").flush();
  CHECK_THROWS_WITH(read_groom(folder / "empty.hair", warnings), Contains("empty.hair: byte 0"));
}

TEST_CASE("a groom written as .hair is read back the same, and its bytes do not depend on anything else") {
  const Folder folder;
  const Groom groom = small_groom();
  write_hair(folder / "a.hair", groom);
  write_hair(folder / "b.hair", groom);
  Warnings warnings;
  const Groom back = read_groom(folder / "a.hair", warnings);
  CHECK(warnings.empty());
  CHECK(back.offset == groom.offset);
  CHECK(back.position == groom.position);
  const std::string bytes = content(folder / "a.hair");
  CHECK(bytes == content(folder / "b.hair"));
  CHECK(bytes.size() == 128 + 2 * 2 + 5 * 12);
  CHECK(bytes.substr(40, 88) == "Strandbake" + std::string(78, '\0'));
  CHECK(folder.entries() == 2);
}

TEST_CASE("the longest strand of .hair is written, a longer one refused") {
  const Folder folder;
  Groom groom;
  groom.offset.push_back(65'536);
  for (int v = 0; v < 65'536; ++v) groom.position.emplace_back(v, 0, 0);
  write_hair(folder / "a.hair", groom);
  Warnings warnings;
  CHECK(read_groom(folder / "a.hair", warnings).position == groom.position);

  groom.offset.back() += 1;
  groom.position.emplace_back(65'536, 0, 0);
  CHECK_THROWS_AS(write_hair(folder / "b.hair", groom), InputError);
  CHECK_THROWS_WITH(write_hair(folder / "b.hair", groom), Contains("strand 0 has 65537 vertices"));
  CHECK(folder.entries() == 1);
}

TEST_CASE("what .hair cannot say is refused before anything is written") {
  const Folder folder;
  const auto refused = [&](const Groom& groom, const char* word) {
    CHECK_THROWS_AS(write_hair(folder / "a.hair", groom), InputError);
    CHECK_THROWS_WITH(write_hair(folder / "a.hair", groom), Contains("a.hair") && Contains(word));
  };
  refused(Groom(), "without strands");
  Groom groom = small_groom();
  groom.offset = {0, 4, 5};
  refused(groom, "strand 1 has one vertex");
  groom = small_groom();
  groom.position[3].y() = 1e39;
  refused(groom, "strand 1, vertex 1");
  CHECK(folder.entries() == 0);
}

TEST_CASE("a .hair file that cannot be written leaves the old one and nothing else") {
  const Folder folder;
  const Groom groom = small_groom();
  SECTION("no such folder") {
    CHECK_THROWS_AS(write_hair(folder / "no/a.hair", groom), DiskError);
    CHECK_THROWS_WITH(write_hair(folder / "no/a.hair", groom), Contains("no/a.hair") && Contains("created"));
    CHECK(folder.entries() == 0);
  }
  SECTION("a file in place of the folder") {
    std::ofstream(folder / "file") << "old";
    CHECK_THROWS_AS(write_hair(folder / "file/a.hair", groom), DiskError);
    CHECK(content(folder / "file") == "old");
  }
  SECTION("a folder in place of the file") {
    fs::create_directory(folder / "a.hair");
    CHECK_THROWS_AS(write_hair(folder / "a.hair", groom), DiskError);
    CHECK(folder.entries() == 1);
  }
  SECTION("a device is not replaced") {
    CHECK_THROWS_AS(write_hair("/dev/null", groom), DiskError);
    CHECK(fs::is_character_file("/dev/null"));
  }
  SECTION("no room: the system stops the file at 64 bytes") {
    std::ofstream(folder / "a.hair") << "old";
    rlimit before{};
    getrlimit(RLIMIT_FSIZE, &before);
    const rlimit tight{64, before.rlim_max};
    const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &tight);
    std::string message;
    try {
      write_hair(folder / "a.hair", groom);
    } catch (const DiskError& error) {
      message = error.what();
    }
    setrlimit(RLIMIT_FSIZE, &before);
    std::signal(SIGXFSZ, old_handler);
    CHECK_THAT(message, Contains("a.hair") && Contains("written"));
    CHECK(content(folder / "a.hair") == "old");
    CHECK(folder.entries() == 1);
  }
  SECTION("a folder without permission") {
    if (geteuid() == 0) {
      WARN("skipped: root may write anywhere");
      return;
    }
    const fs::path closed = folder / "closed";
    fs::create_directory(closed);
    std::ofstream(closed / "a.hair") << "old";
    fs::permissions(closed, fs::perms::owner_read | fs::perms::owner_exec);
    CHECK_THROWS_AS(write_hair(closed / "a.hair", groom), DiskError);
    fs::permissions(closed, fs::perms::owner_all);
    CHECK(content(closed / "a.hair") == "old");
  }
}

TEST_CASE("writing .hair replaces an old file and keeps a link") {
  const Folder folder;
  std::ofstream(folder / "a.hair") << "old";
  fs::create_symlink("a.hair", folder / "link.hair");
  write_hair(folder / "link.hair", small_groom());
  CHECK(fs::is_symlink(folder / "link.hair"));
  CHECK(content(folder / "a.hair").substr(0, 4) == "HAIR");
  CHECK(folder.entries() == 2);
}

TEST_CASE("the real ponytail is read") {
  const std::optional<fs::path> folder = assets();
  if (!folder) return;
  const struct {
    const char* name;
    std::size_t strands;
    bool both_ends;
  } cases[] = {{"front_top", 876, false}, {"side", 3066, false}, {"back", 517, true}, {"tail", 474, false}};
  for (const auto& [name, strands, both_ends] : cases) {
    INFO(name);
    Warnings warnings;
    const Groom groom = read_groom(*folder / "ponytail" / (name + std::string(".tfx")), warnings);
    CHECK(warnings.empty());
    CHECK(groom.strand_count() == strands);
    CHECK(groom.vertex_count() == 16 * strands);
    CHECK(groom.root_uv.empty());
    CHECK(groom.pinned.size() == (both_ends ? 16 * strands : 0));
    CHECK(std::count(groom.pinned.begin(), groom.pinned.end(), 1) == std::ptrdiff_t(both_ends ? 4 * strands : 0));
  }
}

TEST_CASE("the real mohawk is read, and its degenerate strand reported") {
  const std::optional<fs::path> folder = assets();
  if (!folder) return;
  Warnings warnings;
  const Groom groom = read_groom(*folder / "mohawk/Ratboy_mohawk.tfx", warnings);
  CHECK(groom.strand_count() == 2228);
  CHECK(groom.vertex_count() == 2228 * 32);
  CHECK(groom.pinned.empty());
  CHECK(groom.root_uv.size() == 2228);
  // All 31 segments of strand 435 are 1.3e-7 to 3.1e-7 long, where a step of float32 is 6e-8; those of strand 293, the
  // next shortest, are five times as long and have a direction.
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings[0], Contains(": 31 segments") && Contains("strand 435"));
}
