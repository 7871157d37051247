// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// People, doors and cars that move through the simulated worlds while the sensor passes.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ndtree/core/random.hpp"
#include "ndtree/logs/moving.hpp"
#include "ndtree/logs/path.hpp"
#include "ndtree/logs/scene.hpp"
#include "ndtree/logs/worlds_office.hpp"
#include "ndtree/logs/worlds_street.hpp"

namespace ndtree {

/// The sensor's way in time: what moves keeps clear of it, and one person walks ahead of it.
struct SensorTrack {
  std::vector<PlanarPose> poses;  ///< One a scan, in the map.
  std::vector<double> times;      ///< Of the scans [s], rising.
};

/// People who walk along a closed way through a world, in both directions, and stand now and then. The first
/// walks ahead of the sensor, which follows.
/// @param path the way, in the map. @param count how many. @param duration of the log [s].
template <int D>
std::vector<MovingThing<D>> walking_people(const std::vector<Waypoint>& path, const SensorTrack& track,
                                           std::size_t count, double duration, std::uint64_t seed);

/// The first `count` doors of the office, which open and close, and are open where the sensor is near.
std::vector<MovingThing<2>> office_doors(double yaw, const SensorTrack& track, std::size_t count,
                                         double duration, std::uint64_t seed);

/// People on the pavements of the street, and cars on its road: the first drives ahead of the sensor, others
/// come towards it, cross, or leave the places where they were parked.
std::vector<MovingThing<3>> street_traffic(double yaw, const SensorTrack& track, std::size_t people,
                                           std::size_t cars, double duration, std::uint64_t seed);

namespace detail::traffic {

inline constexpr double kStep = 0.2;         // Of ways in time [s].
inline constexpr double kStepsAside = 0.55;  // People nearer than this to the sensor are not there [m].

/// A person: in 3-D legs, body and head, in 2-D the legs as a low laser cuts them.
template <int D>
MovingThing<D> person() {
  constexpr double half_turn = 3.14159265358979324;
  MovingThing<D> thing;
  Scene<D> body;
  const Place<D> here(body);
  for (const double side : {-1.0, 1.0}) here.post(0.0, 0.11 * side, 0.075, 0.0, 0.85);
  if constexpr (D == 3) {
    here.ellipsoid(0.0, 0.0, 0.30, 0.50, 0.70, 1.50);
    here.ellipsoid(0.0, 0.0, 0.21, 0.18, 1.48, 1.74);
  }
  for (std::size_t i = 0; i < body.shapes.size(); ++i)
    thing.add_part({body.shapes[i], i < 2 ? 0.22 : 0.0, i == 1 ? half_turn : 0.0});
  thing.clearance = kStepsAside;
  return thing;
}

inline MovingThing<3> car(void (*put)(const Place<3>&)) {
  MovingThing<3> thing;
  Scene<3> body;
  put(Place<3>(body));
  for (const Shape<3>& shape : body.shapes) thing.add_part({shape});
  thing.clearance = 3.5;
  return thing;
}

/// A way along a straight line at a constant speed, between two times.
inline std::vector<TimedPlace> straight(const Place<3>& ground, double yaw, double x, double y,
                                        double heading, double speed, double begin, double end) {
  std::vector<TimedPlace> way;
  for (const double time : {begin, end}) {
    const double s = speed * (time - begin);
    const Eigen::Vector2d at = ground.position_in_map(x + s * std::cos(heading), y + s * std::sin(heading));
    way.push_back({time, {at.x(), at.y(), yaw + heading}});
  }
  return way;
}

/// When the sensor first is so near to a point [s]; the last time if it never is.
inline double when_near(const SensorTrack& track, const Eigen::Vector2d& point, double distance) {
  for (std::size_t i = 0; i < track.poses.size(); ++i)
    if (planar_length(track.poses[i].x - point.x(), track.poses[i].y - point.y()) <= distance)
      return track.times[i];
  return track.times.empty() ? 0.0 : track.times.back();
}

/// Someone who walks a number of metres before the sensor, on the way that it takes.
inline std::vector<TimedPlace> ahead_of(const SensorTrack& track, double distance) {
  std::vector<TimedPlace> way;
  const std::size_t n = track.poses.size();
  for (std::size_t i = 0; i < n; ++i) {
    double left = distance;
    std::size_t k = i;
    while (k + 1 < n && left > 0.0) {
      left -= planar_length(track.poses[k + 1].x - track.poses[k].x, track.poses[k + 1].y - track.poses[k].y);
      ++k;
    }
    if (left > 0.0) break;  // Has left by then.
    way.push_back({track.times[i], track.poses[k]});
  }
  return way;
}

}  // namespace detail::traffic

template <int D>
std::vector<MovingThing<D>> walking_people(const std::vector<Waypoint>& path, const SensorTrack& track,
                                           std::size_t count, double duration, std::uint64_t seed) {
  namespace t = detail::traffic;
  constexpr double fine = 0.05;  // From place to place of the way [m].
  double length = 0.0;
  for (std::size_t i = 1; i < path.size(); ++i)
    length += planar_length(path[i].x - path[i - 1].x, path[i].y - path[i - 1].y);
  const auto places = static_cast<std::size_t>(length / fine) + 2;
  std::vector<Waypoint> without_spin = path;
  for (Waypoint& stop : without_spin) stop.spin = 0.0;
  const std::vector<PlanarPose> line = drive(without_spin, places, 0.0);
  std::vector<MovingThing<D>> people;
  for (std::size_t i = 0; i < count; ++i) {
    Random random(seed, 1'000'000 + i);
    MovingThing<D> person = t::person<D>();
    if (i == 0) {
      person.set_way(t::ahead_of(track, random.uniform(1.4, 2.2)));
      people.push_back(std::move(person));
      continue;
    }
    const double speed = random.uniform(0.7, 1.4);
    const double aside = random.uniform(-0.2, 0.2);
    const bool back = random.uniform() < 0.5;
    double gone = random.uniform(0.0, length);
    double until = 0.0;  // Walks or stands up to this time.
    bool walks = false;
    std::vector<TimedPlace> way;
    for (double time = 0.0; time <= duration + t::kStep; time += t::kStep) {
      if (time >= until) {
        walks = !walks;
        until = time + (walks ? random.uniform(8.0, 30.0) : random.uniform(2.0, 10.0));
      }
      if (walks) gone += speed * t::kStep;
      const auto k = static_cast<std::size_t>(gone / fine) % places;
      PlanarPose at = line[back ? places - 1 - k : k];
      if (back) at.heading += 3.14159265358979324;
      at.x -= aside * std::sin(at.heading);
      at.y += aside * std::cos(at.heading);
      way.push_back({time, at});
    }
    person.set_way(std::move(way));
    people.push_back(std::move(person));
  }
  return people;
}

inline std::vector<MovingThing<2>> office_doors(double yaw, const SensorTrack& track, std::size_t count,
                                                double duration, std::uint64_t seed) {
  namespace o = detail::office;
  namespace t = detail::traffic;
  constexpr double near = 2.5;  // The sensor's way through a door is free [m].
  Scene<2> scene;
  const Place<2> floor(scene, yaw);
  std::vector<MovingThing<2>> doors;
  for (std::size_t i = 0; i < count; ++i) {
    const o::Hinge hinge = o::hinge_of(i);
    MovingThing<2> door;
    Scene<2> body;
    o::door_leaf(Place<2>(body));
    for (const Shape<2>& shape : body.shapes) door.add_part({shape});
    Random random(seed, 2'000'000 + i);
    const Eigen::Vector2d at = floor.position_in_map(hinge.x, hinge.y);
    std::vector<TimedPlace> way;
    double open = 1.0;  // 1: as wide as the door of the world that stands still; 0: closed.
    double wanted = 1.0;
    double until = random.uniform(5.0, 30.0);
    std::size_t scan = 0;
    for (double time = 0.0; time <= duration + t::kStep; time += t::kStep) {
      if (time >= until) {
        wanted = 1.0 - wanted;
        until = time + random.uniform(10.0, 40.0);
      }
      while (scan + 1 < track.times.size() && track.times[scan] < time) ++scan;
      const PlanarPose& sensor = track.poses[scan];
      const bool passes = planar_length(sensor.x - at.x(), sensor.y - at.y()) < near;
      const double goal = passes ? 1.0 : wanted;
      const double most = t::kStep * 0.5;  // Takes two seconds.
      open += std::clamp(goal - open, -most, most);
      way.push_back({time, {at.x(), at.y(), yaw + hinge.closed + open * (hinge.open - hinge.closed)}});
    }
    door.set_way(std::move(way));
    doors.push_back(std::move(door));
  }
  return doors;
}

inline std::vector<MovingThing<3>> street_traffic(double yaw, const SensorTrack& track, std::size_t people,
                                                  std::size_t cars, double duration, std::uint64_t seed) {
  namespace s = detail::street;
  namespace t = detail::traffic;
  constexpr double half_turn = 3.14159265358979324;
  constexpr std::array<double, 4> parking = {22.4, 40.2, 58.0, 98.2};  // On the north side.
  Scene<3> scene;
  const Place<3> ground(scene, yaw);
  std::vector<MovingThing<3>> things;
  for (std::size_t i = 0; i < cars; ++i) {
    Random random(seed, 3'000'000 + i);
    MovingThing<3> car = t::car(random.uniform() < 0.75 ? s::car : s::van);
    const double speed = random.uniform(5.0, 11.0);
    if (i == 0) {
      car.set_way(t::ahead_of(track, random.uniform(9.0, 14.0)));
    } else if (i % 3 == 2) {  // Parked, and drives away.
      const double x = parking[(i / 3) % parking.size()];
      const double leaves = t::when_near(track, ground.position_in_map(x, 3.45), random.uniform(12.0, 25.0));
      std::vector<TimedPlace> way = t::straight(ground, yaw, x, 3.45, half_turn, 0.0, 0.0, leaves);
      const auto drives =
          t::straight(ground, yaw, x, 3.45, half_turn - 0.45, 0.6 * speed, leaves, leaves + 1.0);
      way.insert(way.end(), drives.begin(), drives.end());
      const double gone = 0.6 * speed;
      const auto on = t::straight(ground, yaw, x - gone * std::cos(0.45), 3.45 - gone * std::sin(0.45),
                                  half_turn, speed, leaves + 1.0, std::max(duration, leaves + 1.5));
      way.insert(way.end(), on.begin(), on.end());
      car.set_way(std::move(way));
    } else if (i % 6 == 4) {  // Crosses.
      const double x = 0.5 * (s::kCrossFrom + s::kCrossTo) + random.uniform(-1.5, 1.5);
      car.set_way(t::straight(ground, yaw, x, -60.0, 0.5 * half_turn, speed,
                              duration * random.uniform(-0.4, 0.3), duration));
    } else {  // Comes towards the sensor.
      car.set_way(
          t::straight(ground, yaw, random.uniform(30.0, 190.0), 1.35, half_turn, speed, 0.0, duration));
    }
    things.push_back(std::move(car));
  }
  for (std::size_t i = 0; i < people; ++i) {
    Random random(seed, 1'000'000 + i);
    MovingThing<3> person = t::person<3>();
    for (auto& part : person.parts) part.shape.center[2] += s::kPavement;
    const double side = i % 2 == 0 ? 1.0 : -1.0;
    const double heading = random.uniform() < 0.5 ? 0.0 : half_turn;
    person.set_way(t::straight(ground, yaw, random.uniform(0.0, 105.0), side * random.uniform(6.15, 6.4),
                               heading, random.uniform(0.0, 1.8), 0.0, duration));
    things.push_back(std::move(person));
  }
  return things;
}

}  // namespace ndtree
