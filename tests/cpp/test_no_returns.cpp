// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "ndtree/evaluation/no_returns.hpp"
#include "ndtree/mapping/occupancy_map.hpp"

namespace ndtree::test::test_no_returns {
namespace {

/// A beam of a scan: up to `range` along +x, and whether it returned.
struct Ray {
  double range;
  bool returned;
};

/// A sensor that looks along +x from heights that are in the middles of cells, one a ray.
template <int D>
Scan<D> scan_of(const std::vector<Ray>& rays) {
  constexpr double kCell = D == 2 ? 0.1 : 0.2;
  const auto n = static_cast<Eigen::Index>(rays.size());
  Scan<D> scan;
  scan.origins = Points<D>::Constant(D, n, 0.5 * kCell);
  scan.returned.resize(n);
  for (Eigen::Index i = 0; i < n; ++i) scan.origins(1, i) = (static_cast<double>(i) + 0.5) * kCell;
  scan.endpoints = scan.origins;
  for (Eigen::Index i = 0; i < n; ++i) {
    scan.endpoints(0, i) += rays[static_cast<std::size_t>(i)].range;
    scan.returned[i] = rays[static_cast<std::size_t>(i)].returned;
  }
  return scan;
}

template <int D>
NoReturns judged(const std::vector<Scan<D>>& scans) {
  std::vector<ScanView<D>> views;
  for (const Scan<D>& scan : scans) views.push_back(scan.view());
  return judge_no_returns<FixedMap<2, D>>(views);
}

const std::vector<Ray> kWall(100, Ray{4.0, true});
const std::vector<Ray> kNothing(100, Ray{9.0, false});

/// `count` of a hundred rays get lost, the others hit the wall.
std::vector<Ray> with_lost(std::size_t count) {
  std::vector<Ray> rays = kWall;
  for (std::size_t i = 0; i < count; ++i) rays[i] = {9.0, false};
  return rays;
}

template <class Dimension>
class NoReturnsIn : public testing::Test {};
using Dimensions = testing::Types<std::integral_constant<int, 2>, std::integral_constant<int, 3>>;
TYPED_TEST_SUITE(NoReturnsIn, Dimensions);

TYPED_TEST(NoReturnsIn, AreWrongWhereTheyCrossAWallThatIsThereBeforeAndAfter) {
  constexpr int D = TypeParam::value;
  for (const std::size_t lost : {std::size_t{0}, std::size_t{36}, std::size_t{37}, std::size_t{100}}) {
    const NoReturns found = judged<D>({scan_of<D>(kWall), scan_of<D>(with_lost(lost)), scan_of<D>(kWall)});
    EXPECT_EQ(found.beams, lost);
    EXPECT_DOUBLE_EQ(found.share, static_cast<double>(lost) / 300.0);
    EXPECT_EQ(found.crossing, lost == 0 ? 0.0 : 1.0);
    EXPECT_EQ(found.expected, 0.0);
    EXPECT_EQ(std::string(found.choice()), "ignore");
    EXPECT_EQ(found.to_text().find("could be checked") != std::string::npos, lost > 0 && lost < 37);
  }
}

TYPED_TEST(NoReturnsIn, AreNotJudgedWhereTheWallCameLaterOrHadLeft) {
  constexpr int D = TypeParam::value;
  const Scan<D> wall = scan_of<D>(kWall), nothing = scan_of<D>(kNothing);
  EXPECT_EQ(judged<D>({nothing, nothing, wall, wall}).beams, 0u);           // Came later.
  EXPECT_EQ(judged<D>({wall, wall, nothing, nothing, nothing}).beams, 0u);  // Had left.
  EXPECT_EQ(judged<D>({wall, nothing}).beams, 0u);                          // Not looked at again.
  EXPECT_EQ(judged<D>({wall, nothing, wall}).beams, 100u);
}

TYPED_TEST(NoReturnsIn, MayComeUpToThreeCellsShortOfASurface) {
  constexpr int D = TypeParam::value;
  constexpr double kCell = D == 2 ? 0.1 : 0.2;
  // The wall's cell begins at 3.95 m (in 3-D 3.9 m) from the sensor.
  const double wall = 4.0 - 0.5 * kCell;
  for (const double beyond : {2.9, 3.1}) {
    const std::vector<Ray> rays(100, Ray{wall + beyond * kCell, false});
    const NoReturns found = judged<D>({scan_of<D>(kWall), scan_of<D>(rays), scan_of<D>(kWall)});
    EXPECT_EQ(found.beams, 100u);
    EXPECT_EQ(found.crossing, beyond > 3.0 ? 1.0 : 0.0);
  }
}

TYPED_TEST(NoReturnsIn, SayHowManyWouldCrossByPosesThatAreWrong) {
  constexpr int D = TypeParam::value;
  constexpr double kCell = D == 2 ? 0.1 : 0.2;
  // Of 100 rays 50 are lost, of which 20 cross the wall, and the others end before it; of the 50 that return,
  // `through` go through the wall to 8 m, and the others end at it.
  for (const std::size_t through : {std::size_t{0}, std::size_t{10}, std::size_t{25}}) {
    std::vector<Ray> rays = kWall;
    for (std::size_t i = 0; i < 20; ++i) rays[i] = {9.0, false};
    for (std::size_t i = 20; i < 50; ++i) rays[i] = {3.0, false};
    for (std::size_t i = 50; i < 50 + through; ++i) rays[i] = {8.0, true};
    const NoReturns found = judged<D>({scan_of<D>(kWall), scan_of<D>(rays), scan_of<D>(kWall)});
    const double wall = 4.0 - 0.5 * kCell, margin = 3.0 * kCell;
    const double k = static_cast<double>(through);
    const double metres = k * wall + (50.0 - k) * (4.0 - margin);
    const double silent = 20.0 * wall + 30.0 * (3.0 - margin);
    EXPECT_EQ(found.beams, 50u);
    EXPECT_DOUBLE_EQ(found.crossing, 0.4);
    EXPECT_NEAR(found.expected, 1.0 - std::exp(-k / metres * silent / 50.0), 1e-9);
    EXPECT_FALSE(found.are_free());  // A beam that crosses a wall by a wrong pose erases it as well.
  }
}

TEST(NoReturns, LeaveOutScansThatNoMapTakes) {
  Scan<2> broken = scan_of<2>(kWall);
  broken.endpoints(0, 7) = 1e300;
  const Scan<2> wall = scan_of<2>(kWall), nothing = scan_of<2>(kNothing);
  EXPECT_EQ(judged<2>({broken, nothing, wall}).beams, 0u);
  EXPECT_EQ(judged<2>({wall, nothing, broken, nothing, wall}).beams, 200u);
}

TEST(NoReturns, AreFreeWhereItIsSureThatFewerThanAFifthCross) {
  // Of n beams k cross: three standard deviations of a fraction of a fifth lie between.
  for (const std::size_t n : {std::size_t{20}, std::size_t{36}, std::size_t{37}, std::size_t{100}})
    for (std::size_t k = 0; k <= n; ++k) {
      std::vector<Ray> rays(n, Ray{3.0, false});
      for (std::size_t i = 0; i < k; ++i) rays[i] = {9.0, false};
      const NoReturns found = judged<2>({scan_of<2>(kWall), scan_of<2>(rays), scan_of<2>(kWall)});
      ASSERT_EQ(found.beams, n);
      const auto beams = static_cast<double>(n), crossing = static_cast<double>(k) / beams;
      EXPECT_EQ(found.are_free(), 0.2 - crossing > 3.0 * std::sqrt(0.2 * 0.8 / beams)) << k << " of " << n;
      EXPECT_EQ(found.are_judged(), n > 36);
    }
}

TYPED_TEST(NoReturnsIn, AreLeftOutWhereFewSurfacesDoNotReturnInTheOpen) {
  constexpr int D = TypeParam::value;
  constexpr double kCell = D == 2 ? 0.1 : 0.2;
  // Of a thousand rays ten meet a post each, and the others nothing. Hits of a post are beside the rays of
  // the scan between, all around them.
  constexpr std::size_t kPosts = 10, kAll = 1000;
  const auto scan = [&](std::size_t dark, double up, double aside) {
    std::vector<Ray> rays(kAll, Ray{9.0, false});
    for (std::size_t i = 0; i < kPosts; ++i) rays[3 * i] = {i < dark ? 9.0 : 4.0, i >= dark};
    Scan<D> made = scan_of<D>(rays);
    for (Points<D>* points : {&made.origins, &made.endpoints}) {
      points->row(1).array() += up * kCell;
      if (D == 3) points->row(2).array() += aside * kCell;
    }
    return made;
  };
  for (std::size_t dark = 0; dark <= 3; ++dark)
    for (const bool are_around : {true, false}) {
      std::vector<Scan<D>> scans;
      for (int k = 0; k < 4; ++k) {
        const double up = k % 2 == 0 || !are_around ? 0.3 : -0.3, aside = k < 2 || !are_around ? 0.3 : -0.3;
        scans.push_back(scan(0, up, aside));
        scans.push_back(scan(dark, 0.0, 0.0));
      }
      for (int k = 0; k < 4; ++k) {
        scans.push_back(scan(0, k % 2 == 0 || !are_around ? 0.3 : -0.3, k < 2 || !are_around ? 0.3 : -0.3));
        scans.push_back(scan(dark, 0.0, 0.0));
      }
      const NoReturns found = judged<D>(scans);
      EXPECT_EQ(found.surfaces, are_around ? kPosts : 0u);
      EXPECT_DOUBLE_EQ(found.erased, are_around ? static_cast<double>(dark) / kPosts : 0.0);
      EXPECT_EQ(found.are_free(), !are_around || dark == 0);
      EXPECT_EQ(found.to_text().find("they would erase") != std::string::npos, !found.are_free());
    }
}

TEST(NoReturns, OfNothingAreLeftOut) {
  // A sensor that never has an echo may be blind.
  EXPECT_FALSE(judged<2>({scan_of<2>(kNothing), scan_of<2>(kNothing), scan_of<2>(kNothing)}).are_free());
  EXPECT_FALSE(judged<2>({}).are_free());
  EXPECT_FALSE(judged<2>({scan_of<2>(kNothing)}).are_free());
  NoReturns many;
  many.share = 0.0002;
  many.beams = 1234567;
  EXPECT_EQ(many.to_text(),
            "beams without return (less than 0.1 %) mean free space: 0 % of 1,234,567 that were tested go "
            "through walls that other scans saw (pose errors would explain 0 %)");
  many.erased = 0.5;
  many.surfaces = 999;
  EXPECT_NE(many.to_text().find("50 % of 999 pieces of surface"), std::string::npos);
  EXPECT_EQ(judged<2>({scan_of<2>(kWall)}).to_text(), "every beam of the scans that were looked at returned");
  EXPECT_EQ(judged<2>({scan_of<2>(kNothing)}).to_text(),
            "beams without return (100.0 %) are left out: none of them could be checked");
}

TEST(NoReturns, InFourDimensionsAreNotJudged) {
  const Scan<4> wall = scan_of<4>(kWall), nothing = scan_of<4>(kNothing);
  const NoReturns found = judged<4>({wall, nothing, wall});
  EXPECT_EQ(found.beams, 0u);
  EXPECT_DOUBLE_EQ(found.share, 1.0 / 3.0);
  EXPECT_FALSE(found.are_free());
}

}  // namespace
}  // namespace ndtree::test::test_no_returns
