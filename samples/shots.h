// Grooms and shots that nobody had to make by hand: what tests and benchmarks run on.
#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include "sim/gusts.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake::samples {

using Eigen::Isometry3d;
using Eigen::Vector3d;
using Points = std::vector<Vector3d>;

// The same numbers from every standard library, unlike std::uniform_real_distribution.
class Random {
 public:
  explicit Random(std::uint32_t seed) : engine_(seed) {}
  double uniform(double low, double high) { return low + (high - low) * (static_cast<double>(engine_()) * 0x1p-32); }
  int integer(int low, int high) {
    return low + static_cast<int>(engine_() % static_cast<std::uint32_t>(high - low + 1));
  }
  Vector3d in_cube(double half) {
    const double x = uniform(-half, half), y = uniform(-half, half), z = uniform(-half, half);
    return {x, y, z};
  }
  Vector3d direction() {
    Vector3d v = in_cube(1);
    while (v.norm() < 0.1 || v.norm() > 1) v = in_cube(1);
    return v.normalized();
  }
  Eigen::Matrix3d rotation() {
    const Vector3d axis = direction();
    return Eigen::AngleAxisd(uniform(-std::numbers::pi, std::numbers::pi), axis).toRotationMatrix();
  }

 private:
  std::mt19937 engine_;
};

// ---- methods ----

// The local methods by their number, and the rod after them.
constexpr int kRod = 5;

inline void set_method(RegionParams& region, int method) {
  region.method = method == kRod ? "rod" : "shape";
  if (method != kRod) region.local.method = method;
}
inline std::string name_of_method(int method) {
  return method == kRod ? "rod" : std::to_string(method);
}

// ---- strands ----

inline void add_strand(Groom& groom, const Points& points) {
  groom.position.insert(groom.position.end(), points.begin(), points.end());
  groom.offset.push_back(groom.position.size());
  if (!groom.pinned.empty()) groom.pinned.resize(groom.position.size(), 0);
}
inline Groom groom_of(const std::vector<Points>& strands) {
  Groom groom;
  for (const Points& points : strands) add_strand(groom, points);
  return groom;
}
inline Points points_of(const Groom& groom, std::size_t strand) {
  return {groom.position.begin() + static_cast<std::ptrdiff_t>(groom.offset[strand]),
          groom.position.begin() + static_cast<std::ptrdiff_t>(groom.offset[strand + 1])};
}
inline void pin(Groom& groom, std::size_t strand, std::size_t vertex) {
  groom.pinned.resize(groom.vertex_count(), 0);
  groom.pinned[groom.offset[strand] + vertex] = 1;
}

inline Points straight(std::size_t vertices, double length, const Vector3d& root = {0, 0, 0},
                       const Vector3d& direction = {0, -1, 0}) {
  Points p;
  for (std::size_t i = 0; i < vertices; ++i) {
    p.push_back(root + direction * (length * static_cast<double>(i) / static_cast<double>(vertices - 1)));
  }
  return p;
}
// A helix along -Y.
inline Points curly(std::size_t vertices, double length, double radius, double turns,
                    const Vector3d& root = {0, 0, 0}) {
  Points p;
  for (std::size_t i = 0; i < vertices; ++i) {
    const double u = static_cast<double>(i) / static_cast<double>(vertices - 1);
    const double angle = 2 * std::numbers::pi * turns * u;
    p.push_back(root + Vector3d(radius * (std::cos(angle) - 1), -length * u, radius * std::sin(angle)));
  }
  return p;
}
// A flat wave along -Y.
inline Points wavy(std::size_t vertices, double length, double amplitude, double waves,
                   const Vector3d& root = {0, 0, 0}) {
  Points p;
  for (std::size_t i = 0; i < vertices; ++i) {
    const double u = static_cast<double>(i) / static_cast<double>(vertices - 1);
    p.push_back(root + Vector3d(amplitude * std::sin(2 * std::numbers::pi * waves * u), -length * u, 0));
  }
  return p;
}
// Walks on with bends of less than 60 degrees and segments of any length.
inline Points rambling(Random& random, std::size_t vertices, const Vector3d& root) {
  Points p = {root};
  Vector3d direction = random.direction();
  while (p.size() < vertices) {
    p.push_back(p.back() + direction * random.uniform(0.004, 0.02));
    direction = (direction + 0.8 * random.direction()).normalized();
  }
  return p;
}
// Turns back on itself at every vertex.
inline Points folded(std::size_t vertices, double segment, const Vector3d& root = {0, 0, 0}) {
  Points p;
  for (std::size_t i = 0; i < vertices; ++i) p.push_back(root + Vector3d(0, i % 2 == 0 ? 0.0 : segment, 0));
  return p;
}
// Every vertex thrice in one place.
inline Points stuttering(Random& random, std::size_t vertices, const Vector3d& root) {
  Points p = rambling(random, vertices, root);
  for (std::size_t i = 0; i < p.size(); ++i) p[i] = p[i - i % 3];
  return p;
}

// Mixed shapes and lengths, 2 to `longest` vertices, on a scalp of 10 cm around `center`. No folds, no coincident
// vertices.
inline Groom mixed_groom(std::uint32_t seed, std::size_t strands, int longest, const Vector3d& center = {0, 0, 0}) {
  Random random(seed);
  Groom groom;
  for (std::size_t s = 0; s < strands; ++s) {
    const Vector3d root = center + 0.1 * random.direction();
    const auto vertices = static_cast<std::size_t>(s < 3 ? 2 + s : random.integer(2, longest));
    switch (s % 4) {
      case 0:
        add_strand(groom, rambling(random, vertices, root));
        break;
      case 1:
        add_strand(groom, curly(vertices, 0.01 * static_cast<double>(vertices), 0.01,
                                0.07 * static_cast<double>(vertices), root));
        break;
      case 2:
        add_strand(groom, wavy(vertices, 0.01 * static_cast<double>(vertices), 0.005,
                               0.1 * static_cast<double>(vertices), root));
        break;
      default:
        add_strand(groom, straight(vertices, 0.01 * static_cast<double>(vertices), root, random.direction()));
        break;
    }
  }
  return groom;
}

// ---- shots ----

inline Isometry3d pose(const Eigen::Matrix3d& rotation, const Vector3d& translation) {
  Isometry3d t = Isometry3d::Identity();
  t.linear() = rotation;
  t.translation() = translation;
  return t;
}
inline Isometry3d no_motion(double) {
  return Isometry3d::Identity();
}
// Turns and nods and travels.
inline Isometry3d dance(double time) {
  const Eigen::Matrix3d rotation = (Eigen::AngleAxisd(0.7 * std::sin(5 * time), Vector3d::UnitY()) *
                                    Eigen::AngleAxisd(0.4 * std::sin(7 * time), Vector3d::UnitX()))
                                       .toRotationMatrix();
  return pose(rotation, {0.1 * std::sin(3 * time), 0.05 * time, 0.08 * std::sin(4 * time)});
}

// Everything a bake would take from a scene. Functions of time are sampled at the end of each substep.
struct Shot {
  Groom groom;
  RegionParams region;
  std::function<std::vector<RegionParams>(int)> regions_at;  // by frame, from 1; empty: `region` always
  Vector3d gravity{0, -9.81, 0};
  WindParams wind;
  std::function<Isometry3d(double)> head = no_motion;
  std::function<std::vector<Sphere>(double)> spheres;
  std::function<int(int)> substeps_at;  // by frame; empty: `substeps` always
  int substeps = 1;
  double fps = 60;
  int frames = 1;
};

inline std::vector<RegionParams> regions_of(const Shot& shot, int frame) {
  return shot.regions_at ? shot.regions_at(frame) : std::vector<RegionParams>{shot.region};
}
inline bool is_windy(const Shot& shot) {
  return shot.wind.velocity.norm() > 0;
}

inline int substeps_of(const Shot& shot, int frame) {
  return shot.substeps_at ? shot.substeps_at(frame) : shot.substeps;
}

inline FrameInput frame_input(const Shot& shot, int frame) {
  FrameInput input;
  const int count = substeps_of(shot, frame);
  input.substep = 1 / (shot.fps * count);
  input.gravity = shot.gravity;
  input.regions = regions_of(shot, frame);
  for (int s = 1; s <= count; ++s) {
    const double time = (frame - 1 + static_cast<double>(s) / count) / shot.fps;
    input.head.push_back(shot.head(time));
    if (shot.spheres) input.spheres.push_back(shot.spheres(time));
    if (is_windy(shot)) input.wind.push_back(wind_at(shot.wind, time));
  }
  return input;
}

inline Plan plan_of(const Shot& shot) {
  Plan plan;
  for (std::size_t r = 0; r < regions_of(shot, 1).size(); ++r) {
    std::vector<RegionParams> over_time;
    for (int frame = 1; frame <= std::max(1, shot.frames); ++frame) over_time.push_back(regions_of(shot, frame)[r]);
    plan.regions.push_back(plan_region(over_time, is_windy(shot)));
  }
  plan.gravity_at_rest = shot.gravity;
  return plan;
}

// Positions at the start, then after each frame. Floats become doubles unrounded.
inline std::vector<Points> run(const Shot& shot, Solver& solver) {
  std::vector<Points> taken(1, Points(shot.groom.vertex_count()));
  solver.read(taken[0]);
  for (int frame = 1; frame <= shot.frames; ++frame) {
    solver.advance(frame_input(shot, frame));
    taken.emplace_back(shot.groom.vertex_count());
    solver.read(taken.back());
  }
  return taken;
}
inline std::vector<Points> run(const Shot& shot, const SolverOptions& options) {
  return run(shot, *make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), options));
}

inline double largest_distance(const Points& a, const Points& b) {
  double largest = 0;
  for (std::size_t v = 0; v < a.size(); ++v) {
    const double distance = (a[v] - b[v]).norm();
    if (!(distance <= largest)) largest = distance;  // NaN counts as the largest
  }
  return largest;
}

}  // namespace strandbake::samples
