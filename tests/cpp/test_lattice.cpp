// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "ndtree/tree/lattice.hpp"
#include "random.hpp"
#include "refusals.hpp"
#include "shapes.hpp"

namespace ndtree::test::test_lattice {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

const std::vector<double>& units() {
  static const std::vector<double> kUnits{0.05, 0.1, 0.25, 0.01, 1.0 / 3.0, 0.7, 1e-3, 1.0, 12.34, 1e5};
  return kUnits;
}

/// The value, and its neighbours on either side.
std::vector<double> with_neighbours(double x) {
  return {std::nextafter(x, -kInfinity), x, std::nextafter(x, kInfinity)};
}

/// How many of the points do not lie between the borders of their coordinate.
template <class Geometry>
int count_misplaced(const Geometry& geometry, const std::vector<double>& points) {
  int misplaced = 0;
  for (const double x : points) {
    const std::int64_t k = geometry.coordinate(x);
    const bool placed = geometry.border(k) <= x && x < geometry.border(k + 1);
    if (!placed && misplaced++ == 0)
      ADD_FAILURE() << x << " is not in cell " << k << " of " << geometry.unit() << " m";
  }
  return misplaced;
}

TEST(Lattice, CoordinateIsTheCellWhoseBordersEncloseThePoint) {
  Random random(1);
  std::size_t cases = 0;
  for (const double unit : units()) {
    const LatticeGeometry<2, 2> geometry(unit, 3);
    std::vector<double> points{0.0, -0.0, geometry.reach(), -geometry.reach()};
    for (int i = -400; i <= 400; ++i)  // Decimal numbers as people write, multiply and divide them.
      for (const double x :
           {i * 0.05, i * 0.1, i / 20.0, i / 10.0, i * unit, i * 0.3, 1e6 + i * 0.01, i - 1e6})
        for (const double near : with_neighbours(x)) points.push_back(near);
    for (int i = 0; i < 1000; ++i) {
      const double size = std::exp2(random.uniform(-10.0, 38.0));
      const std::int64_t k = std::llround(random.uniform(-size, size));
      for (const double near : with_neighbours(geometry.border(k))) points.push_back(near);
      points.push_back(random.uniform(-size, size) * unit);
    }
    EXPECT_EQ(count_misplaced(geometry, points), 0);
    cases += points.size();
  }
  EXPECT_EQ(cases, 10u * (4u + 801u * 8u * 3u + 4000u));
}

TEST(Lattice, BorderIsTheNearestDoubleToAMultipleOfTheUnit) {
  Random random(2);
  for (const double unit : units()) {
    const LatticeGeometry<2, 2> geometry(unit, 0);
    for (int i = 0; i < 500; ++i) {
      const double size = std::exp2(random.uniform(0.0, 38.0));
      const std::int64_t k = std::llround(random.uniform(-size, size));
      const double border = geometry.border(k);
      const auto distance = [&](double x) { return std::abs(std::fma(static_cast<double>(k), unit, -x)); };
      ASSERT_LE(distance(border), distance(std::nextafter(border, kInfinity)));
      ASSERT_LE(distance(border), distance(std::nextafter(border, -kInfinity)));
    }
  }
}

TEST(Lattice, ReachIsClosed) {
  const LatticeGeometry<2, 2> geometry(0.01, 4);
  EXPECT_GE(geometry.reach(), 1e6);  // 1000 km at 1 cm.
  const double reach = geometry.reach();
  const double beyond = std::nextafter(reach, kInfinity);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(geometry.in_reach(reach) && geometry.in_reach(-reach) && geometry.in_reach(0.0));
  for (const double x : {beyond, -beyond, kInfinity, -kInfinity, nan})
    EXPECT_FALSE(geometry.in_reach(x)) << x;
  EXPECT_TRUE(geometry.in_reach(Vector<2>(reach, -reach)));
  EXPECT_FALSE(geometry.in_reach(Vector<2>(0.0, beyond)));
  EXPECT_FALSE(geometry.in_reach(Vector<2>(nan, 0.0)));
}

TEST(Lattice, RefusesWhatItCannotAddress) {
  struct Row {
    double unit;
    int num_levels;
    const char* message;
  };
  const Row rows[] = {{0.0, 1, "min_cell_size = 0.0"},       {-0.1, 1, "min_cell_size = -0.1"},
                      {kInfinity, 1, "min_cell_size = inf"}, {std::nan(""), 1, "min_cell_size = "},
                      {0.1, -1, "number of levels = -1"},    {0.1, 23, "23 levels"}};
  for (const Row& row : rows) {
    SCOPED_TRACE(row.message);
    expect_refused([&] { const LatticeGeometry<3, 2> geometry(row.unit, row.num_levels); }, row.message);
  }
  EXPECT_EQ((LatticeGeometry<3, 2>(0.1, 22).edge(0)), 31381059609);  // 3^22, the last below 2^36.
  EXPECT_EQ((LatticeGeometry<2, 2>(0.1, 36).edge(0)), 68719476736);
  EXPECT_THROW((LatticeGeometry<2, 2>(0.1, 37)), std::invalid_argument);
  EXPECT_EQ((LatticeGeometry<4096, 1>(0.1, 3).edge(0)), 68719476736);
}

template <class S>
class LatticeOf : public ::testing::Test {};
TYPED_TEST_SUITE(LatticeOf, Shapes, ShapeNames);

TYPED_TEST(LatticeOf, EdgesGrowByNFromOneUnit) {
  NDTREE_SHAPE;
  const LatticeGeometry<N, D> geometry(0.1, 3);
  EXPECT_EQ(geometry.finest_level(), -3);
  EXPECT_EQ(geometry.unit(), 0.1);
  std::int64_t edge = 1;
  for (int level = -3; level <= 5; ++level, edge *= N) {
    EXPECT_EQ(geometry.edge(level), edge) << "level " << level;
    EXPECT_DOUBLE_EQ(geometry.cell_size(level), 0.1 * static_cast<double>(edge));
  }
}

TYPED_TEST(LatticeOf, CellsOfAllLevelsShareTheirBordersToTheLastBit) {
  NDTREE_SHAPE;
  Random random(3);
  for (const double unit : units()) {
    const LatticeGeometry<N, D> geometry(unit, 4);
    for (int i = 0; i < 200; ++i) {
      const int small = random.integer(-4, 2);
      const int large = random.integer(small, 2);
      // A large cell anywhere within 1000 km at 1 cm, and a small one that begins where it ends.
      const std::int64_t places = 100000000 / geometry.edge(large);
      CellIndex<D> below{{}, large};
      for (auto& lower : below.lower)
        lower = geometry.edge(large) * std::llround(random.uniform(-1.0, 1.0) * static_cast<double>(places));
      CellIndex<D> above{below.lower, small};
      const auto axis = static_cast<std::size_t>(random.integer(0, D - 1));
      above.lower[axis] += geometry.edge(large);
      const Box<D> box_below = geometry.box(below);
      const Box<D> box_above = geometry.box(above);
      for (int a = 0; a < D; ++a) {
        if (a == static_cast<int>(axis)) {
          ASSERT_EQ(box_below.upper[a], box_above.lower[a]);
        } else {
          ASSERT_EQ(box_below.lower[a], box_above.lower[a]);
        }
        ASSERT_EQ(box_below.lower[a], unit * static_cast<double>(below.lower[static_cast<std::size_t>(a)]));
      }
    }
  }
}

TYPED_TEST(LatticeOf, CellContainsItsHalfOpenRange) {
  NDTREE_SHAPE;
  const LatticeGeometry<N, D> geometry(0.25, 1);
  CellIndex<D> cell{{}, 0};
  cell.lower.fill(-N);
  for (std::size_t a = 0; a < D; ++a) {
    Lattice<D> inside = cell.lower;
    EXPECT_TRUE(geometry.contains(cell, inside));
    inside[a] = -1;
    EXPECT_TRUE(geometry.contains(cell, inside));
    inside[a] = 0;
    EXPECT_FALSE(geometry.contains(cell, inside));
    inside[a] = -N - 1;
    EXPECT_FALSE(geometry.contains(cell, inside));
  }
}

TEST(LatticeGeometry, CornersBesideABorderLieOnIt) {
  int on_border = 0;
  int beside = 0;
  for (const double unit : units()) {
    const LatticeGeometry<2, 1> geometry(unit, 3);
    double sum = 0.0;  // As a user adds cell sizes up.
    for (std::int64_t k = 0; k < 2000; ++k, sum += unit) {
      const double upper = sum + unit;
      const auto box = geometry.on_borders({Vector<1>(sum), Vector<1>(upper)});
      on_border += box.lower[0] == geometry.border(k) && box.upper[0] == geometry.border(k + 1);
      const auto again = geometry.on_borders(box);
      EXPECT_TRUE(again.lower == box.lower && again.upper == box.upper);
      const auto cells = geometry.cells_in({Vector<1>(sum), Vector<1>(upper)}, geometry.finest_level());
      EXPECT_EQ(cells.lower[0], k) << unit;
      EXPECT_EQ(cells.upper[0], k + 1) << unit;
      const Box<1> inside{Vector<1>(sum + 1e-5 * unit), Vector<1>(upper - 1e-5 * unit)};
      const auto same = geometry.on_borders(inside);
      beside += same.lower == inside.lower && same.upper == inside.upper;
    }
    const Box<1> thin{Vector<1>(3.0 * unit - 1e-8 * unit), Vector<1>(3.0 * unit + 1e-8 * unit)};
    EXPECT_EQ(geometry.on_borders(thin).lower, thin.lower);
    const Box<1> all{Vector<1>(-kInfinity), Vector<1>(kInfinity)};
    EXPECT_EQ(geometry.on_borders(all).upper, all.upper);
  }
  EXPECT_EQ(on_border, 20000);
  EXPECT_EQ(beside, 20000);
}

}  // namespace
}  // namespace ndtree::test::test_lattice
