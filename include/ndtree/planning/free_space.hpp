// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The places in a map where a body meets no obstacle, as cells that are as large as they can be.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/brick.hpp"
#include "ndtree/planning/place_cell.hpp"
#include "ndtree/planning/place_finder.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

namespace detail {
template <class Map>
class CoarseSpace;
}  // namespace detail

/// The places where a body of one orientation meets no obstacle: a tree over the lattice of a map, divided by
/// two, whose lower levels are bricks of bits. A cell is free if the body meets nothing from any point of the
/// closed cell, which is exact for the body (BodyStencil), not for a ball around it. Nothing is built before
/// it is asked for: a node is looked at when a question first reaches it, so that a search pays for what it
/// touches. Changes of the map make the nodes around them unvisited again. Memory: 722 bytes for 4096
/// smallest cells (3-D) or 284 for 1024 (2-D) where places of both kinds lie side by side, nothing elsewhere.
template <class Map>
class FreeSpace {
 public:
  static constexpr int D = Map::kDim;
  using Cell = PlaceCell<D>;
  static constexpr bool kHasWalls = false;   ///< Cells that share a face are always joined.
  static constexpr bool kTestsWays = false;  ///< A way through a side that cells share is free.
  static constexpr detail::Sight kSight = detail::Sight::cells_and_walk;

  /// @param map outlives this, see set_map(). @param body in its orientation. @param unknown_cost of a metre
  /// in unknown space: infinite if it is an obstacle, 1 if it is free. @param around box that holds all
  /// places of interest; beyond it, no place is free. @param touches from_each: a cell is also free if the
  /// body may meet nothing from some place in it: then this has all places that are free, and more.
  FreeSpace(const Map& map, const Body<D>& body, double unknown_cost, const Box<D>& around,
            detail::Touches touches = detail::Touches::from_some)
      : finder_(map, body, unknown_cost, around, touches),
        limits_(finder_.limits()),
        has_costs_(finder_.has_costs()) {
    reset();
  }

  FreeSpace(const FreeSpace&) = delete;
  FreeSpace& operator=(const FreeSpace&) = delete;

  /// Places that may be free: all others are blocked.
  [[nodiscard]] const LatticeBox<D>& limits() const { return limits_; }
  [[nodiscard]] std::size_t memory_bytes() const {
    return nodes_.capacity() * sizeof(Node) + free_.capacity() * sizeof(Brick) +
           costly_.capacity() * sizeof(Brick) + cubes_.capacity() * sizeof(Cubes);
  }
  [[nodiscard]] bool has_costs() const { return has_costs_; }

  /// The cell that contains a smallest cell.
  [[nodiscard]] Cell cell_at(const Lattice<D>& at) {
    if (last_brick_ != kNoNode && is_in(at, last_index_))
      return cell_in_brick(last_brick_, nodes_[last_brick_], last_index_, at);
    if (!is_inside(at)) return {at, 1, Passage::blocked, kOutside};
    std::uint32_t number = 0;
    CellIndex<D> index = root_;
    for (;;) {
      visit(number, index);
      const Node node = nodes_[number];
      if (node.state == State::brick) {
        last_brick_ = number;
        last_index_ = index;
        return cell_in_brick(number, node, index, at);
      }
      if (node.state != State::divided) return node_cell(number, index, node.state);
      number = child_towards(node, index, at);
    }
  }

  /// Calls `visit(cell)` for each cell that is not blocked and shares a face, or part of it, with a cell.
  /// O(cells beside), and the depth of the tree for sides at which a brick ends.
  template <class Visit>
  void for_each_beside(const Cell& cell, const Visit& visit) {
    const int level = level_of(cell.edge);
    const auto own = static_cast<std::uint32_t>(cell.number >> (kBrickLevels * D));
    for (std::size_t a = 0; a < D; ++a)
      for (const int side : {0, 1}) {
        CellIndex<D> other{cell.lower, level};  // As large, on that side.
        other.lower[a] += side == 0 ? -cell.edge : cell.edge;
        const Face face{a, 1 - side};
        if (level < kBrickLevels &&
            floored(other.lower[a], kBrickLevels) == floored(cell.lower[a], kBrickLevels)) {
          at_face_in_brick(own, brick_index(other.lower), level, other.lower, face, visit);
          continue;
        }
        std::uint32_t number = 0;
        CellIndex<D> index = root_;
        if (!is_in(other.lower, root_)) continue;
        this->visit(number, index);
        while (nodes_[number].state == State::divided && index.level > level) {
          number = child_towards(nodes_[number], index, other.lower);
          this->visit(number, index);
        }
        if (nodes_[number].state == State::brick && level < kBrickLevels)
          at_face_in_brick(number, index, level, other.lower, face, visit);
        else
          descend(number, index, face, visit);
      }
  }
  /// Calls `visit(cell)` for each cell that is not blocked and overlaps a box.
  template <class Visit>
  void for_each_in(const LatticeBox<D>& box, const Visit& visit) {
    if (box.overlaps(root_, std::int64_t{1} << root_.level)) descend(0, root_, Within{box}, visit);
  }
  /// A cube that holds all places that may be free.
  [[nodiscard]] const CellIndex<D>& root() const { return root_; }
  /// Whether the body is free nowhere in a cube, or none of its places may be free; as far as one look at the
  /// map tells. Builds nothing.
  [[nodiscard]] bool is_blocked(const CellIndex<D>& cube) const {
    return finder_.passage_of(cube) == Passage::blocked;
  }

  /// Obstacles, or what was none, came or went in a box: what depends on it is looked at again when it is
  /// asked for.
  void forget(const LatticeBox<D>& changed) {
    const LatticeBox<D> places = finder_.places_meeting(changed);
    last_brick_ = kNoNode;
    forget(0, root_, places);
  }
  /// Forgets everything.
  void reset() {
    nodes_.assign(1, Node{});
    last_brick_ = kNoNode;
    free_.clear();
    costly_.clear();
    cubes_.clear();
    unused_nodes_.clear();
    unused_bricks_.clear();
    // Two halves that lie where they would for any limits: so do all cells below.
    std::int64_t longest = 1;
    for (std::size_t a = 0; a < D; ++a) longest = std::max(longest, limits_.upper[a] - limits_.lower[a]);
    root_.level = kBrickLevels + 1;
    while (std::int64_t{1} << (root_.level - 1) < longest) ++root_.level;
    for (std::size_t a = 0; a < D; ++a) root_.lower[a] = floored(limits_.lower[a], root_.level - 1);
  }
  /// Takes another map with the same cells; forget() is told what differs.
  void set_map(const Map& map) { finder_.set_map(map); }

 private:
  friend class detail::CoarseSpace<Map>;
  using Brick = detail::Brick<D>;
  using Cubes = detail::CubeBits<D>;
  using Place = typename Brick::Place;
  static constexpr int kBrickLevels = Brick::kLevels;
  static constexpr std::uint64_t kOutside = ~std::uint64_t{0};
  static constexpr std::uint32_t kNoNode = ~std::uint32_t{0};

  enum class State : std::uint8_t { unvisited, blocked, costly, free, divided, brick };
  struct Node {
    std::uint32_t below = 0;  // The first of 2^D children, or a brick.
    State state = State::unvisited;
  };
  [[nodiscard]] static std::int64_t floored(std::int64_t at, int level) {
    return at & -(std::int64_t{1} << level);
  }
  [[nodiscard]] static Passage passage_of(State state) {
    return state == State::free ? Passage::free : state == State::costly ? Passage::costly : Passage::blocked;
  }
  [[nodiscard]] static State state_of(Passage passage) {
    return passage == Passage::free     ? State::free
           : passage == Passage::costly ? State::costly
                                        : State::blocked;
  }
  [[nodiscard]] static std::uint64_t first_number(std::uint32_t node) {
    return std::uint64_t{node} << (kBrickLevels * D);
  }
  [[nodiscard]] bool is_inside(const Lattice<D>& at) const {
    for (std::size_t a = 0; a < D; ++a)
      if (at[a] < limits_.lower[a] || at[a] >= limits_.upper[a]) return false;
    return true;
  }
  [[nodiscard]] static std::uint32_t child_towards(const Node& node, CellIndex<D>& index,
                                                   const Lattice<D>& at) {
    --index.level;
    std::uint32_t child = node.below;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t border = index.lower[a] + (std::int64_t{1} << index.level);
      if (at[a] < border) continue;
      child += 1u << a;
      index.lower[a] = border;
    }
    return child;
  }
  [[nodiscard]] static Cell node_cell(std::uint32_t number, const CellIndex<D>& index, State state) {
    return {index.lower, std::int64_t{1} << index.level, passage_of(state), first_number(number)};
  }
  [[nodiscard]] Cell cell_in_brick(std::uint32_t number, const Node& node, const CellIndex<D>& index,
                                   const Lattice<D>& at) const {
    Place place;
    for (std::size_t a = 0; a < D; ++a) place[a] = static_cast<int>(at[a] - index.lower[a]);
    for (const Passage passage : {Passage::free, Passage::costly}) {
      if (passage == Passage::costly && !has_costs_) break;
      const Brick& brick = (passage == Passage::free ? free_ : costly_)[node.below];
      if (!brick.get(0, place)) continue;
      int level = 0;
      while (level < kBrickLevels && brick.get(level + 1, shifted(place, level + 1))) ++level;
      return brick_cell(number, index, level, shifted(place, level), passage);
    }
    return {at, 1, Passage::blocked, kOutside};
  }
  [[nodiscard]] static Place shifted(Place place, int by) {
    for (int& x : place) x >>= by;
    return place;
  }
  [[nodiscard]] static Cell brick_cell(std::uint32_t number, const CellIndex<D>& index, int level,
                                       const Place& place, Passage passage) {
    Cell cell{index.lower, std::int64_t{1} << level, passage, 0};
    std::uint64_t local = 0;
    for (std::size_t a = D; a-- > 0;) {
      cell.lower[a] += std::int64_t{place[a]} << level;
      local = (local << kBrickLevels) + (static_cast<std::uint64_t>(place[a]) << level);
    }
    cell.number = first_number(number) + local;
    return cell;
  }

  /// A side of a node: axis, and 0 for the lower or 1 for the upper one.
  struct Face {
    std::size_t axis;
    int side;
    [[nodiscard]] bool keeps(const CellIndex<D>&, unsigned j) const {
      return static_cast<int>(j >> axis & 1u) == side;
    }
  };
  struct All {
    [[nodiscard]] bool keeps(const CellIndex<D>&, unsigned) const { return true; }
  };
  struct Within {
    const LatticeBox<D>& box;
    [[nodiscard]] bool keeps(const CellIndex<D>& part, unsigned) const {
      return box.overlaps(part, std::int64_t{1} << part.level);
    }
  };
  [[nodiscard]] static int level_of(std::int64_t edge) {
    int level = 0;
    while (edge >> level > 1) ++level;
    return level;
  }
  [[nodiscard]] static CellIndex<D> brick_index(Lattice<D> at) {
    for (std::int64_t& x : at) x = floored(x, kBrickLevels);
    return {at, kBrickLevels};
  }
  [[nodiscard]] static bool is_in(const Lattice<D>& at, const CellIndex<D>& index) {
    for (std::size_t a = 0; a < D; ++a)
      if (at[a] < index.lower[a] || at[a] >= index.lower[a] + (std::int64_t{1} << index.level)) return false;
    return true;
  }
  /// Calls `visit(cell)` for each cell that is not blocked, in a node and those parts of it that a filter
  /// keeps: `keeps(part, its child number)`.
  template <class Filter, class Visit>
  void descend(std::uint32_t number, const CellIndex<D>& index, const Filter& filter, const Visit& visit) {
    this->visit(number, index);
    const Node node = nodes_[number];
    if (node.state == State::divided) {
      for (unsigned j = 0; j < 1u << D; ++j)
        if (const CellIndex<D> below = child(index, j); filter.keeps(below, j))
          descend(node.below + j, below, filter, visit);
    } else if (node.state == State::brick) {
      within_brick(number, node.below, index, kBrickLevels, Place{}, filter, visit);
    } else if (node.state != State::blocked) {
      visit(node_cell(number, index, node.state));
    }
  }
  /// In a part of a brick, a cube of a level; or the larger cell that the part belongs to.
  template <class Visit>
  void at_face_in_brick(std::uint32_t number, const CellIndex<D>& index, int level, const Lattice<D>& lower,
                        const Face& face, const Visit& visit) const {
    const std::uint32_t brick = nodes_[number].below;
    Place place;
    for (std::size_t a = 0; a < D; ++a) place[a] = static_cast<int>(lower[a] - index.lower[a]) >> level;
    for (const Passage passage : {Passage::free, Passage::costly}) {
      if (passage == Passage::costly && !has_costs_) break;
      const Brick& bits = (passage == Passage::free ? free_ : costly_)[brick];
      if (!bits.get(level, place)) continue;
      while (level < kBrickLevels && bits.get(level + 1, shifted(place, 1))) {
        ++level;
        place = shifted(place, 1);
      }
      visit(brick_cell(number, index, level, place, passage));
      return;
    }
    within_brick(number, brick, index, level, place, face, visit);
  }
  template <class Filter, class Visit>
  void within_brick(std::uint32_t number, std::uint32_t brick, const CellIndex<D>& index, int level,
                    const Place& place, const Filter& filter, const Visit& visit) const {
    if (free_[brick].get(level, place)) {
      visit(brick_cell(number, index, level, place, Passage::free));
    } else if (has_costs_ && costly_[brick].get(level, place)) {
      visit(brick_cell(number, index, level, place, Passage::costly));
    } else if (level > 0) {
      for (unsigned j = 0; j < 1u << D; ++j) {
        Place below;
        for (std::size_t a = 0; a < D; ++a) below[a] = 2 * place[a] + static_cast<int>(j >> a & 1u);
        const CellIndex<D> part{brick_cell(number, index, level - 1, below, Passage::free).lower, level - 1};
        if (filter.keeps(part, j)) within_brick(number, brick, index, level - 1, below, filter, visit);
      }
    }
  }

  [[nodiscard]] static CellIndex<D> child(CellIndex<D> index, unsigned j) {
    --index.level;
    for (std::size_t a = 0; a < D; ++a) index.lower[a] += std::int64_t{j >> a & 1u} << index.level;
    return index;
  }

  /// Finds out what a node is.
  void visit(std::uint32_t number, const CellIndex<D>& index) {
    if (nodes_[number].state == State::unvisited) find_out(number, index);
  }
  void find_out(std::uint32_t number, const CellIndex<D>& index) {
    pace_.spend(30);
    if (const std::optional<Passage> passage = finder_.passage_of(index)) {
      nodes_[number].state = state_of(*passage);
    } else if (index.level == kBrickLevels) {
      build_brick(number, index);
    } else {
      const std::uint32_t below = allocate_nodes();
      nodes_[number] = {below, State::divided};
    }
  }
  [[nodiscard]] std::uint32_t allocate_nodes() {
    if (!unused_nodes_.empty()) {
      const std::uint32_t first = unused_nodes_.back();
      unused_nodes_.pop_back();
      return first;
    }
    const auto first = static_cast<std::uint32_t>(nodes_.size());
    nodes_.resize(nodes_.size() + (std::size_t{1} << D));
    return first;
  }

  void build_brick(std::uint32_t number, const CellIndex<D>& index) {
    Brick free, costly;
    if (const auto passage = finder_.find(index, free, costly)) {
      nodes_[number].state = state_of(*passage);
      return;
    }
    auto brick = static_cast<std::uint32_t>(free_.size());
    if (!unused_bricks_.empty()) {
      brick = unused_bricks_.back();
      unused_bricks_.pop_back();
    } else {
      free_.emplace_back();
      cubes_.emplace_back();
      if (has_costs_) costly_.emplace_back();
    }
    free_[brick] = free;
    if (has_costs_) {
      costly_[brick] = costly;
      for (int r = 0; r < Brick::rows_of(0); ++r) costly.row(r) |= free.row(r);
    }
    cubes_[brick] = Cubes::of(free, has_costs_ ? costly : free);
    nodes_[number] = {brick, State::brick};
  }
  void forget(std::uint32_t number, const CellIndex<D>& index, const LatticeBox<D>& places) {
    Node& node = nodes_[number];
    if (node.state == State::unvisited || !places.overlaps(index, std::int64_t{1} << index.level)) return;
    if (node.state != State::divided) {
      if (node.state == State::brick) unused_bricks_.push_back(node.below);
      node = Node{};
      return;
    }
    bool are_unvisited = true;
    for (unsigned j = 0; j < 1u << D; ++j) {
      forget(node.below + j, child(index, j), places);
      are_unvisited = are_unvisited && nodes_[node.below + j].state == State::unvisited;
    }
    if (!are_unvisited) return;
    unused_nodes_.push_back(node.below);
    node = Node{};
  }

  detail::PlaceFinder<Map> finder_;
  LatticeBox<D> limits_;
  bool has_costs_;
  CellIndex<D> root_;  // Its level counts halvings, from smallest cells up.
  std::vector<Node> nodes_;
  std::vector<Brick> free_;
  std::vector<Brick> costly_;
  std::vector<Cubes> cubes_;
  std::uint32_t last_brick_ = kNoNode;  // Where the last cell was looked for: the next is likely there.
  CellIndex<D> last_index_;
  std::vector<std::uint32_t> unused_nodes_;
  std::vector<std::uint32_t> unused_bricks_;
  Pace pace_;
};

}  // namespace ndtree
