// SPDX-License-Identifier: BSD-3-Clause
// What people know better: space that a body takes is forgotten, or gets a state.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <limits>
#include <string>
#include <type_traits>
#include <vector>

#include "map_kinds.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/forget_rule.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "random_rotation.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_marks {
namespace {

constexpr double kUnit = 0.25;
constexpr int kAcross = 24;  // Smallest cells along an axis that are looked at, around 0.

template <int N>
MapOptions options_of() {
  MapOptions options;
  options.min_cell_size = kUnit;
  options.max_cell_size = kUnit * N * N;
  options.range_sigma = 0.05;
  return options;
}

template <class Map>
Map random_map(Random& random) {
  return test::random_map<Map>(random, options_of<Map::kBranching>(), 2);
}

template <int D>
Eigen::Matrix<double, D, D> random_turn(Random& random) {
  return random.chance(0.3) ? Eigen::Matrix<double, D, D>::Identity() : random_rotation<D>(random);
}

/// Capsules and boxes of all sizes, of which some hold cells of every level.
template <int D>
Body<D> random_body(Random& random) {
  Body<D> body;
  const int parts = random.integer(1, 2);
  for (int i = 0; i < parts; ++i) {
    if (random.chance(0.5)) {
      const Vector<D> a = random_vector<D>(random, 0.7, kUnit);
      body.push_back(Capsule<D>{a, random.chance(0.5) ? a : random_vector<D>(random, 0.7, kUnit),
                                random.chance(0.2) ? 0.0 : random.uniform(0.05, 1.2)});
    } else {
      body.push_back(OrientedBox<D>{random_vector<D>(random, 0.5, kUnit),
                                    random_vector<D>(random, 1.2, kUnit).cwiseAbs(), random_turn<D>(random)});
    }
  }
  return body;
}

/// Calls `visit(cell)` for each smallest cell around 0.
template <int D, class Visit>
void for_each_small(const Visit& visit) {
  int count = 1;
  for (int a = 0; a < D; ++a) count *= kAcross;
  for (int k = 0; k < count; ++k) {
    Box<D> cell;
    int rest = k;
    for (int a = 0; a < D; ++a, rest /= kAcross) cell.lower[a] = kUnit * (rest % kAcross - kAcross / 2);
    cell.upper = cell.lower + Vector<D>::Constant(kUnit);
    visit(cell);
  }
}
template <class Map, int D>
CellState state_at(const Map& map, const Box<D>& cell) {
  return state(map, Vector<D>(0.5 * (cell.lower + cell.upper)));
}

/// Each smallest cell that a change is about has one state afterwards, and all others are as they were.
template <class Map, class IsChanged>
void expect_states(const Map& before, const Map& after, CellState given, const IsChanged& is_changed,
                   int& changed, int& kept) {
  constexpr int D = Map::kDim;
  after.check_invariants();
  for_each_small<D>([&](const Box<D>& cell) {
    const bool changes = is_changed(cell);
    ASSERT_EQ(state_at(after, cell), changes ? given : state_at(before, cell))
        << cell.lower.transpose() << (changes ? " is in it" : " is not");
    (changes ? changed : kept) += state_at(before, cell) != given;
  });
}

template <class Map>
class Marks : public testing::Test {};
TYPED_TEST_SUITE(Marks, MapKinds);

TYPED_TEST(Marks, OfABodyAreTheCellsThatItTouches) {
  constexpr int D = TypeParam::kDim;
  Random random(701);
  int changed = 0;
  int kept = 0;
  for (int i = 0; i < 12; ++i) {
    const TypeParam before = random_map<TypeParam>(random);
    const Body<D> body = random_body<D>(random);
    const Pose<D> pose{random_turn<D>(random), random_vector<D>(random, 0.8, kUnit)};
    const Body<D> placed = moved(body, pose);
    const auto is_touched = [&](const Box<D>& cell) {
      return std::any_of(placed.begin(), placed.end(),
                         [&](const BodyPart<D>& part) { return touch(part, cell.inflated(1e-6 * kUnit)); });
    };
    TypeParam map = before;
    map.clear(body, pose);
    expect_states(before, map, CellState::unknown, is_touched, changed, kept);
    EXPECT_FALSE(collides(map, body, pose));
    for (const CellState given : {CellState::free, CellState::occupied}) {
      map = before;
      map.mark(body, pose, given);
      expect_states(before, map, given, is_touched, changed, kept);
      EXPECT_EQ(collides(map, body, pose), given == CellState::occupied);
      EXPECT_EQ(collides(map, body, pose, UnknownSpace::occupied), given == CellState::occupied);
      const std::string once = to_bytes(map);
      map.mark(body, pose, given);
      EXPECT_TRUE(to_bytes(map) == once) << "a mark again changes nothing";
    }
  }
  EXPECT_GT(changed, 500);
  EXPECT_GT(kept, 500);
}

/// A turned box whose sides lie on borders of cells but for rounding: what is decided for a large cell and
/// for its children may differ in the last bit.
TEST(MarksOnBorders, CollisionsSeeAllThatChanged) {
  Random random(706);
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 0.8;
  options.range_sigma = 0.02;
  const Body<3> body{
      OrientedBox<3>{Vector<3>::Zero(), Vector<3>(0.7, 0.3, 0.4), Eigen::Matrix3d::Identity()}};
  for (int i = 0; i < 20; ++i) {
    const Vector<3> place(1.7, 0.1 * random.integer(-9, 9), 0.1 * random.integer(-9, 9));
    const Pose<3> pose{Eigen::AngleAxisd(0.6, Vector<3>::UnitZ()).toRotationMatrix(), place};
    AdaptiveMap<2, 3> map(options);
    map.mark(Box<3>{Vector<3>::Constant(-4.0), Vector<3>::Constant(4.0)}, CellState::occupied);
    AdaptiveMap<2, 3> cleared = map;
    cleared.clear(body, pose);
    EXPECT_FALSE(collides(cleared, body, pose)) << place.transpose();
    AdaptiveMap<2, 3> freed(options);
    freed.mark(body, pose, CellState::free);
    EXPECT_FALSE(collides(freed, body, pose, UnknownSpace::occupied)) << place.transpose();
    freed = map;
    freed.mark(body, pose, CellState::free);
    EXPECT_FALSE(collides(freed, body, pose, UnknownSpace::occupied)) << place.transpose();
  }
}

TYPED_TEST(Marks, OfABoxAreTheCellsThatShareAVolumeWithIt) {
  constexpr int D = TypeParam::kDim;
  Random random(702);
  int changed = 0;
  int kept = 0;
  for (int i = 0; i < 8; ++i) {
    const TypeParam before = random_map<TypeParam>(random);
    const Vector<D> a = random_vector<D>(random, 1.5, kUnit);
    const Vector<D> b = random_vector<D>(random, 1.5, kUnit);
    const Box<D> box{a.cwiseMin(b), a.cwiseMax(b) + Vector<D>::Constant(0.1)};
    for (const CellState given : {CellState::free, CellState::occupied}) {
      TypeParam map = before;
      map.mark(box, given, random.integer(1, 40));
      expect_states(
          before, map, given, [&](const Box<D>& cell) { return cell.overlaps(box); }, changed, kept);
    }
  }
  EXPECT_GT(changed, 200);
  EXPECT_GT(kept, 200);
}

TYPED_TEST(Marks, DependOnTheSpaceAlone) {
  constexpr int D = TypeParam::kDim;
  // One box, and two halves of it, one after the other or as one body.
  const double edge = options_of<TypeParam::kBranching>().max_cell_size;
  const Box<D> whole{Vector<D>::Constant(-edge), Vector<D>::Constant(edge)};
  Box<D> left = whole;
  Box<D> right = whole;
  left.upper[0] = right.lower[0] = kUnit;
  for (const CellState given : {CellState::free, CellState::occupied}) {
    TypeParam at_once(options_of<TypeParam::kBranching>());
    TypeParam in_parts = at_once;
    at_once.mark(whole, given);
    in_parts.mark(left, given);
    in_parts.mark(right, given);
    EXPECT_TRUE(to_bytes(in_parts) == to_bytes(at_once));
    const auto box_of = [](const Box<D>& box) {
      const Vector<D> slightly = Vector<D>::Constant(0.01);  // Not to touch what is beside it.
      return OrientedBox<D>{0.5 * (box.lower + box.upper), 0.5 * (box.upper - box.lower) - slightly,
                            Eigen::Matrix<double, D, D>::Identity()};
    };
    TypeParam as_body(options_of<TypeParam::kBranching>());
    as_body.mark(Body<D>{box_of(left), box_of(right)}, {}, given);
    EXPECT_TRUE(to_bytes(as_body) == to_bytes(at_once));
  }
}

TYPED_TEST(Marks, AreWorthSoManyBeams) {
  constexpr int D = TypeParam::kDim;
  using Refinement = typename TypeParam::RefinementType;
  const MapOptions options = options_of<TypeParam::kBranching>();
  const Box<D> one{Vector<D>::Zero(), Vector<D>::Constant(kUnit)};
  const Vector<D> middle = Vector<D>::Constant(0.5 * kUnit);
  for (const int beams : {1, 3, 16, 511}) {
    for (const CellState given : {CellState::free, CellState::occupied}) {
      const bool is_occupied = given == CellState::occupied;
      TypeParam map(options);
      map.mark(one, given, beams);
      const auto cell = map.tree().find_leaf(middle)->cell();
      const double of_beam = log_odds(is_occupied ? options.probability_max : options.probability_min);
      EXPECT_TRUE(cell.observed());
      if constexpr (std::is_same_v<Refinement, EvidenceRefinement>) {
        const double evidence =
            std::min(beams * std::abs(of_beam), is_occupied ? options.evidence_memory : options.free_memory);
        const double found =
            static_cast<double>(is_occupied ? cell.occupied_evidence() : cell.free_evidence()) / 256.0;
        EXPECT_NEAR(found, evidence, 0.01 + 0.002 * evidence) << beams;
        EXPECT_EQ(is_occupied ? cell.free_evidence() : cell.occupied_evidence(), 0);
        EXPECT_TRUE(cell.is_covered());
      } else {
        EXPECT_NEAR(cell.log_odds(), std::clamp(beams * of_beam, options.log_odds_min, options.log_odds_max),
                    1e-5);
        EXPECT_EQ(is_occupied ? cell.hits() : cell.misses(), static_cast<std::uint32_t>(beams));
        EXPECT_EQ(is_occupied ? cell.misses() : cell.hits(), 0u);
      }
    }
  }
}

/// A scan whose beams fill a cone from the left through the middle of a plane x = 0.
template <int D>
Scan<D> scan_to(double x) {
  Scan<D> scan;
  scan.origins = Vector<D>::Constant(0.03);
  scan.origins(0, 0) = -2.9;
  const int across = 15;
  scan.endpoints.resize(D, D == 2 ? across : across * across);
  for (Eigen::Index i = 0; i < scan.endpoints.cols(); ++i) {
    scan.endpoints.col(i) = Vector<D>::Constant(x);
    scan.endpoints(1, i) = 0.03 + 0.1 * static_cast<double>(i % across - across / 2);
    if constexpr (D == 3) scan.endpoints(2, i) = 0.03 + 0.1 * static_cast<double>(i / across - across / 2);
  }
  return scan;
}

TYPED_TEST(Marks, AreChangedByLaterBeams) {
  constexpr int D = TypeParam::kDim;
  Random random(703);
  // Something occupied that is not there: beams that pass take it away. Its sides, of which beams see
  // nothing, stay.
  TypeParam map(options_of<TypeParam::kBranching>());
  Box<D> pillar{Vector<D>::Constant(-2.0), Vector<D>::Constant(2.0)};
  pillar.lower[0] = -1.0;
  pillar.upper[0] = 0.0;
  map.mark(pillar, CellState::occupied);
  const Vector<D> middle = (Vector<D>::Constant(0.03) - 0.45 * Vector<D>::Unit(0)).eval();
  const Vector<D> side = (middle + 1.5 * Vector<D>::Unit(1)).eval();
  int scans = 0;
  for (; scans < 60 && state(map, middle) != CellState::free; ++scans) {
    EXPECT_EQ(state(map, side), CellState::occupied) << scans;
    map.insert(scan_to<D>(2.0));
    map.check_invariants();
  }
  const bool needs_several = std::is_same_v<typename TypeParam::RefinementType, EvidenceRefinement>;
  EXPECT_GT(scans, needs_several ? 1 : 0);
  EXPECT_LT(scans, 40);
  EXPECT_EQ(state(map, middle), CellState::free);
  EXPECT_EQ(state(map, side), CellState::occupied);
  // And free space in which beams end.
  TypeParam other(options_of<TypeParam::kBranching>());
  other.mark(pillar, CellState::free);
  const Vector<D> end = (Vector<D>::Constant(0.03) - 0.53 * Vector<D>::Unit(0)).eval();
  for (scans = 0; scans < 60 && state(other, end) != CellState::occupied; ++scans)
    other.insert(scan_to<D>(end[0]));
  EXPECT_LT(scans, 40);
  other.check_invariants();
}

TYPED_TEST(Marks, ThatCannotBeChangeNothing) {
  constexpr int D = TypeParam::kDim;
  Random random(705);
  MapOptions options = options_of<TypeParam::kBranching>();
  TypeParam map(options);
  const Box<D> box{Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)};
  const Body<D> body{Capsule<D>{Vector<D>::Zero(), Vector<D>::Zero(), 0.5}};
  map.mark(box, CellState::free);
  const std::string before = to_bytes(map);
  const auto is_refused = [&](const std::function<void()>& call, const std::string& said) {
    expect_refused(call, said);
    EXPECT_TRUE(to_bytes(map) == before);
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  is_refused([&] { map.mark(box, CellState::unknown); }, "state = unknown");
  is_refused([&] { map.mark(box, CellState::free, 0); }, "beams = 0");
  is_refused([&] { map.mark(body, {}, CellState::free, 512); }, "beams = 512");
  is_refused([&] { map.mark(Box<D>{box.upper, box.lower}, CellState::free); }, "a volume");
  Pose<D> bad;
  bad.translation[0] = nan;
  is_refused([&] { map.mark(body, bad, CellState::free); }, "must be finite");
  is_refused([&] { map.clear(body, bad); }, "must be finite");
  bad.translation[0] = 1e15;
  is_refused([&] { map.mark(body, bad, CellState::occupied); }, "of 0");
  EXPECT_NO_THROW(map.clear(body, bad)) << "nothing is there";
  EXPECT_NO_THROW(map.mark(Body<D>{}, {}, CellState::occupied)) << "no cell is touched";
  EXPECT_TRUE(to_bytes(map) == before);
  options.max_memory = 40e3;
  TypeParam small(options);
  const std::string empty = to_bytes(small);
  EXPECT_THROW(
      small.mark(Body<D>{Capsule<D>{Vector<D>::Zero(), Vector<D>::Zero(), 50.0}}, {}, CellState::occupied),
      MemoryLimitReached);
  EXPECT_TRUE(to_bytes(small) == empty);
}

TEST(MarksOfLayers, ValuesStayWhereCellsAreMarkedAndGoWhereTheyAreForgotten) {
  using Map = LayeredMap<AdaptiveMap<2, 2>, MeanValue<1>>;
  Map map(options_of<2>());
  Scan<2> scan;
  scan.origins = Vector<2>(0.1, 0.1);
  scan.endpoints.resize(2, 2);
  scan.endpoints << 1.1, 1.1, 0.1, 1.1;
  using Measurement = MeanValue<1>::Measurement;
  map.insert(scan, std::vector<Measurement>{Measurement{3.0}, Measurement{5.0}});
  const Body<2> ball{Capsule<2>{Vector<2>(1.1, 0.1), Vector<2>(1.1, 0.1), 0.05}};
  const Map before = map;
  map.mark(ball, {}, CellState::free);
  EXPECT_EQ(state(map.map(), Vector<2>(1.1, 0.1)), CellState::free);
  EXPECT_FALSE(map.value<0>(Vector<2>(1.1, 0.1)).is_empty());
  map.clear(ball);
  EXPECT_TRUE(map.value<0>(Vector<2>(1.1, 0.1)).is_empty());
  EXPECT_FALSE(map.value<0>(Vector<2>(1.1, 1.1)).is_empty());
  EXPECT_FALSE(before.value<0>(Vector<2>(1.1, 0.1)).is_empty());
}

}  // namespace
}  // namespace ndtree::test::test_marks
