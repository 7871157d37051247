// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a map says of the places of a body: for a cube at once, or for each smallest cell of a brick.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/cell/thin_things.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/planning/body_stencil.hpp"
#include "ndtree/planning/brick.hpp"
#include "ndtree/planning/place_cell.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

namespace detail {

/// Finds where a body may be. Cubes are told by their index, whose level counts halvings from smallest cells
/// up.
template <class Map>
class PlaceFinder {
 public:
  static constexpr int D = Map::kDim;
  using Brick = detail::Brick<D>;

  /// As FreeSpace.
  PlaceFinder(const Map& map, const Body<D>& body, double unknown_cost, const Box<D>& around, Touches touches)
      : map_(&map),
        thin_(map),
        stencil_(body, map.tree().geometry().unit(), touches),
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
      const double half = half_cube_in(body.front()) / geometry.unit();
      core_lower_[a] = static_cast<std::int64_t>(std::ceil(middle - half));
      core_upper_[a] = static_cast<std::int64_t>(std::floor(middle + half));
    }
  }
  PlaceFinder(const PlaceFinder&) = delete;
  PlaceFinder& operator=(const PlaceFinder&) = delete;

  void set_map(const Map& map) {
    map_ = &map;
    thin_ = ThinThings(map);
  }
  /// Places that may be free: all others are blocked.
  [[nodiscard]] const LatticeBox<D>& limits() const { return limits_; }
  [[nodiscard]] bool has_costs() const { return unknown_costs_; }
  /// The places for which it matters what is in a box.
  [[nodiscard]] LatticeBox<D> places_meeting(const LatticeBox<D>& box) const {
    LatticeBox<D> places;
    for (std::size_t a = 0; a < D; ++a) {
      places.lower[a] = box.lower[a] + std::min<std::int64_t>(-stencil_.upper()[a], -inside_upper_[a]) - 1;
      places.upper[a] = box.upper[a] + std::max<std::int64_t>(-stencil_.lower()[a], -inside_lower_[a]) + 1;
    }
    return places;
  }

  /// That of all places of a node; none if they may differ.
  [[nodiscard]] std::optional<Passage> passage_of(const CellIndex<D>& index) const {
    const LatticeBox<D> places = box_of(index);
    bool is_within = true;
    LatticeBox<D> touched, inside, covered;  // Covered by the body wherever it stands.
    bool covers = true;
    for (std::size_t a = 0; a < D; ++a) {
      if (places.lower[a] >= limits_.upper[a] || places.upper[a] <= limits_.lower[a]) return Passage::blocked;
      is_within = is_within && places.lower[a] >= limits_.lower[a] && places.upper[a] <= limits_.upper[a];
      touched.lower[a] = places.lower[a] + stencil_.lower()[a];
      touched.upper[a] = places.upper[a] + stencil_.upper()[a];
      inside.lower[a] = places.lower[a] + inside_lower_[a];
      inside.upper[a] = places.upper[a] + inside_upper_[a];
      covered.lower[a] = places.upper[a] + core_lower_[a];
      covered.upper[a] = places.lower[a] + core_upper_[a];
      covers = covers && covered.lower[a] < covered.upper[a];
    }
    if (covers) {
      const Contents core = contents_of(covered);
      if (core.occupied || (core.unknown && unknown_blocks_)) return Passage::blocked;
    }
    const Contents all = contents_of(touched);
    if (!is_within) return std::nullopt;
    const bool touches_unknown = all.unknown && (unknown_blocks_ || unknown_costs_);
    if (!all.occupied && !touches_unknown) return Passage::free;
    if (all.free && all.unknown && all.occupied && index.level == Brick::kLevels) return std::nullopt;
    const Contents core = contents_of(inside);
    if (!core.free && (unknown_blocks_ || !core.unknown)) return Passage::blocked;
    if (unknown_costs_ && !all.occupied && !core.free) return Passage::costly;
    return std::nullopt;
  }
  /// That of all places of a brick; none if they differ. Then it sets the bits of free and of costly places.
  std::optional<Passage> find(const CellIndex<D>& index, Brick& free, Brick& costly) {
    paint(index);
    Brick met;
    occupied_.spread(met);
    bool any = false;
    for (int r = 0; r < Brick::rows_of(0); ++r) {
      free.row(r) = static_cast<typename Brick::Row>(~met.row(r) & within_limits(index, r));
      any = any || free.row(r) != 0;
    }
    if (!any) return Passage::blocked;
    if (unknown_costs_) {
      unknown_.spread(met);
      for (int r = 0; r < Brick::rows_of(0); ++r) {
        costly.row(r) = static_cast<typename Brick::Row>(free.row(r) & met.row(r));
        free.row(r) = static_cast<typename Brick::Row>(free.row(r) & ~met.row(r));
      }
      costly.close();
    }
    free.close();
    if (free.get(Brick::kLevels, Place{})) return Passage::free;
    if (costly.get(Brick::kLevels, Place{})) return Passage::costly;
    return std::nullopt;
  }

 private:
  using Place = typename Brick::Place;
  using Ref = typename Map::Tree::ConstRef;
  /// Half the edge of the largest cube along the axes in a part, around the middle of its bounds.
  [[nodiscard]] static double half_cube_in(const BodyPart<D>& part) {
    if (const auto* const capsule = std::get_if<Capsule<D>>(&part))
      return capsule->radius / std::sqrt(double{D});
    const auto& box = std::get<OrientedBox<D>>(part);
    return (box.half_size.array() / box.axes.cwiseAbs().colwise().sum().transpose().array()).minCoeff();
  }
  /// What a box of the map contains.
  struct Contents {
    bool occupied = false;
    bool free = false;
    bool unknown = false;
  };

  [[nodiscard]] static LatticeBox<D> box_of(const CellIndex<D>& index) {
    LatticeBox<D> box;
    for (std::size_t a = 0; a < D; ++a) {
      box.lower[a] = index.lower[a];
      box.upper[a] = index.lower[a] + (std::int64_t{1} << index.level);
    }
    return box;
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
    const bool is_thin = may_be_thin(ref, summary);
    const Contents here{is_thin || summary.may_contain(CellState::occupied),
                        summary.may_contain(CellState::free) && !(is_thin && ref.is_leaf()),
                        summary.may_contain(CellState::unknown)};
    if ((contents.occupied || !here.occupied) && (contents.free || !here.free) &&
        (contents.unknown || !here.unknown))
      return;
    const bool is_certain = is_within && summary.is_valid() && !is_thin;
    if (ref.is_leaf() || is_certain || here.occupied + here.free + here.unknown == 1) {
      contents.occupied = contents.occupied || here.occupied;
      contents.free = contents.free || here.free;
      contents.unknown = contents.unknown || here.unknown;
      return;
    }
    for (int j = 0; j < Map::Tree::kNumChildren; ++j) look(tree.child(ref, j), box, contents);
  }

  /// Whether a leaf holds something thin, or an inner node might have such a leaf beside free ones.
  [[nodiscard]] bool may_be_thin(const Ref& ref, const Summary& summary) const {
    if (ref.is_leaf()) return thin_.are_in(ref.cell());
    return thin_.may_be_below(summary);
  }

  /// The bits of a row that lie within the limits.
  [[nodiscard]] std::uint32_t within_limits(const CellIndex<D>& index, int row) const {
    for (std::size_t a = 1; a < D; ++a) {
      const std::int64_t at =
          index.lower[a] + (row >> (Brick::kLevels * (static_cast<int>(a) - 1))) % Brick::kEdge;
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
  static void set(ObstacleBits<D>& bits, const LatticeBox<D>& box, const LatticeBox<D>& region, bool to) {
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
    const bool occupied = summary.may_contain(CellState::occupied) || may_be_thin(ref, summary);
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

  const Map* map_;
  ThinThings thin_;
  BodyStencil<D> stencil_;
  ObstacleBits<D> occupied_;
  ObstacleBits<D> unknown_;
  bool unknown_blocks_;
  bool unknown_costs_;
  LatticeBox<D> limits_;
  Lattice<D> inside_lower_, inside_upper_;  // Cells from a place to some point in the body.
  Lattice<D> core_lower_, core_upper_;      // And to a cube in it.
};

}  // namespace detail
}  // namespace ndtree
