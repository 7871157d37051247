// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A path, and how it is searched for.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree {

/// How a search for a path ended: with one; without, as all that can be reached was looked at; without, as
/// there was no time left.
enum class PathStatus { found, none, out_of_time };

/// How a path is searched for.
struct PlannerOptions {
  double clearance = 0.0;  ///< That the body keeps from obstacles, at least [m].
  double unknown_cost =
      std::numeric_limits<double>::infinity();  ///< Of a metre where the body may touch unknown
                                                ///< space; infinite: it is an obstacle, 1: free.
  double greed =
      1.03;  ///< Factor of the way that is left, >= 1: how much sooner the search heads for the goal.

  /// Most that unknown space may cost: 2^30 smallest cells of it add up to an eighth of one, as doubles are
  /// rounded, so that free space beside it still counts.
  static constexpr double kMostCost = 1e6;

  /// @throws std::invalid_argument naming the value.
  void validate() const {
    const auto require = [](bool holds, const char* name, double value, const char* what) {
      if (!holds)
        throw std::invalid_argument(std::string(name) + " = " + describe_number(value) + ": " + what);
    };
    require(clearance >= 0.0 && std::isfinite(clearance), "clearance", clearance,
            "must be >= 0 m and finite");
    require(unknown_cost >= 1.0, "unknown", unknown_cost, "a cost must be >= 1");
    require(unknown_cost <= kMostCost || !std::isfinite(unknown_cost), "unknown", unknown_cost,
            "a cost must be <= 1e6; to go nowhere through unknown space, block it");
    require(greed >= 1.0 && std::isfinite(greed), "greed", greed, "must be >= 1 and finite");
  }
};

/// A way for a body that keeps its orientation, or why there is none.
template <int D>
struct Path {
  PathStatus status = PathStatus::none;
  std::vector<Vector<D>> points;  ///< From start to goal [m]; empty if none was found.
  double length = std::numeric_limits<double>::infinity();  ///< [m]
  double clearance =
      std::numeric_limits<double>::quiet_NaN();  ///< Least distance of the body to an obstacle [m].
  std::size_t expanded = 0;                      ///< Cells that the search looked at.
  std::string reason;  ///< Why there is none, and whether that is proved; empty if there is one.
};

}  // namespace ndtree
