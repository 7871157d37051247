// SPDX-License-Identifier: BSD-3-Clause
// What is seen through faces, against where the straight way meets each of them.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "ndtree/planning/cone.hpp"
#include "random.hpp"

namespace ndtree::test::test_cone {
namespace {

/// Cells side by side from that of a point on, of whole sizes, there and back; the faces between them.
template <int D>
std::vector<Box<D>> chain_of_faces(Random& random, const Vector<D>& from, int count) {
  std::vector<Box<D>> faces;
  Box<D> cell{from.array().floor().matrix(), (from.array().floor() + 1.0).matrix()};
  for (int i = 0; i < count; ++i) {
    const int axis = random.integer(0, D - 1);
    const bool ahead = random.chance(0.8);
    Box<D> face = cell;
    (ahead ? face.lower : face.upper)[axis] = (ahead ? face.upper : face.lower)[axis];
    for (int a = 0; a < D; ++a)
      if (a != axis && face.upper[a] - face.lower[a] > 1.0 && random.chance(0.3)) face.upper[a] -= 1.0;
    faces.push_back(face);
    cell = face;
    (ahead ? cell.upper : cell.lower)[axis] += (ahead ? 1 : -1) * random.integer(1, 3);
    for (int a = 0; a < D; ++a)
      if (a != axis && random.chance(0.5)) cell.upper[a] += random.integer(0, 2);
  }
  return faces;
}
/// How far inside each face the straight way through a point on the last one meets it, and how far ahead, at
/// least; below 0 if it does not. Cells of a search do not overlap, so it meets faces in their order.
template <int D>
double least_margin(const std::vector<Box<D>>& faces, const Vector<D>& from, const Vector<D>& to) {
  double least = 1e9;
  for (const Box<D>& face : faces) {
    int axis = 0;
    while (axis < D - 1 && face.lower[axis] != face.upper[axis]) ++axis;
    const double t = (face.lower[axis] - from[axis]) / (to[axis] - from[axis]);
    least = std::min(least, t);
    const Vector<D> at = from + t * (to - from);
    for (int a = 0; a < D; ++a)
      if (a != axis) least = std::min({least, at[a] - face.lower[a], face.upper[a] - at[a]});
  }
  return least;
}

template <int D>
void check() {
  Random random(31 + D);
  int seen = 0, hidden = 0, moved = 0;
  for (int trial = 0; trial < 20000; ++trial) {
    Vector<D> from;
    for (int a = 0; a < D; ++a) from[a] = random.uniform(0.01, 0.99);
    const auto faces = chain_of_faces<D>(random, from, random.integer(1, 6));
    detail::Cone<D> cone;
    for (const Box<D>& face : faces) cone.narrow(face, from);
    Vector<D> to;
    for (int a = 0; a < D; ++a) to[a] = random.uniform(faces.back().lower[a], faces.back().upper[a]);
    const double margin = least_margin<D>(faces, from, to);
    if (std::abs(margin) > 1e-9) {
      ASSERT_EQ(cone.contains(to - from), margin > 0.0) << "trial " << trial;
    }
    (margin > 0.0 ? seen : hidden) += 1;
    const Vector<D> nearer = cone.moved_into(to, faces.back(), from);
    if (margin > 0.0) {
      EXPECT_LE((nearer - to).norm(), 1e-6);
    }
    if (D == 2 && cone.contains(nearer - from)) {
      ASSERT_GE(least_margin<D>(faces, from, nearer), -1e-9);
      moved += margin < 0.0;
    }
  }
  EXPECT_GT(seen, 2000);
  EXPECT_GT(hidden, 2000);
  EXPECT_GE(moved, D == 2 ? 500 : 0);
  EXPECT_FALSE(detail::Cone<D>::empty().contains(Vector<D>::Ones()));
}

TEST(Cone, SeesWhatTheStraightWayMeetsInThePlane) { check<2>(); }
TEST(Cone, SeesWhatTheStraightWayMeetsInSpace) { check<3>(); }

// A bend lies at a corner of cells: from there, all of the cell behind a face that has the corner is seen.
TEST(Cone, SeesAllFromAPointOfTheFace) {
  const Box<2> face{{1.0, 0.0}, {1.0, 2.0}};
  detail::Cone<2> cone;
  cone.narrow(face, {1.0, 2.0});
  EXPECT_TRUE(cone.contains({0.5, -1.9}));
  EXPECT_TRUE(cone.contains({0.0, -1.0}));
  detail::Cone<2> beside;
  beside.narrow(face, {1.0, 3.0});
  EXPECT_FALSE(beside.contains({0.5, -1.9}));
}

}  // namespace
}  // namespace ndtree::test::test_cone
