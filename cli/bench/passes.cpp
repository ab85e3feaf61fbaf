// What each pass costs, alone and on top of all others.
#include <fmt/format.h>

#include <functional>

#include "cli/bench/benchmarks.h"
#include "cli/bench/floor.h"
#include "formats/procedural.h"
#include "samples/shots.h"

namespace strandbake {
namespace {

constexpr int kSubsteps = 8;    // blocks stay in cache, so that passes are seen and not the memory
constexpr int kIterations = 4;  // of a pass that is swept, for a steadier figure
constexpr int kMostSpheres = 8;

struct PassRow {
  std::string name;
  int iterations;  // that the differences below hold
  std::size_t alone, without_alone;
  std::size_t on_top, without_on_top;
  Work work;
};

RegionParams everything(int method) {
  RegionParams params;
  params.local = {0.9, kIterations, method};
  params.global = {0.02, 1, 0.5};
  params.lengths = LengthParams::iterated(kIterations);
  return params;
}

// Runs that are to be timed, and rows that are differences of them.
class Plans {
 public:
  explicit Plans(std::shared_ptr<const Groom> groom) : groom_(std::move(groom)) {
    Workload base = of(nothing_but_integration(), false, 0);
    integration = add(base);
    for (int method = 1; method <= 4; ++method) all_.push_back(add(of(everything(method), true, 3)));

    RegionParams params = nothing_but_integration();
    params.drag = 1;
    row("wind", 1, of(params, true, 0), 1, of(everything(1), false, 3), work::wind());
    params = nothing_but_integration();
    params.global = everything(1).global;
    RegionParams without = everything(1);
    without.global.stiffness = 0;
    row("global shape", 1, of(params, false, 0), 1, of(without, true, 3), work::global_shape());
    for (int method = 1; method <= 4; ++method) {
      params = nothing_but_integration();
      params.local = everything(method).local;
      without = everything(method);
      without.local.iterations = 0;
      const Work reacting = work::local_shape(method, kIterations, method != 3).repeated(1.0 / kIterations);
      row(fmt::format("local shape, method {}", method), kIterations, of(params, false, 0), method,
          of(without, true, 3), reacting);
      if (method == 3) continue;
      params.local.reaction = false;
      const Work plain = work::local_shape(method, kIterations, false).repeated(1.0 / kIterations);
      RegionParams with = everything(method);
      with.local.reaction = false;
      rows.push_back({fmt::format("local shape, method {}, no reaction", method), kIterations,
                      add(of(params, false, 0)), integration, add(of(with, true, 3)), add(of(without, true, 3)),
                      plain});
    }
    params = nothing_but_integration();
    params.lengths = LengthParams::iterated(kIterations);
    without = everything(1);
    without.lengths = LengthParams::iterated(0);
    row("edge lengths", kIterations, of(params, false, 0), 1, of(without, true, 3), work::edge_lengths());
    params.lengths = {};
    RegionParams direct = everything(1);
    direct.lengths = {};
    rows.push_back({"direct lengths", 1, add(of(params, false, 0)), integration, add(of(direct, true, 3)),
                    add(of(without, true, 3)), work::direct_lengths()});
    // The rod in the place of local shape and edge lengths.
    params = nothing_but_integration();
    RegionParams rod = everything(1);
    samples::set_method(params, samples::kRod);
    samples::set_method(rod, samples::kRod);
    RegionParams no_rod = everything(1);
    no_rod.local.iterations = 0;
    no_rod.lengths = LengthParams::iterated(0);
    rows.push_back({"rod", 1, add(of(params, false, 0)), integration, add(of(rod, true, 0)), add(of(no_rod, true, 0)),
                    work::rod(1)});
    const std::size_t no_spheres = add(of(everything(1), true, 0));
    for (int spheres = 1; spheres <= kMostSpheres; ++spheres) {
      rows.push_back({fmt::format("collisions, {} sphere{}", spheres, spheres == 1 ? "" : "s"), 1,
                      add(of(nothing_but_integration(), false, spheres)), integration,
                      add(of(everything(1), true, spheres)), no_spheres, work::sphere().repeated(spheres)});
    }
  }

  std::vector<Workload> workloads;
  std::vector<PassRow> rows;
  std::size_t integration = 0;

 private:
  Workload of(const RegionParams& params, bool wind, int spheres) const {
    Workload workload;
    workload.groom = groom_;
    workload.params = params;
    if (wind) {
      workload.wind.velocity = {2, 0, 1};
      workload.wind.gust = 0.5;
    }
    workload.spheres = spheres;
    workload.substeps = kSubsteps;
    return workload;
  }
  std::size_t add(const Workload& workload) {
    workloads.push_back(workload);
    return workloads.size() - 1;
  }
  void row(const std::string& name, int iterations, const Workload& alone, int method, const Workload& without,
           const Work& work) {
    rows.push_back(
        {name, iterations, add(alone), integration, all_[static_cast<std::size_t>(method - 1)], add(without), work});
  }

  std::shared_ptr<const Groom> groom_;
  std::vector<std::size_t> all_;  // [methods]
};

}  // namespace

Report bench_passes(const BenchOptions& options) {
  ProceduralParams hair = style_defaults("wavy");
  hair.strands = 4000;
  hair.vertices = 32;
  const auto groom = std::make_shared<const Groom>(thinned(make_groom(hair), options.share));
  const Plans plans(groom);
  const auto vertices = static_cast<double>(groom->vertex_count());

  Report report;
  report.benchmark = "passes";
  report.what = fmt::format("what each pass costs: {} strands of {} vertices, {} substeps a frame, {} threads",
                            groom->strand_count(), groom->vertex_count(0), kSubsteps, options.threads);
  report.table.columns = {{"precision", "precision"},          {"pass", "pass"},
                          {"alone_ns", "alone [ns]"},          {"alone_best_ns", "alone, best [ns]"},
                          {"on_top_ns", "on top [ns]"},        {"floor_ns", "floor [ns]"},
                          {"floor_share_percent", "floor [%]"}};
  report.probes = {measure_probes(options.threads, options.quick)};
  const Probes& probes = report.probes.front();

  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const std::string word = precision == Precision::Float ? "float" : "double";
    std::vector<std::unique_ptr<SolverRun>> runs;
    std::vector<Turn> turns;
    for (const Workload& workload : plans.workloads) {
      runs.push_back(std::make_unique<SolverRun>(workload, SolverOptions{precision, options.threads, 0}));
      turns.push_back(runs.back()->turn(options.quick ? 0.003 : 0.01));
    }
    const Solver& solver = runs.front()->solver();
    std::vector<Eigen::Vector3f> position(groom->vertex_count());
    const auto timed = [](const std::function<void()>& work) -> Turn {
      return [work](std::vector<double>& samples) {
        const auto start = Clock::now();
        work();
        samples.push_back(seconds_since(start));
      };
    };
    const std::size_t read_run = turns.size(), check_run = read_run + 1;
    turns.push_back(timed([&] { solver.read(std::span<Eigen::Vector3f>(position)); }));
    turns.push_back(timed([&] { static_cast<void>(solver.find_non_finite()); }));
    const std::vector<Timing> timings = take_turns(turns, options.quick ? Effort{3, 4} : Effort{31, 60});

    Panel panel;
    panel.title = word;
    panel.x = {"nanoseconds a vertex and substep, of an iteration where there are several"};
    panel.series = {{"alone", {}}, {"on top of all others", {}}, {"floor", {}}};
    const auto add = [&](const std::string& name, const Work& work, int substeps, double alone, double best,
                         std::optional<double> on_top) {
      const double unit = 1e9 / (vertices * substeps);
      const double floor = floor_seconds(work, vertices, substeps, precision, probes);
      report.table.add({{"precision", word},
                        {"pass", name},
                        {"alone_ns", unit * alone},
                        {"alone_best_ns", unit * best},
                        {"on_top_ns", on_top ? Cell(unit * *on_top) : Cell()},
                        {"floor_ns", unit * floor},
                        {"floor_share_percent", 100 * floor / alone}});
      const auto index = static_cast<double>(panel.names.size());
      panel.names.push_back(name);
      panel.series[0].points.emplace_back(index, unit * alone);
      if (on_top) panel.series[1].points.emplace_back(index, unit * *on_top);
      panel.series[2].points.emplace_back(index, unit * floor);
    };
    const Timing& base = timings[plans.integration];
    add("integration", work::integrate(), kSubsteps, base.median, base.best, {});
    for (const PassRow& row : plans.rows) {
      const auto difference = [&](std::size_t with, std::size_t without, double Timing::*figure) {
        return (timings[with].*figure - timings[without].*figure) / row.iterations;
      };
      add(row.name, row.work, kSubsteps, difference(row.alone, row.without_alone, &Timing::median),
          difference(row.alone, row.without_alone, &Timing::best),
          difference(row.on_top, row.without_on_top, &Timing::median));
    }
    add("read, a frame", work::read(), 1, timings[read_run].median, timings[read_run].best, {});
    add("check for non-finite, a frame", work::non_finite(), 1, timings[check_run].median, timings[check_run].best, {});
    report.figure.panels.push_back(panel);
  }
  report.figure.title = "What each pass costs";
  report.figure.note = report.what;
  report.notes = {
      "Nanoseconds a vertex and substep of all threads together; of one iteration for local shape and edge lengths.",
      "alone: with the integration, less the integration. on top: all passes, less all but this one.",
      "floor: of the pass alone; a sphere counts as a test for a vertex outside."};
  return report;
}

}  // namespace strandbake
