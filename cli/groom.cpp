#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <type_traits>
#include <variant>
#include <vector>

#include "cli/checks.h"
#include "cli/console.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/groom_file.h"
#include "formats/procedural.h"
#include "formats/units.h"

namespace strandbake {
namespace {

using Field = std::variant<double*, int*, std::uint64_t*, std::string*>;

// Every declared parameter, in the order of its declaration.
struct ListFields {
  std::vector<Field> fields;
  template <class T, class Allowed>
  void operator()(const char*, T& field, const Allowed&, const char*, const char*) {
    fields.emplace_back(&field);
  }
};

// An option for each declared parameter. make_groom() checks the ranges.
struct AddOptions {
  CLI::App& app;
  std::vector<CLI::Option*> options;
  template <class T>
  void operator()(const char* name, T& field, const Range&, const char* unit, const char* help) {
    std::string flag = name;
    std::replace(flag.begin(), flag.end(), '_', '-');
    options.push_back(
        app.add_option("--" + flag, field, help)->type_name(std::string_view(unit) == "1" ? "NUMBER" : unit));
  }
  void operator()(const char* name, std::string& field, const Text& allowed, const char*, const char* help) {
    options.push_back(
        app.add_option(std::string("--") + name, field, help)
            ->check(CLI::IsMember(std::vector<std::string>(allowed.choices.begin(), allowed.choices.end()))));
  }
};

struct GroomOptions {
  std::filesystem::path output;
  std::filesystem::path from;
  std::string units = "m";
  std::string up = "+Y";
  std::string preset;
  bool force = false;
  bool json = false;
  ProceduralParams given;
  std::vector<CLI::Option*> set;
};

Groom convert(const GroomOptions& options, Warnings& warnings) {
  Groom groom = read_groom(options.from, warnings);
  const Eigen::Matrix3d turn = metres_per_unit(options.units) * to_y_up(options.up);
  for (Eigen::Vector3d& p : groom.position) p = turn * p;
  return groom;
}

Groom make(const GroomOptions& options) {
  ProceduralParams params = style_defaults(options.given.style);
  ProceduralParams given = options.given;
  ListFields to, from;
  fields(to, params);
  fields(from, given);
  for (std::size_t i = 0; i < to.fields.size(); ++i) {
    if (options.set[i]->count() == 0) continue;
    std::visit([&](auto* target) { *target = *std::get<std::decay_t<decltype(target)>>(from.fields[i]); },
               to.fields[i]);
  }
  try {
    return make_groom(params);
  } catch (const InputError& error) {
    throw CLI::ValidationError(error.what());  // there is no input but the command line
  }
}

std::string check_units(const std::string& text) {
  try {
    metres_per_unit(text);
  } catch (const std::invalid_argument& error) {
    return error.what();
  }
  return {};
}

int run_groom(const GroomOptions& options) {
  require_free(options.output, options.force);
  Warnings warnings;
  const Groom groom = !options.from.empty()     ? convert(options, warnings)
                      : !options.preset.empty() ? *make_preset(options.preset)
                                                : make(options);
  if (!options.json)
    for (const std::string& warning : warnings) print_warning(warning);
  write_hair(options.output, groom);
  if (options.json) {
    print_json("groom", {{"output", options.output.string()},
                         {"strands", groom.strand_count()},
                         {"vertices", groom.vertex_count()},
                         {"warnings", warnings}});
    return kGood;
  }
  fmt::print("{}: {} strands, {} vertices\n", options.output.string(), groom.strand_count(), groom.vertex_count());
  return kGood;
}

}  // namespace

Verb add_groom(CLI::App& app) {
  auto options = std::make_shared<GroomOptions>();
  app.add_option("-o,--output", options->output, "The .hair file to write, in metres with +Y up")
      ->type_name("FILE")
      ->required();
  app.add_flag("--force", options->force, "Replace an existing file");
  app.add_flag("--json", options->json, "Say what was written as one JSON object");
  auto* const from =
      app.add_option("--from", options->from, "Convert this .hair, .tfx or .obj file in place of making hair")
          ->type_name("FILE");
  app.add_option("--units", options->units, "Units of the file: m, cm, mm, km, in, ft, yd or metres per unit")
      ->check(check_units)
      ->needs(from);
  app.add_option("--up", options->up, "Up axis of the file: +X, -X, +Y, -Y, +Z or -Z")
      ->check(CLI::IsMember({"+X", "-X", "+Y", "-Y", "+Z", "-Z"}))
      ->needs(from);
  auto* const preset = app.add_option("--preset", options->preset, "A groom of exactly the size of the paper's Table 1")
                           ->check(CLI::IsMember(std::vector<std::string>(preset_names.begin(), preset_names.end())))
                           ->excludes(from);
  AddOptions add{app, {}};
  fields(add, options->given);
  for (CLI::Option* option : add.options) option->excludes(from)->excludes(preset);
  options->set = add.options;
  return [options] { return run_groom(*options); };
}

}  // namespace strandbake
