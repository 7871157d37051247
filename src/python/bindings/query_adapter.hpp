// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Bulk queries of any map, ours or OctoMap, behind the interface that Python sees.
#pragma once

#include <Eigen/Core>
#include <limits>
#include <stdexcept>
#include <string>
#include <variant>

#include "map_interface.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/evaluation/calibration.hpp"
#include "ndtree/evaluation/claims.hpp"
#include "ndtree/evaluation/held_out_truth.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree::python {

/// Queries in bulk over any map that answers state(), probability(), occupied_within() and cast_ray().
template <class Map, int D>
class QueryAdapter : public MapInterface {
  using Point = Eigen::Map<const Vector<D>>;

 public:
  [[nodiscard]] int dim() const final { return D; }

  void probability(const double* points, std::size_t n, float* out) const override {
    const Map& map = cells();
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      out[i] = static_cast<float>(ndtree::probability(map, Vector<D>(Point(points + i * D))));
    });
  }
  void state(const double* points, std::size_t n, std::int8_t* out) const override {
    const Map& map = cells();
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      out[i] = static_cast<std::int8_t>(ndtree::state(map, Vector<D>(Point(points + i * D))));
    });
  }
  void occupied_within(const double* points, std::size_t n, double radius, bool* out) const final {
    const Map& map = cells();
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      out[i] = ndtree::occupied_within(map, Vector<D>(Point(points + i * D)), radius);
    });
  }
  void cast_rays(const double* origins, std::size_t origin_step, const double* directions, std::size_t n,
                 double max_range, RayAim aim, double* out) const final {
    const Map& map = cells();
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      out[i] = ndtree::cast_ray(map, Vector<D>(Point(origins + i * origin_step)),
                                Vector<D>(Point(directions + i * D)), max_range, aim)
                   .value_or(std::numeric_limits<double>::quiet_NaN());
    });
  }
  void evaluate(const BeamPointers& beams, double max_range, HeldOutTruth& truth) const final {
    ndtree::evaluate(cells(), beams.view<D>(), max_range, truth);
  }
  void calibrate(const BeamPointers& beams, double max_range, Calibration& calibration) const final {
    ndtree::calibrate(cells(), beams.view<D>(), max_range, calibration);
  }
  [[nodiscard]] Claims claims(const AnySeenSpace& any) const final {
    const SeenSpace<D>* const own = std::get_if<SeenSpace<D>>(&any.space);
    if (own == nullptr)
      throw std::invalid_argument("space has dim = " + std::to_string(any.dim()) + ": must be " +
                                  std::to_string(D) + " as the map");
    return ndtree::claims(cells(), *own);
  }

 private:
  /// What is asked.
  [[nodiscard]] virtual const Map& cells() const = 0;
};

}  // namespace ndtree::python
