// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What planners and explorers ask of our own maps, in bulk.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "any_field.hpp"
#include "map_exports.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/planning/planner.hpp"
#include "ndtree/planning/turning.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/collision.hpp"
#include "ndtree/query/distance_field.hpp"
#include "ndtree/query/field_update.hpp"
#include "ndtree/query/frontiers.hpp"
#include "ndtree/query/information_gain.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree::python {

/// Of any dimension that maps have.
using AnyFrontiers =
    std::variant<std::vector<Frontier<2>>, std::vector<Frontier<3>>, std::vector<Frontier<4>>>;

/// A piece of a body before the dimension of the map is known. A capsule has `a`, `b` and `radius`; a box has
/// its center in `a`, half its size in `b`, and its axes, column by column, in `axes`; none: those of the
/// body.
struct AnyShapePart {
  bool is_box = false;
  std::vector<double> a;
  std::vector<double> b;
  std::vector<double> axes;
  double radius = 0.0;
};

/// What is behind a Python shape.
struct PythonShape {
  std::vector<AnyShapePart> parts;
  std::string text;
};

/// Corners, of the map's dimension.
struct AnyBox {
  const double* lower;
  const double* upper;
};
/// A body in a pose: a rotation, row by row, and a translation.
struct PlacedShape {
  const std::vector<AnyShapePart>& parts;
  const double* pose;
};
/// What is forgotten or marked.
using AnyPlace = std::variant<AnyBox, PlacedShape>;

[[noreturn]] inline void throw_no_shapes() {
  throw std::invalid_argument("a map with dim = 4: shapes are of maps with dim = 2 or 3");
}
/// @throws std::invalid_argument if a part is of another dimension.
template <int D>
[[nodiscard]] Body<D> body_of(const std::vector<AnyShapePart>& parts) {
  const auto vector_of = [](const std::vector<double>& values) -> Vector<D> {
    if (values.empty()) return Vector<D>::Zero();
    if (values.size() != D)
      throw std::invalid_argument("shape: a point with " + std::to_string(values.size()) +
                                  " coordinates in a map with dim = " + std::to_string(D));
    return Eigen::Map<const Vector<D>>(values.data());
  };
  Body<D> body;
  for (const AnyShapePart& part : parts) {
    if (!part.is_box) {
      const Vector<D> a = vector_of(part.a);
      body.push_back(Capsule<D>{a, part.b.empty() ? a : vector_of(part.b), part.radius});
      continue;
    }
    OrientedBox<D> box{vector_of(part.a), vector_of(part.b), Eigen::Matrix<double, D, D>::Identity()};
    if (!part.axes.empty()) {
      if (part.axes.size() != D * D)
        throw std::invalid_argument("shape: a rotation of another dimension in a map with dim = " +
                                    std::to_string(D));
      box.axes = Eigen::Map<const Eigen::Matrix<double, D, D>>(part.axes.data());
    }
    body.push_back(box);
  }
  return body;
}

/// What rays end at: `cell_lower` and `cell_size` are NaN where there is no cell.
struct RayEndArrays {
  double* distance;
  std::int8_t* state;
  double* cell_lower;
  double* cell_size;
};

/// Beams of a sensor, one after the other: `dim` numbers of a direction, dim - 1 of a spacing.
struct AnyBeamPattern {
  const double* directions;
  const double* spacing;
  std::size_t beams;
  double max_range;
  double mean_free_path;
};

/// A path of any dimension that planners have.
struct AnyPath {
  PathStatus status;
  std::vector<double> points;  ///< One after the other.
  double length;
  double clearance;
  std::size_t expanded;
  std::string reason;
};

template <int D>
[[nodiscard]] AnyPath any_path(const Path<D>& path) {
  AnyPath any{path.status, {}, path.length, path.clearance, path.expanded, path.reason};
  for (const Vector<D>& point : path.points)
    any.points.insert(any.points.end(), point.data(), point.data() + D);
  return any;
}

class MapQueries;

/// A planner in a map of any kind. Calls are made one at a time.
class AnyPlanner {
 public:
  virtual ~AnyPlanner() = default;
  [[nodiscard]] virtual AnyPath plan(const double* start, const double* goal, double max_seconds) = 0;
  /// Of a body that turns, between poses x, y and yaw. @throws std::invalid_argument if the map is not 2-D.
  [[nodiscard]] virtual AnyPath plan_turning(const double* start, const double* goal, int headings,
                                             double max_seconds) const = 0;
  /// Of the ways to n goals.
  virtual void ways(const double* start, const double* goals, std::size_t n, double max_seconds,
                    double* out) = 0;
  /// @throws std::invalid_argument if the map is of another kind than the first.
  virtual bool update(const MapQueries& map) = 0;
  /// The first of the segments between n points in which the body collides; -1 if there is none.
  [[nodiscard]] virtual std::int64_t first_blocked(const double* points, std::size_t n) const = 0;
  /// Of the segments between n poses x, y and yaw of a body that turns, in a 2-D map.
  [[nodiscard]] virtual std::int64_t first_blocked_turning(const double* poses, std::size_t n) const = 0;
  /// For each segment, half spaces one after the other: a normal and an offset each.
  [[nodiscard]] virtual std::vector<std::vector<double>> corridors(const double* points, std::size_t n,
                                                                   double reach) const = 0;
  [[nodiscard]] virtual std::size_t memory_bytes() const = 0;
};

/// Frontiers that follow a map of any kind.
class AnyFrontierSearch {
 public:
  virtual ~AnyFrontierSearch() = default;
  /// @throws std::invalid_argument if the map is of another kind than the first.
  virtual void update(const MapQueries& map) = 0;
  [[nodiscard]] virtual AnyFrontiers frontiers(double min_cells) const = 0;
};

/// A view of a map; it holds as long as the map. As in MapInterface, no call touches a Python object.
class MapQueries {
 public:
  virtual ~MapQueries() = default;
  /// Lower and upper corner, one after the other; empty if nothing was observed.
  [[nodiscard]] virtual std::vector<double> bounds() const = 0;
  /// Infinity, and NaN for the point, where there is none.
  virtual void nearest_occupied(const double* points, std::size_t n, double max_distance, double* distance,
                                double* nearest) const = 0;
  virtual void trace_rays(const double* origins, std::size_t origin_step, const double* directions,
                          std::size_t n, double max_range, bool stops_at_unknown, RayAim aim,
                          const RayEndArrays& out) const = 0;
  /// What a scan from each of n poses would see anew. @param poses as collides(). @param threads 0: as many
  /// as there are cores.
  virtual void information_gain(const double* poses, std::size_t n, const AnyBeamPattern& sensor,
                                std::size_t threads, double* volume, double* bits) const = 0;
  [[nodiscard]] virtual AnyField distance_field(const AnyBox& box, double cell_size, double max_distance,
                                                UnknownSpace unknown) const = 0;
  [[nodiscard]] virtual AnyFrontiers frontiers(const std::optional<AnyBox>& box, double min_cells) const = 0;
  [[nodiscard]] virtual std::unique_ptr<AnyFrontierSearch> frontier_search(
      const std::optional<AnyBox>& box) const = 0;
  [[nodiscard]] virtual std::unique_ptr<AnyPlanner> planner(const std::vector<AnyShapePart>& body,
                                                            const PlannerOptions& options) const = 0;
  /// @param poses n of them, each a rotation, row by row, and a translation.
  virtual void collides(const std::vector<AnyShapePart>& body, const double* poses, std::size_t n,
                        UnknownSpace unknown, bool* out) const = 0;
  /// The first pose that collides, or to which the body cannot move from the one before; -1 if there is none.
  [[nodiscard]] virtual std::int64_t path_collides(const std::vector<AnyShapePart>& body, const double* poses,
                                                   std::size_t n, UnknownSpace unknown) const = 0;
};

template <class Map>
class MapQueriesOf final : public MapQueries {
  static constexpr int D = Map::kDim;
  using Point = Eigen::Map<const Vector<D>>;

 public:
  /// @param refinement its name: maps of several may have cells of one type.
  MapQueriesOf(const Map& map, std::string refinement) : map_(map), refinement_(std::move(refinement)) {}

  [[nodiscard]] std::vector<double> bounds() const override {
    const auto box = ndtree::bounds(map_);
    std::vector<double> corners;
    if (!box) return corners;
    corners.insert(corners.end(), box->lower.data(), box->lower.data() + D);
    corners.insert(corners.end(), box->upper.data(), box->upper.data() + D);
    return corners;
  }
  void nearest_occupied(const double* points, std::size_t n, double max_distance, double* distance,
                        double* nearest) const override {
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      const auto found = ndtree::nearest_occupied(map_, Vector<D>(Point(points + i * D)), max_distance);
      distance[i] = found ? found->distance : std::numeric_limits<double>::infinity();
      Eigen::Map<Vector<D>>(nearest + i * D) = found ? found->point : nowhere();
    });
  }
  void trace_rays(const double* origins, std::size_t origin_step, const double* directions, std::size_t n,
                  double max_range, bool stops_at_unknown, RayAim aim,
                  const RayEndArrays& out) const override {
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      const auto end = trace_ray(map_, Vector<D>(Point(origins + i * origin_step)),
                                 Vector<D>(Point(directions + i * D)), max_range, stops_at_unknown, aim);
      const bool has_cell = end && end->cell;
      out.distance[i] = end ? end->distance : std::numeric_limits<double>::quiet_NaN();
      out.state[i] = static_cast<std::int8_t>(end ? end->state : CellState::free);
      Eigen::Map<Vector<D>>(out.cell_lower + i * D) = has_cell ? end->cell->lower : nowhere();
      out.cell_size[i] =
          has_cell ? end->cell->upper[0] - end->cell->lower[0] : std::numeric_limits<double>::quiet_NaN();
    });
  }
  void information_gain(const double* poses, std::size_t n, const AnyBeamPattern& sensor, std::size_t threads,
                        double* volume, double* bits) const override {
    if constexpr (D <= 3) {
      const auto beams = static_cast<Eigen::Index>(sensor.beams);
      const BeamPattern<D> pattern{
          Eigen::Map<const Points<D>>(sensor.directions, D, beams),
          Eigen::Map<const Eigen::Matrix<double, D - 1, Eigen::Dynamic>>(sensor.spacing, D - 1, beams),
          sensor.max_range, sensor.mean_free_path};
      std::vector<Pose<D>> placed;
      for (std::size_t i = 0; i < n; ++i) placed.push_back(pose_at(poses, i));
      const std::size_t cores = threads > 0 ? threads : std::thread::hardware_concurrency();
      const auto gains = ndtree::information_gain(map_, placed, pattern, cores);
      for (std::size_t i = 0; i < n; ++i) {
        volume[i] = gains[i].volume;
        bits[i] = gains[i].bits;
      }
    } else {
      throw_no_shapes();
    }
  }
  [[nodiscard]] AnyField distance_field(const AnyBox& box, double cell_size, double max_distance,
                                        UnknownSpace unknown) const override {
    return {ndtree::distance_field(map_, box_of(box), cell_size, max_distance, unknown)};
  }
  [[nodiscard]] AnyFrontiers frontiers(const std::optional<AnyBox>& box, double min_cells) const override {
    return ndtree::frontiers(map_, box ? std::optional<Box<D>>(box_of(*box)) : std::nullopt, min_cells);
  }
  [[nodiscard]] std::unique_ptr<AnyFrontierSearch> frontier_search(
      const std::optional<AnyBox>& box) const override {
    return std::make_unique<Search>(*this, box ? std::optional<Box<D>>(box_of(*box)) : std::nullopt);
  }
  [[nodiscard]] std::unique_ptr<AnyPlanner> planner(const std::vector<AnyShapePart>& body,
                                                    const PlannerOptions& options) const override {
    if constexpr (D <= 3)
      return std::make_unique<PlannerOf>(*this, body_of<D>(body), options);
    else
      throw_no_shapes();
  }
  void collides(const std::vector<AnyShapePart>& body, const double* poses, std::size_t n,
                UnknownSpace unknown, bool* out) const override {
    if constexpr (D <= 3) {
      const Body<D> shape = body_of<D>(body);
      for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
        out[i] = ndtree::collides(map_, shape, pose_at(poses, i), unknown);
      });
    } else {
      throw_no_shapes();
    }
  }
  [[nodiscard]] std::int64_t path_collides(const std::vector<AnyShapePart>& body, const double* poses,
                                           std::size_t n, UnknownSpace unknown) const override {
    if constexpr (D <= 3) {
      const Body<D> shape = body_of<D>(body);
      Pace pace;
      for (std::size_t i = 0; i < n; ++i) {
        pace.spend(kStepsOfQuery);
        if (i == 0 ? ndtree::collides(map_, shape, pose_at(poses, i), unknown)
                   : collides_between(map_, shape, pose_at(poses, i - 1), pose_at(poses, i), unknown))
          return static_cast<std::int64_t>(i);
      }
      return -1;
    } else {
      throw_no_shapes();
    }
  }

 private:
  [[nodiscard]] static Vector<D> nowhere() {
    return Vector<D>::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  [[nodiscard]] static Box<D> box_of(const AnyBox& box) { return {Point(box.lower), Point(box.upper)}; }
  class Search final : public AnyFrontierSearch {
   public:
    Search(const MapQueriesOf& map, const std::optional<Box<D>>& box)
        : search_(map.map_, box), refinement_(map.refinement_) {}
    void update(const MapQueries& map) override {
      const auto* const same = dynamic_cast<const MapQueriesOf*>(&map);
      if (same == nullptr || same->refinement_ != refinement_)
        throw std::invalid_argument("a map of another kind: must be of the kind that the search was made of");
      search_.update(same->map_);
    }
    [[nodiscard]] AnyFrontiers frontiers(double min_cells) const override {
      return search_.frontiers(min_cells);
    }

   private:
    FrontierSearch<Map> search_;
    std::string refinement_;
  };
  class PlannerOf final : public AnyPlanner {
   public:
    PlannerOf(const MapQueriesOf& map, Body<D> body, const PlannerOptions& options)
        : planner_(map.map_, std::move(body), options), refinement_(map.refinement_) {}
    [[nodiscard]] AnyPath plan(const double* start, const double* goal, double max_seconds) override {
      return any_path(planner_.plan(Vector<D>(Point(start)), Vector<D>(Point(goal)), max_seconds));
    }
    [[nodiscard]] AnyPath plan_turning(const double* start, const double* goal, int headings,
                                       double max_seconds) const override {
      if constexpr (D == 2)
        return any_path(ndtree::plan_turning(planner_.map(), Vector<3>(Eigen::Map<const Vector<3>>(start)),
                                             Vector<3>(Eigen::Map<const Vector<3>>(goal)), planner_.body(),
                                             planner_.options(), max_seconds, headings));
      (void)start, (void)goal, (void)headings, (void)max_seconds;
      throw std::invalid_argument("start: poses x, y and yaw are of a 2-D map");
    }
    void ways(const double* start, const double* goals, std::size_t n, double max_seconds,
              double* out) override {
      const auto lengths = planner_.ways(Vector<D>(Point(start)), points_of(goals, n), max_seconds);
      std::copy(lengths.begin(), lengths.end(), out);
    }
    bool update(const MapQueries& map) override {
      const auto* const same = dynamic_cast<const MapQueriesOf*>(&map);
      if (same == nullptr || same->refinement_ != refinement_)
        throw std::invalid_argument(
            "a map of another kind: must be of the kind that the planner was made of");
      return planner_.update(same->map_);
    }
    [[nodiscard]] std::int64_t first_blocked(const double* points, std::size_t n) const override {
      const auto found = planner_.first_blocked(points_of(points, n));
      return found ? static_cast<std::int64_t>(*found) : -1;
    }
    [[nodiscard]] std::int64_t first_blocked_turning(const double* poses, std::size_t n) const override {
      if constexpr (D == 2) {
        std::vector<Vector<3>> all;
        for (std::size_t i = 0; i < n; ++i) all.emplace_back(Eigen::Map<const Vector<3>>(poses + 3 * i));
        const auto found = ndtree::first_blocked_turning(planner_, all);
        return found ? static_cast<std::int64_t>(*found) : -1;
      }
      (void)poses, (void)n;
      throw std::invalid_argument("points: poses x, y and yaw are of a 2-D map");
    }
    [[nodiscard]] std::vector<std::vector<double>> corridors(const double* points, std::size_t n,
                                                             double reach) const override {
      std::vector<std::vector<double>> all;
      for (const auto& planes : planner_.corridors(points_of(points, n), reach)) {
        std::vector<double>& numbers = all.emplace_back();
        for (const HalfSpace<D>& plane : planes) {
          numbers.insert(numbers.end(), plane.normal.data(), plane.normal.data() + D);
          numbers.push_back(plane.offset);
        }
      }
      return all;
    }
    [[nodiscard]] std::size_t memory_bytes() const override { return planner_.memory_bytes(); }

   private:
    [[nodiscard]] static std::vector<Vector<D>> points_of(const double* points, std::size_t n) {
      std::vector<Vector<D>> result;
      for (std::size_t i = 0; i < n; ++i) result.emplace_back(Point(points + i * D));
      return result;
    }

    Planner<Map> planner_;
    std::string refinement_;
  };
  [[nodiscard]] static Pose<D> pose_at(const double* poses, std::size_t i) {
    return pose_of<D>(poses + i * (D * D + D));
  }

  const Map& map_;
  std::string refinement_;
};

}  // namespace ndtree::python
