// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/tree/node_pool.hpp"
#include "options.hpp"
#include "random.hpp"

namespace ndtree::test {
namespace {

constexpr double kHit = 0.8 * 0.84729786038720367;  // occupied_weight of log(0.7 / 0.3) [nats].
constexpr double kMiss = 104.0 / 256.0;             // log(0.6 / 0.4) in whole units, of probability_min.
constexpr double kSureToJoin = 1000.0;              // Bits.
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
                                   int share_divisor) {
  const auto nodes = nodes_of(cells);
  return rule_with(merge_loss)(nodes.data(), static_cast<int>(nodes.size()), share_divisor);
}

/// log of B(h + 0.1, m + 1) / B(0.1, 1), spelled out.
double log_evidence_of(double h, double m) {
  return std::lgamma(h + 0.1) + std::lgamma(m + 1.0) - std::lgamma(h + m + 1.1) -
         (std::lgamma(0.1) + std::lgamma(1.0) - std::lgamma(1.1));
}

/// Bits that the siblings' merge loses for each cell that it saves.
double loss_of(const std::vector<EvidenceCell>& cells, int share = 2) {
  double apart = 0.0;
  double hits = 0.0;
  double misses = 0.0;
  for (const EvidenceCell& cell : cells) {
    const double h = static_cast<double>(cell.occupied_evidence()) / 256.0 / kHit;
    const double m = static_cast<double>(cell.free_evidence()) / 256.0 / kMiss;
    apart += log_evidence_of(h, m);
    hits += h;
    misses += m;
  }
  const double q =
      rule_with(0.0).join(nodes_of(cells).data(), static_cast<int>(cells.size()), share).cell.probability();
  double divergence = 0.0;
  for (const EvidenceCell& cell : cells) {
    const double p = cell.probability();
    divergence += p * std::log(p / q) + (1.0 - p) * std::log((1.0 - p) / (1.0 - q));
  }
  return (std::max(0.0, apart - log_evidence_of(hits, misses)) + std::max(0.0, divergence)) / std::log(2.0) /
         static_cast<double>(cells.size() - 1);
}

TEST(EvidenceMerge, LogEvidenceIsThatOfASequenceOfBeams) {
  // The probability of each beam, given those before, is a share of the counts so far: Pólya's urn.
  int cases = 0;
  for (int hits = 0; hits <= 40; ++hits)
    for (int misses = 0; misses <= 40; ++misses, ++cases) {
      long double sum = 0.0L;
      for (int i = 0; i < hits; ++i) sum += std::log((0.1L + i) / (1.1L + i));
      for (int j = 0; j < misses; ++j) sum += std::log((1.0L + j) / (1.1L + hits + j));
      ASSERT_NEAR(EvidenceMergeRule::log_evidence(hits, misses), static_cast<double>(sum), 1e-10)
          << hits << ", " << misses;
    }
  EXPECT_EQ(cases, 41 * 41);
  EXPECT_EQ(EvidenceMergeRule::log_evidence(0.0, 0.0), 0.0);
}

TEST(EvidenceMerge, LogEvidenceIsAnIntegral) {
  // Over rho = u^10, of which u is uniform under Beta(0.1, 1).
  Random random(150);
  SCOPED_TRACE(random.trace());
  int cases = 0;
  for (; cases < 40; ++cases) {
    const double h = random.uniform(0.0, 20.0);
    const double m = random.uniform(1.0, 50.0);
    constexpr int kPieces = 20000;
    long double sum = 0.0L;
    for (int i = 0; i < kPieces; ++i) {
      const long double u = (i + 0.5L) / kPieces;
      sum += std::exp(10.0L * h * std::log(u) + m * std::log1p(-std::pow(u, 10.0L)));
    }
    const auto expected = static_cast<double>(std::log(sum / kPieces));
    ASSERT_NEAR(EvidenceMergeRule::log_evidence(h, m), expected, 1e-5) << h << ", " << m;
  }
  EXPECT_EQ(cases, 40);
}

TEST(EvidenceMerge, ByHand) {
  const EvidenceCell free = cell_of(0, 2080);                // 20 beams that passed.
  const EvidenceCell little = cell_of(0, 1);                 // As good as nothing.
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
      {"as much as one unit", {free, little, little, free}, 1.0, true},
      {"different, and that matters", {free, free, free, nearly_occupied}, 0.5, false},
      {"the same, were it not held against them", {free, free, free, nearly_occupied}, 20.0, true},
      {"free and occupied", {free, free, free, occupied}, kSureToJoin, false},
      {"occupied and free", {occupied, free, free, free}, kSureToJoin, false},
      {"the last not observed", {free, free, free, unknown}, kSureToJoin, false},
      {"the first not observed", {unknown, free, free, free}, kSureToJoin, false},
      {"none observed", {unknown, unknown, unknown, unknown}, kSureToJoin, false},
      {"balanced evidence", {balanced, balanced, balanced, balanced}, kSureToJoin, false},
      {"one with balanced evidence", {free, balanced, free, free}, kSureToJoin, false}};
  int cases = 0;
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    EXPECT_EQ(merged(row.merge_loss, row.cells, 2).has_value(), row.merges) << loss_of(row.cells);
    ++cases;
  }
  EXPECT_EQ(cases, 12);
}

TEST(EvidenceMerge, DividedSiblingsStay) {
  const EvidenceCell free = cell_of(0, 2080);
  int cases = 0;
  for (std::size_t inner = 0; inner < 4; ++inner, ++cases) {
    auto nodes = nodes_of({free, free, free, free});
    const EvidenceMergeRule rule = rule_with(kSureToJoin);
    ASSERT_TRUE(rule(nodes.data(), 4, 2).has_value());
    nodes[inner].become_inner(7);
    EXPECT_FALSE(rule(nodes.data(), 4, 2).has_value());
  }
  EXPECT_EQ(cases, 4);
}

TEST(EvidenceMerge, TheLossDecidesAmongSiblingsOfOneState) {
  Random random(151);
  SCOPED_TRACE(random.trace());
  int joined = 0;
  int apart = 0;
  int cases = 0;
  for (; cases < 6000; ++cases) {
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
    const double loss = loss_of(cells, share);
    if (loss < 1e-6) {  // One cell explains them better than many: nothing is lost.
      ASSERT_TRUE(merged(0.0, cells, share).has_value() || loss > 0.0);
      continue;
    }
    ASSERT_FALSE(merged(loss * (1.0 - 1e-7), cells, share).has_value()) << loss;
    ++apart;
    const auto parent = merged(loss * (1.0 + 1e-7), cells, share);
    ASSERT_TRUE(parent.has_value()) << loss;
    ++joined;
    // A beam that crosses the parent crosses `share` of its children: the mean, times that, rounded up.
    const auto whole = static_cast<std::int64_t>(count);
    const auto scaled = [&](std::int64_t sum) { return (sum * share + whole - 1) / whole; };
    ASSERT_EQ(*parent, cell_of(scaled(occupied), scaled(free), static_cast<std::uint32_t>(scaled(hits)),
                               static_cast<std::uint32_t>(scaled(misses))));
    ASSERT_TRUE(parent->observed());
    ASSERT_EQ(parent->state(), is_free ? CellState::free : CellState::occupied);
  }
  EXPECT_EQ(cases, 6000);
  EXPECT_GT(joined, 1000);
  EXPECT_GT(apart, 1000);
}

TEST(EvidenceMerge, ASplitUndoneIsNearlyIdentity) {
  Random random(152);
  SCOPED_TRACE(random.trace());
  struct Row {
    int count, share;
  };
  int cases = 0;
  for (const Row& row : {Row{2, 1}, Row{4, 2}, Row{9, 3}, Row{25, 5}, Row{8, 4}, Row{27, 9}, Row{16, 8}})
    for (int i = 0; i < 300; ++i, ++cases) {
      const int more = random.integer(5000, 40000);
      const int less = random.integer(0, more / 2) * (random.chance(0.7) ? 1 : 0);
      const bool is_free = random.chance(0.5);
      const EvidenceCell parent = is_free ? cell_of(less, more, 700, 900) : cell_of(more, less, 800, 40);
      const auto share = static_cast<std::int64_t>(row.share);
      const auto again = merged(1.0,
                                std::vector<EvidenceCell>(static_cast<std::size_t>(row.count),
                                                          model().inherited(parent, row.share)),
                                row.share);
      ASSERT_TRUE(again.has_value()) << "nothing tells the children apart";
      ASSERT_EQ(again->occupied_evidence(), parent.occupied_evidence() / share * share);
      ASSERT_EQ(again->free_evidence(), parent.free_evidence() / share * share);
      ASSERT_NEAR(again->hits(), parent.hits(), row.share - 1);
      ASSERT_NEAR(again->misses(), parent.misses(), row.share - 1);
      ASSERT_EQ(again->state(), parent.state());
      // Of what can be divided, nothing is lost.
      ASSERT_EQ(*merged(1.0,
                        std::vector<EvidenceCell>(static_cast<std::size_t>(row.count),
                                                  model().inherited(*again, row.share)),
                        row.share),
                *again);
    }
  EXPECT_EQ(cases, 7 * 300);
}

TEST(EvidenceMergeOptions, BadValuesAreRefusedByName) {
  struct Row {
    double value;
    const char* message;
  };
  const Row rows[] = {{-0.5, "merge_loss = -0.5: must be >= 0 bits and finite"},
                      {std::numeric_limits<double>::infinity(), "merge_loss = inf: "},
                      {std::numeric_limits<double>::quiet_NaN(), "merge_loss = "}};
  EXPECT_NO_THROW(EvidenceMergeOptions{}.validate());
  int cases = 0;
  for (const Row& row : rows) {
    MapOptions options;
    options.merge_loss = row.value;
    try {
      options.validate();
      ADD_FAILURE() << row.message << "accepted";
    } catch (const std::invalid_argument& error) {
      EXPECT_EQ(std::string(error.what()).rfind(row.message, 0), 0u) << error.what();
    }
    ++cases;
  }
  EXPECT_EQ(cases, 3);
  MapOptions options;
  options.merge_loss = 0.0;
  EXPECT_NO_THROW(options.validate());
}

}  // namespace
}  // namespace ndtree::test
