// The solver: load a groom with its plan, advance one film frame, read positions.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "sim/frame_input.h"
#include "sim/groom.h"
#include "sim/measure.h"
#include "sim/work_count.h"

namespace strandbake {

// The first vertex found that is not a finite number, in the order of the groom.
struct NonFinite {
  std::size_t strand;
  std::size_t vertex;  // within the strand
  // Vertices of the longest strand in its block, where that one is masked (sim/block.h), else 0: what an infinity does
  // to its neighbours depends on it, unlike what a number does.
  std::size_t masked_to;
};

class Solver {
 public:
  virtual ~Solver() = default;

  // Work that the threads of advance() do beside it. Each thread calls it twice: with true before it takes part in the
  // simulation, so that it should rather return than wait for others, and with false when no hair is left to take.
  using Alongside = std::function<void(bool hair_is_left)>;

  // One film frame: input.substeps() substeps of Algorithm 1.
  // `out`: empty, or one entry per vertex, which gets what read() would give, while it still lies in cache.
  // `figures`: nullptr, or what gets those of the frame's end; the plan must have `measured`.
  // `alongside`: empty, or other work for the same threads. What it throws leaves advance() when the frame is done.
  // Throws std::invalid_argument where the input asks for something that the plan left out, or its parts differ in
  // length, or `out` has another size.
  virtual void advance(const FrameInput& input, std::span<Eigen::Vector3f> out, Figures* figures,
                       const Alongside& alongside) = 0;
  void advance(const FrameInput& input, std::span<Eigen::Vector3f> out, const Alongside& alongside) {
    advance(input, out, nullptr, alongside);
  }
  void advance(const FrameInput& input) { advance(input, {}, nullptr, {}); }

  // Figures of hair that has not moved yet, among these spheres. Throws as advance() does.
  virtual Figures measure_at_start(std::span<const Sphere> spheres) = 0;

  // Called before advance(): what the call after it will ask for. A device begins with it while the positions of this
  // frame travel; read() has to wait for that next advance() then.
  virtual void expect(const FrameInput&) {}

  // Positions now, world [m], in the order of the groom; `out` holds one entry per vertex.
  virtual void read(std::span<Eigen::Vector3f> out) const = 0;
  virtual void read(std::span<Eigen::Vector3d> out) const = 0;

  // Costs nothing where advance() met finite numbers only.
  virtual std::optional<NonFinite> find_non_finite() const = 0;

  // What the next frame grows out of, as bytes that depend neither on lanes, threads nor backend (solver_state.h). A
  // solver that was made of the same groom, plan, head and precision goes on from there to the same bits. Throws
  // std::logic_error where a device has begun with the next frame already: see expect(). What `out` or `in` throws
  // leaves load() with a state that is of no use.
  using Sink = std::function<void(std::span<const std::byte>)>;
  using Source = std::function<void(std::span<std::byte>)>;
  virtual void save(const Sink& out) const = 0;
  virtual void load(const Source& in) = 0;

  // Bytes that the solver holds between frames.
  virtual std::size_t state_bytes() const = 0;

  virtual WorkCount work() const = 0;
};

struct Plan;

enum class Precision { Float, Double };

// What is left out because it cannot change a bit of the result; false runs it all the same, to test just that.
struct Skip {
  bool passes = true;     // whose stiffness or wind is zero in this frame; the plan knows those of every frame
  bool range = true;      // the global shape beyond its range
  bool colliders = true;  // out of reach of a block of strands
  bool resting = true;    // strands that have come to a fixed point, as long as nothing about them changes
  bool regions = true;    // that are not simulated: their hair just rides on the head
};

struct SolverOptions {
  Precision precision = Precision::Float;
  int threads = 1;  // >= 1; has no influence on the result
  int lanes = 0;    // floats in a vector: one of available_lanes(), or 0 for the widest; has no influence on the result
  Skip skip = {};   // has no influence on the result
};

// Widths that this machine can run, narrowest first.
std::vector<int> available_lanes();

// The CPU solver. Hair starts at rest, at `head` times its rest position. The groom is copied into the solver's own
// layout and not kept. Throws std::invalid_argument where a strand has fewer than two vertices, a strand names a region
// that the plan does not have, or the lanes are not available.
std::unique_ptr<Solver> make_openmp_solver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                           const SolverOptions& options);

// What state_bytes() of that solver will be, without making it.
std::size_t openmp_state_bytes(const Groom& groom, const Plan& plan, const SolverOptions& options);

}  // namespace strandbake
