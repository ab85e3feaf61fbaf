#include "sim/plan.h"

#include <catch2/catch.hpp>

using namespace strandbake;

TEST_CASE("the default parameters need every pass but the wind") {
  const std::vector<RegionParams> params(1);
  const RegionPlan plan = plan_region(params, false);
  CHECK_FALSE(plan.wind);
  CHECK(plan.global_shape);
  CHECK(plan.local_shape);
  CHECK(plan.edge_lengths);
  CHECK(plan.local_method == 1);
  CHECK(plan.global_range == RegionParams{}.global.range);
  CHECK(plan.global_fade == RegionParams{}.global.fade);
}

TEST_CASE("a pass is planned only where something can come of it") {
  std::vector<RegionParams> params(1);
  SECTION("wind needs air that moves and hair that it drags") {
    CHECK(plan_region(params, true).wind);
    params[0].drag = 0;
    CHECK_FALSE(plan_region(params, true).wind);
  }
  SECTION("the global shape needs stiffness and range") {
    params[0].global.stiffness = 0;
    CHECK_FALSE(plan_region(params, false).global_shape);
    CHECK(plan_region(params, false).global_range == 0);
    params[0].global = {0.5, 0, 1};
    CHECK_FALSE(plan_region(params, false).global_shape);
  }
  SECTION("the local shape needs stiffness and iterations") {
    params[0].local = {0, 3, 2};
    CHECK_FALSE(plan_region(params, false).local_shape);
    params[0].local = {0.5, 0, 2};
    CHECK_FALSE(plan_region(params, false).local_shape);
    params[0].local = {0.5, 1, 2};
    CHECK(plan_region(params, false).local_shape);
    CHECK(plan_region(params, false).local_method == 2);
  }
  SECTION("edge lengths need iterations") {
    params[0].lengths = LengthParams::iterated(0);
    CHECK_FALSE(plan_region(params, false).edge_lengths);
  }
}

TEST_CASE("one frame that needs a pass is enough") {
  std::vector<RegionParams> params(3);
  for (RegionParams& p : params) p.local.stiffness = p.global.stiffness = p.drag = 0;
  CHECK_FALSE(plan_region(params, true).local_shape);
  CHECK_FALSE(plan_region(params, true).global_shape);
  CHECK_FALSE(plan_region(params, true).wind);
  params[2].local.stiffness = 0.01;
  CHECK(plan_region(params, true).local_shape);
  params[1].global.stiffness = 0.01;
  CHECK(plan_region(params, true).global_shape);
  params[2].drag = 0.01;
  CHECK(plan_region(params, true).wind);
}
