// Any bytes as a scene; where the first line begins with "!", the rest of that line is an override.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <vector>

#include "formats/scene.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace strandbake;
  std::string text(reinterpret_cast<const char*>(data), size);
  std::vector<std::string> overrides;
  if (!text.empty() && text[0] == '!') {
    const std::size_t end = std::min(text.find('\n'), text.size());
    overrides.push_back(text.substr(1, end - 1));
    text.erase(0, end);
  }
  Faults faults;
  const Scene scene = parse_scene(text, "scene.toml", overrides, {}, faults);
  for (const Fault& fault : faults) {
    if (fault.place.empty() || fault.what.empty() || fault.what.find('\n') != std::string::npos) std::abort();
  }
  if (scene.regions.empty() || scene.last_frame < scene.first_frame) std::abort();
  for (const RegionScene& region : scene.regions) region.params.at(12);
  for (const Animated<ColliderParams>& collider : scene.colliders) collider.at(12);

  // What was read can be written, and is then read as the same.
  if (faults.empty()) {
    std::string shape = "groom.files = [";
    for (std::size_t k = 0; k < scene.groom.files.size(); ++k) shape += "{}, ";
    shape += "]\n";
    for (std::size_t k = 0; k < scene.regions.size(); ++k) shape += "[[region]]\n";
    for (std::size_t k = 0; k < scene.colliders.size(); ++k) shape += "[[collider]]\nsphere = {}\n";
    const auto list = list_parameters(scene);
    std::vector<std::string> values;
    for (const auto& [key, value] : list) values.push_back(key + "=" + value);
    if (list_parameters(parse_scene(shape, "again.toml", values, {}, faults)) != list || !faults.empty()) std::abort();
  }
  return 0;
}
