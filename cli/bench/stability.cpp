// What the solver lives through: the stress table of the tests, with what each shot came to.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "cli/bench/benchmarks.h"
#include "cli/bench/method.h"
#include "samples/real_stability.h"
#include "samples/stability_measure.h"

namespace strandbake {
namespace {

using samples::Case;
using samples::Measured;

// About `share` of the strands, from the first on.
Groom thinned(const Groom& groom, double share) {
  Groom some;
  double wanted = 0;
  for (std::size_t s = 0; s < groom.strand_count(); ++s) {
    const bool taken = s == 0 || std::floor(wanted + share) > std::floor(wanted);
    wanted += share;
    if (!taken) continue;
    samples::add_strand(some, samples::points_of(groom, s));
    for (std::size_t i = 0; !groom.pinned.empty() && i < groom.vertex_count(s); ++i) {
      if (groom.pinned[groom.offset[s] + i]) samples::pin(some, some.strand_count() - 1, i);
    }
  }
  return some;
}

// What does not hold, in words.
std::string faults_of(const Measured& found, bool direct) {
  std::string faults;
  const auto add = [&](bool holds, const char* fault) {
    if (!holds) faults += (faults.empty() ? "" : ", ") + std::string(fault);
  };
  add(found.finite, "not finite");
  if (direct) {
    add(found.stretch <= 1, "stretches");
    add(found.reach <= 1, "out of reach");
    add(found.held <= samples::kHeld, "stretches between pins");
  }
  add(found.growth <= samples::kGrowth, "grows");
  add(found.unrest <= samples::kUnrest, "no rest");
  return faults;
}

}  // namespace

Report bench_stability(const BenchOptions& options) {
  std::vector<Case> cases = samples::cases();
  if (!options.assets.empty()) {
    for (Case& each : samples::real_cases(options.assets)) cases.push_back(std::move(each));
  }
  Report report;
  report.benchmark = "stability";
  report.what = fmt::format("{} shots that no hair is made for, with every method: what they come to", cases.size());
  report.table.columns = {{"case", "case"},
                          {"method", "method"},
                          {"lengths", "lengths"},
                          {"precision", "precision"},
                          {"finite", "finite"},
                          {"largest_stretch_percent", "stretch [%]"},
                          {"largest_held_percent", "between pins [%]"},
                          {"reach", "reach", 7},
                          {"growth", "growth"},
                          {"steps_to_rest", "steps to rest", 6},
                          {"unrest", "unrest"},
                          {"mark", ""}};
  Panel panel;
  panel.title = "Substeps from the end of all motion to rest";
  panel.x = {"substeps", true};
  for (int method = 1; method <= samples::kRod; ++method) panel.series.push_back({name_of(method), {}});
  for (std::size_t index = 0; index < cases.size(); ++index) {
    Case each = cases[index];
    if (options.share < 1) each.shot.groom = thinned(each.shot.groom, options.share);
    panel.names.push_back(each.name);
    for (const bool direct : {true, false}) {
      for (int method = 1; method <= samples::kRod; ++method) {
        for (const Precision precision : {Precision::Float, Precision::Double}) {
          if (method == samples::kRod && !direct) continue;  // its lengths are its own
          if (options.quick && (!direct || precision == Precision::Double)) continue;
          const Case run_of = samples::with_method(each, method, direct ? LengthParams{} : LengthParams::iterated(2));
          const Measured found = samples::measure(
              run_of, precision, samples::run(run_of.shot, {.precision = precision, .threads = options.threads}));
          const auto number = [&](bool there, double value) { return there ? Cell(value) : Cell(); };
          const bool stops = found.finite && each.stop != samples::kNever;
          const auto steps = static_cast<double>(found.steps_to_rest.value_or(0));
          report.table.add({{"case", each.name},
                            {"method", method_cell(method)},
                            {"lengths", std::string(method == samples::kRod ? "rod"
                                                    : direct                ? "direct"
                                                                            : "2 it.")},
                            {"precision", std::string(precision == Precision::Float ? "float" : "double")},
                            {"finite", std::string(found.finite ? "yes" : "no")},
                            {"largest_stretch_percent", number(found.finite, 100 * found.elongation)},
                            {"largest_held_percent", number(found.held > 0, 100 * found.held)},
                            {"reach", number(found.finite, found.reach)},
                            {"growth", number(stops, found.growth)},
                            {"steps_to_rest", number(stops && found.steps_to_rest, steps)},
                            {"unrest", number(stops, found.unrest)},
                            {"mark", faults_of(found, direct)}});
          if (direct && precision == Precision::Float && found.steps_to_rest) {
            panel.series[static_cast<std::size_t>(method - 1)].points.emplace_back(static_cast<double>(index), steps);
          }
        }
      }
    }
  }
  report.figure = {"What the solver lives through",
                   "direct lengths in float; no bar: at once, not in this shot, or the shot does not stop",
                   {panel}};
  report.notes = {
      "stretch: of the worst segment that is held from the root alone, in any frame; segments shorter than a "
      "thousandth "
      "of their strand are left out. between pins: of segments that pinned vertices hold at both ends.",
      "reach: the farthest that a vertex was from the last pinned one, as a share of its way along the strand. growth: "
      "the highest speed later than a second after all motion has stopped, as a share of the highest in that second.",
      fmt::format(
          "steps to rest: substeps from the stop until no vertex goes farther than {} of the longest strand in a "
          "frame any more; empty: not in this shot. unrest: the farthest in one of its last ten frames.",
          samples::kUnrest),
      "The last column says what does not hold; why, tests/stability/stability_test.cpp tells for each. Iterated "
      "lengths promise no stretch and no reach."};
  if (options.assets.empty()) {
    report.notes.push_back("Without real grooms: STRANDBAKE_ASSETS or --assets names their folder.");
  }
  return report;
}

}  // namespace strandbake
