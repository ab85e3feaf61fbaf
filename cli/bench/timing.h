// Times of things that are compared: they take turns in one run, so that what else the machine does hits all alike.
#pragma once

#include <chrono>
#include <functional>
#include <vector>

namespace strandbake {

using Clock = std::chrono::steady_clock;
inline double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

struct Timing {  // [s]
  double median = 0;
  double best = 0;
};
// Of at least one sample.
Timing timing_of(std::vector<double> samples);

// How long a comparison may take: `rounds` turns for everyone, fewer once `seconds` are over, but never below `fewest`.
struct Effort {
  int rounds;
  double seconds;
  int fewest = 3;
};

// One turn of one contender: appends what it measured [s].
using Turn = std::function<void(std::vector<double>& samples)>;

// A turn for each that does not count, then rounds of A B C, A B C, ... Each appends at least one sample a round.
std::vector<Timing> take_turns(const std::vector<Turn>& contenders, const Effort& effort);

}  // namespace strandbake
