// SPDX-License-Identifier: BSD-3-Clause
// What planners and explorers ask, against plain looks at every leaf.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "ndtree/cell/thin_things.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/query/distance_field.hpp"
#include "ndtree/query/frontiers.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "random.hpp"
#include "random_maps.hpp"
#include "random_rotation.hpp"

namespace ndtree::test::test_planning_queries {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

template <class Map>
Map random_map(Random& random) {
  constexpr int D = Map::kDim;
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 0.25 * Map::kBranching * (D == 2 ? Map::kBranching : 1);
  options.range_sigma = 0.05;
  return test::random_map<Map>(random, options, 3);
}

template <int D>
struct PlainLeaf {
  Box<D> box;
  CellState state;
  bool observed;
};
/// @param thin counts as occupied.
template <class Map>
std::vector<PlainLeaf<Map::kDim>> plain_leaves(const Map& map, const ThinThings& thin = {}) {
  std::vector<PlainLeaf<Map::kDim>> leaves;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    leaves.push_back({map.tree().box(leaf.index), thin.state_in_column(leaf.cell()), leaf.cell().observed()});
  });
  return leaves;
}
template <int D>
Box<D> random_box(Random& random, double reach) {
  const Vector<D> a = random_vector<D>(random, reach, 0.25);
  const Vector<D> b = random_vector<D>(random, reach, 0.25);
  return {a.cwiseMin(b), a.cwiseMax(b) + Vector<D>::Constant(0.1)};
}

template <class Map>
void bounds_and_cells_are_those_of_all_leaves(Random& random) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  EXPECT_FALSE(bounds(Map(map.options())).has_value());
  const auto leaves = plain_leaves(map);
  Box<D> around{Vector<D>::Constant(kInfinity), Vector<D>::Constant(-kInfinity)};
  for (const auto& leaf : leaves)
    if (leaf.observed)
      around = {around.lower.cwiseMin(leaf.box.lower), around.upper.cwiseMax(leaf.box.upper)};
  ASSERT_TRUE(bounds(map).has_value());
  EXPECT_EQ(bounds(map)->lower, around.lower);
  EXPECT_EQ(bounds(map)->upper, around.upper);
  std::size_t found = 0;
  for (int i = 0; i < 30; ++i) {
    const Box<D> region = random_box<D>(random, 3.0);
    RegionStates states;
    states.free = random.chance(0.5);
    states.occupied = random.chance(0.5);
    states.unknown = random.chance(0.5);
    std::size_t expected = 0;
    for (const auto& leaf : leaves) expected += contains(states, leaf.state) && region.touches(leaf.box);
    std::size_t n = 0;
    for_each_leaf_of(map, region, states, [&](const auto&) { ++n; });
    ASSERT_EQ(n, expected);
    found += n;
    if (!states.unknown) continue;
    double volume = 0.0;  // Of the region, inside and outside the map.
    for (const Box<D>& part : outside_of(map.tree().box(map.tree().root().index), region))
      volume += (part.upper - part.lower).prod();
    const Box<D> root = map.tree().box(map.tree().root().index);
    const Vector<D> inside = (region.upper.cwiseMin(root.upper) - region.lower.cwiseMax(root.lower));
    if ((inside.array() > 0.0).all()) volume += inside.prod();
    ASSERT_NEAR(volume, (region.upper - region.lower).prod(), 1e-9);
  }
  EXPECT_GT(found, 100u);
}
TEST(PlanningQueries, BoundsAndCellsAreThoseOfAllLeaves) {
  Random random(310);
  bounds_and_cells_are_those_of_all_leaves<PaperMap<3, 2>>(random);
  bounds_and_cells_are_those_of_all_leaves<AdaptiveMap<2, 3>>(random);
}

template <class Map>
void nearest_point_is_that_of_all_leaves(Random& random) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  const auto leaves = plain_leaves(map);
  int none = 0;
  for (int i = 0; i < 200; ++i) {
    const Vector<D> point = random_vector<D>(random, 4.0, 0.25);
    double most = random.chance(0.5) ? kInfinity : random.uniform(0.0, 1.0);
    if (random.chance(0.3)) most = 0.25 * random.integer(0, 8);
    double expected = kInfinity;
    for (const auto& leaf : leaves)
      if (leaf.state == CellState::occupied) expected = std::min(expected, leaf.box.squared_distance(point));
    const auto nearest = nearest_occupied(map, point, most);
    ASSERT_EQ(occupied_within(map, point, most), expected <= most * most);
    ASSERT_EQ(distance_to_occupied(map, point), std::sqrt(expected));
    if (expected > most * most) {
      ASSERT_FALSE(nearest.has_value());
      ++none;
      continue;
    }
    ASSERT_TRUE(nearest.has_value());
    ASSERT_DOUBLE_EQ(nearest->distance, std::sqrt(expected));
    ASSERT_NEAR((nearest->point - point).norm(), nearest->distance, 1e-12);
    bool is_occupied = false;
    for (const auto& leaf : leaves)
      is_occupied = is_occupied ||
                    (leaf.state == CellState::occupied && leaf.box.squared_distance(nearest->point) == 0.0);
    ASSERT_TRUE(is_occupied);
  }
  EXPECT_GT(none, 10);
  const Vector<D> nowhere = Vector<D>::Constant(std::nan(""));
  EXPECT_FALSE(occupied_within(map, nowhere, 1.0));
  EXPECT_FALSE(distance_to_occupied(map, nowhere));
  EXPECT_FALSE(distance_to_occupied(Map(map.options()), Vector<D>::Zero().eval()));
}
TEST(PlanningQueries, TheNearestPointIsThatOfAllLeaves) {
  Random random(311);
  nearest_point_is_that_of_all_leaves<PaperMap<3, 2>>(random);
  nearest_point_is_that_of_all_leaves<AdaptiveMap<2, 3>>(random);
}

template <class Map>
void rays_end_where_leaves_say(Random& random, int& all_outside) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  int unknown = 0;
  int occupied = 0;
  int outside = 0;
  for (int i = 0; i < 400; ++i) {
    const Vector<D> origin = random_vector<D>(random, 2.5, 0.25);
    Vector<D> direction = random_vector<D>(random, 1.0, 0.25);
    if (direction.norm() == 0.0) continue;
    const double max_range = random.chance(0.3) ? 50.0 : random.uniform(0.1, 5.0);
    const auto plain = cast_ray(map, origin, direction, max_range, RayAim::cell);
    const auto traced = trace_ray(map, origin, direction, max_range, false, RayAim::cell);
    ASSERT_EQ(plain.has_value(), traced.has_value());
    if (plain) {
      ASSERT_EQ(*plain, traced->distance);
      ASSERT_EQ(traced->state, CellState::occupied);
      const Vector<D> end = origin + traced->distance * direction.normalized();
      ASSERT_LT(traced->cell->squared_distance(end), 1e-18);
    }
    const auto stopped = trace_ray(map, origin, direction, max_range, true, RayAim::cell);
    // Small steps along the ray: free up to its end, and not behind it.
    const double end = stopped ? stopped->distance : max_range;
    for (double t = 0.003; t < end - 1e-6; t += 0.01) {
      const auto leaf = map.tree().find_leaf(Vector<D>(origin + t * direction.normalized()));
      ASSERT_TRUE(leaf.has_value());
      ASSERT_EQ(leaf->cell().state(), CellState::free) << t << " of " << end;
    }
    if (!stopped) continue;
    ASSERT_LT(stopped->distance, max_range);
    const auto leaf = map.tree().find_leaf(Vector<D>(origin + (end + 1e-7) * direction.normalized()));
    if (!stopped->cell) {
      ++outside;
      ASSERT_FALSE(leaf.has_value());
      ASSERT_EQ(stopped->state, CellState::unknown);
    } else if (leaf && map.tree().box(leaf->index).lower == stopped->cell->lower) {
      if (stopped->state == CellState::occupied && leaf->cell().state() == CellState::free) {
        // Beams may have ended in it, and the unknown is behind it, at most a smallest cell away.
        ASSERT_TRUE(detail::may_end_beams(leaf->cell()));
        const double cell = map.options().min_cell_size;
        const auto next =
            map.tree().find_leaf(Vector<D>(origin + (end + cell + 1e-6) * direction.normalized()));
        ASSERT_TRUE(!next || next->index.lower != leaf->index.lower ||
                    next->index.level != leaf->index.level);
        const CellIndex<D> index = leaf->index;
        bool was_there = false;
        std::optional<CellState> behind;
        traverse_beam(map.tree(), origin, direction, 0.0, kInfinity, [&](const auto& other, double, double) {
          if (was_there && !behind) behind = other.cell().state();
          was_there = was_there || (other.index.lower == index.lower && other.index.level == index.level);
        });
        ASSERT_TRUE(was_there);
        ASSERT_EQ(behind.value_or(CellState::unknown), CellState::unknown);
        continue;
      }
      ASSERT_EQ(leaf->cell().state(), stopped->state);
      ++(stopped->state == CellState::occupied ? occupied : unknown);
    }
  }
  EXPECT_GT(unknown, 50);
  EXPECT_GT(occupied, 10);
  const auto from_outside = trace_ray(map, Vector<D>(Vector<D>::Constant(100.0)),
                                      Vector<D>(Vector<D>::Constant(-1.0)), 500.0, true);
  ASSERT_TRUE(from_outside.has_value());
  EXPECT_EQ(from_outside->distance, 0.0);
  EXPECT_FALSE(from_outside->cell.has_value());
  all_outside += outside;
}
TEST(PlanningQueries, RaysEndWhereLeavesSay) {
  Random random(312);
  int outside = 0;
  rays_end_where_leaves_say<AdaptiveMap<2, 2>>(random, outside);
  rays_end_where_leaves_say<AdaptiveMap<2, 3>>(random, outside);
  rays_end_where_leaves_say<PaperMap<3, 2>>(random, outside);  // Its large cells reach the border of the map.
  EXPECT_GT(outside, 0);
}

/// Wherever the map goes on behind it: max_range / length * length is often not max_range.
TEST(PlanningQueries, ARayThatEndsInFreeSpaceMeetsNothing) {
  Random random(318);
  MapOptions options;
  options.min_cell_size = 0.25;
  options.max_cell_size = 1.0;
  FixedMap<2, 2> map(options);
  Scan<2> scan;
  scan.origins = Vector<2>(-1.9, 0.1);
  scan.endpoints = Vector<2>(1.9, 0.1);
  scan.returned = {false};
  map.insert(scan);
  const Vector<2> origin(-1.5, 0.1);
  ASSERT_EQ(ndtree::state(map, origin), CellState::free);
  int shorter = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vector<2> direction(random.uniform(0.1, 3.0), 0.0);
    const double range = random.uniform(0.1, 3.0);
    shorter += range / direction.norm() * direction.norm() < range;
    ASSERT_FALSE(trace_ray(map, origin, direction, range, true, RayAim::cell).has_value())
        << direction[0] << ", " << range;
  }
  EXPECT_GT(shorter, 20);
}

template <class Map>
void distance_fields_are_exact(Random& random) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  auto leaves = plain_leaves(map, ThinThings(map));
  const Box<D> huge{Vector<D>::Constant(-50.0), Vector<D>::Constant(50.0)};
  for (const Box<D>& part : outside_of(map.tree().box(map.tree().root().index), huge))
    leaves.push_back({part, CellState::unknown, false});
  int inside = 0;
  int outside = 0;
  int far = 0;
  for (int i = 0; i < 12; ++i) {
    const Box<D> box = random_box<D>(random, 3.0);
    const double cell_size = random.chance(0.3) ? 0.25 : random.uniform(0.1, 0.6);
    const double most = random.chance(0.5) ? 20.0 : random.uniform(0.2, 2.0);
    const UnknownSpace unknown = random.chance(0.5) ? UnknownSpace::free : UnknownSpace::occupied;
    const DistanceField<D> field = distance_field(map, box, cell_size, most, unknown);
    std::size_t n = 0;
    auto at = field.shape();
    at.fill(0);
    for (std::size_t k = 0; k < field.values().size(); ++k, ++n) {
      std::size_t rest = k;
      Vector<D> point;
      for (std::size_t a = D; a-- > 0; rest /= field.shape()[a])
        point[static_cast<int>(a)] =
            box.lower[static_cast<int>(a)] + (static_cast<double>(rest % field.shape()[a]) + 0.5) * cell_size;
      double to_obstacle = kInfinity;
      double to_other = kInfinity;
      for (const auto& leaf : leaves) {
        const bool is_obstacle = leaf.state == CellState::occupied ||
                                 (leaf.state == CellState::unknown && unknown == UnknownSpace::occupied);
        (is_obstacle ? to_obstacle : to_other) =
            std::min(is_obstacle ? to_obstacle : to_other, leaf.box.squared_distance(point));
      }
      const double expected =
          to_obstacle > 0.0 ? std::min(std::sqrt(to_obstacle), most) : -std::min(std::sqrt(to_other), most);
      ASSERT_NEAR(static_cast<double>(field.values()[k]), expected, 1e-5);
      inside += expected < 0.0;
      outside += expected > 0.0;
      far += expected == most;
      ASSERT_NEAR(field.distance(point), static_cast<double>(field.values()[k]), 1e-6);
    }
  }
  EXPECT_GT(inside, 20);
  EXPECT_GT(outside, 100);
  EXPECT_GT(far, 0);
}
TEST(PlanningQueries, DistanceFieldsAreExact) {
  Random random(313);
  distance_fields_are_exact<PaperMap<3, 2>>(random);
  distance_fields_are_exact<AdaptiveMap<2, 3>>(random);
}

TEST(PlanningQueries, FieldsAreLinearBetweenCentres) {
  DistanceField<2> field(Vector<2>(1.0, 2.0), 0.5, {4, 3}, 10.0);
  for (std::size_t i = 0; i < 4; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      field.values()[i * 3 + j] =
          static_cast<float>(2.0 * (0.5 * static_cast<double>(i)) - 3.0 * (0.5 * static_cast<double>(j)));
  EXPECT_NEAR(field.distance(Vector<2>(1.25, 2.25)), 0.0, 1e-6);
  EXPECT_NEAR(field.distance(Vector<2>(1.6, 2.8)), 2.0 * 0.35 - 3.0 * 0.55, 1e-6);
  EXPECT_NEAR((field.gradient(Vector<2>(1.6, 2.8)) - Vector<2>(2.0, -3.0)).norm(), 0.0, 1e-6);
  EXPECT_TRUE(std::isnan(field.distance(Vector<2>(0.9, 2.8))));
  EXPECT_TRUE(std::isnan(field.gradient(Vector<2>(1.6, 3.6))[0]));
  EXPECT_NEAR(field.distance(Vector<2>(1.0, 2.25)), 0.0, 1e-6) << "as at the last centre";
  EXPECT_EQ(field.gradient(Vector<2>(1.6, 3.4))[1], 0.0) << "as at the last centre";
}

/// Every face between smallest cells, one by one.
template <class Map>
void frontiers_are_those_of_all_faces(Random& random) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  const auto leaves = plain_leaves(map);
  double area = 0.0;
  std::map<std::vector<double>, std::pair<Vector<D>, Vector<D>>>
      cells;  // Sums of centres, and of directions.
  const auto state_at = [&](const Vector<D>& point) {
    const auto leaf = map.tree().find_leaf(point);
    return leaf ? leaf->cell().state() : CellState::unknown;
  };
  for (const auto& leaf : leaves) {
    if (leaf.state != CellState::free) continue;
    const auto n = static_cast<int>(std::round((leaf.box.upper[0] - leaf.box.lower[0]) / 0.25));
    for (int axis = 0; axis < D; ++axis)
      for (const double side : {-1.0, 1.0}) {
        int count = 1;
        for (int a = 1; a < D; ++a) count *= n;
        for (int k = 0; k < count; ++k) {
          Vector<D> point;
          int rest = k;
          for (int a = 0; a < D; ++a) {
            if (a == axis) {
              point[a] = side < 0.0 ? leaf.box.lower[a] - 0.1 : leaf.box.upper[a] + 0.1;
              continue;
            }
            point[a] = leaf.box.lower[a] + 0.25 * (rest % n) + 0.125;
            rest /= n;
          }
          if (state_at(point) != CellState::unknown) continue;
          const double face = std::pow(0.25, D - 1);
          area += face;
          const std::vector<double> place(leaf.box.lower.data(), leaf.box.lower.data() + D);
          auto& [center, direction] =
              cells.emplace(place, std::pair(Vector<D>::Zero(), Vector<D>::Zero())).first->second;
          point[axis] -= 0.1 * side;
          center += face * point;
          direction[axis] += face * side;
        }
      }
  }
  const auto all = frontiers(map, std::nullopt, 0.0);
  double found = 0.0;
  std::set<std::vector<double>> of_frontiers;
  std::size_t directed = 0;
  for (std::size_t f = 0; f < all.size(); ++f) {
    found += all[f].area;
    if (f > 0) {
      ASSERT_LE(all[f].area, all[f - 1].area);
    }
    Vector<D> center = Vector<D>::Zero(), direction = Vector<D>::Zero();
    for (const Box<D>& cell : all[f].cells) {
      const std::vector<double> place(cell.lower.data(), cell.lower.data() + D);
      ASSERT_TRUE(of_frontiers.insert(place).second);
      ASSERT_EQ(cells.count(place), 1u);
      center += cells.at(place).first;
      direction += cells.at(place).second;
      for (std::size_t g = 0; g < f; ++g)
        for (const Box<D>& other : all[g].cells) ASSERT_FALSE(cell.touches(other)) << "they are one";
    }
    ASSERT_LT((all[f].center - center / all[f].area).norm(), 1e-9);
    const bool on_all_sides = direction.norm() < 1e-6 * all[f].area;
    directed += !on_all_sides;
    ASSERT_LT((all[f].direction - (on_all_sides ? direction : direction.normalized())).norm(), 1e-5);
  }
  EXPECT_EQ(of_frontiers.size(), cells.size());
  EXPECT_GT(directed, 1u);
  EXPECT_NEAR(found, area, 1e-9 * area);
  EXPECT_GT(all.size(), 1u);
  std::size_t large = 0;
  for (const auto& frontier : all) large += frontier.area >= 3.0 * std::pow(0.25, D - 1) * (1.0 - 1e-9);
  EXPECT_EQ(frontiers(map, std::nullopt, 3.0).size(), large);
}
TEST(PlanningQueries, FrontiersAreThoseOfAllFaces) {
  Random random(314);
  frontiers_are_those_of_all_faces<PaperMap<3, 2>>(random);
  frontiers_are_those_of_all_faces<AdaptiveMap<2, 3>>(random);
}

/// A shape meets a box if one of many points of the one lies in the other; never if none is near.
template <int D>
void touching_is_what_sampling_says(Random& random) {
  int touching = 0;
  int apart = 0;
  for (int i = 0; i < 3000; ++i) {
    const Vector<D> a = random_vector<D>(random, 1.0, 0.25);
    const Vector<D> b = random.chance(0.3) ? a : random_vector<D>(random, 1.0, 0.25);
    const BodyPart<D> part =
        random.chance(0.5) ? BodyPart<D>(Capsule<D>{a, b, random.uniform(0.0, 0.5)})
                           : BodyPart<D>(OrientedBox<D>{a, random_vector<D>(random, 0.5, 0.25).cwiseAbs(),
                                                        random_pose<D>(random, 2.5).rotation});
    const Box<D> box = random_box<D>(random, 1.5);
    // The least distance between the two by alternating projections, which are exact for convex sets.
    const auto onto_part = [&](const Vector<D>& p) -> Vector<D> {
      if (const auto* c = std::get_if<Capsule<D>>(&part)) {
        const Vector<D> way = c->b - c->a;
        const double t =
            way.squaredNorm() > 0.0 ? std::clamp((p - c->a).dot(way) / way.squaredNorm(), 0.0, 1.0) : 0.0;
        const Vector<D> on_axis = c->a + t * way;
        const double d = (p - on_axis).norm();
        return d <= c->radius ? p : Vector<D>(on_axis + (p - on_axis) * (c->radius / d));
      }
      const auto& oriented = std::get<OrientedBox<D>>(part);
      const Vector<D> local = oriented.axes.transpose() * (p - oriented.center);
      return oriented.center +
             oriented.axes * local.cwiseMax(-oriented.half_size).cwiseMin(oriented.half_size);
    };
    Vector<D> p = box.lower;
    double distance = 0.0;
    for (int step = 0; step < 3000; ++step) {
      const Vector<D> q = onto_part(p);
      const Vector<D> next = q.cwiseMax(box.lower).cwiseMin(box.upper);
      distance = (next - q).norm();
      if ((next - p).norm() < 1e-13) break;
      p = next;
    }
    if (distance > 1e-9 && distance < 1e-2) continue;  // Too near to say.
    const bool meets = distance <= 1e-9;
    ASSERT_EQ(touch(part, box), meets) << i << ", " << distance;
    (meets ? touching : apart)++;
    if (!meets) continue;
    const Box<D> around = bounds_of(part);
    ASSERT_TRUE(around.squared_distance(p) < 1e-12) << "the shape lies in its bounds";
    ASSERT_LE(p.norm(), reach_of(part) + 1e-9);
  }
  EXPECT_GT(touching, 300);
  EXPECT_GT(apart, 300);
}
TEST(Shape, TouchesABoxIfAPointLiesInBoth) {
  Random random(315);
  touching_is_what_sampling_says<2>(random);
  touching_is_what_sampling_says<3>(random);
}

template <class Map>
void collisions_are_those_with_all_leaves(Random& random) {
  constexpr int D = Map::kDim;
  const Map map = random_map<Map>(random);
  const auto leaves = plain_leaves(map, ThinThings(map));
  const Box<D> root = map.tree().box(map.tree().root().index);
  int hits = 0;
  int misses = 0;
  for (int i = 0; i < 300; ++i) {
    Body<D> body;
    const double size = random.chance(0.3) ? 1.2 : 0.2;  // Within small cells, and around large ones.
    const Vector<D> end = random_vector<D>(random, size, 0.25);
    const Vector<D> other = random.chance(0.3) ? end : random_vector<D>(random, size, 0.25);
    body.push_back(Capsule<D>{end, other, random.chance(0.1) ? 0.0 : random.uniform(0.01, size)});
    if (random.chance(0.5))
      body.push_back(OrientedBox<D>{random_vector<D>(random, size, 0.25),
                                    random_vector<D>(random, size, 0.25).cwiseAbs(),
                                    random_pose<D>(random, 2.5).rotation});
    const Pose<D> pose = random_pose<D>(random, 2.5);
    for (const UnknownSpace unknown : {UnknownSpace::free, UnknownSpace::occupied}) {
      bool expected = false;
      for (const auto& part : body) {
        const auto placed = moved(part, pose);
        for (const auto& leaf : leaves)
          expected = expected || ((leaf.state == CellState::occupied ||
                                   (leaf.state == CellState::unknown && unknown == UnknownSpace::occupied)) &&
                                  touch(placed, leaf.box));
        const Box<D> around = bounds_of(placed);
        expected = expected || (unknown == UnknownSpace::occupied &&
                                !((around.lower.array() >= root.lower.array()).all() &&
                                  (around.upper.array() <= root.upper.array()).all()));
      }
      ASSERT_EQ(collides(map, body, pose, unknown), expected);
      (expected ? hits : misses)++;
    }
    const Pose<D> next = random_pose<D>(random, 2.5);
    const bool on_the_way = collides_between(map, body, pose, next);
    if (collides(map, body, pose) || collides(map, body, next)) {
      ASSERT_TRUE(on_the_way);
    }
    for (int k = 0; k <= 37 && !on_the_way; ++k) {  // It meets nothing, but for what the step leaves open.
      Body<D> thinner{Capsule<D>{std::get<Capsule<D>>(body[0]).a, std::get<Capsule<D>>(body[0]).b, 0.0}};
      if (std::get<Capsule<D>>(body[0]).radius < 0.0625) break;
      ASSERT_FALSE(collides(map, thinner, between(pose, next, k / 37.0)));
    }
  }
  EXPECT_GT(hits, 50);
  EXPECT_GT(misses, 50);
}
TEST(PlanningQueries, CollisionsAreThoseWithAllLeaves) {
  Random random(316);
  collisions_are_those_with_all_leaves<AdaptiveMap<2, 3>>(random);
  collisions_are_those_with_all_leaves<PaperMap<3, 2>>(random);
}

TEST(Pose, TurnsTheShorterWayByEqualAngles) {
  Random random(317);
  for (int i = 0; i < 200; ++i) {
    const Pose<3> a = random_pose<3>(random, 2.5);
    const Pose<3> b = random_pose<3>(random, 2.5);
    ASSERT_LT((between(a, b, 0.0).rotation - a.rotation).norm(), 1e-9);
    ASSERT_LT((between(a, b, 1.0).rotation - b.rotation).norm(), 1e-9);
    const Pose<3> half = between(a, b, 0.5);
    ASSERT_NEAR(angle_between(a, half), 0.5 * angle_between(a, b), 1e-6);
    ASSERT_NEAR(angle_between(half, b), 0.5 * angle_between(a, b), 1e-6);
    const Pose<2> c = random_pose<2>(random, 2.5);
    const Pose<2> d = random_pose<2>(random, 2.5);
    ASSERT_LT((between(c, d, 1.0).rotation - d.rotation).norm(), 1e-9);
    ASSERT_NEAR(angle_between(c, between(c, d, 0.5)), 0.5 * angle_between(c, d), 1e-6);
  }
  Pose<3> turned;  // By half a turn.
  turned.rotation.diagonal() << -1.0, 1.0, -1.0;
  EXPECT_LT((between(Pose<3>{}, turned, 1.0).rotation - turned.rotation).norm(), 1e-9);
  EXPECT_NEAR(angle_between(Pose<3>{}, between(Pose<3>{}, turned, 0.5)), std::acos(0.0), 1e-9);
}

template <class Map>
void forgetting_takes_what_it_says(Random& random) {
  constexpr int D = Map::kDim;
  for (int i = 0; i < 10; ++i) {
    const Map before = random_map<Map>(random);
    Map map = before;
    const Box<D> box = random_box<D>(random, 1.5);
    const Vector<D> center = random_vector<D>(random, 1.0, 0.25);
    const double radius = random.uniform(0.3, 2.0);
    const int what = random.integer(0, 2);
    if (what == 0) map.crop(box);
    if (what == 1) map.clear(box);
    if (what == 2) map.keep_near(center, radius);
    map.check_invariants();
    int kept = 0;
    int gone = 0;
    for_each_leaf(before.tree(), [&](const auto& leaf) {
      if (!leaf.cell().observed()) return;
      const Box<D> cell = before.tree().box(leaf.index);
      // Its smallest cells, by their centres.
      const auto n = static_cast<int>(std::round((cell.upper[0] - cell.lower[0]) / 0.25));
      int count = 1;
      for (int a = 0; a < D; ++a) count *= n;
      for (int k = 0; k < count; ++k) {
        Box<D> small;
        int rest = k;
        for (int a = 0; a < D; ++a, rest /= n) small.lower[a] = cell.lower[a] + 0.25 * (rest % n);
        small.upper = small.lower + Vector<D>::Constant(0.25);
        const bool keeps = what == 0   ? cell.overlaps(box)
                           : what == 1 ? !small.overlaps(box)
                                       : cell.squared_distance(center) <= radius * radius;
        const auto now = map.tree().find_leaf(Vector<D>(0.5 * (small.lower + small.upper)));
        const CellState state = now ? now->cell().state() : CellState::unknown;
        ASSERT_EQ(state, keeps ? leaf.cell().state() : CellState::unknown);
        (keeps ? kept : gone)++;
      }
    });
    EXPECT_GT(kept + gone, 50);
    Scan<D> scan;
    scan.origins = center;
    scan.endpoints = random_vector<D>(random, 2.0, 0.25);
    map.insert(scan);  // It goes on.
    map.check_invariants();
  }
  Map map = random_map<Map>(random);
  const std::size_t full = map.memory_bytes();
  const Map whole = map;
  for (const double everything : {1e10, 1e200, std::numeric_limits<double>::infinity()}) {
    map.keep_near(Vector<D>::Constant(1000.0), everything);
    EXPECT_TRUE(changes(whole, map).empty()) << everything;
    EXPECT_EQ(map.stats().leaves, whole.stats().leaves) << everything;
  }
  EXPECT_THROW(map.keep_near(Vector<D>::Zero(), std::nan("")), std::invalid_argument);
  map.keep_near(Vector<D>::Constant(1000.0), 1.0);
  EXPECT_EQ(map.stats().leaves, 1u);
  EXPECT_LE(map.memory_bytes(), full);
  EXPECT_THROW(map.crop(Box<D>{Vector<D>::Zero(), Vector<D>::Zero()}), std::invalid_argument);
  EXPECT_THROW(map.keep_near(Vector<D>::Zero(), -1.0), std::invalid_argument);
}
TEST(Forgetting, TakesWhatItSays) {
  Random random(318);
  forgetting_takes_what_it_says<PaperMap<3, 2>>(random);
  forgetting_takes_what_it_says<FixedMap<2, 2>>(random);
  forgetting_takes_what_it_says<AdaptiveMap<2, 3>>(random);
}

/// A robot that drives on for ever, with a window around it.
TEST(Forgetting, AWindowHoldsAsMuchAsIsInIt) {
  Random random(319);
  MapOptions options;
  options.min_cell_size = 0.1;
  options.max_cell_size = 1.6;
  AdaptiveMap<2, 2> map(options);
  std::size_t most = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vector<2> at(2.0 * i, 0.0);
    Scan<2> scan;
    scan.origins = at;
    scan.endpoints.resize(2, 60);
    for (int k = 0; k < 60; ++k) {
      const double angle = 0.1 * k;
      scan.endpoints.col(k) = at + random.uniform(3.0, 8.0) * Vector<2>(std::cos(angle), std::sin(angle));
    }
    map.insert(scan);
    map.keep_near(at, 10.0);
    if (i >= 20) most = std::max(most, map.memory_bytes());
    if (i == 100) {
      EXPECT_LT(most, 300000u);
    }
  }
  map.check_invariants();
  EXPECT_LT(most, 400000u) << "4 km behind it";
}

}  // namespace
}  // namespace ndtree::test::test_planning_queries
