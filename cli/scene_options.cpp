#include <omp.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <string_view>

#include "cli/verbs.h"
#include "formats/scene.h"

namespace strandbake {

std::string check_frames(const std::string& text) {
  try {
    parse_frames(text);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return {};
}

int default_threads(std::size_t vertices) {
  constexpr std::size_t kVerticesOfAThread = 4096;
  return static_cast<int>(
      std::clamp<std::size_t>(vertices / kVerticesOfAThread, 1, static_cast<std::size_t>(omp_get_max_threads())));
}

void SceneOptions::add_to(CLI::App& app) {
  app.add_option("scene", scene, "The scene file (TOML)")->type_name("FILE")->required();
  app.add_option("--set", overrides,
                 "Set a parameter in place of the scene's, e.g. bake.substeps=8 or region.tail.damping=0.2")
      ->type_name("KEY=VALUE")
      ->take_all()
      ->expected(1);
  app.add_option("--search", search,
                 "Folder for files that are not beside the scene; STRANDBAKE_PATH lists more, divided by ':'")
      ->type_name("FOLDER")
      ->take_all()
      ->expected(1);
  app.parse_complete_callback([this] {
    const char* const listed = std::getenv("STRANDBAKE_PATH");
    std::string_view rest = listed == nullptr ? "" : listed;
    while (!rest.empty()) {
      const std::size_t end = std::min(rest.find(':'), rest.size());
      if (end > 0) search.emplace_back(rest.substr(0, end));
      rest.remove_prefix(std::min(end + 1, rest.size()));
    }
  });
}

}  // namespace strandbake
