// How the time of a frame grows with strands, vertices, threads, substeps, lanes and regions.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "cli/bench/benchmarks.h"
#include "cli/bench/floor.h"
#include "cli/bench/method.h"
#include "formats/procedural.h"

namespace strandbake {
namespace {

// A point of a sweep.
struct Point {
  double value;  // of what is swept
  Workload workload;
  SolverOptions solver;
  const Device* device = nullptr;  // none: the CPU
};

Workload workload_of(std::shared_ptr<const Groom> groom, int method, int substeps = 1) {
  Workload workload;
  workload.groom = std::move(groom);
  workload.params.damping = 0.04;
  workload.params.drag = 0;
  workload.params.local = {0.9, 4, 1};
  samples::set_method(workload.params, method);
  workload.params.global = {0.02, 0.5, 0};
  workload.params.lengths = LengthParams::iterated(3);
  workload.spheres = 3;
  workload.substeps = substeps;
  return workload;
}

class Scaling {
 public:
  explicit Scaling(const BenchOptions& options) : options_(options) {
    report.benchmark = "scaling";
    report.what =
        "growth with strands, vertices, threads, substeps, lanes and regions: 4 iterations of local shape, 3 of edge "
        "lengths, "
        "3 spheres, float";
    report.table.columns = {{"sweep", "sweep"},
                            {"method", "method"},
                            {"strands", "strands"},
                            {"vertices", "vertices/strand"},
                            {"regions", "regions"},
                            {"threads", "threads"},
                            {"substeps", "substeps"},
                            {"lanes", "lanes"},
                            {"median_ms", "median [ms]"},
                            {"best_ms", "best [ms]"},
                            {"ns_per_vertex", "ns/vertex"},
                            {"ratio", "ratio"},
                            {"floor_share_percent", "floor [%]"}};
  }

  // Points of one method take turns; `ratio` gets all times of them [s].
  using Ratio = double (*)(const std::vector<Point>& points, const std::vector<Timing>& timings, std::size_t k);
  Series run(const std::string& sweep, int method, const std::vector<Point>& points, Ratio ratio, const Effort& effort,
             bool plot_ratio) {
    std::vector<std::unique_ptr<SolverRun>> runs;
    std::vector<Turn> turns;
    for (const Point& point : points) {
      if (point.device != nullptr) {
        OpenCLOptions opencl;
        opencl.threads = point.solver.threads;
        opencl.program_cache = options_.program_cache;
        runs.push_back(std::make_unique<SolverRun>(point.workload, *point.device, opencl));
      } else {
        runs.push_back(std::make_unique<SolverRun>(point.workload, point.solver));
      }
      turns.push_back(runs.back()->turn(options_.quick ? 0.003 : 0.01));
    }
    const std::vector<Timing> timings = take_turns(turns, effort);
    Series series{name_of(method), {}};
    for (std::size_t k = 0; k < points.size(); ++k) {
      const Groom& groom = *points[k].workload.groom;
      const int substeps = points[k].workload.substeps;
      const auto vertices = static_cast<double>(groom.vertex_count());
      const double ns = 1e9 * timings[k].median / (vertices * substeps);
      const double floor = floor_seconds(work_of(points[k].workload), vertices, substeps, Precision::Float,
                                         probes(points[k].solver.threads));
      const double value = ratio(points, timings, k);
      report.table.add(
          {{"sweep", sweep},
           {"method", method_cell(method)},
           {"strands", static_cast<double>(groom.strand_count())},
           {"vertices", vertices / static_cast<double>(groom.strand_count())},
           {"regions", static_cast<double>(points[k].workload.regions)},
           {"threads", static_cast<double>(points[k].solver.threads)},
           {"substeps", static_cast<double>(substeps)},
           {"lanes", static_cast<double>(points[k].solver.lanes)},
           {"median_ms", 1e3 * timings[k].median},
           {"best_ms", 1e3 * timings[k].best},
           {"ns_per_vertex", ns},
           {"ratio", value},
           {"floor_share_percent", points[k].device == nullptr ? Cell(100 * floor / timings[k].median) : Cell()}});
      series.points.emplace_back(points[k].value, plot_ratio ? value : ns);
    }
    return series;
  }

  void panel(const std::string& title, const Axis& x, const Axis& y, std::vector<Series> series) {
    report.figure.panels.push_back({title, x, y, {}, std::move(series)});
  }

  Report report;

 private:
  const Probes& probes(int threads) {
    for (const Probes& p : report.probes) {
      if (p.threads == threads) return p;
    }
    report.probes.push_back(measure_probes(threads, options_.quick));
    return report.probes.back();
  }

  BenchOptions options_;
};

// Time per vertex over the least of the sweep.
double over_least(const std::vector<Point>& points, const std::vector<Timing>& timings, std::size_t k) {
  const auto per_vertex = [&](std::size_t i) {
    return timings[i].median / static_cast<double>(points[i].workload.groom->vertex_count());
  };
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < points.size(); ++i) least = std::min(least, per_vertex(i));
  return per_vertex(k) / least;
}

// How many times as fast as the first.
double speed_up(const std::vector<Point>&, const std::vector<Timing>& timings, std::size_t k) {
  return timings.front().median / timings[k].median;
}

// Over the time of as many frames of one substep.
double over_single(const std::vector<Point>& points, const std::vector<Timing>& timings, std::size_t k) {
  return timings[k].median / (points[k].workload.substeps * timings.front().median);
}

std::shared_ptr<const Groom> wavy(double strands, int vertices) {
  ProceduralParams hair = style_defaults("wavy");
  hair.strands = std::max(1, static_cast<int>(std::lround(strands)));
  hair.vertices = vertices;
  return std::make_shared<const Groom>(make_groom(hair));
}

}  // namespace

Report bench_scaling(const BenchOptions& options) {
  Scaling scaling(options);
  const bool quick = options.quick;
  const int widest = available_lanes().back();
  const SolverOptions all{Precision::Float, options.threads, widest};
  const Effort effort = quick ? Effort{3, 1} : Effort{31, 12};
  const Axis ns{"ns a vertex and substep"};

  std::vector<Series> lines;
  std::vector<Point> points;
  const std::vector<int> strand_counts =
      quick ? std::vector{1000, 20000} : std::vector{1000, 2000, 5000, 10000, 20000, 50000, 100000, 200000};
  std::vector<std::shared_ptr<const Groom>> grooms;
  for (const int strands : strand_counts) grooms.push_back(wavy(options.share * strands, 16));
  for (const int method : {1, 3}) {
    points.clear();
    for (std::size_t k = 0; k < grooms.size(); ++k) {
      points.push_back({static_cast<double>(strand_counts[k]), workload_of(grooms[k], method), all});
    }
    lines.push_back(scaling.run("strands", method, points, over_least, effort, false));
  }
  scaling.panel("Strands (16 vertices each)", {"strands (log)", true}, ns, lines);

  // The same number of vertices in all, cut into fewer and longer strands.
  const double total = options.share * (quick ? 100e3 : 640e3);
  const std::vector<int> lengths = quick ? std::vector{8, 128} : std::vector{8, 16, 32, 64, 128, 256, 512};
  grooms.clear();
  for (const int vertices : lengths) grooms.push_back(wavy(total / vertices, vertices));
  lines.clear();
  for (const int method : {1, 3, 4, samples::kRod}) {
    points.clear();
    for (std::size_t k = 0; k < grooms.size(); ++k) {
      points.push_back({static_cast<double>(lengths[k]), workload_of(grooms[k], method), all});
    }
    lines.push_back(scaling.run("vertices", method, points, over_least, effort, false));
  }
  scaling.panel(fmt::format("Vertices of a strand ({:.0f},000 in all)", total / 1000),
                {"vertices of a strand (log)", true}, ns, lines);
  grooms.clear();

  const auto large = quick ? wavy(options.share * 4000, 69)
                           : std::make_shared<const Groom>(thinned(*make_preset("model3"), options.share));
  const std::string large_name = quick ? "4,000 strands of 69" : "model 3";
  lines.clear();
  std::vector<int> thread_counts;
  for (int threads = 1; threads < options.threads; threads *= 2) thread_counts.push_back(threads);
  thread_counts.push_back(options.threads);
  for (const int method : {1, 3}) {
    points.clear();
    for (const int threads : thread_counts) {
      points.push_back(
          {static_cast<double>(threads), workload_of(large, method), SolverOptions{Precision::Float, threads, widest}});
    }
    lines.push_back(scaling.run("threads", method, points, speed_up, effort, true));
  }
  scaling.panel(fmt::format("Threads ({})", large_name), {"threads"}, {"times as fast as one thread"}, lines);

  lines.clear();
  for (const int method : {1, 2, 3, 4, samples::kRod}) {
    points.clear();
    for (const int substeps : quick ? std::vector{1, 8} : std::vector{1, 2, 4, 8, 16}) {
      points.push_back({static_cast<double>(substeps), workload_of(large, method, substeps), all});
    }
    lines.push_back(scaling.run("substeps", method, points, over_single, effort, true));
  }
  scaling.panel(fmt::format("Substeps ({})", large_name), {"substeps of a frame (log)", true},
                {"time over that of as many frames"}, lines);

  const auto model1 = std::make_shared<const Groom>(thinned(*make_preset("model1"), options.share));
  lines.clear();
  for (const int method : {1, 2, 3, 4, samples::kRod}) {
    points.clear();
    for (const int lanes : available_lanes()) {
      points.push_back({static_cast<double>(lanes), workload_of(model1, method),
                        SolverOptions{Precision::Float, options.threads, lanes}});
    }
    lines.push_back(scaling.run("lanes", method, points, speed_up, effort, true));
  }
  scaling.panel("Lanes (model 1)", {"floats in a vector"}, {"times as fast as the narrowest"}, lines);

  // The paper's claim: the number of regions does not matter.
  std::vector<std::shared_ptr<const Groom>> dealt_out;
  const std::vector<int> region_counts = quick ? std::vector{1, 64} : std::vector{1, 4, 16, 64};
  for (const int regions : region_counts) {
    Groom groom = *model1;
    groom.region.resize(groom.strand_count());
    for (std::size_t s = 0; s < groom.region.size(); ++s) {
      groom.region[s] = static_cast<std::uint32_t>(s % static_cast<std::size_t>(regions));
    }
    dealt_out.push_back(std::make_shared<const Groom>(std::move(groom)));
  }
  const auto with_regions = [&](int method, const Device* device) {
    points.clear();
    for (std::size_t k = 0; k < dealt_out.size(); ++k) {
      Point point{static_cast<double>(region_counts[k]), workload_of(dealt_out[k], method), all, device};
      point.workload.regions = region_counts[k];
      points.push_back(point);
    }
    return scaling.run(device == nullptr ? "regions" : "regions on " + device->name, method, points, over_least, effort,
                       true);
  };
  lines.clear();
  for (const int method : {1, 3}) lines.push_back(with_regions(method, nullptr));
  scaling.panel("Regions (model 1)", {"regions (log)", true}, {"time over the least"}, lines);
  for (const int number : options.devices) {
    const Device device = find_device(number);
    for (const int method : {1, 3}) with_regions(method, &device);
  }

  scaling.report.figure.title = "Growth";
  scaling.report.figure.note = fmt::format("{} threads where they are not what grows; float", options.threads);
  scaling.report.notes = {"ns/vertex: of a substep, all threads together.",
                          "ratio: strands, vertices, regions: time per vertex over the least of the sweep; threads, "
                          "lanes: times as fast as the "
                          "first; substeps: time over that of as many frames of one substep."};
  return scaling.report;
}

}  // namespace strandbake
