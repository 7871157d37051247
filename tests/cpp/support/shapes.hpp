// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The (N, D) that typed suites run over.
#pragma once

#include <gtest/gtest.h>

#include <string>

namespace ndtree::test {

template <int N, int D>
struct Shape {
  static constexpr int kBranching = N;
  static constexpr int kDim = D;
};

/// For what does not depend on N or D: one in the plane, and one in space.
using TwoShapes = ::testing::Types<Shape<3, 2>, Shape<2, 3>>;
#ifdef NDTREE_SANITIZED  // Compiling takes longest there; other builds run all.
using Shapes = TwoShapes;
#else
using Shapes = ::testing::Types<Shape<2, 1>, Shape<2, 2>, Shape<3, 2>, Shape<5, 2>, Shape<2, 3>, Shape<3, 3>,
                                Shape<2, 4>>;
#endif

struct ShapeNames {
  template <class S>
  static std::string GetName(int /*number*/) {
    return "N" + std::to_string(S::kBranching) + "D" + std::to_string(S::kDim);
  }
};

/// Bodies of typed tests begin with it.
#define NDTREE_SHAPE                       \
  constexpr int N = TypeParam::kBranching; \
  constexpr int D = TypeParam::kDim;       \
  static_assert(N >= 2 && D >= 1, "a shape")

}  // namespace ndtree::test
