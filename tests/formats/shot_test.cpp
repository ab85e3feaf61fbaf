// A scene with its files opened: placement, regions, head, colliders, and what each frame is told, against
// hand-computed numbers.
#include "formats/shot.h"

#include <catch2/catch.hpp>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <string>
#include <vector>

#include "formats/digest.h"
#include "formats/groom_file.h"
#include "sim/gusts.h"

namespace {

using namespace strandbake;
using Eigen::Isometry3d;
using Eigen::Vector3d;
namespace fs = std::filesystem;

// A folder that is removed in the end, with grooms and heads to name.
struct Folder {
  fs::path path = fs::temp_directory_path() / "strandbake_shot_test";
  Folder() {
    fs::remove_all(path);
    fs::create_directories(path);
  }
  ~Folder() { fs::remove_all(path); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  void write(const std::string& name, const std::string& bytes) const {
    std::ofstream(path / name, std::ios::binary) << bytes;
  }
  // Strands of three vertices that begin at these places and go down by 0.1.
  void write_groom(const std::string& name, const std::vector<Vector3d>& roots) const {
    Groom groom;
    for (const Vector3d& root : roots) {
      for (int k = 0; k < 3; ++k) groom.position.emplace_back(root - Vector3d(0, 0.1 * k, 0));
      groom.offset.push_back(groom.position.size());
    }
    write_hair(path / name, groom);
  }
  // A .tfx 4 of strands of three vertices; `tip` is the w of their last, 0 pins it. With a UV for each strand or
  // without.
  void write_tfx(const std::string& name, const std::vector<Vector3d>& roots, float tip, bool uv) const {
    std::string bytes;
    const auto add = [&bytes](auto value) { bytes.append(reinterpret_cast<const char*>(&value), sizeof value); };
    const auto strands = static_cast<std::uint32_t>(roots.size());
    add(4.0f);
    for (const std::uint32_t v : {strands, 3u, 160u, uv ? 160u + 48 * strands : 0u, 0u, 0u, 0u}) add(v);
    bytes.resize(160);
    for (const Vector3d& root : roots) {
      for (int k = 0; k < 3; ++k) {
        for (const double x : {root.x(), root.y() - 0.1 * k, root.z()}) add(static_cast<float>(x));
        add(k == 2 ? tip : 1.0f);
      }
    }
    for (std::uint32_t s = 0; uv && s < strands; ++s) {
      add(static_cast<float>(s));
      add(0.5f);
    }
    write(name, bytes);
  }
};

struct Loaded {
  Shot shot;
  Faults faults;
  Warnings warnings;
};

Loaded try_load(const Folder& folder, const std::string& text, const std::vector<std::string>& overrides = {}) {
  folder.write("scene.toml", text);
  Loaded loaded;
  Scene scene = read_scene(folder.path / "scene.toml", overrides, {}, loaded.faults);
  loaded.shot = load_shot(std::move(scene), loaded.faults, loaded.warnings);
  for (Fault& fault : loaded.faults) fault.place.erase(0, fault.place.find("scene.toml"));
  return loaded;
}

Shot load(const Folder& folder, const std::string& text, const std::vector<std::string>& overrides = {}) {
  Loaded loaded = try_load(folder, text, overrides);
  for (const Fault& fault : loaded.faults) FAIL_CHECK(fault.place << ": " << fault.what);
  return std::move(loaded.shot);
}

// The one fault of a scene.
void check_fault(const Folder& folder, const std::string& text, const std::string& place,
                 const std::vector<std::string>& words) {
  const Loaded loaded = try_load(folder, text);
  std::string all;
  for (const Fault& fault : loaded.faults) all += fault.place + ": " + fault.what + "\n";
  INFO(text << "\n" << all);
  REQUIRE(loaded.faults.size() == 1);
  CHECK(loaded.faults[0].place == place);
  for (const std::string& word : words) CHECK_THAT(loaded.faults[0].what, Catch::Contains(word));
}

// Coordinates pass a file as float32 and rotations of a BVH as float quaternions.
constexpr double kTolerance = 1e-6;

void check_near(const Vector3d& found, const Vector3d& expected) {
  INFO("found " << found.transpose() << ", expected " << expected.transpose());
  CHECK((found - expected).norm() < kTolerance);
}

bool same(const Isometry3d& a, const Isometry3d& b) {
  return a.matrix() == b.matrix();
}

bool is_identity(const Isometry3d& transform) {
  return same(transform, Isometry3d::Identity());
}

// The head turns about +Y and its parent moves along x: at 0, 0.5 and 1 s by 0, 90 and 90 degrees, 0, 0.2 and 0.6 m.
// The head's joint is 1 m above its parent.
const std::string bvh = R"(HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Head
  {
    OFFSET 0 1 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 0.2 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.5
0 0 0 0 0 0 0 0 0
0.2 0 0 0 0 0 0 0 90
0.6 0 0 0 0 0 0 0 90
)";
// Two frames a second, so that frame 1 + n stands at the n-th key.
const std::string bake = "[bake]\nframes = \"1-5\"\nfps = 2\nsubsteps = 4\n";
const std::string one_groom = "[groom]\nfiles = [\"a.hair\"]\n";
const std::string head = "[head]\nanimation = \"head.bvh\"\nnode = \"Head\"\n";

Isometry3d turned(double degrees, const Vector3d& at) {
  Isometry3d pose = Isometry3d::Identity();
  pose.linear() = Eigen::AngleAxisd(degrees * std::numbers::pi / 180, Vector3d::UnitY()).toRotationMatrix();
  pose.translation() = at;
  return pose;
}

// Placement

TEST_CASE("a groom is converted from its units and axes, then scaled, turned about x, y and z, and moved") {
  const Folder folder;
  folder.write_groom("a.hair", {{1, 2, 3}});
  const std::string files = one_groom + "units = \"cm\"\nup = \"+Z\"\n";
  // +Z up: (x, z, -y).
  check_near(load(folder, files).groom.position[0], {0.01, 0.03, -0.02});
  check_near(load(folder, files + "scale = 2\n").groom.position[0], {0.02, 0.06, -0.04});
  check_near(load(folder, files + "scale = 2\nrotate = [90, 0, 0]\n").groom.position[0], {0.02, 0.04, 0.06});
  check_near(load(folder, files + "scale = 2\nrotate = [90, 90, 0]\n").groom.position[0], {0.06, 0.04, -0.02});
  check_near(load(folder, files + "scale = 2\nrotate = [90, 90, 90]\n").groom.position[0], {-0.04, 0.06, -0.02});
  check_near(load(folder, files + "scale = 2\nrotate = [90, 90, 90]\ntranslate = [1, 2, 3]\n").groom.position[0],
             {0.96, 2.06, 2.98});
}

TEST_CASE("a file of a groom may have units and axes of its own") {
  const Folder folder;
  folder.write_groom("a.hair", {{1, 2, 3}});
  folder.write_groom("b.hair", {{4, 5, 6}, {7, 8, 9}});
  const Groom groom = load(folder, R"([groom]
files = ["a.hair", {file = "b.hair", units = "mm"}, {file = "a.hair", up = "-Y"}, {file = "b.hair", units = "0.5", up = "+X"}]
units = "cm"
)")
                          .groom;
  REQUIRE(groom.strand_count() == 6);
  CHECK(groom.offset == std::vector<std::uint64_t>{0, 3, 6, 9, 12, 15, 18});
  check_near(groom.position[0], {0.01, 0.02, 0.03});
  check_near(groom.position[3], {0.004, 0.005, 0.006});
  check_near(groom.position[6], {0.007, 0.008, 0.009});
  check_near(groom.position[9], {0.01, -0.02, -0.03});
  check_near(groom.position[12], {-2.5, 2, 3});
  check_near(groom.position[17], {-3.9, 3.5, 4.5});
}

TEST_CASE("pins of one file do not reach another, and scalp coordinates are kept only where every file has them") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write_tfx("pinned.tfx", {{1, 0, 0}, {2, 0, 0}}, 0, true);
  folder.write_tfx("free.tfx", {{3, 0, 0}}, 1, true);
  const auto groom_of = [&](const std::string& files) { return load(folder, "[groom]\nfiles = " + files).groom; };

  const std::vector<std::uint8_t> pinned = {1, 1, 1, 1, 1, 1};
  const std::vector<std::uint8_t> free = {0, 0, 0};
  const auto joined = [](std::vector<std::uint8_t> a, const std::vector<std::uint8_t>& b) {
    a.insert(a.end(), b.begin(), b.end());
    return a;
  };
  CHECK(groom_of("[\"a.hair\", \"pinned.tfx\"]").pinned == joined(free, pinned));
  CHECK(groom_of("[\"pinned.tfx\", \"a.hair\"]").pinned == joined(pinned, free));
  CHECK(groom_of("[\"a.hair\", \"free.tfx\"]").pinned.empty());

  const Groom all = groom_of("[\"pinned.tfx\", \"free.tfx\"]");
  REQUIRE(all.root_uv.size() == 3);
  CHECK(all.root_uv[1] == Eigen::Vector2f(1, 0.5f));
  CHECK(all.root_uv[2] == Eigen::Vector2f(0, 0.5f));
  for (const char* files :
       {"[\"pinned.tfx\", \"a.hair\"]", "[\"a.hair\", \"pinned.tfx\"]", "[\"pinned.tfx\", \"a.hair\", \"free.tfx\"]"}) {
    CHECK(groom_of(files).root_uv.empty());
  }
}

TEST_CASE("a groom made in the axes of the head is placed where the head stands at the rest frame") {
  const Folder folder;
  folder.write_groom("a.hair", {{0.1, 0, 0}});
  folder.write("head.bvh", bvh);
  const std::string text = bake + one_groom + "space = \"head\"\ntranslate = [0, 0.5, 0]\n" + head;
  check_near(load(folder, text).groom.position[0], {0.1, 1.5, 0});
  // At frame 2 the head is turned by 90 degrees about +Y, x to -z, and 0.2 to the side.
  check_near(load(folder, text + "rest_frame = 2\n").groom.position[0], {0.2, 1.5, -0.1});
  check_near(load(folder, text + "start = 0\n").groom.position[0], {0.2, 1.5, -0.1});
  // Without it the head does not move the groom.
  check_near(load(folder, bake + one_groom + head + "rest_frame = 2\n").groom.position[0], {0.1, 0, 0});
}

// Regions

TEST_CASE("strands are divided by file, number, box and what is left") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}});
  folder.write_groom("b.hair", {{0, 1, 0}, {1, 1, 0}, {2, 1, 0}, {3, 1, 0}});
  const std::string files = "[groom]\nfiles = [\"a.hair\", \"b.hair\"]\n";
  using Regions = std::vector<std::uint32_t>;
  const auto divided = [&](const std::vector<std::string>& selections) {
    std::string text = files;
    for (const std::string& selection : selections) {
      text += "[[region]]\nname = \"" + std::to_string(text.size()) + "\"\n";
      if (!selection.empty()) text += "strands = {" + selection + "}\n";
    }
    return load(folder, text).groom.region;
  };
  CHECK(load(folder, files).groom.region == Regions{0, 0, 0, 0, 0, 0, 0});
  CHECK(divided({""}) == Regions{0, 0, 0, 0, 0, 0, 0});
  CHECK(divided({"file = \"b.hair\"", ""}) == Regions{1, 1, 1, 0, 0, 0, 0});
  CHECK(divided({"", "file = \"a.hair\""}) == Regions{1, 1, 1, 0, 0, 0, 0});
  CHECK(divided({"range = \"1, 4-5\"", ""}) == Regions{1, 0, 1, 1, 0, 0, 1});                   // over the whole groom
  CHECK(divided({"file = \"b.hair\", range = \"0, 3\"", ""}) == Regions{1, 1, 1, 0, 1, 1, 0});  // within the file
  CHECK(divided({"box = {min = [0.5, -1, -1], max = [2, 1, 1]}", ""}) == Regions{1, 0, 0, 1, 0, 0, 1});  // faces belong
  CHECK(divided({"box = {max = [0, 9, 9]}", ""}) == Regions{0, 1, 1, 0, 1, 1, 1});
  CHECK(divided({"file = \"b.hair\", range = \"1-3\", box = {min = [2, 0, 0]}", ""}) == Regions{1, 1, 1, 1, 1, 0, 0});
  CHECK(divided({"file = \"b.hair\"", "range = \"0\"", "range = \"1-2\""}) == Regions{1, 2, 2, 0, 0, 0, 0});
}

TEST_CASE("a box takes roots where they stand in the world at the rest frame") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {1, 0, 0}});
  const std::string region =
      "[[region]]\nname = \"high\"\nstrands = {box = {min = [-9, 0.9, -9]}}\n[[region]]\nname = \"low\"\n";
  const std::string turned_groom = one_groom + "rotate = [0, 0, 90]\n";
  CHECK(load(folder, turned_groom + region).groom.region == std::vector<std::uint32_t>{1, 0});
}

TEST_CASE("faults in the division of strands are told with their place") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}});
  const std::string a = "[[region]]\nname = \"a\"\nstrands = {range = \"0-1\"}\n";  // lines 3 to 5
  check_fault(folder, one_groom + a, "scene.toml:3:1", {"no region takes strand 2;", "[[region]]"});
  check_fault(folder, one_groom + a + "[[region]]\nname = \"b\"\nstrands = {range = \"1-2\"}\n", "scene.toml:8:11",
              {"region \"b\" claims strand 1, which region \"a\" has already"});
  check_fault(folder, one_groom + a + "[[region]]\nname = \"b\"\nstrands = {file = \"a.hair\"}\n", "scene.toml:8:11",
              {"region \"b\" claims strand 0 and 1 more, which region \"a\" has already"});
  check_fault(folder, one_groom + "[[region]]\nname = \"b\"\nstrands = {range = \"0-2\"}\n[[region]]\nname = \"c\"\n",
              "scene.toml:6:1", {"region \"c\" has no strands", "the other regions take them all"});
  check_fault(folder,
              one_groom + "[[region]]\nname = \"b\"\n[[region]]\nname = \"c\"\nstrands = {box = {min = [5, 0, 0]}}\n",
              "scene.toml:7:11", {"region \"c\" has no strands", "nothing matches"});
  check_fault(folder, one_groom + "[[region]]\nname = \"b\"\nstrands = {file = \"a.hair\", range = \"3\"}\n",
              "scene.toml:5:37", {"strand 3 is not there: a.hair has 3 strands, numbered from 0"});
}

TEST_CASE("a scene with faults is loaded all the same, and nothing is said twice") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {1, 0, 0}});
  folder.write("head.bvh", bvh);
  const std::string rest = "[[region]]\nname = \"rest\"\nstrands = {range = \"0-1\"}\n";
  for (const std::string& text : std::vector<std::string>{
           one_groom + "units = \"parsec\"\n", "[groom]\nfiles = [{file = \"a.hair\", up = \"W\"}]\n",
           one_groom + head + "units = \"parsec\"\n", one_groom + head + "up = \"W\"\n",
           one_groom + "[[region]]\nname = \"a\"\nstrands = {range = \"x\"}\n" + rest,
           one_groom + "[[region]]\nname = \"a\"\nstrands = {file = \"b.hair\"}\n" + rest,
           one_groom + "[[region]]\nname = \"a\"\nstrands = {rnge = \"0\"}\n" + rest,
           one_groom + "[[region]]\nname = \"a\"\nstrands = {rnge = \"0\"}\n",
           one_groom + "space = \"head\"\n" + head +
               "clip = \"none\"\n[[collider]]\nsphere = {radius = 1}\nnode = \"Neck\"\n"}) {
    const Loaded loaded = try_load(folder, text);
    INFO(text);
    CHECK(loaded.faults.size() == 1);
  }
}

TEST_CASE("files are told by their names in the scene and their digests") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh);
  fs::create_directory(folder.path / "sub");
  fs::rename(folder.path / "a.hair", folder.path / "sub/a.hair");
  const Shot shot = load(folder, "[groom]\nfiles = [\"sub/../sub/a.hair\"]\n" + head);
  REQUIRE(shot.inputs.size() == 2);
  CHECK(shot.inputs[0] == std::pair<std::string, std::string>("head.bvh", sha256_file(folder.path / "head.bvh")));
  CHECK(shot.inputs[1] ==
        std::pair<std::string, std::string>("sub/../sub/a.hair", sha256_file(folder.path / "sub/a.hair")));
  check_fault(folder, "[groom]\nfiles = \"none.hair\"\n", "scene.toml:2:9",
              {"\"none.hair\": no such file beside the scene"});
  check_fault(folder, "[groom]\nfiles = \"scene.toml\"\n", "scene.toml:2:9", {"no groom that can be read"});
  check_fault(folder, "[groom]\nfiles = \"sub/a.hair\"\n[head]\nanimation = \"sub/a.hair\"\nnode = \"Head\"\n",
              "scene.toml:4:13", {"a.hair"});
}

// The head

TEST_CASE("without an animation the head stands still") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  const Shot shot = load(folder, bake + one_groom);
  CHECK(shot.animation.nodes.empty());
  for (const double frame : {-7.0, 1.0, 2.5, 99.0}) CHECK(is_identity(shot.head(frame)));
}

TEST_CASE("the head moves as its clip does, from the rest frame on") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh);
  const std::string text = bake + one_groom + head;
  const Vector3d joint(0, 1, 0), point(0.1, 1.2, 0.3);
  const auto check_head = [&](const Shot& shot, double frame, const Isometry3d& now, const Isometry3d& rest) {
    INFO("frame " << frame);
    check_near(shot.head(frame) * point, now * rest.inverse() * point);
  };
  const Isometry3d start = turned(0, joint), middle = turned(45, joint + Vector3d(0.1, 0, 0)),
                   second = turned(90, joint + Vector3d(0.2, 0, 0)), third = turned(90, joint + Vector3d(0.6, 0, 0));

  Shot shot = load(folder, text);
  CHECK(is_identity(shot.head(1)));
  CHECK(is_identity(shot.head(-5)));  // held before its first key
  check_head(shot, 1.5, middle, start);
  check_head(shot, 2, second, start);
  check_head(shot, 2.5, turned(90, joint + Vector3d(0.4, 0, 0)), start);
  check_head(shot, 3, third, start);
  check_head(shot, 77, third, start);  // and after its last
  CHECK(same(shot.head(3), shot.head(77)));

  SECTION("the rest frame may be any") {
    shot = load(folder, text + "rest_frame = 2\n");
    CHECK(is_identity(shot.head(2)));
    check_head(shot, 1, start, second);
    check_head(shot, 3, third, second);
    shot = load(folder, text + "rest_frame = 9.5\n");
    CHECK(is_identity(shot.head(3)));  // held, so exactly as at rest
    CHECK(is_identity(shot.head(5)));
    check_head(shot, 1, start, third);
  }
  SECTION("the clip may start at any frame") {
    shot = load(folder, text + "start = 2.5\n");
    CHECK(is_identity(shot.head(2.5)));
    CHECK(is_identity(shot.head(1)));
    check_head(shot, 3, middle, start);
    check_head(shot, 3.5, second, start);
    shot = load(folder, text + "start = 0\n");  // the first frame, which is the rest frame, is at the second key
    check_head(shot, 2, third, second);
  }
  SECTION("and go at another frame rate") {
    shot = load(folder, text, {"bake.fps=8"});
    check_head(shot, 3, middle, start);
    check_head(shot, 5, second, start);
  }
  SECTION("units and axes of the animation are converted") {
    shot = load(folder, text + "units = \"cm\"\n");
    check_near(shot.head(3).translation(),
               (turned(90, joint / 100 + Vector3d(0.006, 0, 0)) * turned(0, -joint / 100)).translation());
    shot = load(folder, text + "up = \"+Z\"\n");  // its y is -z, and it turns about that
    Isometry3d there = Isometry3d::Identity();
    there.linear() = Eigen::AngleAxisd(std::numbers::pi / 2, -Vector3d::UnitZ()).toRotationMatrix();
    there.translation() = Vector3d(0.6, 0, -1);
    check_near(shot.head(3) * point, there * (point - Vector3d(0, 0, -1)));
  }
}

TEST_CASE("a head that shrinks to nothing is told before the bake") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("flat.gltf", R"({"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
                               "nodes": [{"name": "Head", "scale": [1, 0, 1]}]})");
  const std::string flat = "[head]\nanimation = \"flat.gltf\"\nnode = \"Head\"\n";
  check_fault(folder, flat + one_groom, "scene.toml:2:13", {"flat.gltf", "squashed flat"});
  check_fault(folder, flat + one_groom + "space = \"head\"\n", "scene.toml:2:13", {"flat.gltf", "squashed flat"});
}

// Colliders

TEST_CASE("a collider stands in the world, in a node's axes or in those of the groom, and rides its node") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh);
  const std::string groom = one_groom + "units = \"cm\"\nup = \"+Z\"\nscale = 2\ntranslate = [0, 0.5, 0]\n";
  const Shot shot = load(folder, bake + groom + head + R"(
[[collider]]
sphere = {center = [0.1, 1.2, 0.3], radius = 0.2}
[[collider]]
sphere = {center = [0.1, 1.2, 0.3], radius = 0.2}
node = "Head"
[[collider]]
sphere = {center = [0.1, 0.2, 0.3], radius = 0.2}
node = "Head"
space = "node"
[[collider]]
sphere = {center = [10, 20, 30], radius = 5}
space = "groom"
[[collider]]
sphere = {center = [10, 20, 30], radius = 5}
space = "groom"
node = "Hips"
[[collider]]
sphere = {center = {2 = [0, 0, 0], 3 = [0, 2, 0]}, radius = {2 = 1, 4 = 2}}
)");
  const auto at = [&](double frame, std::size_t index) { return shot.spheres(frame).at(index); };
  const Isometry3d to_third = turned(90, {0.6, 1, 0}) * turned(0, {0, -1, 0});
  REQUIRE(shot.spheres(1).size() == 6);
  for (const double frame : {1.0, 3.0}) {
    check_near(at(frame, 0).center, {0.1, 1.2, 0.3});
    CHECK(at(frame, 0).radius == 0.2);
    CHECK(at(frame, 2).radius == 0.2);
    check_near(at(frame, 3).center, {0.2, 1.1, -0.4});  // (10, 30, -20) cm, twice as large, moved up
    CHECK(at(frame, 3).radius == Approx(0.1));
  }
  check_near(at(1, 1).center, {0.1, 1.2, 0.3});
  CHECK(at(1, 1).center == Vector3d(0.1, 1.2, 0.3));  // exactly: the head stands as at rest
  check_near(at(3, 1).center, to_third * Vector3d(0.1, 1.2, 0.3));
  check_near(at(1, 2).center, {0.1, 1.2, 0.3});
  check_near(at(3, 2).center, turned(90, {0.6, 1, 0}) * Vector3d(0.1, 0.2, 0.3));
  check_near(at(1, 4).center, {0.2, 1.1, -0.4});
  check_near(at(3, 4).center, {0.8, 1.1, -0.4});  // the hips move and do not turn
  CHECK(at(3, 4).radius == Approx(0.1));
  check_near(at(2.5, 5).center, {0, 1, 0});
  CHECK(at(2.5, 5).radius == Approx(1.25));
}

TEST_CASE("a collider in the axes of a groom that was made around the head stands around the head") {
  const Folder folder;
  folder.write_groom("a.hair", {{0.1, 0, 0}});
  folder.write("head.bvh", bvh);
  const std::string text = bake + one_groom + "space = \"head\"\n" + head + "rest_frame = 2\n";
  const std::string collider = "[[collider]]\nsphere = {center = [0.1, 0, 0], radius = 0.05}\nspace = \"groom\"\n";
  Shot shot = load(folder, text + collider);
  check_near(shot.groom.position[0], {0.2, 1, -0.1});
  check_near(shot.spheres(3)[0].center, {0.2, 1, -0.1});  // where the head is at the rest frame, and does not ride it
  shot = load(folder, text + collider + "node = \"Head\"\n");
  check_near(shot.spheres(2)[0].center, {0.2, 1, -0.1});
  check_near(shot.spheres(3)[0].center, {0.6, 1, -0.1});
}

// Frames

TEST_CASE("a frame's input holds the moments at the end of each substep") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh);
  const Shot shot = load(folder, bake + one_groom + head + R"(
[forces]
gravity = {1 = [0, 0, 0], 3 = [0, -8, 2]}
[wind]
velocity = {1 = [1, 0, 0], 3 = [3, 0, 0]}
gust = 0.5
[[region]]
name = "a"
damping = {1 = 0.1, 3 = 0.3}
local = {stiffness = {1 = 0, 3 = 1}, iterations = 7}
[[collider]]
sphere = {center = {1 = [0, 1, 0], 3 = [2, 1, 0]}, radius = 0.1}
node = "Head"
)");
  const FrameInput input = shot.input(2);
  CHECK(input.substep == 0.125);  // half a second in four
  REQUIRE(input.substeps() == 4);
  REQUIRE(input.spheres.size() == 4);
  REQUIRE(input.wind.size() == 4);
  WindParams wind;
  wind.velocity = {2, 0, 0};
  wind.gust = 0.5;
  for (std::size_t s = 0; s < 4; ++s) {
    const double frame = 1 + 0.25 * static_cast<double>(s + 1);
    INFO("at frame " << frame);
    CHECK(same(input.head[s], shot.head(frame)));
    CHECK(input.spheres[s].at(0).center == shot.spheres(frame).at(0).center);
    CHECK(input.wind[s] == wind_at(wind, frame / 2));
  }
  CHECK_FALSE(same(input.head[0], input.head[1]));
  CHECK(input.wind[0] != input.wind[1]);
  // What the artist keys counts for the whole frame.
  CHECK(input.gravity == Vector3d(0, -4, 1));
  REQUIRE(input.regions.size() == 1);
  CHECK(input.regions[0].damping == Approx(0.2));
  CHECK(input.regions[0].local.stiffness == Approx(0.5));
  CHECK(input.regions[0].local.iterations == 7);
}

TEST_CASE("before the first frame all but the gusts stand as in the first frame") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh);
  const Shot shot = load(folder, bake + one_groom + head + R"(rest_frame = 3
start = -10
[forces]
gravity = {-9 = [9, 9, 9], 1 = [0, -1, 0]}
[wind]
velocity = {-9 = [9, 9, 9], 1 = [1, 0, 0]}
gust = 0.5
[[region]]
name = "a"
damping = {-9 = 0.9, 1 = 0.1}
[[collider]]
sphere = {center = {-9 = [9, 9, 9], 1 = [0, 1, 0]}, radius = 0.1}
)",
                         {"bake.preroll=3"});
  WindParams wind;
  wind.velocity = {1, 0, 0};
  wind.gust = 0.5;
  for (const int frame : {-1, 0, 1}) {
    const FrameInput input = shot.input(frame);
    INFO("frame " << frame);
    CHECK(input.gravity == Vector3d(0, -1, 0));
    CHECK(input.regions[0].damping == Approx(0.1));
    REQUIRE(input.substeps() == 4);
    for (std::size_t s = 0; s < 4; ++s) {
      CHECK(same(input.head[s], shot.head(1)));
      CHECK(input.spheres[s][0].center == Vector3d(0, 1, 0));
      CHECK(input.wind[s] == wind_at(wind, (frame - 1 + 0.25 * static_cast<double>(s + 1)) / 2));
    }
  }
}

// A head that stands at these places along x, a key a frame of 1/24 s.
std::string bvh_of(const std::vector<double>& x) {
  std::string text =
      "HIERARCHY\nROOT Head\n{\n  OFFSET 0 0 0\n  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation "
      "Yrotation\n"
      "  End Site\n  {\n    OFFSET 0 0.2 0\n  }\n}\nMOTION\nFrames: " +
      std::to_string(x.size()) + "\nFrame Time: 0.0416666666666667\n";
  for (const double value : x) text += std::to_string(value) + " 0 0 0 0 0\n";
  return text;
}
const std::string automatic = "[bake]\nframes = \"1-30\"\nsubsteps = \"auto\"\n";

TEST_CASE("a frame takes as many substeps as its motion needs, and the input says so") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {0.1, 0, 0}});
  // Stands for 5 frames, then goes at 0.024 m a frame for 5 more, and stands again: two jumps of the velocity, each by
  // 16 times 0.024 m, which take the square root of 384.
  std::vector<double> x(5, 0.0);
  for (int k = 0; k < 6; ++k) x.push_back(0.024 * k);
  folder.write("head.bvh", bvh_of(x));
  const Shot shot =
      load(folder, automatic + one_groom + head + "[[region]]\nname = \"all\"\ndamping = 1\n", {"bake.preroll=2"});
  for (int frame = -1; frame <= 30; ++frame) {
    CAPTURE(frame);
    const int expected = frame == 7 || frame == 12 ? 20 : 1;
    CHECK(shot.substeps(frame) == expected);
    const FrameInput input = shot.input(frame);
    REQUIRE(input.substeps() == static_cast<std::size_t>(expected));
    CHECK(input.substep == 1 / (24.0 * expected));
    CHECK(same(input.head.back(), shot.head(std::max(frame, 1))));
  }
  const Shot::Substeps count = shot.count_substeps(30);
  CHECK(count.least == 1);
  CHECK(count.most == 20);
  CHECK(count.total == 2 * 20 + 29);  // of the 31 frames after frame -1
  CHECK(shot.count_substeps(6).total == 7);
  CHECK(shot.count_substeps(-1).total == 0);
}

TEST_CASE("the least damping of the simulated regions, as it is keyed, says for how long hair rings") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {0.1, 0, 0}});
  folder.write("head.bvh", bvh_of({0, 0, 0.1, 0.1}));
  const auto counts = [&](const std::string& more, const std::string& fraction) {
    const Shot shot =
        load(folder, automatic + one_groom + head + more + "\n[[region]]\nname = \"a\"\nstrands.range = \"0\"\n" +
                         fraction + "[[region]]\nname = \"b\"\ndamping = 1\n");
    return std::vector<int>{shot.substeps(3), shot.substeps(4), shot.substeps(5), shot.substeps(30)};
  };
  // 1600 mm: 40; once more when it stops; then 0.9^2.5 of it in each frame.
  CHECK(counts("", "damping = 1\n") == std::vector<int>{40, 40, 1, 1});
  CHECK(counts("", "damping = 0.1\n") == std::vector<int>{40, 40, 36, 2});
  CHECK(counts("", "damping = 0\n") == std::vector<int>{40, 40, 40, 40});
  CHECK(counts("", "damping = 0\nsimulate = false\n") == std::vector<int>{40, 40, 1, 1});
  CHECK(counts("", "damping = {4 = 1, 5 = 0}\n") == std::vector<int>{40, 40, 40, 40});
  CHECK(counts("", "damping = {5 = 0, 6 = 1}\n") == std::vector<int>{40, 40, 40, 1});
}

TEST_CASE("colliders ask for substeps of their own, by their keys too") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  const auto counts = [&](const std::string& sphere) {  // strands reach 0.2 m
    const Shot shot =
        load(folder, automatic + one_groom + "[[region]]\nname = \"a\"\ndamping = 1\n[[collider]]\nsphere = " + sphere);
    return std::vector<int>{shot.substeps(9), shot.substeps(10), shot.substeps(11), shot.substeps(20),
                            shot.substeps(21)};
  };
  CHECK(counts("{center = [0, 0, 0]}\n") == std::vector<int>{1, 1, 1, 1, 1});
  // 0.1 m a frame, from frame 9 to 20: beside what its start and stop take, a small one that is in reach takes more.
  const std::string flying = "{center = {9 = [-0.25, -0.1, 0], 20 = [0.85, -0.1, 0]}, radius = ";
  CHECK(counts(flying + "0.02}\n") == std::vector<int>{1, 40, 10, 1, 1});
  CHECK(counts(flying + "1}\n") == std::vector<int>{1, 40, 1, 1, 40});
}

TEST_CASE("where hair only rides, one substep will do") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh_of({0, 0, 0.1, 0.1}));
  const Shot shot = load(folder, automatic + one_groom + head + "[[region]]\nname = \"a\"\nsimulate = false\n");
  CHECK(shot.count_substeps(30).most == 1);
}

TEST_CASE("motion that would take more substeps than there may be is told") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  folder.write("head.bvh", bvh_of({0, 0, 100, 100}));
  const Loaded loaded = try_load(folder, automatic + one_groom + head + "units = \"m\"\n");
  CHECK(loaded.faults.empty());
  REQUIRE(loaded.warnings.size() == 1);
  CHECK_THAT(loaded.warnings[0], Catch::Contains("scene.toml:3:12: frame 3 and ") && Catch::Contains("more than 1000"));
  CHECK(loaded.shot.substeps(3) == 1000);
  CHECK(load(folder, automatic + one_groom + head, {"bake.substeps=7"}).substeps(3) == 7);
}

TEST_CASE("where there is no wind a frame's input has none") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}});
  CHECK(load(folder, bake + one_groom).input(2).wind.empty());
  CHECK(load(folder, bake + one_groom + "[wind]\ngust = 1\n").input(2).wind.empty());
  const Shot shot = load(folder, bake + one_groom + "[wind]\nvelocity = {2 = [0, 0, 0], 4 = [0, 0, 1]}\n");
  CHECK(shot.input(2).wind.empty());
  CHECK(shot.input(3).wind.size() == 4);
}

TEST_CASE("the plan leaves out what does nothing in any frame") {
  const Folder folder;
  folder.write_groom("a.hair", {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}});
  const std::string text = bake + one_groom + R"(
[[region]]
name = "all"
strands = {range = "0"}
local.method = 2
global = {range = 0.6, fade = 0.4}
[[region]]
name = "none"
strands = {range = "1"}
drag = 0
local.stiffness = 0
global.stiffness = 0
lengths.iterations = 0
[[region]]
name = "late"
drag = {5 = 0, 6 = 1}
local.stiffness = {4 = 0, 5 = 0.1}
global.stiffness = {5 = 0, 6 = 0.1}
)";
  const Plan plan = load(folder, text + "[wind]\nvelocity = {4 = [0, 0, 0], 5 = [1, 0, 0]}\n").plan;
  REQUIRE(plan.regions.size() == 3);
  CHECK(plan.regions[0].wind);
  CHECK(plan.regions[0].global_shape);
  CHECK(plan.regions[0].global_range == 0.6);
  CHECK(plan.regions[0].global_fade == 0.4);
  CHECK(plan.regions[0].local_shape);
  CHECK(plan.regions[0].local_method == 2);
  CHECK(plan.regions[0].edge_lengths);
  CHECK_FALSE(plan.regions[1].wind);
  CHECK_FALSE(plan.regions[1].global_shape);
  CHECK_FALSE(plan.regions[1].local_shape);
  CHECK_FALSE(plan.regions[1].edge_lengths);
  CHECK_FALSE(plan.regions[2].wind);  // frame 6 is none of 1 to 5
  CHECK_FALSE(plan.regions[2].global_shape);
  CHECK(plan.regions[2].local_shape);
  CHECK_FALSE(load(folder, text + "[wind]\nvelocity = {5 = [0, 0, 0], 6 = [1, 0, 0]}\n").plan.regions[0].wind);
}

}  // namespace
