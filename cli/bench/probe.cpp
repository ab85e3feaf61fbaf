#include "cli/bench/probe.h"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <functional>
#include <memory>
#include <new>

#include "cli/bench/probe_kernels.h"
#include "cli/bench/timing.h"

namespace strandbake {
namespace {

constexpr std::size_t kAlignment = 64;
constexpr double kMebibyte = 1 << 20;

const ProbeKernels& widest_kernels() {
#ifdef STRANDBAKE_X86
  const int widest = available_lanes().back();
  if (widest == kProbeAvx512.lanes) return kProbeAvx512;
  if (widest == kProbeAvx2.lanes) return kProbeAvx2;
#endif
  return kProbeSse2;
}

volatile double sink;  // what is computed must be used

// What all threads do a second of `work(thread, rounds)`, which does rounds * amount of it. They run beside each other
// and each counts its own best, so that a thread that had to wait for its core spoils nothing.
double rate_of(int threads, int repetitions, double amount, const std::function<void(int thread, long rounds)>& work) {
  constexpr double kLongEnough = 5e-4;
  double sum = 0;
#pragma omp parallel num_threads(threads) reduction(+ : sum)
  {
    const int thread = omp_get_thread_num();
    double best = 0;
    long rounds = 1;
    for (int repetition = 0; repetition < repetitions;) {
      const auto start = Clock::now();
      work(thread, rounds);
      const double done = static_cast<double>(rounds) * amount;
      best = std::max(best, done / seconds_since(start));
      if (done / best < kLongEnough) {
        rounds *= 2;
      } else {
        ++repetition;
      }
    }
    sum += best;
  }
  return sum;
}

Arithmetic measure_arithmetic(const ArithmeticKernels& kernels, int threads, int repetitions) {
  const auto peak = [&](ArithmeticLoop loop) {
    return rate_of(threads, repetitions, kernels.operations, [loop](int, long rounds) { sink = loop(rounds, 1, 0); });
  };
  return {peak(kernels.multiply_add), peak(kernels.divide), peak(kernels.root)};
}

struct AlignedDelete {
  void operator()(float* p) const { ::operator delete (p, std::align_val_t{kAlignment}); }
};

// Four arrays a thread, each thread's touched first by itself.
class Streams {
 public:
  Streams(int threads, std::size_t count) : count_(count) {
    chunks_.resize(static_cast<std::size_t>(threads));
#pragma omp parallel num_threads(threads)
    {
      const std::size_t bytes = 4 * count * sizeof(float);
      auto* p = static_cast<float*>(::operator new (bytes, std::align_val_t{kAlignment}));
      std::memset(p, 0, bytes);
      chunks_[static_cast<std::size_t>(omp_get_thread_num())].reset(p);
    }
  }
  float* array(int thread, int index) const {
    return chunks_[static_cast<std::size_t>(thread)].get() + static_cast<std::size_t>(index) * count_;
  }

 private:
  std::size_t count_;
  std::vector<std::unique_ptr<float[], AlignedDelete>> chunks_;
};

}  // namespace

double Probes::bandwidth(double working_set) const {
  if (working_set <= update.front().first) return update.front().second;
  for (std::size_t i = 1; i < update.size(); ++i) {
    if (working_set > update[i].first) continue;
    const double from = std::log(update[i - 1].first), to = std::log(update[i].first);
    const double u = (std::log(working_set) - from) / (to - from);
    return std::exp((1 - u) * std::log(update[i - 1].second) + u * std::log(update[i].second));
  }
  return update.back().second;
}

Probes measure_probes(int threads, bool quick) {
  const ProbeKernels& kernels = widest_kernels();
  const int repetitions = quick ? 9 : 31;
  Probes probes;
  probes.threads = threads;
  probes.lanes = kernels.lanes;
  probes.single_precision = measure_arithmetic(kernels.single_precision, threads, repetitions);
  probes.double_precision = measure_arithmetic(kernels.double_precision, threads, repetitions);
  const double largest = 256 * kMebibyte;
  for (double size = kMebibyte / 4; size <= largest; size *= quick ? 4 : 2) {
    // Of one of four arrays of one thread; whole cache lines.
    const std::size_t count = std::max<std::size_t>(static_cast<std::size_t>(size / threads / 16) / 16 * 16, 16);
    const Streams streams(threads, count);
    const auto chunk = static_cast<double>(count * sizeof(float));
    probes.update.emplace_back(size, rate_of(threads, repetitions, 5 * chunk, [&](int thread, long rounds) {
                                 for (long round = 0; round < rounds; ++round) {
                                   kernels.update(streams.array(thread, 0), streams.array(thread, 1),
                                                  streams.array(thread, 2), streams.array(thread, 3), count);
                                 }
                               }));
    if (size == largest) {
      probes.triad = rate_of(threads, repetitions, 3 * chunk, [&](int thread, long rounds) {
        for (long round = 0; round < rounds; ++round) {
          kernels.triad(streams.array(thread, 0), streams.array(thread, 1), streams.array(thread, 2), count);
        }
      });
    }
  }
  return probes;
}

}  // namespace strandbake
