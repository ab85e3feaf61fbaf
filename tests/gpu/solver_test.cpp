// What the OpenCL solver does beside its kernels: batches, strands too long for local memory, looking ahead, telling
// what is not finite.
#include <catch2/catch.hpp>
#include <limits>
#include <stdexcept>

#include "gpu/opencl_solver.h"
#include "tests/gpu/rod_shot.h"
#include "tests/gpu/test_devices.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

bool is_exact(const Device& device, Precision precision) {
  return precision == Precision::Float ? device.exact_float : device.exact_double;
}

// The first one that computes exactly in both precisions.
const Device* exact_device() {
  for (const Device& device : devices()) {
    if (is_exact(device, Precision::Float) && is_exact(device, Precision::Double)) return &device;
  }
  return nullptr;
}

Plan measured_plan(const Shot& shot) {
  Plan plan = plan_of(shot);
  plan.measured = true;
  return plan;
}

std::unique_ptr<OpenCLSolver> solver_of(const Shot& shot, const Device& device, const OpenCLOptions& options = {}) {
  return make_opencl_solver(shot.groom, plan_of(shot), shot.head(0), device, options);
}

bool same_figures(const Figures& a, const Figures& b) {
  return a.largest_stretch == b.largest_stretch && a.residual == b.residual &&
         a.deepest_penetration == b.deepest_penetration;
}

void check_same_frames(const std::vector<Points>& taken, const std::vector<Points>& expected) {
  REQUIRE(taken.size() == expected.size());
  for (std::size_t frame = 0; frame < taken.size(); ++frame) {
    CAPTURE(frame, largest_distance(taken[frame], expected[frame]));
    REQUIRE(same_bits(taken[frame], expected[frame]));
  }
}

using Floats = std::vector<Eigen::Vector3f>;
bool same_bits(const Floats& a, const Floats& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof a[0]) == 0;
}

Shot short_busy_shot() {
  Shot shot = busy_shot();
  shot.frames = 5;
  return shot;
}

}  // namespace

// Every constraint has a reaction there, and three iterations walk side by side on the CPU.
TEST_CASE("hair with the default parameters gives the same bytes") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  Shot shot;
  shot.groom = mixed_groom(7, 20, 24);
  shot.region.local.method = GENERATE(1, 2, 4);
  shot.head = dance;
  shot.substeps = 2;
  shot.frames = 4;
  const Mapping mapping = GENERATE(Mapping::Strands, Mapping::Vertices);
  const auto solver = solver_of(shot, *device, {.mapping = mapping});
  check_same_frames(run(shot, *solver), run(shot, SolverOptions{}));
}

TEST_CASE("rods have a strand per work-item, whatever is asked for, and the same bytes") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const Mapping mapping = GENERATE(Mapping::Auto, Mapping::Vertices);
  Shot shot;
  shot.region = rod_region(GENERATE(true, false), GENERATE(1, 3));
  shot.head = dance;
  shot.frames = 4;
  SECTION("strands of one length, nothing on") {
    shot.region.drag = 0;
    shot.region.global.stiffness = 0;
    shot.groom = groom_of({straight(16, 0.2), curly(16, 0.2, 0.01, 5), straight(16, 0.05)});
  }
  SECTION("the shortest strands there are") {
    shot.groom = groom_of({straight(2, 0.1), straight(3, 0.1), straight(3, 0.01), straight(2, 0.05)});
    shot.spheres = [](double) { return std::vector<Sphere>{{{0.03, -0.08, 0}, 0.05}}; };
  }
  SECTION("strands of two vertices alone") {
    shot.groom = groom_of({straight(2, 0.1), straight(2, 0.05)});
  }
  SECTION("spheres that come and go, and pins") {
    shot.groom = mixed_groom(7, 20, 24);
    for (std::size_t s = 0; s < 20; s += 5) pin(shot.groom, s, shot.groom.vertex_count(s) - 1);
    shot.spheres = [](double time) {
      return std::vector<Sphere>{{{0.05 - 3 * time, -0.05, 0}, 0.04}, {{0, -0.1, 10 * time}, 0.08}};
    };
    shot.wind = {{3, 1, 0}, 0.5, 0.1};
    shot.substeps = 2;
  }
  CAPTURE(shot.region.rod.exact_lengths, shot.region.rod.iterations, static_cast<int>(mapping));
  CHECK(mapping_of(plan_of(shot).regions[0], mapping, 1) == Mapping::Strands);
  const auto solver = solver_of(shot, *device, {.mapping = mapping});
  CHECK(solver->report().strand_blocks > 0);
  CHECK(solver->report().vertex_blocks + solver->report().long_blocks == 0);
  const std::vector<Points> expected = run(shot, SolverOptions{});
  for (const Vector3d& v : expected.back()) REQUIRE(v.allFinite());
  check_same_frames(run(shot, *solver), expected);
}

TEST_CASE("rods go on from a state that the CPU has saved") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const Shot shot = rod_shot();
  const auto cpu = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), SolverOptions{});
  const auto solver = solver_of(shot, *device);
  for (int frame = 1; frame <= 3; ++frame) cpu->advance(frame_input(shot, frame));
  std::vector<std::byte> state;
  cpu->save([&](std::span<const std::byte> more) { state.insert(state.end(), more.begin(), more.end()); });
  std::size_t at = 0;
  solver->load([&](std::span<std::byte> to) {
    REQUIRE(at + to.size() <= state.size());
    std::copy_n(state.begin() + static_cast<std::ptrdiff_t>(at), to.size(), to.begin());
    at += to.size();
  });
  CHECK(at == state.size());
  Points taken(shot.groom.vertex_count()), expected(shot.groom.vertex_count());
  for (int frame = 4; frame <= shot.frames; ++frame) {
    cpu->advance(frame_input(shot, frame));
    solver->advance(frame_input(shot, frame));
    cpu->read(expected);
    solver->read(taken);
    CHECK(same_bits(taken, expected));
  }
}

TEST_CASE("what the device works out of a rod counts as its memory, and is no more than that") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const bool exact = GENERATE(true, false);
  Shot shot;
  shot.region = rod_region(exact, 1);
  for (int s = 0; s < 64; ++s) add_strand(shot.groom, straight(10, 0.1, {0.001 * s, 0, 0}));
  const std::size_t on_cpu = openmp_state_bytes(shot.groom, plan_of(shot), {});
  CHECK(solver_of(shot, *device)->state_bytes() == on_cpu + sizeof(float) * 64 * 8 * (exact ? 31 : 39));
}

TEST_CASE("hair beyond the device's memory takes turns there, with the same bytes") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const Shot shot = GENERATE(false, true) ? rod_shot() : short_busy_shot();
  const std::vector<Points> expected = run(shot, SolverOptions{.precision = precision});
  const std::uint64_t all = solver_of(shot, *device, {.precision = precision})->state_bytes();
  for (const std::uint64_t memory : {all, all - 1, all / 3, std::uint64_t{1}}) {
    CAPTURE(precision == Precision::Float, all, memory);
    const auto solver = solver_of(shot, *device, {.precision = precision, .memory = memory});
    const OpenCLReport report = solver->report();
    CHECK(report.streamed == (memory < all));
    CHECK(report.batches >= (memory == all ? 1 : memory == all - 1 ? 2 : 4));
    if (memory == 1) {
      CHECK(report.batches == static_cast<int>(report.strand_blocks + report.vertex_blocks + report.long_blocks));
    }
    check_same_frames(run(shot, *solver), expected);
  }
}

TEST_CASE("hair beyond the device's largest buffer lies in several of them, with the same bytes") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const Shot shot = short_busy_shot();
  Device smaller = *device;
  smaller.largest_buffer = solver_of(shot, *device)->state_bytes() / 2;
  const auto solver = solver_of(shot, smaller);
  CHECK_FALSE(solver->report().streamed);
  CHECK(solver->report().batches > 1);
  check_same_frames(run(shot, *solver), run(shot, SolverOptions{}));
  smaller.largest_buffer = 1000;
  CHECK_THROWS_WITH(solver_of(shot, smaller), "strands of 70 vertices are too long for the device's largest buffer");
}

TEST_CASE("strands too long for local memory give the same bytes") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  Shot shot = short_busy_shot();
  for (std::uint32_t s = 0; s < 64; ++s) {  // enough to fill blocks of their own
    add_strand(shot.groom, straight(4, 0.05, {0.001 * s, 0, 0}));
    shot.groom.region.push_back(s % 4);
  }
  Device smaller = *device;
  smaller.local_memory = precision == Precision::Float ? 4000 : 8000;
  const auto solver = solver_of(shot, smaller, {.precision = precision, .mapping = Mapping::Vertices});
  const OpenCLReport report = solver->report();
  CHECK(report.vertex_blocks > 0);
  CHECK(report.long_blocks > 0);
  CHECK(report.local_bytes <= smaller.local_memory);
  check_same_frames(run(shot, *solver), run(shot, SolverOptions{.precision = precision}));
}

TEST_CASE("looking ahead changes no byte, whether or not positions are asked for") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const bool streamed = GENERATE(false, true);
  // Where it does not share the CPU's memory, positions come through pinned memory.
  Device elsewhere = *device;
  elsewhere.shares_memory = GENERATE(false, true);
  Shot shot = GENERATE(false, true) ? rod_shot() : busy_shot();
  shot.frames = 12;
  const auto cpu = make_openmp_solver(shot.groom, measured_plan(shot), shot.head(0), SolverOptions{});
  const auto solver = make_opencl_solver(shot.groom, measured_plan(shot), shot.head(0), elsewhere,
                                         {.threads = 2, .memory = streamed ? 1u : 0u});
  CHECK(same_figures(solver->measure_at_start(shot.spheres(0)), cpu->measure_at_start(shot.spheres(0))));
  for (int frame = 1; frame <= shot.frames; ++frame) {
    CAPTURE(streamed, elsewhere.shares_memory, frame);
    // All pairs of having looked ahead, wanting positions, and looking ahead.
    const bool wanted = frame % 3 != 0, looks_ahead = frame % 4 != 3 && frame < shot.frames;
    Floats expected(shot.groom.vertex_count()), taken(shot.groom.vertex_count());
    Figures expected_figures, figures;
    const bool measured = frame % 5 != 0;
    cpu->advance(frame_input(shot, frame), expected, &expected_figures, {});
    if (looks_ahead) solver->expect(frame_input(shot, frame + 1));
    solver->advance(frame_input(shot, frame), wanted ? std::span(taken) : std::span<Eigen::Vector3f>(),
                    measured ? &figures : nullptr, {});
    if (measured) CHECK(same_figures(figures, expected_figures));
    CHECK(expected_figures.residual > 0);
    CHECK(expected_figures.deepest_penetration > 0);
    CHECK_FALSE(solver->find_non_finite());
    if (wanted) CHECK(same_bits(taken, expected));
    if (looks_ahead && !streamed) {
      CHECK_THROWS_AS(solver->read(std::span(taken)), std::logic_error);
    } else {
      solver->read(std::span(taken));
      CHECK(same_bits(taken, expected));
    }
  }
}

TEST_CASE("what an exception in the work alongside interrupts is not the simulation") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  Shot shot = short_busy_shot();
  const auto solver = solver_of(shot, *device, {.threads = 2});
  std::vector<Points> taken(1, Points(shot.groom.vertex_count()));
  solver->read(taken[0]);
  for (int frame = 1; frame <= shot.frames; ++frame) {
    CHECK_THROWS_AS(
        solver->advance(frame_input(shot, frame), {}, [](bool) { throw std::runtime_error("a full disk"); }),
        std::runtime_error);
    taken.emplace_back(shot.groom.vertex_count());
    solver->read(taken.back());
  }
  check_same_frames(taken, run(shot, SolverOptions{}));
}

TEST_CASE("a device finds the same vertex that is not finite as the CPU") {
  const Device* const device = exact_device();
  if (device == nullptr) return;
  const Mapping mapping = GENERATE(Mapping::Strands, Mapping::Vertices);
  const bool looks_ahead = GENERATE(false, true);
  Device elsewhere = *device;
  elsewhere.shares_memory = looks_ahead;
  Shot shot;
  // The solver sorts by length and region; the order of the groom is another.
  shot.groom = groom_of({straight(2, 0.1), straight(2, 0.1), straight(30, 0.1), straight(3, 0.1), straight(5, 0.1)});
  shot.groom.region = {0, 0, 0, 1, 1};
  shot.regions_at = [](int) {
    std::vector<RegionParams> regions(2);
    regions[0].local.method = regions[1].local.method = 3;
    regions[0].drag = 0;
    return regions;
  };
  shot.frames = 3;
  shot.wind.velocity = {1, 0, 0};
  Shot bad = shot;
  SECTION("infinite gravity") {
    bad.gravity = {0, -kInfinity, 0};
  }
  SECTION("a head that is nowhere") {
    bad.head = [](double) { return pose(Eigen::Matrix3d::Identity(), {0, 0, std::nan("")}); };
  }
  SECTION("a storm in one region") {
    bad.wind.velocity = {kInfinity, 0, 0};
  }

  const auto cpu = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), SolverOptions{});
  const auto solver = solver_of(shot, elsewhere, {.mapping = mapping});
  for (int frame = 1; frame <= shot.frames; ++frame) {
    const auto input_of = [&](int f) { return frame_input(f < 2 ? shot : bad, f); };
    CAPTURE(static_cast<int>(mapping), looks_ahead, frame);
    cpu->advance(input_of(frame));
    if (looks_ahead && frame < shot.frames) solver->expect(input_of(frame + 1));
    solver->advance(input_of(frame));
    const auto expected = cpu->find_non_finite(), found = solver->find_non_finite();
    REQUIRE(expected.has_value() == (frame > 1));
    REQUIRE(found.has_value() == expected.has_value());
    if (!found) continue;
    CHECK(found->strand == expected->strand);
    CHECK(found->vertex == expected->vertex);
    break;  // a bake ends here
  }
}
