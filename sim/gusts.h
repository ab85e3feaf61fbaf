// Gusts: wind that varies smoothly in time, the same in every run.
#pragma once

#include <array>
#include <cstdint>

#include "sim/frame_input.h"
#include "sim/params.h"

namespace strandbake {

// The four winds at a time [s]: velocity + |velocity| gust n_j(t), where the noise n_j has components in [-1, 1], is
// twice differentiable and takes a new value every `period`. A function of its arguments alone, at any time.
WindSample wind_at(const WindParams& params, double time);

// How strand number `strand` of the groom blends the four: positive weights with sum 1.
std::array<double, 4> wind_weights(std::uint64_t strand);

}  // namespace strandbake
