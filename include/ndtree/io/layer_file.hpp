// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What cells carry, in the map's file.
#pragma once

#include <cstddef>
#include <exception>
#include <filesystem>
#include <new>
#include <stdexcept>
#include <string>
#include <string_view>
#include <tuple>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/layered_map.hpp"

namespace ndtree {

/// A layer as it is stored.
template <int N, int D, class Value>
[[nodiscard]] StoredLayer stored(const Layer<N, D, Value>& layer, const std::string& name) {
  ByteWriter out;
  detail::write_tree(layer.tree(), 0, out);  // No value stands above level 0.
  return {name, Value::rule(), std::move(out.bytes())};
}

/// The layer that stored() made. @param geometry of its map.
/// @throws std::runtime_error naming the layer, if it is damaged or its values follow another rule.
template <class LayerType>
[[nodiscard]] LayerType restored(const StoredLayer& stored, const typename LayerType::Geometry& geometry) {
  using Value = typename LayerType::ValueType;
  const std::string name = "layer " + describe_text(stored.name);
  if (stored.rule != Value::rule())
    throw std::runtime_error(name + ": follows the rule " + describe_text(stored.rule) + ", expected '" +
                             Value::rule() + "'");
  try {
    ByteReader in(stored.bytes);
    LayerType layer(geometry);
    detail::read_tree(layer.tree(), in);
    if (!in.at_end()) throw std::runtime_error("its values end too early");
    layer.for_each([](const auto& cell, const auto&, const auto&) {
      if (cell.level > 0) throw std::runtime_error("a value above the largest cells");
    });
    return layer;
  } catch (const Cancelled&) {
    throw;
  } catch (const std::logic_error& error) {  // A value that no layer has.
    throw std::runtime_error(name + ": damaged: " + error.what());
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(name + ": damaged: " + error.what());
  }
}

/// As those of a map without layers.
template <class Map, class... Values>
[[nodiscard]] std::string to_bytes(const LayeredMap<Map, Values...>& map) {
  std::vector<StoredLayer> layers;
  std::size_t i = 0;
  std::apply([&](const auto&... layer) { (layers.push_back(stored(layer, map.names()[i++])), ...); },
             map.layers());
  return to_bytes(map.map(), layers);
}
template <class Map, class... Values>
void save(const LayeredMap<Map, Values...>& map, const std::filesystem::path& path) {
  write_file(path, to_bytes(map));
}

namespace detail {

/// The layer of a name; one without values if there is none.
template <class LayerType>
[[nodiscard]] LayerType restored_or_empty(const std::vector<StoredLayer>& layers, const std::string& name,
                                          const typename LayerType::Geometry& geometry) {
  for (const StoredLayer& layer : layers)
    if (layer.name == name) return restored<LayerType>(layer, geometry);
  return LayerType(geometry);
}

template <class Map, std::size_t... I>
[[nodiscard]] Map layered(typename Map::MapType map, typename Map::Names names,
                          const std::vector<StoredLayer>& stored, std::index_sequence<I...>) {
  typename Map::Layers layers(restored_or_empty<std::tuple_element_t<I, typename Map::Layers>>(
      stored, names[I], map.tree().geometry())...);
  return Map(std::move(map), std::move(names), std::move(layers));
}

}  // namespace detail

/// The map that to_bytes() wrote, with those of its layers that have these names; others are left out, and
/// those that the bytes do not hold have no values yet.
/// @tparam Map a LayeredMap. @throws std::runtime_error as for maps without layers, and restored().
template <class Map>
[[nodiscard]] Map layered_from_bytes(std::string_view bytes, typename Map::Names names) {
  std::vector<StoredLayer> layers;
  auto map = from_bytes<typename Map::MapType>(bytes, &layers);
  return detail::layered<Map>(std::move(map), std::move(names), layers,
                              std::make_index_sequence<Map::kNumLayers>{});
}
/// Reads what save() wrote. @throws std::runtime_error naming file and reason.
template <class Map>
[[nodiscard]] Map load_layered(const std::filesystem::path& path, typename Map::Names names) {
  const std::string bytes = read_file(path);
  try {
    return layered_from_bytes<Map>(bytes, std::move(names));
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(path.string() + ": " + error.what());
  }
}

}  // namespace ndtree
