// SPDX-License-Identifier: BSD-3-Clause
// What a planner asks of a map: where a body collides, how far walls are, where unknown space begins.
#include <cmath>
#include <cstdio>
#include <ndtree/ndtree.hpp>

using Map = ndtree::AdaptiveMap<2, 2>;
using Point = ndtree::Vector<2>;

/// A laser that looks ahead, 270 degrees wide, in a square room whose walls are 3 m from (0, 0) [m].
ndtree::Scan<2> scan_of_room(const Point& origin) {
  constexpr int kBeams = 541;
  ndtree::Scan<2> scan;
  scan.origins = origin;
  scan.endpoints.resize(2, kBeams);
  for (int i = 0; i < kBeams; ++i) {
    const double angle = (i - 270) * 0.5 * 3.14159265358979 / 180.0 + 1e-3;
    const Point direction(std::cos(angle), std::sin(angle));
    double range = 1e9;
    for (int axis = 0; axis < 2; ++axis)
      range = std::fmin(range, (std::copysign(3.0, direction[axis]) - origin[axis]) / direction[axis]);
    scan.endpoints.col(i) = origin + range * direction;
  }
  return scan;
}

/// A pose in the plane [m, rad].
ndtree::Pose<2> pose(double x, double y, double yaw) {
  return {Eigen::Rotation2Dd(yaw).toRotationMatrix(), Point(x, y)};
}

int main() {
  Map map;
  for (int i = 0; i < 20; ++i) map.insert(scan_of_room(Point(0.02 * i, 0.0)));

  // A robot of 0.8 m by 0.5 m with a round bumper in front, at (0, 0) and looking along x.
  const ndtree::Body<2> robot{
      ndtree::OrientedBox<2>{Point::Zero(), Point(0.4, 0.25), Eigen::Matrix2d::Identity()},
      ndtree::Capsule<2>{Point(0.4, 0.0), Point(0.4, 0.0), 0.25}};
  const auto unknown = ndtree::UnknownSpace::occupied;
  const bool fits = !ndtree::collides(map, robot, pose(1.0, 0.5, 0.0), unknown);
  const bool at_wall = ndtree::collides(map, robot, pose(2.5, 0.5, 0.0), unknown);
  const bool on_the_way =
      ndtree::collides_between(map, robot, pose(1.0, 0.5, 0.0), pose(1.0, 2.9, 0.0), unknown);

  const ndtree::Box<2> window{Point(-2.0, -2.0), Point(3.5, 2.0)};
  const auto field = ndtree::distance_field(map, window, 0.05, 2.0);  // Cells of 0.05 m, up to 2 m.
  const double far = field.distance(Point(2.0, 0.0));
  const Point away = field.gradient(Point(2.0, 0.0));  // From the wall.
  std::printf("a wall %.2f m away, driven from along (%.1f, %.1f)\n", far, away.x(), away.y());

  const auto frontiers = ndtree::frontiers(map);         // The largest first.
  const ndtree::Box<2> cell = frontiers.at(0).cells[0];  // Free: a goal, which the center need not be.
  const Point goal = 0.5 * (cell.lower + cell.upper);
  std::printf("%zu frontiers, one cell of the largest at (%.1f, %.1f)\n", frontiers.size(), goal.x(),
              goal.y());
  const bool is_behind = goal.x() < 0.0 && ndtree::state(map, goal) == ndtree::CellState::free;
  return fits && at_wall && on_the_way && is_behind && std::abs(far - 1.0) < 0.1 && away.x() < -0.8 ? 0 : 1;
}
