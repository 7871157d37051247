// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/tree/nd_tree.hpp"
#include "ndtree/tree/visit.hpp"
#include "random.hpp"
#include "refusals.hpp"
#include "shapes.hpp"
#include "trees.hpp"

namespace ndtree::test::test_nd_tree {
namespace {

/// The same partition as a plain map from cell to value, searched one by one.
template <int N, int D>
struct Model {
  double unit;
  int finest_level;
  CellIndex<D> root;
  LeafMap<D, int> leaves;

  Model(double unit_, int num_levels) : unit(unit_), finest_level(-num_levels) { leaves[root] = 0; }

  [[nodiscard]] std::int64_t edge(int level) const { return edge_above<N>(finest_level, level); }
  [[nodiscard]] std::vector<CellIndex<D>> children(const CellIndex<D>& parent) const {
    return children_of<N, D>(parent, edge(parent.level - 1));
  }
  [[nodiscard]] bool encloses(const CellIndex<D>& cell, const Vector<D>& point) const {
    for (std::size_t a = 0; a < D; ++a) {
      const double x = point[static_cast<int>(a)];
      if (!(x >= unit * static_cast<double>(cell.lower[a]))) return false;
      if (!(x < unit * static_cast<double>(cell.lower[a] + edge(cell.level)))) return false;
    }
    return true;
  }
  [[nodiscard]] std::optional<std::pair<CellIndex<D>, int>> find(const Vector<D>& point) const {
    for (const auto& [index, value] : leaves)
      if (encloses(index, point)) return std::make_pair(index, value);
    return std::nullopt;
  }
  void split(const CellIndex<D>& leaf, int value) {
    leaves.erase(leaf);
    for (const auto& child : children(leaf)) leaves[child] = value;
  }
  void merge(const CellIndex<D>& parent, int value) {
    for (const auto& child : children(parent)) leaves.erase(child);
    leaves[parent] = value;
  }
  [[nodiscard]] bool all_children_are_leaves(const CellIndex<D>& parent) const {
    for (const auto& child : children(parent))
      if (leaves.count(child) == 0) return false;
    return true;
  }
  [[nodiscard]] bool covers(const CellIndex<D>& outer, const CellIndex<D>& inner) const {
    for (std::size_t a = 0; a < D; ++a)
      if (inner.lower[a] < outer.lower[a] ||
          inner.lower[a] + edge(inner.level) > outer.lower[a] + edge(outer.level))
        return false;
    return true;
  }
  /// Fills the new root around the old one: on each level, the siblings of what holds the old root.
  void grow(const CellIndex<D>& new_root) {
    CellIndex<D> around = new_root;
    while (around.level > root.level) {
      std::optional<CellIndex<D>> next;
      for (const auto& child : children(around)) {
        if (covers(child, root)) {
          ASSERT_FALSE(next.has_value());
          next = child;
        } else {
          leaves[child] = 0;
        }
      }
      ASSERT_TRUE(next.has_value()) << "no child of the new root holds the old one";
      around = *next;
    }
    ASSERT_EQ(around, root);
    root = new_root;
  }
};

template <class S>
class NdTreeOf : public ::testing::Test {};
TYPED_TEST_SUITE(NdTreeOf, Shapes, ShapeNames);

TYPED_TEST(NdTreeOf, RandomOperationsAgreeWithAPlainMapOfCells) {
  NDTREE_SHAPE;
  Random random(5);
  int splits = 0;
  int merges = 0;
  int grown = 0;
  int searches = 0;
  for (int round = 0; round < 8; ++round) {
    const double unit = round % 2 == 0 ? 0.25 : 0.05;
    NdTree<N, D, int> tree(unit, 2);
    Model<N, D> model(unit, 2);
    for (int step = 1; step <= 60; ++step) {
      const int action = random.integer(0, 9);
      if (action < 5) {
        const auto leaf = random_leaf(tree, random);
        if (leaf.index.level == tree.geometry().finest_level()) continue;
        model.split(leaf.index, step);
        tree.split(leaf, step);
        ++splits;
      } else if (action < 8) {
        auto parent = tree.root();  // A walk to a random inner node.
        if (parent.is_leaf()) continue;
        while (random.chance(0.8)) {
          const auto next = tree.child(parent, random.integer(0, tree.kNumChildren - 1));
          if (next.is_leaf()) break;
          parent = next;
        }
        if (!model.all_children_are_leaves(parent.index)) continue;
        model.merge(parent.index, step);
        tree.merge(*parent.node, step);
        ++merges;
      } else if (action == 8) {
        const auto leaf = random_leaf(tree, random);
        leaf.cell() = step;
        model.leaves[leaf.index] = step;
      } else if (model.root.level < 3) {
        const Vector<D> point = random_point(random, widened(tree.box(model.root), 0.6));
        const bool grows = !model.encloses(model.root, point);
        tree.grow_to_contain(point);
        grown += grows;
        ASSERT_EQ(tree.root().index.level > model.root.level, grows);
        ASSERT_TRUE(model.covers(tree.root().index, model.root));
        for (const auto& child :
             model.children(tree.root().index))  // It stopped as soon as the point fitted.
          ASSERT_TRUE(!grows || !model.covers(child, model.root) || !model.encloses(child, point));
        model.grow(tree.root().index);
        ASSERT_TRUE(model.encloses(model.root, point));
      }
      ASSERT_NO_THROW(tree.check_invariants()) << "step " << step;
      ASSERT_EQ(leaves_of(tree), model.leaves) << "step " << step;
      ASSERT_EQ(tree.num_leaves(), model.leaves.size());
      ASSERT_EQ(tree.num_nodes(), tree.num_leaves() + tree.num_inner_nodes());
    }
    std::vector<Vector<D>> points;
    for (int i = 0; i < 100; ++i) points.push_back(random_point(random, widened(tree.box(model.root), 0.1)));
    for (const auto& [index, value] : model.leaves) {  // Corners belong to the cell above them.
      points.push_back(tree.box(index).lower);
      points.push_back(tree.box(index).upper);
    }
    if (points.size() > 400) points.resize(400);
    for (const Vector<D>& point : points) {
      const auto expected = model.find(point);
      const auto found = std::as_const(tree).find_leaf(point);
      ASSERT_EQ(found.has_value(), expected.has_value()) << point.transpose();
      ++searches;
      if (!found) continue;
      ASSERT_EQ(found->index, expected->first);
      ASSERT_EQ(found->cell(), expected->second);
      ASSERT_EQ(tree.find_leaf(point)->node, found->node);
      ASSERT_EQ(std::as_const(tree).find_leaf(tree.geometry().coordinates(point))->node, found->node);
    }
  }
  EXPECT_GT(splits, 50);
  EXPECT_GT(merges, 5);
  EXPECT_GT(grown, 5);
  EXPECT_GT(searches, 600);
}

TYPED_TEST(NdTreeOf, SplitThenMergeIsIdentity) {
  NDTREE_SHAPE;
  Random random(6);
  int cases = 0;
  for (int round = 0; round < 60; ++round) {
    auto tree = random_tree<N, D>(random, 0.1, 3, 15);
    const auto before = leaves_of(tree);
    for (int i = 0; i < 10; ++i) {
      const auto leaf = random_leaf(tree, random);
      if (leaf.index.level == tree.geometry().finest_level()) continue;
      const int value = leaf.cell();
      tree.split(leaf, value);  // The argument is the split cell itself.
      for (int j = 0; j < tree.kNumChildren; ++j) ASSERT_EQ(tree.child(leaf, j).cell(), value);
      const std::size_t bytes = tree.memory_bytes();
      tree.merge(*leaf.node, tree.child(leaf, 1).cell());  // And here a child that disappears.
      ASSERT_EQ(leaves_of(tree), before);
      tree.split(leaf);
      for (int j = 0; j < tree.kNumChildren; ++j) ASSERT_EQ(tree.child(leaf, j).cell(), 0);
      tree.merge(*leaf.node, value);
      ASSERT_EQ(leaves_of(tree), before);
      ASSERT_EQ(tree.memory_bytes(), bytes);
      ++cases;
    }
    tree.check_invariants();
  }
  EXPECT_GT(cases, 50);
}

TYPED_TEST(NdTreeOf, WholeReachFitsInAnyOrderOfGrowth) {
  NDTREE_SHAPE;
  Random random(8);
  for (int round = 0; round < 300; ++round) {
    NdTree<N, D, int> tree(0.01, random.integer(0, 3));
    const double reach = tree.geometry().reach();
    for (int i = 0; i < 12; ++i) {
      Vector<D> point;
      for (int a = 0; a < D; ++a) {
        const double size = random.chance(0.3) ? reach : reach * std::exp2(random.uniform(-8.0, 0.0));
        point[a] = random.chance(0.3) ? random.uniform(-1.0, 1.0) : random.chance(0.5) ? size : -size;
      }
      tree.grow_to_contain(point);
      ASSERT_TRUE(tree.find_leaf(point).has_value());
      ASSERT_LE(tree.root().index.level, tree.geometry().coarsest_level());
      ASSERT_TRUE(tree.find_leaf(Vector<D>::Zero().eval()).has_value());
    }
    for (const double sign : {-1.0, 1.0}) {
      tree.grow_to_contain(Vector<D>::Constant(sign * reach));
      ASSERT_TRUE(tree.find_leaf(Vector<D>::Constant(sign * reach).eval()).has_value());
    }
    ASSERT_LE(tree.root().index.level, tree.geometry().coarsest_level());
    tree.check_invariants();
  }
}

TYPED_TEST(NdTreeOf, PointsOutOfReachAreRefusedAndNothingChanges) {
  NDTREE_SHAPE;
  Random random(10);
  auto tree = random_tree<N, D>(random, 0.05, 2, 10);
  const auto before = leaves_of(tree);
  const auto root = tree.root().index;
  const double nan = std::numeric_limits<double>::quiet_NaN();
  const double infinity = std::numeric_limits<double>::infinity();
  const double beyond = std::nextafter(tree.geometry().reach(), infinity);
  for (const double bad : {nan, infinity, -infinity, beyond, -beyond, 1e300})
    for (int a = 0; a < D; ++a) {
      Vector<D> point = Vector<D>::Zero();
      point[a] = bad;
      EXPECT_FALSE(tree.find_leaf(point).has_value());
      expect_refused([&] { tree.grow_to_contain(point); }, "0.05");
      EXPECT_EQ(tree.root().index, root);
      EXPECT_EQ(leaves_of(tree), before);
    }
}

TYPED_TEST(NdTreeOf, ResetTakesOnlyRootsThatGrowthLeadsTo) {
  NDTREE_SHAPE;
  Random random(12);
  for (int i = 0; i < 50; ++i) {
    NdTree<N, D, int> grown(0.1, 2);
    grown.grow_to_contain(random_point<D>(random, {Vector<D>::Constant(-1e5), Vector<D>::Constant(1e5)}));
    NdTree<N, D, int> tree(0.1, 2);
    tree.split(tree.root());
    tree.reset(grown.root().index);
    ASSERT_EQ(tree.root().index, grown.root().index);
    ASSERT_EQ(tree.num_nodes(), 1u);
    tree.check_invariants();
  }

  NdTree<N, D, int> tree(0.1, 2);
  const std::int64_t first = N * N;  // Edge of the first root.
  CellIndex<D> off_the_grid{{}, 0};
  off_the_grid.lower[D - 1] = 1;
  CellIndex<D> beside_zero{{}, 0};
  beside_zero.lower[D - 1] = first;
  CellIndex<D> below_zero{{}, 1};
  below_zero.lower[0] = -first * N;
  CellIndex<D> too_fine{{}, -1};
  CellIndex<D> too_coarse{{}, tree.geometry().coarsest_level() + 1};
  for (const auto& root : {off_the_grid, beside_zero, below_zero, too_fine, too_coarse})
    EXPECT_THROW(tree.reset(root), std::invalid_argument) << root.level << " " << root.lower[0];
  EXPECT_EQ(tree.root().index, CellIndex<D>{});
}

TYPED_TEST(NdTreeOf, VisitsEveryNodeOnceParentsFirstChildrenByNumber) {
  NDTREE_SHAPE;
  Random random(13);
  auto tree = random_tree<N, D>(random, 0.05, 3, 30);
  std::set<std::pair<int, Lattice<D>>> seen;
  std::size_t inner = 0;
  for_each_node(tree, [&](const auto& ref) {
    ASSERT_TRUE(seen.emplace(ref.index.level, ref.index.lower).second);
    inner += !ref.is_leaf();
    if (ref.index == tree.root().index) return;
    const std::int64_t edge = tree.geometry().edge(ref.index.level + 1);
    Lattice<D> parent = ref.index.lower;  // The root's corner is a multiple of no larger edge than the first.
    for (std::size_t a = 0; a < D; ++a) parent[a] -= (parent[a] - tree.root().index.lower[a]) % edge;
    ASSERT_EQ(seen.count({ref.index.level + 1, parent}), 1u) << "a child came before its parent";
  });
  EXPECT_EQ(seen.size(), tree.num_nodes());
  EXPECT_EQ(inner, tree.num_inner_nodes());
  int next = 0;  // random_tree() numbered the leaves in this order.
  for_each_leaf(std::as_const(tree), [&](const auto& leaf) { EXPECT_EQ(leaf.cell(), next++); });
  EXPECT_EQ(static_cast<std::size_t>(next), tree.num_leaves());
  // Siblings come in the order of their numbers.
  NdTree<N, D, int> flat(0.05, 1);
  flat.split(flat.root());
  int number = 0;
  for_each_leaf(flat, [&](const auto& leaf) {
    EXPECT_EQ(leaf.node, flat.child(flat.root(), number).node);
    EXPECT_EQ(leaf.node, flat.child(flat.root(), child_offset<N, D>(number)).node);
    EXPECT_EQ(leaf.node, flat.children(*flat.root().node) + number++);
  });
  EXPECT_EQ(number, flat.kNumChildren);
}

TYPED_TEST(NdTreeOf, LeavesInABoxAreThoseThatTouchIt) {
  NDTREE_SHAPE;
  Random random(14);
  int stopped = 0;
  for (int round = 0; round < 8; ++round) {
    const auto tree = random_tree<N, D>(random, 0.25, 3, 25);
    const Box<D> around = widened(tree.box(tree.root().index), 0.3);
    for (int i = 0; i < 40; ++i) {
      Vector<D> p = random_point(random, around);
      Vector<D> q = random_point(random, around);
      if (i % 2 == 0) {  // On borders of cells, to the last bit.
        p = (p * 4.0).array().floor() / 4.0;
        q = (q * 4.0).array().floor() / 4.0;
      }
      if (i % 5 == 0) q = p;  // One point.
      const Box<D> box{p.cwiseMin(q), p.cwiseMax(q)};
      std::set<int> expected;
      for_each_leaf(tree, [&](const auto& leaf) {
        bool touches = true;
        const Box<D> cell = tree.box(leaf.index);
        for (int a = 0; a < D; ++a)
          touches = touches && cell.lower[a] <= box.upper[a] && box.lower[a] <= cell.upper[a];
        if (touches) expected.insert(leaf.cell());
      });
      std::set<int> visited;
      EXPECT_TRUE(for_each_leaf_in(
          tree, box, [&](const auto& leaf) { EXPECT_TRUE(visited.insert(leaf.cell()).second); }));
      ASSERT_EQ(visited, expected);
      if (expected.size() < 2) continue;
      std::size_t calls = 0;
      EXPECT_FALSE(for_each_leaf_in(tree, box, [&](const auto&) -> bool { return ++calls < 2; }));
      EXPECT_EQ(calls, 2u);
      ++stopped;
    }
  }
  EXPECT_GT(stopped, 40);
}

TEST(NdTree, BrokenInvariantsAreNamed) {
  NdTree<2, 2, int> tree(0.1, 1);
  tree.split(tree.root());
  tree.split(tree.child(tree.root(), 0));  // Below the finest level.
  expect_refused<std::logic_error>([&] { tree.check_invariants(); }, "level -1");
  NdTree<2, 2, int> lost(0.1, 2);
  lost.split(lost.root());
  lost.split(lost.child(lost.root(), 0));
  lost.merge(*lost.root().node, 0);  // A block of grandchildren belongs to no node now.
  expect_refused<std::logic_error>([&] { lost.check_invariants(); }, "1 blocks");
}

TEST(NdTree, GrowsTowardsThePointThatMustFit) {
  struct Row {
    double x, y;
    Lattice<2> lower;
    int level;
  };
  const Row rows[] = {
      {1.5, 0.5, {0, -4}, 1}, {-0.5, 0.5, {-4, -4}, 1},  {0.5, -0.5, {-4, -4}, 1},   {0.5, 1.0, {-4, 0}, 1},
      {1.0, 1.0, {0, 0}, 1},  {-1.0, -1.0, {-4, -4}, 1}, {-1.25, 1.0, {-12, -8}, 2}, {0.999, 0.0, {0, 0}, 0},
  };
  for (const Row& row : rows) {
    NdTree<2, 2, int> tree(0.25, 2);  // The first root is [0, 1) x [0, 1).
    tree.grow_to_contain({row.x, row.y});
    EXPECT_EQ(tree.root().index.level, row.level) << row.x << " " << row.y;
    EXPECT_EQ(tree.root().index.lower, row.lower) << row.x << " " << row.y;
  }
}

TEST(NdTree, GivesMemoryBackThatMergingHasFreed) {
  NdTree<2, 2, OccupancyCell> tree(0.25, 8);
  std::vector<NdTree<2, 2, OccupancyCell>::Ref> divided{tree.root()};
  for (std::size_t i = 0; i < divided.size(); ++i) {
    const auto parent = divided[i];
    tree.split(parent);
    if (divided.size() < 20000)
      for (int j = 0; j < 4; ++j) divided.push_back(tree.child(parent, j));
  }
  OccupancyCell cell;
  cell.update(1.0f, -2.0f, 2.0f);
  const std::size_t full = tree.memory_bytes();
  tree.shrink_if_half_empty();
  ASSERT_EQ(tree.memory_bytes(), full) << "all of it is used";
  for (std::size_t i = divided.size(); i-- > divided.size() / 3;) tree.merge(*divided[i].node, cell);
  ASSERT_EQ(tree.memory_bytes(), full) << "until it is asked to";
  const std::size_t leaves = tree.num_leaves();
  tree.shrink_if_half_empty();
  EXPECT_LT(tree.memory_bytes(), full / 2);
  EXPECT_GT(tree.memory_bytes(), full / 4);
  EXPECT_EQ(tree.num_leaves(), leaves);
  tree.check_invariants();
  std::size_t occupied = 0;
  for_each_leaf(tree, [&](const auto& leaf) { occupied += leaf.cell() == cell; });
  EXPECT_GT(occupied, 1000u);
}

}  // namespace
}  // namespace ndtree::test::test_nd_tree
