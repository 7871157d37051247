// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Sizes and standard deviations of matching.
#pragma once

#include "ndtree/core/option.hpp"

namespace ndtree {

struct MatchOptions {
  double cell_size = 0.05;  ///< Of the likelihood's grid, and the step of the grid of poses [m].
  double sigma = 0.05;      ///< Of an end point's distance from a surface, in the search [m].
  double radius = 0.2;      ///< Of the points that shape a piece of the surface [m].
  double noise = 0.02;      ///< Standard deviation of an end point across a surface, in the refinement [m].

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    constexpr OptionBounds kSizes{1e-4, 1e4, " m"};
    require_within("cell_size", cell_size, kSizes);
    require_within("sigma", sigma, kSizes);
    require_within("radius", radius, kSizes);
    require_within("noise", noise, kSizes);
  }
};

}  // namespace ndtree
