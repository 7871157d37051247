// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The object behind a Python shape.
#pragma once

#include <string>
#include <vector>

#include "map_queries.hpp"

namespace ndtree::python {

struct PythonShape {
  std::vector<AnyShapePart> parts;
  std::string text;
};

}  // namespace ndtree::python
