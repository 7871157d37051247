// SPDX-License-Identifier: BSD-3-Clause
// Paths of bodies that turn, against looks at many poses on the way.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <string>

#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/planning/turning.hpp"
#include "ndtree/query/nearest.hpp"
#include "random.hpp"
#include "refusals.hpp"

namespace ndtree::test::test_turning {
namespace {

constexpr double kPi = 3.14159265358979323846;
using Map = AdaptiveMap<2, 2>;

Map free_square(double reach) {
  MapOptions options;
  options.min_cell_size = 0.05;
  options.max_cell_size = 1.6;
  Map map(options);
  map.mark(Box<2>{{-reach, -reach}, {reach, reach}}, CellState::free);
  return map;
}
Body<2> plank(double half_length, double half_width) {
  return {OrientedBox<2>{{0.0, 0.0}, {half_length, half_width}, Eigen::Matrix2d::Identity()}};
}
bool collides_at(const Map& map, const Body<2>& body, const Vector<3>& pose) {
  Pose<2> at;
  at.translation = pose.head<2>();
  return collides(map, turned(body, pose[2]), at, UnknownSpace::occupied);
}
/// No pose on the way collides, and between two it moves or turns, not both.
void expect_free(const Map& map, const Body<2>& body, const Path<3>& path) {
  for (std::size_t i = 0; i + 1 < path.points.size(); ++i) {
    const Vector<3>& a = path.points[i];
    const Vector<3>& b = path.points[i + 1];
    ASSERT_TRUE(a.head<2>() == b.head<2>() || a[2] == b[2]);
    for (int k = 0; k <= 200; ++k) ASSERT_FALSE(collides_at(map, body, a + (b - a) * (k / 200.0)));
  }
}

TEST(Turning, TurnsMeetWhatPosesOnTheWayMeet) {
  Random random(411);
  int met = 0;
  int clear = 0;
  for (int round = 0; round < 300; ++round) {
    Map map = free_square(3.0);
    const Vector<2> corner(random.uniform(-1.5, 1.5), random.uniform(-1.5, 1.5));
    map.mark(Box<2>{corner, corner + Vector<2>(0.12, 0.12)}, CellState::occupied);
    const Body<2> body = plank(random.uniform(0.1, 1.0), random.uniform(0.05, 0.2));
    const double from = random.uniform(-4.0, 4.0);
    const double to = from + random.uniform(-3.0, 3.0);
    const Vector<2> at(random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3));
    const bool collides = turn_collides(map, body, at, from, to, UnknownSpace::occupied);
    bool is_met = false;
    bool is_nearly_met = false;
    for (int k = 0; k <= 500; ++k) {
      const double angle = from + (to - from) * (k / 500.0);
      is_met = is_met || collides_at(map, body, {at[0], at[1], angle});
      is_nearly_met = is_nearly_met || collides_at(map, inflated(body, 0.0125), {at[0], at[1], angle});
    }
    if (is_met) {
      ASSERT_TRUE(collides);
    }
    if (collides) {
      ASSERT_TRUE(is_nearly_met);
    }
    (collides ? met : clear)++;
  }
  EXPECT_GT(met, 30);
  EXPECT_GT(clear, 30);
}

/// A corridor that a plank fits through lengthwise alone, beside one that no plank fits through.
TEST(Turning, TurnsWhereItOnlyFitsLengthwise) {
  Map map = free_square(4.0);
  map.mark(Box<2>{{-0.5, -4.0}, {0.5, -0.3}}, CellState::occupied);
  map.mark(Box<2>{{-0.5, 0.3}, {0.5, 4.0}}, CellState::occupied);
  const Body<2> body = plank(0.5, 0.15);
  const Vector<3> start(-2.0, 1.0, kPi / 2.0);
  const Vector<3> goal(2.0, -1.0, kPi / 2.0);
  EXPECT_EQ(plan(map, Vector<2>(-2.0, 1.0), Vector<2>(2.0, -1.0), turned(body, kPi / 2.0)).status,
            PathStatus::none);
  const Path<3> path = plan_turning(map, start, goal, body);
  ASSERT_EQ(path.status, PathStatus::found) << path.reason;
  EXPECT_EQ(path.points.front(), start);
  EXPECT_EQ(path.points.back().head<2>(), goal.head<2>());
  EXPECT_NEAR(std::remainder(path.points.back()[2] - goal[2], 2.0 * kPi), 0.0, 1e-9);
  EXPECT_LT(path.length, 1.15 * std::hypot(4.0, 2.0));
  EXPECT_GT(path.clearance, 0.0);
  expect_free(map, body, path);
  const Path<3> again = plan_turning(map, start, goal, body);
  EXPECT_EQ(path.points, again.points);
  EXPECT_EQ(path.expanded, again.expanded);
  Planner<Map> planner(map, body);
  EXPECT_FALSE(first_blocked_turning(planner, path.points).has_value());
  const Vector<2> first_turn = [&] {
    for (std::size_t i = 0;; ++i)
      if (path.points[i][2] != path.points[i + 1][2]) return Vector<2>(path.points[i].head<2>());
  }();
  Map other = map;  // A post where it turned, that its ways pass by.
  other.mark(Box<2>{first_turn + Vector<2>(-0.3, 0.25), first_turn + Vector<2>(-0.2, 0.3)},
             CellState::occupied);
  planner.update(other);
  EXPECT_TRUE(first_blocked_turning(planner, path.points).has_value());

  map.mark(Box<2>{{-0.5, 0.1}, {0.5, 4.0}}, CellState::occupied);  // 0.4 m are left, of 0.3 m that it needs.
  PlannerOptions options;
  options.clearance = 0.06;
  EXPECT_EQ(plan_turning(map, start, goal, body, options).status, PathStatus::none);
}

TEST(Turning, RandomWorldsAreCrossedFree) {
  Random random(412);
  int found = 0;
  for (int round = 0; round < 12; ++round) {
    Map map = free_square(3.0);
    for (int k = 0; k < 12; ++k) {
      const Vector<2> corner(random.uniform(-3.0, 2.5), random.uniform(-3.0, 2.5));
      map.mark(Box<2>{corner, corner + Vector<2>(random.uniform(0.1, 0.6), random.uniform(0.1, 0.6))},
               CellState::occupied);
    }
    const Body<2> body = plank(random.uniform(0.2, 0.45), 0.1);
    for (int k = 0; k < 4; ++k) {
      const auto draw = [&] {
        return Vector<3>(random.uniform(-2.5, 2.5), random.uniform(-2.5, 2.5), random.uniform(-7.0, 7.0));
      };
      const Vector<3> start = draw();
      const Vector<3> goal = draw();
      if (collides_at(map, inflated(body, 1e-4), start) || collides_at(map, inflated(body, 1e-4), goal))
        continue;
      const Path<3> path = plan_turning(map, start, goal, body);
      if (path.status != PathStatus::found) {
        EXPECT_FALSE(path.reason.empty());
        continue;
      }
      ++found;
      EXPECT_EQ(path.points.front(), start);
      EXPECT_NEAR(std::remainder(path.points.back()[2] - goal[2], 2.0 * kPi), 0.0, 1e-9);
      EXPECT_GE(path.length, (goal - start).head<2>().norm() - 1e-9);
      expect_free(map, body, path);
    }
  }
  EXPECT_GT(found, 10);
}

/// Turns in place that posts leave hardly room for: where two turns are free for certain, one may not be.
TEST(Turning, TurnsInPlaceBetweenPosts) {
  Random random(413);
  int found = 0;
  for (int round = 0; round < 60; ++round) {
    Map map = free_square(3.0);
    for (int k = 0; k < 8; ++k) {
      const double angle = random.uniform(-kPi, kPi);
      const Vector<2> post = 0.55 * Vector<2>(std::cos(angle), std::sin(angle));
      map.mark(Box<2>{post, post + Vector<2>(0.02, 0.02)}, CellState::occupied);
    }
    const double reach =
        distance_to_occupied(map, Vector<2>(0.0, 0.0)).value() - random.uniform(0.004, 0.009);
    const Body<2> body = plank(std::sqrt(reach * reach - 0.07 * 0.07), 0.07);
    const double yaw = random.uniform(-kPi, kPi);
    const Path<3> path = plan_turning(map, {0.0, 0.0, yaw}, {0.0, 0.0, yaw + random.uniform(-3.0, 3.0)}, body,
                                      {}, 10.0, 4 << random.integer(0, 4));
    if (path.status != PathStatus::found) continue;
    ++found;
    expect_free(map, body, path);
    EXPECT_FALSE(first_blocked_turning(Planner<Map>(map, body), path.points).has_value());
  }
  EXPECT_GT(found, 30);
}

/// Poses that were wrapped, or written and read again, are those that were planned.
TEST(Turning, RoundingIsNoMotion) {
  Map map = free_square(3.0);
  map.mark(Box<2>{{1.0, 0.5}, {1.2, 0.7}}, CellState::occupied);
  const Planner<Map> planner(map, plank(0.4, 0.1));
  Random random(414);
  for (int round = 0; round < 100; ++round) {
    const double yaw = kPi * random.integer(-2, 2);
    const auto rounded = [&](Vector<3> pose) {
      for (int a = 0; a < 3; ++a) pose[a] += random.uniform(-1e-10, 1e-10);
      return pose;
    };
    const Vector<3> first(-1.0, 0.0, yaw);
    const Vector<3> second(1.1, 0.0, yaw + 2.0 * kPi * random.integer(-1, 1));
    EXPECT_EQ(first_blocked_turning(planner, {rounded(first), rounded(second)}), std::nullopt);
    const Vector<3> third(1.1, 0.0, second[2] + 0.2);
    EXPECT_EQ(first_blocked_turning(planner, {rounded(first), rounded(second), rounded(third)}),
              std::nullopt);
    for (const Vector<3>& wrong : {Vector<3>(0.0, 0.0, yaw + 1e-4), Vector<3>(-1.0 + 1e-4, 0.0, yaw + 1e-4)})
      EXPECT_NE(refusal_by([&] { (void)first_blocked_turning(planner, {first, wrong}); }), "accepted");
  }
}

/// Beside the door that only a turned plank fits through, a window that was not seen.
TEST(Turning, UnknownSpaceCosts) {
  Map map = free_square(4.0);
  map.mark(Box<2>{{-0.5, -4.0}, {0.5, -0.3}}, CellState::occupied);
  map.mark(Box<2>{{-0.5, 0.3}, {0.5, 4.0}}, CellState::occupied);
  map.clear(Box<2>{{-0.5, 1.0}, {0.5, 3.0}});
  const Body<2> body = plank(0.5, 0.15);
  const Vector<3> start(-2.0, 2.0, 0.5 * kPi);
  const Vector<3> goal(2.0, 2.0, 0.5 * kPi);
  const auto planned = [&](double cost) {
    PlannerOptions options;
    options.unknown_cost = cost;
    return plan_turning(map, start, goal, body, options);
  };
  EXPECT_NEAR(planned(1.0).length, 4.0, 1e-6);
  EXPECT_NEAR(planned(1.2).length, 4.0, 0.05);
  const Path<3> around = planned(5.0);
  ASSERT_EQ(around.status, PathStatus::found);
  EXPECT_GT(around.length, 5.0);
  expect_free(map, body, around);
  EXPECT_LT(around.length, 1.06 * planned(std::numeric_limits<double>::infinity()).length);
}

/// Ends may lie far from all that was seen, where unknown space is free.
TEST(Turning, EndsMayBeOutsideTheMap) {
  Map map = free_square(2.0);
  map.mark(Box<2>{{-0.1, -2.0}, {0.1, 1.0}}, CellState::occupied);
  PlannerOptions options;
  options.unknown_cost = 1.0;
  const Body<2> body = plank(0.3, 0.1);
  for (const auto& [from, to] : {std::pair(-60.0, 60.0), std::pair(-1.0, 40.0), std::pair(-40.0, 1.0)}) {
    const Path<3> path = plan_turning(map, Vector<3>(from, 0.0, 0.0), Vector<3>(to, 0.0, 1.0), body, options);
    ASSERT_EQ(path.status, PathStatus::found) << from << ' ' << to << ' ' << path.reason;
    EXPECT_LT(path.length, to - from + 1.5);
    for (std::size_t i = 0; i + 1 < path.points.size(); ++i)
      EXPECT_FALSE(sweep_collides(map, turned(body, path.points[i][2]), Vector<2>(path.points[i].head<2>()),
                                  Vector<2>(path.points[i + 1].head<2>()), UnknownSpace::free));
  }
}

TEST(Turning, SaysWhatIsWrong) {
  const Map map = free_square(2.0);
  const Body<2> body = plank(0.3, 0.1);
  const auto message = [&](const Vector<3>& start, const PlannerOptions& options, int headings) {
    return refusal_by(
        [&] { (void)plan_turning(map, start, Vector<3>(1.0, 1.0, 0.0), body, options, 10.0, headings); });
  };
  EXPECT_EQ(message({0.0, 0.0, 0.0}, {}, 2), "headings = 2: must be 4 to 256");
  EXPECT_EQ(message({0.0, 0.0, std::nan("")}, {}, 16), "start = (0.0, 0.0, nan): yaw must be finite");
  EXPECT_NE(message({1.9, 0.0, 0.0}, {}, 16).find("start = (1.9, 0.0): there the body meets"),
            std::string::npos);
  EXPECT_EQ(message({1.7, 1.7, kPi}, {}, 16).find("start"), 0u);
  const Planner<Map> planner(map, body);
  EXPECT_EQ(first_blocked_turning(planner, {Vector<3>(0.0, 0.0, 0.0)}), std::nullopt);
  EXPECT_EQ(first_blocked_turning(planner, {Vector<3>(1.8, 0.0, 0.0)}), 0u);
  EXPECT_EQ(planner.first_blocked({Vector<2>(0.0, 0.0)}), std::nullopt);
  EXPECT_EQ(planner.first_blocked({Vector<2>(1.8, 0.0)}), 0u);
  EXPECT_EQ(planner.first_blocked({}), std::nullopt);
  const auto refusal = [&](const Vector<3>& pose) {
    return refusal_by([&] { (void)first_blocked_turning(planner, {Vector<3>(0.0, 0.0, 0.0), pose}); });
  };
  EXPECT_EQ(refusal({1.0, 0.0, 1.0}),
            "points[1]: moves by 1.0 m and turns by 1.0 rad at once, expected one of both");
  EXPECT_EQ(refusal({0.0, 0.0, std::nan("")}), "points[1]: yaw must be finite");
}

}  // namespace
}  // namespace ndtree::test::test_turning
