// SPDX-License-Identifier: BSD-3-Clause
// Paths through random worlds, against plain looks at every smallest cell.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <optional>
#include <queue>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/thin_things.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/planning/planner.hpp"
#include "ndtree/query/point.hpp"
#include "random.hpp"
#include "random_rotation.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_planner {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kUnit = 0.25;

template <class Map>
class Planning : public testing::Test {};
using Maps = testing::Types<AdaptiveMap<2, 2>, FixedMap<2, 3>>;
TYPED_TEST_SUITE(Planning, Maps);

template <int D>
Box<D> random_box(Random& random, double reach, double largest) {
  Box<D> box;
  for (int a = 0; a < D; ++a) {
    box.lower[a] = kUnit * random.integer(static_cast<int>(-reach / kUnit), static_cast<int>(reach / kUnit));
    box.upper[a] = box.lower[a] + kUnit * random.integer(1, static_cast<int>(largest / kUnit));
  }
  return box;
}
/// Beams of which a few end in a smallest cell that most of them pass: adaptive maps keep it as free, with
/// something thin in it.
template <class Map>
void put_something_thin(Map& map, const Vector<Map::kDim>& place) {
  constexpr int D = Map::kDim;
  const Vector<D> center = ((place / kUnit).array().floor() + 0.5).matrix() * kUnit;
  Scan<D> scan;
  scan.origins = center - 2.0 * kUnit * Vector<D>::Unit(0);
  scan.endpoints = (center + 2.0 * kUnit * Vector<D>::Unit(0)).replicate(1, 12);
  scan.endpoints.leftCols(4).colwise() = center;
  scan.returned.setConstant(12, false);
  scan.returned.head(4) = true;
  for (int i = 0; i < 6; ++i) map.insert(scan);
}
/// Free space with obstacles, something thin, and holes of unknown space.
template <class Map>
Map random_world(Random& random, int boxes) {
  constexpr int D = Map::kDim;
  MapOptions options;
  options.min_cell_size = kUnit;
  options.max_cell_size = kUnit * Map::kBranching * Map::kBranching;
  options.range_sigma = 0.05;
  Map map(options);
  const double reach = D == 2 ? 4.0 : 2.0;
  map.mark(Box<D>{Vector<D>::Constant(-reach), Vector<D>::Constant(reach)}, CellState::free);
  Random places(static_cast<std::uint64_t>(boxes));
  for (int i = 0; i < 3; ++i) put_something_thin<Map>(map, random_box<D>(places, reach, 1.0).lower);
  for (; boxes > 0; --boxes) {
    const Box<D> box = random_box<D>(random, reach, D == 2 ? 2.0 : 1.5);
    if (random.chance(0.2))
      map.clear(box);
    else
      map.mark(box, CellState::occupied);
  }
  return map;
}
template <int D>
Body<D> random_body(Random& random) {
  Body<D> body;
  const int kind = random.integer(0, 3);
  if (kind == 0) {
    body.push_back(Capsule<D>{Vector<D>::Zero(), Vector<D>::Zero(), random.uniform(0.0, 0.4)});
  } else if (kind == 1 || kind == 3) {
    body.push_back(
        Capsule<D>{random_vector<D>(random, 0.3), random_vector<D>(random, 0.3), random.uniform(0.0, 0.3)});
  }
  if (kind >= 2)
    body.push_back(
        OrientedBox<D>{random_vector<D>(random, 0.2),
                       Vector<D>(Vector<D>::Constant(0.05) + random_vector<D>(random, 0.3).cwiseAbs()),
                       random_rotation<D>(random)});
  return body;
}
template <class Map>
bool collides_at(const Map& map, const Body<Map::kDim>& body, const Vector<Map::kDim>& at,
                 UnknownSpace unknown) {
  Pose<Map::kDim> pose;
  pose.translation = at;
  return collides(map, body, pose, unknown);
}

TYPED_TEST(Planning, SweepsAgreeWithPosesOnTheWay) {
  constexpr int D = TypeParam::kDim;
  Random random(401);
  int met = 0;
  int clear = 0;
  for (int round = 0; round < 8; ++round) {
    const TypeParam map = random_world<TypeParam>(random, 6);
    for (int i = 0; i < 60; ++i) {
      const Body<D> body = random_body<D>(random);
      const Vector<D> from = random_vector<D>(random, 2.0);
      const Vector<D> to = random.chance(0.1) ? from : random_vector<D>(random, 2.0);
      const UnknownSpace unknown = random.chance(0.5) ? UnknownSpace::free : UnknownSpace::occupied;
      const bool collides = sweep_collides(map, body, from, to, unknown);
      const double clearance = sweep_clearance(map, body, from, to, unknown, 5.0);
      const double step = (to - from).norm() / 200.0;
      bool is_met = false;
      bool is_nearly_met = false;
      bool is_within = false;
      for (int k = 0; k <= 200; ++k) {
        const Vector<D> at = from + (to - from) * (k / 200.0);
        is_met = is_met || collides_at(map, body, at, unknown);
        is_nearly_met = is_nearly_met || collides_at(map, inflated(body, step + 1e-6), at, unknown);
        // A larger box holds all that is so near: it meets whatever is.
        is_within = is_within || collides_at(map, inflated(body, clearance + step + 1e-6), at, unknown);
      }
      if (is_met) {
        ASSERT_TRUE(collides);
      }
      if (collides) {
        ASSERT_TRUE(is_nearly_met);
      }
      ASSERT_EQ(clearance <= 1e-9, collides);
      ASSERT_TRUE(is_within || clearance == 5.0);
      (collides ? met : clear)++;
    }
  }
  EXPECT_GT(met, 50);
  EXPECT_GT(clear, 50);
}

/// Whether a body meets something from some place in a smallest cell, by a look at each leaf.
template <class Map>
struct PlainPlaces {
  static constexpr int D = Map::kDim;
  struct Obstacle {
    Box<D> box;
    CellState state;
  };
  std::vector<Obstacle> obstacles;
  Box<D> root;

  explicit PlainPlaces(const Map& map) : root(map.tree().box(map.tree().root().index)) {
    const ThinThings thin(map);
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      const CellState state = thin.state_in_column(leaf.cell());
      if (state != CellState::free) obstacles.push_back({map.tree().box(leaf.index), state});
    });
  }
  Passage passage(const Lattice<D>& at, const Body<D>& body, double unknown_cost) const {
    Pose<D> pose;
    for (int a = 0; a < D; ++a)
      pose.translation[a] = (static_cast<double>(at[static_cast<std::size_t>(a)]) + 0.5) * kUnit;
    bool occupied = false;
    bool unknown = false;
    for (const BodyPart<D>& part : moved(body, pose)) {
      const Box<D> box = bounds_of(part).inflated(0.5 * kUnit);
      unknown = unknown || !root.encloses(box);
      for (const Obstacle& obstacle : obstacles)
        if (touch(part, obstacle.box.inflated(0.5 * kUnit)))
          (obstacle.state == CellState::occupied ? occupied : unknown) = true;
    }
    if (occupied || (unknown && !std::isfinite(unknown_cost))) return Passage::blocked;
    return unknown && unknown_cost > 1.0 ? Passage::costly : Passage::free;
  }
};
template <int D, class Visit>
void for_each_place(const LatticeBox<D>& box, const Visit& visit) {
  Lattice<D> at = box.lower;
  for (bool goes_on = true; goes_on;) {
    visit(at);
    goes_on = false;
    for (std::size_t a = 0; a < D && !goes_on; ++a) {
      goes_on = ++at[a] < box.upper[a];
      if (!goes_on) at[a] = box.lower[a];
    }
  }
}
template <class Map>
void free_space_is_that_of_all_places(FreeSpace<Map>& space, const Map& map, const Body<Map::kDim>& body,
                                      double unknown_cost, int& mixed) {
  constexpr int D = Map::kDim;
  const PlainPlaces<Map> plain(map);
  std::map<std::uint64_t, PlaceCell<D>> cells;
  std::map<Lattice<D>, std::uint64_t> number_at;
  for_each_place<D>(space.limits(), [&](const Lattice<D>& at) {
    const PlaceCell<D> cell = space.cell_at(at);
    const Passage expected = plain.passage(at, body, unknown_cost);
    ASSERT_EQ(cell.passage, expected);
    if (expected == Passage::blocked) return;
    mixed += static_cast<int>(cell.edge > 1);
    for (std::size_t a = 0; a < D; ++a) {
      ASSERT_LE(cell.lower[a], at[a]);
      ASSERT_GT(cell.lower[a] + cell.edge, at[a]);
    }
    cells[cell.number] = cell;
    number_at[at] = cell.number;
  });
  for (const auto& [number, cell] : cells) {
    std::set<std::uint64_t> beside, expected;
    space.for_each_beside(
        cell, [&](const PlaceCell<D>& other) { ASSERT_TRUE(beside.insert(other.number).second); });
    LatticeBox<D> own;
    for (std::size_t a = 0; a < D; ++a) {
      own.lower[a] = cell.lower[a];
      own.upper[a] = cell.lower[a] + cell.edge;
    }
    for (std::size_t a = 0; a < D; ++a)
      for (const std::int64_t plane : {cell.lower[a] - 1, cell.lower[a] + cell.edge}) {
        LatticeBox<D> side = own;
        side.lower[a] = plane;
        side.upper[a] = plane + 1;
        for_each_place<D>(side, [&](const Lattice<D>& at) {
          if (const auto found = number_at.find(at); found != number_at.end()) expected.insert(found->second);
        });
      }
    ASSERT_EQ(beside, expected);
  }
}
TYPED_TEST(Planning, FreeSpaceIsThatOfAllPlaces) {
  constexpr int D = TypeParam::kDim;
  Random random(402);
  int mixed = 0;
  for (const double cost : {kInfinity, 1.0, 3.0}) {
    TypeParam map = random_world<TypeParam>(random, 6);
    const Body<D> body = random_body<D>(random);
    const double reach = D == 2 ? 5.0 : 2.0;
    FreeSpace<TypeParam> space(map, body, cost,
                               {Vector<D>::Constant(-reach), Vector<D>::Constant(reach - 0.5)});
    free_space_is_that_of_all_places(space, map, body, cost, mixed);
    for (int change = 0; change < 2; ++change) {
      const TypeParam before = map.snapshot();
      if (change == 0)
        map.mark(random_box<D>(random, 2.0, 1.0), random.chance(0.5) ? CellState::occupied : CellState::free);
      else
        put_something_thin<TypeParam>(map, random_vector<D>(random, 1.0));
      detail::for_each_difference(before, map, [&](const CellIndex<D>& index) {
        LatticeBox<D> box;
        for (std::size_t a = 0; a < D; ++a) {
          box.lower[a] = index.lower[a];
          box.upper[a] = index.lower[a] + map.tree().geometry().edge(index.level);
        }
        space.forget(box);
      });
      free_space_is_that_of_all_places(space, map, body, cost, mixed);
    }
  }
  EXPECT_GT(mixed, 1000);
}

/// Length of the shortest way over centres of smallest cells, from face to face, with the body larger by a
/// cell; infinite if there is none.
template <class Map>
double plain_way(const Map& map, const Body<Map::kDim>& body, const LatticeBox<Map::kDim>& limits,
                 const Lattice<Map::kDim>& start, const Lattice<Map::kDim>& goal, UnknownSpace unknown) {
  constexpr int D = Map::kDim;
  const Body<D> larger = inflated(body, kUnit);
  const auto centre = [&](const Lattice<D>& at) {
    Vector<D> point;
    for (int a = 0; a < D; ++a)
      point[a] = (static_cast<double>(at[static_cast<std::size_t>(a)]) + 0.5) * kUnit;
    return point;
  };
  std::map<Lattice<D>, double> length;
  std::queue<Lattice<D>> next;
  const auto consider = [&](const Lattice<D>& at, double way) {
    if (length.count(at) != 0) return;
    for (std::size_t a = 0; a < D; ++a)
      if (at[a] < limits.lower[a] || at[a] >= limits.upper[a]) return;
    const bool is_free = !collides_at(map, larger, centre(at), unknown);
    length[at] = is_free ? way : kInfinity;
    if (is_free) next.push(at);
  };
  consider(start, 0.0);
  for (; !next.empty(); next.pop()) {
    const Lattice<D> at = next.front();
    if (at == goal) return length[at];
    for (std::size_t a = 0; a < D; ++a)
      for (const int by : {-1, 1}) {
        Lattice<D> beside = at;
        beside[a] += by;
        consider(beside, length[at] + kUnit);
      }
  }
  return kInfinity;
}
TYPED_TEST(Planning, PathsAreFreeAndFoundWhereDijkstraFindsOne) {
  constexpr int D = TypeParam::kDim;
  Random random(403);
  int found = 0;
  int none = 0;
  for (int round = 0; round < (D == 2 ? 40 : 8); ++round) {
    const TypeParam map = random_world<TypeParam>(random, D == 2 ? 14 : 8);
    Body<D> body = random_body<D>(random);
    PlannerOptions options;
    options.unknown_cost = round % 3 == 0 ? kInfinity : round % 3 == 1 ? 1.0 : 2.0;
    options.clearance = round % 5 == 0 ? 0.1 : 0.0;
    const UnknownSpace unknown = round % 3 == 0 ? UnknownSpace::occupied : UnknownSpace::free;
    Planner<TypeParam> planner(map, body, options);
    const Body<D> kept_away = inflated(body, options.clearance);
    for (int i = 0; i < 8; ++i) {
      const double reach = D == 2 ? 4.0 : 2.0;
      const Vector<D> start = random_vector<D>(random, reach);
      const Vector<D> goal = random_vector<D>(random, reach);
      if (collides_at(map, inflated(kept_away, 1e-5), start, unknown) ||
          collides_at(map, inflated(kept_away, 1e-5), goal, unknown))
        continue;
      const Path<D> path = planner.plan(start, goal);
      const Path<D> again = plan(map, start, goal, body, options);
      ASSERT_EQ(path.points, again.points);
      ASSERT_EQ(path.expanded, again.expanded);
      LatticeBox<D> limits;
      limits.lower.fill(D == 2 ? -40 : -16);
      limits.upper.fill(D == 2 ? 40 : 16);
      const auto& geometry = map.tree().geometry();
      const double way =
          plain_way(map, kept_away, limits, geometry.coordinates(start), geometry.coordinates(goal), unknown);
      if (path.status != PathStatus::found) {
        ASSERT_EQ(path.status, PathStatus::none);
        ASSERT_EQ(way, kInfinity);
        ++none;
        continue;
      }
      ++found;
      if (options.unknown_cost == 1.0 || !std::isfinite(options.unknown_cost)) {
        ASSERT_LE(path.length, 1.02 * way + kUnit * std::sqrt(double{D}));
      }
      ASSERT_EQ(path.points.front(), start);
      ASSERT_EQ(path.points.back(), goal);
      ASSERT_FALSE(planner.first_blocked(path.points).has_value());
      ASSERT_GE(path.clearance, options.clearance);
      for (std::size_t k = 0; k + 1 < path.points.size(); ++k)
        for (int step = 0; step <= 100; ++step)
          ASSERT_FALSE(collides_at(map, kept_away,
                                   path.points[k] + (path.points[k + 1] - path.points[k]) * (step / 100.0),
                                   unknown));
    }
  }
  EXPECT_GT(found, D == 2 ? 60 : 20);
  EXPECT_GE(none, D == 2 ? 3 : 0);
}
TYPED_TEST(Planning, FollowsTheMapAsOneMadeAnew) {
  constexpr int D = TypeParam::kDim;
  Random random(404);
  int found = 0;
  int blocked = 0;
  for (const double cost : {kInfinity, 1.0, 2.0}) {
    TypeParam map = random_world<TypeParam>(random, 5);
    PlannerOptions options;
    options.unknown_cost = cost;
    const Body<D> body{Capsule<D>{Vector<D>::Zero(), Vector<D>::Zero(), 0.2}};
    Planner<TypeParam> planner(map, body, options);
    for (int step = 0; step < 20; ++step) {
      const Box<D> box = random_box<D>(random, 2.0, 1.0);
      if (random.chance(0.2))
        map.clear(box);
      else
        map.mark(box, random.chance(0.5) ? CellState::occupied : CellState::free);
      const Vector<D> start = random_vector<D>(random, 2.0);
      const Vector<D> goal = random_vector<D>(random, 2.0);
      const auto answer = [&](Planner<TypeParam>& one) {
        try {
          return std::pair(one.plan(start, goal), std::string());
        } catch (const std::invalid_argument& error) {
          return std::pair(Path<D>{}, std::string(error.what()));
        }
      };
      const auto before = answer(planner);
      planner.update(map);
      Planner<TypeParam> anew(map, body, options);
      const auto now = answer(planner);
      const auto expected = answer(anew);
      ASSERT_EQ(now.second, expected.second);
      ASSERT_EQ(now.first.status, expected.first.status);
      ASSERT_EQ(now.first.points, expected.first.points);
      found += now.first.status == PathStatus::found;
      if (before.first.status == PathStatus::found && planner.first_blocked(before.first.points)) ++blocked;
    }
  }
  EXPECT_GT(found, 15);
  EXPECT_GT(blocked, 0);
}

TYPED_TEST(Planning, WaysAreNearlyThoseOfPaths) {
  constexpr int D = TypeParam::kDim;
  Random random(405);
  int finite = 0;
  int nearly_equal = 0;
  for (int round = 0; round < 6; ++round) {
    const TypeParam map = random_world<TypeParam>(random, D == 2 ? 14 : 8);
    PlannerOptions options;
    options.unknown_cost = round % 2 == 0 ? kInfinity : 1.0;
    Planner<TypeParam> planner(map, random_body<D>(random), options);
    Vector<D> start = random_vector<D>(random, 2.0);
    while (!planner.is_free(start, start)) start = random_vector<D>(random, 2.0);
    std::vector<Vector<D>> goals;
    for (int i = 0; i < 20; ++i) goals.push_back(random_vector<D>(random, 2.5));
    const std::vector<double> ways = planner.ways(start, goals);
    for (std::size_t i = 0; i < goals.size(); ++i) {
      if (!planner.is_free(goals[i], goals[i])) {
        ASSERT_EQ(ways[i], kInfinity);
        continue;
      }
      const Path<D> path = planner.plan(start, goals[i]);
      if (path.status != PathStatus::found) {
        ASSERT_EQ(ways[i], kInfinity);
        continue;
      }
      ++finite;
      ASSERT_GE(ways[i], (goals[i] - start).norm() - 1e-9);
      nearly_equal += std::abs(ways[i] / path.length - 1.0) < 0.02;
      ASSERT_LE(ways[i], 1.2 * path.length + kUnit);
    }
  }
  EXPECT_GT(finite, 30);
  EXPECT_GT(nearly_equal, finite * 9 / 10);
}

/// No place where the body is free is left out; those from centres are exactly these.
TYPED_TEST(Planning, PossiblePlacesAreAllThatAreFreeSomewhere) {
  constexpr int D = TypeParam::kDim;
  Random random(407);
  int free = 0;
  int blocked = 0;
  for (int round = 0; round < 4; ++round) {
    const double cost = round % 2 == 0 ? kInfinity : 1.0;
    const UnknownSpace unknown = round % 2 == 0 ? UnknownSpace::occupied : UnknownSpace::free;
    const TypeParam map = random_world<TypeParam>(random, 8);
    const Body<D> body = random_body<D>(random);
    const double reach = D == 2 ? 4.0 : 1.5;
    const Box<D> around{Vector<D>::Constant(-reach), Vector<D>::Constant(reach)};
    FreeSpace<TypeParam> possible(map, body, cost, around, detail::Touches::from_each);
    FreeSpace<TypeParam> centres(map, body, cost, around, detail::Touches::from_centre);
    for_each_place<D>(possible.limits(), [&](const Lattice<D>& at) {
      const auto is_free_at = [&](const Vector<D>& in_cell) {
        Vector<D> point;
        for (int a = 0; a < D; ++a)
          point[a] = kUnit * (static_cast<double>(at[static_cast<std::size_t>(a)]) + in_cell[a]);
        return !collides_at(map, body, point, unknown);
      };
      const bool is_possible = possible.cell_at(at).passage != Passage::blocked;
      const bool is_free = is_free_at(Vector<D>::Constant(0.5));
      ASSERT_EQ(centres.cell_at(at).passage != Passage::blocked, is_free);
      for (int k = 0; k < 3; ++k) {
        if (is_possible) break;
        ASSERT_FALSE(is_free_at(Vector<D>(0.5 * (random_vector<D>(random, 1.0).array() + 1.0))));
      }
      (is_free ? free : blocked)++;
    });
  }
  EXPECT_GT(free, 300);
  EXPECT_GT(blocked, 300);
}
/// Bodies that are larger than the cubes of places that are looked at once, where most are blocked.
TEST(Planning, LargeBodiesFitWhereTheyMeetNothing) {
  using Map = AdaptiveMap<2, 2>;
  Random random(415);
  int free = 0;
  int blocked = 0;
  for (int round = 0; round < 9; ++round) {
    MapOptions options;
    options.min_cell_size = kUnit;
    options.max_cell_size = 16.0 * kUnit;
    Map map(options);
    map.mark(Box<2>{{-24.0, -24.0}, {24.0, 24.0}}, CellState::free);
    for (int k = 0; k < 3; ++k) {
      const Vector<2> corner = random_vector<2>(random, 20.0);
      map.mark(Box<2>{corner, corner + Vector<2>(0.3, 0.3)}, CellState::occupied);
    }
    const double turn = random.uniform(-3.0, 3.0);
    Eigen::Matrix2d axes;
    axes << std::cos(turn), -std::sin(turn), std::sin(turn), std::cos(turn);
    const Vector<2> at = random_vector<2>(random, 3.0);
    const Body<2> body = round % 3 == 0   ? Body<2>{Capsule<2>{at, at, 9.0}}
                         : round % 3 == 1 ? Body<2>{Capsule<2>{at, Vector<2>(-at), 8.0}}
                                          : Body<2>{OrientedBox<2>{at, {7.0, 10.0}, axes}};
    const bool is_free_unknown = random.chance(0.5);
    const UnknownSpace unknown = is_free_unknown ? UnknownSpace::free : UnknownSpace::occupied;
    FreeSpace<Map> centres(map, body, is_free_unknown ? 1.0 : kInfinity, {{-16.0, -16.0}, {16.0, 16.0}},
                           detail::Touches::from_centre);
    for_each_place<2>(centres.limits(), [&](const Lattice<2>& place) {
      const Vector<2> centre(kUnit * (static_cast<double>(place[0]) + 0.5),
                             kUnit * (static_cast<double>(place[1]) + 0.5));
      const bool is_free = !collides_at(map, body, centre, unknown);
      ASSERT_EQ(centres.cell_at(place).passage != Passage::blocked, is_free);
      (is_free ? free : blocked)++;
    });
  }
  EXPECT_GT(free, 300);
  EXPECT_GT(blocked, 300);
}
/// A wall at x in [0, kUnit) with a gap of a width around y = 0, which lies anywhere between borders of
/// cells.
template <class Map>
Map wall_with_gap(double width, double shift) {
  constexpr int D = Map::kDim;
  MapOptions options;
  options.min_cell_size = kUnit / 8.0;
  options.max_cell_size = kUnit;
  Map map(options);
  map.mark(Box<D>{Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)}, CellState::free);
  Box<D> wall{Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)};
  wall.lower[0] = 0.0;
  wall.upper[0] = kUnit / 4.0;
  Box<D> lower = wall;
  Box<D> upper = wall;
  lower.upper[1] = shift - width / 2.0;
  upper.lower[1] = shift + width / 2.0;
  map.mark(lower, CellState::occupied);
  map.mark(upper, CellState::occupied);
  return map;
}
/// Gaps are some cells wide; the body is a ball that fits with ever less room.
TYPED_TEST(Planning, FindsGapsThatAreHardlyWiderThanTheBody) {
  constexpr int D = TypeParam::kDim;
  constexpr double kCell = kUnit / 8.0;
  int found = 0;
  for (int cells = 6; cells < 10; ++cells)
    for (const double room : {-0.05, 0.1, 0.4, 0.9, 1.2}) {  // Smallest cells.
      const TypeParam map = wall_with_gap<TypeParam>(cells * kCell, cells % 2 == 0 ? 0.0 : kCell / 2.0);
      const double radius = (cells - room) * kCell / 2.0;
      const Body<D> body{Capsule<D>{Vector<D>::Zero(), Vector<D>::Zero(), radius}};
      Vector<D> start = Vector<D>::Zero();
      Vector<D> goal = Vector<D>::Zero();
      start[0] = -0.6;
      goal[0] = 0.6;
      start[1] = goal[1] = 0.3;
      const Path<D> path = plan(map, start, goal, body);
      if (room < 0.0) {
        ASSERT_EQ(path.status, PathStatus::none);
        ASSERT_NE(path.reason.find("another part"), std::string::npos);
        continue;
      }
      if (D > 2 && room < 1.0) continue;  // In space, from centre to centre of cells.
      ASSERT_EQ(path.status, PathStatus::found) << cells << ' ' << room << ' ' << path.reason;
      ASSERT_TRUE(path.reason.empty());
      ASSERT_LT(path.length, 1.7);
      ++found;
    }
  EXPECT_EQ(found, D == 2 ? 16 : 4);
}
/// Out of a room whose door is hardly wider than the body, through unknown space that is free: the farther
/// the goal, the larger the cells on the way.
TYPED_TEST(Planning, FarGoalsTakeFewCells) {
  constexpr int D = TypeParam::kDim;
  constexpr double kCell = kUnit / 8.0;
  TypeParam map = wall_with_gap<TypeParam>(0.0, 0.0);
  for (int side = 0; side < 2 * D; ++side) {
    Box<D> wall{Vector<D>::Constant(-1.0), Vector<D>::Constant(1.0)};
    (side % 2 == 0 ? wall.upper : wall.lower)[side / 2] = side % 2 == 0 ? -1.0 + kUnit : 1.0 - kUnit;
    map.mark(wall, CellState::occupied);
  }
  Box<D> door{Vector<D>::Constant(-3.0 * kCell), Vector<D>::Constant(3.0 * kCell)};
  door.lower[0] = -1.0;
  door.upper[0] = -0.5;
  map.mark(door, CellState::free);
  PlannerOptions options;
  options.unknown_cost = 1.0;
  Vector<D> start = Vector<D>::Zero();
  start[0] = -0.4;
  for (const double far : {10.0, 1e4, D == 2 ? 1e7 : 3e4})
    for (int side = 0; side < 2 * D; ++side) {
      Planner<TypeParam> planner(map, {Capsule<D>{start * 0.0, start * 0.0, 2.45 * kCell}}, options);
      const Vector<D> goal = (side % 2 == 0 ? -far : far) * Vector<D>::Unit(side / 2);
      const Path<D> path = planner.plan(start, goal);
      ASSERT_EQ(path.status, PathStatus::found) << far << ' ' << side << ' ' << path.reason;
      ASSERT_LT(path.expanded, D == 2 ? 2000 : 30000) << far << ' ' << side;
      ASSERT_LT(path.length, far + 4.0);
      ASSERT_NEAR(planner.ways(start, {goal})[0], path.length, 0.1 + 1e-3 * path.length);
    }
}
/// Coarse cells are joined if some places on both sides of their face are: else a guide would call a goal
/// unreachable that is not, or lead into walls.
TYPED_TEST(Planning, CoarseSpaceJoinsWhatIsJoined) {
  constexpr int D = TypeParam::kDim;
  Random random(406);
  int joined = 0;
  int apart = 0;
  for (const double cost : {kInfinity, 2.0, 1.0, kInfinity, 2.0}) {
    const TypeParam map = random_world<TypeParam>(random, 10);
    const double reach = D == 2 ? 4.0 : 2.0;
    FreeSpace<TypeParam> space(map, random_body<D>(random), cost,
                               {Vector<D>::Constant(-reach), Vector<D>::Constant(reach)});
    detail::CoarseSpace<TypeParam> coarse(space);
    struct Pair {
      PlaceCell<D> from, to;
      std::size_t axis;
      bool is_open;
    };
    std::map<std::pair<std::uint64_t, std::uint64_t>, Pair> pairs;
    const auto is_passable = [&](const Lattice<D>& at) {
      return space.cell_at(at).passage != Passage::blocked;
    };
    for_each_place<D>(space.limits(), [&](const Lattice<D>& at) {
      for (std::size_t a = 0; a < D; ++a) {
        Lattice<D> next = at;
        if (++next[a] == space.limits().upper[a]) continue;
        const auto from = coarse.cell_at(at);
        const auto to = coarse.cell_at(next);
        if (from.number == to.number || from.passage == Passage::blocked || to.passage == Passage::blocked)
          continue;
        auto& pair = pairs.try_emplace({from.number, to.number}, Pair{from, to, a, false}).first->second;
        pair.is_open = pair.is_open || (is_passable(at) && is_passable(next));
      }
    });
    for (const auto& [numbers, pair] : pairs) {
      (pair.is_open ? joined : apart)++;
      for (const bool upwards : {true, false}) {
        const auto& from = upwards ? pair.from : pair.to;
        const auto& to = upwards ? pair.to : pair.from;
        ASSERT_EQ(coarse.are_joined(from, to, static_cast<int>(pair.axis), upwards), pair.is_open);
        bool is_beside = false;
        coarse.for_each_beside(from, [&](const auto& beside) { is_beside |= beside.number == to.number; });
        ASSERT_EQ(is_beside, pair.is_open);
      }
    }
  }
  EXPECT_GT(joined, 100);
  EXPECT_GT(apart, 3);
}
TYPED_TEST(Planning, NarrowCellsBesideAreThoseAtItsFaces) {
  constexpr int D = TypeParam::kDim;
  Random random(408);
  int narrow_ones = 0;
  for (const double cost : {kInfinity, 1.0}) {
    const TypeParam map = random_world<TypeParam>(random, 10);
    const Body<D> body = random_body<D>(random);
    const Box<D> around{Vector<D>::Constant(-2.0), Vector<D>::Constant(2.0)};
    FreeSpace<TypeParam> sure(map, inflated(body, 1e-6), cost, around);
    FreeSpace<TypeParam> possible(map, body, cost, around, detail::Touches::from_each);
    const UnknownSpace unknown = std::isfinite(cost) ? UnknownSpace::free : UnknownSpace::occupied;
    detail::NarrowSpace<TypeParam> space(map, sure, possible, body, unknown);
    const auto at_place = [&](const Lattice<D>& at) -> std::optional<PlaceCell<D>> {
      const auto cell = sure.cell_at(at);
      if (cell.passage != Passage::blocked) return cell;
      if (possible.cell_at(at).passage == Passage::blocked) return std::nullopt;
      return space.narrow_at(at);
    };
    for_each_place<D>(sure.limits(), [&](const Lattice<D>& at) {
      const std::optional<PlaceCell<D>> cell = at_place(at);
      if (!cell || cell->lower != at) return;
      narrow_ones += space.is_narrow(*cell);
      std::set<std::uint64_t> expected, beside;
      LatticeBox<D> box{cell->lower, cell->lower};
      for (std::size_t a = 0; a < D; ++a) {
        --box.lower[a];
        box.upper[a] += cell->edge + 1;
      }
      for_each_place<D>(box, [&](const Lattice<D>& other) {
        int outside = 0;
        for (std::size_t a = 0; a < D; ++a)
          outside += other[a] < cell->lower[a] || other[a] >= cell->lower[a] + cell->edge;
        if (outside != 1) return;
        if (const auto found = at_place(other)) expected.insert(found->number);
      });
      space.for_each_beside(*cell, [&](const PlaceCell<D>& found) { beside.insert(found.number); });
      ASSERT_EQ(beside, expected);
    });
  }
  EXPECT_GT(narrow_ones, 10);
}
/// Cells in a row.
struct Row {
  static constexpr int D = 2;
  std::int64_t count;
  void for_each_beside(const PlaceCell<2>& cell,
                       const std::function<void(const PlaceCell<2>&)>& visit) const {
    for (const std::int64_t x : {cell.lower[0] - 1, cell.lower[0] + 1})
      if (x >= 0 && x < count) visit({{x, 0}, 1, Passage::free, static_cast<std::uint64_t>(x)});
  }
};
/// Looks at as many cells of a row as it is told, and says whether that were all.
TEST(Planning, FloodsEndWithTheirCells) {
  for (std::int64_t count = 1; count < 6; ++count)
    for (std::size_t most = 0; most < 8; ++most)
      for (std::int64_t wanted = 0; wanted < 8; ++wanted) {
        Row row{count};
        detail::GoalFlood<Row> flood(row);
        flood.add({{0, 0}, 1, Passage::free, 0});
        const auto looked = std::min(most, static_cast<std::size_t>(count));
        std::size_t seen = 0;
        const auto met = [&](const PlaceCell<2>& cell) {
          seen += cell.lower[0] != wanted;
          return cell.lower[0] == wanted;
        };
        const bool is_met = static_cast<std::size_t>(wanted) < looked;
        ASSERT_EQ(flood.run(most, met), is_met ? detail::Joined::yes
                                        : looked == static_cast<std::size_t>(count)
                                            ? detail::Joined::no
                                            : detail::Joined::perhaps);
        ASSERT_EQ(seen, is_met ? static_cast<std::size_t>(wanted) : looked);
      }
}
/// Place, and how far away it is said to be.
template <int D>
std::pair<Vector<D>, double> told_place(const std::string& message) {
  const std::string begin = "the nearest place where it fits is ";
  std::istringstream text(message.substr(message.find(begin) + begin.size()));
  std::pair<Vector<D>, double> told;
  text >> told.second;
  text.ignore(100, '(');
  for (int a = 0; a < D; ++a) {
    text >> told.first[a];
    text.ignore(1);
  }
  EXPECT_TRUE(text) << message;
  return told;
}
TYPED_TEST(Planning, NearestPlaceIsThatOfManySamples) {
  constexpr int D = TypeParam::kDim;
  Random random(407);
  int found = 0;
  int nowhere = 0;
  for (int round = 0; round < 24; ++round) {
    const double reach = D == 2 ? 4.0 : 2.0;
    const TypeParam map = random_world<TypeParam>(random, 10);
    PlannerOptions options;
    options.unknown_cost = std::vector<double>{kInfinity, 2.0, 1.0}[static_cast<std::size_t>(round % 3)];
    Planner<TypeParam> planner(map, inflated(random_body<D>(random), round < 4 ? 4.0 : 0.3), options);
    for (int i = 0; i < (D == 2 ? 10 : 4); ++i) {
      const Vector<D> at = random_vector<D>(random, 1.5 * reach);
      if (planner.is_free(at, at)) continue;
      const std::string message = refusal_by([&] { (void)planner.plan(at, at); });
      double none_within = 3.0 * reach;
      if (message.find("no place was found where it fits") != std::string::npos) {
        ++nowhere;
      } else {
        const auto [place, away] = told_place<D>(message);
        ASSERT_TRUE(planner.is_free(place, place)) << message;
        ASSERT_NEAR((place - at).norm(), away, 0.01 * kUnit + 1e-6);
        none_within = std::max(0.0, (place - at).norm() - kUnit / 32.0);
        ++found;
      }
      for (int sample = 0; sample < (D == 2 ? 2000 : 300); ++sample) {
        const Vector<D> way = random_vector<D>(random, 1.0);
        const Vector<D> other = at + way.normalized() * none_within * std::pow(random.uniform(), 0.3);
        ASSERT_FALSE(planner.is_free(other, other)) << message << describe_point(other);
      }
    }
  }
  EXPECT_GT(found, 30);
  EXPECT_GT(nowhere, 4);
}
/// Bricks around a body of hundreds of cells take long.
TEST(Planning, NearestPlaceOfAHugeBody) {
  MapOptions options;
  options.min_cell_size = 0.05;
  options.max_cell_size = 1.6;
  AdaptiveMap<2, 2> map(options);
  map.mark(Box<2>{{0.0, 0.0}, {0.05, 0.05}}, CellState::occupied);
  PlannerOptions over_unknown;
  over_unknown.unknown_cost = 1.0;
  const Body<2> body{Capsule<2>{{0.0, 0.0}, {0.0, 0.0}, 50.0}};
  const auto message = [&](double max_seconds) {
    Planner<AdaptiveMap<2, 2>> planner(map, body, over_unknown);
    return refusal_by([&] { (void)planner.plan({3.0, 0.0}, {3.0, 0.0}, max_seconds); });
  };
  EXPECT_NE(message(kInfinity).find("the nearest place where it fits is 47.05"), std::string::npos)
      << message(kInfinity);
  EXPECT_NE(message(0.0).find("; out of time before the nearest place where it fits was found"),
            std::string::npos)
      << message(0.0);
  const CancelScope stop([] { return true; });
  EXPECT_THROW((void)message(kInfinity), Cancelled);
  EXPECT_THROW((void)message(0.0), Cancelled);
}

TEST(Planning, NothingGoesThroughWhatIsThinnerThanACell) {
  MapOptions options;
  options.min_cell_size = kUnit;
  AdaptiveMap<2, 2> map(options);
  map.mark(Box<2>{Vector<2>(-3.0, -3.0), Vector<2>(3.0, 3.0)}, CellState::free);
  const Body<2> ball{Capsule<2>{Vector<2>::Zero(), Vector<2>::Zero(), 0.3}};
  Planner<AdaptiveMap<2, 2>> planner(map, ball);
  const Vector<2> here(-2.0, 0.1), rod(0.1, 0.1), there(2.0, 0.1);
  ASSERT_EQ(planner.plan(here, there).points.size(), 2u);
  put_something_thin(map, rod);
  ASSERT_EQ(state(map, rod), CellState::free);
  EXPECT_TRUE(collides_at(map, ball, rod, UnknownSpace::free));
  EXPECT_TRUE(planner.update(map));
  const Path<2> path = planner.plan(here, there);
  EXPECT_GT(path.points.size(), 2u);
  for (std::size_t i = 0; i + 1 < path.points.size(); ++i)
    EXPECT_FALSE(sweep_collides(map, ball, path.points[i], path.points[i + 1]));
  EXPECT_THROW((void)planner.plan(here, rod), std::invalid_argument);
}
TEST(Planning, SaysWhatIsWrong) {
  MapOptions options;
  options.min_cell_size = kUnit;
  options.max_cell_size = 4.0;
  AdaptiveMap<2, 2> map(options);
  map.mark(Box<2>{{-4.0, -4.0}, {4.0, 4.0}}, CellState::free);
  map.mark(Box<2>{{-0.25, -4.0}, {0.0, 4.0}}, CellState::occupied);
  const Body<2> body{Capsule<2>{{0.0, 0.0}, {0.0, 0.0}, 0.3}};
  Planner<AdaptiveMap<2, 2>> planner(map, body);
  const auto message = [&](const Vector<2>& start, const Vector<2>& goal) {
    return refusal_by([&] { (void)planner.plan(start, goal); });
  };
  EXPECT_EQ(message({0.1, 1.1}, {2.0, 2.0}),
            "start = (0.1, 1.1): there the body meets the occupied cell from (-0.25, 1.0) to (0.0, 1.25); "
            "the nearest place where it fits is 0.2025 m away, at (0.30078125, 1.09765625)");
  EXPECT_NE(
      message({2.0, 2.0}, {9.0, 9.0}).find("goal = (9.0, 9.0): there the body meets unknown space outside"),
      std::string::npos);
  EXPECT_NE(message({2.0, std::nan("")}, {1.0, 1.0}).find("start = (2.0, nan): must be finite"),
            std::string::npos);
  const std::vector<Vector<2>> no_places{{2.0, 2.0}, {std::nan(""), 0.0}};
  for (const auto& [question, name] :
       {std::pair(refusal_by([&] { (void)planner.first_blocked(no_places); }), "points"),
        std::pair(refusal_by([&] { (void)planner.corridors(no_places, 1.0); }), "points"),
        std::pair(refusal_by([&] {
                    (void)planner.ways({2.0, 2.0}, no_places);
                  }),
                  "goals")})
    EXPECT_EQ(question, std::string(name) + "[1] = (nan, 0.0): must be finite, and on the map's lattice");
  EXPECT_NE(message({2.0, 2.0}, {1e8, 0.0}).find("it fits is 99999996"), std::string::npos);
  const Path<2> none = planner.plan({-2.0, 0.0}, {2.0, 0.0});
  EXPECT_EQ(none.status, PathStatus::none);
  EXPECT_TRUE(none.points.empty());
  EXPECT_EQ(none.reason, "the goal is in another part of free space than the start: there is no way, proved");
  map.mark(Box<2>{{-0.25, 2.0}, {0.0, 3.5}}, CellState::free);  // A door.
  EXPECT_TRUE(planner.update(map));
  EXPECT_FALSE(planner.update(map));
  const Path<2> path = planner.plan({-2.0, 0.0}, {2.0, 0.0});
  ASSERT_EQ(path.status, PathStatus::found);
  // Around the lower post of the door, whose corners the body rounds at 0.3 m.
  const auto around = [](double reach) { return 2.0 * std::hypot(2.0 - 0.125, reach); };
  EXPECT_GT(path.length, around(2.0));
  EXPECT_LT(path.length, around(2.6));
  EXPECT_EQ(planner.plan({-2.0, 0.0}, {2.0, 0.0}, 0.0).status,
            PathStatus::found);  // Few cells: no clock is asked.
  PlannerOptions over_unknown;
  over_unknown.unknown_cost = 2.0;
  EXPECT_NEAR((Planner<AdaptiveMap<2, 2>>(map, body, over_unknown).plan({2.0, 1.0}, {2.0, 1.0}).clearance),
              1.7, 1e-9);
  PlannerOptions wrong;
  wrong.clearance = -1.0;
  EXPECT_THROW((Planner<AdaptiveMap<2, 2>>(map, body, wrong)), std::invalid_argument);
  EXPECT_THROW((Planner<AdaptiveMap<2, 2>>(map, Body<2>{})), std::invalid_argument);
  wrong.clearance = 1e9;
  EXPECT_EQ(refusal_by([&] { (void)Planner<AdaptiveMap<2, 2>>(map, body, wrong); }),
            "body: with its clearance it reaches 1e+09 m: with cells of 0.25 m at most 4096.0 m can be "
            "planned for");
  wrong = {};
  wrong.unknown_cost = 1e17;  // Beside it, metres of free space would be lost in rounding.
  EXPECT_EQ(refusal_by([&] { (void)Planner<AdaptiveMap<2, 2>>(map, body, wrong); }),
            "unknown = 1e+17: a cost must be <= 1e6; to go nowhere through unknown space, block it");
}

}  // namespace
}  // namespace ndtree::test::test_planner
