#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cmath>
#include <csignal>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string_view>
#include <system_error>

#include "cli/backend.h"
#include "cli/checks.h"
#include "cli/console.h"
#include "cli/plan_text.h"
#include "cli/schemas.h"
#include "cli/verbs.h"
#include "cli/version.h"
#include "formats/bake_state.h"
#include "formats/cache.h"
#include "formats/shot.h"
#include "sim/large_array.h"
#include "sim/lost_numbers.h"
#include "sim/measure.h"
#include "sim/solver.h"

namespace strandbake {
namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

struct BakeOptions {
  SceneOptions scene;
  BackendOptions backend;
  std::filesystem::path output;
  std::string frames;
  int threads = 0;
  int lanes = 0;
  std::vector<std::string> no_skip;
  std::vector<std::string> fail_on;
  bool force = false;
  bool resume = false;
  double checkpoint = 30;  // [s]
  bool quiet = false;
  bool json = false;
  bool dry_run = false;
};

// For the cache, or to judge the bake by.
bool wants_stats(const Scene& scene, const BakeOptions& options) {
  return scene.cache.stats || !options.fail_on.empty();
}

// Set by SIGINT and SIGTERM, read between frames. A second signal ends the program at once.
volatile std::sig_atomic_t stop_requested = 0;
void request_stop(int signal) {
  stop_requested = 1;
  std::signal(signal, SIG_DFL);
}

// What happens, told to a person or, with --json, to a script: one object a line on stdout.
class Events {
 public:
  explicit Events(bool json) : json_(json) {}
  void emit(const nlohmann::ordered_json& event) const {
    if (!json_) return;
    print_json_line("bake", event);
  }
  void warning(const std::string& message) const {
    if (json_) {
      emit({{"event", "warning"}, {"message", message}});
    } else {
      print_warning(message);
    }
  }
  int failed(int code, const std::string& message) const {
    emit({{"event", "error"}, {"code", code}, {"message", message}});
    print_error(message);
    return code;
  }

 private:
  bool json_;
};

struct NamedSkip {
  const char* name;
  bool Skip::*what;
};
constexpr std::array kSkips = {NamedSkip{"passes", &Skip::passes}, NamedSkip{"range", &Skip::range},
                               NamedSkip{"colliders", &Skip::colliders}, NamedSkip{"resting", &Skip::resting},
                               NamedSkip{"regions", &Skip::regions}};

Skip skip_all_but(const std::vector<std::string>& names) {
  Skip skip;
  for (const NamedSkip& each : kSkips) {
    if (std::find(names.begin(), names.end(), each.name) != names.end()) skip.*each.what = false;
  }
  return skip;
}

// What was skipped, for a person; empty where there was nothing to skip.
std::string describe_skipped(const WorkCount& work) {
  std::string text;
  const auto add = [&](long long skipped, long long all, const char* what) {
    if (skipped == 0) return;
    const double percent = 100 * static_cast<double>(skipped) / static_cast<double>(all);
    text += fmt::format("{}{:.3g} % of {}", text.empty() ? "" : ", ", percent, what);
  };
  add(work.substeps_at_rest, work.substeps, "the simulation: strands at rest");
  add(work.spheres_out_of_reach, work.spheres, "the collisions: spheres out of reach");
  return text.empty() ? text : "skipped " + text;
}

// What ran on a device, for a person.
std::string describe_device_work(const OpenCLSolver& solver) {
  const OpenCLReport report = solver.report();
  std::string text = fmt::format("its kernels took {}; blocks of {} strand{}", human_seconds(solver.kernel_seconds()),
                                 report.strands_in_a_block, report.strands_in_a_block == 1 ? "" : "s");
  const auto add = [&](std::size_t blocks, const std::string& how) {
    if (blocks > 0) text += fmt::format(", {} with {}", blocks, how);
  };
  add(report.strand_blocks, "a strand per work-item");
  add(report.vertex_blocks, fmt::format("a vertex per work-item in {} of local memory",
                                        human_bytes(static_cast<double>(report.local_bytes))));
  add(report.long_blocks, "a vertex per work-item, too long for local memory");
  if (report.streamed) text += fmt::format("; {} batches took turns in its memory", report.batches);
  return text;
}

nlohmann::ordered_json device_work_json(const OpenCLSolver& solver) {
  const OpenCLReport report = solver.report();
  return {{"kernel_seconds", solver.kernel_seconds()},
          {"strands_in_a_block", report.strands_in_a_block},
          {"strand_blocks", report.strand_blocks},
          {"vertex_blocks", report.vertex_blocks},
          {"long_blocks", report.long_blocks},
          {"local_bytes", report.local_bytes},
          {"group_items", report.group_items},
          {"batches", report.batches},
          {"streamed", report.streamed},
          {"program_from_cache", report.program_from_cache}};
}

// A figure of a frame that a bake can fail on.
struct NamedFigure {
  const char* name;
  const char* in_words;
  const char* unit;
  float FrameStats::*what;
  const char* what_helps;
};
constexpr std::array kFigures = {
    NamedFigure{"stretch", "largest stretch", "", &FrameStats::largest_stretch,
                "more substeps may help, and lengths = \"direct\" where they are iterated"},
    NamedFigure{"residual", "largest residual", "", &FrameStats::residual,
                "more substeps may help where the pinned vertices are not too far apart for the hair between them"},
    NamedFigure{"penetration", "deepest penetration", " m", &FrameStats::deepest_penetration,
                "more substeps or smaller colliders may help"}};

struct Limit {
  const NamedFigure* figure;
  double most;
};

// "stretch=0.01". Throws std::invalid_argument with a sentence that says what would do.
Limit parse_limit(std::string_view text) {
  constexpr const char* would_do =
      "write stretch=0.01 or residual=0.01 (shares of the length), or penetration=0.001 (metres)";
  const auto refuse = [&](const std::string& why) {
    throw std::invalid_argument(fmt::format("{}: {}", why, would_do));
  };
  const std::size_t equals = text.find('=');
  if (equals == std::string_view::npos) refuse(fmt::format("\"{}\" has no \"=\"", text));
  const std::string_view name = text.substr(0, equals), number = text.substr(equals + 1);
  const auto figure =
      std::find_if(kFigures.begin(), kFigures.end(), [&](const auto& each) { return name == each.name; });
  if (figure == kFigures.end()) refuse(fmt::format("\"{}\" is no figure of a frame", name));
  double most = 0;
  const auto [end, error] = std::from_chars(number.data(), number.data() + number.size(), most);
  if (error != std::errc{} || end != number.data() + number.size() || !std::isfinite(most) || most < 0)
    refuse(fmt::format("the limit of {} is \"{}\", but must be a number from 0", name, number));
  return {&*figure, most};
}

CacheHeader make_header(const Shot& shot) {
  CacheHeader header;
  header.fps = shot.scene.bake.fps;
  header.offset = shot.groom.offset;
  header.region = shot.groom.region;
  for (const RegionScene& region : shot.scene.regions) header.region_names.push_back(region.name);
  header.root_uv = shot.groom.root_uv;
  header.rest_position.reserve(shot.groom.vertex_count());
  for (const Eigen::Vector3d& p : shot.groom.position) header.rest_position.push_back(p.cast<float>());
  header.colliders = shot.scene.colliders.size();
  header.program_version = STRANDBAKE_VERSION;
  header.scene_text = shot.scene.text;
  if (!header.scene_text.empty() && header.scene_text.back() != '\n') header.scene_text += '\n';
  for (const std::string& override : shot.scene.overrides) header.scene_text += fmt::format("# --set {}\n", override);
  header.inputs = shot.inputs;
  header.parameters = list_parameters(shot.scene);
  return header;
}

// Everything of one bake. A frame is measured, encoded and written by the solver's own threads while they simulate the
// next one.
class Bake {
 public:
  // Called when a frame is in the file.
  using OnFrame = std::function<void(int frame, const FrameStats& stats)>;

  Bake(Shot shot, const BakeOptions& options, Backend& backend, const Events& events, std::pair<int, int> written,
       OnFrame on_frame)
      : shot_(std::move(shot)),
        events_(events),
        written_(written),
        threads_(options.threads),
        velocity_(shot_.scene.cache.velocity),
        stats_(wants_stats(shot_.scene, options)),
        skip_passes_(skip_all_but(options.no_skip).passes),
        vertex_count_(shot_.groom.vertex_count()),
        on_frame_(std::move(on_frame)),
        checkpoint_seconds_(options.checkpoint) {
    for (const std::string& text : options.fail_on) limits_.push_back(parse_limit(text));
    // First the writer, as what it needs of the groom is gone before the solver is made: grooms are large.
    CacheOptions cache;
    cache.deflate = shot_.scene.deflate_level;
    cache.precision = shot_.scene.cache.precision;
    cache.velocity = velocity_;
    cache.stats = shot_.scene.cache.stats;
    cache.threads = threads_;
    CacheHeader header = make_header(shot_);
    state_.emplace(options.output, state_identity(header, fmt::format("{} {}", fmt::join(options.no_skip, ","),
                                                                      numbers_of(backend, precision_of(shot_.scene)))));
    writer_.emplace(options.output, header, cache,
                    options.resume ? CacheWriter::Existing::Resume : CacheWriter::Existing::Replace);
    header = {};
    next_frame_ = written_.first + static_cast<int>(writer_->frame_count());
    if (writer_->frame_count() > 0) check_kept(options.output.string() + ".part");

    SolverOptions solver;
    solver.precision = precision_of(shot_.scene);
    solver.threads = threads_;
    solver.lanes = options.lanes;
    solver.skip = skip_all_but(options.no_skip);
    shot_.plan.measured = stats_;
    solver_ = make_solver(backend, shot_.groom, shot_.plan, shot_.head(shot_.scene.first_frame), solver,
                          [&](const std::string& warning) { events.warning(warning); });
    made_by_ = describe_backend(backend, solver);
    shot_.groom = {};  // the solver has its own copy
    start_frame_ = first_simulated();
    if (!options.resume) {
      state_->remove();
    } else if (next_frame_ > written_.second) {
      start_frame_ = next_frame_;  // all is there
    } else if (const auto frame = state_->find(); frame && *frame >= start_frame_ && *frame < next_frame_) {
      solver_->load([this](std::span<std::byte> out) { state_->read(out); });
      state_->require_end();
      start_frame_ = *frame;
      is_loaded_ = true;
    }
    for (Positions& positions : positions_) {
      if (&positions != &positions_[kBefore] || velocity_) positions = Positions(vertex_count_);
    }
  }

  const Scene& scene() const { return shot_.scene; }
  std::size_t vertex_count() const { return vertex_count_; }
  WorkCount work_count() const { return solver_->work(); }
  // nullptr: the CPU's.
  const OpenCLSolver* device_solver() const { return dynamic_cast<const OpenCLSolver*>(solver_.get()); }
  // The solver in words.
  const std::string& made_by() const { return made_by_; }
  int first_simulated() const { return scene().first_frame - scene().bake.preroll; }
  // Frame of the first call of advance_to(): the first that is simulated, or that of the state which was found.
  int start_frame() const { return start_frame_; }
  bool starts_from_state() const { return is_loaded_; }
  // The first that is not in the file yet.
  int next_frame() const { return next_frame_; }

  // The first frame that went beyond a limit; it is in the file.
  struct Excess {
    int frame;
    Limit limit;
    float value;
  };
  const std::optional<Excess>& excess() const { return excess_; }

  // Simulates `frame`, which follows the one of the last call, and meanwhile writes that one. Frames that nobody asked
  // for are not read.
  void advance_to(int frame) {
    const bool checked = kept_ && frame == next_frame_ - 1;
    const bool needed = checked || frame >= next_frame_ - (velocity_ ? 1 : 0);
    const bool saves = checkpoint_seconds_ > 0 && seconds_since(last_saved_) >= checkpoint_seconds_;
    Figures figures;
    Figures* const wanted = stats_ && frame >= next_frame_ ? &figures : nullptr;
    const auto next = needed ? positions(kNext) : std::span<Eigen::Vector3f>();
    if (frame > start_frame_) {
      const FrameInput input = next_input_ ? std::move(*next_input_) : shot_.input(frame);
      substeps_ = static_cast<int>(input.substeps());
      next_input_.reset();
      if (frame < written_.second && !saves && !stop_requested) {
        next_input_ = shot_.input(frame + 1);
        solver_->expect(*next_input_);
      }
      solver_->advance(input, next, wanted,
                       pending_ ? [this](bool hair_is_left) { writer_->work(!hair_is_left); } : Solver::Alongside());
    } else if (needed) {
      solver_->read(next);
      if (wanted != nullptr) figures = solver_->measure_at_start(shot_.spheres(frame));
    }
    end_pending();
    simulated_ = frame;
    if (const auto bad = solver_->find_non_finite()) throw trace(frame, *bad);
    if (saves) save_state();
    if (!needed) return;
    if (velocity_) std::swap(positions_[kBefore], positions_[kNow]);
    std::swap(positions_[kNow], positions_[kNext]);
    if (checked) check_last_kept();
    if (frame >= next_frame_) begin(frame, figures);
  }

  // Whether the state is that of the last frame: a device may have begun with the next one.
  bool may_stop() const { return device_solver() == nullptr || !next_input_; }

  // Writes the frame of the last advance_to().
  void write_last() {
    if (!pending_) return;
#pragma omp parallel num_threads(threads_)
    writer_->work(true);
    end_pending();
  }

  void finish() {
    writer_->finish();
    state_->remove();
  }
  // Ends early; the frames that were written stay. `resumable`: with the state after the last of them; may_stop() then.
  void close(bool resumable) {
    if (resumable && checkpoint_seconds_ > 0 && simulated_) save_state();
    writer_->close();
  }

  struct NonFiniteError {
    int frame;
    NonFinite where;
    std::optional<std::size_t> substep;  // from 1
    int substeps;

    std::string message() const {
      const std::string when = substep ? fmt::format("substep {} of {}", *substep, substeps)
                                       : fmt::format("in one of its {} substeps", substeps);
      return fmt::format(
          "frame {}, {}: strand {}, vertex {} is no longer a finite number; more substeps or less stiffness may help",
          frame, when, where.strand, where.vertex);
    }
  };

 private:
  using Positions = LargeArray<Eigen::Vector3f>;
  // The places of positions: of the frame that is simulated, of the one that is written, and of the one before it, from
  // which velocities are made.
  enum { kNext, kNow, kBefore };
  std::span<Eigen::Vector3f> positions(int place) const {
    return {positions_[place].data(), vertex_count_};
  }

  // Whether the frames of a .part are the first of those that are asked for, and within the limits.
  void check_kept(const std::string& part) {
    kept_.emplace(part);
    const std::size_t count = kept_->frame_count();
    const int first = kept_->frame_number(0), last = kept_->frame_number(count - 1);
    if (first != written_.first || last > written_.second) {
      throw InputError(
          fmt::format("{}: cannot be resumed: it holds frames {} to {}, but {} to {} are asked for; "
                      "without --resume, --force starts anew",
                      part, first, last, written_.first, written_.second));
    }
    if (!limits_.empty() && !kept_->stats(0)) {
      throw InputError(fmt::format(
          "{}: cannot be resumed: it has no figures for --fail-on to judge (cache.stats); --force starts anew", part));
    }
    for (std::size_t k = 0; k < count; ++k)
      if (const auto stats = kept_->stats(k)) note_excess(kept_->frame_number(k), *stats);
  }

  // The same bake makes the same numbers, so they tell whether this is the same bake: a device that does not divide
  // exactly, for one, is not.
  void check_last_kept() {
    const std::size_t last = kept_->frame_count() - 1;
    const std::size_t block = kept_->block_vertices();
    std::vector<Eigen::Vector3f> there(block);
    for (std::size_t first = 0; first < vertex_count_; first += block) {
      const std::span<Eigen::Vector3f> stored(there.data(), std::min(block, vertex_count_ - first));
      kept_->read_position(last, first, stored);
      const auto now = std::span<const Eigen::Vector3f>(positions(kNow)).subspan(first, stored.size());
      const bool is_same = std::equal(stored.begin(), stored.end(), now.begin(), [&](const auto& a, const auto& b) {
        const auto rounded = [&](float x) { return round_to_precision(x, scene().cache.precision); };
        return a == b.unaryExpr(rounded);
      });
      if (!is_same) {
        throw InputError(
            fmt::format("frame {} of the .part is not what is baked here; take the program and the backend "
                        "that made it, or start anew with --force, without --resume",
                        kept_->frame_number(last)));
      }
    }
    kept_.reset();
  }

  // The state after the frame that was simulated last. It counts as soon as that frame is in the file.
  void save_state() {
    try {
      state_->write(*simulated_, [this](const Solver::Sink& out) { solver_->save(out); });
      saved_ = *simulated_;
    } catch (const DiskError& error) {
      // The bake goes on without it, and fails by itself where the disk is full.
      checkpoint_seconds_ = 0;
      events_.warning(fmt::format("{}; a bake that is resumed will simulate from the start", error.what()));
    }
    last_saved_ = Clock::now();
    commit_state();
  }
  void commit_state() {
    if (!saved_ || *saved_ >= next_frame_) return;
    state_->commit();
    saved_.reset();
  }

  void note_excess(int frame, const FrameStats& stats) {
    for (const Limit& limit : limits_) {
      const float value = stats.*limit.figure->what;
      if (!excess_ && value > limit.most) excess_ = {frame, limit, value};
    }
  }

  void begin(int frame, const Figures& figures) {
    pending_.emplace();
    pending_->number = frame;
    pending_->time = frame / scene().bake.fps;
    pending_->position = positions(kNow);
    pending_->head = shot_.head(frame);
    pending_colliders_ = shot_.spheres(frame);
    pending_->colliders = pending_colliders_;
    pending_->stats = {figures.largest_stretch, figures.residual, figures.deepest_penetration, substeps_};
    if (velocity_) {
      if (frame == first_simulated()) {
        pending_->velocity = [](std::size_t, std::span<Eigen::Vector3f> out) {
          std::fill(out.begin(), out.end(), Eigen::Vector3f(0, 0, 0));
        };
      } else {
        pending_->velocity = [fps = static_cast<float>(scene().bake.fps), now = positions(kNow),
                              before = positions(kBefore)](std::size_t first, std::span<Eigen::Vector3f> out) {
          for (std::size_t v = 0; v < out.size(); ++v) out[v] = (now[first + v] - before[first + v]) * fps;
        };
      }
    }
    writer_->begin(*pending_);
  }

  // Which substep of `frame` it was, and which vertex then. The groom, long gone, is read again for that.
  NonFiniteError trace(int frame, const NonFinite& bad) {
    NonFiniteError error = {frame, bad, std::nullopt, substeps_};
    if (substeps_ == 1) {
      error.substep = 1;
      return error;
    }
    solver_.reset();
    Faults faults;
    Warnings warnings;
    const Shot again = load_shot(shot_.scene, faults, warnings, skip_passes_);
    if (!faults.empty() || again.inputs != shot_.inputs) return error;
    const Replay replay = {first_simulated(), frame, [&](int f) { return again.input(f); },
                           again.head(scene().first_frame), precision_of(scene())};
    if (const auto found = find_lost_numbers(again.groom, bad, again.plan, replay)) {
      error.where.vertex = found->vertex;
      error.substep = found->substep;
    }
    return error;
  }

  void end_pending() {
    if (!pending_) return;
    writer_->end();
    next_frame_ = pending_->number + 1;
    commit_state();
    on_frame_(pending_->number, pending_->stats);
    note_excess(pending_->number, pending_->stats);
    pending_.reset();
  }

  Shot shot_;
  const Events& events_;
  std::pair<int, int> written_;
  int threads_;
  bool velocity_;
  bool stats_;  // are measured
  bool skip_passes_;
  std::size_t vertex_count_;
  OnFrame on_frame_;
  std::vector<Limit> limits_;
  std::optional<Excess> excess_;
  std::optional<CacheWriter> writer_;
  std::optional<CacheReader> kept_;  // the frames that were there before, until the last of them is checked
  int next_frame_ = 0;
  int start_frame_ = 0;
  bool is_loaded_ = false;
  std::optional<BakeStateFile> state_;
  double checkpoint_seconds_;
  Clock::time_point last_saved_ = Clock::now();
  std::optional<int> simulated_;  // the last frame that was
  std::optional<int> saved_;      // frame of a state that does not count yet
  std::string made_by_;
  std::optional<FrameInput> next_input_;
  int substeps_ = 0;  // of the last advance_to()
  std::array<Positions, 3> positions_;
  std::optional<CacheFrame> pending_;  // simulated, not yet in the file
  std::vector<Sphere> pending_colliders_;
  std::unique_ptr<Solver> solver_;  // last: a device may still write positions when a bake fails
};

int run_bake(BakeOptions options) {
  const Events events(options.json);
  const auto start = Clock::now();
  if (const std::string misuse = options.backend.misuse(); !misuse.empty()) return events.failed(kUsage, misuse);
  Faults faults;
  Warnings warnings;
  Scene scene = read_scene(options.scene.scene, options.scene.overrides, options.scene.search, faults);
  Shot shot = load_shot(std::move(scene), faults, warnings, skip_all_but(options.no_skip).passes);
  for (const std::string& warning : warnings) events.warning(warning);
  if (!faults.empty()) {
    for (const Fault& fault : faults)
      events.emit({{"event", "fault"}, {"place", fault.place}, {"message", fault.what}});
    events.emit({{"event", "error"}, {"code", static_cast<int>(kInput)}, {"message", count_faults(faults)}});
    print_faults(faults);
    return kInput;
  }
  std::pair<int, int> written = {shot.scene.first_frame, shot.scene.last_frame};
  if (!options.frames.empty()) {
    const std::pair<int, int> asked = parse_frames(options.frames);
    if (asked.first < written.first || asked.second > written.second) {
      return events.failed(kUsage, fmt::format("--frames {}: the scene has frames {}-{}", options.frames, written.first,
                                               written.second));
    }
    written = asked;
  }
  if (options.threads == 0) options.threads = default_threads(shot.groom.vertex_count());
  if (options.output.empty()) options.output = options.scene.scene.stem().string() + ".h5";

  Backend backend = choose_backend(options.backend, precision_of(shot.scene), vertex_substeps(shot, written.second));
  if (options.dry_run) {
    fmt::print("{}", describe_plan(shot, written, backend, options.threads));
    return kGood;
  }
  try {
    require_free(options.output, options.force);
  } catch (const DiskError& error) {
    return events.failed(kDisk, error.what());
  }
  const std::string part = options.output.string() + ".part";
  if (!options.force && !options.resume && std::filesystem::exists(part)) {
    return events.failed(
        kDisk, fmt::format("{}: an unfinished bake lies there; --resume goes on with it, --force replaces it", part));
  }

  std::signal(SIGINT, request_stop);
  std::signal(SIGTERM, request_stop);
  Progress* progress = nullptr;
  int first = 0;
  const auto show_progress = [&](int frame, const std::string& note) {
    progress->update(static_cast<std::size_t>(frame - first + 1), note);
  };
  const bool stats = wants_stats(shot.scene, options);
  const Shot::Substeps substeps = shot.count_substeps(written.second);
  Bake bake(std::move(shot), options, backend, events, written, [&](int frame, const FrameStats& found) {
    nlohmann::ordered_json event = {{"event", "frame"}, {"frame", frame}, {"substeps", found.substeps}};
    if (stats) {
      event["largest_stretch"] = found.largest_stretch;
      event["residual"] = found.residual;
      event["deepest_penetration"] = found.deepest_penetration;
    }
    events.emit(event);
    show_progress(frame, fmt::format("frame {}", frame));
  });
  first = bake.start_frame();
  const int kept = bake.next_frame() - written.first;
  events.emit({{"event", "start"},
               {"version", STRANDBAKE_VERSION},
               {"output", options.output.string()},
               {"first_frame", written.first},
               {"last_frame", written.second},
               {"simulated_from", first},
               {"kept_frames", kept},
               {"substeps", {{"least", substeps.least}, {"most", substeps.most}, {"total", substeps.total}}},
               {"vertices", bake.vertex_count()},
               {"solver", bake.made_by()},
               {"threads", options.threads}});
  if (kept > 0 && !options.quiet && !options.json) {
    fmt::print(stderr, "resuming after frame {}{}\n", bake.next_frame() - 1,
               first == bake.next_frame() ? ": no frame is left"
               : bake.starts_from_state()
                   ? fmt::format(", from the state after frame {}", first)
                   : fmt::format(": simulating from frame {} on again, as no state was kept", first));
  } else if (written.first > bake.scene().first_frame && !options.quiet && !options.json) {
    fmt::print(stderr, "simulating frames {} to {} first: frame {} grows out of them\n", bake.scene().first_frame,
               written.first - 1, written.first);
  }
  // What is left behind where a bake ends early.
  const auto left_behind = [&](int frame) {
    return frame > written.first ? fmt::format("{} holds the frames before it", part)
                                 : fmt::format("{} holds no frame yet", part);
  };
  std::optional<std::pair<int, std::string>> failure;
  {
    Progress shown(options.json ? Progress::Style::Silent : Progress::choose(options.quiet),
                   static_cast<std::size_t>(written.second - first + 1), "baking");
    progress = &shown;
    for (int frame = first; frame <= written.second && !bake.excess(); ++frame) {
      if (stop_requested && bake.may_stop()) {
        bake.write_last();
        failure = {kInterrupted, fmt::format("interrupted before frame {}; {}", frame, left_behind(frame))};
        if (bake.next_frame() > written.first) failure->second += ", --resume goes on";
        break;
      }
      try {
        bake.advance_to(frame);
      } catch (const Bake::NonFiniteError& error) {
        nlohmann::ordered_json event = {{"event", "non_finite"}, {"frame", frame}};
        event["substep"] = error.substep ? nlohmann::ordered_json(*error.substep) : nlohmann::ordered_json();
        event["strand"] = error.where.strand;
        event["vertex"] = error.where.vertex;
        events.emit(event);
        failure = {kNonFinite, fmt::format("{}; {}", error.message(), left_behind(frame))};
        break;
      } catch (const DeviceError& error) {
        bake.write_last();
        failure = {kDevice, fmt::format("frame {}: {}; {}", frame, error.what(), left_behind(frame))};
        break;
      }
      if (frame < written.first) show_progress(frame, "before the first frame");
    }
    if (!failure && !bake.excess()) bake.write_last();
    if (!failure && !bake.excess()) bake.finish();
  }
  if (const auto excess = bake.excess()) {
    const NamedFigure& figure = *excess->limit.figure;
    events.emit({{"event", "limit"},
                 {"frame", excess->frame},
                 {"figure", figure.name},
                 {"value", excess->value},
                 {"limit", excess->limit.most}});
    // What else has ended the bake counts for more.
    if (!failure)
      failure = {kInvalid, fmt::format("frame {}: the {} is {}{}, but --fail-on {}={} allows no more; {}; {} holds the "
                                       "frames up to it",
                                       excess->frame, figure.in_words, excess->value, figure.unit, figure.name,
                                       excess->limit.most, figure.what_helps, part)};
  }
  if (failure) {
    bake.close(failure->first == kInterrupted);
    return events.failed(failure->first, failure->second);
  }
  const double elapsed = seconds_since(start);
  const auto bytes = std::filesystem::file_size(options.output);
  const WorkCount work = bake.work_count();
  nlohmann::ordered_json done = {{"event", "done"},
                                 {"output", options.output.string()},
                                 {"bytes", bytes},
                                 {"seconds", elapsed},
                                 {"block_substeps", work.substeps},
                                 {"block_substeps_at_rest", work.substeps_at_rest},
                                 {"block_spheres", work.spheres},
                                 {"block_spheres_out_of_reach", work.spheres_out_of_reach}};
  if (const OpenCLSolver* solver = bake.device_solver()) done["device"] = device_work_json(*solver);
  events.emit(done);
  if (!options.quiet && !options.json) {
    const int frames = written.second - written.first + 1;
    fmt::print("{}: {} frame{}, {} vertices, {}, {}\n", options.output.string(), frames, frames == 1 ? "" : "s",
               bake.vertex_count(), human_bytes(static_cast<double>(bytes)), human_seconds(elapsed));
    if (const OpenCLSolver* solver = bake.device_solver()) {
      fmt::print("solved by {}: {}\n", bake.made_by(), describe_device_work(*solver));
    }
    if (const std::string skipped = describe_skipped(work); !skipped.empty()) fmt::print("{}\n", skipped);
  }
  return kGood;
}

}  // namespace

Verb add_bake(CLI::App& app) {
  auto options = std::make_shared<BakeOptions>();
  options->scene.add_to(app);
  options->backend.add_to(app);
  app.add_option("-o,--output", options->output, "The cache; left out: the scene's name with .h5, in this folder")
      ->type_name("FILE");
  app.add_option("--frames", options->frames,
                 "Write only these frames, e.g. 100-120; those before are simulated all the same")
      ->type_name("A-B")
      ->check(check_frames);
  app.add_option("--threads", options->threads,
                 "Threads; left out: all cores that the groom keeps busy. The cache does not depend on it")
      ->check(CLI::Range(1, 4096));
  app.add_option("--lanes", options->lanes,
                 "Floats in a vector: 4, 8 or 16; left out: the widest. The cache does not depend on it")
      ->check(CLI::IsMember(available_lanes()).description(""))  // help that is the same on every machine
      ->envname("STRANDBAKE_LANES");
  std::vector<std::string> skips;
  for (const NamedSkip& each : kSkips) skips.push_back(each.name);
  app.add_option(
         "--no-skip", options->no_skip,
         "Run what changes nothing all the same: passes, range, colliders, resting, regions. The cache does not "
         "depend on it, and this is to see so")
      ->type_name("NAME,...")
      ->delimiter(',')
      ->check(CLI::IsMember(skips));
  app.add_option("--fail-on", options->fail_on,
                 "Stop with exit code 1 where a frame that is written goes beyond this: stretch=0.01, a share of the "
                 "length, residual=0.01, the same between pinned vertices, or penetration=0.001, in metres. May be "
                 "given more than once")
      ->type_name("FIGURE=MOST")
      ->take_all()
      ->expected(1)
      ->check([](const std::string& text) -> std::string {
        try {
          parse_limit(text);
        } catch (const std::invalid_argument& error) {
          return error.what();
        }
        return {};
      });
  app.add_flag("--force", options->force, "Replace an existing cache");
  app.add_flag(
      "--resume", options->resume,
      "Go on with the .part that an interrupted bake of the same scene has left, to the same bytes; without one, "
      "start from the beginning");
  app.add_option("--checkpoint", options->checkpoint,
                 "Keep the state of the solver beside the .part so often, in seconds, for --resume; 0: never, and a "
                 "bake that is resumed simulates from the start")
      ->type_name("SECONDS")
      ->check(number_between(0, 1e9))
      ->capture_default_str();
  app.add_flag("--quiet", options->quiet, "No progress and no summary");
  auto* const json = app.add_flag("--json", options->json, "One JSON object a line on stdout for each event");
  app.add_flag("--dry-run", options->dry_run, "Say what would be run, with memory and disk, and stop")->excludes(json);
  return [options]() -> int {
    // A script hears of failures on stdout too.
    const Events events(options->json);
    try {
      return run_bake(*options);
    } catch (const InputError& error) {
      return events.failed(kInput, error.what());
    } catch (const DeviceError& error) {
      return events.failed(kDevice, error.what());
    } catch (const DiskError& error) {
      return events.failed(kDisk, error.what());
    } catch (const std::system_error& error) {  // as in main()
      return events.failed(kDisk, error.what());
    } catch (const std::bad_alloc&) {
      return events.failed(kInput, "not enough memory for this scene; `strandbake check` tells what it needs");
    } catch (const std::exception& error) {
      return events.failed(kInput, error.what());
    }
  };
}

}  // namespace strandbake
