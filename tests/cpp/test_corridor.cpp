// SPDX-License-Identifier: BSD-3-Clause
// Convex free space along paths: every place in it is free, and it contains the path.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <vector>

#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/planning/cone.hpp"
#include "ndtree/planning/corridor.hpp"
#include "ndtree/planning/planner.hpp"
#include "random.hpp"
#include "random_rotation.hpp"

namespace ndtree::test::test_corridor {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Each plane, but for those of the box around, has an obstacle behind it that is behind no other, and would
/// not be were the plane a little farther out. @returns how many planes there are.
template <class Map>
int every_plane_is_needed_where_it_is(const Map& map, const Body<Map::kDim>& body,
                                      const std::vector<HalfSpace<Map::kDim>>& planes) {
  constexpr int D = Map::kDim;
  const RegionStates states = obstacles_of(map, UnknownSpace::occupied);
  const std::size_t first = 2 * std::size_t{D};
  std::vector<bool> is_needed(planes.size(), false);
  Box<D> around;
  for (int a = 0; a < D; ++a) {
    around.upper[a] = planes[2 * static_cast<std::size_t>(a)].offset;
    around.lower[a] = -planes[2 * static_cast<std::size_t>(a) + 1].offset;
  }
  for (const Box<D>& box : boxes_of(map, around.inflated(reach_of(body)), states))
    for (const BodyPart<D>& part : body) {
      std::size_t behind = 0;
      std::size_t last = 0;
      double room = 0.0;
      for (std::size_t i = 0; i < planes.size(); ++i) {
        double nearest = kInfinity;  // Of the box's corners, along the normal.
        for (unsigned corner = 0; corner < 1u << D; ++corner) {
          Vector<D> at;
          for (int a = 0; a < D; ++a) at[a] = (corner >> a & 1u) != 0 ? box.upper[a] : box.lower[a];
          nearest = std::min(nearest, planes[i].normal.dot(at));
        }
        const double beyond = nearest - detail::reach_along(part, planes[i].normal) - planes[i].offset;
        if (beyond < -1e-9) continue;
        ++behind;
        last = i;
        room = beyond;
      }
      EXPECT_GT(behind, 0u);
      if (behind == 1 && room < 1e-9) is_needed[last] = true;
    }
  for (std::size_t i = first; i < planes.size(); ++i) EXPECT_TRUE(is_needed[i]);
  return static_cast<int>(planes.size() - first);
}
template <class Map>
void corridors_are_free_and_contain_the_path(Random& random) {
  constexpr int D = Map::kDim;
  const double reach = D == 2 ? 4.0 : 2.0;
  const auto point = [&](double most) {
    Vector<D> result;
    for (int a = 0; a < D; ++a) result[a] = random.uniform(-most, most);
    return result;
  };
  int segments = 0;
  int inside = 0;
  int blocked = 0;
  int planes = 0;
  for (int round = 0; round < 12; ++round) {
    MapOptions options;
    options.min_cell_size = 0.25;
    options.max_cell_size = 2.0;
    Map map(options);
    map.mark(Box<D>{Vector<D>::Constant(-reach), Vector<D>::Constant(reach)}, CellState::free);
    for (int i = 0; i < 8; ++i) {
      const Vector<D> at = point(reach);
      map.mark(Box<D>{at, (at.array() + 0.5).matrix()}, CellState::occupied);
    }
    Body<D> body{Capsule<D>{point(0.2), point(0.2), 0.15}};
    if (round % 2 == 1)
      body.push_back(OrientedBox<D>{point(0.1), Vector<D>::Constant(0.2), random_rotation<D>(random)});
    Planner<Map> planner(map, body);
    for (int i = 0; i < 6; ++i) {
      const Vector<D> start = point(reach);
      const Vector<D> goal = point(reach);
      if (!planner.is_free(start, start) || !planner.is_free(goal, goal)) continue;
      const Path<D> path = planner.plan(start, goal);
      if (path.status != PathStatus::found) continue;
      const auto sets = corridors(map, body, path.points, 1.0);
      ASSERT_EQ(sets.size() + 1, path.points.size());
      for (std::size_t k = 0; k < sets.size(); ++k) {
        ++segments;
        const auto contains = [&](const Vector<D>& place, double slack) {
          for (const HalfSpace<D>& plane : sets[k])
            if (plane.normal.dot(place) > plane.offset + slack) return false;
          return true;
        };
        for (const HalfSpace<D>& plane : sets[k]) ASSERT_NEAR(plane.normal.norm(), 1.0, 1e-12);
        planes += every_plane_is_needed_where_it_is(map, body, sets[k]);
        ASSERT_TRUE(contains(path.points[k], 1e-9) && contains(path.points[k + 1], 1e-9));
        for (int sample = 0; sample < 300; ++sample) {
          const double along = random.uniform();
          const Vector<D> place = path.points[k] + along * (path.points[k + 1] - path.points[k]) + point(1.0);
          Pose<D> pose;
          pose.translation = place;
          const bool collides_there = collides(map, body, pose, UnknownSpace::occupied);
          blocked += collides_there;
          if (!contains(place, -1e-6)) continue;
          ++inside;
          ASSERT_FALSE(collides_there);
        }
      }
    }
  }
  EXPECT_GT(segments, 20);
  EXPECT_GT(planes, 40);
  EXPECT_GT(inside, 1000);
  EXPECT_GT(blocked, 1000);
}
TEST(Corridors, AreFreeAndContainThePath) {
  Random random(501);
  corridors_are_free_and_contain_the_path<AdaptiveMap<2, 2>>(random);
  corridors_are_free_and_contain_the_path<FixedMap<2, 3>>(random);
}
TEST(Corridors, RefuseAPathThatCollides) {
  AdaptiveMap<2, 2> map;
  map.mark(Box<2>{{-1.0, -1.0}, {1.0, 1.0}}, CellState::free);
  const Body<2> body{Capsule<2>{{0.0, 0.0}, {0.0, 0.0}, 0.1}};
  EXPECT_THROW((void)corridors(map, body, {{0.0, 0.0}, {3.0, 0.0}}, 1.0), std::invalid_argument);
  EXPECT_THROW((void)corridors(map, body, {{0.0, 0.0}, {0.5, 0.0}}, 0.0), std::invalid_argument);
  const auto sets = corridors(map, body, {{0.0, 0.0}, {0.5, 0.0}}, 0.5);
  ASSERT_EQ(sets.size(), 1u);
  EXPECT_EQ(sets[0].size(), 4u + 1u);  // The box, and the border of what was seen, to the right.
}

/// Cells side by side from that of a point on, of whole sizes, there and back; the faces between them.
template <int D>
std::vector<Box<D>> chain_of_faces(Random& random, const Vector<D>& from, int count) {
  std::vector<Box<D>> faces;
  Box<D> cell{from.array().floor().matrix(), (from.array().floor() + 1.0).matrix()};
  for (int i = 0; i < count; ++i) {
    const int axis = random.integer(0, D - 1);
    const bool ahead = random.chance(0.8);
    Box<D> face = cell;
    (ahead ? face.lower : face.upper)[axis] = (ahead ? face.upper : face.lower)[axis];
    for (int a = 0; a < D; ++a)
      if (a != axis && face.upper[a] - face.lower[a] > 1.0 && random.chance(0.3)) face.upper[a] -= 1.0;
    faces.push_back(face);
    cell = face;
    (ahead ? cell.upper : cell.lower)[axis] += (ahead ? 1 : -1) * random.integer(1, 3);
    for (int a = 0; a < D; ++a)
      if (a != axis && random.chance(0.5)) cell.upper[a] += random.integer(0, 2);
  }
  return faces;
}
/// How far inside each face the straight way through a point on the last one meets it, and how far ahead, at
/// least; below 0 if it does not. Cells of a search do not overlap, so it meets faces in their order.
template <int D>
double least_margin(const std::vector<Box<D>>& faces, const Vector<D>& from, const Vector<D>& to) {
  double least = 1e9;
  for (const Box<D>& face : faces) {
    int axis = 0;
    while (axis < D - 1 && face.lower[axis] != face.upper[axis]) ++axis;
    const double t = (face.lower[axis] - from[axis]) / (to[axis] - from[axis]);
    least = std::min(least, t);
    const Vector<D> at = from + t * (to - from);
    for (int a = 0; a < D; ++a)
      if (a != axis) least = std::min({least, at[a] - face.lower[a], face.upper[a] - at[a]});
  }
  return least;
}

template <int D>
void cone_sees_what_the_way_meets() {
  Random random(31 + D);
  int seen = 0, hidden = 0, moved = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    Vector<D> from;
    for (int a = 0; a < D; ++a) from[a] = random.uniform(0.01, 0.99);
    const auto faces = chain_of_faces<D>(random, from, random.integer(1, 6));
    detail::Cone<D> cone;
    for (const Box<D>& face : faces) cone.narrow(face, from);
    Vector<D> to;
    for (int a = 0; a < D; ++a) to[a] = random.uniform(faces.back().lower[a], faces.back().upper[a]);
    const double margin = least_margin<D>(faces, from, to);
    if (std::abs(margin) > 1e-9) {
      ASSERT_EQ(cone.contains(to - from), margin > 0.0) << "trial " << trial;
    }
    (margin > 0.0 ? seen : hidden) += 1;
    const Vector<D> nearer = cone.moved_into(to, faces.back(), from);
    if (margin > 0.0) {
      EXPECT_LE((nearer - to).norm(), 1e-6);
    }
    if (D == 2 && cone.contains(nearer - from)) {
      ASSERT_GE(least_margin<D>(faces, from, nearer), -1e-9);
      moved += margin < 0.0;
    }
  }
  EXPECT_GT(seen, 2000);
  EXPECT_GT(hidden, 2000);
  EXPECT_GE(moved, D == 2 ? 500 : 0);
  EXPECT_FALSE(detail::Cone<D>::empty().contains(Vector<D>::Ones()));
}

TEST(Cone, SeesWhatTheStraightWayMeetsInThePlane) { cone_sees_what_the_way_meets<2>(); }
TEST(Cone, SeesWhatTheStraightWayMeetsInSpace) { cone_sees_what_the_way_meets<3>(); }

// A bend lies at a corner of cells: from there, all of the cell behind a face that has the corner is seen.
TEST(Cone, SeesAllFromAPointOfTheFace) {
  const Box<2> face{{1.0, 0.0}, {1.0, 2.0}};
  detail::Cone<2> cone;
  cone.narrow(face, {1.0, 2.0});
  EXPECT_TRUE(cone.contains({0.5, -1.9}));
  EXPECT_TRUE(cone.contains({0.0, -1.0}));
  detail::Cone<2> beside;
  beside.narrow(face, {1.0, 3.0});
  EXPECT_FALSE(beside.contains({0.5, -1.9}));
}

}  // namespace
}  // namespace ndtree::test::test_corridor
