// The one place that knows assimp, a module of its own. What assimp 5.2 does, and what is left to do here:
// - it drops what a glTF says of units (metres, +Y up: nothing to do), leaves FBX in its own units and axes (the
// scene's
//   metadata tell them) and multiplies those of Collada into the root (taken out again);
// - it splits an FBX node with pivots into a chain of nodes "X_$AssimpFbx$_Rotation" ... "X". Without that option
//   (PRESERVE_PIVOTS = false) the keys of such nodes are lost, so we keep the chain; but for a node with nothing more
//   than a joint orientation its keys, on "X", hold the whole transform, and the chain has to go;
// - it names channels by node, so equal names have to be told apart by their order.
#include <assimp/BaseImporter.h>
#include <assimp/MemoryIOWrapper.h>
#include <assimp/config.h>
#include <assimp/importerdesc.h>
#include <assimp/metadata.h>
#include <assimp/scene.h>

#include <Eigen/LU>
#include <algorithm>
#include <assimp/IOSystem.hpp>
#include <assimp/Importer.hpp>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <iterator>
#include <map>
#include <memory>
#include <numeric>
#include <optional>
#include <stdexcept>
#include <utility>

#include "formats/animation.h"
#include "formats/animation_guard.h"
#include "formats/animation_importer.h"
#include "formats/quoted_list.h"
#include "formats/units.h"

namespace strandbake {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix4d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

// Ticks a second where a file has none: what assimp's own viewer and samples take.
constexpr double assumed_rate = 25;
constexpr std::string_view chain_tag = "_$AssimpFbx$_";
constexpr double centimetre = 0.01;
constexpr std::size_t most_clips = 40;  // in one message

// The files that the guard has let through, and no other.
class GuardedFiles : public Assimp::IOSystem {
 public:
  explicit GuardedFiles(const GuardedFile& file) : file_(file) {}

  bool Exists(const char* name) const override { return find(name) != nullptr; }
  char getOsSeparator() const override { return '/'; }
  Assimp::IOStream* Open(const char* name, const char*) override {
    const std::string* bytes = find(name);
    if (bytes == nullptr) return nullptr;
    return new Assimp::MemoryIOStream(reinterpret_cast<const std::uint8_t*>(bytes->data()), bytes->size());
  }
  void Close(Assimp::IOStream* stream) override { delete stream; }

 private:
  const std::string* find(std::string_view name) const {
    if (name.starts_with("./")) name.remove_prefix(2);
    for (const auto& [known, bytes] : file_.files) {
      if (known == name) return &bytes;
    }
    return nullptr;
  }

  const GuardedFile& file_;
};

// An importer for one format alone: the others would otherwise be asked whether they can read a broken file.
std::unique_ptr<Assimp::Importer> make_importer(const GuardedFile& file) {
  auto importer = std::make_unique<Assimp::Importer>();
  const std::string& name = file.files.front().first;
  const std::string extension = name.substr(name.rfind('.') + 1);
  for (std::size_t k = importer->GetImporterCount(); k-- > 0;) {
    const std::string extensions = " " + std::string(importer->GetImporterInfo(k)->mFileExtensions) + " ";
    if (extensions.find(" " + extension + " ") != std::string::npos) continue;
    Assimp::BaseImporter* other = importer->GetImporter(k);
    importer->UnregisterLoader(other);
    delete other;  // unregistered loaders belong to us
  }
  importer->SetIOHandler(new GuardedFiles(file));
  importer->SetPropertyBool(AI_CONFIG_IMPORT_NO_SKELETON_MESHES, true);
  importer->SetPropertyBool(AI_CONFIG_IMPORT_FBX_PRESERVE_PIVOTS, true);
  for (const char* unused : {AI_CONFIG_IMPORT_FBX_READ_ALL_GEOMETRY_LAYERS, AI_CONFIG_IMPORT_FBX_READ_MATERIALS,
                             AI_CONFIG_IMPORT_FBX_READ_TEXTURES, AI_CONFIG_IMPORT_FBX_READ_CAMERAS,
                             AI_CONFIG_IMPORT_FBX_READ_LIGHTS, AI_CONFIG_IMPORT_FBX_READ_WEIGHTS}) {
    importer->SetPropertyBool(unused, false);
  }
  return importer;
}

// The shortest decimal of a float, as a double: 0.01f is meant to be 0.01.
double as_written(float value) {
  char text[64];
  const char* end = std::to_chars(std::begin(text), std::end(text), value).ptr;
  double result = value;
  std::from_chars(text, end, result);
  return result;
}

Matrix4d to_matrix(const aiMatrix4x4& m) {
  Matrix4d result;
  for (int row = 0; row < 4; ++row) {
    for (int column = 0; column < 4; ++column) result(row, column) = m[row][column];
  }
  return result;
}

bool is_separator(char c) {
  return !(c >= '0' && c <= '9') && !(c >= 'A' && c <= 'Z') && !(c >= 'a' && c <= 'z') &&
         static_cast<signed char>(c) >= 0;
}

// "Dance" is a part of "Robot_Dance" and of "Armature|Dance", not of "Dancer".
bool has_part(std::string_view name, std::string_view part) {
  for (std::size_t at = 0; (at = name.find(part, at)) != std::string_view::npos; ++at) {
    const std::size_t end = at + part.size();
    if ((at == 0 || is_separator(name[at - 1])) && (end == name.size() || is_separator(name[end]))) return true;
  }
  return false;
}

// Index of the clip that is asked for among those of the file; none where the file has none.
std::optional<std::size_t> choose_clip(const std::string& source, const std::vector<std::string>& clips,
                                       const std::string& asked, Warnings& warnings) {
  if (clips.empty()) {
    if (!asked.empty()) throw InputError(source + ": clip \"" + asked + "\" is not there; the file has no clips");
    warnings.push_back(source + ": has no clip; its nodes stand still");
    return std::nullopt;
  }
  std::vector<std::string> labels;
  for (std::size_t c = 0; c < clips.size(); ++c) {
    const bool alone = !clips[c].empty() && std::count(clips.begin(), clips.end(), clips[c]) == 1;
    labels.push_back(alone ? clips[c] : "#" + std::to_string(c + 1));
  }
  if (asked.empty()) {
    if (clips.size() == 1) return 0;
    throw InputError(source + ": has " + std::to_string(clips.size()) + " clips; name one of " +
                     quoted_list(labels, most_clips));
  }
  const auto label = std::find(labels.begin(), labels.end(), asked);
  if (label != labels.end()) return static_cast<std::size_t>(label - labels.begin());
  if (std::find(clips.begin(), clips.end(), asked) != clips.end()) {
    throw InputError(source + ": several clips are called \"" + asked + "\"; name one of " +
                     quoted_list(labels, most_clips));
  }
  for (std::size_t c = 0; c < clips.size(); ++c) {  // names may be shared or missing, numbers never are
    if (asked == "#" + std::to_string(c + 1)) return c;
  }
  std::vector<std::size_t> partly;
  for (std::size_t c = 0; c < clips.size(); ++c) {
    if (has_part(clips[c], asked)) partly.push_back(c);
  }
  if (partly.size() == 1) return partly[0];
  throw InputError(source + ": clip \"" + asked + "\" is not there; the clips are " + quoted_list(labels, most_clips));
}

// Fills an Animation from what assimp read.
class Converter {
 public:
  Converter(const GuardedFile& file, const aiScene& scene, std::string source, Warnings& warnings)
      : file_(file), scene_(scene), warnings_(warnings) {
    result_.source = std::move(source);
  }

  // `named` is the same scene once more, with names for people in place of unique ones; may be null.
  Animation run(const AnimationOptions& options, const aiScene* named) {
    if (scene_.mRootNode == nullptr) fail("has no nodes");
    read_nodes(named);
    read_units(options);
    std::vector<std::string> clips = file_.clip_names;
    if (file_.kind != AnimationKind::gltf) {
      for (unsigned a = 0; a < scene_.mNumAnimations; ++a) clips.emplace_back(scene_.mAnimations[a]->mName.C_Str());
    }
    if (clips.size() != scene_.mNumAnimations) fail("lost a clip on the way through the importer");
    if (const auto clip = choose_clip(result_.source, clips, options.clip, warnings_)) {
      result_.clip = clips[*clip];
      read_clip(*scene_.mAnimations[*clip]);
      if (*clip < file_.flattened.size()) warn_flattened(file_.flattened[*clip]);
    }
    if (file_.kind == AnimationKind::fbx) drop_chains();
    if (file_.kind == AnimationKind::bvh && options.units.empty()) warn_units();
    return std::move(result_);
  }

 private:
  [[noreturn]] void fail(const std::string& what) const { throw InputError(result_.source + ": " + what); }
  void warn(const std::string& what) { warnings_.push_back(result_.source + ": " + what); }

  void read_nodes(const aiScene* named) {
    struct Open {
      const aiNode* node;
      const aiNode* named;
      int parent;
    };
    std::vector<Open> open = {{scene_.mRootNode, named ? named->mRootNode : nullptr, -1}};
    while (!open.empty()) {
      const auto [node, with_name, parent] = open.back();
      open.pop_back();
      const int self = static_cast<int>(result_.nodes.size());
      AnimationNode& out = result_.nodes.emplace_back();
      ids_.emplace_back(node->mName.C_Str());
      nodes_of_id_[ids_.back()].push_back(result_.nodes.size() - 1);
      out.name = name_of(ids_.back(), with_name);
      out.parent = parent;
      out.local = to_matrix(node->mTransformation);
      if (!out.local.allFinite()) fail("node \"" + out.name + "\" has a transform that is not finite");
      // A node's shape is moved by its geometric transform, its children are not.
      if (ids_.back().find(std::string(chain_tag) + "Geometric") != std::string::npos) out.local.setIdentity();
      for (unsigned c = node->mNumChildren; c-- > 0;) {  // the first child comes off the stack first
        const bool paired = with_name != nullptr && with_name->mNumChildren == node->mNumChildren;
        open.push_back({node->mChildren[c], paired ? with_name->mChildren[c] : nullptr, self});
      }
    }
  }

  std::string name_of(const std::string& id, const aiNode* with_name) const {
    constexpr std::string_view made_up = "$ColladaAutoName$";
    if (with_name != nullptr && !std::string_view(with_name->mName.C_Str()).starts_with(made_up)) {
      return with_name->mName.C_Str();
    }
    if (id.starts_with(made_up) || id.find(chain_tag) != std::string::npos) return "";
    if (file_.kind != AnimationKind::gltf) return id;
    std::size_t index = 0;
    const auto [end, error] = std::from_chars(id.data(), id.data() + id.size(), index);
    const bool ours = error == std::errc() && end == id.data() + id.size() && index < file_.node_names.size();
    return ours ? file_.node_names[index] : "";  // several roots get one of assimp's above them
  }

  void read_units(const AnimationOptions& options) {
    if (file_.kind == AnimationKind::fbx) read_fbx_units();
    if (file_.kind == AnimationKind::collada) read_collada_units();
    try {
      if (!options.units.empty()) result_.unit = metres_per_unit(options.units);
      if (!options.up.empty()) result_.up = to_y_up(options.up);
    } catch (const std::invalid_argument& error) {
      fail(error.what());
    }
    if (!(result_.unit > 0) || !std::isfinite(result_.unit)) {
      fail("says that its unit is not longer than 0; give the units");
    }
  }

  void read_fbx_units() {
    const aiMetadata* meta = scene_.mMetaData;
    if (meta == nullptr) return;
    float factor = 1;
    if (meta->Get("UnitScaleFactor", factor)) result_.unit = centimetre * as_written(factor);

    // The axes that point to the right, up and to the viewer.
    Matrix3d axes = Matrix3d::Zero();
    const char* const names[] = {"CoordAxis", "UpAxis", "FrontAxis"};
    std::string up = "+Y";
    for (int row = 0; row < 3; ++row) {
      std::int32_t axis = -1;
      std::int32_t sign = 1;
      if (!meta->Get(names[row], axis) || axis < 0 || axis > 2) return;
      meta->Get(std::string(names[row]) + "Sign", sign);
      axes(row, axis) = sign < 0 ? -1 : 1;
      if (row == 1) up = {sign < 0 ? '-' : '+', static_cast<char>('X' + axis)};
    }
    const double handed = axes.determinant();  // exactly 1, -1, or 0 if an axis is named twice
    if (handed == -1) warn("has left-handed axes; it is turned upright but stays mirrored");
    result_.up = handed == 1 ? axes : to_y_up(up);
  }

  // The root is the visual scene, which has no transform of its own.
  void read_collada_units() {
    AnimationNode& root = result_.nodes.front();
    const double unit = root.local.topLeftCorner<3, 3>().cwiseAbs().maxCoeff();
    if (!(unit > 0)) fail("says that its unit is not longer than 0; repair <unit meter=...>");
    result_.up = (root.local.topLeftCorner<3, 3>() / unit).array().round();
    result_.unit = as_written(static_cast<float>(unit));
    root.local.setIdentity();
  }

  void read_clip(const aiAnimation& clip) {
    double rate = clip.mTicksPerSecond;
    if (!std::isfinite(rate)) fail("has a frame rate that is not a number");
    if (rate == 0) {
      rate = assumed_rate;
      warn("has no frame rate; 25 keys a second are assumed");
    } else {
      result_.rate = std::max(0.0, rate);  // negative where an FBX has a rate that assimp does not know; times fit it
    }

    std::map<std::string, std::size_t> channels_of_id;
    for (unsigned c = 0; c < clip.mNumChannels; ++c) ++channels_of_id[clip.mChannels[c]->mNodeName.C_Str()];
    std::map<std::string, std::size_t> taken;
    std::vector<std::string> unknown;
    for (unsigned c = 0; c < clip.mNumChannels; ++c) {
      const aiNodeAnim& channel = *clip.mChannels[c];
      const std::string id = channel.mNodeName.C_Str();
      const auto nodes = nodes_of_id_.find(id);
      if (nodes == nodes_of_id_.end()) {
        unknown.push_back(id.substr(0, id.find(chain_tag)));
        continue;
      }
      // Equal names: nodes and channels come in the same order.
      const std::size_t turn = std::min(taken[id]++, nodes->second.size() - 1);
      if (turn == 0 && nodes->second.size() != channels_of_id[id]) {
        warn(std::to_string(nodes->second.size()) + " nodes are called \"" + id + "\" but the clip moves " +
             std::to_string(channels_of_id[id]) + "; which one is a guess, rename them");
      }
      read_channel(channel, rate, result_.nodes[nodes->second[turn]]);
    }
    if (!unknown.empty()) {
      std::sort(unknown.begin(), unknown.end());
      unknown.erase(std::unique(unknown.begin(), unknown.end()), unknown.end());
      warn("the clip moves nodes that are not there: " + quoted_list(unknown));
    }
    if (!repaired_.empty()) {
      warn("keys out of order or twice at one time were sorted, the last one counts, for " + quoted_list(repaired_));
    }
    if (!no_turn_.empty()) warn("rotation keys of length 0 were left out for " + quoted_list(no_turn_));
  }

  void read_channel(const aiNodeAnim& channel, double rate, AnimationNode& node) {
    const std::string name = node.name.empty() ? std::string("(no name)") : node.name;
    bool in_order = true;
    bool turns = true;
    const auto add = [&](double tick, const auto& value, auto& keys) {
      const double time = tick / rate;
      if (!std::isfinite(time) || !value.allFinite()) fail("node \"" + name + "\" has a key that is not finite");
      keys.time.push_back(time);
      keys.value.emplace_back(value);
    };
    node.animated = true;
    node.translation = {};
    node.rotation = {};
    node.scale = {};
    for (unsigned k = 0; k < channel.mNumPositionKeys; ++k) {
      const aiVector3D& v = channel.mPositionKeys[k].mValue;
      add(channel.mPositionKeys[k].mTime, Vector3d(v.x, v.y, v.z), node.translation);
    }
    for (unsigned k = 0; k < channel.mNumScalingKeys; ++k) {
      const aiVector3D& v = channel.mScalingKeys[k].mValue;
      add(channel.mScalingKeys[k].mTime, Vector3d(v.x, v.y, v.z), node.scale);
    }
    for (unsigned k = 0; k < channel.mNumRotationKeys; ++k) {
      const aiQuaternion& q = channel.mRotationKeys[k].mValue;
      Eigen::Vector4d v(q.x, q.y, q.z, q.w);
      if (v.allFinite() && v.squaredNorm() < 1e-12) {  // no exporter means this as a direction
        turns = false;
        continue;
      }
      add(channel.mRotationKeys[k].mTime, Eigen::Vector4d(v.normalized()), node.rotation);
    }
    in_order &= sort(node.translation);
    in_order &= sort(node.scale);
    in_order &= sort(node.rotation);
    if (!in_order) repaired_.push_back(name);
    if (!turns) no_turn_.push_back(name);
  }

  // Makes times strictly increasing; of equal ones the last counts. False where that changed anything.
  template <class T>
  bool sort(Keys<T>& keys) {
    if (!keys.time.empty()) {
      result_.duration = std::max(result_.duration, *std::max_element(keys.time.begin(), keys.time.end()));
    }
    if (std::is_sorted(keys.time.begin(), keys.time.end(), std::less_equal<>())) return true;
    std::vector<std::size_t> order(keys.time.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](auto a, auto b) { return keys.time[a] < keys.time[b]; });
    Keys<T> sorted;
    for (const std::size_t k : order) {
      if (!sorted.time.empty() && sorted.time.back() == keys.time[k]) {
        sorted.value.back() = keys.value[k];
      } else {
        sorted.time.push_back(keys.time[k]);
        sorted.value.push_back(keys.value[k]);
      }
    }
    keys = std::move(sorted);
    return false;
  }

  // Keys on an FBX node itself hold its whole transform: the chain above it would count a second time.
  void drop_chains() {
    for (std::size_t n = 0; n < result_.nodes.size(); ++n) {
      AnimationNode& node = result_.nodes[n];
      if (!node.animated || node.name.empty()) continue;
      const std::string prefix = ids_[n] + std::string(chain_tag);
      while (node.parent >= 0 && ids_[node.parent].starts_with(prefix)) {
        const AnimationNode& link = result_.nodes[node.parent];
        if (ids_[node.parent] == prefix + "PostRotation") {
          // An FBX rotation ends with the inverse of the post-rotation; assimp's keys end with the post-rotation
          // itself.
          const Quaterniond inverse(Matrix3d(link.local.topLeftCorner<3, 3>()));
          for (Quaterniond& key : node.rotation.value) key = (key * inverse * inverse).normalized();
        }
        node.parent = link.parent;
      }
    }
  }

  void warn_flattened(const FlattenedKeys& keys) {
    if (!keys.step.empty()) {
      warn("STEP keys are read as LINEAR (moving where they should jump) for " + quoted_list(keys.step));
    }
    if (!keys.cubic_spline.empty()) {
      warn("CUBICSPLINE keys are read as LINEAR (corners at the keys) for " + quoted_list(keys.cubic_spline));
    }
  }

  void warn_units() {
    double low = 0;
    double high = 0;
    for (std::size_t n = 0; n < result_.nodes.size(); ++n) {
      const double y = (result_.up * result_.world(n, 0).topRightCorner<3, 1>()).y();
      low = n == 0 ? y : std::min(low, y);
      high = n == 0 ? y : std::max(high, y);
    }
    char text[64];
    std::snprintf(text, sizeof text, "%.3g", high - low);
    warn(std::string("BVH names no units; metres are assumed, which makes it ") + text +
         " m tall, else give the units");
  }

  const GuardedFile& file_;
  const aiScene& scene_;
  Warnings& warnings_;
  Animation result_;
  std::vector<std::string> ids_;  // of the nodes, as assimp has them
  std::map<std::string, std::vector<std::size_t>> nodes_of_id_;
  std::vector<std::string> repaired_;
  std::vector<std::string> no_turn_;
};

// Keeps the scene alive with its importer.
struct Import {
  std::unique_ptr<Assimp::Importer> importer;
  const aiScene* scene = nullptr;
};

Import import_scene(const GuardedFile& file, const AnimationOptions& options, bool names, const std::string& source) {
  std::string reason = "unknown";
  try {
    Import import{make_importer(file), nullptr};
    import.importer->SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_IGNORE_UP_DIRECTION, !options.up.empty());
    import.importer->SetPropertyBool(AI_CONFIG_IMPORT_COLLADA_USE_COLLADA_NAMES, names);
    import.scene = import.importer->ReadFile(file.files.front().first, 0);
    if (import.scene != nullptr) return import;
    reason = import.importer->GetErrorString();
  } catch (const std::exception& error) {
    reason = error.what();
  } catch (...) {
    // assimp throws nothing else that it documents, and the reason stays unknown
  }
  std::replace(reason.begin(), reason.end(), '\n', ' ');
  throw InputError(source + ": cannot be read as an animation (the importer says: " + reason + ")");
}

}  // namespace
}  // namespace strandbake

extern "C" __attribute__((visibility("default"))) void strandbake_import_animation(
    const strandbake::GuardedFile& file, const std::string& source, const strandbake::AnimationOptions& options,
    strandbake::Warnings& warnings, strandbake::Animation& animation) {
  using namespace strandbake;
  const Import import = import_scene(file, options, false, source);
  Import named;
  if (file.kind == AnimationKind::collada) named = import_scene(file, options, true, source);
  animation = Converter(file, *import.scene, source, warnings).run(options, named.scene);
}
