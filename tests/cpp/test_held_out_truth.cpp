// SPDX-License-Identifier: BSD-3-Clause
// Held-out truth: counts on hand-made maps whose every answer is known, and on a real map.

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "ndtree/evaluation/held_out_truth.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "refusals.hpp"

namespace elsewhere {

/// A map of another house: all is free before `wall` on the x axis, occupied from there up to `back`, unknown
/// behind.
struct Wall {
  double wall = 0.0;
  double back = 0.0;
};

ndtree::CellState state(const Wall& map, const ndtree::Vector<2>& point) {
  return point.x() < map.wall   ? ndtree::CellState::free
         : point.x() < map.back ? ndtree::CellState::occupied
                                : ndtree::CellState::unknown;
}

double probability(const Wall& map, const ndtree::Vector<2>& point) {
  return point.x() < map.wall ? 0.1 : point.x() < map.back ? 0.999 : 0.5;
}

bool occupied_within(const Wall& map, const ndtree::Vector<2>& point, double radius) {
  return point.x() >= map.wall - radius && point.x() <= map.back + radius;
}

/// The surface is 3 cm inside.
std::optional<double> cast_ray(const Wall& map, const ndtree::Vector<2>& origin,
                               const ndtree::Vector<2>& direction, double max_range, ndtree::RayAim aim) {
  const double distance = (map.wall - origin.x()) / direction.normalized().x();
  if (!(distance >= 0.0 && distance <= max_range)) return std::nullopt;
  return distance + (aim == ndtree::RayAim::surface ? 0.03 : 0.0);
}

}  // namespace elsewhere

namespace ndtree::test::test_held_out_truth {
namespace {

Scan<2> beams_along_x(const std::vector<double>& ranges) {
  Scan<2> scan;
  scan.origins = Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, static_cast<Eigen::Index>(ranges.size()));
  for (std::size_t i = 0; i < ranges.size(); ++i)
    scan.endpoints.col(static_cast<Eigen::Index>(i)) << ranges[i], 0.0;
  return scan;
}

struct WallCase {
  const char* what;
  elsewhere::Wall map;
  double range;
  std::uint64_t free, occupied, unknown;
  bool near, within;
  double error;
};

// Samples of a beam of 1.05 m: 0.1, 0.2, ... 0.9 m; of one of 0.25 m: 0.1 m; of one of 0.15 m: none.
const WallCase kWallCases[] = {
    {"wall where it was measured", {1.05, 2.0}, 1.05, 9, 0, 0, true, true, 0.0},
    {"wall 9 cm behind", {1.14, 2.0}, 1.05, 9, 0, 0, false, true, 0.09},
    {"wall 4 cm behind", {1.09, 2.0}, 1.05, 9, 0, 0, true, true, 0.04},
    {"wall 11 cm behind", {1.16, 2.0}, 1.05, 9, 0, 0, false, false, 0.11},
    {"wall 50 cm before", {0.55, 2.0}, 1.05, 5, 4, 0, true, false, 0.5},
    {"thin wall before, nothing known behind", {0.55, 0.75}, 1.05, 5, 2, 2, false, false, 0.5},
    {"wall just in reach of the cast", {11.0, 12.0}, 1.05, 9, 0, 0, false, false, 9.95},
    {"wall out of reach of the cast", {11.1, 12.0}, 1.05, 9, 0, 0, false, false, HUGE_VAL},
    {"short beam", {0.25, 1.0}, 0.25, 1, 0, 0, true, true, 0.0},
    {"beam without room for a sample", {0.15, 1.0}, 0.15, 0, 0, 0, true, true, 0.0},
};

TEST(HeldOutTruth, CountsOneBeamAgainstAWall) {
  for (const WallCase& c : kWallCases) {
    SCOPED_TRACE(c.what);
    HeldOutTruth truth;
    evaluate(c.map, beams_along_x({c.range}).view(), kUnlimitedRange, truth);
    EXPECT_EQ(truth.free, c.free);
    EXPECT_EQ(truth.occupied, c.occupied);
    EXPECT_EQ(truth.unknown, c.unknown);
    EXPECT_EQ(truth.endpoints, 1u);
    EXPECT_EQ(truth.endpoints_near, c.near ? 1u : 0u);
    EXPECT_EQ(truth.casts(), 1u);
    EXPECT_EQ(truth.casts_within, c.within ? 1u : 0u);
    EXPECT_NEAR(truth.free_log_likelihood,
                static_cast<double>(c.free) * std::log(0.9) +
                    static_cast<double>(c.occupied) * std::log(0.02) +
                    static_cast<double>(c.unknown) * std::log(0.5),
                1e-12);
    EXPECT_NEAR(truth.endpoint_log_likelihood,
                std::log(c.range < c.map.wall   ? 0.1
                         : c.range < c.map.back ? 0.98
                                                : 0.5),
                1e-12);
    ASSERT_EQ(truth.log_score().has_value(), truth.samples() > 0);
    ASSERT_EQ(truth.balanced_accuracy().has_value(), truth.samples() > 0);
    if (const auto samples = static_cast<double>(truth.samples()); samples > 0.0) {
      EXPECT_NEAR(*truth.log_score(),
                  0.5 * (truth.free_log_likelihood / samples + truth.endpoint_log_likelihood), 1e-12);
      EXPECT_NEAR(*truth.balanced_accuracy(),
                  0.5 * (static_cast<double>(c.free) / samples + (c.near ? 1.0 : 0.0)), 1e-12);
    }
    if (std::isinf(c.error))
      EXPECT_EQ(truth.median_cast_error(), c.error);
    else
      EXPECT_NEAR(truth.median_cast_error().value(), c.error, 1e-12);
    const double surface = std::abs(c.map.wall + 0.03 - c.range);
    EXPECT_EQ(truth.surfaces_within, !std::isinf(c.error) && surface <= 0.10 ? 1u : 0u);
    EXPECT_EQ(truth.surface_errors.size(), 1u);
    if (std::isinf(c.error))
      EXPECT_EQ(truth.median_surface_error(), c.error);
    else
      EXPECT_NEAR(truth.median_surface_error().value(), surface, 1e-12);
  }
}

TEST(HeldOutTruth, AsksOnlyAboutBeamsThatReturnedFromWithinRange) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  Scan<2> scan = beams_along_x({1.05, 1.05, 3.0, 0.0, kNan});
  scan.returned.setConstant(5, true);
  scan.returned[1] = false;
  HeldOutTruth truth;
  evaluate(elsewhere::Wall{1.05, 2.0}, scan.view(), 2.0, truth);
  EXPECT_EQ(truth.endpoints, 1u);
  EXPECT_EQ(truth.casts(), 1u);
  EXPECT_EQ(truth.samples(), 9u);
  evaluate(elsewhere::Wall{1.05, 2.0}, scan.view(), 3.0, truth);
  EXPECT_EQ(truth.endpoints, 3u) << "a beam as long as max_range counts";
}

TEST(HeldOutTruth, AddingEqualsEvaluatingTogether) {
  const elsewhere::Wall map{0.8, 0.95};
  const std::vector<double> ranges{0.33, 0.97, 1.52, 0.84, 2.41};
  HeldOutTruth together;
  evaluate(map, beams_along_x(ranges).view(), kUnlimitedRange, together);
  HeldOutTruth sum;
  for (const double range : ranges) {
    HeldOutTruth one;
    evaluate(map, beams_along_x({range}).view(), kUnlimitedRange, one);
    sum.add(one);
  }
  EXPECT_EQ(sum.free, together.free);
  EXPECT_EQ(sum.occupied, together.occupied);
  EXPECT_EQ(sum.unknown, together.unknown);
  EXPECT_EQ(sum.endpoints, together.endpoints);
  EXPECT_EQ(sum.endpoints_near, together.endpoints_near);
  EXPECT_EQ(sum.casts_within, together.casts_within);
  EXPECT_EQ(sum.cast_errors, together.cast_errors);
  EXPECT_NEAR(sum.free_log_likelihood, together.free_log_likelihood, 1e-12);
  EXPECT_NEAR(sum.endpoint_log_likelihood, together.endpoint_log_likelihood, 1e-12);
  EXPECT_LT(together.free_log_likelihood, 0.0);
  EXPECT_GT(sum.free, 0u);
  EXPECT_GT(sum.occupied, 0u);
  EXPECT_GT(sum.unknown, 0u);
}

TEST(HeldOutTruth, SharesAreOfWhatWasCounted) {
  HeldOutTruth truth;
  truth.free = 6;
  truth.occupied = 1;
  truth.unknown = 3;
  truth.endpoints = 8;
  truth.endpoints_near = 2;
  truth.casts_within = 1;
  truth.cast_errors = {0.05, 0.4};
  EXPECT_DOUBLE_EQ(truth.free_share().value(), 0.6);
  EXPECT_DOUBLE_EQ(truth.occupied_share().value(), 0.1);
  EXPECT_DOUBLE_EQ(truth.unknown_share().value(), 0.3);
  EXPECT_DOUBLE_EQ(truth.endpoints_near_share().value(), 0.25);
  EXPECT_DOUBLE_EQ(truth.casts_within_share().value(), 0.5);

  const HeldOutTruth nothing;
  EXPECT_EQ(nothing.free_share(), std::nullopt);
  EXPECT_EQ(nothing.endpoints_near_share(), std::nullopt);
  EXPECT_EQ(nothing.casts_within_share(), std::nullopt);
  EXPECT_EQ(nothing.median_cast_error(), std::nullopt);
}

TEST(HeldOutTruth, MedianIsExact) {
  struct Case {
    std::vector<double> errors;
    double median;
  };
  const Case cases[] = {
      {{3.0}, 3.0},
      {{4.0, 1.0}, 2.5},
      {{9.0, 1.0, 2.0}, 2.0},
      {{8.0, 1.0, 4.0, 2.0}, 3.0},
      {{HUGE_VAL, 1.0, HUGE_VAL, 2.0, 3.0}, 3.0},
      {{HUGE_VAL, 1.0}, HUGE_VAL},
      {{HUGE_VAL, HUGE_VAL}, HUGE_VAL},
  };
  for (const Case& c : cases) {
    HeldOutTruth truth;
    truth.cast_errors = c.errors;
    EXPECT_EQ(truth.median_cast_error(), c.median) << c.errors.size() << " errors";
  }
}

TEST(HeldOutTruth, OptionsMoveEveryLimit) {
  const elsewhere::Wall map{1.25, 2.0};
  const auto count = [&](const HeldOutTruthOptions& options) {
    HeldOutTruth truth;
    evaluate(map, beams_along_x({1.05}).view(), kUnlimitedRange, truth, options);
    return truth;
  };
  HeldOutTruthOptions options;
  options.sample_spacing = 0.25;
  EXPECT_EQ(count(options).samples(), 3u);
  options.sample_margin = 0.5;
  EXPECT_EQ(count(options).samples(), 2u);
  EXPECT_EQ(count(options).endpoints_near, 0u);
  options.endpoint_radius = 0.21;
  EXPECT_EQ(count(options).endpoints_near, 1u);
  EXPECT_EQ(count(options).casts_within, 0u);
  options.cast_tolerance = 0.21;
  EXPECT_EQ(count(options).casts_within, 1u);
  options.cast_overshoot = 0.19;
  EXPECT_EQ(count(options).median_cast_error(), HUGE_VAL);
}

TEST(HeldOutTruth, OptionsOutOfBoundsAreNamed) {
  struct Case {
    double HeldOutTruthOptions::*option;
    double value;
    const char* message;
  };
  const Case cases[] = {
      {&HeldOutTruthOptions::sample_spacing, 0.0, "sample_spacing = 0.0: must be > 0 m and finite"},
      {&HeldOutTruthOptions::sample_margin, -1.0, "sample_margin = -1.0: must be >= 0 m"},
      {&HeldOutTruthOptions::endpoint_radius, -0.5, "endpoint_radius = -0.5: must be >= 0 m"},
      {&HeldOutTruthOptions::cast_tolerance, -0.5, "cast_tolerance = -0.5: must be >= 0 m"},
      {&HeldOutTruthOptions::cast_overshoot, -0.5, "cast_overshoot = -0.5: must be >= 0 m"},
      {&HeldOutTruthOptions::probability_clip, 0.5, "probability_clip = 0.5: must be in (0, 0.5)"},
  };
  for (const Case& c : cases) {
    HeldOutTruthOptions options;
    options.*c.option = c.value;
    HeldOutTruth truth;
    const auto beams = beams_along_x({1.0});
    EXPECT_EQ(refusal_by([&] {
                evaluate(elsewhere::Wall{1.0, 2.0}, beams.view(), kUnlimitedRange, truth, options);
              }),
              c.message);
  }
}

TEST(HeldOutTruth, OwnMapIsTrueOnTheBeamsThatItMapped) {
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> angle(0.0, 6.283185307179586);
  MapOptions options;
  options.range_sigma = 0.01;
  FixedMap<2, 2> map(options);
  Scan<2> scan;
  scan.origins = Vector<2>(0.31, -0.17);
  scan.endpoints.resize(2, 400);
  for (Eigen::Index i = 0; i < scan.size(); ++i) {
    const double a = angle(random);
    scan.endpoints.col(i) = scan.origins.col(0) + 4.05 * Vector<2>(std::cos(a), std::sin(a));
  }
  for (int k = 0; k < 3; ++k) map.insert(scan);
  HeldOutTruth truth;
  evaluate(map, scan.view(), kUnlimitedRange, truth);
  EXPECT_EQ(truth.samples(), 400u * 39u);
  EXPECT_EQ(truth.free_share(), 1.0);
  EXPECT_EQ(truth.endpoints_near_share(), 1.0);
  EXPECT_EQ(truth.casts_within_share(), 1.0);
  EXPECT_LT(truth.median_cast_error().value(), 0.08);
}

}  // namespace
}  // namespace ndtree::test::test_held_out_truth
