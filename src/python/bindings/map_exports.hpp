// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What our own maps can be turned into, and asked in bulk, beyond what OctoMap answers, too.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>

#include "map_layers.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/io/dense_grid.hpp"
#include "ndtree/io/map_server.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "ndtree/io/ply.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/region.hpp"

namespace ndtree::python {

inline constexpr std::size_t kStepsOfQuery = 64;  // Of a Pace, for one of many points, rays, boxes or poses.

/// A view of a map; it holds as long as the map. As in MapInterface, no call touches a Python object.
class MapExports {
 public:
  virtual ~MapExports() = default;
  virtual void grid_states(const double* lower, const std::size_t* shape, double cell_size,
                           std::optional<double> wall_depth, std::int8_t* out) const = 0;
  virtual void grid_log_odds(const double* lower, const std::size_t* shape, double cell_size,
                             float* out) const = 0;
  /// Three answers a box: unknown, free, occupied.
  virtual void states_in(const double* lower, const double* upper, std::size_t n, bool* out) const = 0;
  /// NaN where there is nothing occupied.
  virtual void distance_to_occupied(const double* points, std::size_t n, double* out) const = 0;
  [[nodiscard]] virtual std::string octomap_bytes(OctomapFormat format,
                                                  std::optional<double> cell_size) const = 0;
  [[nodiscard]] virtual MapServerImage map_server_image(const MapServerOptions& options) const = 0;
  /// @param chosen one a leaf, in the order of leaves(); null for the occupied ones.
  [[nodiscard]] virtual std::string ply_bytes(const bool* chosen) const = 0;
};

template <class Map>
class MapExportsOf final : public MapExports {
  static constexpr int D = Map::kDim;
  using Point = Eigen::Map<const Vector<D>>;

 public:
  MapExportsOf(const Map& map, const MapLayers<Map::kBranching, D>& layers) : map_(map), layers_(layers) {}

  void grid_states(const double* lower, const std::size_t* shape, double cell_size,
                   std::optional<double> wall_depth, std::int8_t* out) const override {
    states_to_grid(map_, grid(lower, shape, cell_size), wall_depth, out);
  }
  void grid_log_odds(const double* lower, const std::size_t* shape, double cell_size,
                     float* out) const override {
    to_grid(
        map_, grid(lower, shape, cell_size), [](const auto& cell) { return cell.log_odds(); }, out);
  }
  void states_in(const double* lower, const double* upper, std::size_t n, bool* out) const override {
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      const RegionStates states = ndtree::states_in(map_, Box<D>{Point(lower + i * D), Point(upper + i * D)});
      out[3 * i] = states.unknown;
      out[3 * i + 1] = states.free;
      out[3 * i + 2] = states.occupied;
    });
  }
  void distance_to_occupied(const double* points, std::size_t n, double* out) const override {
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      out[i] = ndtree::distance_to_occupied(map_, Vector<D>(Point(points + i * D)))
                   .value_or(std::numeric_limits<double>::quiet_NaN());
    });
  }
  [[nodiscard]] std::string octomap_bytes(OctomapFormat format,
                                          std::optional<double> cell_size) const override {
    if constexpr (D == 3)
      return ndtree::octomap_bytes(map_, format, cell_size, layers_.colors());
    else
      throw std::invalid_argument("a " + std::to_string(D) + "-D map: OctoMap has three dimensions");
  }
  [[nodiscard]] MapServerImage map_server_image(const MapServerOptions& options) const override {
    if constexpr (D <= 3)
      return ndtree::map_server_image(map_, options);
    else
      throw std::invalid_argument("a 4-D map: an image is of one in 2-D or 3-D");
  }
  [[nodiscard]] std::string ply_bytes(const bool* chosen) const override {
    if constexpr (D <= 3)
      return ndtree::ply_bytes(
          map_,
          [&](const auto& leaf) {
            return chosen != nullptr ? *chosen++ : leaf.cell().state() == CellState::occupied;
          },
          layers_.ply_properties(),
          [&](const CellIndex<D>& leaf, double* numbers) { layers_.ply_numbers(leaf, numbers); });
    else
      throw std::invalid_argument("a 4-D map: PLY has three dimensions");
  }

 private:
  [[nodiscard]] static GridGeometry<D> grid(const double* lower, const std::size_t* shape, double cell_size) {
    GridGeometry<D> grid;
    grid.lower = Point(lower);
    grid.cell_size = cell_size;
    for (std::size_t a = 0; a < D; ++a) grid.shape[a] = shape[a];
    return grid;
  }

  const Map& map_;
  const MapLayers<Map::kBranching, D>& layers_;
};

}  // namespace ndtree::python
