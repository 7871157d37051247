// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>

#include "ndtree/io/map_builder.hpp"
#include "ndtree/map.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_map_builder {
namespace {

template <class Shape>
class MapBuilderOf : public ::testing::Test {};
TYPED_TEST_SUITE(MapBuilderOf, test::TwoShapes, test::ShapeNames);

template <int D>
Lattice<D> filled(std::int64_t value) {
  Lattice<D> result;
  result.fill(value);
  return result;
}

/// Calls visit(cell) for the cells of a box.
template <int D, class Visit>
void for_each_cell(const Lattice<D>& lower, const Lattice<D>& upper, const Visit& visit) {
  for (Lattice<D> at = lower;;) {
    visit(at);
    std::size_t a = 0;
    while (a < D && ++at[a] == upper[a]) {
      at[a] = lower[a];
      ++a;
    }
    if (a == D) return;
  }
}

TYPED_TEST(MapBuilderOf, BoxesInAnyOrderAreAsCellByCell) {
  NDTREE_SHAPE;
  using Map = PaperMap<N, D>;
  Random random(31);
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.1 * N * N;
  int checked = 0;
  for (int round = 0; round < 8; ++round) {
    MapBuilder<Map> builder(options);
    std::map<Lattice<D>, float> cells;
    for (int i = 0; i < 80; ++i) {
      Lattice<D> lower, upper;
      for (std::size_t a = 0; a < D; ++a) {
        lower[a] = random.integer(-20, 20) *
                   (i == 40 ? 9 : 1);  // Once far away: the root grows, and goes on near 0.
        upper[a] = lower[a] + random.integer(1, i < 4 ? 9 : 2);
      }
      const auto value = static_cast<float>(random.integer(-2, 2)) * 0.5f;
      const bool raises = random.chance(0.3);
      if (raises)
        builder.raise(lower, upper, value);
      else
        builder.fill(lower, upper, value);
      for_each_cell<D>(lower, upper, [&](const Lattice<D>& at) {
        float& now = cells[at];
        if (!raises || now == 0.0f || now < value) now = value;
      });
    }
    const Map map = std::move(builder).finish();
    map.check_invariants();
    for_each_cell<D>(filled<D>(-22), filled<D>(30), [&](const Lattice<D>& at) {
      Vector<D> centre;
      for (int a = 0; a < D; ++a)
        centre[a] = 0.1 * (static_cast<double>(at[static_cast<std::size_t>(a)]) + 0.5);
      const auto found = cells.find(at);
      ASSERT_EQ(cell_at(map, centre).log_odds(), found == cells.end() ? 0.0f : found->second)
          << centre.transpose();
      ++checked;
    });
  }
  EXPECT_GT(checked, 50);
}

}  // namespace
}  // namespace ndtree::test::test_map_builder
