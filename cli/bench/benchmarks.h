// The benchmarks, one file each. Each prepares what it runs, takes its times, and hands back a report.
#pragma once

#include <filesystem>
#include <vector>

#include "cli/bench/report.h"

namespace strandbake {

struct BenchOptions {
  bool quick = false;  // fewer rounds and smaller sweeps
  int threads = 1;
  double share = 1;              // of the strands of each groom that are used, above 0
  std::filesystem::path folder;  // for scenes and caches of bakes
  std::vector<int> devices;      // of OpenCL, beside the CPU; table2 and scaling
  std::filesystem::path program_cache;
  std::filesystem::path assets;  // real grooms and animation; empty: none; stability
};

Report bench_table2(const BenchOptions& options);
Report bench_passes(const BenchOptions& options);
Report bench_scaling(const BenchOptions& options);
Report bench_bake(const BenchOptions& options);
Report bench_features(const BenchOptions& options);
Report bench_error(const BenchOptions& options);
Report bench_stability(const BenchOptions& options);

}  // namespace strandbake
