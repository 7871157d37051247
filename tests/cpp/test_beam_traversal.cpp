// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "fraction.hpp"
#include "ndtree/tree/beam_traversal.hpp"
#include "random.hpp"
#include "shapes.hpp"
#include "trees.hpp"

namespace ndtree::test::test_beam_traversal {
namespace {

constexpr double kUnit = 0.25;
constexpr std::int64_t kParts = 4;  // Exact points are whole numbers of a quarter unit: multiples of 1/16 m.

/// A beam without rounding: origin and direction in quarters of a unit.
template <int D>
struct ExactBeam {
  Lattice<D> origin{};
  Lattice<D> direction{};
  Fraction t_begin{0};
  Fraction t_end{1};

  [[nodiscard]] static Vector<D> metres(const Lattice<D>& quarters) {
    Vector<D> result;
    for (std::size_t a = 0; a < D; ++a)
      result[static_cast<int>(a)] = static_cast<double>(quarters[a]) * (kUnit / kParts);
    return result;
  }
  [[nodiscard]] std::string text() const {
    std::ostringstream out;
    out << "from";
    for (const auto x : origin) out << ' ' << x;
    out << " towards";
    for (const auto x : direction) out << ' ' << x;
    out << ", t from " << t_begin.value() << " to " << t_end.value();
    return out.str();
  }
};

template <int D>
struct Crossing {
  CellIndex<D> index;
  double t_enter;
  double t_exit;
  friend bool operator==(const Crossing& a, const Crossing& b) {
    return a.index == b.index && a.t_enter == b.t_enter && a.t_exit == b.t_exit;
  }
  friend std::ostream& operator<<(std::ostream& out, const Crossing& c) {
    out << "level " << c.index.level << " at";
    for (const auto x : c.index.lower) out << ' ' << x;
    return out << " [" << c.t_enter << ", " << c.t_exit << "]";
  }
};

/// Which part of a beam lies in the half-open cell; false if none or a point.
template <int D>
bool clip(const ExactBeam<D>& beam, const CellIndex<D>& cell, std::int64_t edge, Fraction& enter,
          Fraction& leave) {
  enter = beam.t_begin;
  leave = beam.t_end;
  for (std::size_t a = 0; a < D; ++a) {
    const std::int64_t to_lower = cell.lower[a] * kParts - beam.origin[a];
    const std::int64_t to_upper = to_lower + edge * kParts;
    if (beam.direction[a] == 0) {
      if (to_lower > 0 || to_upper <= 0) return false;
      continue;
    }
    Fraction near(to_lower, beam.direction[a]);
    Fraction far(to_upper, beam.direction[a]);
    if (far < near) std::swap(near, far);
    if (enter < near) enter = near;
    if (far < leave) leave = far;
  }
  return enter < leave;
}

/// All leaves, one by one, against the beam; then in the order of their entries.
template <class Tree, int D>
std::vector<Crossing<D>> expected_crossings(const Tree& tree, const ExactBeam<D>& beam) {
  std::vector<Crossing<D>> crossings;
  for_each_leaf(tree, [&](const auto& leaf) {
    Fraction enter;
    Fraction leave;
    if (clip(beam, leaf.index, tree.geometry().edge(leaf.index.level), enter, leave))
      crossings.push_back({leaf.index, enter.value(), leave.value()});
  });
  std::sort(crossings.begin(), crossings.end(),
            [](const auto& a, const auto& b) { return a.t_enter < b.t_enter; });
  return crossings;
}

template <class Tree>
std::vector<Crossing<Tree::kDim>> traversed(const Tree& tree, const Vector<Tree::kDim>& origin,
                                            const Vector<Tree::kDim>& direction, double t_begin,
                                            double t_end) {
  std::vector<Crossing<Tree::kDim>> crossings;
  EXPECT_TRUE(traverse_beam(tree, origin, direction, t_begin, t_end,
                            [&](const auto& leaf, double t_enter, double t_exit) {
                              crossings.push_back({leaf.index, t_enter, t_exit});
                            }));
  return crossings;
}

template <class Tree, int D>
std::vector<Crossing<D>> traversed(const Tree& tree, const ExactBeam<D>& beam) {
  return traversed(tree, beam.metres(beam.origin), beam.metres(beam.direction), beam.t_begin.value(),
                   beam.t_end.value());
}

/// Compares the traversal of one beam with the list; false and a message if they differ.
template <class Tree, int D>
bool agrees(const Tree& tree, const ExactBeam<D>& beam) {
  const auto expected = expected_crossings(tree, beam);
  const auto found = traversed(tree, beam);
  if (found == expected) return true;
  std::ostringstream out;
  out << beam.text() << "\nexpected:";
  for (const auto& c : expected) out << "\n  " << c;
  out << "\nvisited:";
  for (const auto& c : found) out << "\n  " << c;
  ADD_FAILURE() << out.str();
  return false;
}

template <class S>
class BeamTraversalOf : public ::testing::Test {};
TYPED_TEST_SUITE(BeamTraversalOf, Shapes, ShapeNames);

TYPED_TEST(BeamTraversalOf, RandomBeamsVisitExactlyTheLeavesThatTheyCross) {
  NDTREE_SHAPE;
  Random random(20);
  std::size_t visits = 0;
  for (int round = 0; round < 12; ++round) {
    const auto tree = random_tree<N, D>(random, kUnit, 3, 25);
    const auto root = tree.root().index;
    const auto edge = static_cast<int>(tree.geometry().edge(root.level) * kParts);
    for (int i = 0; i < 60; ++i) {
      ExactBeam<D> beam;
      const int margin = edge / 4;
      for (std::size_t a = 0; a < D; ++a) {
        beam.origin[a] = root.lower[a] * kParts + random.integer(-margin, edge + margin);
        if (random.chance(0.3)) beam.origin[a] -= beam.origin[a] % kParts;  // On a border.
        beam.direction[a] = random.chance(0.2) ? 0 : random.integer(-edge, edge);
        if (random.chance(0.2)) beam.direction[a] = random.chance(0.5) ? edge : -edge;  // Through corners.
      }
      if (random.chance(0.3)) {
        beam.t_begin = Fraction(random.integer(-4, 2), 4);
        beam.t_end = Fraction(random.integer(3, 9), 4);
      }
      if (random.chance(0.1)) beam.t_end = Fraction::infinity();
      ASSERT_TRUE(agrees(tree, beam));
      visits += expected_crossings(tree, beam).size();
    }
  }
  EXPECT_GT(visits, 700u);
}

/// Beams along faces, through edges and corners, in all directions: every sign on every axis, from origins on
/// borders of the finest cells, of the root, within cells and outside.
TYPED_TEST(BeamTraversalOf, DegenerateBeamsInEveryDirection) {
  NDTREE_SHAPE;
  Random random(21);
  NdTree<N, D, int> tree(kUnit, 2);
  tree.split(tree.root());
  for (int j = 0; j < tree.kNumChildren; j += 3) tree.split(tree.child(tree.root(), j));
  constexpr std::int64_t kRoot = N * N * kParts;
  constexpr std::int64_t kStarts[] = {0, kParts, N * kParts, N * kParts + 2, kRoot, -kParts, kRoot + kParts};
  const auto directions = static_cast<int>(integer_power(3, D));
  for (int number = 0; number < directions; ++number) {
    const Offset<D> signs = child_offset<3, D>(number);
    for (const std::int64_t first : kStarts)
      for (const std::int64_t rest : kStarts)
        for (const std::int64_t length : {kRoot, N * kParts, std::int64_t{1}}) {
          ExactBeam<D> beam;
          beam.origin.fill(rest);
          beam.origin[0] = first;
          for (std::size_t a = 0; a < D; ++a) beam.direction[a] = (signs[a] - 1) * length;
          ASSERT_TRUE(agrees(tree, beam));
        }
  }
}

TEST(BeamTraversal, ByHand) {
  // Root [0, 4) x [0, 4) in units; its first child, [0, 2) x [0, 2), is divided once more. Named by number:
  // the small cells a b / c d at the bottom left, then the large ones B (right), C (top), D (top right).
  NdTree<2, 2, char> tree(kUnit, 2);
  tree.split(tree.root());
  tree.split(tree.child(tree.root(), 0));
  for (int j = 0; j < 4; ++j) {
    tree.child(tree.child(tree.root(), 0), j).cell() = "abcd"[j];
    if (j > 0) tree.child(tree.root(), j).cell() = "ABCD"[j];
  }
  struct Row {
    const char* what;
    Lattice<2> origin, direction;  // Quarters of a unit.
    const char* leaves;
    std::vector<double> t;  // Entries, and the last exit.
  };
  const Row rows[] = {
      {"right through the lowest row", {0, 2}, {16, 0}, "abB", {0, 0.25, 0.5, 1}},
      {"along a face of small cells: those above", {0, 4}, {16, 0}, "cdB", {0, 0.25, 0.5, 1}},
      {"backwards along a face: those above, too", {16, 4}, {-16, 0}, "Bdc", {0, 0.5, 0.75, 1}},
      {"along the root's upper face: outside", {0, 16}, {16, 0}, "", {}},
      {"diagonal through corners only", {0, 0}, {16, 16}, "adD", {0, 0.25, 0.5, 1}},
      {"and backwards", {16, 16}, {-16, -16}, "Dda", {0, 0.5, 0.75, 1}},
      {"ends on a border from below", {0, 2}, {4, 0}, "a", {0, 1}},
      {"ends on a border from above", {8, 2}, {-4, 0}, "b", {0, 1}},
      {"starts on a border, upwards", {4, 2}, {2, 0}, "b", {0, 1}},
      {"starts on a border, downwards", {4, 2}, {-2, 0}, "a", {0, 1}},
      {"starts in a corner, down and right", {4, 4}, {4, -4}, "b", {0, 1}},
      {"zero length inside", {2, 2}, {0, 0}, "a", {0, 1}},
      {"zero length in a corner: the cell above", {8, 8}, {0, 0}, "D", {0, 1}},
      {"zero length outside", {-1, 2}, {0, 0}, "", {}},
      {"from outside into the root", {-16, 2}, {32, 0}, "abB", {0.5, 0.625, 0.75, 1}},
      {"from outside, but not far enough", {-16, 2}, {16, 0}, "", {}},
      {"touches the root in a corner", {-4, 4}, {8, -8}, "", {}},
  };
  for (const Row& row : rows) {
    SCOPED_TRACE(row.what);
    std::string leaves;
    std::vector<double> t;
    double exit = 0.0;
    traverse_beam(tree, ExactBeam<2>::metres(row.origin), ExactBeam<2>::metres(row.direction), 0.0, 1.0,
                  [&](const auto& leaf, double t_enter, double t_exit) {
                    leaves += leaf.cell();
                    t.push_back(t_enter);
                    exit = t_exit;
                  });
    if (!t.empty()) t.push_back(exit);
    EXPECT_EQ(leaves, row.leaves);
    EXPECT_EQ(t, row.t);
    ExactBeam<2> beam;
    beam.origin = row.origin;
    beam.direction = row.direction;
    EXPECT_TRUE(agrees(tree, beam));
  }
}

/// Real numbers, unit 0.1 m, near and far from the origin. Half of the beams go like measurements from the
/// corner of one cell to that of another, so that the planes of several axes meet to within the last bits.
/// Each leaf's part is what the planes of its box cut off, to the last bit, and the parts tile the beam's
/// part of the root.
TYPED_TEST(BeamTraversalOf, PartsAreCutOffByTheirLeavesBoxesToTheLastBit) {
  NDTREE_SHAPE;
  Random random(23);
  const auto clipped = [](const Box<D>& box, const Vector<D>& origin, const Vector<D>& direction) {
    std::pair<double, double> t(0.0, 1e3);
    for (int a = 0; a < D; ++a) {
      if (direction[a] == 0.0) {
        if (origin[a] < box.lower[a] || origin[a] >= box.upper[a]) t.second = t.first;
        continue;
      }
      const double t_lower = (box.lower[a] - origin[a]) / direction[a];
      const double t_upper = (box.upper[a] - origin[a]) / direction[a];
      t.first = std::max(t.first, std::min(t_lower, t_upper));
      t.second = std::min(t.second, std::max(t_lower, t_upper));
    }
    return t;
  };
  std::size_t visits = 0;
  for (const double place : {0.0, 0.0, 1e5}) {  // There, a double of metres resolves 1.5e-11 m.
    NdTree<N, D, int> tree(0.1, 3);
    tree.grow_to_contain(Vector<D>::Constant(-0.1));
    tree.grow_to_contain(Vector<D>::Constant(place + 1.0));
    for (int i = 0; i < 100; ++i) {
      const auto leaf =
          i % 2 == 0 ? random_leaf(tree, random)
                     : *tree.find_leaf(Vector<D>::Constant(place) +
                                       random_point<D>(random, {Vector<D>::Zero(), Vector<D>::Ones()}));
      if (leaf.index.level > tree.geometry().finest_level()) tree.split(leaf);
    }
    for (int i = 0; i < 1500; ++i) {
      Vector<D> origin;
      Vector<D> direction;
      const double slope = random.integer(1, 3);
      for (int a = 0; a < D; ++a) {
        origin[a] = place + (i % 2 == 0 ? random.integer(-20, 20) * 0.1 : random.uniform(-2.0, 2.0));
        direction[a] = i % 2 == 0
                           ? (random.chance(0.5) ? 1 : -1) * (random.chance(0.5) ? slope / 3.0 : slope / 7.0)
                           : random.uniform(-1.0, 1.0);
      }
      if (i % 8 == 1) direction[random.integer(0, D - 1)] = 0.0;
      const auto crossings = traversed(tree, origin, direction, 0.0, 1e3);
      visits += crossings.size();
      const auto [t_enter, t_exit] = clipped(tree.box(tree.root().index), origin, direction);
      ASSERT_EQ(crossings.empty(), !(t_enter < t_exit));
      for (std::size_t k = 0; k < crossings.size(); ++k) {
        const auto& c = crossings[k];
        ASSERT_LT(c.t_enter, c.t_exit);
        ASSERT_EQ(c.t_enter, k == 0 ? t_enter : crossings[k - 1].t_exit);
        ASSERT_EQ(std::pair(c.t_enter, c.t_exit), clipped(tree.box(c.index), origin, direction));
      }
      if (!crossings.empty()) {
        ASSERT_EQ(crossings.back().t_exit, t_exit);
      }
    }
  }
  EXPECT_GT(visits, 3000u);
}

/// From so far away that several planes round to the same t: their cells are not crossed over any length.
TYPED_TEST(BeamTraversalOf, PlanesThatRoundingJoinsLeaveNoEmptyParts) {
  NDTREE_SHAPE;
  NdTree<N, D, int> tree(kUnit, 2);
  tree.split(tree.root());
  for (int j = 0; j < tree.kNumChildren; ++j) tree.split(tree.child(tree.root(), j));
  const auto directions = static_cast<int>(integer_power(3, D));
  std::size_t visits = 0;
  std::size_t skipped = 0;
  for (int number = 0; number < directions; ++number) {
    const Offset<D> signs = child_offset<3, D>(number);
    for (const double far : {0x1p50, 0x1p51, 0x1p52}) {  // There, doubles are 1/4, 1/2 and 1 m apart.
      Vector<D> origin;
      Vector<D> direction;
      for (int a = 0; a < D; ++a) {
        direction[a] = signs[static_cast<std::size_t>(a)] - 1;
        origin[a] = 0.375 - direction[a] * far;
      }
      std::vector<Crossing<D>> expected;
      for_each_leaf(tree, [&](const auto& leaf) {
        const Box<D> box = tree.box(leaf.index);
        double t_enter = 0.0;
        double t_exit = 0x1p60;
        for (int a = 0; a < D; ++a) {
          const double to_lower = box.lower[a] - origin[a];
          const double to_upper = box.upper[a] - origin[a];
          if (direction[a] == 0.0) {
            if (to_lower > 0.0 || to_upper <= 0.0) t_exit = t_enter;
          } else {
            t_enter = std::max(t_enter, std::min(to_lower / direction[a], to_upper / direction[a]));
            t_exit = std::min(t_exit, std::max(to_lower / direction[a], to_upper / direction[a]));
          }
        }
        skipped += t_enter == t_exit;
        if (t_enter < t_exit) expected.push_back({leaf.index, t_enter, t_exit});
      });
      std::sort(expected.begin(), expected.end(),
                [](const auto& a, const auto& b) { return a.t_enter < b.t_enter; });
      ASSERT_EQ(traversed(tree, origin, direction, 0.0, 0x1p60), expected)
          << direction.transpose() << " " << far;
      visits += expected.size();
    }
  }
  EXPECT_GT(visits, 10u);
  EXPECT_GT(skipped, 2u);
}

TYPED_TEST(BeamTraversalOf, StopsWhenTheVisitorSaysSo) {
  NDTREE_SHAPE;
  Random random(24);
  int cases = 0;
  for (int round = 0; round < 15; ++round) {
    const auto tree = random_tree<N, D>(random, kUnit, 3, 25);
    const Box<D> box = tree.box(tree.root().index);
    const Vector<D> origin = random_point(random, box);
    const Vector<D> direction = random_point(random, box) - origin;
    const auto all = traversed(tree, origin, direction, 0.0, 1.0);
    for (std::size_t stop = 1; stop <= all.size() + 1; ++stop, ++cases) {
      std::vector<Crossing<D>> some;
      const bool finished = traverse_beam(tree, origin, direction, 0.0, 1.0,
                                          [&](const auto& leaf, double t_enter, double t_exit) {
                                            some.push_back({leaf.index, t_enter, t_exit});
                                            return some.size() < stop;
                                          });
      ASSERT_EQ(finished, stop > all.size());
      ASSERT_EQ(some.size(), std::min(stop, all.size()));
      ASSERT_TRUE(std::equal(some.begin(), some.end(), all.begin()));
    }
  }
  EXPECT_GT(cases, 30);
}

TYPED_TEST(BeamTraversalOf, EmptyAndBackwardRangesOfTVisitNothing) {
  NDTREE_SHAPE;
  const NdTree<N, D, int> tree(kUnit, 2);
  const Vector<D> origin = Vector<D>::Constant(0.1);
  const Vector<D> direction = Vector<D>::Constant(0.01);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const std::pair<double, double> ranges[] = {{0.0, 0.0}, {1.0, 1.0}, {1.0, 0.0}, {0.0, nan}, {0.0, -1.0}};
  for (const auto& [t_begin, t_end] : ranges)
    EXPECT_TRUE(traversed(tree, origin, direction, t_begin, t_end).empty()) << t_begin << " " << t_end;
  EXPECT_EQ(traversed(tree, origin, direction, 0.0, 1.0).size(), 1u);
}

/// Splits what it enters down to the finest level, and joins what it leaves.
template <class Tree>
struct Refiner : BeamVisitor {
  Tree& tree;
  bool merges;
  std::vector<Crossing<Tree::kDim>> crossings{};
  int left = 0;
  Refiner(Tree& tree_, bool merges_) : tree(tree_), merges(merges_) {}

  template <class Ref>
  void enter(const Ref& leaf) {
    ASSERT_TRUE(leaf.is_leaf());
    if (leaf.index.level > tree.geometry().finest_level()) tree.split(leaf, leaf.cell());
  }
  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    crossings.push_back({leaf.index, t_enter, t_exit});
    leaf.cell() = 1;
    return true;
  }
  template <class Ref>
  void leave(const Ref& parent) {
    ++left;
    if (!merges) return;
    int sum = 0;
    for (int j = 0; j < tree.kNumChildren; ++j) {
      ASSERT_TRUE(tree.child(parent, j).is_leaf()) << "an inner child was not left before its parent";
      sum += tree.child(parent, j).cell();
    }
    ASSERT_GT(sum, 0) << "left a node without having visited a child";
    tree.merge(*parent.node, 1);
  }
};

TYPED_TEST(BeamTraversalOf, HooksMaySplitWhatIsEnteredAndMergeWhatIsLeft) {
  NDTREE_SHAPE;
  Random random(25);
  NdTree<N, D, int> fine(kUnit, 2);  // Divided everywhere, for the list.
  fine.split(fine.root());
  for (int j = 0; j < fine.kNumChildren; ++j) fine.split(fine.child(fine.root(), j));
  constexpr int kEdge = N * N * kParts;
  int cases = 0;
  for (int i = 0; i < 100; ++i) {
    ExactBeam<D> beam;
    for (std::size_t a = 0; a < D; ++a) {
      beam.origin[a] = random.integer(-kParts, kEdge + kParts);
      beam.direction[a] = random.chance(0.2) ? 0 : random.integer(-kEdge, kEdge);
    }
    const auto expected = expected_crossings(fine, beam);
    NdTree<N, D, int> tree(kUnit, 2);
    Refiner<NdTree<N, D, int>> split_only(tree, false);
    ASSERT_TRUE(
        traverse_beam(tree, beam.metres(beam.origin), beam.metres(beam.direction), 0.0, 1.0, split_only));
    ASSERT_EQ(split_only.crossings, expected) << beam.text();
    ASSERT_EQ(static_cast<std::size_t>(split_only.left), tree.num_inner_nodes());
    tree.check_invariants();

    NdTree<N, D, int> folded(kUnit, 2);
    Refiner<NdTree<N, D, int>> refiner(folded, true);
    ASSERT_TRUE(
        traverse_beam(folded, beam.metres(beam.origin), beam.metres(beam.direction), 0.0, 1.0, refiner));
    ASSERT_EQ(refiner.crossings, expected) << beam.text();
    ASSERT_EQ(folded.num_nodes(), 1u);
    ASSERT_EQ(folded.root().cell(), expected.empty() ? 0 : 1);
    folded.check_invariants();
    cases += !expected.empty();
  }
  EXPECT_GT(cases, 20);
}

}  // namespace
}  // namespace ndtree::test::test_beam_traversal
