// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <stdexcept>
#include <vector>

#include "map_kinds.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/transform.hpp"
#include "random.hpp"
#include "random_rotation.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_transform {
namespace {

constexpr double kCell = 0.25;

template <class Map>
Map random_map(Random& random) {
  constexpr int D = Map::kDim;
  MapOptions options;
  options.min_cell_size = kCell;
  options.max_cell_size = kCell * Map::kBranching * Map::kBranching;
  options.range_sigma = 0.05;
  Map map(options);
  for (int i = 0; i < 4; ++i) {
    Scan<D> scan;
    scan.origins.resize(D, 1);
    scan.endpoints.resize(D, 150);
    for (int a = 0; a < D; ++a) scan.origins(a, 0) = random.uniform(-1.0, 1.0);
    for (Eigen::Index k = 0; k < 150; ++k) {
      for (int a = 0; a < D; ++a) scan.endpoints(a, k) = random.uniform(-1.0, 1.0);
      scan.endpoints.col(k) *= 3.0 / scan.endpoints.col(k).cwiseAbs().maxCoeff();  // Walls of a room.
    }
    map.insert(scan);
  }
  return map;
}
template <class Map>
class Transformed : public testing::Test {};
TYPED_TEST_SUITE(Transformed, MapKinds);

/// A motion by right angles and whole cells of an edge.
template <int D>
Pose<D> lattice_pose(Random& random, double edge) {
  Pose<D> pose;
  for (int turns = random.integer(0, 5); turns > 0; --turns) {
    const int a = random.integer(0, D - 1);
    const int b = (a + 1) % D;
    Eigen::Matrix<double, D, D> turn = Eigen::Matrix<double, D, D>::Identity();
    turn(a, a) = turn(b, b) = std::cos(1.5707963267948966);  // Not quite 0.
    turn(b, a) = 1.0;
    turn(a, b) = -1.0;
    pose.rotation = turn * pose.rotation;
  }
  for (int a = 0; a < D; ++a) pose.translation[a] = edge * random.integer(-9, 9);
  return pose;
}
/// Lower corner and edge of each leaf that holds something, where a pose moves it, with what it holds.
template <class Map>
auto leaves_at(const Map& map, const Pose<Map::kDim>& pose) {
  constexpr int D = Map::kDim;
  std::map<std::vector<std::int64_t>, std::vector<std::uint32_t>> leaves;
  const double unit = map.tree().geometry().unit();
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    const auto words = leaf.cell().words();
    if (std::all_of(words.begin(), words.end(), [](std::uint32_t word) { return word == 0; })) return;
    const Box<D> box = map.tree().box(leaf.index);
    const Vector<D> one = pose * box.lower;
    const Vector<D> other = pose * box.upper;
    std::vector<std::int64_t> place;
    for (int a = 0; a < D; ++a) place.push_back(std::llround(std::min(one[a], other[a]) / unit));
    place.push_back(map.tree().geometry().edge(leaf.index.level));
    leaves[place] = {words.begin(), words.end()};
  });
  return leaves;
}

TYPED_TEST(Transformed, ByAMotionOfTheLatticeMovesCellsAsTheyAre) {
  constexpr int D = TypeParam::kDim;
  Random random(17);
  for (int round = 0; round < 8; ++round) {
    const auto map = random_map<TypeParam>(random);
    const auto& geometry = map.tree().geometry();
    const double edge =
        geometry.cell_size(TypeParam::RefinementType::coarsest_level(geometry.finest_level()));
    const Pose<D> pose = lattice_pose<D>(random, edge);
    const auto moved = transformed(map, pose);
    moved.check_invariants();
    const auto expected = leaves_at(map, pose);
    EXPECT_GT(expected.size(), 30u);
    ASSERT_EQ(leaves_at(moved, Pose<D>{}), expected);
    Pose<D> by_cells = pose;  // Of the smallest cells, which are put together anew.
    for (double& x : by_cells.translation) x += kCell * random.integer(-20, 20);
    const auto at_cells = transformed(map, by_cells);
    for (int i = 0; i < 1000; ++i) {
      const Vector<D> point = random_vector<D>(random, 4.0);
      ASSERT_EQ(state(at_cells, by_cells * point), state(map, point));
    }
    EXPECT_EQ(moved.counters().updates, map.counters().updates);
    EXPECT_EQ(moved.counters().splits, map.counters().splits);
    EXPECT_EQ(moved.counters().merges, map.counters().merges);
    const Pose<D> back{pose.rotation.transpose(), -(pose.rotation.transpose() * pose.translation)};
    ASSERT_EQ(leaves_at(transformed(moved, back), Pose<D>{}), leaves_at(map, Pose<D>{}));
    EXPECT_TRUE(to_bytes(transformed(map, Pose<D>{})) == to_bytes(map));
    // Half a smallest cell away there are other cells.
    Pose<D> between = pose;
    between.translation[0] += 0.5 * kCell;
    EXPECT_EQ(transformed(map, between).counters().updates, 0u);
  }
}

TYPED_TEST(Transformed, LooksAtNoMoreCellsThanAreAllowed) {
  using Transforming = detail::Transforming<TypeParam>;
  Random random(18);
  const auto map = random_map<TypeParam>(random);
  const auto pose = random_pose<TypeParam::kDim>(random, 5.0);
  EXPECT_GT(Transforming::most_cells(map), std::size_t{1} << 24);
  EXPECT_NO_THROW(Transforming(map, pose, 1000000));
  expect_refused([&] { const Transforming refused(map, pose, 100); }, "100 cells of min_cell_size = 0.25 m");
}

TYPED_TEST(Transformed, MovesNothingByMoreThanHalfADiagonal) {
  constexpr int D = TypeParam::kDim;
  Random random(15);
  for (int round = 0; round < 6; ++round) {
    const auto map = random_map<TypeParam>(random);
    const Pose<D> pose = random_pose<D>(random, 5.0);
    const auto moved = transformed(map, pose);
    moved.check_invariants();
    const double most = 0.5 * kCell * std::sqrt(D) * (1.0 + 1e-9);
    int seen[3] = {0, 0, 0};
    for (int i = 0; i < 2000; ++i) {
      const Vector<D> point = random_vector<D>(random, 4.0);
      const CellState now = state(moved, pose * point);
      ++seen[static_cast<int>(now) + 1];
      bool was = false;  // The state of a leaf that is so near.
      detail::for_each_node_touching(
          map.tree(), map.tree().root(), Box<D>{point.array() - most, point.array() + most},
          [&](const auto& ref, bool) {
            if (ref.is_leaf() && map.tree().box(ref.index).squared_distance(point) <= most * most)
              was = was || ref.cell().state() == now;
            return true;
          });
      was = was || (now == CellState::unknown && (point.cwiseAbs().array() > 3.0).any());
      ASSERT_TRUE(was) << "state " << static_cast<int>(now);
    }
    EXPECT_GT(seen[0], 15);
    EXPECT_GT(seen[1], 100);
    EXPECT_GT(seen[2], 30);
  }
}

TEST(TransformedAdaptiveMaps, KeepTheirEvidence) {
  using Map = AdaptiveMap<2, 2>;
  Random random(16);
  // Beams through cells: the evidence of a square of cells is that of one cell, times its edge.
  const auto evidence = [](const Map& map) {
    Eigen::Array4d sum = Eigen::Array4d::Zero();
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      const auto& cell = leaf.cell();
      sum += Eigen::Array4d(static_cast<double>(cell.occupied_evidence()),
                            static_cast<double>(cell.free_evidence()), cell.hits(), cell.misses()) *
             map.tree().geometry().cell_size(leaf.index.level);
    });
    return sum;
  };
  for (int round = 0; round < 5; ++round) {
    const Map map = random_map<Map>(random);
    const Eigen::Array4d before = evidence(map);
    const Eigen::Array4d ratio = evidence(transformed(map, random_pose<2>(random, 5.0))) / before;
    EXPECT_NEAR(ratio.head<2>().matrix().dot(before.head<2>().matrix()) / before.head<2>().sum(), 1.0, 0.05);
    EXPECT_GT(ratio.minCoeff(), 0.8) << ratio.transpose();  // Occupied and free, hits and misses.
    EXPECT_LT(ratio.maxCoeff(), 1.4) << ratio.transpose();  // Counts are rounded up.
  }
}

TEST(Transformed, NeedsARigidMotion) {
  const AdaptiveMap<2, 2> map;
  Pose<2> pose;
  pose.rotation *= 1.1;
  EXPECT_THROW((void)transformed(map, pose), std::invalid_argument);
  pose.rotation = Eigen::Matrix2d::Identity();
  pose.translation[0] = std::nan("");
  EXPECT_THROW((void)transformed(map, pose), std::invalid_argument);
  EXPECT_EQ(transformed(map, Pose<2>{}).stats().leaves, 1u);
}

}  // namespace
}  // namespace ndtree::test::test_transform
