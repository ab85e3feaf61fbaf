#include "formats/shot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "formats/digest.h"
#include "formats/groom_file.h"
#include "formats/scene_words.h"
#include "formats/units.h"
#include "sim/gusts.h"

namespace strandbake {
namespace {

constexpr std::uint32_t kUnclaimed = std::numeric_limits<std::uint32_t>::max();

// Throws std::invalid_argument for units and axes that read_scene() refuses.
Placement make_placement(const GroomParams& groom, const std::string& units, const std::string& up) {
  const double radian = std::numbers::pi / 180;
  Placement place;
  place.size = metres_per_unit(units) * groom.scale;
  const Eigen::Matrix3d rotation = (Eigen::AngleAxisd(groom.rotate.z() * radian, Eigen::Vector3d::UnitZ()) *
                                    Eigen::AngleAxisd(groom.rotate.y() * radian, Eigen::Vector3d::UnitY()) *
                                    Eigen::AngleAxisd(groom.rotate.x() * radian, Eigen::Vector3d::UnitX()))
                                       .toRotationMatrix();
  place.turn = place.size * rotation * to_y_up(up);
  place.move = groom.translate;
  return place;
}

// Strands [first, first + count) of the groom came from this file.
struct FileStrands {
  std::string name;
  std::size_t first;
  std::size_t count;
};

void append(Groom& all, Groom more, const Placement& place) {
  if (all.strand_count() == 0) {  // most grooms are one file, and large
    for (Eigen::Vector3d& p : more.position) p = place(p);
    all = std::move(more);
    return;
  }
  const std::size_t first_vertex = all.vertex_count();
  const bool pins = !all.pinned.empty() || !more.pinned.empty();
  const bool uvs = !all.root_uv.empty() && !more.root_uv.empty();
  if (pins) all.pinned.resize(first_vertex, 0);
  all.position.reserve(first_vertex + more.vertex_count());
  for (const Eigen::Vector3d& p : more.position) all.position.push_back(place(p));
  if (pins) {
    all.pinned.insert(all.pinned.end(), more.pinned.begin(), more.pinned.end());
    all.pinned.resize(all.vertex_count(), 0);
  }
  if (uvs) {
    all.root_uv.insert(all.root_uv.end(), more.root_uv.begin(), more.root_uv.end());
  } else {
    all.root_uv.clear();
  }
  for (std::size_t s = 1; s < more.offset.size(); ++s) all.offset.push_back(first_vertex + more.offset[s]);
}

std::string strand_and_more(std::size_t strand, std::size_t count) {
  return count == 1 ? fmt::format("strand {}", strand) : fmt::format("strand {} and {} more", strand, count - 1);
}

// Gives each strand its region. A region without a selection takes what no other takes. Selections with a fault that
// read_scene() has told of are passed over; then nothing can be said about what is left.
void divide(const Scene& scene, const std::vector<FileStrands>& files, Groom& groom, Faults& faults) {
  const std::size_t strands = groom.strand_count();
  const bool is_sound = faults.empty();
  bool selections_are_good = true;
  groom.region.assign(strands, kUnclaimed);
  std::optional<std::uint32_t> rest;
  for (std::uint32_t r = 0; r < scene.regions.size(); ++r) {
    const RegionScene& region = scene.regions[r];
    const std::string key = fmt::format("region[{}].strands", r);
    const StrandSelection& chosen = region.strands;
    if (chosen.file.empty() && chosen.range.empty() && !chosen.box) {
      // Nothing in it although it is written: there was a fault in it.
      if (!is_sound && (scene.positions.count(key) > 0 || scene.overridden.count(key) > 0)) selections_are_good = false;
      rest = r;
      continue;
    }
    FileStrands within{"the groom", 0, strands};
    if (!chosen.file.empty()) {
      const auto same = [&](const FileStrands& f) { return f.name == chosen.file; };
      const auto file = std::find_if(files.begin(), files.end(), same);
      if (file == files.end()) {
        selections_are_good = false;
        continue;
      }
      if (std::count_if(files.begin(), files.end(), same) > 1) {
        faults.push_back(
            {scene.place(key + ".file"),
             fmt::format(
                 "\"{}\" is in groom.files more than once; choose its strands with `range` over the whole groom",
                 chosen.file)});
        selections_are_good = false;
        continue;
      }
      within = *file;
    }
    std::vector<std::pair<std::size_t, std::size_t>> ranges = {{0, within.count == 0 ? 0 : within.count - 1}};
    if (!chosen.range.empty()) {
      try {
        ranges = parse_ranges(chosen.range);
      } catch (const std::invalid_argument&) {
        selections_are_good = false;
        continue;
      }
      if (ranges.back().second >= within.count) {
        faults.push_back(
            {scene.place(key + ".range"), fmt::format("strand {} is not there: {} has {} strands, numbered from 0",
                                                      ranges.back().second, within.name, within.count)});
        selections_are_good = false;
        continue;
      }
    }
    std::size_t taken = 0;
    std::size_t claimed_twice = 0, example = 0;
    std::uint32_t other = 0;
    for (const auto& [low, high] : ranges) {
      for (std::size_t s = within.first + low; s <= within.first + high && s < strands; ++s) {
        if (chosen.box) {
          const Eigen::Vector3d& root = groom.position[groom.offset[s]];
          if ((root.array() < chosen.box->min.array()).any() || (root.array() > chosen.box->max.array()).any())
            continue;
        }
        ++taken;
        if (groom.region[s] != kUnclaimed) {
          if (claimed_twice++ == 0) {
            example = s;
            other = groom.region[s];
          }
          continue;
        }
        groom.region[s] = r;
      }
    }
    if (taken == 0) {
      faults.push_back(
          {scene.place(key), fmt::format("region \"{}\" has no strands: nothing matches its selection", region.name)});
    }
    if (claimed_twice > 0) {
      faults.push_back({scene.place(key),
                        fmt::format("region \"{}\" claims {}, which region \"{}\" has already; let one of them go",
                                    region.name, strand_and_more(example, claimed_twice), scene.regions[other].name)});
    }
  }
  const auto unclaimed = static_cast<std::size_t>(std::count(groom.region.begin(), groom.region.end(), kUnclaimed));
  if (rest) {
    if (unclaimed == 0 && selections_are_good) {
      faults.push_back(
          {scene.place(fmt::format("region[{}]", *rest)),
           fmt::format("region \"{}\" has no strands: the other regions take them all", scene.regions[*rest].name)});
    }
    std::replace(groom.region.begin(), groom.region.end(), kUnclaimed, *rest);
  } else if (unclaimed > 0 && selections_are_good) {
    const auto first = std::find(groom.region.begin(), groom.region.end(), kUnclaimed) - groom.region.begin();
    faults.push_back({scene.place("region[0]"),
                      fmt::format("no region takes {}; a [[region]] without `strands` takes all that is left",
                                  strand_and_more(first, unclaimed))});
  }
}

// Frames at which parameters take their extremes: between two keys they change along a line.
template <class Params>
std::vector<double> telling_frames(const Scene& scene, const Animated<Params>& params) {
  std::vector<double> frames = {static_cast<double>(scene.first_frame), static_cast<double>(scene.last_frame)};
  for (const auto& [path, curve] : params.keys) {
    for (const double frame : curve.frame) {
      if (frame > scene.first_frame && frame < scene.last_frame) frames.push_back(frame);
    }
  }
  return frames;
}

// Finds a file that the scene names; records its digest.
std::filesystem::path open_input(const std::string& name, const std::string& key, Shot& shot, Faults& faults) {
  const std::filesystem::path path = find_input(shot.scene, name);
  if (path.empty()) {
    faults.push_back(
        {shot.scene.place(key),
         fmt::format("\"{}\": no such file beside the scene{}; give its folder with --search or STRANDBAKE_PATH", name,
                     shot.scene.search_path.empty() ? "" : " or in the search path")});
    return path;
  }
  try {
    shot.inputs.emplace_back(name, sha256_file(path));
  } catch (const InputError& error) {
    faults.push_back({shot.scene.place(key), error.what()});
    return {};
  }
  return path;
}

// Units and axes that read_scene() has refused count as left out.
AnimationOptions animation_options(const HeadParams& head) {
  try {
    if (!head.units.empty()) metres_per_unit(head.units);
    if (!head.up.empty()) to_y_up(head.up);
  } catch (const std::invalid_argument&) {
    return {head.clip, "", ""};
  }
  return {head.clip, head.units, head.up};
}

void load_animation(Shot& shot, Faults& faults, Warnings& warnings) {
  const HeadParams& head = shot.scene.head;
  if (head.animation.empty()) return;
  const std::filesystem::path path = open_input(head.animation, "head.animation", shot, faults);
  if (path.empty()) return;
  try {
    shot.animation = read_animation(path, animation_options(head), warnings);
  } catch (const InputError& error) {
    faults.push_back({shot.scene.place("head.animation"), error.what()});
    return;
  }
  const auto find = [&](const std::string& node, const std::string& key) -> std::size_t {
    try {
      return shot.animation.find_node(node);
    } catch (const InputError& error) {
      faults.push_back({shot.scene.place(key), error.what()});
      return 0;
    }
  };
  const std::size_t faults_before = faults.size();
  if (!head.node.empty()) shot.head_node = find(head.node, "head.node");
  for (std::size_t c = 0; c < shot.scene.colliders.size(); ++c) {
    const ColliderParams& collider = shot.scene.colliders[c].base;
    if (!collider.node.empty()) shot.collider_node[c] = find(collider.node, fmt::format("collider[{}].node", c));
  }
  if (faults.size() > faults_before) return;
  // A node can shrink to nothing in mid-clip; better known before the bake than in it.
  try {
    const double rest_frame = head.rest_frame.value_or(shot.scene.first_frame);
    shot.head_rest = shot.pose(shot.head_node, rest_frame);
    for (std::size_t c = 0; c < shot.scene.colliders.size(); ++c) {
      if (!shot.scene.colliders[c].base.node.empty())
        shot.collider_rest[c] = shot.pose(shot.collider_node[c], rest_frame);
    }
    // The last key stands for all frames after it.
    const double keys_end =
        head.start.value_or(shot.scene.first_frame) + shot.animation.duration * shot.scene.bake.fps + 1;
    for (int frame = shot.scene.first_frame; frame <= std::min<double>(shot.scene.last_frame, keys_end); ++frame) {
      shot.head(frame);
      shot.spheres(frame);
    }
  } catch (const InputError& error) {
    faults.push_back({shot.scene.place("head.animation"), error.what()});
  }
}

void load_groom(Shot& shot, Faults& faults, Warnings& warnings) {
  const Scene& scene = shot.scene;
  std::vector<FileStrands> files;
  bool complete = true;
  for (std::size_t f = 0; f < scene.groom.files.size(); ++f) {
    const GroomFileParams& file = scene.groom.files[f];
    const std::string key = fmt::format("groom.files[{}]", f);
    const std::filesystem::path path = open_input(file.file, key, shot, faults);
    if (path.empty()) {
      complete = false;
      continue;
    }
    try {
      Groom part = read_groom(path, warnings);
      const Placement place = make_placement(scene.groom, file.units.empty() ? scene.groom.units : file.units,
                                             file.up.empty() ? scene.groom.up : file.up);
      files.push_back({file.file, shot.groom.strand_count(), part.strand_count()});
      append(shot.groom, std::move(part), place);
    } catch (const InputError& error) {
      faults.push_back({scene.place(key), error.what()});
      complete = false;
    } catch (const std::invalid_argument&) {
      complete = false;  // units or axes that read_scene() has refused
    }
  }
  if (scene.groom.space == "head") {
    if (shot.animation.nodes.empty()) return;  // nobody knows where the head is
    for (Eigen::Vector3d& p : shot.groom.position) p = shot.head_rest * p;
  }
  const auto lost = std::find_if(shot.groom.position.begin(), shot.groom.position.end(),
                                 [](const Eigen::Vector3d& p) { return !(p.cwiseAbs().maxCoeff() < 1e9); });
  if (lost != shot.groom.position.end()) {
    faults.push_back(
        {scene.place("groom"),
         fmt::format("vertex {} lies more than a million kilometres away; look at the units, the scale and the "
                     "place of the groom",
                     lost - shot.groom.position.begin())});
    return;
  }
  if (!complete || files.empty()) return;
  divide(scene, files, shot.groom, faults);
}

}  // namespace

Eigen::Isometry3d Shot::pose(std::size_t node, double frame) const {
  const double start = scene.head.start.value_or(scene.first_frame);
  return animation.pose(node, (frame - start) / scene.bake.fps);
}

// The poses of one moment, each found once: colliders often ride the head's node, and several of them the same one.
class Shot::Moment {
 public:
  Moment(const Shot& shot, double frame) : shot_(shot), frame_(frame) {}

  double frame() const { return frame_; }

  const Eigen::Isometry3d& pose(std::size_t node) {
    const auto known = std::find_if(poses_.begin(), poses_.end(), [&](const auto& pose) { return pose.first == node; });
    if (known != poses_.end()) return known->second;
    return poses_.emplace_back(node, shot_.pose(node, frame_)).second;
  }

  Eigen::Isometry3d since_rest(std::size_t node, const Eigen::Isometry3d& rest) {
    const Eigen::Isometry3d& now = pose(node);
    // A pose times its inverse is the identity up to rounding only, and a head that stands still must not move a bit.
    if (now.matrix() == rest.matrix()) return Eigen::Isometry3d::Identity();
    return now * rest.inverse();
  }

 private:
  const Shot& shot_;
  double frame_;
  std::vector<std::pair<std::size_t, Eigen::Isometry3d>> poses_;  // by node
};

Eigen::Isometry3d Shot::head(Moment& moment) const {
  return animation.nodes.empty() ? Eigen::Isometry3d::Identity() : moment.since_rest(head_node, head_rest);
}

std::vector<Sphere> Shot::spheres(Moment& moment) const {
  std::vector<Sphere> spheres;
  for (std::size_t c = 0; c < scene.colliders.size(); ++c) {
    const ColliderParams collider = scene.colliders[c].at(moment.frame());
    Sphere sphere{collider.sphere.center, collider.sphere.radius};
    if (collider.space == "node") {
      sphere.center = moment.pose(collider_node[c]) * sphere.center;
    } else {
      if (collider.space == "groom") {
        sphere.center = placement(sphere.center);
        sphere.radius *= placement.size;
        if (scene.groom.space == "head") sphere.center = head_rest * sphere.center;
      }
      if (!collider.node.empty()) sphere.center = moment.since_rest(collider_node[c], collider_rest[c]) * sphere.center;
    }
    spheres.push_back(sphere);
  }
  return spheres;
}

Eigen::Isometry3d Shot::head(double frame) const {
  Moment moment(*this, frame);
  return head(moment);
}

std::vector<Sphere> Shot::spheres(double frame) const {
  Moment moment(*this, frame);
  return spheres(moment);
}

std::vector<RegionParams> Shot::regions(double frame) const {
  std::vector<RegionParams> params;
  for (const RegionScene& region : scene.regions) params.push_back(region.params.at(frame));
  return params;
}

Motion Shot::motion(double frame) const {
  Moment moment(*this, std::max<double>(frame, scene.first_frame));
  return {head(moment), spheres(moment)};
}

int Shot::substeps(int frame) const {
  if (scene.bake.substeps) return *scene.bake.substeps;
  return frame > scene.first_frame ? auto_substeps.at(static_cast<std::size_t>(frame - scene.first_frame - 1)) : 1;
}

Shot::Substeps Shot::count_substeps(int last_frame) const {
  Substeps count;
  for (int frame = scene.first_frame - scene.bake.preroll + 1; frame <= last_frame; ++frame) {
    const int now = substeps(frame);
    count.least = count.total == 0 ? now : std::min(count.least, now);
    count.most = std::max(count.most, now);
    count.total += now;
  }
  return count;
}

FrameInput Shot::input(int frame) const {
  const double first = scene.first_frame;
  FrameInput input;
  const int count = substeps(frame);
  input.substep = 1 / (scene.bake.fps * count);
  const double held = std::max<double>(frame, first);
  input.gravity = scene.forces.at(held).gravity;
  input.regions = regions(held);
  const WindParams wind = scene.wind.at(held);
  for (int s = 1; s <= count; ++s) {
    const double now = s == count ? frame : frame - 1 + static_cast<double>(s) / count;
    Moment moment(*this, std::max(now, first));
    input.head.push_back(head(moment));
    input.spheres.push_back(spheres(moment));
    if (!wind.velocity.isZero(0)) input.wind.push_back(wind_at(wind, now / scene.bake.fps));
  }
  return input;
}

namespace {

// A frame after which head and colliders stand still.
double end_of_motion(const Shot& shot) {
  const Scene& scene = shot.scene;
  double end = scene.first_frame;
  if (!shot.animation.nodes.empty()) {
    end = scene.head.start.value_or(end) + shot.animation.duration * scene.bake.fps + 1;
  }
  for (const Animated<ColliderParams>& collider : scene.colliders) {
    for (const auto& [path, curve] : collider.keys) end = std::max(end, curve.frame.back());
  }
  return end;
}

void find_substeps(Shot& shot, Faults& faults, Warnings& warnings) {
  constexpr int kMost = 1000;
  const Scene& scene = shot.scene;
  const HairExtent hair = hair_extent(shot.groom, shot.plan);
  const double end = end_of_motion(shot);
  SubstepCounter counter(scene.bake.tolerance, scene.bake.fps);
  std::vector<Motion> path;
  int beyond = 0, example = 0;
  for (int frame = scene.first_frame + 1; frame <= scene.last_frame; ++frame) {
    MotionNeed need;
    if (!hair.roots.isEmpty() && frame - 2 <= end) {
      // The last two moments of a frame are the first two of the next one.
      path.erase(path.begin(), path.end() - std::min<std::ptrdiff_t>(2, std::ssize(path)));
      try {
        for (int s = static_cast<int>(path.size()) - 1; s <= kMotionSamples; ++s) {
          path.push_back(shot.motion(frame - 1 + static_cast<double>(s) / kMotionSamples));
        }
      } catch (const InputError& error) {
        faults.push_back({scene.place("head.animation"), error.what()});
        return;
      }
      need = motion_need(path, hair);
    }
    double damping = 1;
    const std::vector<RegionParams> regions = shot.regions(frame);
    for (std::size_t r = 0; r < regions.size(); ++r) {
      if (shot.plan.regions[r].simulated) damping = std::min(damping, regions[r].damping);
    }
    const double wanted = counter.next(need, damping);
    if (wanted > kMost && beyond++ == 0) example = frame;
    shot.auto_substeps.push_back(static_cast<std::uint16_t>(std::min<double>(wanted, kMost)));
  }
  if (beyond > 0) {
    warnings.push_back(fmt::format(
        "{}: frame {}{} would take more than {} substeps for \"bake.tolerance\" = {} m and gets {}; does the head or a "
        "collider jump?",
        scene.place("bake.substeps"), example, beyond > 1 ? fmt::format(" and {} more", beyond - 1) : "", kMost,
        toml_text(scene.bake.tolerance), kMost));
  }
}

// The dotted path of a table or of the first thing in it that is written; empty if nothing is.
std::string written_path(const Scene& scene, const std::string& table) {
  const auto find = [&](const auto& places) -> std::string {
    const auto at = places.lower_bound(table);
    if (at == places.end() || at->first.compare(0, table.size(), table) != 0) return {};
    return at->first.size() == table.size() || at->first[table.size()] == '.' ? at->first : std::string();
  };
  const std::string in_scene = find(scene.positions);
  return in_scene.empty() ? find(scene.overridden) : in_scene;
}

// What only a rod has, in a region that does not say what it is.
void look_for_forgotten_method(const Scene& scene, Warnings& warnings) {
  for (std::size_t r = 0; r < scene.regions.size(); ++r) {
    const std::string region = fmt::format("region[{}]", r);
    if (!written_path(scene, region + ".method").empty()) continue;
    for (const char* const key : {"hair", "rod"}) {
      const std::string path = written_path(scene, fmt::format("{}.{}", region, key));
      if (path.empty()) continue;
      warnings.push_back(fmt::format(
          "{}: \"{}\" has no part in region \"{}\", which has method = \"shape\" as none is given; did you mean "
          "method = \"rod\"?",
          scene.place(path), key, scene.regions[r].name));
    }
  }
}

}  // namespace

Shot load_shot(Scene scene, Faults& faults, Warnings& warnings, bool skip_idle) {
  Shot shot;
  shot.scene = std::move(scene);
  shot.collider_node.assign(shot.scene.colliders.size(), 0);
  shot.collider_rest.assign(shot.scene.colliders.size(), Eigen::Isometry3d::Identity());
  try {
    shot.placement = make_placement(shot.scene.groom, shot.scene.groom.units, shot.scene.groom.up);
  } catch (const std::invalid_argument&) {
    // read_scene() has told of it.
  }
  const std::size_t faults_before = faults.size();
  load_animation(shot, faults, warnings);
  if (faults.size() > faults_before) {
    // Nodes are not known, so nothing can be placed; the groom files are still worth a look.
    shot.animation = {};
  }
  load_groom(shot, faults, warnings);
  look_for_forgotten_method(shot.scene, warnings);

  bool windy = false;
  for (const double frame : telling_frames(shot.scene, shot.scene.wind)) {
    windy |= !shot.scene.wind.at(frame).velocity.isZero(0);
  }
  for (const RegionScene& region : shot.scene.regions) {
    std::vector<RegionParams> over_time;
    for (const double frame : telling_frames(shot.scene, region.params)) over_time.push_back(region.params.at(frame));
    shot.plan.regions.push_back(plan_region(over_time, windy, skip_idle));
  }
  shot.plan.gravity_at_rest = shot.scene.forces.at(shot.scene.first_frame).gravity;
  shot.plan.colliders = !shot.scene.colliders.empty() || !skip_idle;
  if (!shot.scene.bake.substeps && faults.empty()) find_substeps(shot, faults, warnings);
  return shot;
}

}  // namespace strandbake
