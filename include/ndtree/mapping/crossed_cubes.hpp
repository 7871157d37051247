// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which cubes of max_cell_size a scan may change.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "ndtree/core/beam.hpp"
#include "ndtree/mapping/scan/measurements.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Collects the cubes that beams pass, to the end of their noise, or pass so closely that rounding may
/// decide.
template <int N, int D>
class CrossedCubes {
 public:
  /// @param reach around all beams, see survey_exactly() [m].
  CrossedCubes(const LatticeGeometry<N, D>& geometry, const Box<D>& reach)
      : per_metre_(1.0 / geometry.cell_size(0)),
        beside_(kBeside * geometry.unit() / geometry.cell_size(0)),
        cubes_(geometry.edge(0), around(geometry, reach)) {}

  template <class Sensor>
  void add(const Measurements<D, Sensor>& measurements) {
    for (Eigen::Index i = 0; i < measurements.scan().size; ++i) {
      const Beam<D> beam = measurements.beam(i);
      if (beam.outcome == BeamOutcome::invalid) continue;
      const double t_end = Sensor::t_end(beam, measurements.sigma(i, beam.range));
      add(beam.origin * per_metre_, beam.displacement * (std::max(beam.t_free, t_end) * per_metre_));
    }
  }
  [[nodiscard]] const CubeSet<D>& cubes() const { return cubes_; }

 private:
  /// Smallest cells beside a beam: distances along it are exact to a 16th, see kLongestBeam.
  static constexpr double kBeside = 0.25;

  [[nodiscard]] static LatticeBox<D> around(const LatticeGeometry<N, D>& geometry, const Box<D>& reach) {
    LatticeBox<D> box;
    for (int a = 0; a < D; ++a) {
      const double most = geometry.reach();
      const auto axis = static_cast<std::size_t>(a);
      box.lower[axis] = geometry.coordinate(std::clamp(reach.lower[a], -most, most)) - 1;
      box.upper[axis] = geometry.coordinate(std::clamp(reach.upper[a], -most, most)) + 2;
    }
    return box;
  }
  /// @param from, way in cubes.
  void add(const Vector<D>& from, const Vector<D>& way) {
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

}  // namespace ndtree
