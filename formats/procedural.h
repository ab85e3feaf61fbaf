// Procedural grooms on a sphere for a head: +Y up, the face towards +Z and free of hair. Metres.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "formats/error.h"
#include "sim/declare.h"
#include "sim/groom.h"

namespace strandbake {

// The head that the hair grows on: a sphere about the origin. No vertex lies inside.
inline constexpr double head_radius = 0.1;

struct ProceduralParams {
  std::string style = "straight";
  int strands = 10000;
  int vertices = 32;
  double length = 0.25;
  double length_variation = 0.1;
  double curl_radius = 0.006;
  double curl_turns = 3;
  double clump = 0.5;
  std::uint64_t seed = 1;
};
template <class V>
void fields(V& v, ProceduralParams& p) {
  v("style", p.style, one_of({"straight", "wavy", "curly", "ponytail", "fur"}), "",
    "How the hair lies: falling around the head (straight, wavy in a plane, curly as a helix), combed back to a tie "
    "and "
    "falling as a tail, or standing short.");
  v("strands", p.strands, between(1, 10'000'000), "1", "Number of strands.");
  v("vertices", p.vertices, between(2, 10'000), "1", "Vertices of a strand.");
  v("length", p.length, between(0.001, 2), "m", "Length of the longest strands, the sum of their segments.");
  v("length_variation", p.length_variation, between(0, 0.9), "1",
    "The share of its length that a strand lacks at most.");
  v("curl_radius", p.curl_radius, between(0, 0.1), "m", "Radius of waves and curls; straight hair and fur have none.");
  v("curl_turns", p.curl_turns, between(0, 200), "1", "Turns of the wave or curl along a strand.");
  v("clump", p.clump, between(0, 1), "1", "How far strands draw together in locks towards their tips.");
  v("seed", p.seed, at_least(0), "1", "Another seed gives other hair of the same kind.");
}

// Parameters that suit a style. Throws InputError for a style that is not there.
ProceduralParams style_defaults(std::string_view style);

// The same parameters give the same bytes on every machine: positions are float32 numbers. The segments of a strand are
// equally long, roots are spread evenly over the scalp, and `root_uv` maps the scalp to the unit square, equal areas to
// equal areas. Throws InputError for a parameter outside its range, and for more vertices than a .hair file can hold.
Groom make_groom(const ProceduralParams& params);

// Grooms of the sizes in Table 1 of the paper, with strands of mixed vertex counts: "model1" (a ponytail, 19,776
// strands, 221,078 vertices), "model2" (wavy, 20,000 and 259,993), "model3" (curly, 20,000 and 1,373,047). Nothing for
// other names.
inline constexpr std::array<const char*, 3> preset_names = {"model1", "model2", "model3"};
std::optional<Groom> make_preset(std::string_view name);

}  // namespace strandbake
