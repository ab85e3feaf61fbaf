// The OpenCL solver against the CPU's, bit by bit, on every device of the machine that computes exactly.
#include "gpu/opencl_solver.h"

#include <catch2/catch.hpp>

#include "tests/gpu/rod_shot.h"
#include "tests/gpu/test_devices.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

bool is_exact(const Device& device, Precision precision) {
  return precision == Precision::Float ? device.exact_float : device.exact_double;
}

void check_same_as_cpu(const Shot& shot, OpenCLOptions options) {
  const std::vector<Points> expected = run(shot, SolverOptions{.precision = options.precision});
  for (const Device& device : devices()) {
    if (!is_exact(device, options.precision)) continue;
    CAPTURE(device.name, static_cast<int>(options.mapping), options.precision == Precision::Float);
    const auto solver = make_opencl_solver(shot.groom, plan_of(shot), shot.head(0), device, options);
    const std::vector<Points> taken = run(shot, *solver);
    REQUIRE(taken.size() == expected.size());
    for (std::size_t frame = 0; frame < taken.size(); ++frame) {
      CAPTURE(frame, largest_distance(taken[frame], expected[frame]));
      REQUIRE(same_bits(taken[frame], expected[frame]));
    }
  }
}

}  // namespace

TEST_CASE("a device gives the bytes of the CPU: awkward strands, four regions, everything on") {
  // Drivers build for a while, so not every pair.
  const auto [precision, mapping] =
      GENERATE(std::pair(Precision::Float, Mapping::Strands), std::pair(Precision::Float, Mapping::Vertices),
               std::pair(Precision::Double, Mapping::Vertices));
  Shot shot = busy_shot();
  shot.frames = 6;
  check_same_as_cpu(shot, {.precision = precision, .mapping = mapping});
}

TEST_CASE("a device gives the bytes of the CPU: rods of all kinds among other methods") {
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  check_same_as_cpu(rod_shot(), {.precision = precision});
}

TEST_CASE("a device gives the bytes of the CPU: each method alone") {
  const int method = GENERATE(1, 2, 3, 4);
  const Mapping mapping = GENERATE(Mapping::Strands, Mapping::Vertices);
  if ((method == 1 && mapping == Mapping::Vertices) || (method == 4 && mapping == Mapping::Strands)) return;
  Shot shot;
  shot.groom = mixed_groom(3, 60, 30);
  shot.region.local.method = method;
  shot.head = dance;
  shot.substeps_at = [](int frame) { return 1 + frame % 3; };
  shot.frames = 7;
  check_same_as_cpu(shot, {.mapping = mapping});
}
