// A bake from end to end, as a process of its own, beside its solver alone and its disk alone.
#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <system_error>

#include "cli/bench/benchmarks.h"
#include "cli/bench/child.h"
#include "cli/bench/head_motion.h"
#include "cli/bench/scratch.h"
#include "cli/bench/timing.h"
#include "formats/error.h"
#include "formats/shot.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

struct Model {
  std::string name;
  const char* style;  // where only a share of it is baked
  double strands;
  int vertices;
  int local_iterations, length_iterations;
};

struct Packing {
  const char* name;
  const char* settings;
};
constexpr Packing kPackings[] = {{"none", "compression = \"none\"\n"},
                                 {"deflate:1, 1e-5 m", "compression = \"deflate:1\"\nprecision = 1e-5\n"}};

std::string scene_of(const Model& model, const Packing& packing, int frames) {
  std::string text = fmt::format(
      "[bake]\nframes = \"1-{}\"\nfps = 60\nsubsteps = 1\n\n[groom]\nfiles = [\"{}.hair\"]\n\n"
      "[head]\nanimation = \"head.bvh\"\nnode = \"Head\"\nunits = \"m\"\n\n"
      "[[region]]\nname = \"hair\"\ndamping = 0.04\nlocal = {{stiffness = 0.9, iterations = {}}}\n"
      "global = {{stiffness = 0.02, range = 0.5, fade = 0}}\nlengths = {{iterations = {}}}\n\n",
      frames, model.name, model.local_iterations, model.length_iterations);
  for (const char* center : {"0, 0, 0", "-0.15, -0.2, 0", "0.15, -0.2, 0"}) {
    text += fmt::format("[[collider]]\nsphere = {{center = [{}], radius = 0.098}}\nnode = \"Head\"\n\n", center);
  }
  return text + "[cache]\n" + packing.settings;
}

// What the disk alone takes: as many bytes, a frame at a time, synchronised as a cache is at its end.
double write_alone(const std::filesystem::path& path, std::uintmax_t bytes, const std::vector<char>& frame) {
  const auto check = [&](bool good) {
    if (!good) {
      throw DiskError(fmt::format("{}: cannot be written: {}", path.string(), std::generic_category().message(errno)));
    }
  };
  const auto start = Clock::now();
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  check(file >= 0);
  for (std::uintmax_t left = bytes; left > 0;) {
    const ssize_t count = ::write(file, frame.data(), std::min<std::uintmax_t>(left, frame.size()));
    if (count < 0 && errno == EINTR) continue;
    check(count > 0);
    left -= static_cast<std::uintmax_t>(count);
  }
  check(::fsync(file) == 0);
  check(::close(file) == 0);
  const double seconds = seconds_since(start);
  std::filesystem::remove(path);
  return seconds;
}

Shot load(const std::filesystem::path& scene) {
  Faults faults;
  Warnings warnings;
  Shot shot = load_shot(read_scene(scene, {}, {}, faults), faults, warnings);
  if (!faults.empty()) throw InputError(faults.front().place + ": " + faults.front().what);
  return shot;
}

// Solver::advance alone, over all frames of the scene.
double solve_alone(const Shot& shot, int threads, double& state_bytes) {
  SolverOptions options;
  options.threads = threads;
  const auto solver = make_openmp_solver(shot.groom, shot.plan, shot.head(shot.scene.first_frame), options);
  state_bytes = static_cast<double>(solver->state_bytes());
  double seconds = 0;
  for (int frame = shot.scene.first_frame + 1; frame <= shot.scene.last_frame; ++frame) {
    const FrameInput input = shot.input(frame);
    const auto start = Clock::now();
    solver->advance(input);
    seconds += seconds_since(start);
  }
  return seconds;
}

class BakeBench {
 public:
  explicit BakeBench(const BenchOptions& options)
      : options_(options), folder_(options.folder), frames_(options.quick ? 6 : 120) {
    write_text_file(folder_ / "head.bvh", swaying_head_bvh(frames_, 60));
    report_.benchmark = "bake";
    report_.what = fmt::format(
        "a bake as a process of its own: {} frames of one substep, method 1, {} threads; in turn with its solver alone "
        "and with `write` of as many bytes to the same folder",
        frames_, options.threads);
    report_.table.columns = {{"scene", "scene"},
                             {"compression", "compression"},
                             {"frames", "frames"},
                             {"vertices", "vertices"},
                             {"whole_s", "whole [s]"},
                             {"whole_best_s", "best [s]"},
                             {"solver_s", "solver [s]"},
                             {"write_s", "write [s]"},
                             {"ratio", "whole/max(solver, write)"},
                             {"busy_percent", "busy [%]"},
                             {"megabytes", "MB"},
                             {"bytes_over_floats", "bytes/floats"},
                             {"peak_mib", "peak [MiB]"},
                             {"peak_over_needed", "peak/(state + 2 frames)"},
                             {"before_frames_ms", "before frames [ms]"}};
    bars_.title = "Seconds of a bake";
    bars_.x = {"seconds"};
    bars_.series = {{"whole process", {}}, {"solver alone", {}}, {"write alone", {}}};
  }

  // Memory first, while this process is small: a child's peak starts from its parent's.
  void prepare(const Model& model) {
    if (options_.share < 1) {
      run_child({"groom", "--style", model.style, "--strands",
                 fmt::format("{:.0f}", std::max(1.0, options_.share * model.strands)), "--vertices",
                 fmt::format("{}", model.vertices), "-o", (folder_ / (model.name + ".hair")).string()});
    } else {
      run_child({"groom", "--preset", model.name, "-o", (folder_ / (model.name + ".hair")).string()});
    }
    for (std::size_t p = 0; p < std::size(kPackings); ++p) {
      write_text_file(scene_path(model, p), scene_of(model, kPackings[p], frames_));
      peaks_.push_back(bake(scene_path(model, p)).peak_bytes);
    }
  }

  // In the order of prepare().
  void measure(const Model& model) {
    const Shot shot = load(scene_path(model, 0));
    const auto vertices = static_cast<double>(shot.groom.vertex_count());
    const double frame_bytes = sizeof(Eigen::Vector3f) * vertices;
    std::vector<char> frame(static_cast<std::size_t>(frame_bytes));
    for (std::size_t k = 0; k < frame.size(); ++k) frame[k] = static_cast<char>(k * 2654435761u >> 13);

    constexpr std::size_t kCount = std::size(kPackings);
    double state_bytes = 0;
    std::uintmax_t bytes[kCount] = {};
    std::vector<double> busy[kCount], before[kCount];
    std::vector<Turn> turns;
    for (std::size_t p = 0; p < kCount; ++p) {
      turns.push_back([&, p](std::vector<double>& samples) {
        const ChildRun run = bake(scene_path(model, p));
        bytes[p] = std::filesystem::file_size(folder_ / "out.h5");
        busy[p].push_back((run.user + run.system) / (run.seconds * options_.threads));
        before[p].push_back(run.before_frames);
        samples.push_back(run.seconds);
      });
      turns.push_back(
          [&, p](std::vector<double>& samples) { samples.push_back(write_alone(folder_ / "plain", bytes[p], frame)); });
    }
    turns.push_back(
        [&](std::vector<double>& samples) { samples.push_back(solve_alone(shot, options_.threads, state_bytes)); });
    const auto timings = take_turns(turns, options_.quick ? Effort{1, 1, 1} : Effort{5, 40, 2});
    const Timing& solver = timings.back();
    for (std::size_t p = 0; p < kCount; ++p) {
      const Timing &whole = timings[2 * p], &write = timings[2 * p + 1];
      const double peak = peaks_.front();
      peaks_.erase(peaks_.begin());
      report_.table.add({{"scene", model.name},
                         {"compression", kPackings[p].name},
                         {"frames", static_cast<double>(frames_)},
                         {"vertices", vertices},
                         {"whole_s", whole.median},
                         {"whole_best_s", whole.best},
                         {"solver_s", solver.median},
                         {"write_s", write.median},
                         {"ratio", whole.median / std::max(solver.median, write.median)},
                         {"busy_percent", 100 * timing_of(busy[p]).median},
                         {"megabytes", 1e-6 * static_cast<double>(bytes[p])},
                         {"bytes_over_floats", static_cast<double>(bytes[p]) / (frames_ * frame_bytes)},
                         {"peak_mib", peak / (1 << 20)},
                         {"peak_over_needed", peak / (state_bytes + 2 * frame_bytes)},
                         {"before_frames_ms", 1e3 * timing_of(before[p]).median}});
      const auto index = static_cast<double>(bars_.names.size());
      bars_.names.push_back(fmt::format("{}, {}", model.name, kPackings[p].name));
      bars_.series[0].points.emplace_back(index, whole.median);
      bars_.series[1].points.emplace_back(index, solver.median);
      bars_.series[2].points.emplace_back(index, write.median);
    }
  }

  // So small that starting and ending is all there is.
  void measure_tiny() {
    constexpr int kFrames = 24;
    run_child({"groom", "--style", "wavy", "--strands", "100", "-o", (folder_ / "tiny.hair").string()});
    write_text_file(folder_ / "tiny.toml",
                    fmt::format("[bake]\nframes = \"1-{}\"\n[groom]\nfiles = [\"tiny.hair\"]\n", kFrames));
    std::vector<double> before;
    const Turn turn = [&](std::vector<double>& samples) {
      const ChildRun run = bake(folder_ / "tiny.toml");
      samples.push_back(run.seconds);
      before.push_back(run.before_frames);
    };
    const Timing whole = take_turns({turn}, options_.quick ? Effort{5, 2} : Effort{41, 10}).front();
    const Timing start = timing_of(before);
    report_.table.add({{"scene", "tiny"},
                       {"compression", "deflate:1"},
                       {"frames", static_cast<double>(kFrames)},
                       {"vertices", static_cast<double>(load(folder_ / "tiny.toml").groom.vertex_count())},
                       {"whole_s", whole.median},
                       {"whole_best_s", whole.best},
                       {"before_frames_ms", 1e3 * start.median}});
    tiny_.title = fmt::format("A tiny scene: 100 strands, {} frames, the head stands still", kFrames);
    tiny_.x = {"milliseconds"};
    tiny_.names = {"whole process", "before the first frame"};
    tiny_.series = {{"", {{0, 1e3 * whole.median}, {1, 1e3 * start.median}}}};
  }

  Report finish() {
    report_.figure = {"A bake from end to end", report_.what, {bars_, tiny_}};
    report_.notes = {
        "write: as many bytes as the cache has, a frame at a time, then synchronised.",
        "busy: processor time over cores times seconds. peak: largest resident memory, the libraries' included.",
        "bytes/floats: over positions as plain float32. before frames: from the start of the process to its first "
        "frame."};
    return report_;
  }

 private:
  std::filesystem::path scene_path(const Model& model, std::size_t packing) const {
    return folder_ / fmt::format("{}-{}.toml", model.name, packing);
  }
  ChildRun bake(const std::filesystem::path& scene) const {
    std::filesystem::remove(folder_ / "out.h5");  // to free the old file takes as long as to write a third of it
    return run_child({"bake", scene.string(), "-o", (folder_ / "out.h5").string(), "--json", "--threads",
                      fmt::format("{}", options_.threads)});
  }

  BenchOptions options_;
  Scratch folder_;
  int frames_;
  std::vector<double> peaks_;
  Report report_;
  Panel bars_, tiny_;
};

}  // namespace

Report bench_bake(const BenchOptions& options) {
  const Model models[] = {{"model1", "ponytail", 19776, 11, 3, 2}, {"model3", "curly", 20000, 69, 4, 3}};
  BakeBench bench(options);
  for (const Model& model : models) bench.prepare(model);
  bench.measure_tiny();
  for (const Model& model : models) bench.measure(model);
  return bench.finish();
}

}  // namespace strandbake
