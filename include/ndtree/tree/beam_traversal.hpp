// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Hierarchical ray casting: the leaves along a beam, each once, in order, with entry and exit (Sec. II-D).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <type_traits>
#include <utility>

#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree {

/// Hooks of a visitor that changes the tree while a beam passes through it; override what is needed by
/// hiding.
struct BeamVisitor {
  /// Before a leaf is visited: may split it, and the beam then goes on among its children.
  template <class Ref>
  void enter(const Ref&) {}
  /// Before an inner node: whether the beam goes through it without visiting what is below.
  template <class Ref>
  bool passes_over(const Ref&) {
    return false;
  }
  /// After the last visited child of an inner node: may merge them.
  template <class Ref>
  void leave(const Ref&) {}
};

/// Narrows [t_begin, t_end], of a beam t * direction, to the part inside the half-open box [lower, upper). Of
/// boxes that tile space, each point belongs to one.
/// @returns whether more than a point remains.
template <int D>
bool clip_to_box(const Vector<D>& lower, const Vector<D>& upper, const Vector<D>& direction, double& t_begin,
                 double& t_end) {
  for (int a = 0; a < D; ++a) {
    const double d = direction[a];
    if (d == 0.0) {  // Parallel to the faces: inside for ever, or never.
      if (lower[a] > 0.0 || upper[a] <= 0.0) return false;
      continue;
    }
    const double t_lower = lower[a] / d;
    const double t_upper = upper[a] / d;
    t_begin = std::max(t_begin, std::min(t_lower, t_upper));
    t_end = std::min(t_end, std::max(t_lower, t_upper));
  }
  return t_begin < t_end;
}

/// One beam on the lattice: where it crosses planes, and which children of a cell it passes through. The only
/// code that steps along beams.
template <int N, int D>
class BeamStepper {
  static constexpr double kNever = std::numeric_limits<double>::infinity();

 public:
  BeamStepper(const LatticeGeometry<N, D>& geometry, const Vector<D>& origin, const Vector<D>& direction)
      : geometry_(&geometry), origin_(origin), direction_(direction) {}

  /// Narrows [t_begin, t_end] to the part inside the cell. @returns whether more than a point remains.
  bool clip(const CellIndex<D>& cell, double& t_begin, double& t_end) const {
    const Box<D> box = geometry_->box(cell);
    return clip_to_box<D>(box.lower - origin_, box.upper - origin_, direction_, t_begin, t_end);
  }

  /// Calls `visit(number, index, t_enter, t_exit)` for each child that the beam passes through over more than
  /// a point, in order. @param t_enter, t_exit of the parent. @param visit returns false to stop.
  /// @returns false if it was stopped.
  template <class Visit>
  bool for_each_child(const CellIndex<D>& parent, double t_enter, double t_exit, Visit&& visit) const {
    const int level = parent.level - 1;
    const std::int64_t edge = geometry_->edge(level);
    std::array<std::int64_t, std::size_t{D}> i;  // Offset of the current child.
    std::array<double, std::size_t{D}> t_next;   // Where the beam leaves it on each axis.
    for (std::size_t a = 0; a < D; ++a) {
      const double d = direction_[static_cast<int>(a)];
      const std::int64_t first = parent.lower[a];
      t_next[a] = kNever;
      if (d >= 0.0) {  // Planes at or before the entry are passed; the beam is in the cell above them.
        i[a] = 0;
        for (; i[a] < N - 1; ++i[a]) {
          const double t = crossing(a, first + (i[a] + 1) * edge);
          if (t > t_enter) {
            if (d > 0.0) t_next[a] = t;
            break;
          }
        }
      } else {
        i[a] = N - 1;
        for (; i[a] > 0; --i[a]) {
          const double t = crossing(a, first + i[a] * edge);
          if (t > t_enter) {
            t_next[a] = t;
            break;
          }
        }
      }
    }
    for (double t = t_enter;;) {
      double t_leave = t_exit;
      for (std::size_t a = 0; a < D; ++a) t_leave = std::min(t_leave, t_next[a]);
      if (t_leave > t) {  // Else a sliver that rounding left: the beam is already in the next child.
        CellIndex<D> child{parent.lower, level};
        std::int64_t number = 0;
        for (std::size_t a = D; a-- > 0;) {
          child.lower[a] += i[a] * edge;
          number = number * N + i[a];
        }
        if (!visit(static_cast<int>(number), child, t, t_leave)) return false;
        t = t_leave;
      }
      if (t_leave >= t_exit) return true;
      for (std::size_t a = 0; a < D; ++a) {  // Through an edge or a corner: all its axes step at once.
        if (t_next[a] > t_leave) continue;
        if (direction_[static_cast<int>(a)] > 0.0) {
          ++i[a];
          t_next[a] = i[a] < N - 1 ? crossing(a, parent.lower[a] + (i[a] + 1) * edge) : kNever;
        } else {
          --i[a];
          t_next[a] = i[a] > 0 ? crossing(a, parent.lower[a] + i[a] * edge) : kNever;
        }
      }
    }
  }

  /// Calls `visit(lower, t_enter, t_exit)` for each cell of one level in a larger cell that the beam passes
  /// through over more than a point, in order: the same cells, entries and exits that for_each_child()
  /// reaches level by level.
  /// @param t_enter, t_exit of the larger cell. @param edge of the cells, in smallest ones.
  template <class Visit>
  void for_each_cell(const CellIndex<D>& in, std::int64_t edge, double t_enter, double t_exit,
                     Visit&& visit) const {
    Lattice<D> lower;                            // Of the current cell.
    Lattice<D> step;                             // To the next one on each axis.
    std::array<double, std::size_t{D}> t_next;   // Where the beam leaves it on each axis, and where
    std::array<double, std::size_t{D}> t_after;  // the next one: known before it is needed.
    std::array<double, std::size_t{D}> plane;    // Of t_after, in smallest cells.
    for (std::size_t a = 0; a < D; ++a) {
      const double d = direction_[static_cast<int>(a)];
      lower[a] = first_on_axis(a, in, edge, t_enter);
      step[a] = d < 0.0 ? -edge : edge;
      plane[a] = static_cast<double>(d < 0.0 ? lower[a] : lower[a] + edge);
      t_next[a] = d == 0.0 ? kNever : crossing_at(a, plane[a]);
      plane[a] += static_cast<double>(step[a]);
      t_after[a] = d == 0.0 ? kNever : crossing_at(a, plane[a]);
    }
    for (double t = t_enter;;) {
      double t_leave = t_exit;
      for (std::size_t a = 0; a < D; ++a) t_leave = std::min(t_leave, t_next[a]);
      if (t_leave > t) {
        visit(static_cast<const Lattice<D>&>(lower), t, t_leave);
        t = t_leave;
      }
      if (t_leave >= t_exit) return;
      for (std::size_t a = 0; a < D; ++a) {  // Through an edge or a corner: all its axes step at once.
        if (t_next[a] > t_leave) continue;
        lower[a] += step[a];
        t_next[a] = t_after[a];
        plane[a] += static_cast<double>(step[a]);
        t_after[a] = crossing_at(a, plane[a]);
      }
    }
  }

 private:
  /// Lower border, on this axis, of the cell that the beam is in just behind t. @param in the larger cell
  /// that it lies in.
  [[nodiscard]] std::int64_t first_on_axis(std::size_t a, const CellIndex<D>& in, std::int64_t edge,
                                           double t) const {
    const double d = direction_[static_cast<int>(a)];
    const std::int64_t first = in.lower[a];
    const std::int64_t last = first + geometry_->edge(in.level) - edge;
    const double way = origin_[static_cast<int>(a)] + t * d - geometry_->border(first);
    const double guess = std::floor(way / (static_cast<double>(edge) * geometry_->unit()));
    const std::int64_t cells = (last - first) / edge;
    std::int64_t lower =
        first + edge * static_cast<std::int64_t>(std::min(std::max(guess, 0.0), static_cast<double>(cells)));
    // Planes at or before t are passed: they decide, not the guess. Upwards the cell's lower plane is passed
    // and its upper one is not; downwards the other way round.
    const bool is_downwards = d < 0.0;
    while (lower > first && (crossing(a, lower) > t) != is_downwards) lower -= edge;
    while (lower < last && (crossing(a, lower + edge) > t) == is_downwards) lower += edge;
    return lower;
  }
  /// Where the beam meets the lattice plane at `coordinate` on axis a. It depends on the plane alone, and
  /// never decreases from plane to plane along the beam: cells of all levels agree on their common faces. For
  /// a beam parallel to the plane: -inf if the beam lies on the plane or above it, +inf if below.
  [[nodiscard]] double crossing(std::size_t a, std::int64_t coordinate) const {
    if (direction_[static_cast<int>(a)] != 0.0) return crossing_at(a, static_cast<double>(coordinate));
    return geometry_->border(coordinate) <= origin_[static_cast<int>(a)] ? -kNever : kNever;
  }
  /// crossing() of a beam that is not parallel to the plane. @param coordinate a whole number.
  [[nodiscard]] double crossing_at(std::size_t a, double coordinate) const {
    return (unfused(coordinate * geometry_->unit()) - origin_[static_cast<int>(a)]) /
           direction_[static_cast<int>(a)];
  }

  const LatticeGeometry<N, D>* geometry_;
  Vector<D> origin_;
  Vector<D> direction_;
};

namespace detail {

template <class Tree, class Visitor>
class BeamTraversal {
  static constexpr int D = Tree::kDim;

 public:
  BeamTraversal(Tree& tree, const Vector<D>& origin, const Vector<D>& direction, Visitor& visitor)
      : tree_(tree), stepper_(tree.geometry(), origin, direction), visitor_(visitor) {}

  bool run(double t_begin, double t_end) {
    const auto root = tree_.root();
    return stepper_.clip(root.index, t_begin, t_end) ? descend(root, t_begin, t_end) : true;
  }

 private:
  template <class Ref>
  bool descend(const Ref& ref, double t_enter, double t_exit) {
    if (ref.is_leaf()) {
      visitor_.enter(ref);
      if (ref.is_leaf()) return visitor_.leaf(ref, t_enter, t_exit);
    } else if (visitor_.passes_over(ref)) {
      return true;
    }
    auto* const siblings = tree_.children(*ref.node);
    if (!stepper_.for_each_child(ref.index, t_enter, t_exit,
                                 [&](int number, const CellIndex<D>& index, double enter, double exit) {
                                   return descend(Ref{siblings + number, index}, enter, exit);
                                 }))
      return false;
    visitor_.leave(ref);
    return true;
  }

  Tree& tree_;
  const BeamStepper<Tree::kBranching, D> stepper_;
  Visitor& visitor_;
};

template <class Function>
struct LeafVisitor : BeamVisitor {
  Function& function;
  explicit LeafVisitor(Function& f) : function(f) {}
  template <class Ref>
  bool leaf(const Ref& ref, double t_enter, double t_exit) {
    if constexpr (std::is_same_v<decltype(function(ref, t_enter, t_exit)), bool>) {
      return function(ref, t_enter, t_exit);
    } else {
      function(ref, t_enter, t_exit);
      return true;
    }
  }
};

}  // namespace detail

/// Visits the leaves that the points origin + t * direction, t in (t_begin, t_end), pass through over more
/// than a point: each once, in order, with the t of entry and exit; exits equal the next leaf's entries to
/// the last bit. With a unit direction t is metres; with end point - origin it is 1 at the end point. A beam
/// along a face belongs to the cells above it (cells are half-open); a zero direction stays in the leaf of
/// the origin.
/// @param visitor `visit(leaf, t_enter, t_exit)`, returning void, or false to stop; or a struct derived from
///   BeamVisitor with a member `bool leaf(ref, t_enter, t_exit)`, which may change the tree in its hooks.
/// @returns false if the visitor stopped it.
template <class Tree, class Visitor>
bool traverse_beam(Tree& tree, const Vector<Tree::kDim>& origin, const Vector<Tree::kDim>& direction,
                   double t_begin, double t_end, Visitor&& visitor) {
  using Plain = std::remove_reference_t<Visitor>;
  if constexpr (std::is_base_of_v<BeamVisitor, Plain>) {
    return detail::BeamTraversal<Tree, Plain>(tree, origin, direction, visitor).run(t_begin, t_end);
  } else {
    detail::LeafVisitor<Plain> adapter(visitor);
    return detail::BeamTraversal<Tree, detail::LeafVisitor<Plain>>(tree, origin, direction, adapter)
        .run(t_begin, t_end);
  }
}

}  // namespace ndtree
