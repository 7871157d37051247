// SPDX-License-Identifier: BSD-3-Clause
// Calibration: counts of beams and cells, compared with asking every leaf about every beam.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>

#include "ndtree/evaluation/calibration.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/tree/visit.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_calibration {
namespace {

template <int D>
Scan<D> scan_of_a_box(Random& random, Eigen::Index beams) {
  Scan<D> scan;
  scan.origins = Vector<D>::Zero();
  scan.endpoints.resize(D, beams);
  for (Eigen::Index i = 0; i < beams; ++i) {
    Vector<D> way;
    for (int a = 0; a < D; ++a) way[a] = random.uniform(-1.0, 1.0);
    scan.endpoints.col(i) = way / way.cwiseAbs().maxCoeff() * random.uniform(1.97, 2.03);
  }
  return scan;
}

template <class S>
class CalibrationOf : public ::testing::Test {};
TYPED_TEST_SUITE(CalibrationOf, TwoShapes, ShapeNames);

TYPED_TEST(CalibrationOf, CountsEachBeamInEachLeafThatItReaches) {
  NDTREE_SHAPE;
  Random random(91);
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 1.0;
  AdaptiveMap<N, D> map(options);
  for (int i = 0; i < 12; ++i) map.insert(scan_of_a_box<D>(random, 60));
  const Scan<D> held_out = scan_of_a_box<D>(random, 40);
  Calibration calibration;
  calibrate(map.cells(), held_out.view(), kUnlimitedRange, calibration);

  const HitRateModel model(map.options());
  std::uint64_t pairs = 0;
  std::uint64_t ends = 0;
  double hit_rates = 0.0;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (!leaf.cell().observed()) return;
    const Box<D> box = map.tree().box(leaf.index);
    for (Eigen::Index i = 0; i < held_out.endpoints.cols(); ++i) {
      const Vector<D> end = held_out.endpoints.col(i);
      double enter = 0.0;
      double exit = std::numeric_limits<double>::infinity();
      for (int a = 0; a < D; ++a) {
        enter = std::max(enter, std::min(box.lower[a] / end[a], box.upper[a] / end[a]));
        exit = std::min(exit, std::max(box.lower[a] / end[a], box.upper[a] / end[a]));
      }
      if (enter >= exit || enter > 1.0) continue;
      ++pairs;
      ends += exit > 1.0;
      hit_rates +=
          model(leaf.cell(), static_cast<double>(map.tree().geometry().edge(leaf.index.level))).mean();
    }
  });
  std::uint64_t counted = 0;
  std::uint64_t ended = 0;
  double said = 0.0;
  for (const auto& [group, bins] : calibration.groups) {
    EXPECT_GE(std::get<1>(group), 0.25);
    EXPECT_GE(std::get<2>(group), 0);
    for (std::size_t i = 0; i < bins.size(); ++i) {
      counted += bins[i].pairs;
      ended += bins[i].ends;
      said += bins[i].hit_rates;
      if (bins[i].pairs == 0) continue;
      const double mean = bins[i].hit_rates / static_cast<double>(bins[i].pairs);
      EXPECT_GE(mean, static_cast<double>(i) / 20.0 - 1e-12);
      EXPECT_LE(mean, static_cast<double>(i + 1) / 20.0 + 1e-12);
    }
  }
  EXPECT_EQ(counted, pairs);
  EXPECT_EQ(ended, ends);
  EXPECT_NEAR(said, hit_rates, 1e-9 * static_cast<double>(pairs));
  EXPECT_EQ(calibration.beams, 40u);
  EXPECT_EQ(calibration.ends_at_unknown, 40u - ends);
  EXPECT_GT(ends, 20u);
  EXPECT_GT(pairs, 80u);

  Calibration twice = calibration;  // Counts add up.
  twice.add(calibration);
  EXPECT_EQ(twice.beams, 80u);
  EXPECT_EQ(twice.groups.size(), calibration.groups.size());
  for (const auto& [group, bins] : twice.groups)
    for (std::size_t i = 0; i < bins.size(); ++i)
      EXPECT_EQ(bins[i].pairs, 2 * calibration.groups[group][i].pairs);
}

TEST(Calibration, AsksOnlyAboutBeamsThatReturnedFromWithinRange) {
  AdaptiveMap<2, 2> map;
  Scan<2> scan;
  scan.origins = Vector<2>::Zero();
  scan.endpoints.resize(2, 3);
  scan.endpoints << 1.0, 5.0, 0.0, 0.3, 0.2, 0.0;  // The second is too long, the third of no length.
  map.insert(scan);
  Calibration calibration;
  calibrate(map.cells(), scan.view(), 3.0, calibration);
  EXPECT_EQ(calibration.beams, 1u);
  EXPECT_THROW(calibrate(map.cells(), scan.view(), 0.0, calibration), std::invalid_argument);
  EXPECT_THROW(calibrate(map.cells(), scan.view(), std::nan(""), calibration), std::invalid_argument);
}

}  // namespace
}  // namespace ndtree::test::test_calibration
