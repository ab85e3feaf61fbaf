#include "cli/bench/report.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "cli/bench/machine.h"

namespace strandbake {
namespace {

constexpr double kGiga = 1e9;

std::string probe_text(const Probes& probes) {
  const auto peak = [](const Arithmetic& a) {
    return fmt::format("{:.1f} multiply or add, {:.2f} divide, {:.2f} square root", a.multiply_add / kGiga,
                       a.divide / kGiga, a.root / kGiga);
  };
  std::string bandwidth;
  for (const auto& [size, rate] : probes.update) {
    bandwidth += fmt::format("{}{:.0f} at {:.4g} MiB", bandwidth.empty() ? "" : ", ", rate / kGiga, size / (1 << 20));
  }
  return fmt::format(
      "probe, {} thread{}, {} lanes: triad {:.1f} GB/s; read four, write one, GB/s: {}\n"
      "  float, 1e9 a second: {}\n  double, 1e9 a second: {}\n",
      probes.threads, probes.threads == 1 ? "" : "s", probes.lanes, probes.triad / kGiga, bandwidth,
      peak(probes.single_precision), peak(probes.double_precision));
}

std::string context_text(const Report& report) {
  std::string text = fmt::format("{}: {}\n", report.benchmark, report.what);
  for (const auto& [name, value] : describe_machine()) text += fmt::format("{}: {}\n", name, value);
  for (const Probes& probes : report.probes) text += probe_text(probes);
  return text;
}

}  // namespace

std::string report_text(const Report& report) {
  std::string text = context_text(report) + '\n' + text_of(report.table);
  if (!report.notes.empty()) text += '\n';
  for (const std::string& note : report.notes) text += note + '\n';
  return text;
}

std::string report_csv(const Report& report) {
  std::string text;
  std::string line;
  for (const char c : context_text(report)) {
    if (c != '\n') {
      line += c;
      continue;
    }
    text += "# " + line + '\n';
    line.clear();
  }
  return text + csv_of(report.table);
}

nlohmann::ordered_json report_json(const Report& report) {
  using Json = nlohmann::ordered_json;
  Json machine = Json::object();
  for (const auto& [name, value] : describe_machine()) machine[name] = value;
  Json probes = Json::array();
  const auto peak = [](const Arithmetic& a) {
    return Json{{"multiply_add_per_s", a.multiply_add}, {"divide_per_s", a.divide}, {"root_per_s", a.root}};
  };
  for (const Probes& p : report.probes) {
    Json bandwidth = Json::array();
    for (const auto& [size, rate] : p.update) bandwidth.push_back({{"bytes", size}, {"bytes_per_s", rate}});
    probes.push_back({{"threads", p.threads},
                      {"lanes", p.lanes},
                      {"triad_bytes_per_s", p.triad},
                      {"update", bandwidth},
                      {"float", peak(p.single_precision)},
                      {"double", peak(p.double_precision)}});
  }
  Json rows = Json::array();
  for (const auto& row : report.table.rows) {
    Json object = Json::object();
    for (std::size_t c = 0; c < row.size(); ++c) {
      const std::string& key = report.table.columns[c].key;
      object[key] = nullptr;
      if (const auto* words = std::get_if<std::string>(&row[c])) object[key] = *words;
      if (const auto* value = std::get_if<double>(&row[c])) object[key] = *value;
    }
    rows.push_back(object);
  }
  return Json{
      {"benchmark", report.benchmark}, {"what", report.what}, {"machine", machine}, {"probes", probes}, {"rows", rows},
      {"notes", report.notes}};
}

}  // namespace strandbake
