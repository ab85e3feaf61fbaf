#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "cli/console.h"
#include "cli/plan_text.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/shot.h"

namespace strandbake {

Verb add_check(CLI::App& app) {
  auto options = std::make_shared<SceneOptions>();
  options->add_to(app);
  auto backend = std::make_shared<BackendOptions>();
  backend->add_to(app);
  auto json = std::make_shared<bool>(false);
  app.add_flag("--json", *json, "Faults, warnings and plan as one JSON object");
  return [options, backend, json] {
    if (const std::string misuse = backend->misuse(); !misuse.empty()) {
      print_error(misuse);
      return static_cast<int>(kUsage);
    }
    Faults faults;
    Warnings warnings;
    Scene scene = read_scene(options->scene, options->overrides, options->search, faults);
    const Shot shot = load_shot(std::move(scene), faults, warnings);
    nlohmann::ordered_json out = {{"scene", options->scene.string()},
                                  {"good", faults.empty()},
                                  {"faults", nlohmann::ordered_json::array()},
                                  {"warnings", warnings}};
    if (!*json)
      for (const std::string& warning : warnings) print_warning(warning);
    if (!faults.empty()) {
      for (const Fault& fault : faults) out["faults"].push_back({{"place", fault.place}, {"message", fault.what}});
      if (*json) print_json("check", out);
      print_faults(faults);
      return static_cast<int>(kInput);
    }
    const Backend chosen =
        choose_backend(*backend, precision_of(shot.scene), vertex_substeps(shot, shot.scene.last_frame));
    const std::pair<int, int> frames = {shot.scene.first_frame, shot.scene.last_frame};
    const int threads = default_threads(shot.groom.vertex_count());
    if (*json) {
      out["plan"] = plan_json(shot, frames, chosen, threads);
      print_json("check", out);
    } else {
      fmt::print("{}", describe_plan(shot, frames, chosen, threads));
    }
    return static_cast<int>(kGood);
  };
}

}  // namespace strandbake
