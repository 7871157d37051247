// SPDX-License-Identifier: BSD-3-Clause
// Distances to the nearest of many boxes, against a look at every box.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <type_traits>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/distance_transform.hpp"
#include "ndtree/query/field_grid.hpp"
#include "random.hpp"

namespace ndtree::test::test_distance_transform {
namespace {

/// Of any size and at any place, some of them thin, long, or sharing their borders.
template <int D>
std::vector<Box<D>> random_boxes(Random& random, std::size_t n) {
  std::vector<Box<D>> boxes;
  for (std::size_t i = 0; i < n; ++i) {
    Box<D> box;
    for (int a = 0; a < D; ++a) {
      box.lower[a] = random.uniform(-3.0, 3.0);
      if (random.chance(0.5)) box.lower[a] = std::floor(box.lower[a] * 4.0) / 4.0;
      box.upper[a] = box.lower[a] + (random.chance(0.5) ? 0.25 : random.uniform(0.01, 2.0));
    }
    boxes.push_back(box);
  }
  return boxes;
}

template <int D>
using Dimension = std::integral_constant<int, D>;
template <class T>
class OfDimension : public testing::Test {};
using Dimensions = testing::Types<Dimension<2>, Dimension<3>, Dimension<4>>;
TYPED_TEST_SUITE(OfDimension, Dimensions);

TYPED_TEST(OfDimension, FindsTheNearestOfAllBoxes) {
  constexpr int D = TypeParam::value;
  using Shape = typename FieldGrid<D>::Shape;
  Random random(31);
  std::size_t near = 0;
  std::size_t far = 0;
  for (int round = 0; round < 40; ++round) {
    Shape shape;
    for (std::size_t& n : shape)
      n = static_cast<std::size_t>(random.integer(1, D == 2 ? 40 : D == 3 ? 18 : 7));
    const double spacing = random.chance(0.5) ? 0.25 : random.uniform(0.05, 0.6);
    const FieldGrid<D> grid(Vector<D>::Constant(-2.0), spacing, shape);
    const double most = random.uniform(0.1, 4.0);
    const auto boxes = random_boxes<D>(
        random, static_cast<std::size_t>(random.integer(0, round % 8 == 7 && D < 4 ? 400 : 60)));
    Pace pace;
    const GridBlock<D> whole{{}, shape};
    detail::DistanceTransform<D> transform(grid, whole, most, pace);
    const std::vector<float> found = transform.squared_distances(boxes);
    ASSERT_EQ(found.size(), whole.size());
    detail::any_place(whole.first, whole.last, [&](const Shape& at) {
      Vector<D> point;
      for (std::size_t a = 0; a < at.size(); ++a) point[static_cast<int>(a)] = grid.center(a, at[a]);
      double nearest = most * most;
      for (const Box<D>& box : boxes)
        nearest =
            std::min(nearest, (box.lower - point).cwiseMax(point - box.upper).cwiseMax(0.0).squaredNorm());
      const auto squared = static_cast<double>(found[whole.index(at)]);
      EXPECT_NEAR(squared, nearest, 1e-6 * (1.0 + nearest));
      EXPECT_EQ(squared == 0.0, nearest == 0.0);
      ++(nearest < most * most ? near : far);
      return testing::Test::HasFailure();
    });
    ASSERT_FALSE(testing::Test::HasFailure()) << "round " << round;

    // The same bits for parts of the grid, farther reach, boxes in parts, and without eight at a time.
    GridBlock<D> part = whole;
    for (std::size_t a = 0; a < shape.size(); ++a) {
      part.first[a] = static_cast<std::size_t>(random.integer(0, static_cast<int>(shape[a]) - 1));
      part.last[a] = static_cast<std::size_t>(
          random.integer(static_cast<int>(part.first[a]) + 1, static_cast<int>(shape[a])));
    }
    std::vector<Box<D>> parts;
    for (const Box<D>& box : boxes) {
      const double middle = 0.5 * (box.lower[0] + box.upper[0]);
      parts.push_back(box);
      parts.back().upper[0] = middle;
      parts.push_back(box);
      parts.back().lower[0] = middle;
    }
    std::reverse(parts.begin(), parts.end());
    Simd::limit(1);
    detail::DistanceTransform<D> other(grid, part, 1.5 * most, pace);
    Simd::limit(Simd::kWidest);
    const std::vector<float> again = other.squared_distances(parts);
    detail::any_place(part.first, part.last, [&](const Shape& at) {
      EXPECT_EQ(std::min(again[part.index(at)], transform.limit()), found[whole.index(at)]);
      return testing::Test::HasFailure();
    });
    ASSERT_FALSE(testing::Test::HasFailure()) << "round " << round;
  }
  EXPECT_GT(near, 1000u);
  EXPECT_GT(far, 1000u);
}

}  // namespace
}  // namespace ndtree::test::test_distance_transform
