// Table 2 of the paper on this machine's processor, and on OpenCL devices.
#include <fmt/format.h>

#include <array>
#include <iterator>
#include <optional>

#include "cli/bench/benchmarks.h"
#include "cli/bench/floor.h"
#include "cli/bench/method.h"
#include "formats/procedural.h"

namespace strandbake {
namespace {

struct Row {
  const char* model;  // of make_preset()
  int method;
  int length_iterations;
  int local_iterations;
  std::optional<double> hd7970_ms = {};  // method 4 and the rod are not of the paper
  std::optional<double> w8000_ms = {};
};
constexpr std::size_t kMethods = samples::kRod;
constexpr std::array<Row, 3 * kMethods> kTable2 = {{{"model1", 1, 2, 3, 4.59, 5.32},
                                                    {"model1", 2, 2, 3, 1.22, 1.44},
                                                    {"model1", 3, 2, 3, 0.78, 0.94},
                                                    {"model1", 4, 2, 3},
                                                    {"model1", samples::kRod, 0, 1},
                                                    {"model2", 1, 2, 3, 5.32, 6.28},
                                                    {"model2", 2, 2, 3, 1.24, 1.46},
                                                    {"model2", 3, 2, 3, 0.80, 0.95},
                                                    {"model2", 4, 2, 3},
                                                    {"model2", samples::kRod, 0, 1},
                                                    {"model3", 1, 3, 4, 62.38, 73.84},
                                                    {"model3", 2, 3, 4, 3.21, 3.81},
                                                    {"model3", 3, 3, 4, 2.11, 2.51},
                                                    {"model3", 4, 3, 4},
                                                    {"model3", samples::kRod, 0, 1}}};

Workload workload_of(const Row& row, std::shared_ptr<const Groom> groom) {
  Workload workload;
  workload.groom = std::move(groom);
  workload.params.damping = 0.04;
  workload.params.drag = 0;
  workload.params.local = {0.9, row.local_iterations, 1, false};  // as the paper has it
  samples::set_method(workload.params, row.method);
  workload.params.rod.iterations = row.local_iterations;
  workload.params.global = {0.02, 0.5, 0};
  workload.params.lengths = LengthParams::iterated(row.length_iterations);
  workload.spheres = 3;  // as in Table 1
  return workload;
}

struct Contender {
  std::size_t method_index;
  std::string backend;
  std::unique_ptr<SolverRun> run;
  Timing timing = {};
};

void measure(std::vector<Contender>& contenders, const Effort& effort) {
  std::vector<Turn> turns;
  for (Contender& contender : contenders) turns.push_back(contender.run->turn(0.02));
  const std::vector<Timing> timings = take_turns(turns, effort);
  for (std::size_t k = 0; k < contenders.size(); ++k) contenders[k].timing = timings[k];
}

}  // namespace

Report bench_table2(const BenchOptions& options) {
  Report report;
  report.benchmark = "table2";
  report.what =
      "the paper's Table 2: one step a frame, global shape on half of each strand, 3 spheres, float; "
      "methods take turns";
  report.table.columns = {{"model", "model"},
                          {"strands", "strands"},
                          {"vertices", "vertices"},
                          {"method", "method"},
                          {"length_iterations", "length it."},
                          {"local_iterations", "local it."},
                          {"backend", "backend"},
                          {"hd7970_ms", "HD 7970 [ms]"},
                          {"w8000_ms", "W8000 [ms]"},
                          {"median_ms", "median [ms]"},
                          {"best_ms", "best [ms]"},
                          {"hd7970_over_median", "HD 7970/median"},
                          {"ns_per_vertex", "ns/vertex"},
                          {"floor_ms", "floor [ms]"},
                          {"floor_share_percent", "floor [%]"}};
  report.probes = {measure_probes(options.threads, options.quick)};
  const Probes& probes = report.probes.front();
  std::vector<Device> devices;
  for (const int number : options.devices) devices.push_back(find_device(number));
  const Effort effort = options.quick ? Effort{7, 2} : Effort{51, 25};

  Panel panel;
  panel.title = "Time of a frame";
  panel.x = {"milliseconds a frame (log)", true};
  panel.series = {{"AMD HD 7970 (paper)", {}}, {"this processor, median", {}}, {"floor of this processor", {}}};
  for (std::size_t first = 0; first < kTable2.size(); first += kMethods) {
    const auto groom = std::make_shared<const Groom>(thinned(*make_preset(kTable2.at(first).model), options.share));
    const auto vertices = static_cast<double>(groom->vertex_count());
    std::vector<Workload> workloads;
    for (std::size_t k = first; k < first + kMethods; ++k) workloads.push_back(workload_of(kTable2.at(k), groom));
    // The processor takes turns with nothing but itself: a device that runs on the same cores would be in its way.
    std::vector<Contender> contenders;
    for (std::size_t k = 0; k < kMethods; ++k) {
      contenders.push_back(
          {k, "openmp",
           std::make_unique<SolverRun>(workloads[k], SolverOptions{Precision::Float, options.threads, 0, {}})});
    }
    measure(contenders, effort);
    for (const Device& device : devices) {
      std::vector<Contender> on_device;
      for (std::size_t k = 0; k < kMethods; ++k) {
        for (const Mapping mapping : {Mapping::Strands, Mapping::Vertices}) {
          const int method = kTable2.at(first + k).method;
          if (mapping == Mapping::Strands ? method == 4 : method == 1 || method == samples::kRod) continue;
          OpenCLOptions opencl;
          opencl.threads = options.threads;
          opencl.mapping = mapping;
          opencl.program_cache = options.program_cache;
          on_device.push_back({k, device.name + (mapping == Mapping::Strands ? ", strands" : ", vertices"),
                               std::make_unique<SolverRun>(workloads[k], device, opencl)});
        }
      }
      measure(on_device, effort);
      std::move(on_device.begin(), on_device.end(), std::back_inserter(contenders));
    }
    for (const Contender& contender : contenders) {
      const Row& row = kTable2.at(first + contender.method_index);
      const bool on_cpu = contender.backend == "openmp";
      const double floor =
          floor_seconds(work_of(workloads[contender.method_index]), vertices, 1, Precision::Float, probes);
      const double median = contender.timing.median;
      const auto cell = [](std::optional<double> value) { return value ? Cell(*value) : Cell(); };
      report.table.add({{"model", row.model},
                        {"strands", static_cast<double>(groom->strand_count())},
                        {"vertices", vertices},
                        {"method", method_cell(row.method)},
                        {"length_iterations", static_cast<double>(row.length_iterations)},
                        {"local_iterations", static_cast<double>(row.local_iterations)},
                        {"backend", contender.backend},
                        {"hd7970_ms", cell(row.hd7970_ms)},
                        {"w8000_ms", cell(row.w8000_ms)},
                        {"median_ms", 1e3 * median},
                        {"best_ms", 1e3 * contender.timing.best},
                        {"hd7970_over_median", row.hd7970_ms ? Cell(*row.hd7970_ms / (1e3 * median)) : Cell()},
                        {"ns_per_vertex", 1e9 * median / vertices},
                        {"floor_ms", on_cpu ? Cell(1e3 * floor) : Cell()},
                        {"floor_share_percent", on_cpu ? Cell(100 * floor / median) : Cell()}});
      if (!on_cpu) continue;
      const auto index = static_cast<double>(panel.names.size());
      panel.names.push_back(fmt::format("{}, {}", row.model, name_of(row.method)));
      if (row.hd7970_ms) panel.series[0].points.emplace_back(index, *row.hd7970_ms);
      panel.series[1].points.emplace_back(index, 1e3 * median);
      panel.series[2].points.emplace_back(index, 1e3 * floor);
    }
  }
  report.figure = {
      "Table 2 of the paper", fmt::format("{} threads, one step a frame, float", options.threads), {panel}};
  report.notes = {
      "HD 7970, W8000: milliseconds of the paper's graphics cards, as printed there; method 4 and the rod are not of "
      "the paper.",
      "floor: the larger of bytes over bandwidth and operations over the peak of the arithmetic."};
  for (const Device& device : devices) {
    report.notes.push_back(fmt::format("{}: {}, driver {}; time of its kernels by its own clock.", device.name,
                                       device.version, device.driver));
  }
  return report;
}

}  // namespace strandbake
