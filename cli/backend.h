// Which solver a verb uses: the CPU's, or that of an OpenCL device.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "formats/shot.h"
#include "gpu/opencl_solver.h"
#include "sim/solver.h"

namespace CLI {
class App;
}

namespace strandbake {

struct BackendOptions {
  std::string backend = "auto";
  int device = -1;  // as `strandbake devices` numbers them; -1: the first
  std::string mapping = "auto";
  std::uint64_t device_memory = 0;  // [bytes]
  void add_to(CLI::App& app);
  // What makes no sense about them, a sentence; empty: nothing.
  std::string misuse() const;
};

struct Backend {
  std::optional<Device> device;  // none: the CPU
  bool is_automatic = false;     // nobody has asked for the device: where it fails to start, the CPU will do
  OpenCLOptions opencl;
};

Precision precision_of(const Scene& scene);
// How much there is to do up to a frame: vertices times substeps.
double vertex_substeps(const Shot& shot, int last_frame);

// Throws DeviceError where what is asked for cannot be had.
Backend choose_backend(const BackendOptions& options, Precision precision, double vertex_substeps);

// Whose numbers a bake has: "exact" for all that have the CPU's, else the device.
std::string numbers_of(const Backend& backend, Precision precision);

// "openmp, float, 2 threads"
std::string describe_backend(const Backend& backend, const SolverOptions& options);

// Turns `backend` to the CPU, and tells `warn` why, where a device that nobody asked for fails to start.
std::unique_ptr<Solver> make_solver(Backend& backend, const Groom& groom, const Plan& plan,
                                    const Eigen::Isometry3d& head, const SolverOptions& options,
                                    const std::function<void(const std::string&)>& warn);

// Where built OpenCL programs are kept for the next run: $XDG_CACHE_HOME/strandbake/opencl or
// ~/.cache/strandbake/opencl; empty where neither is known.
std::filesystem::path program_cache_folder();

}  // namespace strandbake
