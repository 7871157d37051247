// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which cubes of max_cell_size a scan may change.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

namespace detail {

/// Collects the cubes that beams pass, or pass so closely that rounding may decide.
template <int N, int D>
class CrossedCubes {
 public:
  /// @param reach around all beams [m]. @pre the lattice can address it.
  CrossedCubes(const LatticeGeometry<N, D>& geometry, const Box<D>& reach)
      : per_metre_(1.0 / geometry.cell_size(0)),
        beside_(kBeside * geometry.unit() / geometry.cell_size(0)),
        cubes_(geometry.edge(0), around(geometry, reach)) {}

  /// @param way of a beam, to the end of its noise [m].
  void add(const Vector<D>& origin, const Vector<D>& way) {
    add_scaled(origin * per_metre_, way * per_metre_);
  }
  [[nodiscard]] const CubeSet<D>& cubes() const { return cubes_; }

 private:
  /// Smallest cells beside a beam: distances along it are exact to a 16th, see kLongestBeam.
  static constexpr double kBeside = 0.25;

  [[nodiscard]] static LatticeBox<D> around(const LatticeGeometry<N, D>& geometry, const Box<D>& reach) {
    LatticeBox<D> box;
    for (int a = 0; a < D; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      box.lower[axis] = geometry.coordinate(reach.lower[a]) - 1;
      box.upper[axis] = geometry.coordinate(reach.upper[a]) + 2;
    }
    return box;
  }
  /// @param from, way in cubes.
  void add_scaled(const Vector<D>& from, const Vector<D>& way) {
    Vector<D> plane;  // The next that the beam crosses on each axis.
    for (int a = 0; a < D; ++a)
      plane[a] = way[a] > 0.0 ? std::floor(from[a]) + 1.0 : std::ceil(from[a]) - 1.0;
    Vector<D> at = from;
    for (double t = 0.0; t < 1.0;) {
      double next = 1.0;  // Where the beam leaves the cube.
      for (int a = 0; a < D; ++a)
        if (way[a] != 0.0) next = std::min(next, (plane[a] - from[a]) / way[a]);
      for (int a = 0; a < D; ++a)
        while (way[a] != 0.0 && (plane[a] - from[a]) / way[a] <= next) plane[a] += way[a] > 0.0 ? 1.0 : -1.0;
      const Vector<D> then = from + next * way;
      insert(at.cwiseMin(then), at.cwiseMax(then));
      t = next;
      at = then;
    }
  }
  /// Inserts all cubes of a box, and those close beside it.
  void insert(const Vector<D>& lower, const Vector<D>& upper) {
    Lattice<D> first;
    Lattice<D> last;
    for (int a = 0; a < D; ++a) {
      first[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(std::floor(lower[a] - beside_));
      last[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(std::floor(upper[a] + beside_));
    }
    Lattice<D> cube = first;
    for (;;) {
      cubes_.insert(cube);
      std::size_t a = 0;
      for (; a < D; ++a) {
        if (++cube[a] <= last[a]) break;
        cube[a] = first[a];
      }
      if (a == D) return;
    }
  }

  double per_metre_;
  double beside_;  // In cubes.
  CubeSet<D> cubes_;
};

}  // namespace detail

/// The cubes of max_cell_size that a scan may change: its beams pass them, to the end of their noise.
/// Cost: O(beams · cubes along a beam).
/// @throws as survey_exactly().
template <int N, int D, class Sensor>
[[nodiscard]] CubeSet<D> cubes_crossed(const LatticeGeometry<N, D>& geometry,
                                       const Measurements<D, Sensor>& measurements) {
  ScanSurvey<D> survey;
  std::vector<std::pair<Vector<D>, Vector<D>>> beams;  // Where each begins, and its way.
  beams.reserve(static_cast<std::size_t>(measurements.scan().size));
  const double longest = kLongestBeam * geometry.unit();
  for (Eigen::Index i = 0; i < measurements.scan().size; ++i) {
    const Beam<D> beam = measurements.beam(i);
    if (beam.outcome == BeamOutcome::invalid) continue;
    const double sigma = measurements.sigma(i, beam);
    const double t_end = std::max(beam.t_free, Sensor::t_end(beam, sigma));
    survey.include(beam.origin);
    survey.include(beam.point(t_end));
    if (!(t_end * beam.range <= longest)) (void)survey_exactly(geometry, measurements, {i, i + 1});
    beams.emplace_back(beam.origin, t_end * beam.displacement);
  }
  if (beams.empty()) return {};
  if (!geometry.in_reach(survey.reach.lower) || !geometry.in_reach(survey.reach.upper))
    (void)survey_exactly(geometry, measurements, measurements.all());
  detail::CrossedCubes<N, D> crossed(geometry, survey.reach);
  for (const auto& [origin, way] : beams) crossed.add(origin, way);
  return crossed.cubes();
}

}  // namespace ndtree
