// The solver on an OpenCL device: the same passes, the same blocks of strands, the same bytes as the CPU's where the
// device divides and draws roots exactly (Device::exact_float).
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "gpu/devices.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {

// How strands are spread over work-items. Method 1 and the rod need Strands and method 4 Vertices,
// whatever is asked for.
enum class Mapping {
  Auto,      // by method and number of strands
  Strands,   // a strand per work-item
  Vertices,  // a block of strands per work-group, a vertex per work-item; the paper's
};

// What a region runs with, of a groom of so many strands.
Mapping mapping_of(const RegionPlan& region, Mapping asked, std::size_t strands);

struct OpenCLOptions {
  Precision precision = Precision::Float;
  int threads = 1;  // for the work alongside
  Skip skip = {};
  Mapping mapping = Mapping::Auto;
  std::uint64_t memory = 0;                  // [bytes] of the device for hair, at most; 0: what it has
  std::filesystem::path program_cache = {};  // folder for built programs; empty: none
};

// What runs where. A bake's summary tells it.
struct OpenCLReport {
  int strands_in_a_block = 0;
  int batches = 0;
  bool streamed = false;  // batches take turns in the device's memory
  bool program_from_cache = false;
  std::size_t strand_blocks = 0;  // run with a strand per work-item
  std::size_t vertex_blocks = 0;  // with a vertex per work-item, in local memory
  std::size_t long_blocks = 0;    // with a vertex per work-item, too long for local memory
  std::uint64_t local_bytes = 0;  // of a group, at most
  std::size_t group_items = 0;    // work-items of a group in the mapping by vertices, at most
};

class OpenCLSolver : public Solver {
 public:
  virtual OpenCLReport report() const = 0;
  // Time that the device has spent in kernels that simulate, by its own clock, since the solver was made [s].
  virtual double kernel_seconds() const = 0;
};

// Hair starts at rest, at `head` times its rest position. Throws std::invalid_argument as the CPU's solver does, and
// DeviceError where the device fails or lacks what is asked for.
std::unique_ptr<OpenCLSolver> make_opencl_solver(const Groom& groom, const Plan& plan, const Eigen::Isometry3d& head,
                                                 const Device& device, const OpenCLOptions& options);

}  // namespace strandbake
