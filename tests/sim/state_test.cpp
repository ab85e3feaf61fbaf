// A solver goes on from a state that another one has saved.
#include <catch2/catch.hpp>
#include <stdexcept>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

using Bytes = std::vector<std::byte>;

Bytes saved(const Solver& solver) {
  Bytes bytes;
  solver.save([&](std::span<const std::byte> more) { bytes.insert(bytes.end(), more.begin(), more.end()); });
  return bytes;
}

// Returns how many bytes were left.
std::size_t load(Solver& solver, const Bytes& bytes) {
  std::span<const std::byte> rest = bytes;
  solver.load([&](std::span<std::byte> out) {
    if (out.size() > rest.size()) throw std::runtime_error("the state is too short");
    std::copy_n(rest.begin(), out.size(), out.begin());
    rest = rest.subspan(out.size());
  });
  return rest.size();
}

// All methods, frames that last with and without support, hair that rides, rods.
Shot shot_of_everything() {
  Shot shot = busy_shot();
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) shot.groom.region[s] = static_cast<std::uint32_t>(s % 8);
  shot.regions_at = [regions_at = shot.regions_at](int frame) {
    std::vector<RegionParams> regions = regions_at(frame);
    regions.push_back(regions[1]);
    regions.push_back(regions[0]);
    regions[3].sag_free = regions[4].sag_free = true;
    regions[5].simulate = false;
    regions.insert(regions.end(), 2, RegionParams{});
    regions[6].method = regions[7].method = "rod";
    regions[7].sag_free = true;
    regions[7].rod.exact_lengths = false;
    return regions;
  };
  return shot;
}

}  // namespace

TEST_CASE("a solver goes on from a saved state to the same bits, on any number of lanes and threads") {
  const Shot shot = shot_of_everything();
  const Plan plan = plan_of(shot);
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const auto make = [&](int lanes, int threads) {
    return make_openmp_solver(shot.groom, plan, shot.head(0),
                              {.precision = precision, .threads = threads, .lanes = lanes});
  };
  const auto first = make(4, 1);
  const std::vector<Points> undisturbed = run(shot, *first);
  for (const int lanes : available_lanes()) {
    for (const int kept : {0, 1, 7, 8}) {  // frames, after even and odd numbers of substeps
      const auto before = make(4, 2);
      for (int frame = 1; frame <= kept; ++frame) before->advance(frame_input(shot, frame));
      const auto after = make(lanes, 3);
      after->advance(frame_input(shot, 15));  // of which nothing must be left
      REQUIRE(load(*after, saved(*before)) == 0);
      CHECK((saved(*after) == saved(*before)));
      Points positions(shot.groom.vertex_count());
      after->read(positions);
      CHECK(same_bits(positions, undisturbed[static_cast<std::size_t>(kept)]));
      for (int frame = kept + 1; frame <= shot.frames; ++frame) after->advance(frame_input(shot, frame));
      after->read(positions);
      CHECK(same_bits(positions, undisturbed.back()));
      CHECK_FALSE(after->find_non_finite());
      CHECK((saved(*after) == saved(*first)));
    }
  }
}

TEST_CASE("a state that is too short is told") {
  const Shot shot = shot_of_everything();
  const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), {});
  Bytes bytes = saved(*solver);
  bytes.pop_back();
  CHECK_THROWS_AS(load(*solver, bytes), std::runtime_error);
}
