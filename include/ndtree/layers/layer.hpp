// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Values beside a map's cells, in a tree of their own: a map without layers does not depend on them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/inline.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/adopt.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree {

/// How much of a cell a map has observed.
enum class KnownPart { none, some, all };

namespace detail {

template <class MapTree, class Ref>
[[nodiscard]] NDTREE_NEVER_INLINE KnownPart known_part_below(const MapTree& map_tree, const Ref& ref) {
  if (ref.is_leaf()) return ref.cell().observed() ? KnownPart::all : KnownPart::none;
  const KnownPart first = known_part_below(map_tree, map_tree.child(ref, 0));
  for (int j = 1; first != KnownPart::some && j < MapTree::kNumChildren; ++j)
    if (known_part_below(map_tree, map_tree.child(ref, j)) != first) return KnownPart::some;
  return first;
}

}  // namespace detail

/// How much of a cell a map has observed. @param map_tree of the map. O(leaves in the cell).
template <class MapTree, int D>
[[nodiscard]] KnownPart known_part(const MapTree& map_tree, const CellIndex<D>& cell) {
  typename MapTree::ConstRef ref = map_tree.root();
  if (!map_tree.geometry().contains(ref.index, cell.lower)) return KnownPart::none;
  while (!ref.is_leaf() && ref.index.level > cell.level) ref = map_tree.child_towards(ref, cell.lower);
  return detail::known_part_below(map_tree, ref);
}

/// A value for each cell in which beams end, such as a colour, a label, or a time. Values follow the cells of
/// a map: where that has split a cell, its parts have what the rule of the value makes of it, and where it
/// has merged some, they are joined by the rule. That is done when a cell is next asked for or added to, so
/// that splitting and merging cost a map nothing.
/// @tparam Value what a cell carries, see values.hpp.
template <int N, int D, class Value>
class Layer {
 public:
  static constexpr int kBranching = N;
  static constexpr int kDim = D;
  using Geometry = LatticeGeometry<N, D>;
  /// A node's value, of a leaf.
  struct Cell {
    static constexpr int kNumWords = Value::kNumWords;
    Value value;

    [[nodiscard]] auto words() const { return value.words(); }
    [[nodiscard]] static Cell from_words(const std::array<std::uint32_t, std::size_t{kNumWords}>& words) {
      return {Value::from_words(words)};
    }
  };
  using ValueType = Value;
  using Measurement = typename Value::Measurement;
  using Tree = NdTree<N, D, Cell>;

  /// Without any value. @param geometry of the map.
  explicit Layer(const Geometry& geometry) : tree_(geometry.unit(), -geometry.finest_level()) {}

  /// A cell's value; empty if it has none. O(depth, and values in it).
  /// @param cell a leaf of the map, of level 0 or below.
  [[nodiscard]] Value of(const CellIndex<D>& cell) const {
    typename Tree::ConstRef ref = tree_.root();
    if (!tree_.geometry().contains(ref.index, cell.lower)) return {};
    while (!ref.is_leaf() && ref.index.level > cell.level) ref = tree_.child_towards(ref, cell.lower);
    if (!ref.is_leaf()) return joined(*ref.node);
    Value value = ref.cell().value;
    for (int level = ref.index.level; level > cell.level; --level) value = value.part(Tree::kNumChildren);
    return value;
  }

  /// Adds a beam's measurement to a cell.
  /// @param point in the cell [m]. @pre the measurement is one that Value::check() accepts.
  void add(const CellIndex<D>& cell, const Vector<D>& point, const Measurement& measurement) {
    reach(cell, point).value.add(measurement);
  }
  /// Adds another value to a cell. @param point as in add().
  void join(const CellIndex<D>& cell, const Vector<D>& point, const Value& value) {
    reach(cell, point).value.join(value);
  }
  /// Adds the values of another layer to the cells of a map. @param map_tree of the map.
  template <class MapTree>
  void join(const Layer& other, const MapTree& map_tree) {
    other.for_each([&](const CellIndex<D>& cell, const Vector<D>& centre, const Value& value) {
      join_below(cell, centre, value, map_tree);
    });
  }

  /// Makes room for all points of a box [m]; for none if it is empty. What the root becomes depends on the
  /// box alone, and on what it was.
  void grow_to(const Box<D>& box) {
    if (!(box.lower.array() <= box.upper.array()).all()) return;
    tree_.grow_to_contain(box.lower);
    tree_.grow_to_contain(box.upper);
  }
  /// A layer whose root has grown as this one's, without any value.
  [[nodiscard]] Layer emptied() const {
    Layer empty(tree_.geometry());
    empty.tree_ = tree_.emptied();
    return empty;
  }
  /// Copies values in cubes of max_cell_size in which this layer has none, bit for bit, as
  /// OccupancyMap::adopt(). @param is_wanted see detail::for_each_cube(). @param max_memory bytes that the
  /// layer may hold. @throws MemoryLimitReached, std::bad_alloc, Cancelled; some may be copied then.
  template <class IsWanted>
  void adopt(const Layer& other, const IsWanted& is_wanted, std::size_t max_memory) {
    limit_memory(max_memory);
    const auto is_blank = [](const Cell& cell) { return cell.value.is_empty(); };
    detail::Adopting(tree_, 0, is_blank).run(other.tree_, is_wanted);
    limit_memory(kUnlimitedMemory);
  }

  /// Forgets the values of what is unknown in a map where it may have changed. O(nodes of the layer there).
  /// @param may_differ of a box: whether the map may have forgotten something in it.
  template <class MapTree, class MayDiffer>
  void keep_known(const MapTree& map_tree, const MayDiffer& may_differ) {
    Pace pace;
    keep_known(tree_.root(), map_tree, may_differ, pace);
    tree_.shrink_if_half_empty();
  }

  /// Calls `visit(cell, centre, value)` for each value, which is of a cell of the map or of a part of one, or
  /// of what was one.
  template <class Visit>
  void for_each(const Visit& visit) const {
    Pace pace;
    for_each_below(tree_.root(), visit, pace);
  }

  [[nodiscard]] const Tree& tree() const { return tree_; }
  [[nodiscard]] Tree& tree() { return tree_; }
  [[nodiscard]] std::size_t memory_bytes() const { return tree_.memory_bytes(); }
  /// Bytes that it may hold from now on; else MemoryLimitReached is thrown.
  void limit_memory(std::size_t bytes) { tree_.limit_memory(bytes); }

 private:
  using Ref = typename Tree::Ref;
  using ConstRef = typename Tree::ConstRef;
  using NodeType = typename Tree::NodeType;

  /// The cell's own place in the tree.
  [[nodiscard]] Cell& reach(const CellIndex<D>& cell, const Vector<D>& point) {
    tree_.grow_to_contain(point);
    Ref ref = tree_.root();
    while (ref.index.level > cell.level) {
      if (ref.is_leaf()) {
        const Cell part{ref.cell().value.is_empty() ? Value{} : ref.cell().value.part(Tree::kNumChildren)};
        tree_.split(ref, part);
      }
      ref = tree_.child_towards(ref, cell.lower);
    }
    if (!ref.is_leaf()) tree_.cut(*ref.node, Cell{joined(*ref.node)});
    return ref.cell();
  }
  [[nodiscard]] Value joined(const NodeType& node) const {
    if (node.is_leaf()) return node.cell().value;
    Value value;
    const NodeType* const children = tree_.children(node);
    for (int j = 0; j < Tree::kNumChildren; ++j) value.join(joined(children[j]));
    return value;
  }
  template <class MapTree>
  void join_below(const CellIndex<D>& cell, const Vector<D>& centre, const Value& value,
                  const MapTree& map_tree) {
    const auto leaf = map_tree.find_leaf(centre);
    if (!leaf) return;
    if (leaf->index.level >= cell.level) {
      if (leaf->cell().observed()) join(leaf->index, centre, value);
      return;
    }
    const Value part = value.part(Tree::kNumChildren);
    if (part.is_empty()) return;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const CellIndex<D> child = tree_.geometry().child(cell, child_offset<N, D>(j));
      join_below(child, centre_of(child), part, map_tree);
    }
  }
  template <class MapTree, class MayDiffer>
  void keep_known(const Ref& ref, const MapTree& map_tree, const MayDiffer& may_differ, Pace& pace) {
    if (ref.is_leaf() && ref.cell().value.is_empty()) return;
    // What is not changed stays shared.
    if (all_observed(ConstRef{ref.node, ref.index}, map_tree, may_differ, pace)) return;
    if (ref.index.level <= 0) {
      const KnownPart known = known_part(map_tree, ref.index);
      if (known == KnownPart::none) tree_.cut(*ref.node);
      if (known != KnownPart::some) return;
      if (ref.is_leaf()) {
        const Cell part{ref.cell().value.part(Tree::kNumChildren)};
        tree_.split(ref, part);
      }
    }
    bool all_empty = true;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Ref child = tree_.child(ref, j);
      keep_known(child, map_tree, may_differ, pace);
      all_empty = all_empty && child.is_leaf() && child.cell().value.is_empty();
    }
    if (all_empty) tree_.cut(*ref.node);
  }
  /// Whether a map has observed all cells that have a value.
  template <class MapTree, class MayDiffer>
  [[nodiscard]] bool all_observed(const ConstRef& ref, const MapTree& map_tree, const MayDiffer& may_differ,
                                  Pace& pace) const {
    pace.spend();
    if (ref.is_leaf() && ref.cell().value.is_empty()) return true;
    if (!may_differ(tree_.box(ref.index))) return true;
    if (ref.index.level <= 0) {
      const KnownPart known = known_part(map_tree, ref.index);
      if (known != KnownPart::some || ref.is_leaf()) return known == KnownPart::all;
    }
    for (int j = 0; j < Tree::kNumChildren; ++j)
      if (!all_observed(tree_.child(ref, j), map_tree, may_differ, pace)) return false;
    return true;
  }
  template <class Visit>
  NDTREE_NEVER_INLINE void for_each_below(const ConstRef& ref, const Visit& visit, Pace& pace) const {
    pace.spend();
    if (!ref.is_leaf()) {
      for (int j = 0; j < Tree::kNumChildren; ++j) for_each_below(tree_.child(ref, j), visit, pace);
    } else if (!ref.cell().value.is_empty()) {
      visit(ref.index, centre_of(ref.index), ref.cell().value);
    }
  }
  [[nodiscard]] Vector<D> centre_of(const CellIndex<D>& cell) const {
    const Box<D> box = tree_.box(cell);
    return 0.5 * (box.lower + box.upper);
  }

  Tree tree_;
};

}  // namespace ndtree
