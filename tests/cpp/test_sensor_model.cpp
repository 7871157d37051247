// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/core/cubic_table.hpp"
#include "ndtree/core/simd.hpp"
#include "random.hpp"

namespace ndtree::test::test_sensor_model {
namespace {

double density(double x, double mean, double sigma) {
  const double z = (x - mean) / sigma;
  return std::exp(-0.5 * z * z) / (sigma * std::sqrt(2.0 * std::acos(-1.0)));
}

/// Simpson's rule over the obstacle's distance, where its density is not negligible.
double probability_of_obstacle_in(double from, double to, double range, double sigma) {
  from = std::max(from, range - 12.0 * sigma);
  to = std::min(to, range + 12.0 * sigma);
  if (!(from < to)) return 0.0;
  constexpr int kSteps = 2000;
  const double step = (to - from) / kSteps;
  double sum = density(from, range, sigma) + density(to, range, sigma);
  for (int i = 1; i < kSteps; ++i) sum += (i % 2 == 1 ? 4.0 : 2.0) * density(from + i * step, range, sigma);
  return sum * step / 3.0;
}

/// The derivation: 1 where the obstacle is inside the cell, 1/2 before it, 0 beyond.
double integrated(double entry, double exit, double range, double sigma) {
  return probability_of_obstacle_in(entry, exit, range, sigma) +
         0.5 * probability_of_obstacle_in(-1e9, entry, range, sigma);
}

TEST(SensorModel, IsTheIntegralOfItsDerivation) {
  Random random(33);
  for (int cases = 0; cases < 1000; ++cases) {
    const double range = random.uniform(0.5, 20.0);
    const double sigma = random.uniform(0.005, 0.2);
    const double entry = range + random.uniform(-6.0, 5.0) * sigma;
    const double exit = entry + random.uniform(0.01, random.chance(0.5) ? 1.0 : 10.0) * sigma;
    ASSERT_NEAR(BeamSensorModel::probability(entry, exit, range, sigma),
                integrated(entry, exit, range, sigma), 1e-10)
        << "cell [" << entry << ", " << exit << "], range " << range << ", sigma " << sigma;
  }
}

TEST(SensorModel, LogOddsAreClampedAndOtherwiseThoseOfTheProbability) {
  SensorOptions options;
  options.probability_min = 0.3;
  options.probability_max = 0.9;
  const BeamSensorModel model(options);
  const auto low = static_cast<float>(std::log(0.3 / 0.7));
  const auto high = static_cast<float>(std::log(0.9 / 0.1));
  EXPECT_EQ(model.log_odds_free(), low);
  Random random(35);
  int clamped_low = 0;
  int clamped_high = 0;
  int between = 0;
  for (int i = 0; i < 3000; ++i) {
    const double range = 5.0;
    const double sigma = 0.05;
    const double entry = range + random.uniform(-4.0, 4.0) * sigma;
    const double exit = entry + random.uniform(0.0, 6.0) * sigma;
    const double p = integrated(entry, exit, range, sigma);
    const float value =
        model.log_odds(BeamSensorModel::cdf(entry, range, sigma), BeamSensorModel::cdf(exit, range, sigma));
    ASSERT_GE(value, low);
    ASSERT_LE(value, high);
    if (p < 0.3 - 1e-9) {
      ASSERT_EQ(value, low);
      ++clamped_low;
    } else if (p > 0.9 + 1e-9) {
      ASSERT_EQ(value, high);
      ++clamped_high;
    } else if (p > 0.3 + 1e-9 && p < 0.9 - 1e-9) {
      ASSERT_NEAR(value, std::log(p / (1.0 - p)), 1e-6);
      ++between;
    }
  }
  EXPECT_GT(clamped_low, 300);
  EXPECT_GT(clamped_high, 100);
  EXPECT_GT(between, 300);
}

TEST(SensorModel, ClearlyFreeCellsReallyGetTheLeastProbability) {
  Random random(36);
  int beyond = 0;
  for (int cases = 0; cases < 5000; ++cases) {
    SensorOptions options;
    options.probability_min = random.uniform(0.01, 0.49);
    const BeamSensorModel model(options);
    const double range = random.uniform(0.1, 30.0);
    const double sigma = random.uniform(0.005, 0.3);
    const double until = model.clearly_free_until(range, sigma);
    ASSERT_LT(until, range);
    const double exit = cases % 4 == 0   ? std::nextafter(until, -1.0)
                        : cases % 4 == 1 ? until - random.uniform(0.0, 3.0) * sigma
                                         : until + random.uniform(0.0, 1.0) * sigma;
    const double entry = exit - random.uniform(0.0, 3.0) * sigma;
    const float value =
        model.log_odds(BeamSensorModel::cdf(entry, range, sigma), BeamSensorModel::cdf(exit, range, sigma));
    if (exit < until) {
      ASSERT_EQ(value, model.log_odds_free());
    } else if (exit - until > 1e-9) {
      // The bound is tight: a cell that began long before would get more.
      ASSERT_GT(model.log_odds(0.0, BeamSensorModel::cdf(exit, range, sigma)), model.log_odds_free());
      ++beyond;
    }
  }
  EXPECT_GT(beyond, 1000);
}

TEST(SensorModel, SigmaGrowsWithTheSquaredRange) {
  SensorOptions options;
  options.range_sigma = 0.01;
  options.range_sigma_quadratic = 0.002;
  EXPECT_DOUBLE_EQ(BeamSensorModel(options).sigma(0.0), 0.01);
  EXPECT_DOUBLE_EQ(BeamSensorModel(options).sigma(1.0), 0.012);
  EXPECT_DOUBLE_EQ(BeamSensorModel(options).sigma(5.0), 0.06);
  EXPECT_DOUBLE_EQ(BeamSensorModel(SensorOptions{}).sigma(5.0), SensorOptions{}.range_sigma);
  EXPECT_EQ(BeamSensorModel::kReachSigmas, 3.0);
}

TEST(BeamSensorModel, QuicklySaysTheSame) {
  Random random(76);
  for (const double least : {0.05, 0.4, 0.49})
    for (const double most : {0.51, 0.7, 0.95}) {
      SensorOptions options;
      options.probability_min = least;
      options.probability_max = most;
      const BeamSensorModel model(options);
      for (int i = 0; i < 1000; ++i) {
        const double entry = random.uniform(-8.0, 4.0);
        const double exit = entry + random.uniform(0.0, 4.0);
        ASSERT_NEAR(model.quick_log_odds(static_cast<float>(entry), static_cast<float>(exit)),
                    model.log_odds(normal_cdf(entry), normal_cdf(exit)), 1e-3f);
      }
    }
}

TEST(CubicTable, IsWithinItsError) {
  int places = 0;
  const CubicTable sine(3.0, [](double x) { return std::sin(x); });
  const double step = 3.0 / 8.0;
  const double error = step * step * step * step / 1536.0 + 2e-7;
  for (double x = 0.0; x < 3.0; x += 0.0037, ++places)
    ASSERT_NEAR(static_cast<double>(sine(static_cast<float>(x))), std::sin(x), error) << x;
  EXPECT_GT(places, 800);
  // Parts share their ends.
  for (int part = 0; part <= 8; ++part) {
    const auto end = static_cast<float>(part * step);
    EXPECT_NEAR(sine(std::nextafter(end, 0.0f)), sine(end), 5e-7f) << part;
    EXPECT_NEAR(static_cast<double>(sine(end)), std::sin(part * step), 2e-7) << part;
  }
  const CubicTable cubic(2.0, [](double x) { return ((x - 2.0) * x + 3.0) * x - 4.0; });
  for (const float x : {0.0f, 0.3f, 1.0f, 1.7f, 2.0f})
    EXPECT_NEAR(cubic(x), ((x - 2.0f) * x + 3.0f) * x - 4.0f, 2e-6f) << x;
  for (const float x : {2.1f, 1e6f, std::numeric_limits<float>::infinity(), std::nanf("")})
    EXPECT_EQ(cubic(x), cubic(2.0f)) << x;
}

#ifdef NDTREE_HAS_EIGHTS
using Eight = std::array<float, 8>;
NDTREE_BY_EIGHTS Eight of_eight(const CubicTable& table, const Eight& x) {
  Eight result;
  table(EightFloats::load(x.data())).store(result.data());
  return result;
}
NDTREE_BY_EIGHTS Eight of_eight(const BeamSensorModel& model, const Eight& entry, const Eight& exit) {
  Eight result;
  model.quick_log_odds(EightFloats::load(entry.data()), EightFloats::load(exit.data())).store(result.data());
  return result;
}

TEST(CubicTable, OfEightIsThatOfEach) {
  if (Simd::width() < 8) GTEST_SKIP() << "no vectors of eight floats here";
  Random random(77);
  const CubicTable sine(3.0, [](double x) { return std::sin(x); });
  SensorOptions options;
  options.probability_min = 0.2;
  const BeamSensorModel model(options);
  for (int i = 0; i < 20'000; ++i) {
    Eight entry;
    Eight exit;
    Eight x;
    for (std::size_t k = 0; k < 8; ++k) {
      entry[k] = static_cast<float>(random.uniform(-8.0, 6.0));
      exit[k] = entry[k] + static_cast<float>(random.uniform(0.0, 4.0));
      x[k] = k == 0 ? 0.0f : std::abs(entry[k]);
    }
    const Eight sines = of_eight(sine, x);
    const Eight log_odds = of_eight(model, entry, exit);
    for (std::size_t k = 0; k < 8; ++k) {
      ASSERT_EQ(sines[k], sine(x[k])) << x[k];
      ASSERT_EQ(log_odds[k], model.quick_log_odds(entry[k], exit[k])) << entry[k] << " to " << exit[k];
    }
  }
  const float nan = std::nanf("");
  EXPECT_EQ(of_eight(sine, {nan, 1e9f, 3.0f})[0], sine(nan));
}
#endif

}  // namespace
}  // namespace ndtree::test::test_sensor_model
