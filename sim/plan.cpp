#include "sim/plan.h"

namespace strandbake {

RegionPlan plan_region(std::span<const RegionParams> over_time, bool windy, bool skip_idle) {
  const RegionParams& first = over_time.front();
  RegionPlan plan;
  plan.simulated = first.simulate;
  plan.sag_free = first.simulate && first.sag_free;
  plan.local_method = first.local.method;
  plan.reacts = first.local.reaction && first.local.method != 3;
  plan.direct_lengths = first.lengths.direct;
  plan.edge_lengths = first.lengths.direct || first.lengths.iterations > 0;
  for (const RegionParams& params : over_time) {
    plan.wind |= (windy && params.drag > 0) || !skip_idle;
    plan.global_shape |= (params.global.stiffness > 0 || !skip_idle) && first.global.range > 0;
    plan.local_shape |= (params.local.stiffness > 0 || !skip_idle) && first.local.iterations > 0;
  }
  if (plan.global_shape) {
    plan.global_range = first.global.range;
    plan.global_fade = first.global.fade;
  }
  return plan;
}

}  // namespace strandbake
