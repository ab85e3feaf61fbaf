// The stress table on OpenCL devices: the CPU's bytes, and what must hold of them.
#include <unistd.h>

#include <catch2/catch.hpp>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "gpu/opencl_solver.h"
#include "samples/stability_measure.h"
#include "tests/gpu/test_devices.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

// With all passes, so that few programs have to be built for many shots.
Plan full_plan(const Shot& shot) {
  Plan plan = plan_of(shot);
  for (RegionPlan& region : plan.regions) {
    region.wind = true;
    region.local_shape = region.edge_lengths = !region.rod;
    if (region.global_shape) continue;
    region.global_shape = true;
    region.global_range = 0.3;
  }
  return plan;
}

// Most shots run the same programs.
struct ProgramFolder {
  std::filesystem::path path = std::filesystem::temp_directory_path() / ("strandbake-" + std::to_string(::getpid()));

  ProgramFolder() { std::filesystem::create_directory(path); }
  ~ProgramFolder() { std::filesystem::remove_all(path); }
};

}  // namespace

TEST_CASE("a device makes the CPU's bytes of each shot of the stress table, with every method and mapping") {
  // Of all pairs of shot and kernel every third, as each builds programs; with STRANDBAKE_STABILITY_ALL all.
  const bool all = std::getenv("STRANDBAKE_STABILITY_ALL") != nullptr;
  const ProgramFolder programs;
  for (const Device& device : devices()) {
    int shots = 0;
    for (const Case& each : cases()) {
      int kernels = shots++;
      for (const int method : {1, 2, 3, 4, kRod}) {
        for (const Mapping mapping : {Mapping::Strands, Mapping::Vertices}) {
          if (mapping !=
              mapping_of({.rod = method == kRod, .local_shape = method != kRod, .local_method = method}, mapping, 1))
            continue;
          if (++kernels % 3 != 0 && !all) continue;
          Case run_of = with_method(each, method, LengthParams{});
          Shot& shot = run_of.shot;
          shot.frames = std::min(shot.frames, 6);
          if (shot.substeps_at) shot.substeps_at = [of = shot.substeps_at](int f) { return std::min(of(f), 40); };
          run_of.stop = kNever;
          const bool in_double = (kernels + shots) % 2 == 0 && device.exact_double;
          const Precision precision = in_double ? Precision::Double : Precision::Float;
          if (!in_double && !device.exact_float) continue;
          const Plan plan = full_plan(shot);
          const OpenCLOptions options = {.precision = precision, .mapping = mapping, .program_cache = programs.path};
          const std::vector<Points> found =
              run(shot, *make_opencl_solver(shot.groom, plan, shot.head(0), device, options));
          const std::vector<Points> expected =
              run(shot, *make_openmp_solver(shot.groom, plan, shot.head(0), {.precision = precision}));
          CAPTURE(device.name, each.name, method, mapping == Mapping::Vertices, in_double);
          CHECK(std::equal(found.begin(), found.end(), expected.begin(), same_bits));
          const Measured measured = measure(run_of, precision, found);
          CHECK(measured.finite);
          CHECK(measured.stretch <= 1);
          CHECK(measured.reach <= 1);
        }
      }
    }
  }
}
