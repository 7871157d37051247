// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Points of a grid that are looked at together: what is nearest to each of them.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/lanes.hpp"
#include "ndtree/core/simd.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/field_grid.hpp"
#include "ndtree/query/region.hpp"
#include "ndtree/tree/child_index.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree::detail {

/// The points of a small block of a grid, and for each a squared distance [m²]: to the nearest of the boxes
/// that they were shown. All that is to be known of a box is how far it is from each plane of points along
/// each axis, for a distance is a sum of one of these for each axis: ((z² + y²) + x²) in float32. A box is
/// never farther than one that lies in it, not by a bit: so a search among boxes within boxes is exact.
template <int D>
class PointPacket {
  static constexpr auto kAxes = static_cast<std::size_t>(D);

 public:
  /// Points along an axis.
  static constexpr std::size_t kSide = D == 2 ? 8 : D == 3 ? 4 : 2;
  static constexpr std::size_t kPoints = static_cast<std::size_t>(integer_power(kSide, D));
  /// For each point, in the order of a C array.
  using Values = std::array<float, kPoints>;
  /// From the planes of points along one axis to a box.
  using AxisSquares = std::array<float, kSide>;
  /// For each axis.
  using Squares = std::array<const AxisSquares*, kAxes>;

  /// All have -1, so that nothing is nearer.
  /// @param block of at most kSide points along each axis, not empty. Points that it lacks repeat its
  /// last planes, and are to keep -1.
  PointPacket(const FieldGrid<D>& grid, const GridBlock<D>& block) {
    for (std::size_t a = 0; a < kAxes; ++a)
      for (std::size_t i = 0; i < kSide; ++i)
        planes_[a][i] = grid.center(a, std::min(block.first[a] + i, block.last[a] - 1));
    squared_.fill(-1.0f);
  }

  /// Which of the values is that of a place of the block.
  [[nodiscard]] static std::size_t lane(const GridBlock<D>& block,
                                        const typename FieldGrid<D>::Shape& place) {
    std::size_t at = 0;
    for (std::size_t a = 0; a < kAxes; ++a) at = at * kSide + (place[a] - block.first[a]);
    return at;
  }
  [[nodiscard]] Values& squared() { return squared_; }
  [[nodiscard]] const Values& squared() const { return squared_; }
  [[nodiscard]] double middle(std::size_t axis) const {
    return 0.5 * (planes_[axis].front() + planes_[axis].back());
  }

  /// Whether a box is nearer to some point than what it has.
  [[nodiscard]] bool is_nearer(const Squares& box) const {
#ifdef NDTREE_HAS_EIGHTS
    if constexpr (kRest % 8 == 0)
      if (by_eights_) return is_nearer_by_eights(box);
#endif
    const Rest rest = rest_of(box);
    for (std::size_t i = 0; i < kSide; ++i) {
      unsigned nearer = 0;
      for (std::size_t k = 0; k < kRest; ++k)
        nearer |= static_cast<unsigned>(rest[k] + (*box[0])[i] < squared_[i * kRest + k]);
      if (nearer != 0) return true;
    }
    return false;
  }
  /// Gives each point the nearer of a box and what it has.
  void take(const Squares& box) {
#ifdef NDTREE_HAS_EIGHTS
    if constexpr (kRest % 8 == 0)
      if (by_eights_) return take_by_eights(box);
#endif
    const Rest rest = rest_of(box);
    for (std::size_t i = 0; i < kSide; ++i)
      for (std::size_t k = 0; k < kRest; ++k) {
        const float sum = rest[k] + (*box[0])[i];
        float& squared = squared_[i * kRest + k];
        squared = sum < squared ? sum : squared;
      }
  }
  [[nodiscard]] bool is_nearer(const Box<D>& box) const { return is_nearer(Measured(*this, box).squares); }
  void take(const Box<D>& box) { take(Measured(*this, box).squares); }

  /// From the planes along an axis to what lies between each two borders.
  template <std::size_t N>
  void measure(std::size_t axis, const std::array<double, N + 1>& borders,
               std::array<AxisSquares, N>& squares) const {
#ifdef NDTREE_HAS_EIGHTS
    if constexpr (kSide % 4 == 0)
      if (by_eights_) return measure_by_fours<N>(planes_[axis], borders, squares);
#endif
    for (std::size_t j = 0; j < N; ++j)
      for (std::size_t i = 0; i < kSide; ++i) {
        const double at = planes_[axis][i];
        const double outside = std::max(borders[j] - at, at - borders[j + 1]);
        const double gap = std::max(outside, 0.0);
        squares[j][i] = static_cast<float>(gap * gap);
      }
  }

 private:
  /// A box of its own.
  struct Measured {
    std::array<std::array<AxisSquares, 1>, kAxes> of_axis;
    Squares squares;

    Measured(const PointPacket& packet, const Box<D>& box) {
      for (std::size_t a = 0; a < kAxes; ++a) {
        const auto axis = static_cast<int>(a);
        packet.measure<1>(a, {box.lower[axis], box.upper[axis]}, of_axis[a]);
        squares[a] = of_axis[a].data();
      }
    }
  };
  static constexpr std::size_t kRest = kPoints / kSide;
  using Rest = std::array<float, kRest>;
  using Planes = std::array<double, kSide>;

  /// Sums for all axes but the first, from the last on.
  [[nodiscard]] static Rest rest_of(const Squares& box) {
    Rest rest{};
    if constexpr (kAxes == 1) return rest;
    std::copy_n(box[kAxes - 1]->begin(), kSide, rest.begin());
    std::size_t n = kSide;
    for (std::size_t a = kAxes - 1; a > 1; --a, n *= kSide) {
      const Rest sums = rest;
      for (std::size_t i = 0; i < kSide; ++i)
        for (std::size_t k = 0; k < n; ++k) rest[i * n + k] = sums[k] + (*box[a - 1])[i];
    }
    return rest;
  }

#ifdef NDTREE_HAS_EIGHTS
  NDTREE_BY_EIGHTS [[nodiscard]] bool is_nearer_by_eights(const Squares& box) const {
    const Rest rest = rest_of(box);
    for (std::size_t i = 0; i < kSide; ++i) {
      const float first = (*box[0])[i];
      EightMask nearer = EightMask::none();
      for (std::size_t k = 0; k < kRest; k += 8)
        nearer = nearer | (EightFloats::load(rest.data() + k) + first <
                           EightFloats::load(squared_.data() + i * kRest + k));
      if (nearer.set() != 0) return true;
    }
    return false;
  }
  NDTREE_BY_EIGHTS void take_by_eights(const Squares& box) {
    const Rest rest = rest_of(box);
    for (std::size_t i = 0; i < kSide; ++i) {
      const float first = (*box[0])[i];
      for (std::size_t k = 0; k < kRest; k += 8) {
        float* const squared = squared_.data() + i * kRest + k;
        min_of(EightFloats::load(rest.data() + k) + first, EightFloats::load(squared)).store(squared);
      }
    }
  }
  template <std::size_t N>
  NDTREE_BY_EIGHTS static void measure_by_fours(const Planes& planes,
                                                const std::array<double, N + 1>& borders,
                                                std::array<AxisSquares, N>& squares) {
    for (std::size_t i = 0; i < kSide; i += 4) {
      const FourDoubles at = FourDoubles::load(planes.data() + i);
      FourDoubles below = borders[0] - at;
      for (std::size_t j = 0; j < N; ++j) {
        const FourDoubles gap = max_of(max_of(below, at - borders[j + 1]), 0.0);
        store_as_floats(gap * gap, squares[j].data() + i);
        below = borders[j + 1] - at;
      }
    }
  }
  bool by_eights_ = Simd::width() >= 8;
#endif

  std::array<Planes, kAxes> planes_;
  Values squared_;
};

/// Shows packets of points the cells of a map that have one of some states.
template <class Map>
class PacketSearch {
  using Tree = typename Map::Tree;
  using NodeType = typename Tree::NodeType;
  static constexpr int N = Tree::kBranching;
  static constexpr int D = Tree::kDim;

 public:
  PacketSearch(const Map& map, const RegionStates& states, Pace& pace)
      : tree_(map.tree()), states_(states), pace_(pace) {}

  /// All that is nearer to some point than what the packet has. Space outside the map, which is unknown, has
  /// to be shown to it beside. Nodes that are no nearer than what was found are not entered.
  void show(PointPacket<D>& packet) const {
    const auto root = tree_.root();
    if (!root.is_leaf())
      show_below(*root.node, root.index, packet);
    else if (may_contain(states_, *root.node))
      packet.take(tree_.box(root.index));
  }

 private:
  /// The children of a node, beginning with the nearest.
  void show_below(const NodeType& parent, const CellIndex<D>& index, PointPacket<D>& packet) const {
    using AxisSquares = typename PointPacket<D>::AxisSquares;
    pace_.spend(4 + Tree::kNumChildren);
    const auto& geometry = tree_.geometry();
    const std::int64_t edge = geometry.edge(index.level - 1);
    std::array<std::array<AxisSquares, std::size_t{N}>, std::size_t{D}> squares;
    Offset<D> nearest{};
    for (std::size_t a = 0; a < D; ++a) {
      std::array<double, std::size_t{N} + 1> borders;
      for (std::size_t j = 0; j <= N; ++j)
        borders[j] = geometry.border(index.lower[a] + static_cast<std::int64_t>(j) * edge);
      packet.template measure<N>(a, borders, squares[a]);
      for (std::size_t j = 1; j < N; ++j) nearest[a] += borders[j] < packet.middle(a);
    }
    const NodeType* const children = tree_.children(parent);
    const int first = child_number<N, D>(nearest);
    for (int i = 0; i < Tree::kNumChildren; ++i) {
      const int number = child_from<N, D>(first, i);
      const NodeType& child = children[number];
      if (!may_contain(states_, child)) continue;
      const auto offset = child_offset<N, D>(number);
      typename PointPacket<D>::Squares box;
      for (std::size_t a = 0; a < D; ++a) box[a] = &squares[a][static_cast<std::size_t>(offset[a])];
      if (!packet.is_nearer(box)) continue;
      if (child.is_leaf())
        packet.take(box);
      else
        show_below(child, geometry.child(index, offset), packet);
    }
  }

  const Tree& tree_;
  RegionStates states_;
  Pace& pace_;
};

}  // namespace ndtree::detail
