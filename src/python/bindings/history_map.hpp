// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A map and the layers of a Python map, as a ScanHistory asks for them.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "map_layers.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/tree/cube_set.hpp"

namespace ndtree::python {

/// As LayeredMap, with layers that are chosen when it is made; a scan may have measurements for some of them.
template <class Map>
class HistoryMap {
 public:
  static constexpr int kBranching = Map::kBranching;
  static constexpr int kDim = Map::kDim;
  using Layers = MapLayers<kBranching, kDim>;
  using Measured = std::vector<LayerMeasurements>;
  using PackedMeasured = PackedLayers;
  struct Reach {
    typename Map::Reach beams;
    Box<kDim> ends;
  };

  HistoryMap(Map map, Layers layers) : map_(std::move(map)), layers_(std::move(layers)) {}

  [[nodiscard]] const Map& map() const { return map_; }
  [[nodiscard]] const Layers& layers() const { return layers_; }
  [[nodiscard]] const typename Map::Tree& tree() const { return map_.tree(); }
  [[nodiscard]] const typename Map::Options& options() const { return map_.options(); }
  [[nodiscard]] const typename Map::Counters& counters() const { return map_.counters(); }
  [[nodiscard]] std::size_t memory_bytes() const { return map_.memory_bytes() + layers_.memory_bytes(); }

  [[nodiscard]] auto measurements(const ScanView<kDim>& scan, double max_range) const {
    return map_.measurements(scan, max_range);
  }
  [[nodiscard]] bool undoes_insertions() const { return layers_.empty() && map_.undoes_insertions(); }
  [[nodiscard]] PackedMeasured packed(const ScanView<kDim>& scan, const Measured& given) const {
    return layers_.packed(scan, given);
  }
  [[nodiscard]] std::vector<LayerNumbers> unpacked(const ScanView<kDim>& scan,
                                                   const PackedMeasured& kept) const {
    return layers_.numbers(scan, kept);
  }
  InsertReport insert_in(const CubeSet<kDim>& cubes, const ScanView<kDim>& scan,
                         const PackedMeasured& measured, double max_range, int threads, Reach& reach) {
    const InsertReport report = map_.insert_in(cubes, scan, {}, max_range, threads, reach.beams);
    if (layers_.empty()) return report;
    reach.ends = ends_of(map_.tree().geometry(), scan, max_range);
    within_limit([&](std::size_t limit) {
      layers_.add_packed(LayeredCellsOf(map_.cells()), map_.memory_bytes(), limit, scan, measured, max_range,
                         cubes);
    });
    return report;
  }
  void grow_to(const Reach& reach, const PackedMeasured& measured) {
    map_.grow_to(reach.beams, {});
    layers_.grow_to(reach.ends, measured);
  }
  void adopt_inside(const CubeSet<kDim>& cubes, const HistoryMap& other) {
    map_.adopt_inside(cubes, other.map_);
    if (layers_.empty()) return;
    within_limit([&](std::size_t limit) {
      layers_.adopt_inside(cubes, other.layers_, memory_beside(map_.memory_bytes(), limit));
    });
  }
  void adopt_outside(const CubeSet<kDim>& cubes, const HistoryMap& other) {
    map_.adopt_outside(cubes, other.map_);
    if (layers_.empty()) return;
    within_limit([&](std::size_t limit) {
      layers_.adopt_outside(cubes, other.layers_, memory_beside(map_.memory_bytes(), limit));
    });
  }
  [[nodiscard]] HistoryMap emptied(const typename Map::Counters& counters) const {
    return {map_.emptied(counters), layers_.emptied()};
  }

 private:
  /// Changes layers. @throws MemoryLimitReached naming the limit of map and layers together.
  template <class Change>
  void within_limit(const Change& change) {
    const std::size_t limit = map_.options().memory_limit();
    try {
      change(limit);
    } catch (const MemoryLimitReached&) {
      throw MemoryLimitReached(limit);
    }
    if (memory_bytes() > limit) throw MemoryLimitReached(limit);
  }

  Map map_;
  Layers layers_;
};

}  // namespace ndtree::python
