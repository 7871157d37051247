// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The free space of a body, seen coarsely: how far the goal is, nearly, from everywhere a search may come.
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/planning/brick.hpp"
#include "ndtree/planning/free_space.hpp"
#include "ndtree/planning/path_search.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree::detail {

/// A free space whose cells are cubes of kEdge^D smallest cells where it has smaller ones. A cube is passable
/// if some place in it is, and two that share a face are joined if places are free on both sides of it
/// somewhere. So whatever is connected in the space is connected here; a way may be shorter than it can be by
/// what it cuts in cubes. It has no memory of its own.
template <class Map>
class CoarseSpace {
 public:
  static constexpr int D = Map::kDim;
  using Space = FreeSpace<Map>;
  using Cell = PlaceCell<D>;
  static constexpr bool kHasWalls = true;
  static constexpr bool kTestsWays = false;
  static constexpr Sight kSight = Sight::cells;
  static constexpr int kLevel = CubeBits<D>::kLevel;
  static constexpr int kEdge = CubeBits<D>::kEdge;

  explicit CoarseSpace(Space& space) : space_(space) {}

  [[nodiscard]] Cell cell_at(const Lattice<D>& at) {
    if (!space_.is_inside(at)) return {at, 1, Passage::blocked, Space::kOutside};
    const auto [number, index] = node_towards(at, 0);
    return cell_in(number, index, at);
  }
  /// Calls `visit(cell)` for each passable cell that is joined to one through a face.
  template <class Visit>
  void for_each_beside(const Cell& cell, const Visit& visit) {
    const int level = Space::level_of(cell.edge);
    for (std::size_t a = 0; a < D; ++a)
      for (const int side : {0, 1}) {
        if (level == kLevel && at_cube(cell, a, side, visit)) continue;
        Lattice<D> at = cell.lower;
        at[a] += side == 0 ? -cell.edge : cell.edge;
        if (!Space::is_in(at, space_.root_)) continue;
        const std::uint32_t own = face_of(cell, a, side);
        if (own == 0) continue;
        const auto [number, index] = node_towards(at, level);
        if (level > kLevel) {
          at_face(number, index, {a, 1 - side}, visit);
          continue;
        }
        const Cell other = cell_in(number, index, at);
        if (other.passage != Passage::blocked && (own & face_of(other, a, 1 - side)) != 0) visit(other);
      }
  }
  /// Whether a way may lead from one cell to the next through a face.
  [[nodiscard]] bool are_joined(const Cell& from, const Cell& to, int axis, bool upwards) const {
    const auto a = static_cast<std::size_t>(axis);
    return (face_of(from, a, upwards ? 1 : 0) & face_of(to, a, upwards ? 0 : 1)) != 0;
  }

 private:
  using Brick = typename Space::Brick;
  using Cubes = typename Space::Cubes;
  using State = typename Space::State;
  using Face = typename Space::Face;
  struct Found {
    std::uint32_t number;
    CellIndex<D> index;
  };

  /// The cube beside one in the same brick. @returns whether it is in it.
  template <class Visit>
  bool at_cube(const Cell& cell, std::size_t axis, int side, const Visit& visit) const {
    typename Brick::Place cube = place_of(cell);
    typename Brick::Place lower = cube;
    cube[axis] += side == 0 ? -1 : 1;
    if (cube[axis] < 0 || cube[axis] >= Cubes::kPerAxis) return false;
    lower[axis] = std::min(lower[axis], cube[axis]);
    const std::uint32_t number = node_of(cell);
    if ((cubes_of(number).joined[axis] & Cubes::bit(lower)) == 0) return true;
    visit(cube_of(number, Space::brick_index(cell.lower), cube));
    return true;
  }
  /// The node that is not divided, or of a level, and holds a place.
  [[nodiscard]] Found node_towards(const Lattice<D>& at, int level) {
    std::uint32_t& last = space_.last_brick_;
    if (level < Space::kBrickLevels && last != Space::kNoNode && Space::is_in(at, space_.last_index_))
      return {last, space_.last_index_};
    Found found{0, space_.root_};
    space_.visit(0, found.index);
    while (space_.nodes_[found.number].state == State::divided && found.index.level > level) {
      found.number = Space::child_towards(space_.nodes_[found.number], found.index, at);
      space_.visit(found.number, found.index);
    }
    if (space_.nodes_[found.number].state == State::brick) {
      last = found.number;
      space_.last_index_ = found.index;
    }
    return found;
  }
  /// @pre the node is not divided.
  [[nodiscard]] Cell cell_in(std::uint32_t number, const CellIndex<D>& index, const Lattice<D>& at) const {
    const auto& node = space_.nodes_[number];
    if (node.state != State::brick) return Space::node_cell(number, index, node.state);
    typename Brick::Place cube;
    for (std::size_t a = 0; a < D; ++a) cube[a] = static_cast<int>(at[a] - index.lower[a]) >> kLevel;
    return cube_of(number, index, cube);
  }
  [[nodiscard]] Cell cube_of(std::uint32_t number, const CellIndex<D>& index,
                             const typename Brick::Place& cube) const {
    const Cubes& cubes = cubes_of(number);
    const std::uint64_t bit = Cubes::bit(cube);
    const Passage passage = (cubes.free & bit) != 0  ? Passage::free
                            : (cubes.any & bit) != 0 ? Passage::costly
                                                     : Passage::blocked;
    return Space::brick_cell(number, index, kLevel, cube, passage);
  }
  [[nodiscard]] const Cubes& cubes_of(std::uint32_t number) const {
    return space_.cubes_[space_.nodes_[number].below];
  }
  [[nodiscard]] static std::uint32_t node_of(const Cell& cell) {
    return static_cast<std::uint32_t>(cell.number >> (Space::kBrickLevels * D));
  }
  [[nodiscard]] static typename Brick::Place place_of(const Cell& cell) {
    typename Brick::Place cube;
    for (std::size_t a = 0; a < D; ++a)
      cube[a] = static_cast<int>(cell.lower[a] & (Brick::kEdge - 1)) >> kLevel;
    return cube;
  }
  /// Calls `visit(row, offsets)` for each row of a cube, with its offset in the cube on axes 1 and 2.
  template <class Visit>
  static void for_each_row(const typename Brick::Place& cube, const Visit& visit) {
    typename Brick::Place offset{};
    for (int i = 0; i < (D == 2 ? kEdge : kEdge * kEdge); ++i) {
      offset[1] = i % kEdge;
      offset[D - 1] = D == 2 ? i : i / kEdge;
      int row = cube[1] * kEdge + offset[1];
      if constexpr (D == 3) row += (cube[2] * kEdge + offset[2]) * Brick::kEdge;
      visit(row, offset);
    }
  }
  /// Which places on a side of a cell are passable, a bit each; all of them in what is no cube of a brick.
  [[nodiscard]] std::uint32_t face_of(const Cell& cell, std::size_t axis, int side) const {
    if (cell.edge != kEdge) return ~std::uint32_t{0};
    const auto& node = space_.nodes_[node_of(cell)];
    const typename Brick::Place cube = place_of(cell);
    const int at = side == 0 ? 0 : kEdge - 1;
    std::uint32_t face = 0;
    for_each_row(cube, [&](int row, const typename Brick::Place& offset) {
      std::uint32_t bits = space_.free_[node.below].row(row);
      if (space_.has_costs_) bits |= space_.costly_[node.below].row(row);
      bits = bits >> (cube[0] * kEdge) & kNibble;
      if (axis == 0)
        face = face << 1 | (bits >> at & 1u);
      else if (offset[axis] == at)
        face = face << kEdge | bits;
    });
    return face;
  }
  template <class Visit>
  void at_face(std::uint32_t number, const CellIndex<D>& index, const Face& face, const Visit& visit) {
    space_.visit(number, index);
    const auto node = space_.nodes_[number];
    if (node.state == State::divided) {
      for (unsigned j = 0; j < 1u << D; ++j)
        if (static_cast<int>(j >> face.axis & 1u) == face.side)
          at_face(node.below + j, Space::child(index, j), face, visit);
    } else if (node.state == State::brick) {
      constexpr int kCubes = Brick::kEdge / kEdge;
      for (int i = 0; i < (D == 2 ? kCubes : kCubes * kCubes); ++i) {
        typename Brick::Place cube;
        int rest = i;
        for (std::size_t a = 0; a < D; ++a) {
          cube[a] = a == face.axis ? face.side * (kCubes - 1) : rest % kCubes;
          if (a != face.axis) rest /= kCubes;
        }
        const Cell cell = cube_of(number, index, cube);
        if (cell.passage != Passage::blocked && face_of(cell, face.axis, face.side) != 0) visit(cell);
      }
    } else if (node.state != State::blocked) {
      visit(Space::node_cell(number, index, node.state));
    }
  }

  static constexpr std::uint32_t kNibble = (1u << kEdge) - 1;

  Space& space_;
};

/// Lengths of coarse ways to a goal: a search from there, as far as the start. Of cells that it did not come
/// to, all ways from the start through them are longer.
template <class Map>
class CoarseGuide {
 public:
  static constexpr int D = Map::kDim;
  using Cell = PlaceCell<D>;

  CoarseGuide(FreeSpace<Map>& space, double unknown_cost)
      : space_(space), search_(space_, unknown_cost, 1.0), has_costs_(space.has_costs()) {}

  /// Points in smallest cells.
  PathStatus run(const std::vector<Anchor<D>>& from, const std::vector<Anchor<D>>& to, const Vector<D>& start,
                 std::chrono::steady_clock::time_point deadline) {
    start_ = start;
    for (const Anchor<D>& anchor : to) search_.add_start(coarse(anchor));
    for (const Anchor<D>& anchor : from) search_.add_goal(coarse(anchor));
    const PathStatus status = search_.run(start, deadline);
    if (status == PathStatus::found) length_ = search_.length();
    return status;
  }
  /// Of the coarse way, in smallest cells.
  [[nodiscard]] double length() const { return length_; }
  [[nodiscard]] std::size_t expanded() const { return search_.expanded(); }
  [[nodiscard]] std::size_t memory_bytes() const { return search_.memory_bytes(); }
  /// As PathSearch's.
  template <class Visit>
  void for_each_expanded(const Visit& visit) const {
    search_.for_each_expanded(visit);
  }
  /// An estimate of what is left of the way from a point in a cell.
  [[nodiscard]] double left_from(const Cell& cell, const Vector<D>& point) {
    const std::uint64_t number = space_.cell_at(place_in(cell, point)).number;
    if (const auto left = search_.way_from(number, point, has_costs_)) return *left;
    return kBeyond * length_ - (point - start_).norm();
  }

 private:
  [[nodiscard]] Anchor<D> coarse(Anchor<D> anchor) {
    anchor.cell = space_.cell_at(place_in(anchor.cell, anchor.point));
    return anchor;
  }
  /// The smallest cell of one that holds a point of it.
  [[nodiscard]] static Lattice<D> place_in(const Cell& cell, const Vector<D>& point) {
    Lattice<D> at;
    for (std::size_t a = 0; a < D; ++a)
      at[a] = std::clamp(static_cast<std::int64_t>(std::floor(point[static_cast<int>(a)])), cell.lower[a],
                         cell.lower[a] + cell.edge - 1);
    return at;
  }

  /// Ways through cells that the coarse search has not come to are longer than its own; by how much is not
  /// known: a twentieth, so that they are looked at after the others.
  static constexpr double kBeyond = 1.05;

  CoarseSpace<Map> space_;
  PathSearch<CoarseSpace<Map>> search_;
  bool has_costs_;
  Vector<D> start_ = Vector<D>::Zero();
  double length_ = std::numeric_limits<double>::infinity();
};

}  // namespace ndtree::detail
