#include "formats/procedural.h"

#include <Eigen/Core>
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>

using namespace strandbake;

namespace {

// FNV-1a over the bits of every position and root UV.
std::uint64_t hash_of(const Groom& groom) {
  std::uint64_t hash = 0xcbf29ce484222325;
  const auto add = [&](float value) {
    unsigned char bytes[sizeof(value)];
    std::memcpy(bytes, &value, sizeof(value));
    for (const unsigned char byte : bytes) hash = (hash ^ byte) * 0x100000001b3;
  };
  for (const Eigen::Vector3d& p : groom.position) {
    for (const double x : p) add(static_cast<float>(x));
  }
  for (const Eigen::Vector2f& uv : groom.root_uv) {
    for (const float x : uv) add(x);
  }
  return hash;
}

ProceduralParams small(std::string_view style) {
  ProceduralParams params = style_defaults(style);
  params.strands = 200;
  return params;
}

// What every groom of these parameters has to be. Positions are rounded to float32: half a unit in the last place of a
// coordinate below 4 m is 1.2e-7 m, which moves a segment by at most 2 sqrt(3) times as much.
void check_groom(const Groom& groom, double longest, double length_variation) {
  const double rounding = 2 * std::sqrt(3.) * 1.2e-7;
  REQUIRE(groom.root_uv.size() == groom.strand_count());
  CHECK(groom.pinned.empty());
  CHECK(groom.region.empty());
  std::size_t faults = 0;
  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    const Eigen::Vector3d root = groom.position[groom.offset[strand]];
    if (std::abs(root.norm() - head_radius) > 1e-6) ++faults;
    if (root.z() > 0.08) ++faults;  // the face
    const auto segments = static_cast<double>(groom.vertex_count(strand) - 1);
    double total = 0, shortest_segment = 1e9, longest_segment = 0;
    for (std::size_t v = groom.offset[strand] + 1; v < groom.offset[strand + 1]; ++v) {
      const double segment = (groom.position[v] - groom.position[v - 1]).norm();
      total += segment;
      shortest_segment = std::min(shortest_segment, segment);
      longest_segment = std::max(longest_segment, segment);
    }
    if (!(longest_segment - shortest_segment <= 2 * rounding)) ++faults;
    if (!(total <= longest + segments * rounding)) ++faults;
    if (!(total >= longest * (1 - length_variation) - segments * rounding)) ++faults;
    const Eigen::Vector2f uv = groom.root_uv[strand];
    if (!(uv.minCoeff() >= 0 && uv.maxCoeff() <= 1)) ++faults;
  }
  CHECK(faults == 0);
  const auto inside = [](const Eigen::Vector3d& p) { return !(p.norm() >= head_radius); };
  CHECK(std::count_if(groom.position.begin(), groom.position.end(), inside) == 0);
}

}  // namespace

TEST_CASE("each style makes equal segments of the length asked for, outside the head") {
  for (const char* style : {"straight", "wavy", "curly", "ponytail", "fur"}) {
    INFO(style);
    const ProceduralParams params = small(style);
    const Groom groom = make_groom(params);
    CHECK(groom.strand_count() == 200);
    CHECK(groom.vertex_count() == 200 * static_cast<std::size_t>(params.vertices));
    check_groom(groom, params.length, params.length_variation);
  }
}

TEST_CASE("parameters at the ends of their ranges still make a groom") {
  for (const char* style : {"straight", "wavy", "curly", "ponytail", "fur"}) {
    for (const double length : {0.001, 2.}) {
      for (const double extreme : {0., 1.}) {
        for (const int vertices : {2, 400}) {
          ProceduralParams params = style_defaults(style);
          params.strands = 81;
          params.vertices = vertices;
          params.length = length;
          params.length_variation = 0.9 * extreme;
          params.curl_radius = 0.1 * extreme;
          params.curl_turns = 200 * extreme;
          params.clump = extreme;
          INFO(style << ", " << length << " m, " << vertices << " vertices, extreme " << extreme);
          check_groom(make_groom(params), length, params.length_variation);
        }
      }
    }
  }
  ProceduralParams one;
  one.strands = 1;
  one.vertices = 10'000;
  check_groom(make_groom(one), one.length, one.length_variation);
}

TEST_CASE("hair hangs below its roots and leaves the face free") {
  for (const char* style : {"straight", "wavy", "curly", "ponytail"}) {
    INFO(style);
    const Groom groom = make_groom(small(style));
    std::size_t hanging = 0, over_face = 0;
    for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
      const Eigen::Vector3d tip = groom.position[groom.offset[strand + 1] - 1];
      hanging += tip.y() < groom.position[groom.offset[strand]].y() - 0.02;
      for (std::size_t v = groom.offset[strand]; v < groom.offset[strand + 1]; ++v) {
        const Eigen::Vector3d& p = groom.position[v];
        over_face += p.z() > 0.06 && p.y() < 0.02;
      }
    }
    CHECK(hanging == groom.strand_count());
    CHECK(over_face == 0);
  }
}

TEST_CASE("curly hair curls and straight hair does not") {
  // The turn from segment to segment, summed along the strands and averaged.
  const auto mean_turning = [](const Groom& groom) {
    double sum = 0;
    for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
      for (std::size_t v = groom.offset[strand] + 1; v + 1 < groom.offset[strand + 1]; ++v) {
        const Eigen::Vector3d a = groom.position[v] - groom.position[v - 1];
        const Eigen::Vector3d b = groom.position[v + 1] - groom.position[v];
        sum += std::acos(std::clamp(a.normalized().dot(b.normalized()), -1., 1.));
      }
    }
    return sum / static_cast<double>(groom.strand_count());
  };
  // Down the head at most half a circle and some; a helix of six turns at 45 degrees more than six times as much.
  CHECK(mean_turning(make_groom(small("straight"))) < 4);
  CHECK(mean_turning(make_groom(small("curly"))) > 15);
}

TEST_CASE("the same seed makes the same bytes on every machine, another seed other hair") {
  const struct {
    const char* style;
    std::uint64_t hash;
  } cases[] = {{"straight", 0xa856958197d0b6ae},
               {"wavy", 0x10cfa65954734e08},
               {"curly", 0x7bd50de8b42e93dd},
               {"ponytail", 0xd4bb91be694decb8},
               {"fur", 0x4e393f1b67404b78}};
  for (const auto& [style, hash] : cases) {
    INFO(style);
    ProceduralParams params = small(style);
    CHECK(hash_of(make_groom(params)) == hash);
    params.seed = 2;
    CHECK(hash_of(make_groom(params)) != hash);
  }
}

TEST_CASE("the presets have exactly the sizes of the paper's models and the same bytes everywhere") {
  const struct {
    const char* name;
    std::size_t strands, vertices;
    double length;
    std::uint64_t hash;
  } cases[] = {{"model1", 19'776, 221'078, 0.4, 0x066c7d224089cd82},
               {"model2", 20'000, 259'993, 0.25, 0x656784aa73fa5cc5},
               {"model3", 20'000, 1'373'047, 0.35, 0x73ce505d863652bd}};
  for (const auto& [name, strands, vertices, length, hash] : cases) {
    INFO(name);
    const std::optional<Groom> groom = make_preset(name);
    REQUIRE(groom);
    CHECK(groom->strand_count() == strands);
    CHECK(groom->vertex_count() == vertices);
    CHECK(groom->offset.back() == vertices);
    check_groom(*groom, length, 0.1);
    CHECK(hash_of(*groom) == hash);
  }
  CHECK(!make_preset("model4"));
  CHECK(preset_names.size() == std::size(cases));
}

TEST_CASE("positions are float32 numbers, so .hair holds them exactly") {
  for (const Eigen::Vector3d& p : make_groom(small("wavy")).position) REQUIRE(p == p.cast<float>().cast<double>());
}

TEST_CASE("parameters out of range are refused by name") {
  const auto refused = [](auto change, const char* word) {
    ProceduralParams params;
    change(params);
    CHECK_THROWS_AS(make_groom(params), InputError);
    CHECK_THROWS_WITH(make_groom(params), Catch::Contains(word));
  };
  refused([](ProceduralParams& p) { p.style = "bald"; }, "bald");
  refused([](ProceduralParams& p) { p.strands = 0; }, "strands");
  refused([](ProceduralParams& p) { p.vertices = 1; }, "vertices");
  refused([](ProceduralParams& p) { p.length = std::nan(""); }, "length");
  refused([](ProceduralParams& p) { p.length_variation = 1; }, "length_variation");
  refused([](ProceduralParams& p) { p.curl_radius = -1; }, "curl_radius");
  refused([](ProceduralParams& p) { p.curl_turns = 1e9; }, "curl_turns");
  refused([](ProceduralParams& p) { p.clump = 1.5; }, "clump");
  refused([](ProceduralParams& p) { p.strands = 10'000'000, p.vertices = 10'000; }, ".hair");
  CHECK_THROWS_AS(style_defaults("bald"), InputError);
}
