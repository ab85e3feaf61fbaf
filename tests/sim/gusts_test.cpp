#include "sim/gusts.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <set>

using namespace strandbake;

namespace {

const WindParams kBreeze = {{3, 0, 4}, 0.4, 0.5};  // a speed of 5, gusts of up to 2

}  // namespace

TEST_CASE("without gusts all four winds are the mean, at any time") {
  for (const double time : {-2.0, 0.0, 0.3, 1e6}) {
    for (const Eigen::Vector3d& v : wind_at({{1, -2, 3}, 0, 0.7}, time)) CHECK(v == Eigen::Vector3d(1, -2, 3));
  }
}

TEST_CASE("no gust goes further than its share of the speed, and some go far") {
  double farthest = 0;
  Eigen::Vector3d sum(0, 0, 0);
  int samples = 0;
  for (int k = -2000; k < 8000; ++k) {
    for (const Eigen::Vector3d& v : wind_at(kBreeze, 0.037 * k)) {
      const Eigen::Vector3d off = v - kBreeze.velocity;
      REQUIRE(off.cwiseAbs().maxCoeff() <= 2 + 1e-12);
      farthest = std::max(farthest, off.cwiseAbs().maxCoeff());
      sum += off;
      ++samples;
    }
  }
  CHECK(farthest > 1.95);
  // About 740 independent values for each of four winds, each with a deviation of at most 2 / sqrt(3).
  CHECK((sum / samples).norm() < 5 * 2 / std::sqrt(3 * 740 * 4) * std::sqrt(3));
}

TEST_CASE("gusts are smooth, across the borders of their cells too") {
  // Noise between two values at most 4 apart in a period of 0.5 s: the slope of the blend is at most 15/8, its second
  // derivative at most 10 / sqrt(3).
  const double most_slope = 4 * 1.875 / 0.5, most_curvature = 4 * 5.7735 / 0.25, dt = 1e-4;
  double steepest = 0;
  for (int k = 0; k < 20000; ++k) {
    const double time =
        k % 2 == 0 ? 0.5 * (k / 2 % 100) + dt * (k % 17 - 8) : 0.00213 * k;  // half of them around borders
    const WindSample before = wind_at(kBreeze, time - dt), at = wind_at(kBreeze, time),
                     after = wind_at(kBreeze, time + dt);
    for (std::size_t j = 0; j < 4; ++j) {
      const double slope = (after[j] - before[j]).cwiseAbs().maxCoeff() / (2 * dt);
      steepest = std::max(steepest, slope);
      REQUIRE(slope <= most_slope * 1.001);
      REQUIRE((after[j] - 2 * at[j] + before[j]).cwiseAbs().maxCoeff() / (dt * dt) <= most_curvature * 1.01);
    }
  }
  CHECK(steepest > most_slope / 2);
}

TEST_CASE("the four winds and the three axes differ, and a new period brings a new value") {
  std::set<double> values;
  for (int cell = 0; cell < 50; ++cell) {
    for (const Eigen::Vector3d& v : wind_at(kBreeze, 0.5 * cell)) {
      for (int axis = 0; axis < 3; ++axis) values.insert(v[axis] - kBreeze.velocity[axis]);
    }
  }
  CHECK(values.size() > 590);  // of 600 draws from 2^24
}

TEST_CASE("a gust is the same in every run and on every machine") {
  const WindSample now = wind_at(kBreeze, 1.3), before = wind_at(kBreeze, -7.77);
  CHECK(now[0] == Eigen::Vector3d(0x1.0d0f10493c89fp+2, 0x1.7fc306262cba2p-2, 0x1.2b891d8cbd124p+2));
  CHECK(now[3] == Eigen::Vector3d(0x1.77cdcb119ce08p+1, 0x1.88bcc458cd218p-2, 0x1.19d940e1c5826p+2));
  CHECK(before[1] == Eigen::Vector3d(0x1.1d9e8c9cd31e4p+1, -0x1.95737215602cp-5, 0x1.5608cbf4a9a2cp+2));
}

TEST_CASE("the weights of a strand are positive and sum to one") {
  double sum[4] = {0, 0, 0, 0};
  for (std::uint64_t strand = 0; strand < 10000; ++strand) {
    const auto weight = wind_weights(strand);
    double total = 0;
    for (std::size_t j = 0; j < 4; ++j) {
      REQUIRE(weight[j] > 0);
      total += weight[j];
      sum[j] += weight[j];
    }
    REQUIRE(total == Approx(1).epsilon(1e-15));
  }
  for (const double s : sum) CHECK(s / 10000 == Approx(0.25).margin(0.01));
  CHECK(wind_weights(0) != wind_weights(1));
  CHECK(wind_weights(std::uint64_t{1} << 40) != wind_weights(0));
}

TEST_CASE("the weights of a strand are the same in every run and on every machine") {
  const auto weight = wind_weights(12345);
  CHECK(weight[0] == 0x1.fdfcefb7839e5p-7);
  CHECK(weight[1] == 0x1.507b0d88e31f8p-2);
  CHECK(weight[2] == 0x1.92633e56b8a76p-3);
  CHECK(weight[3] == 0x1.d6636bce046fep-2);
}
