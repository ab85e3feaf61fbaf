// This program run as a process of its own, with what it took.
#pragma once

#include <string>
#include <vector>

namespace strandbake {

struct ChildRun {
  double seconds = 0;        // from its start to its end, as its parent sees it
  double before_frames = 0;  // from its start to its event "start": what goes before the first frame
  double user = 0;           // [s] of all its threads
  double system = 0;         // [s]
  double peak_bytes = 0;     // largest resident memory. Not below that of this process at the time, so start early
};

// Runs this program with these arguments; reads its events where --json is among them. Throws std::runtime_error where
// it does not end with 0.
ChildRun run_child(const std::vector<std::string>& arguments);

}  // namespace strandbake
