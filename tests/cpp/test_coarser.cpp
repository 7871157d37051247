// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/io/coarser.hpp"
#include "ndtree/io/dense_grid.hpp"
#include "ndtree/io/map_server.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "ndtree/map.hpp"
#include "ndtree/query/point.hpp"
#include "support/random.hpp"

namespace ndtree::test::test_coarser {
namespace {

// Lengths are whole numbers of sixtieths of the map's cells, so that what overlaps is decided exactly.
constexpr std::int64_t kUnit = 60;

/// Random boxes of five values, some flat: log-odds that differ by state and within it.
template <class Map>
Map blocks(double unit, std::uint64_t seed) {
  MapOptions options;
  options.min_cell_size = unit;
  options.max_cell_size = 8 * unit;
  MapBuilder<Map> builder(options);
  Random random(seed);
  for (int i = 0; i < 60; ++i) {
    Lattice<Map::kDim> lower, upper;
    for (std::size_t a = 0; a < Map::kDim; ++a) {
      lower[a] = random.integer(-17, 14);
      upper[a] = lower[a] + random.integer(1, i < 12 ? 12 : 3);
    }
    const std::array<float, 5> values = {-2.0f, -1.0f, 1.0f, 2.0f, 0.0f};
    builder.fill(lower, upper, values[static_cast<std::size_t>(i < 12 ? i % 2 : i % 5)]);
  }
  return std::move(builder).finish();
}

/// Asks the map's smallest cells one by one: the largest log-odds of the known ones that overlap a box, else
/// 0.
/// @param lower, edge of the box, in sixtieths of a cell.
template <class Map>
float oracle(const Map& map, const std::array<std::int64_t, Map::kDim>& lower, std::int64_t edge) {
  constexpr int D = Map::kDim;
  std::vector<Vector<D>> points{Vector<D>::Zero()};
  for (int a = 0; a < D; ++a) {
    const auto begin = static_cast<double>(lower[static_cast<std::size_t>(a)]);
    std::vector<Vector<D>> longer;
    for (auto k = std::floor(begin / kUnit); k * kUnit < begin + static_cast<double>(edge); ++k)
      for (Vector<D> point : points) {
        point[a] = (k + 0.5) * map.options().min_cell_size;
        longer.push_back(point);
      }
    points = longer;
  }
  float most = 0.0f;
  for (const Vector<D>& point : points) {
    const auto leaf = map.tree().find_leaf(point);
    const float here = leaf ? leaf->cell().log_odds() : 0.0f;
    if (here != 0.0f && (most == 0.0f || here > most)) most = here;
  }
  return most;
}

/// Calls visit(i, j, ...) for numbers of cells along each axis.
template <int D, class Visit>
void for_each_index(std::int64_t from, std::int64_t to, const Visit& visit) {
  std::array<std::int64_t, std::size_t{D}> at;
  at.fill(from);
  for (;;) {
    visit(at);
    int a = D - 1;
    while (a >= 0 && ++at[static_cast<std::size_t>(a)] == to) at[static_cast<std::size_t>(a--)] = from;
    if (a < 0) return;
  }
}

CellState state_of_value(float log_odds) { return state_of(log_odds); }

/// Sixtieths of the map's cells: 1, 1 1/60, 1.5, 5/3, 2, 3.2 and 7 of them.
constexpr std::array<std::int64_t, 7> kEdges = {60, 61, 90, 100, 120, 192, 420};

template <class Map>
class Coarser : public testing::Test {};
using Maps = testing::Types<FixedMap<2, 2>, AdaptiveMap<2, 3>, PaperMap<3, 2>>;
TYPED_TEST_SUITE(Coarser, Maps, );

TYPED_TEST(Coarser, AllWritersFollowOneRule) {
  constexpr int D = TypeParam::kDim;
  int mixed = 0;
  for (const double unit : {0.05, 0.1, 0.3}) {
    if (D == 3 && unit > 0.05) break;  // The oracle takes its time there.
    const auto map = blocks<TypeParam>(unit, 5);
    for (const std::int64_t edge : kEdges) {
      const double size = unit * static_cast<double>(edge) / kUnit;
      const std::string trace = std::to_string(size) + " m from " + std::to_string(unit) + " m";
      SCOPED_TRACE(trace);
      const std::int64_t reach = 32 * kUnit / edge + 2;
      GridGeometry<D> grid;
      grid.cell_size = size;
      grid.lower = Vector<D>::Constant(-static_cast<double>(reach) * size);
      grid.shape.fill(static_cast<std::size_t>(2 * reach));
      std::vector<float> values(grid.size());
      to_grid(
          map, grid, [](const auto& cell) { return cell.log_odds(); }, values.data());
      const auto other = with_cell_size<PaperMap<TypeParam::kBranching, D>>(map, size);
      other.check_invariants();
      EXPECT_EQ(other.options().min_cell_size, size);
      const auto same = with_cell_size<TypeParam>(map, size);
      same.check_invariants();
      std::size_t i = 0;
      for_each_index<D>(-reach, reach, [&](std::array<std::int64_t, D> at) {
        Vector<D> centre;
        for (std::size_t a = 0; a < D; ++a) {
          centre[static_cast<int>(a)] = (static_cast<double>(at[a]) + 0.5) * size;
          at[a] *= edge;
        }
        const float expected = oracle(map, at, edge);
        ASSERT_EQ(values[i], expected) << centre.transpose();
        const auto leaf = other.tree().find_leaf(centre);
        ASSERT_EQ(leaf ? leaf->cell().log_odds() : 0.0f, expected) << centre.transpose();
        ASSERT_EQ(state(same, centre), state_of_value(expected)) << centre.transpose();
        mixed += edge > kUnit && expected != oracle(map, at, 1);
        ++i;
      });
      if constexpr (D == 3) {
        const auto full = octomap_from_bytes<PaperMap<2, 3>>(octomap_bytes(map, OctomapFormat::full, size));
        const auto binary =
            octomap_from_bytes<PaperMap<2, 3>>(octomap_bytes(map, OctomapFormat::binary, size));
        i = 0;
        for_each_index<D>(-reach, reach, [&](const std::array<std::int64_t, D>& at) {
          Vector<3> centre;
          for (int a = 0; a < 3; ++a)
            centre[a] = (static_cast<double>(at[static_cast<std::size_t>(a)]) + 0.5) * size;
          const auto leaf = full.tree().find_leaf(centre);
          ASSERT_EQ(leaf ? leaf->cell().log_odds() : 0.0f, values[i]) << centre.transpose();
          ASSERT_EQ(state(binary, centre), state_of_value(values[i])) << centre.transpose();
          ++i;
        });
      } else {
        MapServerOptions options;
        options.cell_size = size;
        const MapServerImage image = map_server_image(map, options);
        const auto left = std::llround(image.origin.x() / size), low = std::llround(image.origin.y() / size);
        const auto width = static_cast<std::int64_t>(image.width),
                   height = static_cast<std::int64_t>(image.height);
        i = 0;
        for_each_index<2>(-reach, reach, [&](const std::array<std::int64_t, 2>& at) {
          const std::int64_t x = at[0] - left, y = at[1] - low;
          const bool in = x >= 0 && x < width && y >= 0 && y < height;
          const int pixel = in ? image.pixels[static_cast<std::size_t>((height - 1 - y) * width + x)] : 205;
          const CellState expected = state_of_value(values[i++]);
          ASSERT_EQ(pixel, expected == CellState::occupied ? 0 : expected == CellState::free ? 254 : 205);
        });
      }
    }
  }
  EXPECT_GT(mixed, 300);
}

TYPED_TEST(Coarser, GridsMayBeginAnywhere) {
  constexpr int D = TypeParam::kDim;
  const double unit = 0.1;
  const auto map = blocks<TypeParam>(unit, 6);
  Random random(7);
  int known = 0;
  for (const std::int64_t edge : kEdges) {
    if (edge == kUnit) continue;
    GridGeometry<D> grid;
    grid.cell_size = unit * static_cast<double>(edge) / kUnit;
    std::array<std::int64_t, D> lower;
    for (std::size_t a = 0; a < D; ++a) {
      lower[a] = random.integer(-18 * kUnit, 0);
      grid.lower[static_cast<int>(a)] = unit * static_cast<double>(lower[a]) / kUnit;
      grid.shape[a] = static_cast<std::size_t>(random.integer(1, 9));
    }
    std::vector<std::int8_t> states(grid.size());
    to_grid(
        map, grid, [](const auto& cell) { return static_cast<std::int8_t>(cell.state()); }, states.data());
    for (std::size_t i = 0; i < grid.size(); ++i) {
      std::array<std::int64_t, D> at;
      std::size_t rest = i;
      for (std::size_t a = D; a-- > 0; rest /= grid.shape[a])
        at[a] = lower[a] + static_cast<std::int64_t>(rest % grid.shape[a]) * edge;
      ASSERT_EQ(states[i], static_cast<std::int8_t>(state_of_value(oracle(map, at, edge)))) << edge;
      known += states[i] >= 0;
    }
  }
  EXPECT_GT(known, 20);
}

TEST(Coarser, AThinWallStaysAtEverySize) {
  MapOptions options;
  options.min_cell_size = options.max_cell_size = 0.05;
  MapBuilder<FixedMap<2, 3>> builder(options);
  builder.fill({40, 0, 0}, {41, 40, 40}, 1.0f);
  const auto wall = std::move(builder).finish();
  for (const auto& [size, cells] : std::vector<std::pair<double, int>>{{0.1, 400}, {0.2, 100}, {0.4, 25}}) {
    const auto coarse = octomap_from_bytes<FixedMap<2, 3>>(octomap_bytes(wall, OctomapFormat::binary, size));
    EXPECT_EQ(coarse.stats().observed_leaves, static_cast<std::size_t>(cells)) << size;
  }
}

TEST(Coarser, FarFromZeroBordersAreStillWhole) {
  const CellsAlong cells(0.05, 431234.35, 0.1);  // 8624687 cells.
  EXPECT_EQ(cells.border(0), 8624687.0);
  EXPECT_EQ(cells.border(7), 8624701.0);
  EXPECT_EQ(cells.first(8624701), 7);
  EXPECT_EQ(cells.last(8624701), 7);
  EXPECT_EQ(cells.first(8624702), 7);
  EXPECT_EQ(cells.last(8624702), 8);
}

TEST(Coarser, CellsBeginAtTheirBordersAtEverySize) {
  Random random(17);
  for (const double unit : {0.05, 0.1, 0.03, 1.0 / 3.0})
    for (const double units : {1.0, 2.0, 3.0, 7.0, 64.0, 2.5, 1.0 + 1e-10, 1.0001, 0.5, 1.0 / 3.0})
      for (const double begin : {0.0, 5.0, -12.0, 0.25}) {
        const CellsAlong cells(unit, begin * unit, units * unit);
        for (int i = 0; i < 200; ++i) {
          const std::int64_t k =
              i % 2 == 0 ? random.integer(-50, 50) : random.integer(-1000000000, 1000000000);
          const auto at = static_cast<double>(k);
          const std::int64_t first = cells.first(k);
          ASSERT_LE(cells.border(first), at) << unit << " " << units << " " << begin;
          ASSERT_GT(cells.border(first + 1), at) << unit << " " << units << " " << begin;
          const std::int64_t last = cells.last(k);
          ASSERT_LT(cells.border(last - 1), at) << unit << " " << units << " " << begin;
          ASSERT_GE(cells.border(last), at) << unit << " " << units << " " << begin;
        }
      }
}

TEST(Coarser, SmallerCellsAreRefused) {
  const auto map = blocks<AdaptiveMap<2, 2>>(0.1, 3);
  for (const double size : {0.05, 0.0, -1.0, std::nan(""), HUGE_VAL})
    EXPECT_THROW(static_cast<void>(with_cell_size<PaperMap<2, 2>>(map, size)), std::invalid_argument) << size;
}

}  // namespace
}  // namespace ndtree::test::test_coarser
