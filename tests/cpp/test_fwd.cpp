// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/fwd.hpp"

namespace ndtree::test_fwd {
namespace {

// As a header that names maps would, before anything of them is defined.
CellState state_of(const AdaptiveMap<2, 3>& map, const Scan<3>& scan);
template <int D>
InsertReport insert_into(FixedMap<3, D>& map, const ScanView<D>& scan);
struct Robot {
  const MapOptions* options = nullptr;
  AdaptiveMap<2, 3>* map = nullptr;
  PaperMap<4, 2>* paper = nullptr;
  const MapCells<2, 3, class SomeCell>* cells = nullptr;
  LayeredMap<AdaptiveMap<2, 3>, class SomeValue>* layered = nullptr;
  const Layer<2, 3, class SomeValue>* layer = nullptr;
  const Box<3>* box = nullptr;
  const Change<3>* change = nullptr;
  const Frontier<3>* frontier = nullptr;
  const FrontierSearch<AdaptiveMap<2, 3>>* search = nullptr;
  const DistanceField<3>* field = nullptr;
  const MapStats* stats = nullptr;
};

}  // namespace
}  // namespace ndtree::test_fwd

#include <gtest/gtest.h>

#include <fstream>
#include <regex>
#include <set>
#include <string>
#include <type_traits>

#include "ndtree/ndtree.hpp"

namespace ndtree::test_fwd {
namespace {

CellState state_of(const AdaptiveMap<2, 3>& map, const Scan<3>& scan) {
  return state(map, Vector<3>(scan.endpoints.col(0)));
}
template <int D>
InsertReport insert_into(FixedMap<3, D>& map, const ScanView<D>& scan) {
  return map.insert(scan);
}

// What was declared is what is defined: a second declaration with other parameters would not compile.
static_assert(std::is_same_v<AdaptiveMap<2, 3>, OccupancyMap<2, 3, EvidenceRefinement, BeamSensorModel>>);
static_assert(std::is_same_v<PaperMap<2, 3>, OccupancyMap<2, 3, PaperRefinement>>);
static_assert(std::is_same_v<FixedMap<2, 3>, OccupancyMap<2, 3, FixedRefinement>>);
static_assert(std::is_base_of_v<MapCells<2, 3, EvidenceCell>, AdaptiveMap<2, 3>>);
static_assert(std::is_same_v<std::underlying_type_t<CellState>, std::int8_t>);

TEST(Forward, DeclaresTheTypesThatTheLibraryDefines) {
  MapOptions options;
  AdaptiveMap<2, 3> map(options);
  Scan<3> scan;
  scan.origins = Points<3>::Zero(3, 1);
  scan.endpoints = Vector<3>(2.0, 0.3, 0.4);
  Robot robot;
  robot.options = &map.options();
  robot.map = &map;
  robot.map->insert(scan);
  EXPECT_EQ(map.stats().scans, 1u);
  EXPECT_EQ(state_of(*robot.map, scan), state(map, Vector<3>(2.0, 0.3, 0.4)));
  FixedMap<3, 3> fixed(options);
  EXPECT_EQ(insert_into(fixed, scan.view()).returned, 1u);
}

TEST(Forward, IncludesNothingThatTakesLongToCompile) {
  std::ifstream file(NDTREE_SOURCE_DIR "/include/ndtree/fwd.hpp");
  ASSERT_TRUE(file);
  const std::regex include(R"(\s*#\s*include\s*([<"][^>"]*[>"]).*)");
  std::set<std::string> included;
  std::smatch match;
  for (std::string line; std::getline(file, line);)
    if (std::regex_match(line, match, include)) included.insert(match[1]);
  EXPECT_EQ(included, std::set<std::string>{"<cstdint>"});
}

}  // namespace
}  // namespace ndtree::test_fwd
