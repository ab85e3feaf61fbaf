// What a benchmark hands back, and how it is told.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "cli/bench/probe.h"
#include "cli/bench/svg.h"
#include "cli/bench/table.h"

namespace strandbake {

struct Report {
  std::string benchmark;
  std::string what;  // a sentence: what was run
  Table table;
  Figure figure;
  std::vector<std::string> notes;  // sentences: how to read the columns
  std::vector<Probes> probes;      // one a number of threads
};

// The table with the machine above and the notes below.
std::string report_text(const Report& report);
// The table, with machine and probes in lines that start with '#' before it.
std::string report_csv(const Report& report);
// {"benchmark", "what", "machine": {...}, "probes": [...], "rows": [{...}], "notes": [...]}
nlohmann::ordered_json report_json(const Report& report);

}  // namespace strandbake
