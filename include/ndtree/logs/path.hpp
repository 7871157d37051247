// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A drive along way points with turns on the spot, for the poses of simulated sensors.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

namespace ndtree {

/// A place on the way [m], where the sensor turns towards the next one, and by `spin` more [rad].
struct Waypoint {
  double x = 0.0;
  double y = 0.0;
  double spin = 0.0;  ///< Counter-clockwise; 2 pi to look all around.
};

/// Position [m] and heading [rad, not wrapped] in the plane.
struct PlanarPose {
  double x = 0.0;
  double y = 0.0;
  double heading = 0.0;
};

/// Length of (x, y); std::hypot() rounds its last bit as the C library likes.
inline double planar_length(double x, double y) { return std::sqrt(x * x + y * y); }

/// `count` poses, evenly spaced along the way, where a turn by one radian is as long as `turn_length` [m].
/// The sensor looks where it goes; between legs it turns the shorter way,
/// and clockwise to go straight back. Needs two different way points.
inline std::vector<PlanarPose> drive(const std::vector<Waypoint>& waypoints, std::size_t count,
                                     double turn_length) {
  constexpr double two_pi = 6.28318530717958648;
  struct Leg {
    PlanarPose from;
    PlanarPose to;
    double length;
  };
  std::vector<Leg> legs;
  double total = 0.0;
  const auto add = [&](const PlanarPose& from, const PlanarPose& to) {
    const double length =
        planar_length(to.x - from.x, to.y - from.y) + turn_length * std::abs(to.heading - from.heading);
    if (length > 0.0) legs.push_back({from, to, length});
    total += length;
  };
  double heading = 0.0;
  for (std::size_t i = 0; i < waypoints.size(); ++i) {
    const Waypoint& here = waypoints[i];
    double turned = heading + here.spin;
    if (i + 1 < waypoints.size()) {
      const double ahead = std::atan2(waypoints[i + 1].y - here.y, waypoints[i + 1].x - here.x);
      if (i == 0) heading = ahead;
      double turn = std::remainder(ahead - heading, two_pi);
      if (turn > 0.5 * two_pi - 1e-9)
        turn -= two_pi;  // Which of two equal turns is not left to the last bit.
      turned = heading + here.spin + turn;
    }
    add({here.x, here.y, heading}, {here.x, here.y, turned});
    if (i + 1 < waypoints.size())
      add({here.x, here.y, turned}, {waypoints[i + 1].x, waypoints[i + 1].y, turned});
    heading = turned;
  }

  std::vector<PlanarPose> poses;
  poses.reserve(count);
  std::size_t leg = 0;
  double passed = 0.0;  // length of the legs before this one
  for (std::size_t i = 0; i < count; ++i) {
    const double s = total * (static_cast<double>(i) + 0.5) / static_cast<double>(count);
    while (leg + 1 < legs.size() && passed + legs[leg].length < s) passed += legs[leg++].length;
    const PlanarPose& a = legs[leg].from;
    const PlanarPose& b = legs[leg].to;
    const double t = std::min((s - passed) / legs[leg].length, 1.0);
    poses.push_back({a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), a.heading + t * (b.heading - a.heading)});
  }
  return poses;
}

}  // namespace ndtree
