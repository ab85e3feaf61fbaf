// Which substep it was that left the numbers: one strand alone against the whole groom, cut short after each substep.
#include "sim/lost_numbers.h"

#include <catch2/catch.hpp>
#include <limits>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

// The input of a frame that ends after `count` of its substeps.
FrameInput cut_short(FrameInput input, std::size_t count) {
  input.head.resize(count);
  if (!input.spheres.empty()) input.spheres.resize(count);
  if (!input.wind.empty()) input.wind.resize(count);
  return input;
}

}  // namespace

TEST_CASE("one strand alone tells the substep and the vertex that left the numbers first among all strands") {
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  Shot shot = busy_shot();
  shot.substeps_at = [](int frame) { return 3 + frame % 4; };
  shot.frames = 5;
  std::function<FrameInput(int)> input_of = [&](int frame) { return frame_input(shot, frame); };
  SECTION("a gust beyond all numbers in one substep") {
    const std::size_t gust = GENERATE(0u, 1u, 3u);
    input_of = [&shot, gust](int frame) {
      FrameInput input = frame_input(shot, frame);
      for (std::size_t s = gust; frame == shot.frames && s < input.substeps(); ++s) {
        input.wind[s][1] = {std::numeric_limits<double>::infinity(), 0, 0};
      }
      return input;
    };
  }
  SECTION("a weight that is too much after some substeps, far from the origin") {
    const Vector3d far(3e4, 0, 1e4);
    for (Vector3d& p : shot.groom.position) p += far;
    shot.head = [far](double time) { return pose(Eigen::Matrix3d::Identity(), far) * dance(time); };
    shot.regions_at = [regions_at = shot.regions_at](int frame) {
      std::vector<RegionParams> regions = regions_at(frame);
      for (RegionParams& region : regions) region.lengths = LengthParams::iterated(0);
      return regions;
    };
    shot.gravity = {0, precision == Precision::Float ? -3e21 : -2.2e156, 0};
    shot.frames = 30;
  }
  const Plan plan = plan_of(shot);
  Replay replay = {0, 0, input_of, shot.head(0), precision};

  const auto whole = make_openmp_solver(shot.groom, plan, shot.head(0), {.precision = precision});
  std::optional<NonFinite> at_end;
  for (int frame = 1; frame <= shot.frames && !at_end; ++frame) {
    whole->advance(input_of(frame));
    at_end = whole->find_non_finite();
    replay.last = frame;
  }
  REQUIRE(at_end);
  const std::size_t strand = at_end->strand;
  const FrameInput last = input_of(replay.last);
  REQUIRE(last.substeps() > 1);
  const auto after = [&](std::size_t count) {
    const auto solver = make_openmp_solver(shot.groom, plan, shot.head(0), {.precision = precision});
    for (int frame = 1; frame < replay.last; ++frame) solver->advance(input_of(frame));
    solver->advance(cut_short(last, count));
    Points now(shot.groom.vertex_count());
    solver->read(now);
    return points_of({shot.groom.offset, now, {}, {}, {}}, strand);
  };
  const auto is_finite = [](const Points& points) {
    return std::all_of(points.begin(), points.end(), [](const Vector3d& p) { return p.allFinite(); });
  };

  const auto found = find_lost_numbers(shot.groom, *at_end, plan, replay);
  REQUIRE(found);
  CAPTURE(precision == Precision::Float, strand, found->vertex, found->substep, last.substeps());
  const Points then = after(found->substep);
  CHECK_FALSE(then[found->vertex].allFinite());
  for (std::size_t v = 2; v < found->vertex; ++v) CHECK(then[v].allFinite());
  if (found->substep > 1) CHECK(is_finite(after(found->substep - 1)));
}

TEST_CASE("a strand that stays finite has lost no numbers") {
  const Shot shot = busy_shot();
  const Replay replay = {0, 3, [&](int frame) { return frame_input(shot, frame); }, shot.head(0), Precision::Float};
  CHECK_FALSE(find_lost_numbers(shot.groom, {0, 2, 0}, plan_of(shot), replay));
}
