#include "cli/backend.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>

namespace strandbake {
namespace {

// A smaller bake takes a second on a CPU: less than a driver needs to build its program.
constexpr double kWorthADevice = 2e8;  // vertex substeps

}  // namespace

void BackendOptions::add_to(CLI::App& app) {
  app.add_option("--backend", backend,
                 "The solver. openmp: the CPU. opencl: a device (`strandbake devices`). auto: a GPU where there is one "
                 "that gives the "
                 "bytes of the CPU and the bake is long enough to gain from it, else the CPU")
      ->check(CLI::IsMember({"auto", "openmp", "opencl"}))
      ->envname("STRANDBAKE_BACKEND");
  app.add_option("--device", device, "Which device, with --backend opencl; left out: the first")
      ->type_name("N")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--mapping", mapping,
                 "What a work-item does, with opencl. strands: a strand per work-item (methods 1 to 3 and rods). "
                 "vertices: a vertex per work-item "
                 "(methods 2 to 4). auto: by method and number of strands. The cache does not depend on it")
      ->check(CLI::IsMember({"auto", "strands", "vertices"}));
  app.add_option("--device-memory", device_memory,
                 "Hair takes at most so much of the device's memory, e.g. 512MiB, with opencl, and goes through it in "
                 "batches if need be; left out: all of it")
      ->type_name("SIZE")
      ->transform(CLI::AsSizeValue(false));
}

std::string BackendOptions::misuse() const {
  if (backend == "opencl") return {};
  const char* const option = device >= 0          ? "--device"
                             : mapping != "auto"  ? "--mapping"
                             : device_memory != 0 ? "--device-memory"
                                                  : nullptr;
  return option == nullptr ? "" : fmt::format("{} is for OpenCL's devices; it wants --backend opencl", option);
}

Precision precision_of(const Scene& scene) {
  return scene.solver.precision == "double" ? Precision::Double : Precision::Float;
}

double vertex_substeps(const Shot& shot, int last_frame) {
  return static_cast<double>(shot.groom.vertex_count()) * static_cast<double>(shot.count_substeps(last_frame).total);
}

Backend choose_backend(const BackendOptions& options, Precision precision, double vertex_substeps) {
  Backend backend;
  if (options.backend == "opencl") {
    backend.device = find_device(std::max(options.device, 0));
  } else if (options.backend == "auto" && vertex_substeps >= kWorthADevice) {
    if (const int gpu = find_exact_gpu(precision == Precision::Double); gpu >= 0) {
      backend.device = find_device(gpu);
      backend.is_automatic = true;
    }
  }
  backend.opencl.mapping = options.mapping == "strands"    ? Mapping::Strands
                           : options.mapping == "vertices" ? Mapping::Vertices
                                                           : Mapping::Auto;
  backend.opencl.memory = options.device_memory;
  return backend;
}

namespace {
bool is_exact(const Device& device, Precision precision) {
  return precision == Precision::Double ? device.exact_double : device.exact_float;
}
}  // namespace

std::string numbers_of(const Backend& backend, Precision precision) {
  if (!backend.device || is_exact(*backend.device, precision)) return "exact";
  return fmt::format("{} {} {}", backend.device->platform_name, backend.device->name, backend.device->driver);
}

std::string describe_backend(const Backend& backend, const SolverOptions& options) {
  const char* const precision = options.precision == Precision::Double ? "double" : "float";
  if (!backend.device) {
    return fmt::format("openmp, {}, {} thread{}", precision, options.threads, options.threads == 1 ? "" : "s");
  }
  const Device& device = *backend.device;
  const bool exact = is_exact(device, options.precision);
  return fmt::format("opencl on {} ({}), {}{}", device.name, device.platform_name, precision,
                     exact ? "" : "; its division and square root are not exact, so bytes differ from the CPU's");
}

std::unique_ptr<Solver> make_solver(Backend& backend, const Groom& groom, const Plan& plan,
                                    const Eigen::Isometry3d& head, const SolverOptions& options,
                                    const std::function<void(const std::string&)>& warn) {
  if (!backend.device) return make_openmp_solver(groom, plan, head, options);
  OpenCLOptions opencl = backend.opencl;
  opencl.precision = options.precision;
  opencl.threads = options.threads;
  opencl.skip = options.skip;
  opencl.program_cache = program_cache_folder();
  try {
    return make_opencl_solver(groom, plan, head, *backend.device, opencl);
  } catch (const DeviceError& error) {
    if (!backend.is_automatic) throw;
    warn(fmt::format("{}; the CPU bakes", error.what()));
    backend.device.reset();
    return make_openmp_solver(groom, plan, head, options);
  }
}

std::filesystem::path program_cache_folder() {
  if (const char* const cache = std::getenv("XDG_CACHE_HOME"); cache != nullptr && *cache != '\0') {
    return std::filesystem::path(cache) / "strandbake/opencl";
  }
  if (const char* const home = std::getenv("HOME"); home != nullptr && *home != '\0') {
    return std::filesystem::path(home) / ".cache/strandbake/opencl";
  }
  return {};
}

}  // namespace strandbake
