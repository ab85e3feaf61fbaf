// The least hair that takes every path of the OpenCL program, for tools that watch a program run and take their time:
//   gpu_sample SOURCE strands|vertices [LOCAL_MEMORY [GROUP]]
// runs the program text of the file SOURCE on device 0 as if that had so many bytes of local memory and work-items in a
// group, prints what ran as JSON, with the root mean squares of the distances to the CPU's vertices after a frame, of
// rods and of all other hair [m], and returns 1 where bits are not the CPU's.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>

#include "gpu/opencl_solver.h"
#include "gpu/program.h"
#include "tests/sim/harness.h"

namespace strandbake {

// In place of the text that the library holds.
static char source_text[1 << 20];
const char* const kProgramSource = source_text;

namespace {

using namespace harness;

// The last local method that a scene may ask for.
struct LastMethod {
  int last = 0;
  void operator()(std::string_view name, int&, const Range& range, const char*, const char*) {
    if (name == "method") last = static_cast<int>(range.high);
  }
  template <class T, class Allowed>
  void operator()(std::string_view, T&, const Allowed&, const char*, const char*) {}
};
int last_method() {
  LastMethod visitor;
  LocalShapeParams params;
  fields(visitor, params);
  return visitor.last;
}

// Regions without local shape and with each method, with both ways to hold lengths and with and without a
// reaction, rods, and one that rides on the head.
Shot sample_shot() {
  const int methods = 1 + last_method();
  const int rods = 2 * methods;
  const int simulated = rods + 2;
  Shot shot;
  Random random(5);
  for (int r = 0; r <= simulated; ++r) {
    // Two of a length, two of different ones, and the longest with a pinned tip.
    for (const std::size_t vertices : {2u, 3u, 5u, 5u, 9u}) {
      if (r == simulated && vertices != 3) continue;
      add_strand(shot.groom, rambling(random, vertices, 0.1 * random.direction()));
      shot.groom.region.push_back(static_cast<std::uint32_t>(r));
    }
    if (r < simulated) pin(shot.groom, shot.groom.strand_count() - 1, 8);
  }
  shot.regions_at = [=](int) {
    std::vector<RegionParams> regions(static_cast<std::size_t>(simulated) + 1);
    for (int r = 0; r < simulated; ++r) {
      RegionParams& region = regions[static_cast<std::size_t>(r)];
      const int method = r % methods;
      region.local = method == 0 ? LocalShapeParams{0, 0, 1} : LocalShapeParams{0.4, 2, method};
      if (r >= methods) {
        region.lengths = LengthParams::iterated(1);
        region.local.reaction = false;
      }
      if (r >= rods) region.method = "rod";
      if (r > rods) region.rod = {.iterations = 2, .exact_lengths = false};
      region.sag_free = r % 2 == 0;
      region.global = {0.1, 0.5, 1};
    }
    regions.back().simulate = false;
    return regions;
  };
  shot.wind = {{4, 0, 1}, 0.5, 0.2};
  shot.head = dance;
  shot.spheres = [](double time) {
    return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.05, 0), 0.09}, {{0.1, 0, 0}, 0.05}};
  };
  shot.substeps_at = [](int frame) { return 3 - frame; };  // an odd number ends with positions in the other place
  shot.fps = 24;
  shot.frames = 2;
  return shot;
}

double rms_distance_between(const std::vector<Eigen::Vector3f>& a, const std::vector<Eigen::Vector3f>& b,
                            const Shot& shot, bool rods) {
  const std::vector<RegionParams> regions = regions_of(shot, 1);
  double sum = 0, count = 0;
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
    if (regions[shot.groom.region[s]].is_rod() != rods) continue;
    for (std::size_t v = shot.groom.offset[s]; v < shot.groom.offset[s + 1]; ++v, ++count) {
      sum += (a[v] - b[v]).cast<double>().squaredNorm();
    }
  }
  return std::sqrt(sum / count);
}

int sample(int argc, char** argv) {
  if (argc < 3) {
    std::fputs("usage: gpu_sample SOURCE strands|vertices [LOCAL_MEMORY [GROUP]]\n", stderr);
    return 2;
  }
  std::ifstream file(argv[1], std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  if (text.empty() || text.size() >= sizeof source_text) {
    std::fprintf(stderr, "gpu_sample: %s cannot be read\n", argv[1]);
    return 2;
  }
  std::memcpy(source_text, text.c_str(), text.size() + 1);
  const bool by_vertices = std::strcmp(argv[2], "vertices") == 0;
  Device device = find_device(0);
  if (argc > 3) device.local_memory = std::strtoull(argv[3], nullptr, 10);
  if (argc > 4) device.largest_group = std::strtoull(argv[4], nullptr, 10);

  const Shot shot = sample_shot();
  const auto solver = make_opencl_solver(shot.groom, plan_of(shot), shot.head(0), device,
                                         {.mapping = by_vertices ? Mapping::Vertices : Mapping::Strands});
  const auto on_cpu = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), SolverOptions{});
  std::vector<Eigen::Vector3f> taken(shot.groom.vertex_count()), expected(shot.groom.vertex_count());
  const auto alike = [&] { return std::memcmp(taken.data(), expected.data(), sizeof taken[0] * taken.size()) == 0; };
  solver->read(taken);
  on_cpu->read(expected);
  bool same = alike();
  double rms_distance = 0, rod_rms_distance = 0;
  for (int frame = 1; frame <= shot.frames; ++frame) {
    solver->advance(frame_input(shot, frame), taken, {});
    on_cpu->advance(frame_input(shot, frame), expected, {});
    same &= alike();
    if (frame > 1) continue;
    rms_distance = rms_distance_between(taken, expected, shot, false);
    rod_rms_distance = rms_distance_between(taken, expected, shot, true);
  }
  const OpenCLReport report = solver->report();
  std::printf(
      "{\"device\": \"%s\", \"rms_distance\": %g, \"rod_rms_distance\": %g, \"strands_in_a_block\": %d, \"group\": "
      "%zu, \"strand_blocks\": %zu, "
      "\"vertex_blocks\": %zu, \"long_blocks\": %zu}\n",
      device.name.c_str(), rms_distance, rod_rms_distance, report.strands_in_a_block, report.group_items,
      report.strand_blocks, report.vertex_blocks, report.long_blocks);
  return same ? 0 : 1;
}

}  // namespace
}  // namespace strandbake

int main(int argc, char** argv) {
  try {
    return strandbake::sample(argc, argv);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "gpu_sample: %s\n", e.what());
    return 3;
  }
}
