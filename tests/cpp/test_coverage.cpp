// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Unseen space stays unknown: half-seen cells, what several scans see together, and what merging,
/// compressing and files make of it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/insert/coverage.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "options.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_coverage {
namespace {

constexpr double kUnit = 0.1;

MapOptions options_of(int branching, int levels) {
  MapOptions options = spelled_out_options(kUnit, kUnit * std::pow(branching, levels));
  options.range_sigma = 0.01;
  options.sample_beams = 2.0;
  options.covered_share = 0.25;
  return options;
}

/// Beams without return from one point, through a grid of directions: along axis 0, and up to `lower` and
/// `upper` times as far along each other axis.
template <int D>
Scan<D> fan(const Vector<D>& origin, double depth, double lower, double upper, int count) {
  std::vector<Vector<D>> endpoints;
  std::vector<int> at(static_cast<std::size_t>(D), 0);
  for (;;) {
    Vector<D> path = Vector<D>::Constant(1.0);
    for (int a = 1; a < D; ++a)
      path[a] = lower + (upper - lower) * (at[static_cast<std::size_t>(a)] + 0.5) / count;
    endpoints.push_back(origin + depth * path);
    int a = 1;
    for (; a < D && ++at[static_cast<std::size_t>(a)] == count; ++a) at[static_cast<std::size_t>(a)] = 0;
    if (a >= D) break;
  }
  Scan<D> scan;
  scan.origins = origin;
  scan.endpoints.resize(D, static_cast<Eigen::Index>(endpoints.size()));
  for (std::size_t i = 0; i < endpoints.size(); ++i)
    scan.endpoints.col(static_cast<Eigen::Index>(i)) = endpoints[i];
  scan.returned = Eigen::Array<bool, Eigen::Dynamic, 1>::Constant(scan.size(), false);
  return scan;
}

template <class S>
class CoverageOf : public ::testing::Test {};
TYPED_TEST_SUITE(CoverageOf, TwoShapes, ShapeNames);

/// How much of a box is free, by points.
template <class Map>
double share_free(const Map& map, const Vector<Map::kDim>& lower, const Vector<Map::kDim>& upper) {
  Random random(5);
  int free = 0;
  constexpr int kPoints = 400;
  for (int i = 0; i < kPoints; ++i) {
    Vector<Map::kDim> point;
    for (int a = 0; a < Map::kDim; ++a) point[a] = random.uniform(lower[a], upper[a]);
    free += state(map, point) == CellState::free;
  }
  return static_cast<double>(free) / kPoints;
}

TYPED_TEST(CoverageOf, OnlyTheSideThatWasLookedIntoIsFreeHoweverOften) {
  NDTREE_SHAPE;
  if constexpr (D >= 2) {
    const int levels = N == 2 ? 4 : 2;
    AdaptiveMap<N, D> map(options_of(N, levels));
    const double edge = kUnit * std::pow(N, levels);
    // One coarsest cell ahead, of which beams pass the children of large coordinates along axis 1.
    const double border = edge * (N / 2) / N;
    Vector<D> origin = Vector<D>::Constant(border);
    origin[0] = -3.0 * edge;
    Scan<D> scan = fan<D>(origin, 5.0 * edge, -0.25, 0.25, D <= 2 ? 400 : D == 3 ? 60 : 20);
    for (Eigen::Index i = 0; i < scan.size(); ++i)
      if (scan.endpoints(1, i) < origin[1]) scan.endpoints.col(i) = origin;  // Says nothing.
    Vector<D> lower = Vector<D>::Constant(0.0);
    Vector<D> upper = Vector<D>::Constant(edge);
    Vector<D> seen_lower = lower;
    seen_lower[1] = border;
    Vector<D> unseen_upper = upper;
    unseen_upper[1] = border;
    for (const int scans : {1, 30}) {
      for (int i = 0; i < scans; ++i) map.insert(scan);
      ASSERT_NO_THROW(map.check_invariants());
      EXPECT_GT(share_free(map, seen_lower, upper), 0.97) << scans;
      EXPECT_LT(share_free(map, lower, unseen_upper), 0.01) << scans;
    }
    // Another place looks into the rest: all is free, and the cell is whole.
    const std::size_t before = map.stats().observed_leaves;
    EXPECT_GT(before, 1u);
    const Scan<D> rest = fan<D>(origin, 5.0 * edge, -0.25, 0.25, D <= 2 ? 400 : D == 3 ? 60 : 20);
    for (int i = 0; i < 30; ++i) map.insert(rest);
    EXPECT_GT(share_free(map, lower, upper), 0.99);
    const auto leaf = map.tree().find_leaf(Vector<D>(Vector<D>::Constant(0.5 * edge)));
    ASSERT_TRUE(leaf);
    EXPECT_EQ(leaf->index.level, 0) << "siblings join again";
  }
}

TYPED_TEST(CoverageOf, FewBeamsSpreadAllOverACellSeeAllOfIt) {
  NDTREE_SHAPE;
  if constexpr (D >= 2) {
    AdaptiveMap<N, D> map(options_of(N, N == 2 ? 3 : 2));
    const double edge = map.options().max_cell_size;
    Vector<D> origin = Vector<D>::Constant(0.5 * edge);
    origin[0] = -8.0 * edge;
    map.insert(fan<D>(origin, 16.0 * edge, -0.5, 0.5, 12));  // About two thirds of the cell apart there.
    Vector<D> upper = Vector<D>::Constant(edge);
    EXPECT_GT(share_free(map, Vector<D>::Zero(), upper), 0.9);
    EXPECT_LE(map.tree().find_leaf(Vector<D>(Vector<D>::Constant(0.5 * edge)))->index.level, 0);
  }
}

TYPED_TEST(CoverageOf, NothingFarFromAllBeamsIsFree) {
  NDTREE_SHAPE;
  Random random(21);
  AdaptiveMap<N, D> map(options_of(N, N == 2 ? 4 : 2));
  const double reach = 3.0;
  std::vector<Vector<D>> ends;
  Vector<D> origin = Vector<D>::Constant(0.05);
  for (int scan = 0; scan < 3; ++scan) {
    Scan<D> beams;
    beams.origins = origin;
    beams.endpoints.resize(D, 300);
    for (Eigen::Index i = 0; i < beams.size(); ++i) {
      for (int a = 0; a < D; ++a)
        beams.endpoints(a, i) = reach * random.uniform(a == 0 ? 0.3 : -0.5, 0.5 + (a == 0));
      ends.emplace_back(beams.endpoints.col(i));
    }
    map.insert(beams);
  }
  int asked = 0;
  int free = 0;
  for (int i = 0; i < 2000; ++i) {
    Vector<D> point;
    for (int a = 0; a < D; ++a) point[a] = random.uniform(-reach, reach);
    bool is_far = true;
    for (const Vector<D>& end : ends) {
      const Vector<D> path = end - origin;
      const double t = std::clamp((point - origin).dot(path) / path.squaredNorm(), 0.0, 1.0);
      is_far = is_far && (origin + t * path - point).norm() > 0.6;
    }
    if (!is_far) continue;
    ++asked;
    free += state(map, point) == CellState::free;
  }
  EXPECT_GT(asked, 300);
  EXPECT_LE(free, D == 1 ? 0 : asked / 50) << "of " << asked;
}

TYPED_TEST(CoverageOf, ALoneBeamFreesItsWayAndNoMore) {
  NDTREE_SHAPE;
  AdaptiveMap<N, D> map(options_of(N, N == 2 ? 4 : 2));
  Scan<D> scan;
  scan.origins = Vector<D>::Constant(0.05);
  scan.endpoints = Vector<D>::Constant(0.05);
  scan.endpoints(0, 0) = 2.05;
  map.insert(scan);
  for (double x = 0.35; x < 1.9; x += 0.05) {
    Vector<D> point = Vector<D>::Constant(0.05);
    point[0] = x;
    EXPECT_EQ(state(map, point), CellState::free) << x;
    if (D == 1) continue;
    point[D - 1] = 0.55;
    EXPECT_EQ(state(map, point), CellState::unknown) << x;
  }
  EXPECT_EQ(state(map, Vector<D>(scan.endpoints.col(0))), CellState::occupied);
}

TYPED_TEST(CoverageOf, CompressingMakesNothingKnownThatWasNeverSeen) {
  NDTREE_SHAPE;
  Random random(9);
  AdaptiveMap<N, D> map(options_of(N, N == 2 ? 3 : 2));
  for (int scan = 0; scan < 6; ++scan) {
    Scan<D> beams;
    beams.origins = Vector<D>::Constant(random.uniform(-0.3, 0.3));
    beams.endpoints.resize(D, 200);
    for (Eigen::Index i = 0; i < beams.size(); ++i)
      for (int a = 0; a < D; ++a) beams.endpoints(a, i) = random.uniform(a == 0 ? 1.0 : -1.0, 1.5);
    map.insert(beams);
  }
  auto small = map;
  const CompressReport report = small.compress({1e9, {}, {}});
  ASSERT_NO_THROW(small.check_invariants());
  EXPECT_GT(report.merges, 0u);
  int unknown = 0;
  for (int i = 0; i < 3000; ++i) {
    Vector<D> point;
    for (int a = 0; a < D; ++a) point[a] = random.uniform(-1.5, 1.5);
    if (state(map, point) != CellState::unknown) continue;
    ++unknown;
    EXPECT_EQ(state(small, point), CellState::unknown);
  }
  EXPECT_GT(unknown, 200);
}

/// What a beam sees, @param way over a child's edge.
template <class Sum>
auto passed(float way, float width) {
  return Sum::passed(way * Sum::kUnitsOfOne, width);
}
/// Of one child. @param area over that of a face of the child.
template <class Sum>
std::int64_t seen(float way, float area) {
  return nearest_integer(way * Sum::kUnitsOfOne * area);
}

TEST(Coverage, BeamsThatClipACornerHaveNotSeenTheCell) {
  const CoverageModel model(CoverageOptions{});
  using Sum = ScanCoverage<2, 3>;
  struct Row {
    int beams;      // Side by side, through each seen child.
    float way;      // Of each, through a child.
    float width;    // Of each.
    int children;   // Seen, of eight.
    double passed;  // Mean passes so far.
    bool is_enough, shows_more;
  };
  const Row rows[] = {
      {1, 1.0f, 2.0f, 2, 1.0, true, false},   // Straight through, as wide as the cell.
      {1, 0.3f, 2.0f, 1, 0.3, false, false},  // Through a corner.
      {1, 3e-7f, 2.0f, 1, 0.0, false, false},
      {7, 0.3f, 1.0f, 1, 7.0, false, false},    // Many see no more of it,
      {7, 0.3f, 1.0f, 1, 33.0, false, true},    // and where they go on doing so, smaller cells show it.
      {1, 1.0f, 1.0f, 4, 4.0, true, false},     // Half of the cell.
      {16, 1.0f, 0.25f, 2, 4.0, false, false},  // A quarter.
      {16, 1.0f, 0.25f, 4, 4.0, true, false},
  };
  int cases = 0;
  for (const Row& row : rows) {
    Sum scan;
    for (int child = 0; child < row.children; ++child)
      for (int i = 0; i < row.beams; ++i) {
        scan.add(passed<Sum>(row.way, row.width));
        scan.add(child, seen<Sum>(row.way, std::min(1.0f, row.width * row.width)));
      }
    const CoverageVerdict verdict = model.judge(scan, 0, model.limits<2>(2.0), row.passed);
    EXPECT_EQ(verdict.is_enough, row.is_enough) << cases;
    EXPECT_EQ(verdict.shows_more, row.shows_more) << cases;
    ++cases;
  }
}

/// A laser that stands still, its beams evenly spaced by angle. Of twenty, three side by side are blocked.
template <int N>
void no_shadow_is_free(double turn) {
  constexpr double kRange = 12.0;
  constexpr int kBeams = 180;
  constexpr double kStep = 0.0262;  // 0.1 m at a distance of 4 m [rad].
  MapOptions options = options_of(N, N == 2 ? 5 : 3);
  options.covered_share = 0.5;
  AdaptiveMap<N, 2> map(options);
  Scan<2> scan;
  scan.origins = Vector<2>(0.03, 0.02);
  scan.endpoints.resize(2, kBeams);
  scan.returned = Eigen::Array<bool, Eigen::Dynamic, 1>::Constant(kBeams, false);
  const auto at = [&](int beam, double range) {
    const double angle = turn + beam * kStep;
    return Vector<2>(scan.origins.col(0) + range * Vector<2>(std::cos(angle), std::sin(angle)));
  };
  for (int i = 0; i < kBeams; ++i) scan.endpoints.col(i) = at(i, i % 20 < 3 ? 0.5 : kRange);
  for (int i = 0; i < 40; ++i) map.insert(scan);
  int free = 0;
  int hidden = 0;
  int unknown = 0;
  int seen = 0;
  for (int i = 20; i < kBeams; ++i)
    for (double range = 4.0; range < kRange - 1.0; range += 0.03) {
      if (i % 20 != 1 && i % 20 < 3) continue;
      const bool is_free = state(map, at(i, range)) == CellState::free;
      (i % 20 == 1 ? hidden : seen) += 1;
      free += i % 20 == 1 && is_free;
      unknown += i % 20 != 1 && !is_free;
    }
  EXPECT_GT(std::min(hidden, seen), 1000);
  EXPECT_LE(free, hidden / 50) << "in the middle of a shadow";
  EXPECT_LE(unknown, seen / 100) << "what is seen is known";
}

TEST(Coverage, NoShadowOfThreeBeamsIsFreeInAPlane) {
  for (const double turn : {0.0, 0.3, 0.785}) {
    SCOPED_TRACE(turn);
    no_shadow_is_free<2>(turn);
    no_shadow_is_free<3>(turn);
  }
}

TEST(Coverage, OfABeamOnlyWhatLiesInTheChildIsSeen) {
  using Sum = ScanCoverage<2, 2>;
  EXPECT_FLOAT_EQ(Sum::overlap(0.0f, 0.2f), 0.2f);
  EXPECT_FLOAT_EQ(Sum::overlap(0.5f, 0.2f), 0.1f) << "the other half lies in the neighbour";
  EXPECT_FLOAT_EQ(Sum::overlap(0.4f, 1.0f), 0.6f);
  EXPECT_FLOAT_EQ(Sum::overlap(0.2f, 10.0f), 1.0f) << "no more than the child";
  EXPECT_FLOAT_EQ(Sum::overlap(0.6f, 0.1f), 0.0f) << "by rounding the middle may lie outside";
}

TEST(Coverage, TheMeanOverlapIsThatOfEvenlySpreadBeams) {
  using Sum = ScanCoverage<2, 2>;
  for (const float width : {0.01f, 0.3f, 1.0f, 1.4f, 2.0f, 7.0f}) {
    double sum = 0.0;
    constexpr int kPlaces = 10000;
    for (int i = 0; i < kPlaces; ++i)
      sum +=
          static_cast<double>(Sum::overlap(std::abs((static_cast<float>(i) + 0.5f) / kPlaces - 0.5f), width));
    EXPECT_NEAR(sum / kPlaces, Sum::mean_overlap(0.5 * static_cast<double>(width)), 1e-3) << width;
  }
}

TYPED_TEST(CoverageOf, WhatIsCertainStaysWhateverElseIsSeen) {
  NDTREE_SHAPE;
  using Sum = ScanCoverage<N, D>;
  Random random(268);
  const CoverageModel model(CoverageOptions{});
  const auto is_same = [](const CoverageVerdict& a, const CoverageVerdict& b) {
    return a.parts == b.parts && a.is_enough == b.is_enough && a.shows_more == b.shows_more;
  };
  int certain = 0;
  int changed_from_uncertain = 0;
  for (int i = 0; i < 2000; ++i) {
    Sum scan;
    const auto add = [&](int child, double share) {
      const auto width = std::pow(static_cast<float>(share), 1.0f / std::max(1, D - 1));
      scan.add(passed<Sum>(1.0f, width));
      scan.add(child, seen<Sum>(1.0f, D == 1 ? 1.0f : static_cast<float>(share)));
    };
    const double most = random.uniform(0.1, 1.6);
    const int beams = static_cast<int>(random.uniform(4.0, 100.0));
    for (int j = 0; j < Sum::kNumChildren; ++j)
      for (int k = 0; k < beams; ++k)
        if (D > 1 || k == 0) add(j, random.uniform(0.5, 1.0) * most / beams);
    const double size = random.uniform(1.0, 40.0);
    const CoverageLimits limits = model.template limits<N>(size);
    const bool was_certain = CoverageModel::is_certain(scan, limits);
    const CoverageVerdict before = model.judge(scan, 0, limits, beams);
    const bool was_covered = CoverageModel::is_covered(scan, limits);
    for (int j = 0; j < Sum::kNumChildren; ++j)  // Much more of some, so that others seem to be missing.
      if (random.uniform(0.0, 1.0) < 0.5)
        for (int k = 0; k < 50; ++k) add(j, 0.02);
    const bool same = is_same(before, model.judge(scan, 0, limits, beams)) &&
                      was_covered == CoverageModel::is_covered(scan, limits);
    ASSERT_TRUE(!was_certain || same) << size;
    certain += was_certain;
    changed_from_uncertain += !same;
  }
  EXPECT_GE(certain, 100);
  EXPECT_GE(changed_from_uncertain, D == 1 ? 0 : 50);
}

TEST(Coverage, PartsTileTheChildren) {
  EXPECT_EQ((CellParts<2, 3>::kCount), 8);
  for (int j = 0; j < 8; ++j) EXPECT_EQ((CellParts<2, 3>::of_child(j)), j);
  int lower = 0;
  for (int j = 0; j < 9; ++j) lower += CellParts<3, 2>::of_child(j) == 0;
  EXPECT_EQ(lower, 4) << "of three, the middle belongs to the lower half";
  EXPECT_EQ((CellParts<2, 6>::kCount), 16);
}

TEST(Coverage, APartlySeenCellKeepsPartsAndEvidenceAndKnowsNothing) {
  EvidenceCell cell;
  cell.set_partly_seen(0xa5f1, 777);
  EXPECT_TRUE(cell.is_partly_seen());
  EXPECT_TRUE(cell.is_consistent());
  EXPECT_FALSE(cell.observed());
  EXPECT_EQ(cell.state(), CellState::unknown);
  EXPECT_EQ(cell.log_odds(), 0.0f);
  EXPECT_EQ(cell.seen_parts(), 0xa5f1u);
  EXPECT_EQ(cell.free_evidence(), 777);
  EXPECT_EQ(cell.occupied_evidence(), 0);
  EXPECT_EQ(EvidenceCell::from_words(cell.words()), cell);
  const MapOptions options = spelled_out_options(0.1, 0.4);
  const EvidenceModel model(options, options);
  ScanEvidence scan;
  scan.free = 104;
  scan.misses = scan.beams = 1;
  model.update(cell, scan);
  EXPECT_FALSE(cell.is_partly_seen());
  EXPECT_TRUE(cell.observed() && cell.is_consistent());
  EXPECT_EQ(cell.free_evidence(), 777 + 104) << "what was seen before counts, too";
  EXPECT_EQ(cell.state(), CellState::free);
}

TEST(Coverage, FilesFromBeforeThereWasCoverageAreRead) {
  const std::string hex =
      "894e44540d0a1a0a0200000057030000000000000200000002000000080065766964656e6365190000000d006d696e5f"
      "63656c6c5f73697a65000000000000d03f0d006d61785f63656c6c5f73697a65000000000000f03f0b0072616e67655f"
      "7369676d619a9999999999a93f150072616e67655f7369676d615f71756164726174696300000000000000000f007072"
      "6f626162696c6974795f6d696e9a9999999999d93f0f0070726f626162696c6974795f6d6178666666666666e63f0c00"
      "6c6f675f6f6464735f6d696e00000000000000c00c006c6f675f6f6464735f6d61780000000000000c4013006d697373"
      "5f676976656e5f6f636375706965649a9999999999b93f0e006869745f676976656e5f667265659a9999999999a93f0c"
      "007369676e69666963616e6365d7a3703d0ad7ef3f10006d657267655f667265655f62656c6f77a4703d0ad7a3c03f14"
      "006d657267655f6f636375706965645f61626f7665b81e85eb51b8ee3f110073706c69745f70726f626162696c697479"
      "666666666666e63f0a006d657267655f6c6f737300000000000010400f00696e686572697465645f6265616d73000000"
      "00000000400c006e6f6973655f7369676d6173000000000000f03f0f0065766964656e63655f6d656d6f727900000000"
      "000069400b00667265655f6d656d6f727900000000000049400a007363616e5f6265616d7300000000000050400e006b"
      "6e6f776e5f65766964656e636500000000000049400c0073616d706c655f6265616d7300000000000000400e00657669"
      "64656e63655f7072696f72000000000000e03f12006368616e67655f70726f626162696c697479f168e388b5f8e43e12"
      "0065766964656e63655f68616c665f6c6966650000000000000000130000000000000005000000000000000000000000"
      "000000010000000000000000000000000000000000000000000080000a004054a8e7bf8e020000000000800006004089"
      "5aa0bf4001000000000080010084405971623f0000b60000000000010084405971623f0000b6000000000000060040ec"
      "2da3bf4a01000000000080010084405971623f0000b60000000000010084405971623f0000b600000000000000000000"
      "00008000020040391fecbe4b0000000000008000020440036f373d0300090000000000010084405971623f0000b60000"
      "0000000000000000000000519fc8bc";
  std::string bytes;
  for (std::size_t i = 0; i < hex.size(); i += 2)
    bytes.push_back(static_cast<char>(std::stoi(hex.substr(i, 2), nullptr, 16)));
  const auto map = from_bytes<AdaptiveMap<2, 2>>(bytes);
  EXPECT_EQ(map_file_header(bytes).version, 2u);
  EXPECT_EQ(map.stats().observed_leaves, 10u);
  EXPECT_EQ(state(map, Vector<2>(0.6, 0.3)), CellState::free);
  EXPECT_EQ(state(map, Vector<2>(1.6, 0.9)), CellState::occupied);
  EXPECT_EQ(to_bytes(from_bytes<AdaptiveMap<2, 2>>(to_bytes(map))), to_bytes(map));
}

}  // namespace
}  // namespace ndtree::test::test_coverage
