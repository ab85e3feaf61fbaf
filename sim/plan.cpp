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
  plan.rod = first.is_rod();
  if (plan.rod) {
    const RodParams& rod = first.rod;
    const double shear = rod.shear > 0 ? rod.shear : rod.young / (2 * (1 + rod.poisson));
    // I / A = r^2 / 4, J / A = r^2 / 2.
    plan.rod_bend = rod.stiffness * rod.young * rod.radius * rod.radius / (4 * rod.density);
    plan.rod_twist = rod.stiffness * shear * rod.radius * rod.radius / (2 * rod.density);
    plan.rod_stretch = rod.exact_lengths ? 0 : rod.young / rod.density;
    plan.direct_lengths = plan.edge_lengths = plan.reacts = false;
  }
  for (const RegionParams& params : over_time) {
    plan.wind |= (windy && params.drag > 0) || !skip_idle;
    plan.global_shape |= (params.global.stiffness > 0 || !skip_idle) && first.global.range > 0;
    plan.local_shape |= !plan.rod && (params.local.stiffness > 0 || !skip_idle) && first.local.iterations > 0;
  }
  if (plan.global_shape) {
    plan.global_range = first.global.range;
    plan.global_fade = first.global.fade;
  }
  return plan;
}

}  // namespace strandbake
