// SPDX-License-Identifier: BSD-3-Clause
// Nearest points: those that a look at every point finds, ties included.

#include <gtest/gtest.h>

#include <limits>
#include <optional>

#include "ndtree/core/kd_tree.hpp"
#include "random.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_kd_tree {
namespace {

template <class Shape>
class KdTreeOf : public ::testing::Test {};
TYPED_TEST_SUITE(KdTreeOf, test::TwoShapes, test::ShapeNames);

/// @param except a column that does not count; none: all count.
template <int D>
std::optional<typename KdTree<D>::Neighbor> nearest_of_all(const Points<D>& points, const Vector<D>& query,
                                                           std::optional<Eigen::Index> except = {}) {
  std::optional<typename KdTree<D>::Neighbor> best;
  for (Eigen::Index i = 0; i < points.cols(); ++i) {
    const double squared = (points.col(i) - query).squaredNorm();
    if (i != except && (!best || squared < best->squared_distance)) best = {i, squared};
  }
  return best;
}

/// On a coarse lattice many points are in one place, and many are equally near.
template <int D>
Points<D> random_points(test::Random& random, int n, bool on_lattice) {
  Points<D> points(D, n);
  for (Eigen::Index i = 0; i < points.size(); ++i)
    points.data()[i] = on_lattice ? 0.5 * random.integer(-4, 4) : random.uniform(-2.0, 2.0);
  return points;
}

TYPED_TEST(KdTreeOf, FindsWhatALookAtEveryPointFinds) {
  constexpr int D = TypeParam::kDim;
  test::Random random(71);
  int found = 0;
  int none = 0;
  for (const int n : {0, 1, 2, 7, 8, 9, 17, 100, 700}) {
    for (const bool on_lattice : {false, true}) {
      const Points<D> points = random_points<D>(random, n, on_lattice);
      const KdTree<D> tree(points);
      ASSERT_EQ(tree.size(), n);
      const Points<D> queries = random_points<D>(random, 60, on_lattice);
      for (Eigen::Index q = 0; q < queries.cols(); ++q) {
        const Vector<D> query = queries.col(q);
        const auto expected = nearest_of_all<D>(points, query);
        const double limit = q % 3 == 0   ? std::numeric_limits<double>::infinity()
                             : q % 3 == 1 ? 0.5
                                          : random.uniform(0.0, 0.5);
        const bool is_near = expected && expected->squared_distance <= limit * limit;
        const auto nearest = tree.nearest(query, limit);
        ASSERT_EQ(nearest.has_value(), is_near) << n << " points, within " << limit;
        ++(is_near ? found : none);
        if (!is_near) continue;
        EXPECT_EQ(nearest->index, expected->index);
        EXPECT_EQ(nearest->squared_distance, expected->squared_distance);
      }
      for (Eigen::Index i = 0; i < n; ++i) {
        const auto expected = nearest_of_all<D>(points, points.col(i), i);
        const auto nearest = tree.nearest_other(i);
        ASSERT_EQ(nearest.has_value(), expected.has_value());
        if (!expected) continue;
        EXPECT_EQ(nearest->index, expected->index);
        EXPECT_EQ(nearest->squared_distance, expected->squared_distance);
        ++found;
      }
    }
  }
  EXPECT_GT(found, 2000);
  EXPECT_GT(none, 100);
}

}  // namespace
}  // namespace ndtree::test::test_kd_tree
