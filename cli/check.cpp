#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "cli/console.h"
#include "cli/plan_text.h"
#include "cli/verbs.h"
#include "formats/shot.h"

namespace strandbake {

Verb add_check(CLI::App& app) {
  auto options = std::make_shared<SceneOptions>();
  options->add_to(app);
  auto backend = std::make_shared<BackendOptions>();
  backend->add_to(app);
  return [options, backend] {
    if (const std::string misuse = backend->misuse(); !misuse.empty()) {
      print_error(misuse);
      return static_cast<int>(kUsage);
    }
    Faults faults;
    Warnings warnings;
    Scene scene = read_scene(options->scene, options->overrides, options->search, faults);
    const Shot shot = load_shot(std::move(scene), faults, warnings);
    for (const std::string& warning : warnings) print_warning(warning);
    if (!faults.empty()) {
      print_faults(faults);
      return static_cast<int>(kInput);
    }
    fmt::print("{}", describe_plan(shot, {shot.scene.first_frame, shot.scene.last_frame},
                                   choose_backend(*backend, precision_of(shot.scene),
                                                  vertex_substeps(shot, shot.scene.last_frame)),
                                   default_threads(shot.groom.vertex_count())));
    return static_cast<int>(kGood);
  };
}

}  // namespace strandbake
