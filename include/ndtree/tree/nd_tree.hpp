// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The N^d-tree: a cube of D dimensions, recursively divided into N^D children (Sec. II).
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <new>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/node_pool.hpp"

namespace ndtree {

/// A node and the region that it stands for. The pointer holds until the node's parent is merged or the tree
/// is grown, moved or destroyed; splitting other nodes does not disturb it.
template <class NodeType, int D>
struct NodeRef {
  NodeType* node = nullptr;
  CellIndex<D> index;

  [[nodiscard]] bool is_leaf() const { return node->is_leaf(); }
  [[nodiscard]] auto& cell() const { return node->cell(); }
};

/// Tree of cells of any type: geometry and structure. The meaning of a cell is up to its users.
/// Copies share what neither of them has changed since: a copy takes O(nodes / hundreds), and what a part of
/// the tree needs once more is allocated when it is first accessed to be changed, that is, through a tree
/// that is not const. Invariants, tested by check_invariants(): an inner node has exactly N^D children, every
/// block of the pool but the root's belongs to one inner node, children tile their parent, no node lies below
/// the finest level.
template <int N, int D, class CellType>
class NdTree {
  static_assert(N >= 2 && D >= 1, "a node has N >= 2 children along each of D >= 1 axes");
  static_assert(integer_power(N, D) <= 4096, "at most 4096 children a node");

 public:
  static constexpr int kBranching = N;
  static constexpr int kDim = D;
  static constexpr int kNumChildren = static_cast<int>(integer_power(N, D));
  using Cell = CellType;
  using NodeType = Node<Cell>;
  using Ref = NodeRef<NodeType, D>;
  using ConstRef = NodeRef<const NodeType, D>;
  using Arena = typename NodePool<NodeType, kNumChildren>::Arena;

  /// One root, a leaf of level 0, with its lower corner at 0.
  /// @param min_cell_size edge of the smallest cell [m]. @param num_levels levels from it up to level 0.
  NdTree(double min_cell_size, int num_levels) : geometry_(min_cell_size, num_levels) { pool_.allocate(); }

  NdTree(const NdTree&) = default;
  NdTree(NdTree&&) = default;
  NdTree& operator=(const NdTree& other) { return *this = NdTree(other); }  // Lack of memory changes nothing.
  NdTree& operator=(NdTree&&) = default;
  ~NdTree() = default;

  [[nodiscard]] const LatticeGeometry<N, D>& geometry() const { return geometry_; }
  [[nodiscard]] Box<D> box(const CellIndex<D>& index) const { return geometry_.box(index); }

  [[nodiscard]] Ref root() { return {pool_.block(kRootBlock), root_index_}; }
  [[nodiscard]] ConstRef root() const { return {pool_.block(kRootBlock), root_index_}; }

  /// Child of an inner node by number, or by Euclidean offset (Sec. II-A).
  [[nodiscard]] Ref child(const Ref& parent, int number) { return child_of<Ref>(*this, parent, number); }
  [[nodiscard]] ConstRef child(const ConstRef& parent, int number) const {
    return child_of<ConstRef>(*this, parent, number);
  }
  [[nodiscard]] Ref child(const Ref& parent, const Offset<D>& offset) {
    return child(parent, child_number<N, D>(offset));
  }
  [[nodiscard]] ConstRef child(const ConstRef& parent, const Offset<D>& offset) const {
    return child(parent, child_number<N, D>(offset));
  }
  /// The child of an inner node that contains a smallest cell, which the node contains.
  [[nodiscard]] Ref child_towards(const Ref& parent, const Lattice<D>& coordinates) {
    return child_towards<Ref>(*this, parent, coordinates);
  }
  [[nodiscard]] ConstRef child_towards(const ConstRef& parent, const Lattice<D>& coordinates) const {
    return child_towards<ConstRef>(*this, parent, coordinates);
  }
  /// First of the N^D siblings below an inner node.
  [[nodiscard]] NDTREE_ALWAYS_INLINE NodeType* children(const NodeType& parent) {
    return pool_.block(parent.children());
  }
  [[nodiscard]] const NodeType* children(const NodeType& parent) const {
    return pool_.block(parent.children());
  }

  /// Whether nothing can have changed below an inner node of this tree, and one of another whose children
  /// have the same number: neither was accessed to be changed since one tree was copied from the other.
  [[nodiscard]] bool shares_children(const NodeType& parent, const NdTree& other,
                                     const NodeType& others_parent) const {
    return parent.children() == others_parent.children() && pool_.shares(parent.children(), other.pool_);
  }
  /// Whether changes may need memory for what is shared with a copy.
  [[nodiscard]] bool is_shared() { return pool_.is_shared(); }

  /// The leaf that contains a point, or none outside the root. O(depth).
  [[nodiscard]] std::optional<Ref> find_leaf(const Vector<D>& point) { return find<Ref>(*this, point); }
  [[nodiscard]] std::optional<ConstRef> find_leaf(const Vector<D>& point) const {
    return find<ConstRef>(*this, point);
  }
  [[nodiscard]] std::optional<ConstRef> find_leaf(const Lattice<D>& coordinates) const {
    return find_at<ConstRef>(*this, coordinates);
  }

  /// Which child along an axis lies so far from its parent's lower corner: offset / edge, known to be less
  /// than N. A division takes longer than some comparisons.
  [[nodiscard]] static std::int64_t child_place(std::int64_t offset, std::int64_t edge) {
    if constexpr (N > 8) return offset / edge;
    std::int64_t i = 0;
    for (std::int64_t border = edge, m = 1; m < N; ++m, border += edge) i += offset >= border;
    return i;
  }

  /// A leaf becomes an inner node; all children start as `cell` (Sec. II-B).
  /// @pre the node is a leaf above the finest level.
  void split(const Ref& leaf, const Cell& cell = Cell{}) { split_node(*leaf.node, cell); }

  /// Splits a leaf whose region the caller knows. Whether that is a split or a division (glossary) the caller
  /// knows, too.
  void split_node(NodeType& leaf, const Cell& cell = Cell{}) { split_node(leaf, cell, pool_.main_arena()); }
  /// Splits a leaf in one of several threads, with an arena of its own.
  void split_node(NodeType& leaf, const Cell& cell, Arena& arena) {
    const BlockId block = pool_.allocate(arena);
    NodeType* children = pool_.block(block);
    for (int j = 0; j < kNumChildren; ++j) children[j].become_leaf(cell);
    leaf.become_inner(block);
  }

  /// An inner node whose children are all leaves becomes a leaf with the given cell.
  void merge(NodeType& parent, const Cell& cell) { merge(parent, cell, pool_.main_arena()); }
  void merge(NodeType& parent, const Cell& cell, Arena& arena) {
    const BlockId block = parent.children();
    parent.become_leaf(cell);
    pool_.free(block, arena);
  }

  /// A node becomes a leaf with the given cell; all below it goes. O(nodes below).
  void cut(NodeType& node, const Cell& cell = Cell{}) {
    if (!node.is_leaf()) {
      NodeType* const below = children(node);
      for (int j = 0; j < kNumChildren; ++j) cut(below[j]);
      pool_.free(node.children());
    }
    node.become_leaf(cell);
  }

  /// The storage that split_node() and merge() take and free blocks through, unless a thread has its own.
  [[nodiscard]] Arena& main_arena() { return pool_.main_arena(); }
  /// While threads have arenas, they may split and merge below nodes of their own, and nothing else happens.
  void lend(Arena& arena) { pool_.lend(arena); }
  void absorb(Arena& arena) { pool_.absorb(arena); }

  /// Adds roots, each N times larger, until the point fits; the old root becomes the child on the far side
  /// from the point (Sec. II-C), and on axes that fit already the new one is balanced about 0. No other node
  /// moves; no region that existed changes.
  /// @throws std::invalid_argument if the point is beyond `geometry().reach()`; the tree is then unchanged.
  void grow_to_contain(const Vector<D>& point) {
    if (!geometry_.in_reach(point)) throw std::invalid_argument(out_of_reach(point));
    const Lattice<D> target = geometry_.coordinates(point);
    while (!geometry_.contains(root_index_, target)) grow_towards(target);
  }

  /// A tree whose root has grown as this one's, and is a leaf.
  [[nodiscard]] NdTree emptied() const {
    NdTree empty(geometry_.unit(), -geometry_.finest_level());
    empty.root_index_ = root_index_;
    return empty;
  }

  /// Takes growth back: what it has added goes. @param root_index of a root that has grown to this one.
  void shrink_to(const CellIndex<D>& root_index) {
    while (root_index_.level > root_index.level) {
      NodeType& root = *pool_.block(kRootBlock);
      CellIndex<D> below{root_index_.lower, root_index_.level - 1};
      const std::int64_t edge = geometry_.edge(below.level);
      Offset<D> offset;
      for (std::size_t a = 0; a < D; ++a) {
        offset[a] = static_cast<int>((root_index.lower[a] - root_index_.lower[a]) / edge);
        below.lower[a] += offset[a] * edge;
      }
      if (!root.is_leaf()) {
        const int old_root = child_number<N, D>(offset);
        for (int j = 0; j < kNumChildren; ++j)
          if (j != old_root) cut(children(root)[j]);
        const BlockId block = root.children();
        root = pool_.block(block)[old_root];
        pool_.free(block);
      }
      root_index_ = below;
    }
  }

  /// Bytes that the tree may hold from now on, `others` beside it included. Splitting and growing then throw
  /// MemoryLimitReached.
  void limit_memory(std::size_t bytes, std::size_t others = 0) {
    pool_.limit_memory(bytes, sizeof(*this) + others);
  }

  [[nodiscard]] std::size_t num_inner_nodes() const { return pool_.num_blocks() - 1; }
  [[nodiscard]] std::size_t num_nodes() const { return 1 + num_inner_nodes() * kNumChildren; }
  [[nodiscard]] std::size_t num_leaves() const { return num_nodes() - num_inner_nodes(); }
  /// Gives back the memory of blocks that merging has freed, and puts siblings' blocks in depth-first order.
  /// Pointers to nodes do not hold. O(nodes). If there is not enough memory for both, nothing changes.
  void shrink_to_fit() {
    Pool fresh;
    fresh.reserve(pool_.num_blocks());
    fresh.allocate();
    Pace pace;
    copy_node(*pool_.block(kRootBlock), fresh, *fresh.block(kRootBlock), pace);
    last_checkpoint();
    pool_.swap(fresh);
  }
  /// shrink_to_fit(), if less than half of the memory is used. So memory follows what the tree holds, at a
  /// cost of O(1) for each merge. Pointers to nodes may not hold.
  /// @returns whether it did, after its last_checkpoint(). @throws Cancelled; the tree is then as it was.
  bool shrink_if_half_empty() {
    constexpr std::size_t kSmall = 1024;  // Blocks that are not worth it.
    if (pool_.capacity_in_blocks() <= 2 * pool_.num_blocks() + kSmall) return false;
    try {
      shrink_to_fit();
      return true;
    } catch (const std::bad_alloc&) {  // Then not now.
      return false;
    }
  }
  /// Bytes that a tree with this many inner nodes holds after shrink_to_fit().
  [[nodiscard]] static std::size_t memory_bytes_of(std::size_t num_inner_nodes) {
    return sizeof(NdTree) + Pool::memory_bytes_of(num_inner_nodes + 1);
  }
  /// Bytes held by the nodes' storage, used or not.
  [[nodiscard]] std::size_t memory_bytes() const { return sizeof(*this) + pool_.memory_bytes(); }

  /// @throws std::logic_error naming the first broken invariant. O(nodes).
  void check_invariants() const {
    std::size_t inner = 0;
    check_node(root(), inner);
    if (inner != num_inner_nodes())
      throw std::logic_error("the pool holds " + std::to_string(num_inner_nodes()) +
                             " blocks of children, the tree " + std::to_string(inner));
  }

  /// Back to one leaf, with another root region: where a stored tree begins.
  /// @throws std::invalid_argument if such a root could not grow on to all that is in reach.
  void reset(const CellIndex<D>& root_index) {
    bool reachable = root_index.level >= 0 && root_index.level <= geometry_.coarsest_level();
    const bool is_last = root_index.level == geometry_.coarsest_level();
    const std::int64_t reach = geometry_.coordinate(geometry_.reach());
    for (std::size_t a = 0; reachable && a < D; ++a)  // The first root, which begins at 0, is inside.
      reachable = root_index.lower[a] % geometry_.edge(0) == 0 && root_index.lower[a] <= 0 &&
                  root_index.lower[a] > -geometry_.edge(root_index.level) &&
                  (!is_last || (root_index.lower[a] <= -reach &&
                                root_index.lower[a] + geometry_.edge(root_index.level) > reach));
    if (!reachable)
      throw std::invalid_argument("root of level " + std::to_string(root_index.level) +
                                  ": not one that a tree can grow to");
    Pool fresh;
    fresh.allocate();
    pool_.swap(fresh);
    root_index_ = root_index;
  }

 private:
  using Pool = NodePool<NodeType, kNumChildren>;
  static constexpr BlockId kRootBlock = 0;  // Of this block only the first node is used.

  void copy_node(const NodeType& source, Pool& pool, NodeType& target, Pace& pace) const {
    if (source.is_leaf()) {
      target.become_leaf(source.cell());
      return;
    }
    pace.spend();
    const BlockId block = pool.allocate();
    target.become_inner(block);
    target.set_summary_word(source.summary_word());
    const NodeType* const sources = children(source);
    for (int j = 0; j < kNumChildren; ++j) copy_node(sources[j], pool, pool.block(block)[j], pace);
  }

  template <class R, class Tree>
  static R child_of(Tree& tree, const R& parent, int number) {
    return {tree.children(*parent.node) + number,
            tree.geometry_.child(parent.index, child_offset<N, D>(number))};
  }

  template <class R, class Tree>
  static R child_towards(Tree& tree, const R& parent, const Lattice<D>& coordinates) {
    R ref{nullptr, {parent.index.lower, parent.index.level - 1}};
    const std::int64_t edge = tree.geometry_.edge(ref.index.level);
    int number = 0;
    for (std::size_t a = D; a-- > 0;) {
      const std::int64_t i = child_place(coordinates[a] - ref.index.lower[a], edge);
      ref.index.lower[a] += i * edge;
      number = number * N + static_cast<int>(i);
    }
    ref.node = tree.children(*parent.node) + number;
    return ref;
  }

  template <class R, class Tree>
  static std::optional<R> find(Tree& tree, const Vector<D>& point) {
    if (!tree.geometry_.in_reach(point)) return std::nullopt;
    return find_at<R>(tree, tree.geometry_.coordinates(point));
  }
  template <class R, class Tree>
  static std::optional<R> find_at(Tree& tree, const Lattice<D>& coordinates) {
    R ref = tree.root();
    if (!tree.geometry_.contains(ref.index, coordinates)) return std::nullopt;
    while (!ref.is_leaf()) ref = child_towards<R>(tree, ref, coordinates);
    return ref;
  }

  void grow_towards(const Lattice<D>& target) {
    const std::int64_t edge = geometry_.edge(root_index_.level);
    Offset<D> offset;
    CellIndex<D> above{root_index_.lower, root_index_.level + 1};
    // Towards the target; on axes where it fits already, to the root's shorter side of 0.
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t lower = root_index_.lower[a];
      const bool fits = target[a] >= lower && target[a] - lower < edge;
      const bool downwards = fits ? lower + edge > -lower : target[a] < lower;
      offset[a] = downwards ? N - 1 : 0;
      above.lower[a] -= offset[a] * edge;
    }
    NodeType& root = *pool_.block(kRootBlock);
    const BlockId block = pool_.allocate();
    pool_.block(block)[child_number<N, D>(offset)] = root;
    root.become_inner(block);
    root_index_ = above;
  }

  void check_node(const ConstRef& ref, std::size_t& inner) const {
    if (ref.is_leaf()) return;
    ++inner;
    if (ref.index.level <= geometry_.finest_level())
      throw std::logic_error("an inner node of level " + std::to_string(ref.index.level) +
                             ": the finest leaves have level " + std::to_string(geometry_.finest_level()));
    const Box<D> whole = box(ref.index);
    for (int j = 0; j < kNumChildren; ++j) {
      const ConstRef c = child(ref, j);
      const Offset<D> offset = child_offset<N, D>(j);
      const Box<D> part = box(c.index);
      for (int a = 0; a < D; ++a) {
        const int i = offset[static_cast<std::size_t>(a)];
        if ((i == 0 && part.lower[a] != whole.lower[a]) || (i == N - 1 && part.upper[a] != whole.upper[a]))
          throw std::logic_error("child " + std::to_string(j) + " of a node of level " +
                                 std::to_string(ref.index.level) + " does not share its parent's border");
      }
      check_node(c, inner);
    }
  }

  [[nodiscard]] std::string out_of_reach(const Vector<D>& point) const {
    std::string text = "point (";
    for (int a = 0; a < D; ++a) text += (a ? ", " : "") + describe_number(point[a]);
    return text + ") m: with cells of " + describe_number(geometry_.unit()) +
           " m every component must be within " + describe_number(geometry_.reach()) + " m of 0";
  }

  LatticeGeometry<N, D> geometry_;
  Pool pool_;
  CellIndex<D> root_index_{};
};

}  // namespace ndtree
