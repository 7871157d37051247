// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How much of the space that a map calls free was not seen by any beam, and how much of the seen space is
/// unknown in the map.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/kd_tree.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/random.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/point.hpp"

namespace ndtree {

/// Where space is asked about, and what counts as seen.
struct ClaimsOptions {
  std::size_t samples = 40000;  ///< Points drawn, 1 to 1e9.
  double spacings = 1.5;        ///< A point is in view if a beam passes it within this many median spacings.
  double tolerance = 0.1;       ///< A beam that returned sees this far behind its end point [m].
  double margin = 1.0;          ///< Points are drawn up to this far around the box of end points [m],
  double middle = 0.98;         ///< which holds this fraction of them on each axis, the middle ones.
  std::uint64_t seed = 0;       ///< Of the points.

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  void validate() const {
    require_option(samples >= 1 && samples <= 1'000'000'000, "samples", static_cast<double>(samples),
                   "in [1, 1e9]");
    require_option(spacings > 0.0 && std::isfinite(spacings), "spacings", spacings, "> 0 and finite");
    require_option(tolerance >= 0.0 && std::isfinite(tolerance), "tolerance", tolerance, ">= 0 m and finite");
    require_option(margin >= 0.0 && std::isfinite(margin), "margin", margin, ">= 0 m and finite");
    require_option(middle > 0.0 && middle <= 1.0, "middle", middle, "in (0, 1]");
  }
};

/// Points drawn uniformly around the end points of a log, and whether some scan saw them.
///
/// A beam stands for its solid angle: a scan has a point in view if its beam that is nearest in
/// direction (Euclidean distance of unit vectors) is at most `spacings` times the median distance from a
/// beam's direction to the nearest other one away. It sees the point if that beam goes past it, or returned
/// at most `tolerance` before it. Beams are cut at the maximum range, and one that did not return sees up to
/// where it ends. Beams from several origins are scans of their own. Of a single beam the spacing is not
/// known, and it sees nothing.
///
/// Equal logs and options give equal points on every platform.
template <int D>
class SeenSpace {
 public:
  /// @param scans of the whole log; they are not kept.
  /// @param max_range [m]
  /// @throws std::invalid_argument if max_range is not > 0, or an option is out of bounds.
  SeenSpace(const std::vector<ScanView<D>>& scans, double max_range, const ClaimsOptions& options = {})
      : SeenSpace(scans, max_range, options, NoWorld{}) {}

  /// Where the world is known, it says what is seen instead of the nearest beam's range: a point in view, not
  /// farther than max_range, before which there is no surface but in the last `tolerance`.
  /// @param world what has `distance(origin, unit direction, max_range)`, the distance to the first surface
  ///   up to and including max_range, or none; as World<D>.
  template <class World>
  SeenSpace(const std::vector<ScanView<D>>& scans, double max_range, const ClaimsOptions& options,
            const World& world)
      : max_range_(max_range), options_(options) {
    options.validate();
    if (!(max_range > 0.0))
      throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
    draw(scans);
    std::vector<Eigen::Index> unseen(static_cast<std::size_t>(points_.cols()));
    for (std::size_t i = 0; i < unseen.size(); ++i) unseen[i] = static_cast<Eigen::Index>(i);
    for (const ScanView<D>& scan : scans) look(scan, world, unseen);
    seen_.setConstant(points_.cols(), true);
    for (const Eigen::Index i : unseen) seen_[i] = false;
  }

  /// One column each; none without a valid beam.
  [[nodiscard]] const Points<D>& points() const { return points_; }
  /// Whether a scan saw the point, one each.
  [[nodiscard]] const Eigen::Array<bool, Eigen::Dynamic, 1>& seen() const { return seen_; }
  /// Where the points are; none without a valid beam.
  [[nodiscard]] const std::optional<Box<D>>& box() const { return box_; }

 private:
  /// Beams alone say what was seen.
  struct NoWorld {
    [[nodiscard]] static std::optional<double> distance(const Vector<D>&, const Vector<D>&, double) {
      return std::nullopt;
    }
  };

  struct Sight {
    Vector<D> origin;
    Vector<D> direction;  // Of unit length.
    double reach;         // Nothing is seen behind it [m].
  };

  /// Calls `visit(beam)` for each that says something.
  template <class Visit>
  void for_each_beam(const ScanView<D>& scan, const Visit& visit) const {
    for (Eigen::Index i = 0; i < scan.size; ++i) {
      const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range_);
      if (beam.outcome != BeamOutcome::invalid) visit(beam);
    }
  }

  void draw(const std::vector<ScanView<D>>& scans) {
    Box<D> box;
    std::vector<double> ends;
    for (int axis = 0; axis < D; ++axis) {  // One at a time: a log may be large.
      ends.clear();
      for (const ScanView<D>& scan : scans)
        for_each_beam(scan, [&](const Beam<D>& beam) { ends.push_back(beam.free_end()[axis]); });
      if (ends.empty()) return;
      const double outside = 0.5 * (1.0 - options_.middle);
      box.lower[axis] = quantile(ends, outside) - options_.margin;
      box.upper[axis] = quantile(ends, 1.0 - outside) + options_.margin;
    }
    Random random(options_.seed);
    points_.resize(D, static_cast<Eigen::Index>(options_.samples));
    for (Eigen::Index i = 0; i < points_.cols(); ++i)
      for (int axis = 0; axis < D; ++axis)
        points_(axis, i) = random.uniform(box.lower[axis], box.upper[axis]);
    box_ = box;
  }

  /// Between two values on a straight line. Changes their order. O(n).
  static double quantile(std::vector<double>& values, double fraction) {
    const double place = fraction * static_cast<double>(values.size() - 1);
    const auto below = values.begin() + static_cast<std::ptrdiff_t>(place);
    std::nth_element(values.begin(), below, values.end());
    if (below + 1 == values.end()) return *below;
    const double above = *std::min_element(below + 1, values.end());
    return *below + (place - std::floor(place)) * (above - *below);
  }

  template <class World>
  void look(const ScanView<D>& scan, const World& world, std::vector<Eigen::Index>& unseen) const {
    std::vector<Sight> sights;
    for_each_beam(scan, [&](const Beam<D>& beam) {
      double reach = std::min(beam.range, max_range_);
      if (beam.outcome == BeamOutcome::returned) reach += options_.tolerance;
      if constexpr (!std::is_same_v<World, NoWorld>) reach = max_range_;
      sights.push_back({beam.origin, beam.displacement / beam.range, reach});
    });
    if (scan.origin_per_beam)
      std::stable_sort(sights.begin(), sights.end(), [](const Sight& a, const Sight& b) {
        return std::lexicographical_compare(a.origin.data(), a.origin.data() + D, b.origin.data(),
                                            b.origin.data() + D);
      });
    for (std::size_t begin = 0, end = 0; begin < sights.size(); begin = end) {
      while (end < sights.size() && sights[end].origin == sights[begin].origin) ++end;
      if (end - begin > 1) look_from(sights.data() + begin, sights.data() + end, world, unseen);
    }
  }

  /// The sights in [begin, end) have one origin; there are at least two. Takes what they see from `unseen`.
  template <class World>
  void look_from(const Sight* begin, const Sight* end, const World& world,
                 std::vector<Eigen::Index>& unseen) const {
    const Vector<D> origin = begin->origin;
    Points<D> directions(D, end - begin);
    double farthest = 0.0;
    for (const Sight* sight = begin; sight != end; ++sight) {
      directions.col(sight - begin) = sight->direction;
      farthest = std::max(farthest, sight->reach);
    }
    const KdTree<D> tree(directions);
    const double in_view = options_.spacings * median_spacing(tree);
    const auto is_seen = [&](Eigen::Index i) {
      const Vector<D> way = points_.col(i) - origin;
      const double distance = way.norm();
      if (distance == 0.0) return true;
      if (!(distance <= farthest)) return false;
      const Vector<D> direction = way / distance;
      const auto nearest = tree.nearest(direction, in_view);
      return nearest && distance <= begin[nearest->index].reach &&
             !world.distance(origin, direction, distance - options_.tolerance);
    };
    unseen.erase(std::remove_if(unseen.begin(), unseen.end(), is_seen), unseen.end());
  }

  /// Of an even number the mean of the middle two.
  static double median_spacing(const KdTree<D>& tree) {
    std::vector<double> spacings(static_cast<std::size_t>(tree.size()));
    for (Eigen::Index i = 0; i < tree.size(); ++i)
      spacings[static_cast<std::size_t>(i)] = std::sqrt(tree.nearest_other(i)->squared_distance);
    return quantile(spacings, 0.5);
  }

  double max_range_;
  ClaimsOptions options_;
  std::optional<Box<D>> box_;
  Points<D> points_;
  Eigen::Array<bool, Eigen::Dynamic, 1> seen_;
};

/// Counts of the states that a map gives to points, of which each was seen by a scan or not. As the points
/// are drawn uniformly, fractions of them are fractions of volume; none where nothing was counted.
struct Claims {
  std::uint64_t points = 0;            ///< All.
  std::uint64_t seen = 0;              ///< Some scan saw it.
  std::uint64_t free = 0;              ///< The map calls it free.
  std::uint64_t free_and_unseen = 0;   ///< The map calls it free, but no scan saw it.
  std::uint64_t unknown_and_seen = 0;  ///< A scan saw it, but the map calls it unknown.

  /// Of the space called free, the fraction that was not seen.
  [[nodiscard]] std::optional<double> free_unseen() const { return share(free_and_unseen, free); }
  /// Of the space seen, the fraction that is called unknown.
  [[nodiscard]] std::optional<double> seen_unknown() const { return share(unknown_and_seen, seen); }
  /// Both volumes over the volume seen; may exceed 1.
  [[nodiscard]] std::optional<double> wrong_volume() const {
    return share(free_and_unseen + unknown_and_seen, seen);
  }

 private:
  [[nodiscard]] static std::optional<double> share(std::uint64_t part, std::uint64_t whole) {
    if (whole == 0) return std::nullopt;
    return static_cast<double>(part) / static_cast<double>(whole);
  }
};

/// Calls `visit(name, value)` for each figure of a report, in its order: counts, and then fractions that are
/// none where nothing was counted.
template <class Visit>
void for_each_figure(const Claims& claims, Visit&& visit) {
  visit("points", claims.points);
  visit("seen", claims.seen);
  visit("free", claims.free);
  visit("free_and_unseen", claims.free_and_unseen);
  visit("unknown_and_seen", claims.unknown_and_seen);
  visit("free_unseen", claims.free_unseen());
  visit("seen_unknown", claims.seen_unknown());
  visit("wrong_volume", claims.wrong_volume());
}

/// Asks the map about every point of the space.
/// @param map any type for which `state(map, point)` is found, in ndtree or in the map's own namespace.
template <class Map, int D>
[[nodiscard]] Claims claims(const Map& map, const SeenSpace<D>& space) {
  Claims result;
  for (Eigen::Index i = 0; i < space.points().cols(); ++i) {
    const CellState found = state(map, Vector<D>(space.points().col(i)));
    const bool seen = space.seen()[i];
    ++result.points;
    result.seen += seen;
    result.free += found == CellState::free;
    result.free_and_unseen += found == CellState::free && !seen;
    result.unknown_and_seen += found == CellState::unknown && seen;
  }
  return result;
}

}  // namespace ndtree
