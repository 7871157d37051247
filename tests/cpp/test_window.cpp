// SPDX-License-Identifier: BSD-3-Clause
// Insertion into a part of a map, against insertion into all of it.
#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>

#include "ndtree/mapping/occupancy_map.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_window {
namespace {

template <int D>
Scan<D> random_scan(Random& random, Eigen::Index beams) {
  Scan<D> scan;
  scan.origins.resize(D, 1);
  scan.endpoints.resize(D, beams);
  scan.returned.resize(beams);
  for (int a = 0; a < D; ++a) scan.origins(a, 0) = random.uniform(-2.0, 2.0);
  for (Eigen::Index i = 0; i < beams; ++i) {
    for (int a = 0; a < D; ++a) scan.endpoints(a, i) = random.uniform(-5.0, 5.0);
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}

/// Each leaf of one map that lies in some region is a leaf of the other, with the same cell. Unknown space
/// may be divided otherwise. @returns how many were compared.
template <class Map, class IsIn>
std::size_t expect_same(const Map& one, const Map& other, const IsIn& is_in) {
  std::size_t compared = 0;
  for_each_leaf(one.tree(), [&](const auto& leaf) {
    if (!is_in(leaf.index) || leaf.index.level > 0) return;
    const auto there = other.tree().find_leaf(leaf.index.lower);
    const bool is_blank = leaf.cell() == typename Map::Cell{};
    if (is_blank) {
      ASSERT_TRUE(!there || there->cell() == typename Map::Cell{});
      return;
    }
    ASSERT_TRUE(there.has_value());
    ASSERT_EQ(there->index, leaf.index);
    ASSERT_EQ(there->cell(), leaf.cell());
    ++compared;
  });
  return compared;
}

template <class Map>
class Window : public testing::Test {};
using Maps = testing::Types<AdaptiveMap<3, 2>, AdaptiveMap<2, 3>, PaperMap<2, 2>, FixedMap<2, 2>>;
TYPED_TEST_SUITE(Window, Maps);

TYPED_TEST(Window, BecomesWhatItWouldAndNothingElseChanges) {
  constexpr int N = TypeParam::kBranching;
  constexpr int D = TypeParam::kDim;
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 0.25 * N * N;
  options.range_sigma = 0.1;
  Random random(7);
  std::size_t inside = 0;
  std::size_t outside = 0;
  for (int round = 0; round < 30; ++round) {
    TypeParam before(options);
    for (int i = random.integer(0, 2); i > 0; --i) before.insert(random_scan<D>(random, 30));
    Box<D> window{Vector<D>::Zero(), Vector<D>::Zero()};
    for (int a = 0; a < D; ++a) {
      window.lower[a] = random.uniform(-6.0, 3.0);
      window.upper[a] = window.lower[a] + random.uniform(0.1, 5.0);
      if (random.chance(0.2)) window.upper[a] = std::ceil(window.upper[a]);  // On a border of cells.
      if (random.chance(0.2)) window.lower[a] = std::floor(window.lower[a]);
    }
    const Scan<D> scan = random_scan<D>(random, round % 3 == 0 ? 3000 : 30);
    TypeParam whole = before;
    TypeParam part = before;
    whole.insert(scan, kUnlimitedRange, 1);
    const InsertReport report = part.insert(scan, kUnlimitedRange, 1 + round % 2, window);
    EXPECT_EQ(report.beams, static_cast<std::uint64_t>(scan.size()));
    part.check_invariants();
    const double size = TypeParam::RefinementType::kAdaptive ? options.max_cell_size : options.min_cell_size;
    const auto is_in = [&](const CellIndex<D>& index) {
      Box<D> cell = whole.tree().box(index);
      for (int a = 0; a < D; ++a) {  // The cell of the coarsest size around it.
        cell.lower[a] = std::floor(cell.lower[a] / size + 1e-9) * size;
        cell.upper[a] = cell.lower[a] + size;
      }
      return cell.overlaps(window);
    };
    const auto is_out = [&](const CellIndex<D>& index) { return !is_in(index); };
    inside += expect_same(whole, part, is_in);
    expect_same(part, whole, is_in);
    outside += expect_same(before, part, is_out);
    expect_same(part, before, is_out);
    if (this->HasFatalFailure()) return;
  }
  EXPECT_GT(inside, 500u);
  EXPECT_GT(outside, 500u);
}

TEST(WindowOfAMap, MustHaveAVolume) {
  AdaptiveMap<2, 2> map;
  Scan<2> scan;
  scan.origins = Vector<2>::Zero();
  scan.endpoints = Vector<2>(1.0, 1.0);
  const Box<2> flat{Vector<2>(0.0, 0.0), Vector<2>(1.0, 0.0)};
  EXPECT_EQ(refusal_by([&] { map.insert(scan, kUnlimitedRange, 1, flat); }),
            "box from (0.0, 0.0) to (1.0, 0.0): must be finite, and have a volume");
  EXPECT_EQ(map.stats().observed_leaves, 0u);
}

}  // namespace
}  // namespace ndtree::test::test_window
