// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A cube of places of a body, and what searches ask of it.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "ndtree/core/types.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// What a body may do at a place: not be there, be there at a cost because it may touch unknown space, or be
/// there.
enum class Passage : std::uint8_t { blocked, costly, free };

/// A cube of places of one passage, on the lattice of smallest cells.
template <int D>
struct PlaceCell {
  Lattice<D> lower{};
  std::int64_t edge = 0;
  Passage passage = Passage::blocked;
  std::uint64_t number = 0;  ///< Of this cell alone, as long as nothing changes.
};

/// What two cells share: a face, if they lie side by side.
template <int D>
[[nodiscard]] Box<D> common_box(const PlaceCell<D>& a, const PlaceCell<D>& b) {
  Box<D> box;
  for (int k = 0; k < D; ++k) {
    const auto i = static_cast<std::size_t>(k);
    box.lower[k] = static_cast<double>(std::max(a.lower[i], b.lower[i]));
    box.upper[k] = static_cast<double>(std::min(a.lower[i] + a.edge, b.lower[i] + b.edge));
  }
  return box;
}
/// The nearest point of a closed box.
template <int D>
[[nodiscard]] Vector<D> nearest_in(const Box<D>& box, const Vector<D>& point) {
  return point.cwiseMax(box.lower).cwiseMin(box.upper);
}

namespace detail {

/// How a search finds out whether a point sees another: by a walk through the cells between; or through the
/// cells that it has come through, which is faster, and may miss it; or, if it does, also by a walk.
enum class Sight { walk, cells, cells_and_walk };

/// A place in a cell of free space where a path may begin or end, and the way from there to the pose itself,
/// which may lie in a cell that is not free as a whole.
template <int D>
struct Anchor {
  Vector<D> point;  ///< In smallest cells.
  PlaceCell<D> cell;
  double way = 0.0;      ///< To the pose, in smallest cells.
  std::size_t goal = 0;  ///< Of several, which one it belongs to.
};

}  // namespace detail
}  // namespace ndtree
