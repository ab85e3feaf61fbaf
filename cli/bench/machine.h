// What a figure was measured on.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace strandbake {

// Name and value, in the order to print: program and commit, processor, cores, caches, memory, lanes, compiler, flags.
// No host name and no date, so the same machine gives the same words.
std::vector<std::pair<std::string, std::string>> describe_machine();

}  // namespace strandbake
