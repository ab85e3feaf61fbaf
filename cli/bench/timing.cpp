#include "cli/bench/timing.h"

#include <algorithm>

namespace strandbake {

Timing timing_of(std::vector<double> samples) {
  std::sort(samples.begin(), samples.end());
  const std::size_t half = samples.size() / 2;
  const double median = samples.size() % 2 == 1 ? samples[half] : (samples[half - 1] + samples[half]) / 2;
  return {median, samples.front()};
}

std::vector<Timing> take_turns(const std::vector<Turn>& contenders, const Effort& effort) {
  std::vector<double> unused;
  for (const Turn& turn : contenders) turn(unused);
  std::vector<std::vector<double>> samples(contenders.size());
  const auto start = Clock::now();
  for (int round = 0; round < effort.rounds && (round < effort.fewest || seconds_since(start) < effort.seconds);
       ++round) {
    for (std::size_t c = 0; c < contenders.size(); ++c) contenders[c](samples[c]);
  }
  std::vector<Timing> timings;
  for (const auto& own : samples) timings.push_back(timing_of(own));
  return timings;
}

}  // namespace strandbake
