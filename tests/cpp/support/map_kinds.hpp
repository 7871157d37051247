// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The maps that typed suites run over whose subject is no shape.
#pragma once

#include <gtest/gtest.h>

#include "ndtree/mapping/occupancy_map.hpp"

namespace ndtree::test {

/// Each refinement once, in the plane and in space, with two and with three children an axis.
using MapKinds = ::testing::Types<AdaptiveMap<2, 3>, PaperMap<3, 2>, FixedMap<2, 2>>;

}  // namespace ndtree::test
