// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Where free space ends and unknown space begins.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Free cells beside each other that border on unknown space.
template <int D>
struct Frontier {
  std::vector<Box<D>> cells;             ///< The free ones, of any size.
  double area = 0.0;                     ///< Of the border: [m] in 2-D, [m²] in 3-D.
  Vector<D> center = Vector<D>::Zero();  ///< Of the border [m], not always on it: drive to one of the cells.
  Vector<D> direction = Vector<D>::Zero();  ///< Into the unknown, of length 1; 0 if it is on all sides.
};

namespace detail {

/// The face that two boxes share, if they do not overlap and it has an area.
template <int D>
struct SharedFace {
  double area = 0.0;
  Vector<D> center = Vector<D>::Zero();
  int axis = 0;
  bool is_upper = false;  ///< Of the first.

  SharedFace(const Box<D>& box, const Box<D>& other) {
    int touching = 0;
    double product = 1.0;
    for (int a = 0; a < D; ++a) {
      const double lower = std::max(box.lower[a], other.lower[a]);
      const double upper = std::min(box.upper[a], other.upper[a]);
      center[a] = 0.5 * (lower + upper);
      if (upper > lower) {
        product *= upper - lower;
        continue;
      }
      ++touching;
      axis = a;
      is_upper = other.lower[a] >= box.upper[a];
    }
    if (touching == 1) area = product;
  }
};

/// How a free cell borders on unknown space.
template <int D>
struct FrontierBorder {
  double area = 0.0;
  Vector<D> center = Vector<D>::Zero();  // Times the area, as the direction.
  Vector<D> direction = Vector<D>::Zero();

  void add(const Box<D>& free, const Box<D>& unknown) {
    const SharedFace<D> face(free, unknown);
    if (!(face.area > 0.0)) return;
    area += face.area;
    center += face.area * face.center;
    direction[face.axis] += face.is_upper ? face.area : -face.area;
  }
};

}  // namespace detail

/// The frontiers of a map, which follow it: update() looks only at what has changed since, and at frontiers
/// that this touches.
template <class Map>
class FrontierSearch {
  static constexpr int D = Map::kDim;

 public:
  /// @param box free cells that share a point with it count; none: all.
  /// @throws std::invalid_argument if the box is upside down. O(cells log cells).
  explicit FrontierSearch(const Map& map, const std::optional<Box<D>>& box = std::nullopt)
      : seen_(map.snapshot()) {
    if (box && !(box->lower.array() <= box->upper.array()).all())
      throw std::invalid_argument("box: its lower corner must not lie above the upper one");
    if (box) box_ = seen_.tree().geometry().on_borders(*box);
    add_all();
  }

  /// The frontiers of the map as it is now. O(what was written since the map was last looked at, and cells of
  /// the frontiers near it). @param map that this was made of, or a copy that has changed.
  /// @throws std::invalid_argument if the cells of the maps have other sizes: nothing has changed;
  /// std::bad_alloc,
  ///   Cancelled: there are no frontiers then until a next update, which begins anew.
  void update(const Map& map) {
    detail::check_same_cells(seen_, map);
    try {
      if (is_broken_) {
        seen_ = map.snapshot();
        add_all();
      } else {
        follow(map);
      }
      is_broken_ = false;
    } catch (...) {
      is_broken_ = true;
      cells_.clear();
      unused_.clear();
      numbers_.clear();
      clusters_.clear();
      unused_clusters_.clear();
      throw;
    }
  }

  /// All of them, the largest first. Cells that share a point belong together.
  /// @param min_cells frontiers whose border is smaller than this many faces of smallest cells are left out.
  /// @throws std::invalid_argument if min_cells is negative.
  [[nodiscard]] std::vector<Frontier<D>> frontiers(double min_cells = 8.0) const {
    if (!(min_cells >= 0.0))
      throw std::invalid_argument("min_cells = " + describe_number(min_cells) + ": must be >= 0");
    const double least = min_cells * std::pow(seen_.tree().geometry().unit(), D - 1) * (1.0 - 1e-9);
    std::vector<const Cluster*> chosen;
    for (const Cluster& cluster : clusters_)
      if (!cluster.cells.empty() && !(cluster.border.area < least)) chosen.push_back(&cluster);
    std::stable_sort(chosen.begin(), chosen.end(),
                     [](const Cluster* a, const Cluster* b) { return a->border.area > b->border.area; });
    std::vector<Frontier<D>> all;
    all.reserve(chosen.size());
    for (const Cluster* const cluster : chosen) all.push_back(frontier_of(*cluster));
    return all;
  }

 private:
  using Number = std::uint32_t;
  static constexpr Number kNone = static_cast<Number>(-1);
  static constexpr std::size_t kSteps = 32;  // Of Pace, for a cell's surroundings.

  /// A free cell at the border; one that is gone has no area.
  struct Cell {
    CellIndex<D> index;
    Number cluster = kNone;
    detail::FrontierBorder<D> border;
    std::vector<Number> beside;  // Those that share a point with it.
  };
  struct Cluster {
    std::vector<Number> cells;  // None if it is gone.
    detail::FrontierBorder<D> border;
  };
  struct Hash {
    std::size_t operator()(const CellIndex<D>& index) const {
      std::uint64_t hash = static_cast<std::uint64_t>(index.level);
      for (const std::int64_t coordinate : index.lower)
        hash = (hash ^ static_cast<std::uint64_t>(coordinate)) * 0x9e3779b97f4a7c15u;
      return static_cast<std::size_t>(hash ^ hash >> 32);
    }
  };

  static RegionStates only(bool free) {
    RegionStates states;
    (free ? states.free : states.unknown) = true;
    return states;
  }
  [[nodiscard]] Box<D> box_of(const Cell& cell) const { return seen_.tree().box(cell.index); }
  [[nodiscard]] double margin() const { return 0.5 * seen_.tree().geometry().unit(); }

  void add_all() {
    const Box<D> root = seen_.tree().box(seen_.tree().root().index);
    std::vector<CellIndex<D>> free;
    std::vector<Box<D>> boxes;
    Box<D> around = root;
    for_each_leaf_of(seen_, box_ ? *box_ : root, only(true), [&](const auto& leaf) {
      free.push_back(leaf.index);
      boxes.push_back(seen_.tree().box(leaf.index));
      if (boxes.size() == 1) around = boxes[0];
      around = {around.lower.cwiseMin(boxes.back().lower), around.upper.cwiseMax(boxes.back().upper)};
    });
    around.lower.array() -= margin();
    around.upper.array() += margin();
    const BoxTree<D> beyond(boxes_of(seen_, around, only(false)));
    std::vector<Box<D>> at_border;
    for_each_paced(free.size(), kSteps, [&](std::size_t i) {
      detail::FrontierBorder<D> border;
      beyond.for_each_touching(boxes[i],
                               [&](std::uint32_t number) { border.add(boxes[i], beyond.box(number)); });
      if (!(border.area > 0.0)) return;
      (void)make(free[i], border);
      at_border.push_back(boxes[i]);
    });
    const BoxTree<D> places(at_border);
    for_each_paced(at_border.size(), kSteps, [&](std::size_t i) {
      places.for_each_touching(at_border[i], [&](std::uint32_t number) {
        if (places.index(number) != i) cells_[i].beside.push_back(static_cast<Number>(places.index(number)));
      });
    });
    for (Number i = 0; i < cells_.size(); ++i) gather(i);
  }
  [[nodiscard]] Number make(const CellIndex<D>& index, const detail::FrontierBorder<D>& border) {
    Number number = static_cast<Number>(cells_.size());
    if (unused_.empty()) {
      cells_.emplace_back();
    } else {
      number = unused_.back();
      unused_.pop_back();
    }
    cells_[number] = Cell{index, kNone, border, {}};
    numbers_[index] = number;
    return number;
  }

  void follow(const Map& map) {
    std::vector<Box<D>> changed;
    detail::for_each_difference(seen_, map,
                                [&](const CellIndex<D>& index) { changed.push_back(map.tree().box(index)); });
    std::vector<Number> left;  // Remaining cells of frontiers that lost some.
    Pace pace;
    for (const Box<D>& region : changed)
      for_each_leaf_of(seen_, region, only(true), [&](const auto& leaf) {
        pace.spend(kSteps);
        const auto found = numbers_.find(leaf.index);
        if (found != numbers_.end()) remove(found->second, left);
      });
    seen_ = map.snapshot();
    std::vector<Number> added;
    std::unordered_set<CellIndex<D>, Hash> looked_at;
    for (const Box<D>& region : changed)
      for_each_leaf_of(seen_, region, only(true), [&](const auto& leaf) {
        pace.spend(kSteps);
        const Box<D> box = seen_.tree().box(leaf.index);
        if ((box_ && !box_->touches(box)) || !looked_at.insert(leaf.index).second) return;
        Box<D> around = box;
        around.lower.array() -= margin();
        around.upper.array() += margin();
        detail::FrontierBorder<D> border;
        for (const Box<D>& unknown : boxes_of(seen_, around, only(false))) border.add(box, unknown);
        if (border.area > 0.0) added.push_back(make(leaf.index, border));
      });
    for (const Number number : added) {
      pace.spend(kSteps);
      for_each_leaf_of(seen_, box_of(cells_[number]), only(true), [&](const auto& leaf) {
        const auto found = numbers_.find(leaf.index);
        if (found == numbers_.end() || found->second == number) return;
        put_beside(number, found->second);
        put_beside(found->second, number);
      });
    }
    for (const std::vector<Number>* const numbers : {&left, &added})
      for (const Number number : *numbers)
        if (cells_[number].border.area > 0.0 && cells_[number].cluster == kNone) gather(number);
  }
  void put_beside(Number number, Number other) {
    auto& beside = cells_[number].beside;
    if (std::find(beside.begin(), beside.end(), other) == beside.end()) beside.push_back(other);
  }
  /// Takes a cell away, and its frontier apart. @param left takes the rest of it.
  void remove(Number number, std::vector<Number>& left) {
    dissolve(cells_[number].cluster, left);
    for (const Number other : cells_[number].beside) {
      auto& beside = cells_[other].beside;
      beside.erase(std::remove(beside.begin(), beside.end(), number), beside.end());
    }
    numbers_.erase(cells_[number].index);
    cells_[number] = Cell{};
    unused_.push_back(number);
  }
  void dissolve(Number cluster, std::vector<Number>& left) {
    if (cluster == kNone) return;
    for (const Number number : clusters_[cluster].cells) {
      cells_[number].cluster = kNone;
      left.push_back(number);
    }
    clusters_[cluster] = Cluster{};
    unused_clusters_.push_back(cluster);
  }
  /// Makes a frontier of all that is connected with a cell, if that is of none.
  void gather(Number first) {
    if (cells_[first].cluster != kNone) return;
    Number number = static_cast<Number>(clusters_.size());
    if (unused_clusters_.empty()) {
      clusters_.emplace_back();
    } else {
      number = unused_clusters_.back();
      unused_clusters_.pop_back();
    }
    Cluster cluster;
    std::vector<Number> others;  // Of frontiers that join.
    cells_[first].cluster = number;
    cluster.cells.push_back(first);
    for (std::size_t i = 0; i < cluster.cells.size(); ++i) {
      const Cell& cell = cells_[cluster.cells[i]];
      cluster.border.area += cell.border.area;
      cluster.border.center += cell.border.center;
      cluster.border.direction += cell.border.direction;
      for (const Number other : cell.beside) {
        if (cells_[other].cluster == number) continue;
        dissolve(cells_[other].cluster, others);
        cells_[other].cluster = number;
        cluster.cells.push_back(other);
      }
    }
    clusters_[number] = std::move(cluster);
  }
  [[nodiscard]] Frontier<D> frontier_of(const Cluster& cluster) const {
    Frontier<D> frontier;
    frontier.cells.reserve(cluster.cells.size());
    for (const Number number : cluster.cells) frontier.cells.push_back(box_of(cells_[number]));
    frontier.area = cluster.border.area;
    frontier.center = cluster.border.center / frontier.area;
    const double length = cluster.border.direction.norm();
    if (length > 1e-9 * frontier.area) frontier.direction = cluster.border.direction / length;
    return frontier;
  }

  Map seen_;
  bool is_broken_ = false;  // Then all below the box is empty.
  std::optional<Box<D>> box_;
  std::vector<Cell> cells_;
  std::vector<Number> unused_;
  std::unordered_map<CellIndex<D>, Number, Hash> numbers_;
  std::vector<Cluster> clusters_;
  std::vector<Number> unused_clusters_;
};

/// Where free cells border on unknown space, outside the map too; the largest first. Cells that share a
/// point belong together.
/// @param box free cells that share a point with it count; none: all.
/// @param min_cells frontiers whose border is smaller than this many faces of smallest cells are left out.
/// @throws std::invalid_argument if the box is upside down or min_cells negative. O(cells log cells).
template <class Map>
[[nodiscard]] std::vector<Frontier<Map::kDim>> frontiers(
    const Map& map, const std::optional<Box<Map::kDim>>& box = std::nullopt, double min_cells = 8.0) {
  if (!(min_cells >= 0.0))
    throw std::invalid_argument("min_cells = " + describe_number(min_cells) + ": must be >= 0");
  return FrontierSearch<Map>(map, box).frontiers(min_cells);
}

}  // namespace ndtree
