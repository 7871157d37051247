// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is tried with the values that cells of a file carry.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "ndtree/core/scan.hpp"
#include "ndtree/io/layer_file.hpp"
#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/layers/values.hpp"
#include "target.hpp"

namespace ndtree::fuzz {

inline void measure(Bytes& bytes, double& measurement) { measurement = bytes.raw_double(); }
inline void measure(Bytes& bytes, std::int64_t& measurement) {
  const double any = bytes.raw_double();
  std::memcpy(&measurement, &any, sizeof measurement);
  if (bytes.flag()) measurement = measurement & 3;
}
template <std::size_t K>
void measure(Bytes& bytes, std::array<float, K>& measurement) {
  for (float& x : measurement) x = static_cast<float>(bytes.length(1.0));
}

/// A layer of a file, whatever it holds, is refused or good: it is written as it was read, answers, and takes
/// a scan, or refuses it and stays.
template <class Value, class Map>
void read_layer(const StoredLayer& from_file, const Map& map, const Scan<Map::kDim>& scan, Bytes& more) {
  using LayerType = Layer<Map::kBranching, Map::kDim, Value>;
  if (from_file.rule != Value::rule()) return;
  accepted([&] {
    LayerType layer = restored<LayerType>(from_file, map.tree().geometry());
    const StoredLayer written = stored(layer, from_file.name);
    require(
        stored(restored<LayerType>(written, map.tree().geometry()), from_file.name).bytes == written.bytes,
        "a layer that is saved and read is the same");
    std::vector<typename Value::Measurement> measurements(static_cast<std::size_t>(scan.size()));
    for (auto& measurement : measurements) measure(more, measurement);
    if (accepted([&] { check_measurements<Value>(scan.view(), measurements.data()); }))
      accepted([&] {
        layer =
            with_scan(layer, map, scan.view(), measurements.data(), kUnlimitedRange, std::nullopt, 1u << 16);
      });
    layer.tree().check_invariants();
    layer.for_each([&](const auto& cell, const auto& centre, const Value& value) {
      require(cell.level <= 0 && centre.allFinite(), "values stand in cells");
      (void)value_at(map, layer, centre);
      require(!value.is_empty(), "values that are visited are values");
      require(Value::from_words(value.words()).words() == value.words(), "a value can be written");
    });
    layer.keep_known(map.tree(), [](const auto&) { return true; });
  });
}

/// Those rules that the library knows.
template <class Map>
void read_layers(const std::vector<StoredLayer>& layers, const Map& map, const Scan<Map::kDim>& scan,
                 Bytes& more) {
  for (const StoredLayer& layer : layers) {
    read_layer<MeanValue<1>>(layer, map, scan, more);
    read_layer<MeanValue<3>>(layer, map, scan, more);
    read_layer<MajorityLabel>(layer, map, scan, more);
    read_layer<LatestStamp>(layer, map, scan, more);
  }
}

}  // namespace ndtree::fuzz
