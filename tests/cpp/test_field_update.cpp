// SPDX-License-Identifier: BSD-3-Clause
// Distance fields that follow a map, against those made anew.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>

#include "ndtree/core/cancel.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/distance_field.hpp"
#include "ndtree/query/field_update.hpp"
#include "random.hpp"
#include "random_maps.hpp"

namespace ndtree::test::test_field_update {
namespace {

template <class Map>
class FieldUpdate : public testing::Test {};
using Maps = testing::Types<AdaptiveMap<2, 2>, AdaptiveMap<2, 3>, FixedMap<2, 1>>;
TYPED_TEST_SUITE(FieldUpdate, Maps);

TYPED_TEST(FieldUpdate, GivesTheFieldThatIsMadeAnew) {
  constexpr int D = TypeParam::kDim;
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 0.25 * TypeParam::kBranching * TypeParam::kBranching;
  options.range_sigma = 0.05;
  Random random(17);
  std::size_t changed = 0;
  for (int round = 0; round < 6; ++round) {
    TypeParam map(options);
    const Box<D> box{Vector<D>::Constant(-3.0), Vector<D>::Constant(2.5)};
    const UnknownSpace unknown = round % 2 == 0 ? UnknownSpace::free : UnknownSpace::occupied;
    const double cell = round < 3 ? 0.25 : 0.17;
    const double most = random.uniform(0.3, 3.0);
    DistanceField<D> field = distance_field(map, box, cell, most, unknown);
    for (int step = 0; step < 8; ++step) {
      const TypeParam before = map.snapshot();
      if (step == 5) {
        map.clear({Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)});
      } else {
        map.insert(scan_about<D>(random, 0.0, 5 + 20 * (step % 3), 1.0, 2.5));
      }
      update(field, before, map);
      const DistanceField<D> anew = distance_field(map, box, cell, most, unknown);
      changed += static_cast<std::size_t>(std::count_if(
          anew.values().begin(), anew.values().end(), [&](float v) { return v < static_cast<float>(most); }));
      ASSERT_EQ(field.values(), anew.values()) << "round " << round << ", step " << step;
    }
  }
  EXPECT_GT(changed, D == 1 ? 1000u : 10000u);
}

TEST(FieldUpdateOfOneChange, IsExactWhereDistancesAreLessThanRounding) {
  // Points on borders, and so near to one that squares of floats lose them.
  struct Case {
    double unit, cell_size, most, lower;
  };
  for (const Case& one : {Case{0.5, 0.25, 1e-17, -1.125}, Case{0.5, 1e-21, 1.0, -1e-20},
                          Case{0.5, 1e-24, 1.0, -1e-23}, Case{1.0, 1.0, 0.7, 0x1p30 - 4.3}}) {
    MapOptions options;
    options.min_cell_size = one.unit;
    FixedMap<2, 1> map(options);
    const FixedMap<2, 1> before = map.snapshot();
    Scan<1> scan;
    scan.origins = Vector<1>::Constant(one.lower - 6.0 * one.unit);
    scan.endpoints = Eigen::MatrixXd::Constant(1, 1, std::ceil(one.lower) + 0.1 * one.unit);
    for (int i = 0; i < 5; ++i) map.insert(scan);
    const Box<1> box{Vector<1>::Constant(one.lower), Vector<1>::Constant(one.lower + 20.0 * one.cell_size)};
    ASSERT_FALSE(changes(before, map).empty());
    DistanceField<1> field = distance_field(before, box, one.cell_size, one.most);
    update(field, before, map);
    EXPECT_EQ(field.values(), distance_field(map, box, one.cell_size, one.most).values()) << one.cell_size;
    update(field, map, before);
    EXPECT_EQ(field.values(), distance_field(before, box, one.cell_size, one.most).values()) << one.cell_size;
  }
}

TEST(FieldUpdateOfOneChange, LooksAtWhatIsNearAlone) {
  // A room whose walls are all far from the one cell that changes: values are those of before elsewhere, bit
  // for bit, even if they are wrong.
  MapOptions options;
  options.min_cell_size = 0.25;
  FixedMap<2, 2> map(options);
  Scan<2> scan;
  scan.origins = Vector<2>(0.1, 0.1);
  scan.endpoints = Eigen::MatrixXd(2, 1);
  scan.endpoints << 3.1, 0.1;
  for (int i = 0; i < 5; ++i) map.insert(scan);
  const Box<2> box{Vector<2>(-20.0, -20.0), Vector<2>(20.0, 20.0)};
  DistanceField<2> field = distance_field(map, box, 0.25, 2.0);
  std::fill(field.values().begin(), field.values().end(), 1.0f);
  const FixedMap<2, 2> before = map.snapshot();
  scan.endpoints << -3.1, 0.1;
  for (int i = 0; i < 5; ++i) map.insert(scan);
  update(field, before, map);
  const auto kept = std::count(field.values().begin(), field.values().end(), 1.0f);
  EXPECT_GT(static_cast<double>(kept), 0.97 * static_cast<double>(field.values().size()));
  EXPECT_LT(kept, static_cast<std::ptrdiff_t>(field.values().size()));
}

TEST(FieldUpdateOfOneChange, LeavesWhatIsFarAsItIs) {
  // Obstacles that are farther from the change than anything that is looked at again.
  MapOptions options;
  options.min_cell_size = 0.25;
  FixedMap<2, 2> map(options);
  Scan<2> scan;
  scan.origins = Vector<2>(0.1, 0.1);
  scan.endpoints = Eigen::MatrixXd(2, 2);
  scan.endpoints << 5.1, -3.1, 0.1, 0.1;
  for (int i = 0; i < 5; ++i) map.insert(scan);
  const Box<2> box{Vector<2>(-8.0, -8.0), Vector<2>(8.0, 8.0)};
  for (const double most : {0.25, 1.0, 3.0}) {
    FixedMap<2, 2> changed = map;
    DistanceField<2> field = distance_field(map, box, 0.25, most);
    changed.clear({Vector<2>(-4.0, -1.0), Vector<2>(-2.0, 1.0)});
    update(field, map, changed);
    EXPECT_EQ(field.values(), distance_field(changed, box, 0.25, most).values()) << most;
    update(field, changed, map);
    EXPECT_EQ(field.values(), distance_field(map, box, 0.25, most).values()) << most;
  }
}

TEST(FieldUpdateOfOneChange, IsWholeOrNotAtAll) {
  MapOptions options;
  options.min_cell_size = 0.05;
  options.max_cell_size = 0.4;
  AdaptiveMap<2, 2> map(options);
  Random random(18);
  const Scan<2> scan = scan_about<2>(random, 0.0, 300, 0.1, 4.0);
  const Box<2> box{Vector<2>(-5.0, -5.0), Vector<2>(5.0, 5.0)};
  const AdaptiveMap<2, 2> before = map.snapshot();
  const DistanceField<2> first = distance_field(map, box, 0.05, 2.0);
  map.insert(scan);
  int stopped = 0;
  for (int questions = 0;; ++questions) {
    DistanceField<2> field = first;
    int left = questions;
    bool is_done = false;
    try {
      const CancelScope scope([&] { return left-- == 0; });
      update(field, before, map);
      is_done = true;
    } catch (const Cancelled&) {
      ++stopped;
      ASSERT_EQ(field.values(), first.values()) << questions;
    }
    if (!is_done) continue;
    EXPECT_EQ(field.values(), distance_field(map, box, 0.05, 2.0).values());
    break;
  }
  EXPECT_GT(stopped, 0);
}

}  // namespace
}  // namespace ndtree::test::test_field_update
