#include "sim/gusts.h"

#include <cmath>

namespace strandbake {
namespace {

// A random word for each key (the finaliser of splitmix64: Steele, Lea, Flood, OOPSLA 2014).
std::uint64_t hash(std::uint64_t key) {
  key += 0x9e3779b97f4a7c15u;
  key = (key ^ (key >> 30)) * 0xbf58476d1ce4e5b9u;
  key = (key ^ (key >> 27)) * 0x94d049bb133111ebu;
  return key ^ (key >> 31);
}

// In [0, 1), a multiple of 2^-24.
double unit_interval(std::uint64_t word) {
  return static_cast<double>(word >> 40) * 0x1p-24;
}

double lattice_noise(std::uint64_t cell, std::uint64_t channel) {
  return 2 * unit_interval(hash(hash(channel) ^ cell)) - 1;
}

}  // namespace

WindSample wind_at(const WindParams& params, double time) {
  const double speed = std::sqrt(params.velocity.squaredNorm());
  const double phase = time / params.period;
  const double cell = std::floor(phase);
  const double u = phase - cell;
  const double blend = u * u * u * (u * (u * 6 - 15) + 10);  // first and second derivatives vanish at 0 and 1
  const auto key = static_cast<std::uint64_t>(static_cast<std::int64_t>(cell));
  WindSample sample;
  for (std::uint64_t j = 0; j < sample.size(); ++j) {
    for (std::uint64_t axis = 0; axis < 3; ++axis) {
      const double from = lattice_noise(key, 3 * j + axis), to = lattice_noise(key + 1, 3 * j + axis);
      sample[j][static_cast<int>(axis)] =
          params.velocity[static_cast<int>(axis)] + speed * params.gust * (from + blend * (to - from));
    }
  }
  return sample;
}

std::array<double, 4> wind_weights(std::uint64_t strand) {
  std::array<double, 4> weight;
  double sum = 0;
  for (std::uint64_t j = 0; j < weight.size(); ++j) {
    weight[j] = 0x1p-24 + unit_interval(hash(4 * strand + j));
    sum += weight[j];
  }
  for (double& w : weight) w /= sum;
  return weight;
}

}  // namespace strandbake
