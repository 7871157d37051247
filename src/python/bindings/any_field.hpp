// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A distance field of any dimension that maps have.
#pragma once

#include <cstddef>
#include <variant>

#include "ndtree/query/distance_field.hpp"

namespace ndtree::python {

struct AnyField {
  std::variant<DistanceField<2>, DistanceField<3>, DistanceField<4>> field;

  [[nodiscard]] int dim() const { return static_cast<int>(field.index()) + 2; }

  /// Of n points of dim() coordinates each: the distance there, and its gradient.
  void distance(const double* points, std::size_t n, double* out) const;
  void gradient(const double* points, std::size_t n, double* out) const;
};

}  // namespace ndtree::python
