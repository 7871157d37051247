// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <string>

#include "at_a_time.hpp"
#include "map_kinds.hpp"
#include "ndtree/cell/evidence_summary.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "ndtree/query/region.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test::test_summary {
namespace {

TEST(Summary, BoundsAreOrderedAsLogOddsAndHardlyAbove) {
  Random random(190);
  for (int cases = 0; cases < 20000; ++cases) {
    const auto scale = static_cast<float>(std::exp(random.uniform(-20.0, 3.0)));
    OccupancyCell cell;
    cell.set_log_odds((random.chance(0.5) ? -1.0f : 1.0f) * scale);
    const Summary summary = Summary::of_cell(cell);
    ASSERT_TRUE(summary.is_valid());
    ASSERT_GE(summary.max_log_odds(), cell.log_odds());
    ASSERT_LE(summary.max_log_odds(), cell.log_odds() + scale / 32000.0f);
    for (const CellState state : {CellState::unknown, CellState::free, CellState::occupied})
      ASSERT_EQ(summary.may_contain(state), cell.state() == state);
    OccupancyCell other;
    other.set_log_odds(static_cast<float>(random.uniform(-3.0, 3.0)));
    Summary both = summary;
    both.add(Summary::of_cell(other));
    ASSERT_EQ(both.max_log_odds(), std::max(summary.max_log_odds(), Summary::of_cell(other).max_log_odds()));
    ASSERT_TRUE(both.may_contain(cell.state()) && both.may_contain(other.state()));
  }
  EXPECT_EQ(Summary::of_cell(OccupancyCell{}).max_log_odds(), 0.0f);
  EXPECT_FALSE(Summary().is_valid());
  EXPECT_TRUE(Summary().may_contain(CellState::occupied)) << "what is not known may be";
}

template <class Map>
class SummaryOf : public ::testing::Test {};
TYPED_TEST_SUITE(SummaryOf, MapKinds);

/// Where a ray ends that skips nothing [m]: at an occupied leaf, or where it would go into the unknown from
/// one in which beams may have ended.
template <class Map>
std::optional<double> end_by_all_leaves(const Map& map, const Vector<Map::kDim>& origin,
                                        const Vector<Map::kDim>& direction, double max_range) {
  const double length = direction.norm();
  std::optional<double> end;
  std::optional<double> before;  // In the leaf before.
  double last = 0.0;
  traverse_beam(map.tree(), origin, direction, 0.0, max_range / length,
                [&](const auto& leaf, double t_enter, double t_exit) {
                  last = t_exit;
                  const CellState state = leaf.cell().state();
                  if (!end && state == CellState::occupied) end = t_enter;
                  if (!end && state == CellState::unknown) end = before;
                  before.reset();
                  if (state == CellState::free && detail::may_end_beams(leaf.cell()))
                    before = std::max(t_enter, t_exit - map.options().min_cell_size / length);
                });
  if (!end && last < max_range / length) end = before;
  if (end) *end *= length;
  return end;
}

/// Queries that use summaries, against all leaves one by one, while the map grows, merges and is compressed.
TYPED_TEST(SummaryOf, QueriesEqualThoseOverAllLeaves) {
  using Map = TypeParam;
  constexpr int D = Map::kDim;
  Random random(191);
  Map map(spelled_out_options(0.1, 0.1 * Map::kBranching * Map::kBranching));
  int with_occupied = 0;
  int all_free = 0;
  for (int i = 0; i < 12; ++i) {
    Scan<D> scan;
    const int count = i < 6 ? 60 : 300;
    scan.origins = Vector<D>::Constant(random.uniform(-0.3, 0.3));
    scan.endpoints.resize(D, count);
    for (Eigen::Index k = 0; k < count; ++k)
      for (int a = 0; a < D; ++a)
        scan.endpoints(a, k) = a == 0 && random.chance(0.7) ? (i < 9 ? 1.2 : 1.8) : random.uniform(-1.5, 1.5);
    map.insert(scan, kUnlimitedRange, 1 + i % 3);
    if constexpr (Map::RefinementType::kAdaptive && !std::is_same_v<typename Map::Cell, OccupancyCell>) {
      if (i == 7) map.compress({30.0, {}, {}});
    }
    ASSERT_NO_THROW(map.check_invariants());
    const Map copy = i == 10 ? from_bytes<Map>(to_bytes(map)) : map;
    ASSERT_NO_THROW(copy.check_invariants());
    for (int k = 0; k < 40; ++k) {
      Box<D> region;
      const double size = std::exp(random.uniform(-4.0, 1.0));
      for (int a = 0; a < D; ++a) region.lower[a] = random.uniform(-2.0, 2.0);
      region.upper = region.lower.array() + size;
      RegionStates expected;
      const Box<D> root = copy.tree().box(copy.tree().root().index);
      const bool outside = (region.lower.array() < root.lower.array()).any() ||
                           (region.upper.array() > root.upper.array()).any();
      expected.unknown = outside;
      double most = outside ? 0.5 : 0.0;
      bool near = false;
      const double radius = 0.5 * size;
      for_each_leaf(copy.tree(), [&](const auto& leaf) {
        const Box<D> box = copy.tree().box(leaf.index);
        const CellState state = leaf.cell().state();
        near =
            near || (state == CellState::occupied && box.squared_distance(region.lower) <= radius * radius);
        if (!region.touches(box)) return;
        expected.occupied = expected.occupied || state == CellState::occupied;
        expected.free = expected.free || state == CellState::free;
        expected.unknown = expected.unknown || state == CellState::unknown;
        most = std::max(most, leaf.cell().probability());
      });
      const RegionStates states = states_in(copy, region);
      ASSERT_EQ(states.occupied, expected.occupied);
      ASSERT_EQ(states.free, expected.free);
      ASSERT_EQ(states.unknown, expected.unknown);
      ASSERT_EQ(max_probability(copy, region), most);
      ASSERT_EQ(occupied_within(copy, region.lower, radius), near);
      with_occupied += states.occupied;
      all_free += states.free && !states.occupied && !states.unknown;
    }
    for (int k = 0; k < 40; ++k) {
      Vector<D> from;
      Vector<D> direction;
      for (int a = 0; a < D; ++a) {
        from[a] = random.uniform(-1.0, 1.0);
        direction[a] = random.uniform(-1.0, 1.0);
      }
      ASSERT_EQ(cast_ray(copy, from, direction, 5.0, RayAim::cell),
                end_by_all_leaves(copy, from, direction, 5.0));
    }
  }
  EXPECT_GT(with_occupied, 20);
  EXPECT_GT(all_free, 0);
}

TEST(Summary, NodesOfSaturatedLeavesSayThatTheyAreUntilOneIsHit) {
  MapOptions options = spelled_out_options(0.25, 1.0);
  options.free_memory = 2.0;
  AdaptiveMap<2, 2> map(options);
  constexpr Eigen::Index kBeams = 3000;
  Scan<2> scan;
  scan.origins = Vector<2>(0.1, 0.2);
  scan.endpoints.resize(2, kBeams);
  for (Eigen::Index i = 0; i < kBeams; ++i) {
    const double angle = 2.0 * 3.14159265358979323846 * static_cast<double>(i) / kBeams;
    scan.endpoints.col(i) = scan.origins.col(0) + 9.0 * Vector<2>(std::cos(angle), std::sin(angle));
  }
  const auto saturated_nodes = [&] {
    map.check_invariants();  // Which compares summaries with all leaves.
    int saturated = 0;
    for_each_node(map.tree(), [&](const auto& ref) {
      saturated += static_cast<int>(!ref.is_leaf() && Summary(ref.node->summary_word()).is_saturated());
    });
    return saturated;
  };
  EXPECT_EQ(saturated_nodes(), 0);
  for (int i = 0; i < 20; ++i) map.insert(scan);
  const int before = saturated_nodes();
  EXPECT_GT(before, 20);
  Scan<2> hits;  // Something stands in the middle of a saturated node now.
  hits.origins = scan.origins;
  hits.endpoints.resize(2, 200);
  for (Eigen::Index i = 0; i < 200; ++i)
    hits.endpoints.col(i) = Vector<2>(4.1, 4.1 + 0.01 * static_cast<double>(i % 20));
  for (int i = 0; i < 3; ++i) map.insert(hits);
  EXPECT_EQ(state(map, Vector<2>(4.1, 4.15)), CellState::occupied);
  EXPECT_LT(saturated_nodes(), before);
}

/// Nodes of all kinds that siblings may be.
template <int kCount>
void check_summaries_of_siblings(Random& random) {
  MapOptions options;
  if (random.chance(0.2)) options.evidence_half_life = 10.0;
  const EvidenceModel model(options, options);
  std::array<Node<EvidenceCell>, kCount> siblings;
  const bool are_much_alike = random.chance(0.7);
  const int kind_of_most = random.integer(0, 5);
  for (auto& sibling : siblings) {
    EvidenceCell cell;
    switch (are_much_alike && random.chance(0.95) ? kind_of_most : random.integer(0, 5)) {
      case 0:
        break;
      case 1:
        cell.set_partly_seen(static_cast<std::uint32_t>(random.integer(0, 255)), random.integer(0, 1000));
        break;
      case 2:
        cell = model.saturated();
        break;
      case 3:
        model.assign(cell, 0, random.integer(0, 2000));
        break;
      case 4:
        model.assign(cell, random.integer(0, 2000), random.integer(0, 100));
        break;
      default: {
        Summary summary = Summary::of_cell(model.saturated(), random.chance(0.5));
        if (random.chance(0.3)) summary.add(Summary::of_cell(EvidenceCell{}));
        sibling.become_inner(static_cast<BlockId>(random.integer(0, 1000)));
        sibling.set_summary_word(random.chance(0.2) ? 0 : summary.word());
        continue;
      }
    }
    sibling.become_leaf(cell);
  }
  const SummaryOfSiblings expected = summary_of_siblings(
      siblings.data(), kCount, [&](const EvidenceCell& cell) { return model.is_saturated(cell); });
  for (const int width : {1, 8}) {
    const AtATime loops(width);
    const SummaryOfSiblings all = EvidenceSummary<kCount>(model)(siblings.data());
    ASSERT_EQ(all.summary.word(), expected.summary.word());
    ASSERT_EQ(all.are_leaves, expected.are_leaves);
  }
}

TEST(EvidenceSummary, IsTheSameEightAtATime) {
  Random random(64);
  for (int i = 0; i < 3000 && !HasFailure(); ++i) {
    check_summaries_of_siblings<2>(random);
    check_summaries_of_siblings<4>(random);
    check_summaries_of_siblings<8>(random);
    check_summaries_of_siblings<9>(random);
    check_summaries_of_siblings<27>(random);
  }
}

}  // namespace
}  // namespace ndtree::test::test_summary
