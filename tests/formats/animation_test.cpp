#include "formats/animation.h"

#include <stdlib.h>

#include <Eigen/LU>
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <random>
#include <sstream>

using namespace strandbake;
using Catch::Matchers::Contains;
using Eigen::AngleAxisd;
using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::Matrix4d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

namespace {

namespace fs = std::filesystem;

constexpr double pi = std::numbers::pi;

double difference(const Matrix4d& a, const Matrix4d& b) {
  return (a - b).cwiseAbs().maxCoeff();
}

Matrix4d turned(double angle, const Vector3d& axis, const Vector3d& translation = Vector3d::Zero()) {
  Isometry3d m(AngleAxisd(angle, axis.normalized()));
  m.pretranslate(translation);
  return m.matrix();
}

AnimationNode node_at(std::string name, int parent, const Vector3d& translation) {
  AnimationNode node;
  node.name = std::move(name);
  node.parent = parent;
  node.local.topRightCorner<3, 1>() = translation;
  return node;
}

// One node whose keys turn it at a constant rate about an axis.
Animation turning(const Vector3d& axis, double step, int keys) {
  Animation a;
  a.source = "turning";
  a.nodes.push_back(node_at("Head", -1, Vector3d::Zero()));
  a.nodes[0].animated = true;
  for (int k = 0; k < keys; ++k) {
    a.nodes[0].rotation.time.push_back(k);
    a.nodes[0].rotation.value.emplace_back(AngleAxisd(step * k, axis.normalized()));
  }
  return a;
}

class TempFolder {
 public:
  TempFolder() {
    std::string name = (fs::temp_directory_path() / "strandbake-animation-XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
    path_ = name;
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
  ~TempFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  fs::path write(const std::string& name, const std::string& bytes) const {
    std::ofstream(path_ / name, std::ios::binary) << bytes;
    return path_ / name;
  }
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

std::string slurp(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

// The folder with the fixture files, empty where there is none.
fs::path assets() {
  const char* folder = std::getenv("STRANDBAKE_ASSETS");
#ifdef STRANDBAKE_ASSETS
  if (folder == nullptr) folder = STRANDBAKE_ASSETS;
#endif
  return folder != nullptr && fs::is_directory(fs::path(folder) / "animation") ? fs::path(folder) / "animation"
                                                                               : fs::path();
}

Animation read(const fs::path& path, const AnimationOptions& options = {}) {
  Warnings warnings;
  return read_animation(path, options, warnings);
}

Animation parse(const std::string& bytes, const AnimationOptions& options = {}) {
  Warnings warnings;
  return parse_animation(bytes, "test", options, warnings);
}

Warnings warnings_of(const std::string& bytes, const AnimationOptions& options = {}) {
  Warnings warnings;
  parse_animation(bytes, "test", options, warnings);
  return warnings;
}

std::string joined(const Warnings& warnings) {
  std::string text;
  for (const std::string& w : warnings) text += w + "\n";
  return text;
}

AnimationOptions clip(const std::string& name) {
  return {name, "", ""};
}

// --- a small glTF, written by hand ---

std::string base64(const std::string& bytes) {
  static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  for (std::size_t k = 0; k < bytes.size(); k += 3) {
    std::uint32_t group = 0;
    for (std::size_t b = 0; b < 3; ++b) {
      group = group << 8 | (k + b < bytes.size() ? static_cast<unsigned char>(bytes[k + b]) : 0);
    }
    for (std::size_t d = 0; d < 4; ++d) out += k + d <= bytes.size() ? digits[group >> (18 - 6 * d) & 63] : '=';
  }
  return out;
}

std::string floats(const std::vector<float>& values) {
  std::string bytes(4 * values.size(), '\0');
  std::memcpy(bytes.data(), values.data(), bytes.size());
  return bytes;
}

struct GltfBuilder {
  nlohmann::json file = {{"asset", {{"version", "2.0"}}}};
  std::string data;

  int node(const std::string& name, int parent, const std::vector<double>& translation = {0, 0, 0}) {
    const auto n = static_cast<int>(file["nodes"].size());
    file["nodes"].push_back({{"translation", translation}});
    if (!name.empty()) file["nodes"][n]["name"] = name;
    if (parent < 0) {
      file["scenes"][0]["nodes"].push_back(n);
    } else {
      file["nodes"][parent]["children"].push_back(n);
    }
    return n;
  }
  int accessor(const std::vector<float>& values, const std::string& type) {
    const int width = type == "SCALAR" ? 1 : type == "VEC3" ? 3 : 4;
    file["bufferViews"].push_back({{"buffer", 0}, {"byteOffset", data.size()}, {"byteLength", 4 * values.size()}});
    file["accessors"].push_back({{"bufferView", file["bufferViews"].size() - 1},
                                 {"componentType", 5126},
                                 {"count", values.size() / width},
                                 {"type", type}});
    data += floats(values);
    return static_cast<int>(file["accessors"].size()) - 1;
  }
  void channel(int clip, int node, const std::string& path, const std::vector<float>& times,
               const std::vector<float>& values, const std::string& interpolation = "LINEAR") {
    nlohmann::json& animation = file["animations"][clip];
    const int input = accessor(times, "SCALAR");
    const int output = accessor(values, path == "rotation" ? "VEC4" : "VEC3");
    animation["samplers"].push_back({{"input", input}, {"output", output}, {"interpolation", interpolation}});
    animation["channels"].push_back(
        {{"sampler", animation["samplers"].size() - 1}, {"target", {{"node", node}, {"path", path}}}});
  }
  std::string text() {
    file["buffers"] = {{{"byteLength", data.size()}, {"uri", "data:application/octet-stream;base64," + base64(data)}}};
    return file.dump();
  }
  std::string glb() {
    file["buffers"] = {{{"byteLength", data.size()}}};
    std::string json = file.dump();
    json.resize((json.size() + 3) / 4 * 4, ' ');
    const auto word = [](std::size_t v) {
      const auto narrow = static_cast<std::uint32_t>(v);
      return std::string(reinterpret_cast<const char*>(&narrow), 4);
    };
    return "glTF" + word(2) + word(28 + json.size() + data.size()) + word(json.size()) + "JSON" + json +
           word(data.size()) + std::string("BIN\0", 4) + data;
  }
};

// Root, Neck 1 m above it, Head 0.5 m above that; the neck turns by 90 degrees about +Y within 2 s, the root walks.
GltfBuilder nodding() {
  GltfBuilder g;
  const int root = g.node("Root", -1);
  const int neck = g.node("Neck", root, {0, 1, 0});
  g.node("Head", neck, {0, 0.5, 0.25});
  const float half = std::sqrt(0.5f);
  g.channel(0, neck, "rotation", {0, 2}, {0, 0, 0, 1, 0, half, 0, half});
  g.channel(0, root, "translation", {0.5f, 1.5f}, {0, 0, 0, 4, 0, 0});
  g.file["animations"][0]["name"] = "Nod";
  return g;
}

// Tolerances of files: they hold floats (6e-8), and a chain of a few joints adds up some of those.
constexpr double float_file = 2e-6;

const char* const small_bvh = R"(HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Neck
  {
    OFFSET 0 10 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT Head
    {
      OFFSET 0 5 1
      CHANNELS 3 Yrotation Zrotation Xrotation
      End Site
      {
        OFFSET 0 2 0
      }
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.5
0 100 0   0 0 0   0 0 0   0 0 0
2 100 0   30 20 10   0 0 90   10 20 30
4 100 0   30 20 10   0 0 90   -40 50 60
)";

std::string small_dae(const std::string& asset) {
  return R"(<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
  <asset>)" +
         asset + R"(</asset>
  <library_animations>
    <animation id="turn" name="Turn">
      <source id="times"><float_array id="times-array" count="2">0 2</float_array><technique_common>
        <accessor source="#times-array" count="2" stride="1"><param name="TIME" type="float"/></accessor>
      </technique_common></source>
      <source id="angles"><float_array id="angles-array" count="2">0 90</float_array><technique_common>
        <accessor source="#angles-array" count="2" stride="1"><param name="ANGLE" type="float"/></accessor>
      </technique_common></source>
      <source id="kinds"><Name_array id="kinds-array" count="2">LINEAR LINEAR</Name_array><technique_common>
        <accessor source="#kinds-array" count="2" stride="1"><param name="INTERPOLATION" type="name"/></accessor>
      </technique_common></source>
      <sampler id="sampler"><input semantic="INPUT" source="#times"/><input semantic="OUTPUT" source="#angles"/>
        <input semantic="INTERPOLATION" source="#kinds"/></sampler>
      <channel source="#sampler" target="rig_Neck/spin.ANGLE"/>
    </animation>
  </library_animations>
  <library_visual_scenes><visual_scene id="Scene" name="Scene">
    <node id="rig_Neck" name="Neck" type="JOINT">
      <translate sid="place">0 0 100</translate>
      <rotate sid="spin">0 0 1 0</rotate>
      <node id="rig_Head" name="Head" type="JOINT"><translate sid="place">20 0 50</translate></node>
    </node>
  </visual_scene></library_visual_scenes>
  <scene><instance_visual_scene url="#Scene"/></scene>
</COLLADA>
)";
}

// Hips turning from 0 to 90 degrees about Y in 1 s, with a Head on it whose properties the caller gives.
std::string small_fbx(const std::string& settings, const std::string& head, const std::string& connections = "") {
  return R"(; FBX 7.4.0 project file
FBXHeaderExtension:  {
	FBXHeaderVersion: 1003
	FBXVersion: 7400
}
GlobalSettings:  {
	Version: 1000
	Properties70:  {
		P: "TimeMode", "enum", "", "",6
)" + settings +
         R"(	}
}
Objects:  {
	Model: 101, "Model::Hips", "LimbNode" {
		Version: 232
		Properties70:  {
			P: "Lcl Translation", "Lcl Translation", "", "A",0,100,0
		}
	}
	Model: 102, "Model::Head", "LimbNode" {
		Version: 232
		Properties70:  {
			P: "Lcl Translation", "Lcl Translation", "", "A",0,50,0
)" + head +
         R"(		}
	}
	AnimationStack: 201, "AnimStack::Take", "" {
		Properties70:  {
			P: "LocalStop", "KTime", "Time", "",46186158000
		}
	}
	AnimationLayer: 202, "AnimLayer::Base", "" {
	}
	AnimationCurveNode: 203, "AnimCurveNode::R", "" {
	}
	AnimationCurve: 204, "AnimCurve::", "" {
		Default: 0
		KeyVer: 4008
		KeyTime: *2 {
			a: 0,46186158000
		}
		KeyValueFloat: *2 {
			a: 0,90
		}
	}
	AnimationCurveNode: 205, "AnimCurveNode::R", "" {
	}
}
Connections:  {
	C: "OO",101,0
	C: "OO",102,101
	C: "OO",202,201
	C: "OO",203,202
	C: "OO",205,202
	C: "OP",203,101, "Lcl Rotation"
	C: "OP",205,102, "Lcl Rotation"
	C: "OP",204,203, "d|Y"
	C: "OP",204,205, "d|Y"
)" + connections +
         "}\n";
}

// --- samplers that share nothing with the code under test ---

struct PlainGltf {
  nlohmann::json file;
  std::vector<std::string> buffers;

  explicit PlainGltf(const fs::path& path) {
    const std::string bytes = slurp(path);
    std::string text = bytes;
    std::string chunk;
    if (bytes.substr(0, 4) == "glTF") {
      std::uint32_t size = 0;
      std::memcpy(&size, bytes.data() + 12, 4);
      text = bytes.substr(20, size);
      chunk = bytes.substr(28 + size);
    }
    file = nlohmann::json::parse(text);
    for (const auto& buffer : file["buffers"]) {
      const std::string uri = buffer.value("uri", "");
      if (uri.empty()) {
        buffers.push_back(chunk);
      } else if (uri.rfind("data:", 0) == 0) {
        std::string out;
        std::uint32_t bits = 0;
        int held = 0;
        for (const char c : uri.substr(uri.find(',') + 1)) {
          if (c == '=') break;
          const int v = c >= 'A' && c <= 'Z'   ? c - 'A'
                        : c >= 'a' && c <= 'z' ? c - 'a' + 26
                        : c >= '0' && c <= '9' ? c - '0' + 52
                        : c == '+'             ? 62
                                               : 63;
          bits = bits << 6 | static_cast<std::uint32_t>(v);
          held += 6;
          if (held >= 8) {
            held -= 8;
            out += static_cast<char>(bits >> held & 255);
          }
        }
        buffers.push_back(out);
      } else {
        buffers.push_back(slurp(path.parent_path() / uri));
      }
    }
  }

  std::vector<double> values(int accessor, int width) const {
    const auto& a = file["accessors"][accessor];
    const auto& view = file["bufferViews"][a["bufferView"].get<int>()];
    const std::size_t stride = view.value("byteStride", 4 * width);
    const std::size_t start = view.value("byteOffset", 0) + a.value("byteOffset", 0);
    std::vector<double> out;
    for (std::size_t k = 0; k < a["count"].get<std::size_t>(); ++k) {
      for (int c = 0; c < width; ++c) {
        float v = 0;
        std::memcpy(&v, buffers[view["buffer"].get<int>()].data() + start + k * stride + 4 * c, 4);
        out.push_back(v);
      }
    }
    return out;
  }

  // Value of a track at a time; the specification's slerp for rotations.
  std::vector<double> at(const nlohmann::json& sampler, int width, double time) const {
    const std::vector<double> t = values(sampler["input"], 1);
    const std::vector<double> v = values(sampler["output"], width);
    std::size_t k = 0;
    while (k + 1 < t.size() && t[k + 1] <= time) ++k;
    if (k + 1 == t.size() || time <= t[k]) return {v.begin() + k * width, v.begin() + (k + 1) * width};
    const double u = (time - t[k]) / (t[k + 1] - t[k]);
    double wa = 1 - u;
    double wb = u;
    if (width == 4) {
      double dot = 0;
      for (int c = 0; c < 4; ++c) dot += v[k * 4 + c] * v[k * 4 + 4 + c];
      const double angle = std::acos(std::min(1.0, std::abs(dot)));
      if (angle > 1e-6) {
        wa = std::sin((1 - u) * angle) / std::sin(angle);
        wb = std::sin(u * angle) / std::sin(angle);
      }
      if (dot < 0) wb = -wb;
    }
    std::vector<double> out;
    for (int c = 0; c < width; ++c) out.push_back(wa * v[k * width + c] + wb * v[(k + 1) * width + c]);
    return out;
  }

  Matrix4d local(int node, int clip, double time) const {
    const auto& n = file["nodes"][node];
    if (n.contains("matrix")) {
      const auto m = n["matrix"].get<std::vector<double>>();
      return Eigen::Map<const Matrix4d>(m.data());
    }
    std::vector<double> t = n.value("translation", std::vector<double>{0, 0, 0});
    std::vector<double> r = n.value("rotation", std::vector<double>{0, 0, 0, 1});
    std::vector<double> s = n.value("scale", std::vector<double>{1, 1, 1});
    for (const auto& channel : file["animations"][clip]["channels"]) {
      if (channel["target"]["node"] != node) continue;
      const std::string path = channel["target"]["path"];
      const auto& sampler = file["animations"][clip]["samplers"][channel["sampler"].get<int>()];
      if (path == "translation") t = at(sampler, 3, time);
      if (path == "rotation") r = at(sampler, 4, time);
      if (path == "scale") s = at(sampler, 3, time);
    }
    Matrix4d m = Matrix4d::Identity();
    m.topLeftCorner<3, 3>() =
        Quaterniond(r[3], r[0], r[1], r[2]).normalized().toRotationMatrix() * Vector3d(s[0], s[1], s[2]).asDiagonal();
    m.topRightCorner<3, 1>() = Vector3d(t[0], t[1], t[2]);
    return m;
  }

  Matrix4d world(int node, int clip, double time) const {
    Matrix4d m = local(node, clip, time);
    for (int n = 0; n < static_cast<int>(file["nodes"].size()); ++n) {
      for (const auto& child : file["nodes"][n].value("children", std::vector<int>())) {
        if (child == node) return world(n, clip, time) * m;
      }
    }
    return m;
  }
};

// World matrix of a joint at a frame, straight from the numbers of a BVH file.
struct PlainBvh {
  struct Joint {
    std::string name;
    int parent;
    Vector3d offset;
    std::vector<std::string> channels;
  };
  std::vector<Joint> joints;
  std::vector<std::vector<double>> frames;
  double interval = 0;

  explicit PlainBvh(const std::string& text) {
    std::istringstream in(text);
    std::string word;
    std::vector<int> open;
    bool site = false;
    while (in >> word && word != "MOTION") {
      if (word == "ROOT" || word == "JOINT") {
        in >> word;
        joints.push_back({word, open.empty() ? -1 : open.back(), {}, {}});
      } else if (word == "End") {
        site = true;
      } else if (word == "{") {
        open.push_back(site ? -2 : static_cast<int>(joints.size()) - 1);
        site = false;
      } else if (word == "}") {
        open.pop_back();
      } else if (word == "OFFSET") {
        Vector3d v;
        in >> v.x() >> v.y() >> v.z();
        if (open.back() != -2) joints[open.back()].offset = v;
      } else if (word == "CHANNELS") {
        int count = 0;
        in >> count;
        for (; count > 0; --count) {
          in >> word;
          joints[open.back()].channels.push_back(word);
        }
      }
    }
    std::size_t count = 0;
    in >> word >> count >> word >> word >> interval;
    std::size_t width = 0;
    for (const Joint& j : joints) width += j.channels.size();
    frames.assign(count, std::vector<double>(width));
    for (auto& frame : frames) {
      for (double& v : frame) in >> v;
    }
  }

  Matrix4d world(const std::string& name, std::size_t frame) const {
    std::vector<Isometry3d> world;
    std::size_t at = 0;
    for (const Joint& joint : joints) {
      Vector3d place = joint.offset;
      Matrix3d turn = Matrix3d::Identity();
      for (const std::string& channel : joint.channels) {
        const double v = frames[frame][at++];
        const int axis = channel[0] - 'X';
        if (channel.substr(1) == "position") {
          place[axis] = v;
        } else {
          turn = turn * AngleAxisd(v * pi / 180, Vector3d::Unit(axis)).toRotationMatrix();
        }
      }
      Isometry3d local(turn);
      local.pretranslate(place);
      world.push_back(joint.parent < 0 ? local : world[joint.parent] * local);
      if (joint.name == name) return world.back().matrix();
    }
    throw std::runtime_error("no such joint");
  }
};

// A rotation apart, relative in translation: |a - b| over the size of the numbers.
double relative(const Matrix4d& a, const Matrix4d& b) {
  const double size = std::max(1.0, b.topRightCorner<3, 1>().norm());
  return std::max((a - b).topLeftCorner<3, 3>().cwiseAbs().maxCoeff() /
                      std::max(1.0, b.topLeftCorner<3, 3>().cwiseAbs().maxCoeff()),
                  (a - b).topRightCorner<3, 1>().norm() / size);
}

}  // namespace

// --- sampling ---

TEST_CASE("translation runs in straight lines between keys and is held outside them") {
  Animation a;
  a.nodes.push_back(node_at("Head", -1, Vector3d(9, 9, 9)));
  a.nodes[0].animated = true;
  a.nodes[0].translation = {{1, 2, 4}, {Vector3d(0, 0, 0), Vector3d(1, 2, 3), Vector3d(5, 2, 1)}};
  const auto at = [&](double t) -> Vector3d { return a.pose(0, t).translation(); };
  REQUIRE(at(-5) == Vector3d(0, 0, 0));
  REQUIRE(at(1) == Vector3d(0, 0, 0));
  REQUIRE(at(1.25) == Vector3d(0.25, 0.5, 0.75));
  REQUIRE(at(2) == Vector3d(1, 2, 3));
  REQUIRE(at(3) == Vector3d(3, 2, 2));
  REQUIRE(at(4) == Vector3d(5, 2, 1));
  REQUIRE(at(1e9) == Vector3d(5, 2, 1));
}

TEST_CASE("a constant turn is met between its keys to 1e-12") {
  const Vector3d axis(1, -2, 0.5);
  for (const double step : {1e-7, 0.01, 0.5, 1.5, 3.0}) {
    const Animation a = turning(axis, step, 4);
    for (double t = -0.5; t < 3.6; t += 0.0371) {
      const double held = std::clamp(t, 0.0, 3.0);
      CAPTURE(step, t);
      REQUIRE(difference(a.world(0, t), turned(step * held, axis)) < 1e-12);
    }
  }
}

TEST_CASE("the short way round is taken, whichever sign the keys have") {
  for (const double sign : {1.0, -1.0}) {
    Animation a = turning(Vector3d::UnitY(), 0, 1);
    const Quaterniond end(AngleAxisd(-2.0, Vector3d::UnitY()));
    a.nodes[0].rotation.time = {0, 1};
    a.nodes[0].rotation.value = {Quaterniond::Identity(), Quaterniond(sign * end.coeffs())};
    REQUIRE(difference(a.world(0, 0.25), turned(-0.5, Vector3d::UnitY())) < 1e-14);
  }
}

TEST_CASE("half turns between keys give rotations, not numbers out of range") {
  Animation a = turning(Vector3d::UnitZ(), pi, 2);
  for (double t = 0; t <= 1; t += 0.01) {
    const Matrix3d r = a.pose(0, t).linear();
    REQUIRE((r * r.transpose() - Matrix3d::Identity()).norm() < 1e-14);
  }
}

TEST_CASE("a chain of nodes is the product of its matrices") {
  Animation a;
  a.nodes.push_back(node_at("Root", -1, Vector3d(1, 2, 3)));
  a.nodes.push_back(node_at("Neck", 0, Vector3d(0, 1, 0)));
  a.nodes.push_back(node_at("Head", 1, Vector3d(0, 0.5, 0)));
  a.nodes[0].animated = true;
  a.nodes[0].rotation = {
      {0, 2}, {Quaterniond(AngleAxisd(0, Vector3d::UnitX())), Quaterniond(AngleAxisd(1, Vector3d::UnitX()))}};
  a.nodes[0].scale = {{0}, {Vector3d(2, 2, 2)}};
  a.nodes[2].animated = true;
  a.nodes[2].translation = {{0, 1}, {Vector3d(0, 0, 0), Vector3d(0, 1, 0)}};
  a.nodes[2].scale = {{0, 1}, {Vector3d(1, 1, 1), Vector3d(3, 5, 7)}};

  Matrix4d root = turned(0.25, Vector3d::UnitX());  // animated: its own transform is replaced, missing tracks rest
  root.topLeftCorner<3, 3>() *= 2;
  Matrix4d head = Matrix4d::Identity();
  head.diagonal() << 2, 3, 4, 1;
  head(1, 3) = 0.5;
  const Matrix4d expected = root * turned(0, Vector3d::UnitX(), Vector3d(0, 1, 0)) * head;
  REQUIRE(difference(a.world(2, 0.5), expected) < 1e-14);
  // Scale is gone from the pose, the way up is not.
  REQUIRE(difference(a.pose(2, 0.5).matrix(), turned(0.25, Vector3d::UnitX(), expected.topRightCorner<3, 1>())) <
          1e-14);
}

TEST_CASE("a pose is exactly the identity for one, and else a rotation to 1e-12") {
  Animation a;
  a.nodes.push_back(node_at("Head", -1, Vector3d(0, 0, 0)));
  REQUIRE(a.pose(0, 0).matrix() == Matrix4d::Identity());

  std::mt19937 random(7);
  std::uniform_real_distribution<double> uniform(-1, 1);
  for (int trial = 0; trial < 500; ++trial) {
    Matrix3d m;
    for (int k = 0; k < 9; ++k) m(k) = uniform(random);
    if (std::abs(m.determinant()) < 1e-3) continue;
    a.nodes[0].local.topLeftCorner<3, 3>() = m * std::pow(10.0, 5 * uniform(random));
    const Matrix3d r = a.pose(0, 0).linear();
    REQUIRE((r * r.transpose() - Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-12);
    REQUIRE(r.determinant() == Approx(1).margin(1e-12));
    // The polar factor: what is left, R' M, is symmetric.
    const Matrix3d rest = r.transpose() * m;
    REQUIRE((rest - rest.transpose()).cwiseAbs().maxCoeff() < 1e-12);
  }
}

TEST_CASE("a mirrored node turns with its parent") {
  Animation a = turning(Vector3d(1, 1, 0), 1, 3);
  a.nodes.push_back(node_at("Mirrored", 0, Vector3d(0, 1, 0)));
  a.nodes[1].local(0, 0) = -2;
  const Isometry3d rest = a.pose(1, 0);
  for (const double t : {0.3, 1.0, 1.9}) {
    const Matrix4d motion = (a.pose(1, t) * rest.inverse()).matrix();
    REQUIRE(difference(motion, turned(t, Vector3d(1, 1, 0))) < 1e-14);
  }
}

TEST_CASE("a node squashed flat or not finite is refused with its name and time") {
  Animation a;
  a.source = "flat.glb";
  a.nodes.push_back(node_at("Neck", -1, Vector3d(0, 0, 0)));
  a.nodes.push_back(node_at("Head", 0, Vector3d(0, 0, 0)));
  a.nodes[1].animated = true;
  a.nodes[1].scale = {{0, 2}, {Vector3d(1, 1, 1), Vector3d(1, 1, 0)}};
  REQUIRE_NOTHROW(a.pose(1, 1.9));
  REQUIRE_THROWS_WITH(a.pose(1, 2.5), Contains("flat.glb") && Contains("Neck/Head") && Contains("2.5 s"));
  REQUIRE_THROWS_AS(a.pose(1, 2.5), InputError);
  a.nodes[0].local(1, 1) = std::nan("");
  REQUIRE_THROWS_WITH(a.pose(1, 0), Contains("not finite"));
}

TEST_CASE("units and axes turn file coordinates into metres with +Y up") {
  // Z up, centimetres: the head stands 160 up, and yaws about the file's Z.
  Animation a = turning(Vector3d::UnitZ(), pi / 2, 2);
  a.nodes[0].translation = {{0, 1}, {Vector3d(10, 20, 160), Vector3d(10, 30, 160)}};
  a.unit = 0.01;
  a.up << 1, 0, 0, 0, 0, 1, 0, -1, 0;
  const Isometry3d p0 = a.pose(0, 0);
  const Isometry3d p1 = a.pose(0, 1);
  REQUIRE((p0.translation() - Vector3d(0.1, 1.6, -0.2)).norm() < 1e-15);
  // The node's own axes stay those of the file: its Z points up.
  REQUIRE((p0.linear() * Vector3d::UnitZ() - Vector3d::UnitY()).norm() < 1e-15);
  // The motion from rest to now is a yaw about the world's Y, through the right points.
  const Isometry3d motion = p1 * p0.inverse();
  REQUIRE((motion.linear() - AngleAxisd(pi / 2, Vector3d::UnitY()).toRotationMatrix()).norm() < 1e-15);
  REQUIRE((motion * p0.translation() - Vector3d(0.1, 1.6, -0.3)).norm() < 1e-15);
  REQUIRE(a.world(0, 0)(2, 3) == 160);  // in the file's own units
}

// --- nodes ---

TEST_CASE("nodes are found by name and by path") {
  Animation a;
  a.source = "robot.glb";
  a.nodes.push_back(node_at("Root", -1, Vector3d::Zero()));
  a.nodes.push_back(node_at("Head", 0, Vector3d::Zero()));
  a.nodes.push_back(node_at("Neck", 0, Vector3d::Zero()));
  a.nodes.push_back(node_at("", 2, Vector3d::Zero()));
  a.nodes.push_back(node_at("Head", 3, Vector3d::Zero()));
  a.nodes.push_back(node_at("Jaw/Chin", 4, Vector3d::Zero()));
  REQUIRE(a.find_node("Neck") == 2);
  REQUIRE(a.find_node("Neck/Head") == 4);  // a nameless node between them does not count
  REQUIRE(a.find_node("Root/Neck/Head") == 4);
  REQUIRE(a.find_node("/Root/Head") == 1);
  REQUIRE(a.find_node("Jaw/Chin") == 5);
  REQUIRE(a.find_node("Head/Jaw/Chin") == 5);

  REQUIRE_THROWS_WITH(a.find_node("Head"), Contains("\"Root/Head\", \"Root/Neck/Head\"") && Contains("path"));
  REQUIRE_THROWS_WITH(a.find_node("heed"), Contains("robot.glb") && Contains("closest names are \"Head\", \"Neck\""));
  REQUIRE_THROWS_WITH(a.find_node("eck/Head"), Contains("is not there"));
  REQUIRE_THROWS_AS(a.find_node(""), InputError);
  REQUIRE_THROWS_AS(a.find_node("/"), InputError);

  a.nodes[2].name = "Root";
  a.nodes[2].parent = -1;
  REQUIRE_THROWS_WITH(a.find_node("Root/Head"), Contains("rename"));
}

// --- files ---

TEST_CASE("a glTF is read with its nodes, keys and clip") {
  GltfBuilder g = nodding();
  const TempFolder folder;
  for (const fs::path& path : {folder.write("a.gltf", g.text()), folder.write("a.glb", g.glb())}) {
    Warnings warnings;
    const Animation a = read_animation(path, {}, warnings);
    REQUIRE(joined(warnings).empty());
    REQUIRE(a.clip == "Nod");
    REQUIRE(a.duration == 2);
    REQUIRE(a.unit == 1);
    REQUIRE(a.up == Matrix3d::Identity());
    const std::size_t head = a.find_node("Neck/Head");
    for (double t = -0.5; t < 3; t += 0.173) {
      const double walk = 4 * std::clamp(t - 0.5, 0.0, 1.0);  // starts late, ends early, is held
      const Matrix4d neck = turned(pi / 4 * std::clamp(t, 0.0, 2.0), Vector3d::UnitY(), Vector3d(walk, 1, 0));
      const Matrix4d expected = neck * turned(0, Vector3d::UnitY(), Vector3d(0, 0.5, 0.25));
      REQUIRE(difference(a.world(head, t), expected) < float_file);
    }
  }
}

TEST_CASE("a glTF finds its buffer beside it, spaces in its name included") {
  GltfBuilder g = nodding();
  g.text();
  g.file["buffers"] = {{{"byteLength", g.data.size()}, {"uri", "my%20keys.bin"}}};
  const TempFolder folder;
  const fs::path path = folder.write("a.gltf", g.file.dump());
  REQUIRE_THROWS_WITH(read(path), Contains("my keys.bin") && Contains("no such file"));
  folder.write("my keys.bin", g.data.substr(0, 10));
  REQUIRE_THROWS_WITH(read(path), Contains("buffer 0 should have") && Contains("but has 10"));
  folder.write("my keys.bin", g.data);
  REQUIRE(read(path).duration == 2);
}

TEST_CASE("nodes of one name keep their own keys") {
  GltfBuilder g = nodding();
  g.node("Neck", 0, {5, 5, 5});  // the keys are those of the other
  g.node("Other", 3);
  const Animation a = parse(g.text());
  REQUIRE(a.nodes[a.find_node("Other")].parent == static_cast<int>(a.find_node("Other")) - 1);
  REQUIRE(difference(a.world(a.find_node("Root/Neck/Other"), 0), turned(0, Vector3d::UnitX(), Vector3d(5, 5, 5))) <
          float_file);
  REQUIRE(a.world(a.find_node("Head"), 2)(0, 0) == Approx(0).margin(float_file));
}

TEST_CASE("clips are chosen by name, by a part of it, and by number") {
  GltfBuilder g = nodding();
  for (int c = 1; c < 4; ++c) g.channel(c, 0, "translation", {0, static_cast<float>(c)}, {0, 0, 0, 1, 1, 1});
  g.file["animations"][0]["name"] = "Robot_Dance";
  g.file["animations"][1]["name"] = "Robot_No";
  g.file["animations"][2]["name"] = "Robot_No";
  const std::string text = g.text();
  REQUIRE(parse(text, clip("Robot_Dance")).duration == 2);
  REQUIRE(parse(text, clip("Dance")).clip == "Robot_Dance");
  REQUIRE(parse(text, clip("#3")).duration == 2);
  REQUIRE(parse(text, clip("#4")).duration == 3);
  const std::string all = "\"Robot_Dance\", \"#2\", \"#3\", \"#4\"";
  REQUIRE_THROWS_WITH(parse(text), Contains("has 4 clips; name one of " + all));
  REQUIRE_THROWS_WITH(parse(text, clip("Robot_No")), Contains("several clips") && Contains(all));
  for (const char* wrong : {"No", "Danc", "Robot", "#0", "#5", "Walk"}) {
    REQUIRE_THROWS_WITH(parse(text, clip(wrong)), Contains("is not there; the clips are " + all));
  }
}

TEST_CASE("a file without a clip stands still, with a warning") {
  GltfBuilder g;
  g.node("Head", g.node("Neck", -1, {0, 1, 0}), {0, 0.5, 0});
  const std::string text = g.text();
  REQUIRE_THAT(joined(warnings_of(text)), Contains("has no clip"));
  const Animation a = parse(text);
  REQUIRE(a.clip.empty());
  REQUIRE(a.pose(a.find_node("Head"), 7).translation() == Vector3d(0, 1.5, 0));
  REQUIRE_THROWS_WITH(parse(text, clip("Dance")), Contains("the file has no clips"));
}

TEST_CASE("STEP and CUBICSPLINE keys of the chosen clip are reported with their nodes") {
  GltfBuilder g = nodding();
  g.channel(1, 2, "translation", {0, 1}, {0, 0, 0, 1, 0, 0}, "STEP");
  g.channel(1, 0, "scale", {0, 1}, std::vector<float>(18, 1), "CUBICSPLINE");
  g.file["animations"][1]["name"] = "Jump";
  REQUIRE(joined(warnings_of(g.text(), clip("Nod"))).empty());
  const std::string warnings = joined(warnings_of(g.text(), clip("Jump")));
  REQUIRE_THAT(warnings, Contains("STEP keys") && Contains("\"Head\""));
  REQUIRE_THAT(warnings, Contains("CUBICSPLINE keys") && Contains("\"Root\""));
}

TEST_CASE("keys are repaired with a warning or refused") {
  GltfBuilder g = nodding();
  SECTION("out of order and twice at one time: sorted, the last one counts") {
    g.channel(1, 0, "translation", {2, 0, 1, 1}, {2, 0, 0, 0, 0, 0, 9, 9, 9, 1, 0, 0});
    REQUIRE_THAT(joined(warnings_of(g.text(), clip("#2"))), Contains("sorted") && Contains("\"Root\""));
    const Animation a = parse(g.text(), clip("#2"));
    REQUIRE(a.duration == 2);
    for (const double t : {0.5, 1.0, 1.5}) REQUIRE(a.world(0, t)(0, 3) == Approx(t).margin(float_file));
  }
  SECTION("a rotation of length 0 is left out") {
    g.channel(1, 0, "rotation", {0, 1, 2}, {0, 0, 0, 2, 0, 0, 0, 0, 0, 3, 0, 3});
    REQUIRE_THAT(joined(warnings_of(g.text(), clip("#2"))), Contains("length 0") && Contains("\"Root\""));
    const Animation a = parse(g.text(), clip("#2"));
    REQUIRE(difference(a.world(0, 1), turned(pi / 4, Vector3d::UnitY())) < float_file);
  }
  SECTION("not finite") {
    for (const float bad : {std::nanf(""), HUGE_VALF, -HUGE_VALF}) {
      GltfBuilder value = nodding();
      value.channel(0, 2, "translation", {0, 1}, {0, 0, 0, 0, bad, 0});
      REQUIRE_THROWS_WITH(parse(value.text()), Contains("\"Head\" has a key that is not finite"));
      GltfBuilder time = nodding();
      time.channel(0, 2, "rotation", {0, bad}, {0, 0, 0, 1, 0, 0, 0, 1});
      REQUIRE_THROWS_WITH(parse(time.text()), Contains("\"Head\" has a key that is not finite"));
    }
  }
  SECTION("two tracks for one thing") {
    g.channel(0, 0, "translation", {0}, {7, 0, 0});
    REQUIRE_THAT(joined(warnings_of(g.text())), Contains("moves the translation of node \"Root\" twice"));
    REQUIRE(parse(g.text()).world(0, 0)(0, 3) == 7);
  }
}

TEST_CASE("a glTF that lies is refused") {
  const auto refused = [](const std::function<void(nlohmann::json&)>& spoil, const std::string& words) {
    GltfBuilder g = nodding();
    g.text();
    spoil(g.file);
    REQUIRE_THROWS_AS(parse(g.file.dump()), InputError);
    REQUIRE_THROWS_WITH(parse(g.file.dump()), Contains(words));
  };
  refused([](auto& f) { f["nodes"][2]["children"] = {0}; }, "root and a child");
  refused([](auto& f) { f["nodes"][2]["children"] = {1}; }, "child of two nodes");
  refused([](auto& f) { f["nodes"][2]["children"] = {2}; }, "child of two nodes");
  refused([](auto& f) { f["nodes"][2]["children"] = {77}; }, "beyond the last of 3");
  refused([](auto& f) { f["nodes"][2]["children"] = {"x"}; }, "missing or beyond");
  refused([](auto& f) { f["nodes"][2]["translation"] = {1, 2}; }, "not 3 numbers");
  refused([](auto& f) { f["nodes"][2]["name"] = 7; }, "wrong kind");
  refused([](auto& f) { f["scenes"][0]["nodes"] = {0, 0}; }, "twice in its scene");
  refused([](auto& f) { f["scenes"][0]["nodes"] = nlohmann::json::array(); }, "has no nodes");
  refused([](auto& f) { f.erase("nodes"); }, "beyond the last of 0");
  refused([](auto& f) { f["asset"]["version"] = "1.0"; }, "version \"1.0\"");
  refused([](auto& f) { f.erase("asset"); }, "not glTF");
  refused([](auto& f) { f["accessors"][0]["count"] = 3; }, "reaches beyond its buffer");
  refused([](auto& f) { f["accessors"][0]["count"] = 4000000000u; }, "reaches beyond its buffer");
  refused([](auto& f) { f["accessors"][0]["count"] = -1; }, "whole number");
  refused([](auto& f) { f["accessors"][0]["count"] = 1; }, "1 key times");
  refused([](auto& f) { f["accessors"][0]["byteOffset"] = 4; }, "reaches beyond its buffer");
  refused([](auto& f) { f["accessors"][1]["componentType"] = 5122; }, "float keys");
  refused([](auto& f) { f["accessors"][1]["type"] = "VEC3"; }, "type VEC4");
  refused([](auto& f) { f["accessors"][1]["sparse"] = {{"count", 1}}; }, "sparse");
  refused([](auto& f) { f["bufferViews"][1]["byteLength"] = 400; }, "reaches beyond its buffer");
  refused([](auto& f) { f["bufferViews"][1]["byteStride"] = 2; }, "reaches beyond its buffer");
  refused([](auto& f) { f["bufferViews"][1]["extensions"]["EXT_meshopt_compression"] = {{"x", 1}}; }, "compressed");
  refused([](auto& f) { f["buffers"][0]["byteLength"] = 4000000; }, "should have 4000000 bytes");
  refused([](auto& f) { f["buffers"][0]["uri"] = "data:;base64,!!!!"; }, "base64");
  refused([](auto& f) { f["buffers"][0]["uri"] = "/dev/zero"; }, "not a file beside it");
  refused([](auto& f) { f["buffers"][0]["uri"] = "http://example.org/a.bin"; }, "not a file beside it");
  refused([](auto& f) { f["buffers"][0].erase("uri"); }, "has no data");
  refused([](auto& f) { f["animations"][0]["channels"][0]["sampler"] = 9; }, "beyond the last of 2");
  refused([](auto& f) { f["animations"][0]["channels"][0]["target"]["node"] = 9; }, "beyond the last of 3");
  refused([](auto& f) { f["animations"][0]["samplers"][0]["interpolation"] = "CUBICSPLINE"; },
          "another number of values");
  refused(
      [](auto& f) {
        for (int n = 3; n < 3000; ++n) {
          f["nodes"].push_back({{"name", "deep"}});
          f["nodes"][n - 1]["children"] = {n};
        }
      },
      "more than 1000 deep");
}

TEST_CASE("BVH joints follow the order of their channels") {
  Warnings warnings;
  const Animation a = parse_animation(small_bvh, "small.bvh", {}, warnings);
  REQUIRE(warnings.size() == 1);
  REQUIRE_THAT(warnings[0], Contains("names no units; metres are assumed") && Contains("m tall"));
  REQUIRE(a.rate == 2);
  REQUIRE(a.duration == 1);
  const PlainBvh plain(small_bvh);
  const std::size_t head = a.find_node("Neck/Head");
  for (std::size_t f = 0; f < 3; ++f) {
    REQUIRE(relative(a.world(head, 0.5 * static_cast<double>(f)), plain.world("Head", f)) < float_file);
  }
  // Half way each joint is half way on its own arc.
  REQUIRE(a.world(a.find_node("Neck"), 0.25)(0, 3) != Approx(0));
  AnimationOptions inches;
  inches.units = "in";
  warnings.clear();
  const Animation b = parse_animation(small_bvh, "small.bvh", inches, warnings);
  REQUIRE(warnings.empty());
  REQUIRE(b.pose(head, 0).translation().y() == Approx(115 * 0.0254));
  REQUIRE_THROWS_WITH(parse(small_bvh, {"", "parsec", ""}), Contains("parsec"));
  REQUIRE_THROWS_WITH(parse(small_bvh, {"", "", "Q"}), Contains("\"Q\""));
}

TEST_CASE("a BVH that lies is refused with its line") {
  const auto refused = [](const std::string& from, const std::string& to, const std::string& words) {
    std::string text = small_bvh;
    text.replace(text.find(from), from.size(), to);
    CAPTURE(to);
    REQUIRE_THROWS_AS(parse(text), InputError);
    REQUIRE_THROWS_WITH(parse(text), Contains("test:") && Contains(words));
  };
  refused("Frames: 3", "Frames: 4", "expected a number, found the end of the file");
  refused("Frames: 3", "Frames: 4000000000", "too few values");
  refused("Frames: 3", "Frames: 1e300", "expected a number");
  refused("Frames: 3", "Frames: 0", "number of frames");
  refused("Frames: 3", "Frames: 2.5", "number of frames");
  refused("Time: 0.5", "Time: 0", "frame time");
  refused("Time: 0.5", "Time: -1", "frame time");
  refused("0 100 0 ", "0 nan 0 ", "found \"nan\"");
  refused("0 100 0 ", "0 x 0 ", "found \"x\"");
  refused("OFFSET 0 10 0", "OFFSET 0 10", "found \"CHANNELS\"");
  refused("CHANNELS 6", "CHANNELS 7", "0 to 6");
  refused("CHANNELS 3 Zrotation", "CHANNELS 3 Zrotate", "found \"Zrotate\"");
  refused("6 Xposition", "6 Yposition", "twice");
  refused("JOINT Head", "JOINT {", "name of a joint");
  refused("JOINT Head", "LIMB Head", "test:10: expected OFFSET");
  refused("MOTION", "ROOT B { } MOTION", "expected \"MOTION\"");
  std::string deep = "HIERARCHY ROOT r { ";
  for (int k = 0; k < 100000; ++k) deep += "JOINT j { ";
  REQUIRE_THROWS_WITH(parse(deep), Contains("more than 1000 deep"));
}

TEST_CASE("Collada units and axes are taken out of the root and applied once") {
  struct Case {
    const char* asset;
    AnimationOptions options;
    Vector3d head;  // at 0 s
    Vector3d axis;  // about which it turns
  };
  const Case cases[] = {
      {"<unit name=\"cm\" meter=\"0.01\"/><up_axis>Z_UP</up_axis>", {}, {0.2, 1.5, 0}, {0, 1, 0}},
      {"<unit name=\"cm\" meter=\"0.01\"/><up_axis>Y_UP</up_axis>", {}, {0.2, 0, 1.5}, {0, 0, 1}},
      {"<up_axis>X_UP</up_axis>", {}, {0, 20, 150}, {0, 0, 1}},
      {"<unit name=\"cm\" meter=\"0.01\"/><up_axis>Z_UP</up_axis>", {"", "mm", ""}, {0.02, 0.15, 0}, {0, 1, 0}},
      {"<unit name=\"cm\" meter=\"0.01\"/><up_axis>Z_UP</up_axis>", {"", "", "+Y"}, {0.2, 0, 1.5}, {0, 0, 1}},
      {"", {"", "0.5", "Z"}, {10, 75, 0}, {0, 1, 0}},
  };
  for (const Case& c : cases) {
    CAPTURE(c.asset, c.options.units, c.options.up);
    Warnings warnings;
    const Animation a = parse_animation(small_dae(c.asset), "small.dae", c.options, warnings);
    REQUIRE(joined(warnings).empty());
    const std::size_t head = a.find_node("Neck/Head");  // by name; its id is rig_Head
    const Isometry3d rest = a.pose(head, 0);
    REQUIRE((rest.translation() - c.head).norm() < float_file * c.head.norm());
    REQUIRE(a.world(head, 0)(2, 3) == Approx(150));
    const Isometry3d motion = a.pose(head, 1) * rest.inverse();
    REQUIRE((motion.linear() - AngleAxisd(pi / 4, c.axis).toRotationMatrix()).norm() < float_file);
  }
  REQUIRE(parse(small_dae("<unit meter=\"0.01\"/>")).unit == 0.01);  // exactly, although the importer has a float
  REQUIRE_THROWS_WITH(parse(small_dae("<unit meter=\"0\"/>")), Contains("unit"));
}

TEST_CASE("a Collada file that lies is refused") {
  const auto refused = [](const std::string& from, const std::string& to, const std::string& words) {
    std::string text = small_dae("");
    text.replace(text.find(from), from.size(), to);
    CAPTURE(to);
    REQUIRE_THROWS_AS(parse(text), InputError);
    REQUIRE_THROWS_WITH(parse(text), Contains(words));
  };
  refused("#angles-array\" count=\"2\"", "#angles-array\" count=\"3\"", "beyond its array");
  refused("#angles-array\" count=\"2\" stride=\"1\"", "#angles-array\" count=\"2\" stride=\"99\"", "beyond its array");
  refused("\"angles-array\" count=\"2\"", "\"angles-array\" count=\"4000000000\"", "more than fit");
  refused("<translate sid=\"place\">20 0 50</translate>", "<instance_node url=\"#rig_Neck\"/>", "its own ancestor");
  refused("</COLLADA>", "", "is not closed");
  refused("</visual_scene>", "</node>", "without its beginning");
  std::string deep = "<COLLADA>";
  for (int k = 0; k < 100000; ++k) deep += "<node>";
  REQUIRE_THROWS_WITH(parse(deep), Contains("more than 1000 deep"));
}

TEST_CASE("FBX units, axes, orientations and pivots come out right") {
  const auto property = [](const std::string& name, const std::string& value) {
    return "P: \"" + name + "\", \"Vector3D\", \"Vector\", \"\"," + value + "\n";
  };
  const Vector3d y = Vector3d::UnitY();
  SECTION("centimetres and +Y up where the file says nothing") {
    Warnings warnings;
    const Animation a = parse_animation(small_fbx("", ""), "small.fbx", {}, warnings);
    REQUIRE(joined(warnings).empty());
    REQUIRE(a.clip == "Take");
    REQUIRE(a.rate == 30);
    REQUIRE(a.duration == Approx(1));
    REQUIRE(a.unit == 0.01);
    const std::size_t head = a.find_node("Hips/Head");
    REQUIRE((a.pose(head, 0).translation() - Vector3d(0, 1.5, 0)).norm() < float_file);
    REQUIRE(difference(a.pose(head, 0.5).matrix(), turned(pi / 2, y, Vector3d(0, 1.5, 0))) < float_file);
  }
  SECTION("inches, Z up") {
    const Animation a =
        parse(small_fbx("P: \"UnitScaleFactor\", \"double\", \"Number\", \"\",2.54\n"
                        "P: \"UpAxis\", \"int\", \"Integer\", \"\",2\n"
                        "P: \"FrontAxis\", \"int\", \"Integer\", \"\",1\n"
                        "P: \"FrontAxisSign\", \"int\", \"Integer\", \"\",-1\n",
                        ""));
    REQUIRE(a.unit == Approx(0.0254).epsilon(1e-15));
    REQUIRE((a.pose(a.find_node("Head"), 0).translation() - Vector3d(0, 0, -150 * 0.0254)).norm() < 1e-5);
    const Animation b = parse(small_fbx("", ""), {"", "m", "-Y"});
    REQUIRE((b.pose(b.find_node("Head"), 0).translation() - Vector3d(0, -150, 0)).norm() < 1e-4);
  }
  SECTION("left-handed axes give a warning") {
    const std::string text = small_fbx("P: \"CoordAxisSign\", \"int\", \"Integer\", \"\",-1\n", "");
    REQUIRE_THAT(joined(warnings_of(text)), Contains("left-handed"));
    REQUIRE(parse(text).up == Matrix3d::Identity());
  }
  SECTION("a joint orientation stands before the keys, a post-rotation is undone after them") {
    const Animation a = parse(small_fbx("", property("PreRotation", "90,0,0") + property("PostRotation", "0,0,90")));
    const std::size_t head = a.find_node("Hips/Head");
    for (const double t : {0.0, 0.3, 1.0}) {
      const Matrix4d hips = turned(t * pi / 2, y, Vector3d(0, 100, 0));
      const Matrix4d expected = hips * turned(pi / 2, Vector3d::UnitX(), Vector3d(0, 50, 0)) * turned(t * pi / 2, y) *
                                turned(-pi / 2, Vector3d::UnitZ());
      REQUIRE(relative(a.world(head, t), expected) < float_file);
    }
  }
  SECTION("keys turn a node about its pivot, and what is geometry's own does not move the node") {
    const Animation a =
        parse(small_fbx("", property("RotationPivot", "0,0,5") + property("GeometricTranslation", "7,7,7")));
    const std::size_t head = a.find_node("Hips/Head");
    for (const double t : {0.0, 0.3, 1.0}) {
      const Matrix4d hips = turned(t * pi / 2, y, Vector3d(0, 100, 0));
      const Vector3d pivot(0, 0, 5);
      const Matrix4d expected = hips * turned(t * pi / 2, y, Vector3d(0, 50, 0) + pivot) * turned(0, y, -pivot);
      REQUIRE(relative(a.world(head, t), expected) < float_file);
    }
  }
  SECTION("loops and missing ends are refused") {
    REQUIRE_THROWS_WITH(parse(small_fbx("", "", "C: \"OO\",101,102\n")), Contains("its own ancestor"));
    REQUIRE_THROWS_WITH(parse(small_fbx("", "", "Deep: {\n")), Contains("do not end"));
    REQUIRE_THROWS_WITH(parse(small_fbx("", "", "}}\n")), Contains("} too many"));
    std::string deep = small_fbx("", "");
    for (int k = 0; k < 100000; ++k) deep += "a: {\n";
    REQUIRE_THROWS_WITH(parse(deep), Contains("too deeply"));
  }
  SECTION("nodes of one name are a guess, said so") {
    std::string text = small_fbx("", "");
    text.replace(text.find("Model::Head"), 11, "Model::Hips");
    REQUIRE_THAT(joined(warnings_of(text)), Contains("2 nodes are called \"Hips\" but the clip moves 1"));
  }
}

TEST_CASE("what is not an animation file is refused in one sentence") {
  const TempFolder folder;
  REQUIRE_THROWS_WITH(read(folder.path() / "none.glb"), Contains("none.glb: there is no such file"));
  REQUIRE_THROWS_WITH(read(folder.path()), Contains("is not a file"));
  REQUIRE_THROWS_WITH(read("/dev/null"), Contains("is not a file"));
  REQUIRE_THROWS_WITH(read(folder.write("empty.fbx", "")), Contains("empty.fbx: is empty"));
  for (const char* foreign :
       {"solid cube\n", "<html></html>", "\x89PNG\r\n\x1a\n", " ", "Kaydara", "v 0 0 0\nl 1 2\n"}) {
    REQUIRE_THROWS_WITH(read(folder.write("a.glb", foreign)), Contains("is none of glTF, GLB, FBX, BVH and Collada"));
  }
  for (const char* broken : {"{", "{}", "{\"asset\": {}}", "glTF", "HIERARCHY", "<COLLADA", "Kaydara FBX Binary  "}) {
    CAPTURE(broken);
    REQUIRE_THROWS_AS(read(folder.write("a.glb", broken)), InputError);
  }
  // The content decides, whatever the name says.
  REQUIRE(read(folder.write("wrong.fbx", small_bvh)).nodes.size() == 4);
}

TEST_CASE("files cut short are refused at every length") {
  GltfBuilder g = nodding();
  const std::string whole[] = {g.text(), g.glb(), small_bvh, small_dae(""), small_fbx("", "")};
  for (const std::string& bytes : whole) {
    REQUIRE_NOTHROW(parse(bytes));
    // The last number of a BVH may lose digits unnoticed, and white space at the end is nobody's.
    const std::size_t end = bytes.size() - 4;
    for (std::size_t length = 0; length < end; length += 1 + end / 60) {
      CAPTURE(bytes.substr(0, 20), length);
      REQUIRE_THROWS_AS(parse(bytes.substr(0, length)), InputError);
    }
    REQUIRE_THROWS_AS(parse(bytes.substr(0, end)), InputError);
  }
}

// --- the fixtures ---

TEST_CASE("glTF fixtures are sampled as their own numbers say") {
  if (assets().empty()) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with animations");
    return;
  }
  struct Case {
    const char* file;
    const char* clip;
    int index;
    const char* node;
    int node_index;
  };
  const Case cases[] = {{"robot_expressive.glb", "Dance", 0, "Neck/Head", 1},
                        {"robot_expressive.glb", "Robot_Yes", 13, "Neck/Head", 1},
                        {"Fox.glb", "Run", 2, "b_Head_05", -1},
                        {"cesium_man.gltf", "", 0, "nodes[13]", 13}};
  for (const Case& c : cases) {
    Warnings warnings;
    const Animation a = read_animation(assets() / c.file, clip(c.clip), warnings);
    REQUIRE(joined(warnings).empty());
    const std::size_t node = a.find_node(c.node);
    const PlainGltf plain(assets() / c.file);
    int index = c.node_index;
    for (std::size_t n = 0; index < 0; ++n) {
      if (plain.file["nodes"][n].value("name", "") == c.node) index = static_cast<int>(n);
    }
    for (int k = 0; k <= 50; ++k) {
      const double t = -0.1 + k * (a.duration + 0.2) / 50;
      CAPTURE(c.file, t);
      // Key times come as float milliseconds: 1e-7 of the time, at 26 rad/s and chains of ten joints.
      REQUIRE(relative(a.world(node, t), plain.world(index, c.index, t)) < 1e-5);
    }
    // At a key, where both take the same numbers.
    const double key = plain.values(plain.file["animations"][c.index]["samplers"][0]["input"], 1)[3];
    REQUIRE(relative(a.world(node, key), plain.world(index, c.index, key)) < 1e-5);
  }
}

TEST_CASE("the robot's head is told apart from its mesh") {
  if (assets().empty()) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with animations");
    return;
  }
  const fs::path path = assets() / "robot_expressive.glb";
  REQUIRE_THROWS_WITH(read(path), Contains("14 clips") && Contains("Robot_Dance") && Contains("Robot_Yes"));
  const Animation a = read(path, clip("Dance"));
  REQUIRE(a.duration == Approx(10.0 / 3).epsilon(1e-6));
  REQUIRE_THROWS_WITH(a.find_node("Head"), Contains("2 nodes") && Contains("Neck/Head"));
  const std::size_t head = a.find_node("Neck/Head");
  REQUIRE(a.nodes[head].animated);
  REQUIRE(a.nodes[a.nodes[head].parent].name == "Neck");
  REQUIRE_NOTHROW(a.find_node("RobotArmature/Head"));
}

TEST_CASE("the FBX fixture stands at a man's height") {
  if (assets().empty()) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with animations");
    return;
  }
  Warnings warnings;
  const Animation a = read_animation(assets() / "crackhead.fbx", {}, warnings);
  REQUIRE(joined(warnings).empty());
  REQUIRE(a.rate == 30);
  REQUIRE(a.duration == Approx(100.0 / 30).epsilon(1e-9));
  REQUIRE(a.unit == 0.01);
  const std::size_t head = a.find_node("Neck/Head");
  double travel = 0;
  for (double t = 0; t < a.duration; t += 0.01) {
    const Isometry3d pose = a.pose(head, t);
    REQUIRE(pose.translation().y() > 1.4);
    REQUIRE(pose.translation().y() < 1.9);
    travel += AngleAxisd(Matrix3d(pose.linear().transpose() * a.pose(head, t + 0.01).linear())).angle();
  }
  REQUIRE(travel > 1);  // it moves
}

TEST_CASE("the BVH fixture is sampled as its own numbers say") {
  if (assets().empty()) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with animations");
    return;
  }
  const fs::path path = assets() / "cmu_01_01.bvh";
  const Animation a = read(path);
  REQUIRE(a.rate == Approx(120).epsilon(1e-5));
  REQUIRE(a.duration == Approx(22.9).margin(0.05));
  const PlainBvh plain(slurp(path));
  REQUIRE(plain.frames.size() == 2752);
  const std::size_t head = a.find_node("Head");
  for (std::size_t f = 0; f < plain.frames.size(); f += 37) {
    CAPTURE(f);
    REQUIRE(relative(a.world(head, static_cast<double>(f) / a.rate), plain.world("Head", f)) < 1e-5);
  }
}

TEST_CASE("the interpolation fixture names what is flattened") {
  if (assets().empty()) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with animations");
    return;
  }
  const std::pair<const char*, const char*> cases[] = {{"Step Scale", "STEP keys"},
                                                       {"CubicSpline Rotation", "CUBICSPLINE keys"},
                                                       {"Step Translation", "\"Cube.006\""},
                                                       {"CubicSpline Translation", "\"Cube.008\""}};
  for (const auto& [name, words] : cases) {
    Warnings warnings;
    read_animation(assets() / "interpolation_test.gltf", clip(name), warnings);
    REQUIRE_THAT(joined(warnings), Contains(words));
  }
  Warnings none;
  read_animation(assets() / "interpolation_test.gltf", clip("Linear Rotation"), none);
  REQUIRE(joined(none).empty());
}

TEST_CASE("fixtures cut short are refused") {
  if (assets().empty()) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with animations");
    return;
  }
  for (const char* name : {"robot_expressive.glb", "crackhead.fbx", "cmu_01_01.bvh", "cesium_man.gltf"}) {
    const std::string bytes = slurp(assets() / name);
    for (std::size_t k = 0; k < 50; ++k) {
      CAPTURE(name, k);
      REQUIRE_THROWS_AS(parse(bytes.substr(0, k * bytes.size() / 50 + k)), InputError);
    }
  }
}

TEST_CASE("whatever lies in assimp's own models is read or refused") {
  const fs::path models = "/usr/share/assimp/models";
  if (!fs::is_directory(models)) {
    WARN("skipped: no assimp test models on this machine");
    return;
  }
  std::size_t read_well = 0;
  for (const auto& entry : fs::recursive_directory_iterator(models)) {
    std::string extension = entry.path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    if (extension != ".bvh" && extension != ".dae" && extension != ".fbx" && extension != ".gltf" &&
        extension != ".glb") {
      continue;
    }
    INFO(entry.path());
    Warnings warnings;
    try {
      const Animation a = read_animation(entry.path(), clip(""), warnings);
      ++read_well;
      for (std::size_t n = 0; n < a.nodes.size(); ++n) {
        REQUIRE(a.nodes[n].parent < static_cast<int>(n));
        for (const double t : {-1.0, 0.0, 0.37 * a.duration, a.duration + 1}) {
          const Matrix4d m = a.world(n, t);
          REQUIRE(m.allFinite());
        }
      }
    } catch (const InputError& error) {
      REQUIRE_THAT(error.what(), Contains(entry.path().filename().string()));
    }
  }
  REQUIRE(read_well > 50);
}
