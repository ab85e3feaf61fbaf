// The plan of a bake, in words and for scripts.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <utility>

#include "cli/backend.h"
#include "formats/shot.h"

namespace strandbake {

// What each region runs and what it skips and why, one line each, then frames, memory and disk. `written`:
// first and last frame that the cache will hold.
std::string describe_plan(const Shot& shot, std::pair<int, int> written, const Backend& backend, int threads);
// The same as `plan` of docs/schemas/check.json.
nlohmann::ordered_json plan_json(const Shot& shot, std::pair<int, int> written, const Backend& backend, int threads);

}  // namespace strandbake
