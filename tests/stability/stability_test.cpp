// The stress suite: every shot of the table with every method, both ways to hold lengths, in float and double. What
// does not hold is listed here, and the list is as much a test as the rest: what starts to hold must leave it.
#include <catch2/catch.hpp>
#include <cstdlib>
#include <cstring>

#include "formats/procedural.h"
#include "samples/real_stability.h"
#include "samples/stability_measure.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

struct Known {
  const char* shot;
  const char* lengths;
  const char* property;
  const char* runs;  // methods, r for the rod, each with f for float and d for double
  const char* why;
};

// Why hair does not come to rest.
constexpr const char* kBetween =
    "Between two pinned vertices no walk makes lengths exact, and two rounds of the solve leave this where the head "
    "turns by a great angle in a substep.";
constexpr const char* kFollower =
    "The local shape turns twist back against nothing. Curled hair that is stiff, or in short substeps, and held or "
    "pressed so that it cannot hang, flutters where damping is little.";
constexpr const char* kBalance =
    "The balance of gravity and a force that turns with the hair is not a stable one: hair that has left it flutters "
    "and stays away.";
constexpr const char* kNoFrame =
    "Where a segment folds back or is next to nothing, frames and the directions of lengths turn with the least "
    "motion.";
constexpr const char* kSlow =
    "Two iterations let hair go long, or cannot bring it back against the force; it shrinks from step to step.";
constexpr const char* kTurns =
    "How far hair sags or is stretched at rest depends on the substep, which changes in turn.";
constexpr const char* kSwings = "With so little damping, or none, hair still swings.";
constexpr const char* kDangles =
    "What hangs by joints that are soft for its weight swings, or creeps, for longer than the shot has time for.";
constexpr const char* kSlides =
    "Where spheres hold roots inside, or leave no way out between them, hair slides about on them without friction.";
constexpr const char* kCreeps = "Without velocity hair goes on creeping down, a little in each step.";

const std::vector<Known> kKnown = {
    {"the head is elsewhere at once", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSlow},
    {"one frame a second", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSlow},
    {"one frame a second", "direct", "rest", "2f 2d", kFollower},
    {"1 to 1000 substeps from frame to frame", "direct", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kTurns},
    {"1 to 1000 substeps from frame to frame", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kTurns},
    {"16 substeps", "direct", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"16 substeps", "iterated", "rest", "2f 2d", kFollower},
    {"local shape alone, rigid, 20 iterations", "direct", "rest", "1f 1d", kFollower},
    {"all velocity lost", "direct", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kCreeps},
    {"all velocity lost", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kCreeps},
    {"in balance as it was made", "direct", "rest", "1f 1d 2f 2d 4f 4d", kBalance},
    {"in balance as it was made", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kBalance},
    {"little damping", "direct", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSwings},
    {"little damping", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSwings},
    {"no damping", "direct", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSwings},
    {"no damping", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSwings},
    {"strands that fold back on themselves", "direct", "rest", "1f 1d 3f 3d 4f 4d", kNoFrame},
    {"strands that fold back on themselves", "iterated", "rest", "2f 2d", kNoFrame},
    {"vertices in one place", "direct", "rest", "1f 1d 2f 2d 4f 4d", kNoFrame},
    {"vertices in one place", "iterated", "rest", "4f 4d", kNoFrame},
    {"segments of 1e-7 m beside segments of 1 m", "direct", "rest", "1f 1d 2f 2d 4f 4d", kNoFrame},
    {"segments of 1e-7 m beside segments of 1 m", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kNoFrame},
    {"hair of a tenth of a millimetre", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSlow},
    {"hair of a kilometre", "direct", "rest", "1f 1d 2f 2d 4f", kFollower},
    {"hair of a kilometre", "iterated", "rest", "1f 1d 2f 2d", kFollower},
    {"both ends held", "direct", "held", "1f 1d 2f 2d 3f 3d 4f 4d", kBetween},
    {"both ends held", "direct", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"both ends held", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"both ends held, one substep", "direct", "held", "1f 1d 2f 2d 3f 3d 4f 4d", kBetween},
    {"both ends held, one substep", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"a sphere that grows to swallow the roots", "direct", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"a sphere that grows to swallow the roots", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"a sphere larger than the groom", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSlow},
    {"six spheres in one another", "direct", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"six spheres in one another", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"a thousand times the weight", "iterated", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kSlow},
    {"a real ponytail at 1,501 degrees a second", "direct", "held", "1f 1d 2f 2d 3f 3d 4f 4d", kBetween},
    {"a real ponytail at 1,501 degrees a second", "direct", "rest", "1f 1d 2f 2d 4f 4d", kFollower},
    {"a real ponytail at 1,501 degrees a second, one substep", "direct", "held", "1f 1d 2f 2d 3f 3d 4f 4d", kBetween},
    {"a real ponytail at 1,501 degrees a second, one substep", "direct", "rest", "1f 1d 2f 2d 3f 3d 4f 4d", kBetween},
    {"half a turn in one frame", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"a hundred kilometres from the origin", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"one substep", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"parameters from end to end of their ranges, each frame", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"a sphere that sweeps through at 50 m/s", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"a sphere out of nothing, and gone again", "iterated", "rest", "1f 1d 2f 2d 4f 4d", kSlow},
    {"all velocity lost", "direct", "rest", "rf rd", kDangles},
    {"little damping", "direct", "rest", "rf rd", kSwings},
    {"no damping", "direct", "rest", "rf rd", kSwings},
    {"strands that fold back on themselves", "direct", "rest", "rf rd", kDangles},
    {"segments of 1e-7 m beside segments of 1 m", "direct", "rest", "rf rd", kDangles},
    {"hair of a kilometre", "direct", "rest", "rf", kDangles},
    {"both ends held, one substep", "direct", "held", "rf rd", kBetween},
    {"six spheres in one another", "direct", "rest", "rf rd", kSlides},
    {"a real ponytail at 1,501 degrees a second", "direct", "held", "rf rd", kBetween},
    {"a real ponytail at 1,501 degrees a second, one substep", "direct", "held", "rf rd", kBetween},
};

std::string known_runs(const std::string& shot, const std::string& lengths, const std::string& property) {
  std::string runs;
  for (const Known& known : kKnown) {
    if (shot != known.shot || lengths != known.lengths || property != known.property) continue;
    runs += (runs.empty() ? "" : " ") + std::string(known.runs);
  }
  return runs;
}

void check_what_holds(const Case& c) {
  for (const bool direct : {true, false}) {
    std::string infinite, stretched, out_of_reach, held, growing, restless;
    for (const int method : {1, 2, 3, 4, kRod}) {
      if (method == kRod && !direct) continue;  // its lengths are its own
      const Case run_of = with_method(c, method, direct ? LengthParams{} : LengthParams::iterated(2));
      for (const Precision precision : {Precision::Float, Precision::Double}) {
        const auto note = [&](std::string& runs) {
          runs += (runs.empty() ? "" : " ") + name_of_method(method).substr(0, 1) +
                  (precision == Precision::Float ? "f" : "d");
        };
        const Measured found = measure(run_of, precision, run(run_of.shot, {.precision = precision}));
        if (!found.finite) note(infinite);
        // Iterated lengths promise nothing.
        if (direct && !(found.stretch <= 1)) note(stretched);
        if (direct && !(found.reach <= 1)) note(out_of_reach);
        if (direct && !(found.held <= kHeld)) note(held);
        if (!(found.growth <= kGrowth)) note(growing);
        if (!(found.unrest <= kUnrest)) note(restless);
      }
    }
    const std::string lengths = direct ? "direct" : "iterated";
    CAPTURE(c.name, lengths);
    CHECK(infinite.empty());
    CHECK(stretched == known_runs(c.name, lengths, "stretch"));
    CHECK(out_of_reach == known_runs(c.name, lengths, "reach"));
    CHECK(held == known_runs(c.name, lengths, "held"));
    CHECK(growing == known_runs(c.name, lengths, "growth"));
    CHECK(restless == known_runs(c.name, lengths, "rest"));
  }
}

// Those with real grooms are named so; they need files that are not part of the project.
bool is_real(const std::string& name) {
  return name.rfind("a real ", 0) == 0 || name.rfind("curls on a head that dances", 0) == 0;
}
std::vector<Case> real_cases_if_there() {
  const char* const assets = std::getenv("STRANDBAKE_ASSETS");
  if (assets == nullptr) {
    WARN("skipped: STRANDBAKE_ASSETS names no folder with real grooms and animation");
    return {};
  }
  return real_cases(assets);
}

}  // namespace

TEST_CASE("every shot of the stress table holds what it should, but for those that are listed") {
  for (const Case& c : cases()) check_what_holds(c);
}

TEST_CASE("so do real grooms on a head that turns at 1,501 degrees a second") {
  for (const Case& c : real_cases_if_there()) {
    CHECK(is_real(c.name));
    check_what_holds(c);
  }
}

TEST_CASE("what is listed of the stress table names shots that it has") {
  std::vector<Case> all = cases();
  const std::vector<Case> real = real_cases_if_there();
  all.insert(all.end(), real.begin(), real.end());
  for (const Known& known : kKnown) {
    CAPTURE(known.shot);
    if (real.empty() && is_real(known.shot)) continue;
    CHECK(std::any_of(all.begin(), all.end(), [&](const Case& c) { return c.name == known.shot; }));
    CHECK(std::strlen(known.why) > 20);
  }
}

TEST_CASE("a shot of the stress table is the same bits again, on two threads and narrow lanes") {
  for (const Case& c : cases()) {
    for (const int method : {1, 2, 3, 4, kRod}) {
      Case run_of = with_method(c, method, LengthParams{});
      run_of.shot.frames = std::min(run_of.shot.frames, 15);
      const Precision precision = method % 2 == 0 ? Precision::Float : Precision::Double;
      const std::vector<Points> once = run(run_of.shot, {.precision = precision});
      const std::vector<Points> again =
          run(run_of.shot, {.precision = precision, .threads = 2, .lanes = available_lanes().front()});
      CAPTURE(c.name, method);
      CHECK(std::equal(once.begin(), once.end(), again.begin(), same_bits));
    }
  }
}

TEST_CASE("hair of every style comes to rest on a head with one step a frame") {
  for (const char* const style : {"straight", "wavy", "curly", "ponytail"}) {
    ProceduralParams made = style_defaults(style);
    made.strands = 80;
    made.vertices = 48;
    Shot shot;
    shot.groom = make_groom(made);
    shot.region.damping = 0.1;
    shot.region.global.stiffness = 0;
    shot.fps = 24;
    shot.frames = 480;
    shot.spheres = [](double) { return std::vector<Sphere>{{{0, 0, 0}, 0.098}}; };
    for (const int method : {1, kRod}) {
      set_method(shot.region, method);
      const std::vector<Points> taken = run(shot, {});
      const Points& last = taken.back();
      double nearest = 1;
      for (const Vector3d& p : last) nearest = std::min(nearest, p.norm());
      CAPTURE(style, method, nearest);
      CHECK(nearest < 0.099);
      CHECK(largest_distance(last, taken[taken.size() - 2]) < 5e-6);
    }
  }
}

// STRANDBAKE_STABILITY_DRAWS says how many.
TEST_CASE("random parameters, ends of their ranges among them, leave hair finite and at its lengths") {
  const char* const wanted = std::getenv("STRANDBAKE_STABILITY_DRAWS");
  const int draws = wanted != nullptr ? std::atoi(wanted) : 400;
  Random random(111);
  const auto share = [&] {
    const int kind = random.integer(0, 4);
    const double between = random.uniform(0, 1);
    return kind == 0 ? 0.0 : kind == 1 ? 1.0 : between;
  };
  const Groom groom = awkward_groom({0, 0, 0});
  for (int draw = 0; draw < draws; ++draw) {
    Case c = {"random", {}, kNever};
    Shot& shot = c.shot;
    shot.groom = groom;
    shot.region.damping = share();
    shot.region.drag = 10 * share();
    shot.region.local.stiffness = share();
    shot.region.local.iterations = random.integer(0, 12);
    set_method(shot.region, random.integer(1, kRod));
    shot.region.rod.iterations = random.integer(1, 3);
    RodParams& rod = shot.region.rod;
    rod.stiffness = std::pow(10, random.uniform(-6, 6));
    if (random.integer(0, 1) == 1) {
      rod.young = std::pow(10, random.uniform(5, 12));
      rod.radius = std::pow(10, random.uniform(-6, -2));
      rod.density = std::pow(10, random.uniform(1, 4.4));
      rod.poisson = random.uniform(-0.99, 0.5);
      if (random.integer(0, 1) == 1) rod.shear = rod.young * std::pow(10, random.uniform(-2, 2));
      rod.exact_lengths = random.integer(0, 3) > 0;
    }
    shot.region.global.stiffness = share();
    shot.region.global.range = share();
    shot.region.global.fade = share();
    shot.gravity = 30 * share() * random.direction();
    shot.wind.velocity = 50 * share() * random.direction();
    shot.wind.gust = share();
    const double speed = 20 * share();
    const Vector3d axis = random.direction();
    shot.head = [speed, axis](double time) {
      return shifted(axis * std::sin(speed * time)) * turned(speed * time, axis.unitOrthogonal());
    };
    if (random.integer(0, 1) == 1) {
      const Vector3d center = random.in_cube(0.2);
      const double radius = 0.3 * share();
      shot.spheres = [center, radius, speed](double time) {
        return std::vector<Sphere>{{center * std::cos(speed * time), radius}};
      };
    }
    shot.fps = random.integer(1, 240);
    shot.substeps = random.integer(1, 6);
    shot.frames = 8;
    const Precision precision = random.integer(0, 1) == 0 ? Precision::Float : Precision::Double;
    const Measured found = measure(c, precision, run(shot, {.precision = precision}));
    CAPTURE(draw, found.stretch, found.reach, shot.fps, shot.substeps, shot.region.method, rod.stiffness, rod.young,
            rod.radius, rod.density, rod.shear, rod.exact_lengths, shot.region.global.stiffness,
            shot.region.local.method, precision == Precision::Float);
    CHECK(found.finite);
    if (shot.region.is_rod() && !rod.exact_lengths) continue;  // stretches
    CHECK(found.stretch <= 1);
    CHECK(found.reach <= 1);
  }
}
