// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A map whose cells carry values beside their occupancy.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/forget_rule.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Whether a beam of a scan may end in a cell: it returned, and has a direction.
template <int D>
[[nodiscard]] bool ends_in_a_cell(const ScanView<D>& scan, Eigen::Index i) {
  return Beam<D>(scan.origin(i), scan.endpoint(i), scan.is_returned(i)).outcome == BeamOutcome::returned;
}

/// Refuses what cannot be added, before anything is. @param measurements one a beam.
/// @throws std::invalid_argument naming the beam; beams that did not return are not checked.
template <class Value, int D>
void check_measurements(const ScanView<D>& scan, const typename Value::Measurement* measurements) {
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    if (!ends_in_a_cell(scan, i)) continue;
    try {
      Value::check(measurements[i]);
    } catch (const std::invalid_argument& error) {
      throw std::invalid_argument("'" + Value::rule() + "' of beam " + std::to_string(i) + " = " +
                                  error.what());
    }
  }
}

/// A layer as it is after a map has taken a scan: measurements go to the cells in which their beams end. The
/// layer that is given stays as it is, and shares with the new one what does not change.
/// @param measurements one a beam, checked; measurements of beams that end in no cell of the map are ignored.
/// @param max_range, window as they were given to the map. @param max_memory of the layer [bytes].
/// @throws MemoryLimitReached, std::bad_alloc, Cancelled.
template <class Map, class Value>
[[nodiscard]] Layer<Map::kBranching, Map::kDim, Value> with_scan(
    Layer<Map::kBranching, Map::kDim, Value> layer, const Map& map, const ScanView<Map::kDim>& scan,
    const typename Value::Measurement* measurements, double max_range = kUnlimitedRange,
    const std::optional<Box<Map::kDim>>& window = std::nullopt, std::size_t max_memory = kUnlimitedMemory) {
  constexpr int D = Map::kDim;
  const auto& geometry = map.tree().geometry();
  LatticeBox<D> cells;
  if (window) cells = geometry.cells_in(*window, map.coarsest_level());
  layer.limit_memory(max_memory);
  Pace pace;
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    pace.spend();
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned) continue;
    const auto leaf = map.tree().find_leaf(beam.endpoint);
    if (!leaf || !leaf->cell().observed()) continue;
    if (window && !cells.overlaps(leaf->index, geometry.edge(leaf->index.level))) continue;
    layer.add(leaf->index, beam.endpoint, measurements[i]);
  }
  layer.limit_memory(kUnlimitedMemory);
  return layer;
}

/// What the cell of a map that contains a point carries; empty if nothing, or outside the map.
template <class Map, class Value>
[[nodiscard]] Value value_at(const Map& map, const Layer<Map::kBranching, Map::kDim, Value>& layer,
                             const Vector<Map::kDim>& point) {
  const auto leaf = map.tree().find_leaf(point);
  return leaf && leaf->cell().observed() ? layer.of(leaf->index) : Value{};
}

/// An occupancy map with a layer for each of the values. What changes it changes all of it, or nothing.
/// ```
/// LayeredMap<AdaptiveMap<2, 3>, MeanValue<3>, LatestStamp> map(options);
/// map.insert(scan, colours, stamps);            // One of each a beam.
/// MeanValue<3> colour = map.value<0>(point);    // Of the cell that contains the point.
/// ```
/// @tparam Map an OccupancyMap. @tparam Values see values.hpp.
template <class Map, class... Values>
class LayeredMap {
  template <class Value>
  using LayerOf = Layer<Map::kBranching, Map::kDim, Value>;

 public:
  static constexpr int kDim = Map::kDim;
  static constexpr std::size_t kNumLayers = sizeof...(Values);
  using MapType = Map;
  using Layers = std::tuple<LayerOf<Values>...>;
  /// What the layers are called in files.
  using Names = std::array<std::string, kNumLayers>;

  /// @param names all different; if none are given, the rules of the values.
  /// @throws std::invalid_argument naming the first option that is out of bounds, a name that two have, or a
  ///   max_memory that is less than a map with empty layers takes.
  explicit LayeredMap(const typename Map::Options& options = {}, Names names = {Values::rule()...})
      : LayeredMap(Map(options), std::move(names)) {
    require_room_for_empty(memory_bytes(), map_.options().memory_limit());
  }
  /// A map that has no values yet.
  explicit LayeredMap(Map map, Names names = {Values::rule()...})
      : LayeredMap(std::move(map), std::move(names), std::nullopt) {}
  /// A map and what it carries. @pre the layers have been made for cells of the map's sizes.
  LayeredMap(Map map, Names names, std::optional<Layers> layers)
      : map_(std::move(map)),
        names_(std::move(names)),
        layers_(layers ? std::move(*layers) : Layers(LayerOf<Values>(map_.tree().geometry())...)) {
    for (std::size_t i = 0; i < kNumLayers; ++i)
      if (std::count(names_.begin(), names_.end(), names_[i]) > 1)
        throw std::invalid_argument("two layers are called '" + names_[i] + "': names must be different");
  }

  /// Integrates a scan. @param measurements one a beam for each layer. @throws std::invalid_argument as
  /// OccupancyMap::insert(), or if their number is not that of the beams, or a value does not take one that
  /// returned; nothing has changed then, whatever is thrown.
  auto insert(const Scan<kDim>& scan, const std::vector<typename Values::Measurement>&... measurements,
              double max_range = kUnlimitedRange, int threads = 0,
              const std::optional<Box<kDim>>& window = std::nullopt) {
    const ScanView<kDim> view = scan.view();
    (check<Values>(view, measurements), ...);
    return change([&](LayeredMap& map) {
      const auto report = map.map_.insert(view, max_range, threads, window);
      const std::size_t limit = map.map_.options().memory_limit();
      const auto add = [&](auto& layer, const auto* of_layer) {
        using Value = typename std::decay_t<decltype(layer)>::ValueType;
        layer = with_scan<typename Map::Cells, Value>(
            layer, map.map_, view, of_layer, max_range, window,
            memory_beside(map.memory_bytes() - layer.memory_bytes(), limit));
      };
      std::apply([&](auto&... layer) { (add(layer, measurements.data()), ...); }, map.layers_);
      if (map.memory_bytes() > limit) throw MemoryLimitReached(limit);
      return report;
    });
  }

  /// What OccupancyMap does, with the values as well. @throws as it does.
  void crop(const Box<kDim>& box) {
    forget(CropRule<kDim>{map_.tree().geometry().on_borders(box)}, [&](Map& map) { map.crop(box); });
  }
  void clear(const Box<kDim>& box) {
    forget(ClearRule<kDim>{map_.tree().geometry().on_borders(box)}, [&](Map& map) { map.clear(box); });
  }
  void clear(const Body<kDim>& body, const Pose<kDim>& pose = {}) {
    forget(ShapeRule<kDim>{moved(body, pose)}, [&](Map& map) { map.clear(body, pose); });
  }
  /// Values stay as they are, whatever state their cells get.
  void mark(const Box<kDim>& box, CellState state, int beams = kMarkBeams) {
    mark([&](Map& map) { map.mark(box, state, beams); });
  }
  void mark(const Body<kDim>& body, const Pose<kDim>& pose, CellState state, int beams = kMarkBeams) {
    mark([&](Map& map) { map.mark(body, pose, state, beams); });
  }
  void keep_near(const Vector<kDim>& center, double radius) {
    forget(NearRule<kDim>{center, radius}, [&](Map& map) { map.keep_near(center, radius); });
  }
  void merge(const LayeredMap& other) {
    change([&](LayeredMap& map) {
      map.map_.merge(other.map_);
      map.join_layers(other, std::index_sequence_for<Values...>{});
      return 0;
    });
  }

  [[nodiscard]] const Map& map() const { return map_; }
  [[nodiscard]] const Names& names() const { return names_; }
  [[nodiscard]] const Layers& layers() const { return layers_; }
  template <std::size_t I>
  [[nodiscard]] const auto& layer() const {
    return std::get<I>(layers_);
  }
  /// What the cell that contains a point carries; empty if nothing, or outside the map.
  template <std::size_t I>
  [[nodiscard]] auto value(const Vector<kDim>& point) const {
    return value_at(map_, layer<I>(), point);
  }
  [[nodiscard]] LayeredMap snapshot() const { return *this; }
  /// Bytes held, used or not.
  [[nodiscard]] std::size_t memory_bytes() const {
    return std::apply(
        [&](const auto&... layer) { return (map_.memory_bytes() + ... + layer.memory_bytes()); }, layers_);
  }

 private:
  template <class Value>
  static void check(const ScanView<kDim>& scan,
                    const std::vector<typename Value::Measurement>& measurements) {
    if (measurements.size() != static_cast<std::size_t>(scan.size))
      throw std::invalid_argument("'" + Value::rule() + "' has " + std::to_string(measurements.size()) +
                                  " values: must be " + std::to_string(scan.size) +
                                  ", the number of end points");
    check_measurements<Value>(scan, measurements.data());
  }
  /// Changes a copy, which shares what stays, and takes its place.
  template <class Change>
  auto change(const Change& change) {
    LayeredMap changed = *this;
    const auto result = change(changed);
    last_checkpoint();
    *this = std::move(changed);
    return result;
  }
  template <class Rule, class Forget>
  void forget(const Rule& rule, const Forget& forget) {
    change([&](LayeredMap& map) {
      forget(map.map_);
      const auto may_differ = [&](const Box<kDim>& region) { return takes_from(rule, region); };
      std::apply([&](auto&... layer) { (layer.keep_known(map.map_.tree(), may_differ), ...); }, map.layers_);
      return 0;
    });
  }
  template <class Mark>
  void mark(const Mark& mark) {
    change([&](LayeredMap& map) {
      mark(map.map_);
      const std::size_t limit = map.map_.options().memory_limit();
      if (map.memory_bytes() > limit) throw MemoryLimitReached(limit);
      return 0;
    });
  }
  template <std::size_t... I>
  void join_layers(const LayeredMap& other, std::index_sequence<I...>) {
    (std::get<I>(layers_).join(std::get<I>(other.layers_), map_.tree()), ...);
  }
  Map map_;
  Names names_;
  Layers layers_;
};

}  // namespace ndtree
