// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Random trees, and the plain list of a tree's leaves that oracles search one by one.
#pragma once

#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/tree/nd_tree.hpp"
#include "ndtree/tree/visit.hpp"
#include "random.hpp"

namespace ndtree::test {

struct IndexLess {
  template <int D>
  bool operator()(const CellIndex<D>& a, const CellIndex<D>& b) const {
    return a.level != b.level ? a.level < b.level : a.lower < b.lower;
  }
};

/// What the leaves of a tree hold, by index.
template <int D, class Cell>
using LeafMap = std::map<CellIndex<D>, Cell, IndexLess>;

template <class Tree>
LeafMap<Tree::kDim, typename Tree::Cell> leaves_of(const Tree& tree) {
  LeafMap<Tree::kDim, typename Tree::Cell> leaves;
  for_each_leaf(tree, [&](const auto& leaf) { leaves.emplace(leaf.index, leaf.cell()); });
  return leaves;
}

/// Every combination of positions [first, last) on each axis, counted in edges from the one cell.
template <int D>
std::vector<CellIndex<D>> cells_within(const CellIndex<D>& at, std::int64_t edge, int first, int last) {
  std::vector<CellIndex<D>> result{at};
  for (std::size_t a = D; a-- > 0;) {  // The first axis varies fastest.
    std::vector<CellIndex<D>> longer;
    for (const CellIndex<D>& begun : result)
      for (int i = first; i < last; ++i) {
        longer.push_back(begun);
        longer.back().lower[a] += i * edge;
      }
    result = std::move(longer);
  }
  return result;
}

/// The children's indices, spelled out.
template <int N, int D>
std::vector<CellIndex<D>> children_of(const CellIndex<D>& parent, std::int64_t child_edge) {
  return cells_within(CellIndex<D>{parent.lower, parent.level - 1}, child_edge, 0, N);
}

/// N to the power of the level's height over the finest: the edge of a cell in lattice units.
template <int N>
std::int64_t edge_above(int finest_level, int level) {
  std::int64_t edge = 1;
  for (; level > finest_level; --level) edge *= N;
  return edge;
}

/// A random walk from the root down to a leaf.
template <class Tree>
typename Tree::Ref random_leaf(Tree& tree, Random& random) {
  auto ref = tree.root();
  while (!ref.is_leaf()) ref = tree.child(ref, random.integer(0, Tree::kNumChildren - 1));
  return ref;
}

/// A tree whose leaves are numbered from 0 in their order.
template <int N, int D>
NdTree<N, D, int> random_tree(Random& random, double unit, int num_levels, int splits) {
  NdTree<N, D, int> tree(unit, num_levels);
  const double size = tree.geometry().cell_size(0);
  Vector<D> far;
  for (int a = 0; a < D; ++a) far[a] = random.uniform(-size, 2.0 * size);
  if (random.chance(0.5)) tree.grow_to_contain(far);
  for (int i = 0; i < splits; ++i) {
    const auto leaf = random_leaf(tree, random);
    if (leaf.index.level > tree.geometry().finest_level()) tree.split(leaf);
  }
  int number = 0;
  for_each_leaf(tree, [&](const auto& leaf) { leaf.cell() = number++; });
  return tree;
}

template <int D>
Vector<D> random_point(Random& random, const Box<D>& box) {
  Vector<D> point;
  for (int a = 0; a < D; ++a) point[a] = random.uniform(box.lower[a], box.upper[a]);
  return point;
}

/// The box, wider on each side by `share` of its edge.
template <int D>
Box<D> widened(const Box<D>& box, double share) {
  const Vector<D> margin = share * (box.upper - box.lower);
  return {box.lower - margin, box.upper + margin};
}

}  // namespace ndtree::test
