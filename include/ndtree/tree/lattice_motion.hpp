// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Motions that map the lattice of cells onto itself, and what they do to a tree.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Axes change places, some of them are mirrored, and then all are shifted by whole cells.
template <int D>
struct LatticeMotion {
  std::array<std::size_t, std::size_t{D}> source{};  ///< By axis: which one it was.
  std::array<bool, std::size_t{D}> is_mirrored{};    ///< By axis: whether it points the other way.
  Lattice<D> shift{};                                ///< In units of the smallest cell.

  [[nodiscard]] bool is_identity() const {
    for (std::size_t a = 0; a < D; ++a)
      if (source[a] != a || is_mirrored[a] || shift[a] != 0) return false;
    return true;
  }
  /// Where a cell's lower corner comes to lie. @param edge of the cell.
  [[nodiscard]] Lattice<D> operator()(const Lattice<D>& lower, std::int64_t edge) const {
    Lattice<D> result;
    for (std::size_t a = 0; a < D; ++a)
      result[a] = (is_mirrored[a] ? -(lower[source[a]] + edge) : lower[source[a]]) + shift[a];
    return result;
  }
  /// What number a child gets among its siblings.
  template <int N>
  [[nodiscard]] int child(int number) const {
    const Offset<D> from = child_offset<N, D>(number);
    Offset<D> to{};
    for (std::size_t a = 0; a < D; ++a) to[a] = is_mirrored[a] ? N - 1 - from[source[a]] : from[source[a]];
    return child_number<N, D>(to);
  }
};

/// The lattice motion that x -> rotation x + translation is for cells of a level, if it is one up to
/// rounding: no point with |components| up to `extent` [m] ends more than a millionth of the smallest cell
/// away.
template <int N, int D>
[[nodiscard]] std::optional<LatticeMotion<D>> lattice_motion(const LatticeGeometry<N, D>& geometry, int level,
                                                             const Eigen::Matrix<double, D, D>& rotation,
                                                             const Vector<D>& translation, double extent) {
  constexpr double kRounding = 1e-14;
  const double tolerance = 1e-6 * geometry.unit();
  const std::int64_t edge = geometry.edge(level);
  LatticeMotion<D> motion;
  std::array<bool, std::size_t{D}> is_taken{};
  for (int a = 0; a < D; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    Eigen::Index from = 0;
    rotation.row(a).cwiseAbs().maxCoeff(&from);
    motion.source[axis] = static_cast<std::size_t>(from);
    motion.is_mirrored[axis] = rotation(a, from) < 0.0;
    if (is_taken[motion.source[axis]]) return std::nullopt;
    is_taken[motion.source[axis]] = true;
    double off = 0.0;
    for (int b = 0; b < D; ++b)
      off += std::abs(rotation(a, b) - (b != from ? 0.0 : motion.is_mirrored[axis] ? -1.0 : 1.0));
    const double cells = translation[a] / geometry.cell_size(level);
    if (!(std::abs(cells) * static_cast<double>(edge) < 0x1p40)) return std::nullopt;  // Far out of reach.
    motion.shift[axis] = std::llround(cells) * edge;
    if (off <= kRounding) off = 0.0;  // As of a cosine of a right angle, however far the point.
    if (!(off * extent + std::abs(translation[a] - geometry.border(motion.shift[axis])) <= tolerance))
      return std::nullopt;
  }
  return motion;
}

namespace detail {

/// Copies the subtrees of some level to where a motion moves them.
template <class Tree>
class MovingCells {
  static constexpr int D = Tree::kDim;
  using NodeType = typename Tree::NodeType;
  using ConstRef = typename Tree::ConstRef;

 public:
  /// @param level up to 0. @param motion by whole cells of the level.
  MovingCells(const Tree& source, int level, const LatticeMotion<D>& motion)
      : source_(source), level_(level), motion_(motion) {
    for (int j = 0; j < Tree::kNumChildren; ++j)
      numbers_[static_cast<std::size_t>(j)] = motion.template child<Tree::kBranching>(j);
  }
  /// @param target an empty tree with the source's cells. @param is_empty of a cell: it may be left out.
  /// @returns false if a leaf above the level is not empty: nothing has been copied then.
  /// @throws std::invalid_argument if a cell is moved out of reach.
  template <class IsEmpty>
  [[nodiscard]] bool run(Tree& target, const IsEmpty& is_empty) {
    const std::int64_t edge = source_.geometry().edge(level_);
    std::optional<LatticeBox<D>> box;
    const bool is_possible = for_each_part(source_.root(), is_empty, [&](const ConstRef& part) {
      const Lattice<D> lower = motion_(part.index.lower, edge);
      if (!box) box = {lower, lower};
      for (std::size_t a = 0; a < D; ++a) {
        box->lower[a] = std::min(box->lower[a], lower[a]);
        box->upper[a] = std::max(box->upper[a], lower[a] + edge);
      }
    });
    if (!is_possible || !box) return is_possible;
    grow_around(target, *box);
    return for_each_part(source_.root(), is_empty, [&](const ConstRef& part) {
      const Lattice<D> lower = motion_(part.index.lower, edge);
      typename Tree::Ref ref = target.root();
      while (ref.index.level > level_) {
        if (ref.is_leaf()) target.split(ref);
        ref = target.child_towards(ref, lower);
      }
      copy(*part.node, target, *ref.node);
    });
  }

 private:
  template <class IsEmpty, class Visit>
  bool for_each_part(const ConstRef& ref, const IsEmpty& is_empty, const Visit& visit) {
    pace_.spend();
    if (ref.is_leaf() && is_empty(ref.cell())) return true;
    if (ref.index.level == level_) {
      visit(ref);
      return true;
    }
    if (ref.is_leaf()) return false;
    for (int j = 0; j < Tree::kNumChildren; ++j)
      if (!for_each_part(source_.child(ref, j), is_empty, visit)) return false;
    return true;
  }
  void copy(const NodeType& from, Tree& target, NodeType& to) {
    if (from.is_leaf()) {
      to.become_leaf(from.cell());
      return;
    }
    pace_.spend(Tree::kNumChildren);
    target.split_node(to);
    for (int j = 0; j < Tree::kNumChildren; ++j)
      copy(source_.children(from)[j], target, target.children(to)[numbers_[static_cast<std::size_t>(j)]]);
  }

  const Tree& source_;
  int level_;
  LatticeMotion<D> motion_;
  std::array<int, std::size_t{Tree::kNumChildren}> numbers_{};
  Pace pace_;
};

}  // namespace detail
}  // namespace ndtree
