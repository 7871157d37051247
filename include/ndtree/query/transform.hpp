// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A map moved by a rigid motion, as when two maps are to be put together.
#pragma once

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_merge.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/region.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/lattice_motion.hpp"

namespace ndtree {

namespace detail {

/// Fills a new tree with what a map says of the places that its cells come from.
template <class Map>
class Transforming {
  static constexpr int D = Map::kDim;
  using Tree = typename Map::Tree;
  using Cell = typename Map::Cell;
  using Ref = typename Tree::Ref;
  using Refinement = typename Map::RefinementType;

 public:
  /// Smallest cells that are looked at, unless said otherwise.
  [[nodiscard]] static std::size_t most_cells(const Map& map) {
    return (std::size_t{1} << 24) + 16 * map.tree().num_leaves();
  }

  Transforming(const Map& map, const Pose<D>& pose, std::size_t most)
      : map_(map),
        back_{pose.rotation.transpose(), -(pose.rotation.transpose() * pose.translation)},
        spread_(back_.rotation.cwiseAbs()),
        refinement_(map.options()),
        tree_(map.options().min_cell_size, map.options().num_levels(Map::kBranching)),
        coarsest_(Refinement::coarsest_level(tree_.geometry().finest_level())),
        most_(most),
        left_(most) {
    tree_.limit_memory(map.options().memory_limit(), sizeof(Map) - sizeof(Tree));
    if (const auto known = bounds(map)) {
      const Vector<D> half = pose.rotation.cwiseAbs() * (0.5 * (known->upper - known->lower));
      const Vector<D> centre = pose * Vector<D>(0.5 * (known->upper + known->lower));
      tree_.grow_to_contain(within_reach(centre - half));
      tree_.grow_to_contain(within_reach(centre + half));
      fill(tree_.root());
    }
    tree_.limit_memory(kUnlimitedMemory);
  }
  [[nodiscard]] Tree& tree() { return tree_; }

 private:
  /// A large cell may go beyond what is in reach: by less than its edge.
  [[nodiscard]] Vector<D> within_reach(Vector<D> point) const {
    const auto& geometry = tree_.geometry();
    for (int a = 0; a < D; ++a)
      if (std::abs(point[a]) < geometry.reach() + geometry.cell_size(0))
        point[a] = std::clamp(point[a], -geometry.reach(), geometry.reach());
    return point;
  }
  void fill(const Ref& ref) {
    pace_.spend(kStepsOfCell);
    if (ref.index.level == tree_.geometry().finest_level() && left_-- == 0) refuse();
    const Box<D> box = tree_.box(ref.index);
    const Vector<D> centre = back_ * Vector<D>(0.5 * (box.lower + box.upper));
    const Vector<D> half = spread_ * Vector<D>(0.5 * (box.upper - box.lower));
    const RegionStates states = states_in(map_, Box<D>{centre - half, centre + half});
    if (!states.free && !states.occupied) return;
    const bool is_finest = ref.index.level == tree_.geometry().finest_level();
    if (ref.index.level <= coarsest_ && (is_finest || states.free + states.occupied + states.unknown == 1)) {
      ref.cell() = resampled(box, tree_.geometry().edge(ref.index.level), is_finest ? 1 : kSamplesOfAxis);
      return;
    }
    if (ref.is_leaf()) tree_.split(ref);
    bool are_leaves = true;
    for (int j = 0; j < Tree::kNumChildren; ++j) {
      const Ref child = tree_.child(ref, j);
      fill(child);
      are_leaves = are_leaves && child.is_leaf();
    }
    if (!are_leaves || ref.index.level > coarsest_) return;
    if (const auto cell = merged_siblings<Tree>(refinement_, tree_.children(*ref.node)))
      tree_.merge(*ref.node, *cell);
  }

  [[noreturn]] void refuse() const {
    throw std::invalid_argument(
        "pose: after this motion, borders and surfaces would go through more than " + std::to_string(most_) +
        " cells of min_cell_size = " + describe_number(map_.options().min_cell_size) +
        " m: expected larger cells, a smaller map (crop), or a motion by right angles and whole cells of " +
        describe_number(tree_.geometry().cell_size(coarsest_)) + " m");
  }

  /// What the map says at places spread evenly over a box, on the average.
  [[nodiscard]] Cell resampled(const Box<D>& box, std::int64_t edge, int samples_of_axis) const {
    int samples = 1;
    for (int a = 0; a < D; ++a) samples *= samples_of_axis;
    Sum sum;
    for (int i = 0; i < samples; ++i) {
      Vector<D> at;
      for (int a = 0, rest = i; a < D; ++a, rest /= samples_of_axis)
        at[a] =
            box.lower[a] + (box.upper[a] - box.lower[a]) * (rest % samples_of_axis + 0.5) / samples_of_axis;
      if (const auto leaf = map_.tree().find_leaf(back_ * at); leaf && leaf->cell().observed())
        sum.add(leaf->cell(),
                std::pow(static_cast<double>(edge) /
                             static_cast<double>(map_.tree().geometry().edge(leaf->index.level)),
                         D - 1));
    }
    return 2 * sum.observed >= samples ? cell_of(sum, samples) : Cell{};
  }
  struct Sum {
    int observed = 0;
    double occupied = 0.0;  // Of evidence; of other maps, the log-odds.
    double free = 0.0;
    double hits = 0.0;
    double misses = 0.0;

    /// @param fraction of the beams through a cell of one size that a cell of another meets.
    void add(const EvidenceCell& cell, double fraction) {
      ++observed;
      occupied += fraction * static_cast<double>(cell.occupied_evidence());
      free += fraction * static_cast<double>(cell.free_evidence());
      hits += fraction * cell.hits();
      misses += fraction * cell.misses();
    }
    void add(const OccupancyCell& cell, double fraction) {
      ++observed;
      occupied += static_cast<double>(cell.log_odds());
      hits += fraction * cell.hits();
      misses += fraction * cell.misses();
    }
  };
  [[nodiscard]] Cell cell_of(const Sum& sum, int samples) const {
    const auto mean = [samples](double of_all) {  // Rounded up: what was seen is not forgotten.
      constexpr double kMost = 1e9;               // More than any cell can remember.
      return static_cast<std::int64_t>(std::ceil(std::min(of_all / samples, kMost) - 1e-9));
    };
    const auto count = [&](double of_all) {
      return static_cast<std::uint32_t>(std::min<std::int64_t>(mean(of_all), 0xffffff));
    };
    Cell cell;
    if constexpr (std::is_same_v<Cell, EvidenceCell>) {
      std::int64_t occupied = mean(sum.occupied);
      std::int64_t free = mean(sum.free);
      if (occupied == free && sum.occupied != sum.free) ++(sum.occupied > sum.free ? occupied : free);
      refinement_.model.assign(cell, occupied, free);
      cell.set_counts(cell.occupied_evidence() > 0 ? count(sum.hits) : 0, count(sum.misses));
    } else {
      cell.set_counts(count(sum.hits), count(sum.misses));
      cell.set_log_odds(static_cast<float>(sum.occupied / samples));
    }
    return cell;
  }

  static constexpr int kSamplesOfAxis = 3;
  static constexpr std::uint32_t kStepsOfCell = 16;  // Of Pace.

  const Map& map_;
  const Pose<D> back_;
  const Eigen::Matrix<double, D, D> spread_;
  const Refinement refinement_;
  Tree tree_;
  int coarsest_;
  std::size_t most_;
  std::size_t left_;  // Smallest cells that may still be looked at.
  Pace pace_;
};

/// A bound on the |components| of all points in a tree's root [m].
template <class Tree>
[[nodiscard]] double extent_of(const Tree& tree) {
  const Box<Tree::kDim> box = tree.box(tree.root().index);
  return std::max(box.lower.cwiseAbs().maxCoeff(), box.upper.cwiseAbs().maxCoeff());
}

template <int D>
void require_rigid(const Pose<D>& pose) {
  using Matrix = Eigen::Matrix<double, D, D>;
  if (!pose.rotation.allFinite() || !pose.translation.allFinite())
    throw std::invalid_argument("pose: must be finite");
  if (!((pose.rotation * pose.rotation.transpose() - Matrix::Identity()).cwiseAbs().maxCoeff() < 1e-4) ||
      !(pose.rotation.determinant() > 0.0))
    throw std::invalid_argument("pose: its rotation is not one");
}

}  // namespace detail

/// The lattice motion that a pose is for a map's cells, see transformed(), or none.
template <class Map>
[[nodiscard]] std::optional<LatticeMotion<Map::kDim>> lattice_motion_of(const Map& map,
                                                                        const Pose<Map::kDim>& pose) {
  const auto& geometry = map.tree().geometry();
  return lattice_motion(geometry, map.coarsest_level(), pose.rotation, pose.translation,
                        detail::extent_of(map.tree()));
}

/// A layer after a lattice motion of its map: each value is where its cell is, bit for bit. None if a value
/// is of more than one cell that the motion may move. @param level see lattice_motion(). @param max_memory
/// [bytes].
/// @throws MemoryLimitReached, std::bad_alloc, Cancelled.
template <class LayerType, int D>
[[nodiscard]] std::optional<LayerType> transformed_layer(const LayerType& layer, int level,
                                                         const LatticeMotion<D>& motion,
                                                         std::size_t max_memory) {
  if (motion.is_identity()) return layer;
  LayerType moved(layer.tree().geometry());
  moved.limit_memory(max_memory);
  detail::MovingCells<typename LayerType::Tree> moving(layer.tree(), level, motion);
  if (!moving.run(moved.tree(), [](const auto& cell) { return cell.value.is_empty(); })) return std::nullopt;
  moved.limit_memory(kUnlimitedMemory);
  return moved;
}

/// The map as it would be in a frame in which every point x lies at `pose * x`.
///
/// A motion that maps the lattice of cells onto itself, by right angles and whole cells of max_cell_size (of
/// a map whose cells are all of one size, whole cells), moves every cell as it is, bit for bit, and keeps the
/// counters; the identity gives a map of the same bytes. O(nodes).
///
/// Otherwise cells are filled anew, and the counters are 0. A smallest cell takes what
/// the map says at the place from which its centre comes, so that borders and surfaces are moved by at most
/// half its diagonal; nothing is blurred, and nothing that was unknown there becomes known. Larger cells
/// stand where the map says the same all over the place that they come from. Evidence is that of cells of
/// their size. What was seen but is not yet known (see CoverageModel) is left out.
/// O(smallest cells along surfaces and borders, and cells elsewhere).
/// @throws std::invalid_argument if the pose is not a finite rigid motion, moves cells out of reach, or
///   leaves borders and surfaces that go through more than 2^24 smallest cells, and 16 more for each leaf;
///   MemoryLimitReached, std::bad_alloc, Cancelled.
template <class Map>
[[nodiscard]] Map transformed(const Map& map, const Pose<Map::kDim>& pose) {
  using Tree = typename Map::Tree;
  detail::require_rigid(pose);
  if (const auto motion = lattice_motion_of(map, pose)) {
    if (motion->is_identity()) return map;
    Tree tree(map.options().min_cell_size, map.options().num_levels(Map::kBranching));
    tree.limit_memory(map.options().memory_limit(), sizeof(Map) - sizeof(Tree));
    const std::array<std::uint32_t, std::size_t{Map::Cell::kNumWords}> empty{};
    detail::MovingCells<Tree> moving(map.tree(), map.coarsest_level(), *motion);
    if (moving.run(tree, [&](const auto& cell) { return cell.words() == empty; })) {
      tree.limit_memory(kUnlimitedMemory);
      return Map(map.options(), std::move(tree), map.counters());
    }
  }
  detail::Transforming<Map> transforming(map, pose, detail::Transforming<Map>::most_cells(map));
  return Map(map.options(), std::move(transforming.tree()), typename Map::Counters{});
}

}  // namespace ndtree
