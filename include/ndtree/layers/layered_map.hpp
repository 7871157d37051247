// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A map whose cells carry values beside their occupancy.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
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
#include "ndtree/layers/packed_measurements.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/tree/adopt.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/lattice.hpp"

namespace ndtree {

/// Around the points in which beams of a scan may end in a cell [m]; empty if none does.
/// @param geometry whose reach they must be in. @param max_range as it is given to the map.
template <int N, int D>
[[nodiscard]] Box<D> ends_of(const LatticeGeometry<N, D>& geometry, const ScanView<D>& scan,
                             double max_range) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  Box<D> box{Vector<D>::Constant(kInfinity), Vector<D>::Constant(-kInfinity)};
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned || !geometry.in_reach(beam.endpoint)) continue;
    box.lower = box.lower.cwiseMin(beam.endpoint);
    box.upper = box.upper.cwiseMax(beam.endpoint);
  }
  return box;
}

/// layer.grow_to(ends_of(...)): of most scans all end points have room already, whether or not beams end
/// there.
template <int N, int D, class Value>
void grow_to_ends(Layer<N, D, Value>& layer, const ScanView<D>& scan, double max_range) {
  const typename Layer<N, D, Value>::Tree& tree = layer.tree();
  const Box<D> room = tree.box(tree.root().index);
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    if (!scan.is_returned(i) || room.contains(scan.endpoint(i))) continue;
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), true, max_range);
    if (beam.outcome != BeamOutcome::returned || !tree.geometry().in_reach(beam.endpoint)) continue;
    return layer.grow_to(ends_of(tree.geometry(), scan, max_range));
  }
}

/// A layer as it is after a map has taken a scan: measurements go to the cells in which their beams end. The
/// layer that is given stays as it is, and shares with the new one what does not change. The root grows
/// around all ends of beams, wherever cells change.
/// @param measurements one a beam, checked; measurements of beams that end in no cell of the map are ignored.
/// @param max_range, window as they were given to the map. @param max_memory of the layer [bytes].
/// @param cubes if given, those in which values may be added, as of OccupancyMap::insert_in().
/// @throws MemoryLimitReached, std::bad_alloc, Cancelled.
template <class Map, class Value>
[[nodiscard]] Layer<Map::kBranching, Map::kDim, Value> with_scan(
    Layer<Map::kBranching, Map::kDim, Value> layer, const Map& map, const ScanView<Map::kDim>& scan,
    const typename Value::Measurement* measurements, double max_range = kUnlimitedRange,
    const std::optional<Box<Map::kDim>>& window = std::nullopt, std::size_t max_memory = kUnlimitedMemory,
    const CubeSet<Map::kDim>* cubes = nullptr) {
  constexpr int D = Map::kDim;
  const auto& geometry = map.tree().geometry();
  LatticeBox<D> cells;
  if (window) cells = geometry.cells_in(*window, map.coarsest_level());
  const ChangeWindow<D> where{window ? &cells : nullptr, cubes};
  layer.limit_memory(max_memory);
  grow_to_ends(layer, scan, max_range);
  Pace pace;
  for (Eigen::Index i = 0; i < scan.size; ++i) {
    pace.spend();
    const Beam<D> beam(scan.origin(i), scan.endpoint(i), scan.is_returned(i), max_range);
    if (beam.outcome != BeamOutcome::returned) continue;
    const auto leaf = map.tree().find_leaf(beam.endpoint);
    if (!leaf || !leaf->cell().observed()) continue;
    if (!where.overlaps(leaf->index, geometry.edge(leaf->index.level))) continue;
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
  static constexpr int kBranching = Map::kBranching;
  static constexpr int kDim = Map::kDim;
  static constexpr std::size_t kNumLayers = sizeof...(Values);
  using MapType = Map;
  using RefinementType = typename Map::RefinementType;
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
    return insert(scan.view(), measurements..., max_range, threads, window);
  }
  auto insert(const ScanView<kDim>& scan, const std::vector<typename Values::Measurement>&... measurements,
              double max_range = kUnlimitedRange, int threads = 0,
              const std::optional<Box<kDim>>& window = std::nullopt) {
    (check<Values>(scan, measurements), ...);
    return change([&](LayeredMap& map) {
      const auto report = map.map_.insert(scan, max_range, threads, window);
      map.add(scan, Measured(measurements...), max_range, window, nullptr,
              std::index_sequence_for<Values...>{});
      return report;
    });
  }

  // What a ScanHistory asks of its map; one without layers has the same.

  /// As of OccupancyMap.
  [[nodiscard]] auto measurements(const ScanView<kDim>& scan, double max_range) const {
    return map_.measurements(scan, max_range);
  }
  /// Of a scan, one measurement a beam for each layer.
  using Measured = std::tuple<const std::vector<typename Values::Measurement>&...>;
  struct PackedMeasured {
    std::tuple<PackedMeasurements<Values>...> layers;

    [[nodiscard]] std::size_t memory_bytes() const {
      return std::apply([](const auto&... layer) { return (std::size_t{0} + ... + layer.memory_bytes()); },
                        layers);
    }
  };
  /// @throws std::invalid_argument as insert().
  [[nodiscard]] static PackedMeasured packed(const ScanView<kDim>& scan, const Measured& given) {
    return std::apply(
        [&](const auto&... of_layer) {
          (check<Values>(scan, of_layer), ...);
          return PackedMeasured{{PackedMeasurements<Values>(scan, of_layer.data())...}};
        },
        given);
  }
  /// One a beam for each layer. @param scan see PackedMeasurements::at().
  [[nodiscard]] static std::tuple<std::vector<typename Values::Measurement>...> unpacked(
      const ScanView<kDim>& scan, const PackedMeasured& kept) {
    return std::apply([&](const auto&... layer) { return std::make_tuple(layer.at(scan)...); }, kept.layers);
  }
  /// How far a scan reaches.
  struct Reach {
    typename Map::Reach beams;
    Box<kDim> ends;  ///< See ends_of().
  };
  [[nodiscard]] static constexpr bool undoes_insertions() { return false; }

  /// As insert(), but only cells in some cubes of max_cell_size change. @param reach see grow_to().
  /// @throws as insert(); the map is then not what it was.
  auto insert_in(const CubeSet<kDim>& cubes, const ScanView<kDim>& scan, const PackedMeasured& measured,
                 double max_range, int threads, Reach& reach) {
    const auto report = map_.insert_in(cubes, scan, {}, max_range, threads, reach.beams);
    reach.ends = ends_of(map_.tree().geometry(), scan, max_range);
    const auto measurements = unpacked(scan, measured);
    std::apply(
        [&](const auto&... of_layer) {
          add(scan, Measured(of_layer...), max_range, std::nullopt, &cubes,
              std::index_sequence_for<Values...>{});
        },
        measurements);
    return report;
  }
  /// Makes the room that a scan of this reach needs, as insert() does. @param reach as insert_in() gave it.
  void grow_to(const Reach& reach, const PackedMeasured& /*of_all*/) {
    map_.grow_to(reach.beams, {});
    std::apply([&](auto&... layer) { (layer.grow_to(reach.ends), ...); }, layers_);
  }
  /// As OccupancyMap::adopt_outside() and adopt_inside(). @throws as these; some may be adopted then.
  void adopt_outside(const CubeSet<kDim>& cubes, const LayeredMap& other) {
    map_.adopt_outside(cubes, other.map_);
    adopt_layers(other, detail::outside(cubes), std::index_sequence_for<Values...>{});
  }
  void adopt_inside(const CubeSet<kDim>& cubes, const LayeredMap& other) {
    map_.adopt_inside(cubes, other.map_);
    adopt_layers(other, detail::inside(cubes), std::index_sequence_for<Values...>{});
  }
  /// A map whose root has grown as this one's, all of it unknown. @param counters that it goes on from.
  [[nodiscard]] LayeredMap emptied(const typename Map::Counters& counters) const {
    return std::apply(
        [&](const auto&... layer) {
          return LayeredMap(map_.emptied(counters), names_, Layers(layer.emptied()...));
        },
        layers_);
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
  [[nodiscard]] const typename Map::Tree& tree() const { return map_.tree(); }
  [[nodiscard]] const typename Map::Options& options() const { return map_.options(); }
  [[nodiscard]] const typename Map::Counters& counters() const { return map_.counters(); }
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
  /// Adds measurements to the layers, after the map has taken the scan.
  template <std::size_t... I>
  void add(const ScanView<kDim>& scan, const Measured& measurements, double max_range,
           const std::optional<Box<kDim>>& window, const CubeSet<kDim>* cubes, std::index_sequence<I...>) {
    const std::size_t limit = map_.options().memory_limit();
    const auto add_to = [&](auto& layer, const auto& of_layer) {
      using Value = typename std::decay_t<decltype(layer)>::ValueType;
      const std::size_t left = memory_beside(memory_bytes() - layer.memory_bytes(), limit);
      layer = with_scan<typename Map::Cells, Value>(std::move(layer), map_, scan, of_layer.data(), max_range,
                                                    window, left, cubes);
    };
    (add_to(std::get<I>(layers_), std::get<I>(measurements)), ...);
    require_in_limit();
  }
  template <class IsWanted, std::size_t... I>
  void adopt_layers(const LayeredMap& other, const IsWanted& is_wanted, std::index_sequence<I...>) {
    const std::size_t limit = map_.options().memory_limit();
    const auto adopt = [&](auto& layer, const auto& of_other) {
      layer.adopt(of_other, is_wanted, memory_beside(memory_bytes() - layer.memory_bytes(), limit));
    };
    (adopt(std::get<I>(layers_), std::get<I>(other.layers_)), ...);
    require_in_limit();
  }
  /// @throws MemoryLimitReached if map and layers together hold more than they may.
  void require_in_limit() const {
    const std::size_t limit = map_.options().memory_limit();
    if (memory_bytes() > limit) throw MemoryLimitReached(limit);
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
      map.require_in_limit();
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
