// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Things of simulated worlds that move: rigid or walking bodies, each on a way of its own in time.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/logs/path.hpp"
#include "ndtree/logs/shape.hpp"

namespace ndtree {

/// Where a thing is at a time [s]; its own x axis points along the heading.
struct TimedPlace {
  double time = 0.0;
  PlanarPose place;
};

/// A body of several shapes that moves upright. It is there from its way's first time to its last.
template <int D>
struct MovingThing {
  /// A shape in the thing's own frame, which may swing along its own x axis as a leg does.
  struct Part {
    Shape<D> shape;
    double swing = 0.0;   ///< Largest distance from its middle position [m].
    double phase = 0.0;   ///< Of the swing, where the thing has gone no distance [rad].
    double stride = 1.4;  ///< Way of the thing for one whole swing [m].
  };

  std::vector<Part> parts;
  std::vector<TimedPlace> way;    ///< Times rise. Linear in between, headings too.
  std::vector<double> travelled;  ///< Distance from the first place to each [m]; filled by set_way().
  double radius = 0.0;            ///< No part reaches farther from the thing's place, horizontally [m].
  double clearance = 0.0;         ///< It is not there while its place is nearer to the sensor [m].

  void set_way(std::vector<TimedPlace> places) {
    way = std::move(places);
    travelled.assign(way.size(), 0.0);
    for (std::size_t i = 1; i < way.size(); ++i)
      travelled[i] = travelled[i - 1] +
                     planar_length(way[i].place.x - way[i - 1].place.x, way[i].place.y - way[i - 1].place.y);
  }

  void add_part(Part part) {
    const Box<D> box = part.shape.bounds();
    double reach = 0.0;
    for (int k = 0; k < 2; ++k)
      reach = std::hypot(reach, std::max(std::abs(box.lower[k]), std::abs(box.upper[k])));
    radius = std::max(radius, reach + part.swing);
    parts.push_back(std::move(part));
  }

  /// The parts where they are at a time, in the map; none if the thing is not there, or would be too near.
  [[nodiscard]] std::vector<Shape<D>> shapes(double time, const Vector<D>& sensor) const {
    std::vector<Shape<D>> placed;
    if (way.empty() || time < way.front().time || time > way.back().time) return placed;
    const auto after =
        std::lower_bound(way.begin(), way.end(), time,
                         [](const TimedPlace& place, double wanted) { return place.time < wanted; });
    const auto i = static_cast<std::size_t>(after - way.begin());
    const std::size_t before = i == 0 ? 0 : i - 1;
    const double span = way[i].time - way[before].time;
    const double t = span > 0.0 ? (time - way[before].time) / span : 1.0;
    const auto between = [t](double a, double b) { return a + t * (b - a); };
    const PlanarPose& a = way[before].place;
    const PlanarPose& b = way[i].place;
    const PlanarPose at{between(a.x, b.x), between(a.y, b.y), between(a.heading, b.heading)};
    if (planar_length(at.x - sensor[0], at.y - sensor[1]) < clearance) return placed;
    const double gone = between(travelled[before], travelled[i]);
    const double c = std::cos(at.heading);
    const double s = std::sin(at.heading);
    constexpr double two_pi = 6.28318530717958648;
    for (const Part& part : parts) {
      Shape<D> shape = part.shape;
      const double x = shape.center[0] + part.swing * std::sin(two_pi * gone / part.stride + part.phase);
      const double y = shape.center[1];
      shape.center[0] = at.x + c * x - s * y;
      shape.center[1] = at.y + s * x + c * y;
      const Eigen::Vector2d heading = part.shape.heading;
      shape.heading << c * heading.x() - s * heading.y(), s * heading.x() + c * heading.y();
      placed.push_back(shape);
    }
    return placed;
  }
};

}  // namespace ndtree
