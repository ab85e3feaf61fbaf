// A hundred strands on a head that nods, two seconds of it, without a file: the solver alone.
//   cmake -S . -B build -D CMAKE_PREFIX_PATH=/where/strandbake/is && cmake --build build && build/step_groom
#include <sim/plan.h>
#include <sim/solver.h>

#include <cmath>
#include <cstdio>

int main() {
  using namespace strandbake;
  Groom groom;
  for (int s = 0; s < 100; ++s) {
    for (int v = 0; v < 16; ++v) groom.position.emplace_back(0.001 * s - 0.05, 1.6, 0.1 + 0.01 * v);  // [m]
    groom.offset.push_back(groom.position.size());
  }
  RegionParams hair;
  hair.local.stiffness = 0.3;
  Plan plan;
  plan.regions = {plan_region({&hair, 1}, false)};
  plan.colliders = false;
  const auto solver = make_openmp_solver(groom, plan, Eigen::Isometry3d::Identity(), {});

  constexpr int kFrames = 48, kSubsteps = 4;
  std::vector<Eigen::Vector3f> position(groom.vertex_count());
  for (int frame = 1; frame <= kFrames; ++frame) {
    FrameInput input;
    input.substep = 1.0 / (24 * kSubsteps);
    input.gravity = {0, -9.81, 0};
    input.regions = {hair};
    input.spheres.resize(kSubsteps);
    for (int step = 1; step <= kSubsteps; ++step) {
      const double time = (frame - 1) / 24.0 + step * input.substep;
      input.head.push_back(Eigen::Isometry3d(Eigen::AngleAxisd(0.2 * std::sin(6 * time), Eigen::Vector3d::UnitX())));
    }
    solver->advance(input);
    solver->read(position);
    const Eigen::Vector3f& tip = position.back();
    if (frame % 12 == 0)
      std::printf("frame %2d: the last tip is at %.4f %.4f %.4f m\n", frame, tip.x(), tip.y(), tip.z());
  }
}
