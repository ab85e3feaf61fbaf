#include <fmt/format.h>
#include <omp.h>

#include <CLI/CLI.hpp>
#include <array>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>

#include "cli/backend.h"
#include "cli/bench/benchmarks.h"
#include "cli/checks.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "formats/error.h"

namespace strandbake {
namespace {

struct Benchmark {
  const char* name;
  const char* help;
  Report (*run)(const BenchOptions&);
};
constexpr std::array<Benchmark, 7> kBenchmarks = {
    {{"table2", "The paper's Table 2 on this processor, with the paper's figures beside", bench_table2},
     {"passes", "What each pass of the solver costs, alone and on top of the others", bench_passes},
     {"scaling", "How time grows with strands, vertices, threads, substeps, lanes and regions", bench_scaling},
     {"bake", "Bakes from end to end, beside their solver alone and their disk alone", bench_bake},
     {"features", "What each thing that a scene asks for costs, on and off", bench_features},
     {"error", "Run time against error: methods, substeps, iterations, length solvers, precision", bench_error},
     {"stability", "What shots that no hair is made for come to: stretch, growth, rest", bench_stability}}};

struct BenchVerbOptions {
  BenchOptions bench;
  std::filesystem::path csv, svg;
  bool json = false;
  bool force = false;
};

void write_report(const std::filesystem::path& path, const std::string& text) {
  if (path.empty()) return;
  std::ofstream out(path, std::ios::binary);
  out << text;
  out.close();
  if (!out) throw DiskError(fmt::format("{}: cannot be written", path.string()));
}

int run_bench(const Benchmark& benchmark, BenchVerbOptions options) {
  // Before minutes of measuring, not after.
  for (const std::filesystem::path& path : {options.csv, options.svg}) {
    if (!path.empty()) require_free(path, options.force);
    if (path.has_parent_path() && !std::filesystem::is_directory(path.parent_path())) {
      throw DiskError(fmt::format("{}: there is no folder {}; create it", path.string(), path.parent_path().string()));
    }
  }
  if (options.bench.threads == 0) options.bench.threads = omp_get_max_threads();
  options.bench.program_cache = program_cache_folder();
  const Report report = benchmark.run(options.bench);
  if (options.json) {
    print_json("bench", report_json(report));
  } else {
    fmt::print("{}", report_text(report));
  }
  write_report(options.csv, report_csv(report));
  write_report(options.svg, svg_of(report.figure));
  return kGood;
}

}  // namespace

Verb add_bench(CLI::App& app) {
  auto options = std::make_shared<BenchVerbOptions>();
  options->bench.threads = 0;
  options->bench.folder = ".";
  app.require_subcommand(1);
  for (const Benchmark& benchmark : kBenchmarks) {
    CLI::App* const sub = app.add_subcommand(benchmark.name, benchmark.help);
    sub->add_option("--csv", options->csv, "Also write the table as CSV")->type_name("FILE");
    sub->add_option("--svg", options->svg, "Also draw a plot")->type_name("FILE");
    sub->add_flag("--force", options->force, "Replace existing files");
    sub->add_flag("--json", options->json, "Machine, probes and table as one JSON object");
    sub->add_flag("--quick", options->bench.quick, "A first look in seconds: fewer rounds and smaller sweeps");
    sub->add_option("--threads", options->bench.threads, "Threads; left out: all cores")->check(CLI::Range(1, 4096));
    sub->add_option("--share", options->bench.share, "Use only this share of the strands of each groom")
        ->check(CLI::Range(1e-4, 1.0))
        ->capture_default_str();
    sub->add_option("--folder", options->bench.folder, "Where bakes put their files; left out: this folder")
        ->type_name("FOLDER")
        ->check(CLI::ExistingDirectory);
  }
  for (const char* const with_devices : {"table2", "scaling"}) {
    app.get_subcommand(with_devices)
        ->add_option("--device", options->bench.devices,
                     "Also run on this OpenCL device: each mapping of table2, the regions of scaling")
        ->type_name("N")
        ->check(CLI::NonNegativeNumber);
  }
  app.get_subcommand("stability")
      ->add_option("--assets", options->bench.assets, "Folder with real grooms and animation, for more shots")
      ->type_name("FOLDER")
      ->envname("STRANDBAKE_ASSETS")
      ->check(CLI::ExistingDirectory);
  return [options, &app]() -> int {
    const std::string name = app.get_subcommands().front()->get_name();
    for (const Benchmark& benchmark : kBenchmarks) {
      if (name == benchmark.name) return run_bench(benchmark, *options);
    }
    return kUsage;
  };
}

}  // namespace strandbake
