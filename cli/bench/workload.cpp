#include "cli/bench/workload.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "sim/gusts.h"

namespace strandbake {
namespace {

constexpr double kFps = 60;

Eigen::Isometry3d head_at(double frame) {
  Eigen::Isometry3d head = Eigen::Isometry3d::Identity();
  head.rotate(Eigen::AngleAxisd(0.3 * std::sin(0.1 * frame), Eigen::Vector3d::UnitY()));
  head.pretranslate(Eigen::Vector3d(0.1 * std::sin(0.07 * frame), 0, 0));
  return head;
}

// In the frame of the head: head, shoulders, then smaller ones where hair hangs.
const std::array<Sphere, 8>& sphere_places() {
  static const std::array<Sphere, 8> places = {{{{0, 0, 0}, 0.098},
                                                {{-0.15, -0.2, 0}, 0.098},
                                                {{0.15, -0.2, 0}, 0.098},
                                                {{0, -0.1, -0.05}, 0.06},
                                                {{0.06, -0.1, -0.02}, 0.04},
                                                {{-0.06, -0.1, -0.02}, 0.04},
                                                {{0.08, -0.02, -0.04}, 0.04},
                                                {{-0.08, -0.02, -0.04}, 0.04}}};
  return places;
}

}  // namespace

Plan Workload::plan() const {
  Plan plan;
  plan.regions.assign(static_cast<std::size_t>(regions), plan_region(std::span(&params, 1), windy()));
  return plan;
}

FrameInput Workload::input(int frame) const {
  FrameInput input;
  input.substep = 1 / (kFps * substeps);
  input.gravity = {0, -9.81, 0};
  input.regions.assign(static_cast<std::size_t>(regions), params);
  for (int s = 1; s <= substeps; ++s) {
    const double now = frame - 1 + static_cast<double>(s) / substeps;
    input.head.push_back(head_at(now));
    std::vector<Sphere> moment;
    for (int k = 0; k < spheres; ++k) {
      Sphere sphere = sphere_places().at(static_cast<std::size_t>(k));
      sphere.center = input.head.back() * sphere.center;
      moment.push_back(sphere);
    }
    input.spheres.push_back(moment);
    if (windy()) input.wind.push_back(wind_at(wind, now / kFps));
  }
  return input;
}

RegionParams nothing_but_integration() {
  RegionParams params;
  params.damping = 0.04;
  params.drag = 0;
  params.local.iterations = 0;
  params.global.stiffness = 0;
  params.lengths = LengthParams::iterated(0);
  return params;
}

Groom thinned(const Groom& groom, double share) {
  if (share >= 1) return groom;
  const auto strands = static_cast<double>(groom.strand_count());
  const auto left = static_cast<std::size_t>(std::max(1.0, std::round(share * strands)));
  Groom few;
  for (std::size_t k = 0; k < left; ++k) {
    const auto s = static_cast<std::size_t>(strands * static_cast<double>(k) / static_cast<double>(left));
    few.position.insert(few.position.end(), groom.position.begin() + static_cast<std::ptrdiff_t>(groom.offset[s]),
                        groom.position.begin() + static_cast<std::ptrdiff_t>(groom.offset[s + 1]));
    few.offset.push_back(few.position.size());
  }
  return few;
}

SolverRun::SolverRun(const Workload& workload, const SolverOptions& options)
    : workload_(workload),
      solver_(make_openmp_solver(*workload.groom, workload.plan(), workload.input(0).head.back(), options)) {}

SolverRun::SolverRun(const Workload& workload, const Device& device, const OpenCLOptions& options)
    : workload_(workload) {
  auto solver = make_opencl_solver(*workload.groom, workload.plan(), workload.input(0).head.back(), device, options);
  on_device_ = solver.get();
  solver_ = std::move(solver);
}

double SolverRun::frame() {
  const FrameInput input = workload_.input(++frame_);
  if (on_device_ != nullptr) {
    const double before = on_device_->kernel_seconds();
    solver_->advance(input);
    return on_device_->kernel_seconds() - before;
  }
  const auto start = Clock::now();
  solver_->advance(input);
  return seconds_since(start);
}

Turn SolverRun::turn(double seconds) {
  return [this, seconds](std::vector<double>& samples) {
    frame();
    double sum = 0;
    do {
      samples.push_back(frame());
      sum += samples.back();
      // Not every device tells how long its kernels took.
    } while (sum < seconds && sum > 0);
  };
}

}  // namespace strandbake
