// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The places in a map where a body meets no obstacle, as cells that are as large as they can be.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "ndtree/cell/summary.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/body_stencil.hpp"
#include "ndtree/planning/brick.hpp"
#include "ndtree/query/cells.hpp"
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

/// The places where a body of one orientation meets no obstacle: a tree over the lattice of a map, divided by
/// two, whose lower levels are bricks of bits. A cell is free if the body meets nothing from any point of the
/// closed cell, which is exact for the body (BodyStencil), not for a ball around it. Nothing is built before
/// it is asked for: a node is looked at when a question first reaches it, so that a search pays for what it
/// touches. Changes of the map make the nodes around them unvisited again. Memory: 682 bytes for 4096
/// smallest cells (3-D) or 252 for 1024 (2-D) where places of both kinds lie side by side, nothing elsewhere.
template <class Map>
class FreeSpace {
 public:
  static constexpr int D = Map::kDim;
  using Cell = PlaceCell<D>;

  /// @param map outlives this, see set_map(). @param body in its orientation. @param unknown_cost of a metre
  /// in unknown space: infinite if it is an obstacle, 1 if it is free. @param around box that holds all
  /// places of interest; beyond it, no place is free.
  FreeSpace(const Map& map, const Body<D>& body, double unknown_cost, const Box<D>& around)
      : map_(&map),
        stencil_(body, map.tree().geometry().unit()),
        occupied_(stencil_),
        unknown_(stencil_),
        unknown_blocks_(!std::isfinite(unknown_cost)),
        unknown_costs_(std::isfinite(unknown_cost) && unknown_cost > 1.0) {
    const auto& geometry = map.tree().geometry();
    const Box<D> inside = bounds_of(body.front());
    for (std::size_t a = 0; a < D; ++a) {
      const int axis = static_cast<int>(a);
      limits_.lower[a] = geometry.coordinate(std::max(around.lower[axis], -geometry.reach()));
      limits_.upper[a] = geometry.coordinate(std::min(around.upper[axis], geometry.reach()));
      const double middle = 0.5 * (inside.lower[axis] + inside.upper[axis]) / geometry.unit();
      inside_lower_[a] = static_cast<std::int64_t>(std::floor(middle));
      inside_upper_[a] = static_cast<std::int64_t>(std::ceil(middle));
    }
    reset();
  }

  FreeSpace(const FreeSpace&) = delete;
  FreeSpace& operator=(const FreeSpace&) = delete;

  /// Places that may be free: all others are blocked.
  [[nodiscard]] const LatticeBox<D>& limits() const { return limits_; }
  [[nodiscard]] std::size_t memory_bytes() const {
    return nodes_.capacity() * sizeof(Node) + free_.capacity() * sizeof(Brick) +
           costly_.capacity() * sizeof(Brick);
  }
  [[nodiscard]] bool has_costs() const { return unknown_costs_; }

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
      if (node.state != State::divided)
        return {index.lower, std::int64_t{1} << index.level, passage_of(node.state), first_number(number)};
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
          at_face(number, index, face, visit);
      }
  }
  /// Calls `visit(cell)` for each cell that is not blocked and overlaps a box.
  template <class Visit>
  void for_each_in(const LatticeBox<D>& box, const Visit& visit) {
    for_each_in(0, root_, box, visit);
  }

  /// Obstacles, or what was none, came or went in a box: what depends on it is looked at again when it is
  /// asked for. @param map as it is now.
  void forget(const LatticeBox<D>& changed) {
    LatticeBox<D> places;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t inside_lower = std::min<std::int64_t>(-stencil_.upper()[a], -inside_upper_[a]);
      const std::int64_t inside_upper = std::max<std::int64_t>(-stencil_.lower()[a], -inside_lower_[a]);
      places.lower[a] = changed.lower[a] + inside_lower - 1;
      places.upper[a] = changed.upper[a] + inside_upper + 1;
    }
    last_brick_ = kNoNode;
    forget(0, root_, places);
  }
  /// Forgets everything.
  void reset() {
    nodes_.assign(1, Node{});
    last_brick_ = kNoNode;
    free_.clear();
    costly_.clear();
    unused_nodes_.clear();
    unused_bricks_.clear();
    // Two halves that lie where they would for any limits: so do all cells below.
    std::int64_t longest = 1;
    for (std::size_t a = 0; a < D; ++a) longest = std::max(longest, limits_.upper[a] - limits_.lower[a]);
    root_.level = kBrickLevels + 1;
    while (std::int64_t{1} << (root_.level - 1) < longest) ++root_.level;
    for (std::size_t a = 0; a < D; ++a) root_.lower[a] = floored(limits_.lower[a], root_.level - 1);
  }
  /// Another map with the same cells, of which forget() is told what is different.
  void set_map(const Map& map) { map_ = &map; }

 private:
  using Brick = detail::Brick<D>;
  using Place = typename Brick::Place;
  using Ref = typename Map::Tree::ConstRef;
  static constexpr int kBrickLevels = Brick::kLevels;
  static constexpr std::uint64_t kOutside = ~std::uint64_t{0};
  static constexpr std::uint32_t kNoNode = ~std::uint32_t{0};

  enum class State : std::uint8_t { unvisited, blocked, costly, free, divided, brick };
  struct Node {
    std::uint32_t below = 0;  // The first of 2^D children, or a brick.
    State state = State::unvisited;
  };
  /// What a box of the map contains.
  struct Contents {
    bool occupied = false;
    bool free = false;
    bool unknown = false;
  };

  [[nodiscard]] static std::int64_t floored(std::int64_t at, int level) { return (at >> level) << level; }
  [[nodiscard]] static Passage passage_of(State state) {
    return state == State::free ? Passage::free : state == State::costly ? Passage::costly : Passage::blocked;
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
  [[nodiscard]] static LatticeBox<D> box_of(const CellIndex<D>& index) {
    LatticeBox<D> box;
    for (std::size_t a = 0; a < D; ++a) {
      box.lower[a] = index.lower[a];
      box.upper[a] = index.lower[a] + (std::int64_t{1} << index.level);
    }
    return box;
  }

  [[nodiscard]] Cell cell_in_brick(std::uint32_t number, const Node& node, const CellIndex<D>& index,
                                   const Lattice<D>& at) const {
    Place place;
    for (std::size_t a = 0; a < D; ++a) place[a] = static_cast<int>(at[a] - index.lower[a]);
    for (const Passage passage : {Passage::free, Passage::costly}) {
      if (passage == Passage::costly && !unknown_costs_) break;
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
  /// Cells that are not blocked in a node, at one side of it.
  template <class Visit>
  void at_face(std::uint32_t number, const CellIndex<D>& index, const Face& face, const Visit& visit) {
    this->visit(number, index);
    const Node node = nodes_[number];
    if (node.state == State::divided) {
      for (unsigned j = 0; j < 1u << D; ++j)
        if (static_cast<int>(j >> face.axis & 1u) == face.side)
          at_face(node.below + j, child(index, j), face, visit);
    } else if (node.state == State::brick) {
      within_brick(number, node.below, index, kBrickLevels, Place{}, face, visit);
    } else if (node.state != State::blocked) {
      visit(Cell{index.lower, std::int64_t{1} << index.level, passage_of(node.state), first_number(number)});
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
      if (passage == Passage::costly && !unknown_costs_) break;
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
  template <class Visit>
  void within_brick(std::uint32_t number, std::uint32_t brick, const CellIndex<D>& index, int level,
                    const Place& place, const Face& face, const Visit& visit) const {
    if (free_[brick].get(level, place)) {
      visit(brick_cell(number, index, level, place, Passage::free));
    } else if (unknown_costs_ && costly_[brick].get(level, place)) {
      visit(brick_cell(number, index, level, place, Passage::costly));
    } else if (level > 0) {
      for (unsigned j = 0; j < 1u << D; ++j) {
        if (static_cast<int>(j >> face.axis & 1u) != face.side) continue;
        Place below;
        for (std::size_t a = 0; a < D; ++a) below[a] = 2 * place[a] + static_cast<int>(j >> a & 1u);
        within_brick(number, brick, index, level - 1, below, face, visit);
      }
    }
  }

  template <class Visit>
  void for_each_in(std::uint32_t number, const CellIndex<D>& index, const LatticeBox<D>& box,
                   const Visit& visit) {
    for (std::size_t a = 0; a < D; ++a)
      if (box.lower[a] >= index.lower[a] + (std::int64_t{1} << index.level) || box.upper[a] <= index.lower[a])
        return;
    this->visit(number, index);
    const Node node = nodes_[number];
    if (node.state == State::divided) {
      for (unsigned j = 0; j < 1u << D; ++j) for_each_in(node.below + j, child(index, j), box, visit);
    } else if (node.state == State::brick) {
      Place lower, upper;
      for (std::size_t a = 0; a < D; ++a) {
        lower[a] = static_cast<int>(std::max<std::int64_t>(box.lower[a] - index.lower[a], 0));
        upper[a] = static_cast<int>(std::min<std::int64_t>(box.upper[a] - index.lower[a], Brick::kEdge)) - 1;
      }
      for_each_in_brick(number, node.below, index, kBrickLevels, Place{}, lower, upper, visit);
    } else if (node.state != State::blocked) {
      visit(Cell{index.lower, std::int64_t{1} << index.level, passage_of(node.state), first_number(number)});
    }
  }
  template <class Visit>
  void for_each_in_brick(std::uint32_t number, std::uint32_t brick, const CellIndex<D>& index, int level,
                         const Place& place, const Place& lower, const Place& upper,
                         const Visit& visit) const {
    for (std::size_t a = 0; a < D; ++a)
      if (place[a] < lower[a] >> level || place[a] > upper[a] >> level) return;
    if (free_[brick].get(level, place)) {
      visit(brick_cell(number, index, level, place, Passage::free));
    } else if (unknown_costs_ && costly_[brick].get(level, place)) {
      visit(brick_cell(number, index, level, place, Passage::costly));
    } else if (level > 0) {
      for (unsigned j = 0; j < 1u << D; ++j) {
        Place below;
        for (std::size_t a = 0; a < D; ++a) below[a] = 2 * place[a] + static_cast<int>(j >> a & 1u);
        for_each_in_brick(number, brick, index, level - 1, below, lower, upper, visit);
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
    if (nodes_[number].state != State::unvisited) return;
    pace_.spend(30);
    if (const std::optional<State> state = state_of(index)) {
      nodes_[number].state = *state;
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

  /// That of all places of a node; none if they may differ.
  [[nodiscard]] std::optional<State> state_of(const CellIndex<D>& index) const {
    const LatticeBox<D> places = box_of(index);
    bool is_within = true;
    LatticeBox<D> touched, inside;
    for (std::size_t a = 0; a < D; ++a) {
      if (places.lower[a] >= limits_.upper[a] || places.upper[a] <= limits_.lower[a]) return State::blocked;
      is_within = is_within && places.lower[a] >= limits_.lower[a] && places.upper[a] <= limits_.upper[a];
      touched.lower[a] = places.lower[a] + stencil_.lower()[a];
      touched.upper[a] = places.upper[a] + stencil_.upper()[a];
      inside.lower[a] = places.lower[a] + inside_lower_[a];
      inside.upper[a] = places.upper[a] + inside_upper_[a];
    }
    const Contents all = contents_of(touched);
    if (!is_within) return std::nullopt;
    const bool touches_unknown = all.unknown && (unknown_blocks_ || unknown_costs_);
    if (!all.occupied && !touches_unknown) return State::free;
    if (all.free && all.unknown && all.occupied && index.level == kBrickLevels) return std::nullopt;
    const Contents core = contents_of(inside);
    if (!core.free && (unknown_blocks_ || !core.unknown)) return State::blocked;
    if (unknown_costs_ && !all.occupied && !core.free) return State::costly;
    return std::nullopt;
  }
  [[nodiscard]] Contents contents_of(const LatticeBox<D>& box) const {
    Contents contents;
    const auto& tree = map_->tree();
    const LatticeBox<D> root = box_of(tree, tree.root());
    for (std::size_t a = 0; a < D; ++a)
      contents.unknown = contents.unknown || box.lower[a] < root.lower[a] || box.upper[a] > root.upper[a];
    look(tree.root(), box, contents);
    return contents;
  }
  [[nodiscard]] static LatticeBox<D> box_of(const typename Map::Tree& tree, const Ref& ref) {
    LatticeBox<D> box;
    for (std::size_t a = 0; a < D; ++a) {
      box.lower[a] = ref.index.lower[a];
      box.upper[a] = ref.index.lower[a] + tree.geometry().edge(ref.index.level);
    }
    return box;
  }
  void look(const Ref& ref, const LatticeBox<D>& box, Contents& contents) const {
    const auto& tree = map_->tree();
    const LatticeBox<D> own = box_of(tree, ref);
    bool is_within = true;
    for (std::size_t a = 0; a < D; ++a) {
      if (own.lower[a] >= box.upper[a] || own.upper[a] <= box.lower[a]) return;
      is_within = is_within && own.lower[a] >= box.lower[a] && own.upper[a] <= box.upper[a];
    }
    const Summary summary = Summary::of(*ref.node);
    const Contents here{summary.may_contain(CellState::occupied), summary.may_contain(CellState::free),
                        summary.may_contain(CellState::unknown)};
    if ((contents.occupied || !here.occupied) && (contents.free || !here.free) &&
        (contents.unknown || !here.unknown))
      return;
    if (ref.is_leaf() || (is_within && summary.is_valid()) || here.occupied + here.free + here.unknown == 1) {
      contents.occupied = contents.occupied || here.occupied;
      contents.free = contents.free || here.free;
      contents.unknown = contents.unknown || here.unknown;
      return;
    }
    for (int j = 0; j < Map::Tree::kNumChildren; ++j) look(tree.child(ref, j), box, contents);
  }

  void build_brick(std::uint32_t number, const CellIndex<D>& index) {
    paint(index);
    Brick met;
    occupied_.spread(met);
    Brick free, costly;
    bool any = false;
    for (int r = 0; r < Brick::rows_of(0); ++r) {
      free.row(r) = static_cast<typename Brick::Row>(~met.row(r) & within_limits(index, r));
      any = any || free.row(r) != 0;
    }
    if (unknown_costs_ && any) {
      unknown_.spread(met);
      for (int r = 0; r < Brick::rows_of(0); ++r) {
        costly.row(r) = static_cast<typename Brick::Row>(free.row(r) & met.row(r));
        free.row(r) = static_cast<typename Brick::Row>(free.row(r) & ~met.row(r));
      }
      costly.close();
    }
    free.close();
    if (!any || free.get(kBrickLevels, Place{}) || costly.get(kBrickLevels, Place{})) {
      nodes_[number].state = !any                              ? State::blocked
                             : free.get(kBrickLevels, Place{}) ? State::free
                                                               : State::costly;
      return;
    }
    auto brick = static_cast<std::uint32_t>(free_.size());
    if (!unused_bricks_.empty()) {
      brick = unused_bricks_.back();
      unused_bricks_.pop_back();
    } else {
      free_.emplace_back();
      if (unknown_costs_) costly_.emplace_back();
    }
    free_[brick] = free;
    if (unknown_costs_) costly_[brick] = costly;
    nodes_[number] = {brick, State::brick};
  }
  /// The bits of a row that lie within the limits.
  [[nodiscard]] std::uint32_t within_limits(const CellIndex<D>& index, int row) const {
    for (std::size_t a = 1; a < D; ++a) {
      const std::int64_t at =
          index.lower[a] + (row >> (kBrickLevels * (static_cast<int>(a) - 1))) % Brick::kEdge;
      if (at < limits_.lower[a] || at >= limits_.upper[a]) return 0;
    }
    const std::int64_t first = std::clamp<std::int64_t>(limits_.lower[0] - index.lower[0], 0, Brick::kEdge);
    const std::int64_t last = std::clamp<std::int64_t>(limits_.upper[0] - index.lower[0], 0, Brick::kEdge);
    return static_cast<std::uint32_t>(((std::uint64_t{1} << last) - 1) & ~((std::uint64_t{1} << first) - 1));
  }

  /// Sets the bits of all obstacles that the body can meet from a brick.
  void paint(const CellIndex<D>& index) {
    occupied_.clear();
    if (unknown_costs_) unknown_.clear();
    LatticeBox<D> region;
    for (std::size_t a = 0; a < D; ++a) {
      region.lower[a] = index.lower[a] + stencil_.lower()[a];
      region.upper[a] = index.lower[a] + Brick::kEdge + stencil_.upper()[a];
    }
    const auto& tree = map_->tree();
    const LatticeBox<D> root = box_of(tree, tree.root());
    if (unknown_blocks_ || unknown_costs_) {  // All beyond the root is unknown.
      auto& bits = unknown_blocks_ ? occupied_ : unknown_;
      set(bits, region, region, true);
      set(bits, root, region, false);
    }
    paint(tree.root(), region);
  }
  static void set(detail::ObstacleBits<D>& bits, const LatticeBox<D>& box, const LatticeBox<D>& region,
                  bool to) {
    Place lower, upper;
    for (std::size_t a = 0; a < D; ++a) {
      const std::int64_t extent = region.upper[a] - region.lower[a];
      lower[a] = static_cast<int>(std::clamp<std::int64_t>(box.lower[a] - region.lower[a], 0, extent));
      upper[a] = static_cast<int>(std::clamp<std::int64_t>(box.upper[a] - region.lower[a], 0, extent));
    }
    bits.set(lower, upper, to);
  }
  void paint(const Ref& ref, const LatticeBox<D>& region) {
    const Summary summary = Summary::of(*ref.node);
    const bool occupied = summary.may_contain(CellState::occupied);
    const bool unknown = summary.may_contain(CellState::unknown) && (unknown_blocks_ || unknown_costs_);
    if (!occupied && !unknown) return;
    const auto& tree = map_->tree();
    if (!region.overlaps(ref.index, tree.geometry().edge(ref.index.level))) return;
    const bool is_alike = !summary.may_contain(CellState::free) && (unknown_blocks_ || occupied != unknown) &&
                          (unknown_blocks_ || unknown_costs_ || !summary.may_contain(CellState::unknown));
    if (ref.is_leaf() || is_alike) {
      set(occupied || unknown_blocks_ ? occupied_ : unknown_, box_of(tree, ref), region, true);
      return;
    }
    for (int j = 0; j < Map::Tree::kNumChildren; ++j) paint(tree.child(ref, j), region);
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

  const Map* map_;
  detail::BodyStencil<D> stencil_;
  detail::ObstacleBits<D> occupied_;
  detail::ObstacleBits<D> unknown_;
  bool unknown_blocks_;
  bool unknown_costs_;
  LatticeBox<D> limits_;
  Lattice<D> inside_lower_, inside_upper_;  // Cells from a place to some point in the body.
  CellIndex<D> root_;                       // Its level counts halvings, from smallest cells up.
  std::vector<Node> nodes_;
  std::vector<Brick> free_;
  std::vector<Brick> costly_;
  std::uint32_t last_brick_ = kNoNode;  // Where the last cell was looked for: the next is likely there.
  CellIndex<D> last_index_;
  std::vector<std::uint32_t> unused_nodes_;
  std::vector<std::uint32_t> unused_bricks_;
  Pace pace_;
};

}  // namespace ndtree
