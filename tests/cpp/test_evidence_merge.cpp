// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <vector>

#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/tree/node_pool.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test::test_evidence_merge {
namespace {

constexpr double kHit = 0.84729786038720367;  // log(0.7 / 0.3), of probability_max [nats].
constexpr double kMiss = 104.0 / 256.0;       // log(0.6 / 0.4) in whole units, of probability_min.
constexpr double kSureToJoin = 1000.0;        // Bits.
const MapOptions& base_options() {
  static const MapOptions kOptions = spelled_out_options(0.05, 1.6);
  return kOptions;
}
const EvidenceModel& model() {
  static const EvidenceModel kModel(base_options(), base_options());
  return kModel;
}

EvidenceMergeRule rule_with(double merge_loss) {
  EvidenceMergeOptions options;
  options.merge_loss = merge_loss;
  return EvidenceMergeRule(options, model());
}

EvidenceCell cell_of(std::int64_t occupied, std::int64_t free, std::uint32_t hits = 0,
                     std::uint32_t misses = 0) {
  EvidenceCell cell;
  model().assign(cell, occupied, free);
  cell.set_counts(hits, misses);
  return cell;
}

std::vector<Node<EvidenceCell>> nodes_of(const std::vector<EvidenceCell>& cells) {
  std::vector<Node<EvidenceCell>> nodes(cells.size());
  for (std::size_t j = 0; j < cells.size(); ++j) nodes[j].become_leaf(cells[j]);
  return nodes;
}

std::optional<EvidenceCell> merged(double merge_loss, const std::vector<EvidenceCell>& cells,
                                   int children_across) {
  const auto nodes = nodes_of(cells);
  return rule_with(merge_loss)(nodes.data(), static_cast<int>(nodes.size()), children_across);
}

/// Of B(h + a, m + 1) / B(a, 1), the product over the cells against that of their sums [bits].
double bits_for_many(const std::vector<EvidenceCell>& cells, double a) {
  const auto log_evidence = [&](double h, double m) {
    return std::lgamma(h + a) + std::lgamma(m + 1.0) - std::lgamma(h + m + a + 1.0) -
           (std::lgamma(a) + std::lgamma(1.0) - std::lgamma(a + 1.0));
  };
  double apart = 0.0;
  double hits = 0.0;
  double misses = 0.0;
  for (const EvidenceCell& cell : cells) {
    const double h = static_cast<double>(cell.occupied_evidence()) / 256.0 / kHit;
    const double m = static_cast<double>(cell.free_evidence()) / 256.0 / kMiss;
    apart += log_evidence(h, m);
    hits += h;
    misses += m;
  }
  return (apart - log_evidence(hits, misses)) / std::log(2.0);
}

/// Bits that the siblings' merge loses for each cell that it saves.
double loss_of(const std::vector<EvidenceCell>& cells, int share = 2) {
  const double q =
      rule_with(0.0).join(nodes_of(cells).data(), static_cast<int>(cells.size()), share).cell.probability();
  double divergence = 0.0;
  for (const EvidenceCell& cell : cells) {
    const double p = cell.probability();
    divergence += p * std::log(p / q) + (1.0 - p) * std::log((1.0 - p) / (1.0 - q));
  }
  return (std::max(0.0, bits_for_many(cells, 0.1)) + std::max(0.0, divergence) / std::log(2.0)) /
         static_cast<double>(cells.size() - 1);
}

TEST(EvidenceMerge, ByHand) {
  const EvidenceCell free = cell_of(0, 2080);  // 20 beams that passed.
  const EvidenceCell once = cell_of(0, 104);   // One beam that passed.
  const EvidenceCell little = cell_of(0, 1);   // As good as nothing.
  const EvidenceCell less_free = cell_of(500, 2080);
  const EvidenceCell nearly_occupied = cell_of(2000, 2080);  // Free still.
  const EvidenceCell occupied = cell_of(2170, 208);          // 10 hits, 2 misses.
  const EvidenceCell balanced = cell_of(500, 500);
  const EvidenceCell unknown;
  struct Row {
    const char* what;
    std::vector<EvidenceCell> cells;
    double merge_loss;
    bool merges;
  };
  const Row rows[] = {
      {"all free", {free, free, free, free}, 0.0, true},
      {"all occupied", {occupied, occupied, occupied, occupied}, 0.05, true},
      {"as much as one beam", {free, once, once, free}, 1.0, true},
      {"as good as nothing", {free, free, free, little}, kSureToJoin, false},
      {"different, and that matters", {free, free, free, less_free}, 0.5, false},
      {"the same, were it not held against them", {free, free, free, less_free}, 20.0, true},
      {"one that is not clearly free", {free, free, free, nearly_occupied}, kSureToJoin, false},
      {"free and occupied", {free, free, free, occupied}, kSureToJoin, false},
      {"occupied and free", {occupied, free, free, free}, kSureToJoin, false},
      {"the last not observed", {free, free, free, unknown}, kSureToJoin, false},
      {"the first not observed", {unknown, free, free, free}, kSureToJoin, false},
      {"none observed", {unknown, unknown, unknown, unknown}, kSureToJoin, false},
      {"balanced evidence", {balanced, balanced, balanced, balanced}, kSureToJoin, false},
      {"one with balanced evidence", {free, balanced, free, free}, kSureToJoin, false}};
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    EXPECT_EQ(merged(row.merge_loss, row.cells, 2).has_value(), row.merges) << loss_of(row.cells);
  }
}

TEST(EvidenceMerge, DividedSiblingsStay) {
  const EvidenceCell free = cell_of(0, 2080);
  for (std::size_t inner = 0; inner < 4; ++inner) {
    auto nodes = nodes_of({free, free, free, free});
    const EvidenceMergeRule rule = rule_with(kSureToJoin);
    ASSERT_TRUE(rule(nodes.data(), 4, 2).has_value());
    nodes[inner].become_inner(7);
    EXPECT_FALSE(rule(nodes.data(), 4, 2).has_value());
  }
}

TEST(EvidenceMerge, TheLossDecidesAmongSiblingsOfOneState) {
  Random random(151);
  int joined = 0;
  int apart = 0;
  int too_different = 0;
  for (int cases = 0; cases < 6000; ++cases) {
    const auto count = static_cast<std::size_t>(random.chance(0.5) ? 4 : 9);
    const int share = count == 4 ? 2 : 3;
    const bool is_free = random.chance(0.5);
    std::vector<EvidenceCell> cells;
    std::int64_t occupied = 0;
    std::int64_t free = 0;
    std::uint32_t hits = 0;
    std::uint32_t misses = 0;
    for (std::size_t j = 0; j < count; ++j) {
      const int more = random.integer(1, 20000);
      // Now and then nearly of the other state.
      const auto less = static_cast<int>(more * (random.chance(0.5) ? 0.05 : 0.99) * random.uniform());
      cells.push_back(is_free ? cell_of(less, more, static_cast<std::uint32_t>(random.integer(0, 20)),
                                        static_cast<std::uint32_t>(random.integer(0, 20)))
                              : cell_of(more, less, 3, 1));
      occupied += cells.back().occupied_evidence();
      free += cells.back().free_evidence();
      hits += cells.back().hits();
      misses += cells.back().misses();
    }
    const auto unclear = [](const EvidenceCell& cell) { return cell.log_odds() > -0.5f; };
    if (is_free ? std::any_of(cells.begin(), cells.end(), unclear) : bits_for_many(cells, 1.0) > -1.0) {
      ASSERT_FALSE(merged(kSureToJoin, cells, share).has_value());
      ++too_different;
      continue;
    }
    const double loss = loss_of(cells, share);
    constexpr double kRounding = 1e-6;  // Of log-odds to float.
    if (loss < 2.0 * kRounding) {       // One cell explains them better than many: nothing is lost.
      ASSERT_TRUE(merged(0.0, cells, share).has_value() || loss > 0.0);
      continue;
    }
    ASSERT_FALSE(merged(loss - kRounding, cells, share).has_value()) << loss;
    ++apart;
    const auto parent = merged(loss + kRounding, cells, share);
    ASSERT_TRUE(parent.has_value()) << loss;
    ++joined;
    // A beam that crosses the parent crosses `share` of its children: the mean, times that, rounded up.
    const auto whole = static_cast<std::int64_t>(count);
    const auto scaled = [&](std::int64_t sum) { return (sum * share + whole - 1) / whole; };
    EvidenceCell expected = cell_of(scaled(occupied), scaled(free), static_cast<std::uint32_t>(scaled(hits)),
                                    static_cast<std::uint32_t>(scaled(misses)));
    expected.set_known_levels(1);
    ASSERT_EQ(*parent, expected);
    ASSERT_TRUE(parent->observed());
    ASSERT_EQ(parent->state(), is_free ? CellState::free : CellState::occupied);
  }
  EXPECT_GT(joined, 800);
  EXPECT_GT(apart, 800);
  EXPECT_GT(too_different, 300);
}

TEST(EvidenceMerge, ASplitUndoneIsNearlyIdentity) {
  Random random(152);
  struct Row {
    int count, share;
  };
  for (const Row& row : {Row{2, 1}, Row{4, 2}, Row{9, 3}, Row{25, 5}, Row{8, 4}, Row{27, 9}, Row{16, 8}})
    for (int i = 0; i < 300; ++i) {
      const int more = random.integer(5000, 40000);
      const int less = random.integer(0, more / 2) * (random.chance(0.7) ? 1 : 0);
      const EvidenceCell parent = cell_of(less, more, 350, 450);
      const auto beams = static_cast<std::size_t>(100 * row.share);
      const std::vector<EvidenceCell> children(static_cast<std::size_t>(row.count),
                                               model().initial_child(parent, row.share, 100, beams));
      const auto again = merged(1.0, children, row.share);
      ASSERT_TRUE(again.has_value()) << "nothing tells the children apart";
      ASSERT_NEAR(static_cast<double>(again->occupied_evidence()),
                  static_cast<double>(parent.occupied_evidence()), row.share);
      ASSERT_NEAR(static_cast<double>(again->free_evidence()), static_cast<double>(parent.free_evidence()),
                  row.share);
      ASSERT_EQ(again->hits() + again->misses(), 0u) << "counted anew";
      ASSERT_EQ(again->state(), parent.state());
    }
}

TEST(EvidenceMerge, WhatWasObservedBeforeAMergeIsKnownAfterASplit) {
  Random random(157);
  int known = 0;
  int covered = 0;
  for (int i = 0; i < 2000; ++i) {
    const int depth = random.integer(1, 4);
    std::vector<EvidenceCell> finest;
    for (int j = 0; j < 1 << (2 * depth); ++j) {
      finest.push_back(cell_of(0, random.integer(2000, 4000), 0, 9));
      finest.back().set_covered(random.chance(0.995));
    }
    const bool all_covered =
        std::all_of(finest.begin(), finest.end(), [](const EvidenceCell& cell) { return cell.is_covered(); });
    std::vector<EvidenceCell> level = finest;  // Four merge at a time, up to one cell.
    while (level.size() > 1) {
      std::vector<EvidenceCell> above;
      for (std::size_t first = 0; first < level.size(); first += 4) {
        const auto cell = merged(kSureToJoin,
                                 {level.begin() + static_cast<std::ptrdiff_t>(first),
                                  level.begin() + static_cast<std::ptrdiff_t>(first) + 4},
                                 2);
        ASSERT_TRUE(cell.has_value());
        above.push_back(*cell);
      }
      level = above;
    }
    EvidenceCell cell = level.front();
    ASSERT_EQ(cell.is_covered(), all_covered);
    ASSERT_EQ(cell.known_levels(), static_cast<unsigned>(depth));
    ASSERT_EQ(EvidenceCell::from_words(cell.words()), cell);
    for (; cell.known_levels() > 0; ++known) {  // None of many beams passes the child.
      const EvidenceCell child = model().initial_child(cell, 2, 0, 500, 0, true, false);
      ASSERT_EQ(child.state(), CellState::free);
      ASSERT_EQ(child.known_levels(), cell.known_levels() - 1);
      cell = child;
    }
    if (!all_covered) {
      const EvidenceCell below = model().initial_child(cell, 2, 0, 500, 0, true, false);
      ASSERT_FALSE(below.observed()) << "nobody saw that";
    }
    covered += all_covered;
  }
  EXPECT_GT(known, 4000);
  EXPECT_GT(covered, 300);
}

}  // namespace
}  // namespace ndtree::test::test_evidence_merge
