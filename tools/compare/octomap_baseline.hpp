// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// OctoMap with the calls of our maps: the baseline of another house (Hornung et al. 2013). No OctoMap header
/// is seen through this one.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <iosfwd>
#include <memory>
#include <optional>

#include "ndtree/cell/hit_rate.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree {

/// Which of OctoMap's insertions is meant.
enum class OctomapInsertion {
  beam_by_beam,       ///< insertRay() for each beam, each of which updates each cell that it touches.
  scan_at_once,       ///< insertPointCloud(): a cell is updated once a scan, a hit outvoting all misses.
  scan_at_once_lazy,  ///< As scan_at_once, with lazy evaluation: nothing is pruned while inserting.
  scan_discretized    ///< Lazy, and with discretize: of the beams that end in one cell, one counts.
};

/// The size of an OctoMap tree.
struct OctomapStats {
  std::size_t leaves = 0;           ///< As stored. All but lazy insertion prune while they insert.
  std::size_t leaves_expanded = 0;  ///< All of the cell size, as after expand(): the cells before pruning.
  std::size_t leaves_pruned = 0;    ///< After prune() of a copy.
  std::size_t nodes = 0;            ///< As stored; OctoMap stores no node for unknown space.
  std::uint64_t updates = 0;        ///< As in InsertReport, over the map's life.
  std::size_t memory_bytes = 0;     ///< OctoMap's own figure: nodes and arrays of children, no allocator.
};

/// Leaves of an OctoMap tree as stored, one column or entry each.
struct OctomapLeaves {
  Points<3> lower;           ///< Lower corners [m].
  Eigen::VectorXd size;      ///< Edge lengths [m].
  Eigen::VectorXf log_odds;  ///< Evidence of being occupied.
};

/// An occupancy octree by liboctomap that takes the same scans and options as our maps, and answers the same
/// calls. One hit adds the log-odds of probability_max, one miss those of probability_min, within
/// [log_odds_min, log_odds_max]; a cell is occupied where its log-odds are above 0, free below, unknown
/// at 0 or without a node. 2-D scans and questions lie in the plane z = 0, a layer of cells that can
/// never be pruned, because their neighbours in z are unknown.
/// OctoMap computes with float coordinates and addresses 32768 cells in each direction from 0.
class OctomapBaseline {
 public:
  /// @param cell_size edge of the smallest cell [m]; the options' cell sizes are not used.
  /// @throws std::invalid_argument naming the first value that is out of bounds.
  explicit OctomapBaseline(double cell_size, const MapOptions& options = {},
                           OctomapInsertion insertion = OctomapInsertion::beam_by_beam);
  ~OctomapBaseline();
  OctomapBaseline(const OctomapBaseline& other);
  OctomapBaseline(OctomapBaseline&& other) noexcept;
  OctomapBaseline& operator=(OctomapBaseline other) noexcept;

  /// Integrates a scan; a beam's evidence is that of our maps, except that nothing behind the end point is
  /// updated.
  /// @returns counts as of our maps. `updates` are the (beam, cell) pairs that insertRay() touches, and
  ///   the (scan, cell) pairs that insertPointCloud() does. `seconds` is OctoMap's insertion alone: checks
  ///   before it and the count of beam-by-beam updates are not in it.
  /// @throws std::invalid_argument if max_range is not > 0, if the scan's one origin is not finite, if a beam
  ///   leaves what OctoMap can address, or if a scan at once has more than one origin. The map is then
  ///   unchanged.
  template <int D>
  InsertReport insert(const ScanView<D>& scan, double max_range = kUnlimitedRange);
  template <int D>
  InsertReport insert(const Scan<D>& scan, double max_range = kUnlimitedRange) {
    return insert(scan.view(), max_range);
  }

  [[nodiscard]] double cell_size() const;
  [[nodiscard]] const MapOptions& options() const;
  [[nodiscard]] OctomapInsertion insertion() const;
  /// O(nodes); prunes a copy.
  [[nodiscard]] OctomapStats stats() const;
  [[nodiscard]] OctomapLeaves leaves() const;

  /// Log-odds at a point; none where OctoMap has no node, outside what it can address, and if not finite.
  [[nodiscard]] std::optional<float> log_odds(const Vector<3>& point) const;
  /// See the free functions of the same names.
  [[nodiscard]] bool occupied_within(const Vector<3>& point, double radius) const;
  [[nodiscard]] std::optional<double> cast_ray(const Vector<3>& origin, const Vector<3>& direction,
                                               double max_range, RayAim aim) const;
  /// Calls `visit(log_odds, d_enter, d_exit)` for the cells that a ray passes through over more than a point,
  /// in order, with log-odds of 0 where OctoMap has no node, until it returns false or the ray leaves what
  /// OctoMap can address. @param direction of length 1. @param begin distance from the origin to begin at
  /// [m].
  void for_each_cell(const Vector<3>& origin, const Vector<3>& direction, double begin,
                     const std::function<bool(float, double, double)>& visit) const;

  /// The whole state, for load().
  void save(std::ostream& out) const;
  /// @throws std::runtime_error if the stream does not hold what save() wrote.
  [[nodiscard]] static OctomapBaseline load(std::istream& in);
  /// OctoMap's own file, .ot, which its viewer reads.
  void write_ot(std::ostream& out) const;
  /// The same without log-odds, .bt: cells are free or occupied.
  void write_bt(std::ostream& out) const;
  /// Whatever OctoMap reads of its own files, .ot or .bt. @throws std::runtime_error if it does not.
  [[nodiscard]] static OctomapBaseline read_octomap(std::istream& in);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

namespace detail {

inline Vector<3> in_space(const Vector<2>& point) { return {point.x(), point.y(), 0.0}; }
inline const Vector<3>& in_space(const Vector<3>& point) { return point; }

}  // namespace detail

template <int D>
[[nodiscard]] CellState state(const OctomapBaseline& map, const Vector<D>& point) {
  const float value = map.log_odds(detail::in_space(point)).value_or(0.0f);
  return value > 0.0f ? CellState::occupied : value < 0.0f ? CellState::free : CellState::unknown;
}

/// 0.5 where unknown.
template <int D>
[[nodiscard]] double probability(const OctomapBaseline& map, const Vector<D>& point) {
  return probability(static_cast<double>(map.log_odds(detail::in_space(point)).value_or(0.0f)));
}

/// Whether some occupied cell is at most `radius` >= 0 [m] away from the point, its border counted in.
template <int D>
[[nodiscard]] bool occupied_within(const OctomapBaseline& map, const Vector<D>& point, double radius) {
  return map.occupied_within(detail::in_space(point), radius);
}

/// Distance [m] to where the ray enters the first occupied cell; 0 if it starts in one; none if there is none
/// within `max_range` [m], or if it starts outside what OctoMap can address. Unknown space does not stop it.
/// @throws std::invalid_argument if origin or direction is not finite, the direction zero or max_range not >
/// 0.
/// @param aim surface: as of our maps, by HitRateModel::mean_of() the cells' log-odds.
template <int D>
[[nodiscard]] std::optional<double> cast_ray(const OctomapBaseline& map, const Vector<D>& origin,
                                             const Vector<D>& direction, double max_range,
                                             RayAim aim = RayAim::surface) {
  return map.cast_ray(detail::in_space(origin), detail::in_space(direction), max_range, aim);
}

/// As of our maps; OctoMap does not keep how many beams a cell has seen.
template <int D, class Visit>
void for_each_cell_on(const OctomapBaseline& map, const Beam<D>& beam, const Visit& visit) {
  const double length = beam.displacement.norm();
  map.for_each_cell(detail::in_space(beam.origin), detail::in_space(beam.displacement) / length, 0.0,
                    [&](float log_odds, double enter, double exit) {
                      if (enter > length) return false;
                      CellOnBeam cell;
                      cell.state = state_of(log_odds);
                      cell.hit_rate = HitRateModel::mean_of(static_cast<double>(log_odds));
                      cell.size = map.cell_size();
                      cell.ends_beam = exit > length;
                      if (cell.state != CellState::unknown) visit(cell);
                      return !cell.ends_beam;
                    });
}

}  // namespace ndtree
