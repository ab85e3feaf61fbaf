#include <dlfcn.h>

#include <filesystem>
#include <system_error>

#include "formats/animation.h"
#include "formats/animation_guard.h"
#include "formats/animation_importer.h"

namespace strandbake {
namespace {

// Loads the importer, which then stays.
StrandbakeImportAnimation* load_importer(const std::string& source) {
  const std::filesystem::path module = STRANDBAKE_ASSIMP_MODULE;
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  const std::filesystem::path installed = (folder / "../lib/strandbake").lexically_normal();
  for (const std::filesystem::path& place : {folder / module, installed / module}) {
    if (!std::filesystem::exists(place, error)) continue;
    void* const library = dlopen(place.c_str(), RTLD_NOW | RTLD_LOCAL);
    void* const import = library == nullptr ? nullptr : dlsym(library, "strandbake_import_animation");
    if (import != nullptr) return reinterpret_cast<StrandbakeImportAnimation*>(import);
    const char* const reason = dlerror();
    throw InputError(source + ": the reader of animation cannot be loaded (" + reason +
                     "); install strandbake and assimp again");
  }
  throw InputError(source + ": the reader of animation, " + module.string() + ", is neither in " + folder.string() +
                   " nor in " + installed.string() + "; install strandbake again");
}

}  // namespace

Animation parse_animation(std::string_view bytes, const std::filesystem::path& path, const AnimationOptions& options,
                          Warnings& warnings) {
  const std::string source = path.string();
  const GuardedFile file = guard_animation(bytes, path, warnings);
  static StrandbakeImportAnimation* const import = load_importer(source);
  Animation animation;
  import(file, source, options, warnings, animation);
  return animation;
}

Animation read_animation(const std::filesystem::path& path, const AnimationOptions& options, Warnings& warnings) {
  return parse_animation(read_bytes(path), path, options, warnings);
}

}  // namespace strandbake
