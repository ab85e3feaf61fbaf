#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "cli/verbs.h"
#include "formats/scene.h"

namespace strandbake {

Verb add_docs(CLI::App& app) {
  auto example = std::make_shared<bool>(false);
  app.add_flag("--example", *example,
               "A commented scene with every parameter at its default, in place of the reference");
  return [example] {
    fmt::print("{}", *example ? default_scene() : scene_reference());
    return kGood;
  };
}

}  // namespace strandbake
