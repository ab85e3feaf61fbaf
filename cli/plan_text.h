// The plan of a bake in words.
#pragma once

#include <string>

#include "formats/shot.h"

namespace strandbake {

// What each region runs and what it skips and why, one line each, then frames, memory and disk. `state_bytes`: the
// solver's.
std::string describe_plan(const Shot& shot, std::size_t state_bytes, int threads);

}  // namespace strandbake
