// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A path of any dimension that planners have.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "ndtree/planning/planner.hpp"
#include "ndtree/planning/turning.hpp"

namespace ndtree::python {

struct AnyPath {
  PathStatus status;
  std::vector<double> points;  ///< One after the other.
  double length;
  double clearance;
  std::size_t expanded;
  std::string reason;
};

template <int D>
[[nodiscard]] AnyPath any_path(const Path<D>& path) {
  AnyPath any{path.status, {}, path.length, path.clearance, path.expanded, path.reason};
  for (const Vector<D>& point : path.points)
    any.points.insert(any.points.end(), point.data(), point.data() + D);
  return any;
}

}  // namespace ndtree::python
