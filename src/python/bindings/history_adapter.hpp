// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// ScanHistory behind the interface that Python sees.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <utility>
#include <vector>

#include "beam_pointers.hpp"
#include "history_interface.hpp"
#include "history_map.hpp"
#include "map_adapter.hpp"

namespace ndtree::python {

template <class Map>
class HistoryAdapter final : public HistoryInterface {
  static constexpr int D = Map::kDim;
  static constexpr int kNumbers = D * D + D;  // Of a pose.

 public:
  /// @throws std::invalid_argument as a map with these layers.
  HistoryAdapter(const MapOptions& options, const std::vector<LayerKind>& layers)
      : history_(empty_map(options, layers)) {}

  [[nodiscard]] int dim() const override { return D; }
  [[nodiscard]] const MapOptions& options() const override { return history_.map().options(); }
  [[nodiscard]] std::unique_ptr<MapInterface> map() const override {
    return adapted(history_.map().map(), history_.map().layers());
  }
  [[nodiscard]] std::vector<LayerKind> layers() const override { return history_.map().layers().kinds(); }
  [[nodiscard]] std::vector<Key> keys() const override { return history_.keys(); }
  [[nodiscard]] bool contains(Key key) const override { return history_.contains(key); }
  [[nodiscard]] std::vector<double> pose(Key key) const override {
    const Pose<D>& pose = history_.pose(key);
    std::vector<double> numbers;
    numbers.reserve(kNumbers);
    for (int row = 0; row < D; ++row)
      for (int column = 0; column < D; ++column) numbers.push_back(pose.rotation(row, column));
    numbers.insert(numbers.end(), pose.translation.data(), pose.translation.data() + D);
    return numbers;
  }
  [[nodiscard]] StoredScan scan(Key key) const override {
    const Scan<D> scan = history_.scan(key);
    StoredScan stored;
    stored.endpoints.assign(scan.endpoints.data(), scan.endpoints.data() + scan.endpoints.size());
    stored.origins.assign(scan.origins.data(), scan.origins.data() + scan.origins.size());
    stored.returned.assign(scan.returned.data(), scan.returned.data() + scan.returned.size());
    stored.range_sigma.assign(scan.range_sigma.data(), scan.range_sigma.data() + scan.range_sigma.size());
    return stored;
  }
  [[nodiscard]] std::vector<LayerNumbers> measurements(Key key) const override {
    return history_.measurements(key);
  }
  [[nodiscard]] std::size_t memory_bytes() const override { return history_.memory_bytes(); }
  InsertReport insert(Key key, const BeamPointers& beams, const double* pose,
                      const std::vector<LayerMeasurements>& layers, double max_range, int threads) override {
    return history_.insert(key, beams.view<D>(), pose_of<D>(pose), layers, max_range, threads);
  }
  HistoryReport move(const std::vector<Key>& keys, const double* poses, int threads) override {
    std::vector<std::pair<Key, Pose<D>>> moved;
    moved.reserve(keys.size());
    for (const Key key : keys) {
      moved.emplace_back(key, pose_of<D>(poses));
      poses += kNumbers;
    }
    return history_.move(moved, threads);
  }
  HistoryReport remove(const std::vector<Key>& keys, int threads) override {
    return history_.remove(keys, threads);
  }
  void freeze(std::size_t count, int threads) override { history_.freeze(count, threads); }
  [[nodiscard]] std::size_t num_frozen() const override { return history_.num_frozen(); }

 private:
  [[nodiscard]] static HistoryMap<Map> empty_map(const MapOptions& options,
                                                 const std::vector<LayerKind>& layers) {
    Map map(options);
    typename HistoryMap<Map>::Layers empty;
    for (const LayerKind& kind : layers) empty.add(kind, map.tree().geometry());
    require_room_for_empty(map.memory_bytes() + empty.memory_bytes(), options.memory_limit());
    return {std::move(map), std::move(empty)};
  }

  ScanHistory<HistoryMap<Map>> history_;
};

template <int N, int D>
std::unique_ptr<HistoryInterface> make_history(const MapOptions& options,
                                               const std::vector<LayerKind>& layers) {
  return std::make_unique<HistoryAdapter<AdaptiveMap<N, D>>>(options, layers);
}

}  // namespace ndtree::python
