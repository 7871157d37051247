// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Simulated logs of an office, an apartment and a street, whose truth is known exactly (as in Sec. IV).
#pragma once

#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/option.hpp"
#include "ndtree/core/random.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/logs/moving.hpp"
#include "ndtree/logs/path.hpp"
#include "ndtree/logs/sensors.hpp"
#include "ndtree/logs/world.hpp"
#include "ndtree/logs/worlds_apartment.hpp"
#include "ndtree/logs/worlds_office.hpp"
#include "ndtree/logs/worlds_street.hpp"
#include "ndtree/logs/worlds_traffic.hpp"

namespace ndtree {

/// What goes wrong in a simulated log, and how the world lies in the map.
struct SimulationOptions {
  std::uint64_t seed = 1;  ///< Of everything random; the world itself is always the same.
  std::optional<std::size_t>
      scans;                    ///< Spread evenly along the way; none: as many as the world's function says.
  double noise_scale = 1.0;     ///< Multiplies the sensor's sigma; 0 measures exactly.
  double outlier_rate = 0.002;  ///< Share of beams that return from anywhere before the surface.
  double no_return_rate = 0.005;  ///< Share of beams that find nothing although something is there.
  double position_sigma = 0.0;    ///< Error of the stated sensor position, each horizontal axis and scan [m].
  double heading_sigma = 0.0;     ///< Error of the stated heading, each scan [rad].
  double yaw = 0.12;              ///< World to map [rad], so that no wall lies along the lattice.
  std::size_t people = 0;         ///< That walk through the world, one of them ahead of the sensor.
  std::size_t doors = 0;          ///< Of the office that open and close, at most kOfficeDoors.
  std::size_t cars = 0;           ///< In the street that drive, one of them ahead of the sensor.

  /// @throws std::invalid_argument that names the first value out of its limits.
  void validate() const;
};

/// A log that measures each scan when it is asked for. Scan i depends on the seed and on i only.
template <int D>
struct SimulatedLog {
  using Pose = Eigen::Transform<double, D, Eigen::Isometry>;

  World<D> world;        ///< The truth, in the map frame.
  Points<D> directions;  ///< Unit vectors in the sensor frame, one column a beam, in the sensor's order.
  RangeModel range;
  std::vector<Pose> T_map_sensor;  ///< Where the sensor truly is, one a scan.
  SimulationOptions options;
  std::vector<double> times;           ///< Of the scans [s]; empty where nothing moves.
  std::vector<MovingThing<D>> moving;  ///< What is not part of the world, since it moves.

  /// Number of scans.
  [[nodiscard]] std::size_t size() const { return T_map_sensor.size(); }

  /// All beams in the sensor's order, none left out. A beam that measures nothing has `returned` false, and
  /// ends at the maximum range or in NaN as the range model says. i < size().
  [[nodiscard]] Scan<D> scan(std::size_t i) const { return measured(i).scan; }

  /// Whether each beam of a scan returned from something that moves: exact, by the nearest surface without
  /// noise. A beam that returned from nowhere, as outliers do, did not.
  [[nodiscard]] std::vector<bool> moved(std::size_t i) const { return measured(i).moved; }

 private:
  struct Measured {
    Scan<D> scan;
    std::vector<bool> moved;
  };
  [[nodiscard]] Measured measured(std::size_t i) const;
};

/// 26 m by 16 m with a corridor and eleven furnished rooms, cut at the height of a laser on a robot that
/// drives into each of them. 720 scans unless the options say otherwise.
SimulatedLog<2> simulate_office(const SimulationOptions& options = {}, const PlanarLaser& laser = {});

/// Five furnished rooms and a hall, seen by a depth camera that is carried through all of them at the height
/// of 1.4 m and looks around, up and down. 300 scans unless the options say otherwise.
SimulatedLog<3> simulate_apartment(const SimulationOptions& options = {}, const DepthCamera& camera = {});

/// 100 m of a street between façades with windows and doors, trees, poles and parked cars, seen by a lidar
/// 1.8 m above the road. 80 scans unless the options say otherwise.
SimulatedLog<3> simulate_street(const SimulationOptions& options = {}, const RingLidar& lidar = {});

inline void SimulationOptions::validate() const {
  using detail::require;
  if (scans == std::size_t{0}) throw std::invalid_argument("scans = 0: must be >= 1");
  require(noise_scale >= 0.0 && std::isfinite(noise_scale), "noise_scale", noise_scale, ": must be >= 0");
  require(outlier_rate >= 0.0 && outlier_rate <= 1.0, "outlier_rate", outlier_rate, ": must be in [0, 1]");
  require(no_return_rate >= 0.0 && no_return_rate <= 1.0 - outlier_rate, "no_return_rate", no_return_rate,
          ": must be in [0, 1 - outlier_rate]");
  require(position_sigma >= 0.0 && std::isfinite(position_sigma), "position_sigma", position_sigma,
          " m: must be >= 0");
  require(heading_sigma >= 0.0 && std::isfinite(heading_sigma), "heading_sigma", heading_sigma,
          " rad: must be >= 0");
  require(std::isfinite(yaw), "yaw", yaw, " rad: must be finite");
}

namespace detail {

/// The range that the sensor gives: none where it measures nothing, below `min_range` where it cannot.
/// Takes the same number of random numbers whatever happens, so that a setting changes only what it names.
inline std::optional<double> measured_range(std::optional<double> truth, const RangeModel& range,
                                            const SimulationOptions& options, Random& random,
                                            bool& is_outlier) {
  const double fate = random.uniform();
  const double where = random.uniform();
  const double error = random.normal();
  if (fate < options.no_return_rate) return std::nullopt;
  if (fate < options.no_return_rate + options.outlier_rate) {
    is_outlier = true;
    const double end = std::max(truth.value_or(range.max_range), range.min_range);
    return range.min_range + where * (end - range.min_range);
  }
  if (!truth || *truth < range.min_range) return truth;
  const double noisy = *truth + options.noise_scale * range.sigma_at(*truth) * error;
  if (noisy > range.max_range) return std::nullopt;
  return noisy;
}

/// Rotation times vector, the same on each processor: Eigen's own products are fused where it can. See
/// unfused().
template <int D>
Vector<D> turned(const Eigen::Matrix<double, D, D>& rotation, const Vector<D>& vector) {
  Vector<D> sum = Vector<D>::Zero();
  for (int b = 0; b < D; ++b)
    for (int a = 0; a < D; ++a) sum[a] += unfused(rotation(a, b) * vector[b]);
  return sum;
}

/// Turns a pose about the vertical and shifts it, as a localisation that is a little wrong would.
template <int D>
Eigen::Transform<double, D, Eigen::Isometry> disturbed(
    const Eigen::Transform<double, D, Eigen::Isometry>& pose, const SimulationOptions& options,
    Random& random) {
  const double dx = options.position_sigma * random.normal();
  const double dy = options.position_sigma * random.normal();
  const double turn = options.heading_sigma * random.normal();
  if (options.position_sigma == 0.0 && options.heading_sigma == 0.0) return pose;
  Eigen::Matrix<double, D, D> rotation = Eigen::Matrix<double, D, D>::Identity();
  rotation.template topLeftCorner<2, 2>() << std::cos(turn), -std::sin(turn), std::sin(turn), std::cos(turn);
  Eigen::Transform<double, D, Eigen::Isometry> wrong = pose;
  for (int k = 0; k < D; ++k) wrong.linear().col(k) = turned<D>(rotation, pose.linear().col(k));
  wrong.translation().template head<2>() += Eigen::Vector2d(dx, dy);
  return wrong;
}

}  // namespace detail

template <int D>
typename SimulatedLog<D>::Measured SimulatedLog<D>::measured(std::size_t i) const {
  Random random(options.seed, i);
  const Pose& pose = T_map_sensor.at(i);
  const Pose stated = detail::disturbed<D>(pose, options, random);
  const Vector<D> origin = pose.translation();
  Measured both;
  Scan<D>& scan = both.scan;
  std::vector<Shape<D>> things;
  const double time = times.empty() ? 0.0 : times.at(i);
  for (const MovingThing<D>& thing : moving) {
    const std::vector<Shape<D>> placed = thing.shapes(time, origin);
    things.insert(things.end(), placed.begin(), placed.end());
  }
  const World<D> now(std::move(things));
  scan.stamp = time;
  both.moved.assign(static_cast<std::size_t>(directions.cols()), false);
  scan.origins = stated.translation();
  scan.endpoints.resize(D, directions.cols());
  scan.returned.resize(directions.cols());
  for (Eigen::Index k = 0; k < directions.cols(); ++k) {
    const Vector<D> direction = detail::turned<D>(pose.linear(), directions.col(k));
    std::optional<double> truth = world.distance(origin, direction, range.max_range);
    const std::optional<double> before = now.distance(origin, direction, truth.value_or(range.max_range));
    if (before) truth = before;
    bool is_outlier = false;
    const std::optional<double> measured = detail::measured_range(truth, range, options, random, is_outlier);
    both.moved[static_cast<std::size_t>(k)] = before && measured && !is_outlier;
    const bool too_near = measured && *measured < range.min_range;
    scan.returned[k] = measured && !too_near;
    if (too_near || (!measured && range.no_echo == NoEcho::no_measurement))
      scan.endpoints.col(k).setConstant(std::numeric_limits<double>::quiet_NaN());
    else
      scan.endpoints.col(k) =
          detail::turned<D>(stated.linear(), measured.value_or(range.max_range) * directions.col(k)) +
          stated.translation();
  }
  return both;
}

namespace detail {

/// When the sensor is where, at a speed [m/s] at which a turn by one radian is as long as `turn_length` [m];
/// the same for any number of scans.
inline SensorTrack timed(const std::vector<Waypoint>& path, const std::vector<PlanarPose>& poses,
                         double turn_length, double speed, double& duration) {
  constexpr std::size_t fine = 5000;
  double length = 0.0;
  const std::vector<PlanarPose> way = drive(path, fine, turn_length);
  for (std::size_t i = 1; i < fine; ++i)
    length += planar_length(way[i].x - way[i - 1].x, way[i].y - way[i - 1].y) +
              turn_length * std::abs(way[i].heading - way[i - 1].heading);
  duration = length / speed;
  SensorTrack track{poses, {}};
  for (std::size_t i = 0; i < poses.size(); ++i)
    track.times.push_back(duration * (static_cast<double>(i) + 0.5) / static_cast<double>(poses.size()));
  return track;
}

inline void refuse(std::size_t count, const char* name, const char* world) {
  if (count > 0) throw OptionError(name, std::to_string(count), std::string("0 in the ") + world);
}

}  // namespace detail

inline SimulatedLog<2> simulate_office(const SimulationOptions& options, const PlanarLaser& laser) {
  constexpr double turn_length = 0.35;
  options.validate();
  laser.validate();
  detail::refuse(options.cars, "cars", "office");
  if (options.doors > kOfficeDoors)
    throw OptionError("doors", std::to_string(options.doors),
                      "at most " + std::to_string(kOfficeDoors) + ", which the office has");
  Scene<2> scene = office_scene(options.yaw, options.doors);
  SimulatedLog<2> log{
      World<2>(std::move(scene.shapes)), laser.directions(), laser.range, {}, options, {}, {}};
  const std::vector<PlanarPose> path = drive(scene.path, options.scans.value_or(720), turn_length);
  if (options.people + options.doors > 0) {
    double duration = 0.0;
    const SensorTrack track = detail::timed(scene.path, path, turn_length, 0.8, duration);
    log.times = track.times;
    log.moving = walking_people<2>(scene.path, track, options.people, duration, options.seed);
    for (MovingThing<2>& door : office_doors(options.yaw, track, options.doors, duration, options.seed))
      log.moving.push_back(std::move(door));
  }
  for (const PlanarPose& at : path) {
    Eigen::Isometry2d pose(Eigen::Rotation2Dd(at.heading));
    pose.translation() << at.x, at.y;
    log.T_map_sensor.push_back(pose);
  }
  return log;
}

inline SimulatedLog<3> simulate_apartment(const SimulationOptions& options, const DepthCamera& camera) {
  constexpr double turn_length = 0.6;
  constexpr double eye_height = 1.4;
  options.validate();
  camera.validate();
  detail::refuse(options.cars, "cars", "apartment");
  detail::refuse(options.doors, "doors", "apartment");
  Scene<3> scene = apartment_scene(options.yaw);
  SimulatedLog<3> log{
      World<3>(std::move(scene.shapes)), camera.directions(), camera.range, {}, options, {}, {}};
  const std::vector<PlanarPose> path = drive(scene.path, options.scans.value_or(300), turn_length);
  if (options.people > 0) {
    double duration = 0.0;
    const SensorTrack track = detail::timed(scene.path, path, turn_length, 0.5, duration);
    log.times = track.times;
    log.moving = walking_people<3>(scene.path, track, options.people, duration, options.seed);
  }
  for (std::size_t i = 0; i < path.size(); ++i) {
    // Nods 31 times on the whole way, and sways a little: never twice the same view.
    const double phase =
        2.0 * 3.14159265358979324 * static_cast<double>(i) / static_cast<double>(path.size());
    const double pitch = -0.15 + 0.40 * std::sin(31.0 * phase);
    const double heading = path[i].heading + 0.35 * std::sin(17.0 * phase);
    const Vector<3> ahead(std::cos(pitch) * std::cos(heading), std::cos(pitch) * std::sin(heading),
                          std::sin(pitch));
    const Vector<3> right(std::sin(heading), -std::cos(heading), 0.0);
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() << right, ahead.cross(right), ahead;
    pose.translation() << path[i].x, path[i].y, eye_height + 0.08 * std::sin(23.0 * phase);
    log.T_map_sensor.push_back(pose);
  }
  return log;
}

inline SimulatedLog<3> simulate_street(const SimulationOptions& options, const RingLidar& lidar) {
  constexpr double turn_length = 1.0;
  constexpr double mount_height = 1.8;
  options.validate();
  lidar.validate();
  detail::refuse(options.doors, "doors", "street");
  Scene<3> scene = street_scene(options.yaw);
  SimulatedLog<3> log{
      World<3>(std::move(scene.shapes)), lidar.directions(), lidar.range, {}, options, {}, {}};
  const std::vector<PlanarPose> path = drive(scene.path, options.scans.value_or(80), turn_length);
  if (options.people + options.cars > 0) {
    double duration = 0.0;
    const SensorTrack track = detail::timed(scene.path, path, turn_length, 8.0, duration);
    log.times = track.times;
    log.moving = street_traffic(options.yaw, track, options.people, options.cars, duration, options.seed);
  }
  for (const PlanarPose& at : path) {
    Eigen::Isometry3d pose(Eigen::AngleAxisd(at.heading, Vector<3>::UnitZ()));
    pose.translation() << at.x, at.y, mount_height;
    log.T_map_sensor.push_back(pose);
  }
  return log;
}

}  // namespace ndtree
