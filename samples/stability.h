// The table of the stress suite: shots that a solver is not meant for and must live through all the same.
#pragma once

#include <string>
#include <vector>

#include "samples/shots.h"

namespace strandbake::samples {

// A shot whose method, lengths and precision are still open. Head, spheres, wind and parameters stand still after frame
// `stop`; by the last frame the hair should, too.
struct Case {
  std::string name;
  Shot shot;
  int stop;
};
constexpr int kNever = -1;

inline Case with_method(const Case& c, int method, const LengthParams& lengths) {
  const auto set = [method, lengths](RegionParams region) {
    set_method(region, method);
    region.lengths = lengths;
    return region;
  };
  Case with = c;
  with.shot.region = set(c.shot.region);
  if (c.shot.regions_at) {
    with.shot.regions_at = [regions_at = c.shot.regions_at, set](int frame) {
      std::vector<RegionParams> regions = regions_at(frame);
      for (RegionParams& region : regions) region = set(region);
      return regions;
    };
  }
  return with;
}

// What `function` of time does until `time`, and its last value from then on.
template <class Function>
auto until(double time, const Function& function) {
  return [time, function](double now) { return function(std::min(now, time)); };
}

inline Isometry3d shifted(const Vector3d& by) {
  return pose(Eigen::Matrix3d::Identity(), by);
}
inline Isometry3d turned(double angle, const Vector3d& axis) {
  return pose(Eigen::AngleAxisd(angle, axis.normalized()).toRotationMatrix(), {0, 0, 0});
}

// Straight, wavy, curly and rambling hair of about `length` with 4 to 64 vertices.
inline Groom ordinary_groom(double length = 0.3, const Vector3d& center = {0, 0, 0}) {
  Random random(101);
  Groom groom;
  const auto root = [&] { return Vector3d(center + length / 3 * random.direction()); };
  add_strand(groom, straight(64, length, root()));
  const Vector3d aside = random.direction();
  add_strand(groom, straight(4, length, root(), aside));
  add_strand(groom, wavy(11, length, length / 20, 2, root()));
  add_strand(groom, wavy(48, length, length / 40, 6, root()));
  add_strand(groom, curly(32, length, length / 15, 3, root()));
  add_strand(groom, curly(64, length, length / 30, 8, root()));
  Points points = rambling(random, 24, {0, 0, 0});
  const Vector3d at = root();
  for (Vector3d& p : points) p = at + p * (length / 0.3);
  add_strand(groom, points);
  return groom;
}

inline Shot ordinary_shot() {
  Shot shot;
  shot.groom = ordinary_groom();
  shot.frames = 240;
  shot.fps = 60;
  return shot;
}

inline std::vector<Case> cases() {
  std::vector<Case> all;
  const auto add = [&](const std::string& name, const Shot& shot, int stop) { all.push_back({name, shot, stop}); };
  const auto dancing = [](int frames, double fps) { return until(frames / fps, dance); };
  Shot shot;

  // ---- the head ----
  shot = ordinary_shot();
  shot.head = [](double time) { return shifted(time > 0.1 ? Vector3d(10, 3, -4) : Vector3d(0, 0, 0)); };
  add("the head is elsewhere at once", shot, 10);

  shot = ordinary_shot();
  shot.head = [](double time) { return turned(time > 0.1 ? std::numbers::pi : 0, {0.3, 1, 0.2}); };
  add("half a turn in one frame", shot, 10);

  shot = ordinary_shot();
  shot.head = until(0.5, [](double time) { return turned(100 * std::numbers::pi * time, Vector3d::UnitY()); });
  shot.substeps = 8;
  add("3,000 turns a minute", shot, 30);

  shot = ordinary_shot();
  shot.head = until(
      0.5, [](double time) { return shifted(Vector3d(0.05, 0.01, 0.03) * std::sin(40 * std::numbers::pi * time)); });
  shot.substeps = 4;
  add("20 shakes a second", shot, 30);

  shot = ordinary_shot();
  shot.fps = 1;
  shot.head = dancing(10, shot.fps);
  shot.frames = 60;
  add("one frame a second", shot, 10);

  shot = ordinary_shot();
  const Vector3d far(6e4, 1e4, 8e4);
  shot.groom = ordinary_groom(0.3, far);
  shot.head = [far](double time) { return shifted(far) * dance(std::min(time, 0.5)) * shifted(-far); };
  add("a hundred kilometres from the origin", shot, 30);
  shot.spheres = [far](double time) {
    const Vector3d place = far + dance(std::min(time, 0.5)) * Vector3d(0, -0.1, 0.05);
    return std::vector<Sphere>{{place, 0.1}};
  };
  shot.substeps = 3;
  add("a hundred kilometres from the origin, with a sphere", shot, 30);

  // ---- steps ----
  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  shot.substeps_at = [](int frame) {
    constexpr int kCounts[] = {1, 1000, 1, 2, 300, 7};
    return frame <= 12 ? kCounts[frame % 6] : 1 + frame % 3;
  };
  add("1 to 1000 substeps from frame to frame", shot, 30);

  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  add("one substep", shot, 30);
  shot.substeps = 16;
  add("16 substeps", shot, 30);

  // ---- parameters ----
  const auto with = [&](const std::string& name, double damping, const LocalShapeParams& local,
                        const GlobalShapeParams& global) {
    Shot s = ordinary_shot();
    s.head = dancing(30, s.fps);
    s.substeps = 2;
    s.region.damping = damping;
    s.region.local = local;
    s.region.global = global;
    add(name, s, 30);
  };
  with("no stiffness at all", 0.1, {0, 3, 1}, {0, 0.3, 1});
  with("local shape alone, rigid", 0.1, {1, 3, 1}, {0, 0.3, 1});
  with("local shape alone, rigid, 20 iterations", 0.1, {1, 20, 1}, {0, 0.3, 1});
  with("global shape alone, rigid, without fade", 0.1, {0, 3, 1}, {1, 1, 0});
  with("both rigid", 0.1, {1, 3, 1}, {1, 1, 0});
  with("a range of nothing", 0.1, {0.5, 3, 1}, {1, 0, 0});
  with("rigid up to a hard end", 0.1, {0.5, 3, 1}, {1, 0.5, 0});
  with("all velocity lost", 1, {0.5, 3, 1}, {0.1, 0.3, 1});
  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  shot.substeps = 4;
  shot.region.sag_free = true;
  add("in balance as it was made", shot, 30);
  with("little damping", 0.02, {0.5, 3, 1}, {0.1, 0.3, 1});
  with("no damping", 0, {0.5, 3, 1}, {0.1, 0.3, 1});

  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  shot.regions_at = [](int frame) {
    RegionParams region;
    if (frame <= 30) {
      region.damping = frame % 2;
      region.local.stiffness = (frame / 2) % 2;
      region.global.stiffness = (frame / 4) % 2;
    }
    return std::vector<RegionParams>{region};
  };
  add("parameters from end to end of their ranges, each frame", shot, 30);

  // ---- strands ----
  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  shot.groom = groom_of({folded(9, 0.02), folded(40, 0.01, {0.1, 0, 0}), folded(16, 0.05, {0, 0, 0.1})});
  add("strands that fold back on themselves", shot, 30);

  Random random(102);
  shot.groom = groom_of(
      {stuttering(random, 30, {0, 0, 0}), stuttering(random, 9, {0.1, 0, 0}), Points(12, Vector3d(0, 0.1, 0))});
  add("vertices in one place", shot, 30);

  Points uneven = {{0, 0, 0}};
  for (int i = 1; i < 16; ++i) {
    const Vector3d step = i % 2 == 0 ? Vector3d(1, 0, 0) : Vector3d(0, -1, 0);
    uneven.push_back(uneven.back() + step * (i % 3 == 0 ? 1e-7 : 1.0));
  }
  shot.groom = groom_of({uneven});
  add("segments of 1e-7 m beside segments of 1 m", shot, 30);

  shot.groom = groom_of({straight(2, 0.1), curly(10000, 3, 0.02, 200)});
  shot.frames = 20;
  add("2 vertices beside 10,000", shot, kNever);

  shot = ordinary_shot();
  shot.head = until(0.5, [](double time) { return shifted(Vector3d(1e-4, 0, 0) * std::sin(9 * time)); });
  shot.groom = ordinary_groom(1e-4);
  add("hair of a tenth of a millimetre", shot, 30);

  shot = ordinary_shot();
  shot.head = until(2, [](double time) { return turned(std::sin(3 * time), {0.2, 0.1, 1}); });
  shot.groom = ordinary_groom(1000);
  shot.fps = 10;
  shot.region.damping = 0.02;
  shot.frames = 600;
  add("hair of a kilometre", shot, 20);

  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) pin(shot.groom, s, shot.groom.vertex_count(s) - 1);
  shot.substeps = 4;
  add("both ends held", shot, 30);
  shot.substeps = 1;
  add("both ends held, one substep", shot, 30);

  // ---- spheres ----
  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  shot.spheres = until(0.5, [](double time) {
    return std::vector<Sphere>{{dance(time) * Vector3d(0, 0, 0), 0.05 + 0.2 * time}};
  });
  add("a sphere that grows to swallow the roots", shot, 30);

  shot = ordinary_shot();
  shot.spheres = until(0.5, [](double time) { return std::vector<Sphere>{{{50 * (time - 0.2), -0.1, 0}, 0.15}}; });
  add("a sphere that sweeps through at 50 m/s", shot, 30);

  shot = ordinary_shot();
  shot.spheres = [](double time) {
    const bool there = time > 0.2 && time < 0.5;
    return there ? std::vector<Sphere>{{{0.02, -0.15, 0.01}, 0.2}} : std::vector<Sphere>{};
  };
  add("a sphere out of nothing, and gone again", shot, 30);

  shot = ordinary_shot();
  shot.spheres = until(0.5, [](double time) { return std::vector<Sphere>{{{0.3 * std::sin(9 * time), -0.1, 0}, 10}}; });
  add("a sphere larger than the groom", shot, 30);

  shot = ordinary_shot();
  shot.head = dancing(30, shot.fps);
  shot.spheres = until(0.5, [](double time) {
    std::vector<Sphere> spheres;
    for (int k = 0; k < 6; ++k)
      spheres.push_back({dance(time) * Vector3d(0.1 * std::cos(k), -0.1, 0.1 * std::sin(k)), 0.12});
    return spheres;
  });
  add("six spheres in one another", shot, 30);

  // ---- forces ----
  shot = ordinary_shot();
  shot.gravity = {0, -1e4, 0};
  shot.head = dancing(30, shot.fps);
  add("a thousand times the weight", shot, 30);

  shot = ordinary_shot();
  shot.wind = {{200, 0, 30}, 0.5, 0.1};
  add("wind of 200 m/s", shot, kNever);
  return all;
}

}  // namespace strandbake::samples
