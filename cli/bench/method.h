// The methods as reports have them: those of the local shape by their number, and the rod (samples/shots.h).
#pragma once

#include <string>

#include "cli/bench/report.h"
#include "samples/shots.h"

namespace strandbake {

inline Cell method_cell(int method) {
  return method == samples::kRod ? Cell("rod") : Cell(static_cast<double>(method));
}
inline std::string name_of(int method) {
  return method == samples::kRod ? "rod" : "method " + samples::name_of_method(method);
}

}  // namespace strandbake
