#include <nettle/base64.h>

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>
#include <utility>
#include <vector>

#include "formats/animation_guard_parts.h"

namespace strandbake {
namespace {

using nlohmann::json;

class GltfGuard {
 public:
  GltfGuard(std::string_view bytes, const std::filesystem::path& path) : path_(path), name_(path.string()) {
    std::string_view text = bytes;
    if (bytes.starts_with("glTF")) text = open_container(bytes);
    try {
      file_ = json::parse(text.begin(), text.end());
    } catch (const json::parse_error& error) {
      fail("is not valid JSON" + at_byte(error.byte) + "; it may be cut short");
    }
  }

  GuardedFile run(Warnings& warnings) {
    try {
      check_version();
      json out;
      out["asset"]["version"] = "2.0";
      read_nodes(out);
      read_clips(out, warnings);
      write_buffers(out);
      result_.kind = AnimationKind::gltf;
      result_.files.insert(result_.files.begin(), {"animation.gltf", out.dump()});
      return std::move(result_);
    } catch (const json::exception& error) {
      const std::string what = error.what();
      fail("has an entry of the wrong kind (" + what.substr(std::min(what.size(), what.find("] ") + 2)) + ")");
    }
  }

 private:
  [[noreturn]] void fail(const std::string& what) const { throw InputError(name_ + ": " + what); }

  // GLB: returns the text, keeps the binary chunk.
  std::string_view open_container(std::string_view bytes) {
    if (bytes.size() < 20) {
      fail("is cut short: a GLB file has at least 20 bytes, this one " + std::to_string(bytes.size()));
    }
    if (little32(bytes, 4) != 2) {
      fail("is GLB version " + std::to_string(little32(bytes, 4)) + "; export it as glTF 2.0");
    }
    if (little32(bytes, 8) > bytes.size()) {
      fail("is cut short: its header says " + std::to_string(little32(bytes, 8)) + " bytes, the file has " +
           std::to_string(bytes.size()));
    }
    const std::size_t text_size = little32(bytes, 12);
    if (bytes.substr(16, 4) != "JSON" || text_size > bytes.size() - 20) fail("has no JSON chunk" + at_byte(12));
    const std::size_t next = 20 + text_size + (4 - text_size % 4) % 4;
    if (next + 8 <= bytes.size() && bytes.substr(next + 4, 4) == std::string_view("BIN\0", 4)) {
      if (little32(bytes, next) > bytes.size() - next - 8) fail("has a binary chunk that is cut short" + at_byte(next));
      binary_chunk_ = bytes.substr(next + 8, little32(bytes, next));
    }
    return bytes.substr(20, text_size);
  }

  void check_version() const {
    if (!file_.is_object() || !file_.contains("asset")) fail("is JSON but not glTF: it has no \"asset\"");
    const std::string version = file_["asset"].value("version", "");
    if (!version.starts_with("2.")) fail("is glTF version \"" + version + "\"; export it as glTF 2.0");
  }

  const json& list(const char* key) const {
    static const json none = json::array();
    if (!file_.contains(key)) return none;
    if (!file_[key].is_array()) fail("has \"" + std::string(key) + "\" that is not a list");
    return file_[key];
  }

  // entry[key] as an index into a list of that size.
  std::size_t index(const json& entry, const char* key, std::size_t size, const std::string& where) const {
    const auto found = entry.find(key);
    if (found == entry.end() || !found->is_number_unsigned() || found->get<std::uint64_t>() >= size) {
      fail(where + " has a \"" + key + "\" that is missing or beyond the last of " + std::to_string(size));
    }
    return found->get<std::size_t>();
  }

  std::uint64_t number(const json& entry, const char* key, std::uint64_t missing, const std::string& where) const {
    const auto found = entry.find(key);
    if (found == entry.end()) return missing;
    // The importer counts in 32 bits.
    if (!found->is_number_unsigned() || found->get<std::uint64_t>() > UINT32_MAX) {
      fail(where + " has a \"" + key + "\" that is not a whole number of 0 or more");
    }
    return found->get<std::uint64_t>();
  }

  void read_nodes(json& out) {
    const json& nodes = list("nodes");
    std::vector<int> parent(nodes.size(), -1);
    json rewritten = json::array();
    for (std::size_t n = 0; n < nodes.size(); ++n) {
      const std::string where = "node " + std::to_string(n);
      const json& node = nodes[n];
      if (!node.is_object()) fail(where + " is not an object");
      const std::string name = node.value("name", "");
      result_.node_names.push_back(name.empty() ? "nodes[" + std::to_string(n) + "]" : name);
      json entry = {{"name", std::to_string(n)}};
      for (const auto& [key, size] : {std::pair("matrix", 16), {"translation", 3}, {"rotation", 4}, {"scale", 3}}) {
        if (!node.contains(key)) continue;
        const json& values = node[key];
        if (!values.is_array() || values.size() != static_cast<std::size_t>(size) ||
            !std::all_of(values.begin(), values.end(), [](const json& v) { return v.is_number(); })) {
          fail(where + " has a \"" + key + "\" that is not " + std::to_string(size) + " numbers");
        }
        entry[key] = values;
      }
      for (const json& child : node.value("children", json::array())) {
        const std::size_t c = index(json{{"child", child}}, "child", nodes.size(), where);
        if (parent[c] >= 0) fail("node " + std::to_string(c) + " is the child of two nodes");
        parent[c] = static_cast<int>(n);
        entry["children"].push_back(c);
      }
      rewritten.push_back(std::move(entry));
    }

    std::vector<std::size_t> roots;
    const json& scenes = list("scenes");
    if (!scenes.empty()) {
      const std::size_t scene = file_.contains("scene") ? index(file_, "scene", scenes.size(), "the file") : 0;
      for (const json& root : scenes[scene].value("nodes", json::array())) {
        roots.push_back(index(json{{"node", root}}, "node", nodes.size(), "scene " + std::to_string(scene)));
        if (parent[roots.back()] >= 0) fail("node " + std::to_string(roots.back()) + " is a root and a child");
      }
    } else {
      for (std::size_t n = 0; n < nodes.size(); ++n) {
        if (parent[n] < 0) roots.push_back(n);
      }
    }
    if (roots.empty()) fail("has no nodes");

    in_scene_.assign(nodes.size(), false);
    std::vector<std::pair<std::size_t, std::size_t>> open;  // node and depth
    for (const std::size_t root : roots) open.emplace_back(root, 1);
    while (!open.empty()) {
      const auto [n, depth] = open.back();
      open.pop_back();
      if (depth > deepest) fail("nests its nodes more than " + std::to_string(deepest) + " deep");
      if (in_scene_[n]) fail("names node " + std::to_string(n) + " twice in its scene");
      in_scene_[n] = true;
      if (rewritten[n].contains("children")) {
        for (const json& child : rewritten[n]["children"]) open.emplace_back(child.get<std::size_t>(), depth + 1);
      }
    }
    out["nodes"] = std::move(rewritten);
    out["scene"] = 0;
    out["scenes"][0]["nodes"] = roots;
  }

  void read_clips(json& out, Warnings& warnings) {
    const std::size_t node_count = list("nodes").size();
    out["accessors"] = json::array();
    for (std::size_t a = 0; a < list("accessors").size(); ++a) out["accessors"].push_back(json::object());
    out["bufferViews"] = json::array();
    for (std::size_t v = 0; v < list("bufferViews").size(); ++v) out["bufferViews"].push_back(json::object());
    const json& clips = list("animations");
    for (std::size_t c = 0; c < clips.size(); ++c) {
      const std::string where = "animation " + std::to_string(c);
      if (!clips[c].is_object()) fail(where + " is not an object");
      result_.clip_names.push_back(clips[c].value("name", ""));
      FlattenedKeys& flattened = result_.flattened.emplace_back();
      const json samplers = clips[c].value("samplers", json::array());
      json clip = {{"name", std::to_string(c)}, {"samplers", json::array()}, {"channels", json::array()}};
      std::set<std::pair<std::size_t, std::string>> seen;
      for (const json& channel : clips[c].value("channels", json::array())) {
        if (!channel.is_object() || !channel.contains("target")) fail(where + " has a channel without a target");
        const json& target = channel["target"];
        const std::string what = target.value("path", "");
        if (!target.contains("node") || (what != "translation" && what != "rotation" && what != "scale")) continue;
        const std::size_t node = index(target, "node", node_count, where);
        if (!in_scene_[node]) continue;
        if (!seen.emplace(node, what).second) {
          warnings.push_back(name_ + ": " + where + " moves the " + what + " of node \"" + result_.node_names[node] +
                             "\" twice; the last one counts");
        }
        const json& sampler = samplers[index(channel, "sampler", samplers.size(), where)];
        const std::string interpolation = sampler.value("interpolation", "LINEAR");
        const std::size_t per_key = interpolation == "CUBICSPLINE" ? 3 : 1;
        const std::uint64_t keys = check_accessor(sampler, "input", "SCALAR", 1, where, out);
        const bool turn = what == "rotation";
        if (check_accessor(sampler, "output", turn ? "VEC4" : "VEC3", turn ? 4 : 3, where, out) != keys * per_key) {
          fail(where + " has " + std::to_string(keys) + " key times for the " + what + " of node \"" +
               result_.node_names[node] + "\" but another number of values");
        }
        std::vector<std::string>* kind = interpolation == "STEP"          ? &flattened.step
                                         : interpolation == "CUBICSPLINE" ? &flattened.cubic_spline
                                                                          : nullptr;
        if (kind && std::find(kind->begin(), kind->end(), result_.node_names[node]) == kind->end()) {
          kind->push_back(result_.node_names[node]);
        }
        clip["channels"].push_back(
            {{"sampler", clip["samplers"].size()}, {"target", {{"node", node}, {"path", what}}}});
        clip["samplers"].push_back(
            {{"input", sampler["input"]}, {"output", sampler["output"]}, {"interpolation", interpolation}});
      }
      out["animations"].push_back(std::move(clip));
    }
  }

  // Returns the number of its elements.
  std::uint64_t check_accessor(const json& sampler, const char* key, const char* type, std::uint64_t floats,
                               const std::string& clip, json& out) {
    const json& accessors = list("accessors");
    const std::size_t a = index(sampler, key, accessors.size(), clip);
    const std::string where = "accessor " + std::to_string(a);
    const json& accessor = accessors[a];
    if (accessor.value("type", "") != type) fail(where + " should be of type " + type);
    if (accessor.value("componentType", 0) != 5126) {
      fail(where + " holds keys as integers, which the importer misreads; export the animation with float keys");
    }
    if (accessor.contains("sparse") || !accessor.contains("bufferView")) {
      fail(where + " holds sparse keys, which cannot be read; export the animation without sparse accessors");
    }
    const std::size_t v = index(accessor, "bufferView", list("bufferViews").size(), where);
    const json& view = list("bufferViews")[v];
    const std::string view_where = "buffer view " + std::to_string(v);
    if (view.contains("extensions")) {
      fail(view_where + " is compressed; export the animation without mesh compression (EXT_meshopt_compression)");
    }
    const std::size_t b = index(view, "buffer", list("buffers").size(), view_where);
    const std::uint64_t size = load_buffer(b).size();
    const std::uint64_t view_offset = number(view, "byteOffset", 0, view_where);
    const std::uint64_t view_size = number(view, "byteLength", 0, view_where);
    const std::uint64_t offset = number(accessor, "byteOffset", 0, where);
    const std::uint64_t count = number(accessor, "count", 0, where);
    const std::uint64_t stride = number(view, "byteStride", 0, view_where);
    const std::uint64_t step = stride == 0 ? 4 * floats : stride;
    if (view_offset + view_size > size || count == 0 || step < 4 * floats ||
        offset + (count - 1) * step + 4 * floats > view_size) {
      fail(where + " reaches beyond its buffer of " + std::to_string(size) + " bytes, or is empty");
    }
    out["accessors"][a] = {
        {"bufferView", v}, {"byteOffset", offset}, {"componentType", 5126}, {"count", count}, {"type", type}};
    out["bufferViews"][v] = {{"buffer", b}, {"byteOffset", view_offset}, {"byteLength", view_size}};
    if (stride != 0) out["bufferViews"][v]["byteStride"] = stride;
    return count;
  }

  const std::string& load_buffer(std::size_t b) {
    const auto known = buffers_.find(b);
    if (known != buffers_.end()) return known->second;
    const json& buffer = list("buffers")[b];
    const std::string where = "buffer " + std::to_string(b);
    if (!buffer.is_object()) fail(where + " is not an object");
    std::string data;
    if (!buffer.contains("uri")) {
      if (b != 0 || binary_chunk_.empty()) fail(where + " has no data");
      data = std::string(binary_chunk_);
    } else {
      const auto& uri = buffer["uri"].get_ref<const std::string&>();
      data = uri.starts_with("data:") ? decode_base64(uri, where) : read_beside(uri, where);
    }
    const std::uint64_t size = number(buffer, "byteLength", 0, where);
    if (data.size() < size) {
      fail(where + " should have " + std::to_string(size) + " bytes but has " + std::to_string(data.size()));
    }
    data.resize(size);
    return buffers_[b] = std::move(data);
  }

  std::string decode_base64(const std::string& uri, const std::string& where) const {
    const std::size_t comma = uri.find(";base64,");
    if (comma == std::string::npos) fail(where + " is embedded but not as base64");
    const std::size_t begin = comma + 8;
    std::string data(BASE64_DECODE_LENGTH(uri.size() - begin), '\0');
    base64_decode_ctx context;
    base64_decode_init(&context);
    std::size_t size = data.size();
    if (!base64_decode_update(&context, &size, reinterpret_cast<std::uint8_t*>(data.data()), uri.size() - begin,
                              uri.data() + begin) ||
        !base64_decode_final(&context)) {
      fail(where + " is not valid base64");
    }
    data.resize(size);
    return data;
  }

  std::string read_beside(const std::string& uri, const std::string& where) const {
    std::string file;
    for (std::size_t k = 0; k < uri.size(); ++k) {
      unsigned code = 0;
      if (uri[k] == '%' && k + 2 < uri.size() &&
          std::from_chars(uri.data() + k + 1, uri.data() + k + 3, code, 16).ptr == uri.data() + k + 3) {
        file += static_cast<char>(code);
        k += 2;
      } else {
        file += uri[k];
      }
    }
    if (file.find(':') != std::string::npos || file.find('\0') != std::string::npos ||
        std::filesystem::path(file).is_absolute()) {
      fail(where + " lies at \"" + uri + "\", which is not a file beside it");
    }
    return read_bytes(path_.parent_path() / file);
  }

  void write_buffers(json& out) {
    out["buffers"] = json::array();
    for (std::size_t b = 0; b < list("buffers").size(); ++b) out["buffers"].push_back(json::object());
    for (auto& [b, data] : buffers_) {
      const std::string file = std::to_string(b) + ".bin";
      out["buffers"][b] = {{"uri", file}, {"byteLength", data.size()}};
      result_.files.emplace_back(file, std::move(data));
    }
  }

  std::filesystem::path path_;
  std::string name_;
  std::string_view binary_chunk_;
  json file_;
  std::vector<bool> in_scene_;
  std::map<std::size_t, std::string> buffers_;  // those that keys lie in
  GuardedFile result_;
};

}  // namespace

GuardedFile guard_gltf(std::string_view bytes, const std::filesystem::path& path, Warnings& warnings) {
  return GltfGuard(bytes, path).run(warnings);
}

}  // namespace strandbake
