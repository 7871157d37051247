// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What scans saw, of any dimension that maps have.
#pragma once

#include <variant>

#include "ndtree/evaluation/claims.hpp"

namespace ndtree::python {

struct AnySeenSpace {
  std::variant<SeenSpace<2>, SeenSpace<3>, SeenSpace<4>> space;

  [[nodiscard]] int dim() const { return static_cast<int>(space.index()) + 2; }
};

}  // namespace ndtree::python
