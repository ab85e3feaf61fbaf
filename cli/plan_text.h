// The plan of a bake in words.
#pragma once

#include <string>
#include <utility>

#include "cli/backend.h"
#include "formats/shot.h"

namespace strandbake {

// What each region runs and what it skips and why, one line each, then frames, memory and disk. `written`:
// first and last frame that the cache will hold.
std::string describe_plan(const Shot& shot, std::pair<int, int> written, const Backend& backend, int threads);

}  // namespace strandbake
