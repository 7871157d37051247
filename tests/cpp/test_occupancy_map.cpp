// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "flat_map.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "options.hpp"
#include "random.hpp"
#include "refusals.hpp"
#include "shapes.hpp"
#include "trees.hpp"

namespace ndtree::test::test_occupancy_map {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
const double kNan = std::numeric_limits<double>::quiet_NaN();

template <int D>
Scan<D> scan_of(const std::vector<Vector<D>>& origins, const std::vector<Vector<D>>& endpoints,
                const std::vector<bool>& returned = {}) {
  Scan<D> scan;
  scan.origins.resize(D, static_cast<Eigen::Index>(origins.size()));
  scan.endpoints.resize(D, static_cast<Eigen::Index>(endpoints.size()));
  scan.returned.resize(static_cast<Eigen::Index>(returned.size()));
  for (std::size_t i = 0; i < origins.size(); ++i)
    scan.origins.col(static_cast<Eigen::Index>(i)) = origins[i];
  for (std::size_t i = 0; i < endpoints.size(); ++i)
    scan.endpoints.col(static_cast<Eigen::Index>(i)) = endpoints[i];
  for (std::size_t i = 0; i < returned.size(); ++i) scan.returned[static_cast<Eigen::Index>(i)] = returned[i];
  return scan;
}

template <int D>
Scan<D> one_beam(const Vector<D>& origin, const Vector<D>& endpoint, bool returned = true) {
  return scan_of<D>({origin}, {endpoint}, {returned});
}

/// Beams within (-size, size): measured numbers, or exact ones on a grid of a quarter of the smallest cell.
template <int D>
Scan<D> random_beams(Random& random, int count, double size, double grid) {
  std::vector<Vector<D>> origins;
  std::vector<Vector<D>> endpoints;
  std::vector<bool> returned;
  const auto place = [&] {
    Vector<D> point;
    for (int a = 0; a < D; ++a) {
      point[a] = random.uniform(-size, size);
      if (grid > 0.0) point[a] = std::round(point[a] / grid) * grid;
    }
    return point;
  };
  for (int i = 0; i < count; ++i) {
    origins.push_back(place());
    endpoints.push_back(place());
    if (grid > 0.0)  // Often parallel to an axis, sometimes of no length.
      for (int a = 0; a < D; ++a)
        if (random.chance(0.3)) endpoints.back()[a] = origins.back()[a];
    returned.push_back(random.chance(0.8));
  }
  return scan_of<D>(origins, endpoints, returned);
}

/// Leaves that a beam updated.
template <class Map>
LeafMap<Map::kDim, OccupancyCell> observed_leaves(const Map& map) {
  LeafMap<Map::kDim, OccupancyCell> leaves;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    if (leaf.cell().observed()) leaves.emplace(leaf.index, leaf.cell());
  });
  return leaves;
}

template <class Map, class Flat>
void expect_equal(const Map& map, const Flat& flat) {
  std::size_t observed = 0;
  for (const auto& [index, evidence] : flat.cells) observed += evidence.observed;
  const auto leaves = observed_leaves(map);
  EXPECT_EQ(leaves.size(), observed);
  const MapStats stats = map.stats();
  EXPECT_EQ(stats.observed_leaves, observed);
  EXPECT_EQ(stats.leaves, leaves_of(map.tree()).size());
  EXPECT_EQ(stats.nodes, map.tree().num_nodes());
  EXPECT_EQ(stats.updates, map.counters().updates);
  EXPECT_GE(stats.memory_bytes, stats.nodes * 8);
  int wrong = 0;
  for (const auto& [index, cell] : leaves) {
    const auto found = flat.cells.find(index);
    const bool same = found != flat.cells.end() && found->second.observed &&
                      found->second.hits == cell.hits() && found->second.misses == cell.misses() &&
                      std::abs(found->second.log_odds - cell.log_odds()) <= 1e-5f;
    if (!same && wrong++ == 0) {
      ADD_FAILURE() << "level " << index.level << " at " << index.lower[0] << " ...: " << cell.hits()
                    << " hits, " << cell.misses() << " misses, log-odds " << cell.log_odds() << "; expected "
                    << (found == flat.cells.end()
                            ? "another cell"
                            : std::to_string(found->second.hits) + " hits, " +
                                  std::to_string(found->second.misses) + " misses, log-odds " +
                                  std::to_string(found->second.log_odds));
    }
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(map.counters().updates, flat.updates);
  EXPECT_EQ(map.counters().splits, flat.splits);
  EXPECT_EQ(map.counters().merges, flat.merges);
}

template <class S>
class OccupancyMapOf : public ::testing::Test {};
TYPED_TEST_SUITE(OccupancyMapOf, Shapes, ShapeNames);

TYPED_TEST(OccupancyMapOf, AdaptiveMapEqualsThePaperWithoutATree) {
  NDTREE_SHAPE;
  Random random(41);
  constexpr double kUnit = 0.25;
  const int levels = N == 2 ? 2 : 1;
  const double coarsest = kUnit * std::pow(N, levels);
  MapOptions options = spelled_out_options(kUnit, coarsest);
  options.range_sigma = 0.03;
  options.merge_free_below = 0.42;  // One beam is enough, so that much merges.
  options.merge_occupied_above = 0.65;
  ASSERT_EQ(options.num_levels(N), levels);
  const double size = 2.0 * coarsest - 0.125;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  for (const double grid : {0.0, kUnit / 4.0}) {
    options.range_sigma_quadratic = grid > 0.0 ? 0.0002 : 0.0;
    PaperMap<N, D> map(options);
    FlatMap<N, D> flat(options, levels, true, -2, 2);
    const int scans = D <= 2 ? 12 : 20;
    for (int scan = 0; scan < scans; ++scan) {
      // Beams from one origin that end in one wall, now and then elsewhere; then the wall is taken away.
      Scan<D> beam_list = random_beams<D>(random, 20, size, grid);
      for (Eigen::Index i = 0; i < beam_list.size(); ++i) {
        if (random.chance(0.7)) beam_list.origins.col(i).setConstant(-size + 0.375);
        if (random.chance(0.7)) beam_list.endpoints(0, i) = scan < scans / 2 ? 0.125 : size - 0.25;
      }
      if (scan % 4 == 3) beam_list.origins = beam_list.origins.leftCols(1).eval();
      const double max_range = scan % 3 == 2 ? 1.0 : kInfinity;
      const InsertReport report = map.insert(beam_list, max_range);
      const std::uint64_t before = flat.updates;
      for (Eigen::Index i = 0; i < beam_list.size(); ++i)
        flat.insert(beam_list.view().origin(i), beam_list.endpoints.col(i), beam_list.returned[i], max_range);
      EXPECT_EQ(report.updates, flat.updates - before);
      EXPECT_EQ(report.beams, 20u);
      EXPECT_EQ(report.beams,
                report.returned + report.not_returned + report.beyond_max_range + report.invalid);
      ASSERT_NO_THROW(map.check_invariants());
    }
    expect_equal(map, flat);
    splits += map.counters().splits;
    merges += map.counters().merges;
  }
  EXPECT_GE(splits, 5u);
  EXPECT_GE(merges, D <= 2 ? 1u : 0u);
}

TEST(OccupancyMap, RefusedCallsChangeNothing) {
  constexpr int D = 2;
  Random random(45);
  PaperMap<2, D> map(spelled_out_options(0.1, 0.2));
  map.insert(random_beams<D>(random, 60, 1.0, 0.0));
  const auto before = leaves_of(map.tree());
  const auto root = map.tree().root().index;
  const std::uint64_t updates = map.counters().updates;
  const Vector<D> zero = Vector<D>::Zero();
  const Vector<D> one = Vector<D>::Ones();
  struct Row {
    const char* what;
    Scan<D> scan;
    double max_range;
    const char* message;
  };
  const Vector<D> nan = Vector<D>::Constant(kNan);
  const Row rows[] = {
      {"origin is NaN", one_beam<D>(nan, one), 5.0, "origin"},
      {"origin is infinite", one_beam<D>(Vector<D>::Constant(kInfinity), one), 5.0, "origin"},
      {"max_range is zero", one_beam<D>(zero, one), 0.0, "max_range = 0"},
      {"max_range is negative", one_beam<D>(zero, one), -1.0, "max_range = -1"},
      {"max_range is NaN", one_beam<D>(zero, one), kNan, "max_range"},
      {"end point out of reach", scan_of<D>({zero}, {one, Vector<D>::Constant(1e30)}), kInfinity,
       "beam 1 reaches"},
      {"origin out of reach", scan_of<D>({zero, Vector<D>::Constant(-1e30)}, {one, one}), kInfinity,
       "beam 1"},
      {"max_range out of reach", scan_of<D>({zero}, {one, Vector<D>::Constant(1e30)}), 1e20, "beam 1"},
      {"too many origins", scan_of<D>({zero, zero}, {one}), kInfinity,
       "origins has 2 columns: must be 1 or 1"},
      {"no origin", scan_of<D>({}, {one}), kInfinity, "origins has 0 columns"},
      {"returned too short", scan_of<D>({zero}, {one, one}, {true}), kInfinity, "returned has 1 entries"}};
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    expect_refused([&] { map.insert(row.scan, row.max_range); }, row.message);
    EXPECT_EQ(leaves_of(map.tree()), before);
    EXPECT_EQ(map.tree().root().index, root);
    EXPECT_EQ(map.counters().updates, updates);
  }
  // A far end point is no harm where max_range ends the beam before.
  EXPECT_EQ(map.insert(one_beam<D>(zero, Vector<D>::Constant(1e30)), 2.0).beyond_max_range, 1u);
}

TEST(OccupancyMap, IsMovedWithoutACopy) {  // So do vectors of maps and trees that grow.
  using Map = AdaptiveMap<2, 3>;
  static_assert(std::is_nothrow_move_constructible_v<Map> && std::is_nothrow_move_assignable_v<Map>);
  static_assert(std::is_nothrow_move_constructible_v<Map::Tree> &&
                std::is_nothrow_move_assignable_v<Map::Tree>);
}

TEST(OccupancyMap, OutcomesHaveTheirEffects) {
  // Cells of 0.5 m; beams along the row [0, 0.5) of y, from x = 0.25.
  struct Row {
    const char* what;
    Vector<2> endpoint;
    bool returned;
    double max_range;
    const char* outcome;
    std::vector<int> states;  // Of the cells from x = 0 on.
  };
  const int free = 0;
  const int hit = 1;
  const int none = -1;
  const Row rows[] = {
      {"returned", {1.75, 0.25}, true, kInfinity, "returned", {free, free, free, hit, none}},
      {"not returned: the cell it ends in, too",
       {1.75, 0.25},
       false,
       kInfinity,
       "not",
       {free, free, free, free, none}},
      {"not returned, ends on a border", {1.5, 0.25}, false, kInfinity, "not", {free, free, free, none}},
      {"beyond max_range", {1.75, 0.25}, true, 1.0, "beyond", {free, free, free, none}},
      {"exactly max_range", {1.75, 0.25}, true, 1.5, "returned", {free, free, free, hit, none}},
      {"not returned, cut by max_range", {1.75, 0.25}, false, 1.0, "not", {free, free, free, none}},
      {"max_range ends on a border", {1.75, 0.25}, true, 0.75, "beyond", {free, free, none, none}},
      {"too short to leave its cell", {0.375, 0.25}, true, kInfinity, "returned", {hit, none}},
      {"NaN", {kNan, 0.25}, true, kInfinity, "invalid", {none, none}},
      {"infinite", {kInfinity, 0.25}, false, kInfinity, "invalid", {none, none}},
      {"infinite, in spite of max_range", {kInfinity, 0.25}, true, 1.0, "invalid", {none, none}},
      {"zero length", {0.25, 0.25}, true, kInfinity, "invalid", {none, none}},
  };
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    MapOptions options = spelled_out_options(0.5, 0.5);
    options.range_sigma = 0.001;
    FixedMap<2, 2> map(options);
    const auto report = map.insert(one_beam<2>({0.25, 0.25}, row.endpoint, row.returned), row.max_range);
    const std::string outcome = row.outcome;
    EXPECT_EQ(report.beams, 1u);
    EXPECT_EQ(report.returned, outcome == "returned");
    EXPECT_EQ(report.not_returned, outcome == "not");
    EXPECT_EQ(report.beyond_max_range, outcome == "beyond");
    EXPECT_EQ(report.invalid, outcome == "invalid");
    std::uint64_t updates = 0;
    for (std::size_t i = 0; i < row.states.size(); ++i) {
      const auto leaf = map.tree().find_leaf(Vector<2>(0.5 * static_cast<double>(i) + 0.25, 0.25));
      const OccupancyCell cell = leaf ? leaf->cell() : OccupancyCell{};
      EXPECT_EQ(static_cast<int>(cell.state()), row.states[i]) << "cell " << i;
      EXPECT_EQ(cell.hits(), row.states[i] == hit) << "cell " << i;
      EXPECT_EQ(cell.misses(), row.states[i] == free) << "cell " << i;
      updates += row.states[i] != none;
    }
    EXPECT_EQ(report.updates, updates);
    EXPECT_EQ(map.stats().observed_leaves, updates);
  }
}

TEST(OccupancyMap, AnEmptyScanDoesNothing) {
  PaperMap<2, 2> map;
  const Scan<2> empty = scan_of<2>({Vector<2>::Zero()}, {});
  const auto report = map.insert(empty);
  EXPECT_EQ(report.beams, 0u);
  EXPECT_EQ(report.updates, 0u);
  EXPECT_EQ(map.stats().nodes, 1u);
  // Beams that say nothing, each from its own origin.
  const auto mixed = scan_of<2>({{kNan, 0.0}, {0.0, 0.0}, {1.0, 1.0}}, {{1.0, 1.0}, {kNan, 1.0}, {1.0, 1.0}});
  EXPECT_EQ(map.insert(mixed).invalid, 3u);
  EXPECT_EQ(map.stats().nodes, 1u);
}

TEST(OccupancyMap, FarFromTheOriginAsNear) {
  Random random(47);
  // Dyadic cells and points, so that the shift by 2^20 m, 1048 km, is exact.
  MapOptions options = spelled_out_options(0.0078125, 0.0625);
  options.range_sigma = 0.01;
  const double shift = 1048576.0;
  PaperMap<2, 2> near(options);
  PaperMap<2, 2> far(options);
  Scan<2> beams = random_beams<2>(random, 200, 1.0, 1.0 / 1024.0);
  near.insert(beams);
  beams.origins.array() += shift;
  beams.endpoints.array() += shift;
  far.insert(beams);
  LeafMap<2, OccupancyCell> shifted;
  for (const auto& [near_index, cell] : observed_leaves(near)) {
    auto index = near_index;
    for (auto& lower : index.lower) lower += static_cast<std::int64_t>(shift * 128.0);
    shifted.emplace(index, cell);
  }
  EXPECT_EQ(observed_leaves(far), shifted);
  EXPECT_GT(shifted.size(), 100u);
  far.check_invariants();
}

TEST(MapOptions, LevelsBetweenTheSmallestAndTheLargestCell) {
  struct Row {
    double min_cell_size, max_cell_size;
    int branching, levels;
  };
  const Row rows[] = {{0.05, 1.6, 2, 5},  {0.05, 1.59, 2, 4}, {0.1, 0.1, 2, 0},   {0.1, 0.19, 2, 0},
                      {0.1, 0.3, 3, 1},   {0.1, 0.9, 3, 2},   {0.1, 2.7, 3, 3},   {0.1, 0.7, 7, 1},
                      {0.01, 0.25, 5, 2}, {0.02, 2.5, 5, 3},  {0.05, 0.35, 7, 1}, {0.05, 6.4, 2, 7}};
  for (const Row& row : rows) {
    MapOptions options;
    options.min_cell_size = row.min_cell_size;
    options.max_cell_size = row.max_cell_size;
    EXPECT_EQ(options.num_levels(row.branching), row.levels)
        << row.min_cell_size << " to " << row.max_cell_size << ", N = " << row.branching;
  }
}

TEST(MapOptions, WhatDoesNotFitTogetherIsRefused) {
  const std::function<void(MapOptions&)> changes[] = {
      [](MapOptions& o) { o.max_cell_size = 1e300; },  // More levels than the lattice has.
      [](MapOptions& o) { o.min_cell_size = 1e-300, o.max_cell_size = 1e300; },
      [](MapOptions& o) { o.merge_free_below = 0.6; }};
  for (const auto& spoil : changes) {
    MapOptions options;
    spoil(options);
    EXPECT_THROW((PaperMap<2, 2>(options)), std::invalid_argument);
  }
}

/// Maps scans from within a room, in units of the smallest cells, and tests all that must hold of numbers.
/// @returns the cells that were observed.
template <class Map>
std::size_t expect_sane_numbers(const MapOptions& options) {
  Random random(7);
  Map map(options);
  const double unit = options.min_cell_size;
  for (int scan = 0; scan < 3; ++scan) {
    Scan<Map::kDim> beams;
    beams.origins = Vector<Map::kDim>::Constant((0.3 + scan) * unit);
    beams.endpoints.resize(Map::kDim, 60);
    for (int i = 0; i < 60; ++i)
      for (int a = 0; a < Map::kDim; ++a) beams.endpoints(a, i) = random.uniform(-12.0, 12.0) * unit;
    map.insert(beams);
  }
  map.check_invariants();
  for_each_leaf(map.tree(), [&](const auto& leaf) { EXPECT_TRUE(std::isfinite(leaf.cell().log_odds())); });
  return map.stats().observed_leaves;
}

/// Options with one of them at an end of its bounds; cells are as large as the noise is where that is large.
MapOptions with_end(const std::string& option, bool most) {
  MapOptions options;
  for (const OptionRow& row : kOptionTable)
    if (option == row.name) options.*row.member = most ? row.bounds.most : row.bounds.least;
  if (option == "range_sigma_quadratic") options.min_cell_size = 2e-9;
  if (option == "max_cell_size" && !most) options.min_cell_size = options.max_cell_size;
  if (option == "max_cell_size" && most) options.min_cell_size = options.max_cell_size / 1024.0;
  if (option == "range_sigma")
    options.min_cell_size = std::max(options.min_cell_size, options.range_sigma);
  else
    options.range_sigma = std::min(options.range_sigma, options.min_cell_size);
  options.max_cell_size = std::max(options.max_cell_size, options.min_cell_size);
  if (options.max_cell_size > 1024.0 * options.min_cell_size)
    options.max_cell_size = 32.0 * options.min_cell_size;
  if (option == "hit_given_free" && most) options.miss_given_occupied = 1e-7 + 1e-6;
  if (option == "miss_given_occupied" && most) options.hit_given_free = 1e-7 + 1e-6;
  return options;
}

TEST(MapOptions, EveryRowIsAnOptionOfItsOwnAndRefusesWhatIsOutOfItsBounds) {
  const MapOptions defaults;
  EXPECT_NO_THROW(defaults.validate());
  int options_of_users = 0;
  for (const OptionRow& row : kOptionTable) {
    SCOPED_TRACE(row.name);
    for (const OptionRow& other : kOptionTable)
      EXPECT_EQ(row.member == other.member, std::string(row.name) == other.name);
    options_of_users += row.is_constant() ? 0 : 1;
    EXPECT_NE(row.kinds, 0u);
    EXPECT_STRNE(row.help, "");
    const double inf = std::numeric_limits<double>::infinity();
    for (const double value : {std::nextafter(row.bounds.least, -inf), std::nextafter(row.bounds.most, inf),
                               std::numeric_limits<double>::quiet_NaN()}) {
      if (row.bounds.contain(value)) continue;  // Memory has no upper bound.
      MapOptions options;
      options.*row.member = value;
      try {
        options.validate();
        ADD_FAILURE() << value << " was accepted";
      } catch (const OptionError& error) {
        EXPECT_EQ(error.field(), row.name);
        EXPECT_EQ(error.value(), describe_number(value));
        EXPECT_EQ(error.expected().find("in ["), 0u) << error.expected();
        EXPECT_EQ(error.what(), error.field() + " = " + error.value() + ": must be " + error.expected());
      }
    }
  }
  EXPECT_LE(options_of_users, 16) << "and N and the refinement: 18";
  MapOptions upside_down;
  upside_down.max_cell_size = 0.01;
  try {
    upside_down.validate();
    FAIL();
  } catch (const OptionError& error) {
    EXPECT_STREQ(error.what(), "max_cell_size = 0.01: must be at least min_cell_size = 0.05 m");
    EXPECT_EQ(error.other(), "min_cell_size");
  }
}

TEST(MapOptions, ArithmeticHoldsAtBothEndsOfEveryOption) {
  for (const OptionRow& row : kOptionTable) {
    const std::string name = row.name;
    for (const bool most : {false, true}) {
      SCOPED_TRACE(name + (most ? " at most" : " at least"));
      const MapOptions options = with_end(name, most);
      const bool leaves_room = options.hit_given_free < 1.0 - options.miss_given_occupied;
      if (leaves_room) {
        // Of a thousandth of the beams, none may be left.
        const std::size_t least = name == "sample_beams" && !most ? 0 : 1;
        EXPECT_GE((expect_sane_numbers<AdaptiveMap<2, 2>>(options)), least);
        EXPECT_GE((expect_sane_numbers<AdaptiveMap<3, 3>>(options)), least);
      } else {
        EXPECT_THROW((AdaptiveMap<2, 2>(options)), std::invalid_argument);
      }
      EXPECT_GT((expect_sane_numbers<PaperMap<2, 2>>(options)), 0u);
      EXPECT_GT((expect_sane_numbers<FixedMap<2, 2>>(options)), 0u);
    }
  }
}

TEST(MapOptions, ArithmeticHoldsWhereManyOptionsAreAtTheirEnds) {
  Random random(11);
  std::size_t observed = 0;
  for (int run = 0; run < 200; ++run) {
    MapOptions options;
    for (const OptionRow& row : kOptionTable) {
      const std::string option = row.name;
      if (option.find("cell_size") != std::string::npos || option.find("sigma") != std::string::npos)
        continue;
      if (option == "hit_given_free" || option == "miss_given_occupied") continue;
      if (random.chance(0.6)) options.*row.member = random.chance(0.5) ? row.bounds.least : row.bounds.most;
    }
    SCOPED_TRACE(run);
    observed += expect_sane_numbers<AdaptiveMap<2, 2>>(options);
  }
  EXPECT_GT(observed, 2000u);
}

}  // namespace
}  // namespace ndtree::test::test_occupancy_map
