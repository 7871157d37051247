// SPDX-License-Identifier: BSD-3-Clause
#include "any_field.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <type_traits>

#include "ndtree/core/cancel.hpp"

namespace ndtree::python {

namespace {

constexpr std::size_t kStepsOfPoint = 8;  // Of looking up one point, for Pace.

/// Calls `fill(field, point, i)` for each of n points.
template <class Fill>
void for_each_point(const AnyField& any, const double* points, std::size_t n, const Fill& fill) {
  std::visit(
      [&](const auto& field) {
        using Point = std::decay_t<decltype(field.lower())>;
        constexpr auto kDim = static_cast<std::size_t>(Point::RowsAtCompileTime);
        for_each_paced(n, kStepsOfPoint, [&](std::size_t i) {
          fill(field, Point(Eigen::Map<const Point>(points + i * kDim)), i);
        });
      },
      any.field);
}

}  // namespace

void AnyField::distance(const double* points, std::size_t n, double* out) const {
  for_each_point(*this, points, n,
                 [&](const auto& own, const auto& point, std::size_t i) { out[i] = own.distance(point); });
}

void AnyField::gradient(const double* points, std::size_t n, double* out) const {
  for_each_point(*this, points, n, [&](const auto& own, const auto& point, std::size_t i) {
    const auto gradient = own.gradient(point);
    const auto size = static_cast<std::size_t>(gradient.size());
    std::copy_n(gradient.data(), size, out + i * size);
  });
}

}  // namespace ndtree::python
