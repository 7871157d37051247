// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/io/dense_grid.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "refusals.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_dense_grid {
namespace {

template <class Map>
Map scanned(Random& random) {
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.9;
  Map map(options);
  map.insert(scan_about<Map::kDim>(random, 0.0, 200, 0.1, 1.5));
  return map;
}

/// Centres of a grid's cells, in the order of its array.
template <int D>
std::vector<Vector<D>> centres(const GridGeometry<D>& grid) {
  std::vector<Vector<D>> result;
  for (std::size_t i = 0; i < grid.size(); ++i) {
    Vector<D> point;
    std::size_t rest = i;
    for (int a = D - 1; a >= 0; rest /= grid.shape[static_cast<std::size_t>(a)], --a)
      point[a] = grid.centre(a, rest % grid.shape[static_cast<std::size_t>(a)]);
    result.push_back(point);
  }
  return result;
}

template <class Shape>
class DenseGrid : public testing::Test {};
TYPED_TEST_SUITE(DenseGrid, test::TwoShapes, test::ShapeNames);

TYPED_TEST(DenseGrid, HoldsWhatTheMapSaysAtTheCentresOfCellsNoLargerThanItsOwn) {
  NDTREE_SHAPE;
  Random random(11);
  const auto map = scanned<AdaptiveMap<N, D>>(random);
  std::size_t known = 0;
  for (const double size : {0.1, 0.05, 0.073, 0.09}) {
    GridGeometry<D> grid;
    grid.cell_size = size;
    for (int a = 0; a < D; ++a) {
      grid.lower[a] = size == 0.1 ? -2.0 + 0.1 * a : random.uniform(-2.0, 0.0);
      grid.shape[static_cast<std::size_t>(a)] = static_cast<std::size_t>(random.integer(5, 30));
    }
    std::vector<float> values(grid.size(), 77.0f);
    to_grid(
        map, grid, [](const auto& cell) { return cell.log_odds(); }, values.data());
    const auto points = centres(grid);
    for (std::size_t i = 0; i < points.size(); ++i) {
      ASSERT_EQ(values[i], cell_at(map, points[i]).log_odds()) << points[i].transpose();
      known += values[i] != 0.0f;
    }
  }
  EXPECT_GT(known, 10u);
}

TYPED_TEST(DenseGrid, AndBackIsTheSame) {
  NDTREE_SHAPE;
  Random random(12);
  GridGeometry<D> grid;
  grid.cell_size = 0.05;
  for (int a = 0; a < D; ++a) {
    grid.lower[a] = -0.35 + a;  // -7 cells, or nearly.
    grid.shape[static_cast<std::size_t>(a)] = D == 2 ? 40 : 17;
  }
  std::vector<std::int8_t> states(grid.size());
  std::int8_t last = 0;
  for (auto& state : states) {
    if (&state - states.data() < static_cast<std::ptrdiff_t>(states.size() / 2)) continue;  // Free.
    if (random.chance(0.3)) last = static_cast<std::int8_t>(random.integer(-1, 1));
    state = last;
  }
  const auto expect_same = [&](const auto& map) {
    map.check_invariants();
    std::vector<std::int8_t> again(grid.size());
    to_grid(
        map, grid, [](const auto& cell) { return static_cast<std::int8_t>(cell.state()); }, again.data());
    EXPECT_EQ(again, states);
    const auto known =
        static_cast<std::size_t>(std::count_if(states.begin(), states.end(), [](int s) { return s >= 0; }));
    EXPECT_LE(map.stats().observed_leaves, known);
    return map.stats().observed_leaves;
  };
  EXPECT_LT((expect_same(from_grid<AdaptiveMap<N, D>>(states.data(), grid))),
            (expect_same(from_grid<FixedMap<N, D>>(states.data(), grid))));
  expect_same(from_grid<PaperMap<N, D>>(states.data(), grid));
}

TYPED_TEST(DenseGrid, OfLargeOccupiedCellsOnlyWhatIsNearFreeOnesIsDrawn) {
  NDTREE_SHAPE;
  Random random(14);
  MapOptions options;  // Of beams that end anywhere in a metre, whose noise keeps cells whole.
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.1 * N * N;
  options.range_sigma = 0.3;
  AdaptiveMap<N, D> map(options);
  for (int i = 0; i < 30; ++i) {
    Scan<D> scan;
    scan.origins = Vector<D>::Constant(0.03);
    scan.endpoints.resize(D, 300);
    for (Eigen::Index k = 0; k < 300; ++k) {
      for (int a = 1; a < D; ++a) scan.endpoints(a, k) = random.uniform(-0.6, 0.6);
      scan.endpoints(0, k) = random.uniform(1.5, 3.0);
    }
    map.insert(scan);
  }
  GridGeometry<D> grid;
  std::size_t left_out = 0;
  std::size_t drawn = 0;
  for (const double depth : {0.1, 0.25, 0.5}) {
    grid.cell_size = depth == 0.25 ? 0.2 : 0.1;
    for (int a = 0; a < D; ++a) {
      grid.lower[a] = a == 0 ? 1.0 : -0.6;
      grid.shape[static_cast<std::size_t>(a)] = a == 0 ? 24 : 12;
    }
    std::vector<std::int8_t> all(grid.size());
    states_to_grid(map, grid, std::nullopt, all.data());
    std::vector<std::int8_t> some(grid.size());
    states_to_grid(map, grid, depth, some.data());
    const auto points = centres(grid);
    const double reach = std::floor(depth / grid.cell_size + 1e-9) * grid.cell_size;
    for (std::size_t i = 0; i < all.size(); ++i) {
      if (all[i] != 1) {
        ASSERT_EQ(some[i], all[i]);
        continue;
      }
      bool is_near = false;
      for (std::size_t k = 0; k < all.size(); ++k)
        is_near |= all[k] == 0 && (points[k] - points[i]).cwiseAbs().maxCoeff() < reach + 0.01;
      if (grid.cell_size > 0.15) {  // Cells of the map within may be small.
        bool has_small = false;
        for_each_leaf(map.tree(), [&](const auto& leaf) {
          const Box<D> box = map.tree().box(leaf.index);
          has_small |= leaf.cell().state() == CellState::occupied &&
                       leaf.index.level == map.tree().geometry().finest_level() &&
                       (0.5 * (box.lower + box.upper) - points[i]).cwiseAbs().maxCoeff() < 0.1;
        });
        ASSERT_EQ(some[i], is_near || has_small ? 1 : -1);
      } else {
        const bool is_large =
            map.tree().find_leaf(points[i])->index.level > map.tree().geometry().finest_level();
        ASSERT_EQ(some[i], is_near || !is_large ? 1 : -1) << points[i].transpose();
      }
      left_out += some[i] == -1;
      drawn += some[i] == 1;
    }
  }
  EXPECT_GT(left_out, 10u);
  EXPECT_GT(drawn, 3u);
  std::vector<std::int8_t> none(grid.size());
  EXPECT_THROW(states_to_grid(map, grid, 0.0, none.data()), std::invalid_argument);
}

TEST(DenseGrid, CellsAndTheMapAreHalfOpen) {
  MapOptions options;
  options.min_cell_size = options.max_cell_size = 0.25;
  MapBuilder<FixedMap<2, 2>> builder(options);
  builder.fill({0, 0}, {1, 1}, 1.0f);
  const auto map = std::move(builder).finish();  // All of it is the one cell, up to 0.25 m.
  GridGeometry<2> grid{Vector<2>(-0.25, 0.0), 0.25, {3, 3}};
  grid.lower -= Vector<2>::Constant(0.125);  // Centres lie on borders.
  std::vector<std::int8_t> states(9);
  to_grid(
      map, grid, [](const auto& cell) { return static_cast<std::int8_t>(cell.state()); }, states.data());
  EXPECT_EQ(states, (std::vector<std::int8_t>{-1, -1, -1, 1, -1, -1, -1, -1, -1}));
}

TEST(DenseGrid, WhatIsNoGridIsRefused) {
  const std::int8_t good[] = {0, 1};
  const std::int8_t bad[] = {0, 2};
  GridGeometry<1> grid;
  grid.shape = {2};
  const auto refused = [&](const std::int8_t* states) {
    return refusal_by([&] { static_cast<void>(from_grid<FixedMap<2, 1>>(states, grid)); });
  };
  grid.cell_size = 0.1;
  EXPECT_EQ(refused(good), "accepted");
  EXPECT_NE(refused(bad).find("state 2 at 1"), std::string::npos);
  grid.lower[0] = 0.05;
  EXPECT_NE(refused(good).find("whole number of cells"), std::string::npos);
  grid.lower[0] = NAN;
  EXPECT_NE(refused(good).find("lower"), std::string::npos);
  grid.lower[0] = 0.0;
  grid.cell_size = -1.0;
  EXPECT_NE(refused(good).find("cell_size"), std::string::npos);
}

}  // namespace
}  // namespace ndtree::test::test_dense_grid
