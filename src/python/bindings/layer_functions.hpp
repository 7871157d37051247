// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What the layers of a Python map do: compiled in files of their own, see layers_2.cpp.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string_view>
#include <type_traits>
#include <utility>

#include "map_layers.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/io/layer_file.hpp"
#include "ndtree/layers/layered_map.hpp"
#include "ndtree/query/transform.hpp"
#include "ndtree/tree/adopt.hpp"

namespace ndtree::python {

/// How a value is given and taken as numbers: nan where there is none.
template <class Value>
struct ValueNumbers;
template <int K>
struct ValueNumbers<MeanValue<K>> {
  static constexpr std::size_t kWidth = K;
  static typename MeanValue<K>::Measurement from(const double* numbers) {
    typename MeanValue<K>::Measurement measurement;
    constexpr double kMost = std::numeric_limits<float>::max();
    for (std::size_t i = 0; i < K; ++i) {
      if (std::isfinite(numbers[i]) && std::abs(numbers[i]) > kMost)
        throw std::invalid_argument(describe_number(numbers[i]) + ": must be within " +
                                    describe_number(kMost) + ", as it is held as float32");
      measurement[i] = static_cast<float>(numbers[i]);
    }
    return measurement;
  }
  static void to(const MeanValue<K>& value, double* numbers) {
    for (std::size_t i = 0; i < K; ++i) numbers[i] = static_cast<double>(value.mean()[i]);
  }
};
template <>
struct ValueNumbers<MajorityLabel> {
  static constexpr std::size_t kWidth = 1;
  static std::int64_t from(const double* number) {
    if (std::nearbyint(*number) != *number || !(std::abs(*number) < 1e15))
      throw std::invalid_argument(describe_number(*number) + ": must be a whole number in [0, " +
                                  std::to_string(MajorityLabel::kMaxLabel) + "]");
    return static_cast<std::int64_t>(*number);
  }
  static void to(const MajorityLabel& value, double* number) { *number = value.label(); }
};
template <>
struct ValueNumbers<LatestStamp> {
  static constexpr std::size_t kWidth = 1;
  static double from(const double* number) { return *number; }
  static void to(const LatestStamp& value, double* number) { *number = value.stamp(); }
};

template <int N, int D>
MapLayers<N, D>::MapLayers() = default;
template <int N, int D>
MapLayers<N, D>::MapLayers(const MapLayers&) = default;
template <int N, int D>
MapLayers<N, D>::MapLayers(MapLayers&&) noexcept = default;
template <int N, int D>
MapLayers<N, D>& MapLayers<N, D>::operator=(const MapLayers&) = default;
template <int N, int D>
MapLayers<N, D>& MapLayers<N, D>::operator=(MapLayers&&) noexcept = default;
template <int N, int D>
MapLayers<N, D>::~MapLayers() = default;

template <int N, int D>
std::vector<LayerKind> MapLayers<N, D>::kinds() const {
  std::vector<LayerKind> kinds;
  for (const Named& one : layers_)
    std::visit(
        [&](const auto& layer) {
          kinds.push_back({one.name, ValueOf<decltype(layer)>::rule()});
        },
        one.layer);
  return kinds;
}
template <int N, int D>
void MapLayers<N, D>::add(const LayerKind& kind, const LatticeGeometry<N, D>& geometry) {
  AnyLayer layer{Layer<N, D, LatestStamp>(geometry)};
  if (!choose<MeanValue<1>, MeanValue<3>, MajorityLabel, LatestStamp>(kind.rule, geometry, layer))
    throw std::invalid_argument("layers: " + describe_text(kind.name) + ": " + describe_text(kind.rule) +
                                ": must be 'mean', 'mean3', 'majority' or 'latest'");
  layers_.push_back({kind.name, std::move(layer)});
}
template <int N, int D>
void MapLayers<N, D>::check(const ScanView<D>& scan, const std::vector<LayerMeasurements>& all) const {
  for (const LayerMeasurements& one : all)
    std::visit(
        [&](const auto& layer) {
          using Value = ValueOf<decltype(layer)>;
          try {
            if (one.width != ValueNumbers<Value>::kWidth)
              throw std::invalid_argument(std::to_string(one.width) + " numbers a beam: must be " +
                                          std::to_string(ValueNumbers<Value>::kWidth));
            check_measurements<Value>(scan, measurements<Value>(scan, one).data());
          } catch (const std::invalid_argument& error) {
            throw std::invalid_argument("layers: " + describe_text(one.name) + ": " + error.what());
          }
        },
        find(one.name).layer);
}
template <int N, int D>
void MapLayers<N, D>::add_scan(const LayeredCells<N, D>& map, std::size_t map_bytes, std::size_t max_memory,
                               const ScanView<D>& scan, const std::vector<LayerMeasurements>& all,
                               double max_range, const std::optional<Box<D>>& window) {
  for (const LayerMeasurements& one : all)
    std::visit(
        [&](auto& layer) {
          const auto of_beams = measurements<ValueOf<decltype(layer)>>(scan, one);
          add_to(layer, map, map_bytes, max_memory, scan, of_beams.data(), max_range, window);
        },
        find(one.name).layer);
}
template <int N, int D>
template <class Value>
void MapLayers<N, D>::add_to(Layer<N, D, Value>& layer, const LayeredCells<N, D>& map, std::size_t map_bytes,
                             std::size_t max_memory, const ScanView<D>& scan,
                             const typename Value::Measurement* of_beams, double max_range,
                             const std::optional<Box<D>>& window, const CubeSet<D>* cubes) {
  const std::size_t others = map_bytes + memory_bytes() - layer.memory_bytes();
  layer = with_scan<LayeredCells<N, D>, Value>(std::move(layer), map, scan, of_beams, max_range, window,
                                               memory_beside(others, max_memory), cubes);
}
template <int N, int D>
PackedLayers MapLayers<N, D>::packed(const ScanView<D>& scan,
                                     const std::vector<LayerMeasurements>& all) const {
  check(scan, all);
  PackedLayers packed;
  packed.all.reserve(all.size());
  for (const LayerMeasurements& one : all) {
    const Named& named = find(one.name);
    std::visit(
        [&](const auto& layer) {
          using Value = ValueOf<decltype(layer)>;
          const auto given = measurements<Value>(scan, one);
          packed.all.push_back({static_cast<std::size_t>(&named - layers_.data()),
                                PackedMeasurements<Value>(scan, given.data())});
        },
        named.layer);
  }
  return packed;
}
template <int N, int D>
void MapLayers<N, D>::add_packed(const LayeredCells<N, D>& map, std::size_t map_bytes, std::size_t max_memory,
                                 const ScanView<D>& scan, const PackedLayers& measured, double max_range,
                                 const CubeSet<D>& cubes) {
  for (const PackedLayers::One& one : measured.all)
    std::visit(
        [&](auto& layer) {
          using Value = ValueOf<decltype(layer)>;
          const auto of_beams = std::get<PackedMeasurements<Value>>(one.measurements).at(scan);
          add_to(layer, map, map_bytes, max_memory, scan, of_beams.data(), max_range, std::nullopt, &cubes);
        },
        layers_[one.layer].layer);
}
template <int N, int D>
void MapLayers<N, D>::grow_to(const Box<D>& ends, const PackedLayers& measured) {
  for (const PackedLayers::One& one : measured.all)
    std::visit([&](auto& layer) { layer.grow_to(ends); }, layers_[one.layer].layer);
}
template <int N, int D>
void MapLayers<N, D>::adopt_inside(const CubeSet<D>& cubes, const MapLayers& others, std::size_t max_memory) {
  adopt(others, detail::inside(cubes), max_memory);
}
template <int N, int D>
void MapLayers<N, D>::adopt_outside(const CubeSet<D>& cubes, const MapLayers& others,
                                    std::size_t max_memory) {
  adopt(others, detail::outside(cubes), max_memory);
}
template <int N, int D>
template <class IsWanted>
void MapLayers<N, D>::adopt(const MapLayers& others, const IsWanted& is_wanted, std::size_t max_memory) {
  for (std::size_t i = 0; i < layers_.size(); ++i)
    std::visit(
        [&](auto& layer) {
          layer.adopt(std::get<std::decay_t<decltype(layer)>>(others.layers_[i].layer), is_wanted,
                      memory_beside(memory_bytes() - layer.memory_bytes(), max_memory));
        },
        layers_[i].layer);
}
template <int N, int D>
MapLayers<N, D> MapLayers<N, D>::emptied() const {
  MapLayers empty;
  for (const Named& one : layers_)
    empty.layers_.push_back(
        {one.name, std::visit([](const auto& layer) { return AnyLayer(layer.emptied()); }, one.layer)});
  return empty;
}
template <int N, int D>
std::vector<LayerNumbers> MapLayers<N, D>::numbers(const ScanView<D>& scan,
                                                   const PackedLayers& measured) const {
  std::vector<LayerNumbers> all;
  for (const PackedLayers::One& one : measured.all)
    std::visit(
        [&](const auto& layer) {
          using Value = ValueOf<decltype(layer)>;
          constexpr std::size_t kWidth = ValueNumbers<Value>::kWidth;
          const auto of_beams = std::get<PackedMeasurements<Value>>(one.measurements).at(scan);
          std::vector<double> numbers(of_beams.size() * kWidth, std::numeric_limits<double>::quiet_NaN());
          for (std::size_t i = 0; i < of_beams.size(); ++i) {
            if (!scan.is_returned(static_cast<Eigen::Index>(i))) continue;
            Value value;
            value.add(of_beams[i]);
            ValueNumbers<Value>::to(value, numbers.data() + i * kWidth);
          }
          all.push_back({{layers_[one.layer].name, Value::rule()}, kWidth, std::move(numbers)});
        },
        layers_[one.layer].layer);
  return all;
}
template <int N, int D>
void MapLayers<N, D>::values_at(const LayeredCells<N, D>& map, const std::string& name, const double* points,
                                std::size_t n, std::vector<double>& numbers) const {
  std::visit(
      [&](const auto& layer) {
        using Value = ValueOf<decltype(layer)>;
        constexpr std::size_t kWidth = ValueNumbers<Value>::kWidth;
        numbers.assign(n * kWidth, std::numeric_limits<double>::quiet_NaN());
        for_each_paced(n, 16, [&](std::size_t i) {
          const Value value = value_at(map, layer, Vector<D>(Eigen::Map<const Vector<D>>(points + i * D)));
          if (!value.is_empty()) ValueNumbers<Value>::to(value, numbers.data() + i * kWidth);
        });
      },
      find(name).layer);
}
template <int N, int D>
void MapLayers<N, D>::keep_known(const LayeredCells<N, D>& tree,
                                 const std::function<bool(const Box<D>&)>& may_differ) {
  for (Named& one : layers_) std::visit([&](auto& layer) { layer.keep_known(tree, may_differ); }, one.layer);
}
template <int N, int D>
void MapLayers<N, D>::join(const MapLayers& others, const LayeredCells<N, D>& tree, std::size_t max_memory) {
  for (const LayerKind& kind : others.kinds()) {
    const Named* const own = find_or_null(kind.name);
    if (own == nullptr) add(kind, tree.geometry());
    std::visit(
        [&](const auto& other) {
          auto* const layer = std::get_if<std::decay_t<decltype(other)>>(&find(kind.name).layer);
          if (layer == nullptr)
            throw std::invalid_argument("layers: " + describe_text(kind.name) + ": follows the rule " +
                                        describe_text(kind.rule) + " in the other map: must be the same");
          const std::size_t beside = memory_bytes() - layer->memory_bytes();
          layer->limit_memory(memory_beside(beside, max_memory));
          layer->join(other, tree);
          layer->limit_memory(kUnlimitedMemory);
        },
        others.find(kind.name).layer);
  }
}
template <int N, int D>
MapLayers<N, D> MapLayers<N, D>::transformed(const LayeredCells<N, D>& moved, const Pose<D>& pose,
                                             const std::optional<LatticeMotion<D>>& motion,
                                             std::size_t max_memory) const {
  const auto& geometry = moved.geometry();
  const int level = moved.coarsest_level();
  MapLayers result;
  for (const Named& one : layers_)
    std::visit(
        [&](const auto& layer) {
          using LayerType = std::decay_t<decltype(layer)>;
          const std::size_t left = memory_beside(result.memory_bytes(), max_memory);
          std::optional<LayerType> target;
          if (motion) target = transformed_layer(layer, level, *motion, left);
          if (!target) {
            target.emplace(geometry);
            target->limit_memory(left);
            layer.for_each([&](const auto&, const Vector<D>& centre, const auto& value) {
              const Vector<D> point = pose * centre;
              const auto leaf = moved.tree().find_leaf(point);
              if (leaf && leaf->cell().observed()) target->join(leaf->index, point, value);
            });
            target->limit_memory(kUnlimitedMemory);
          }
          result.layers_.push_back({one.name, std::move(*target)});
        },
        one.layer);
  if (result.memory_bytes() > max_memory) throw MemoryLimitReached(max_memory);
  return result;
}
template <int N, int D>
void MapLayers<N, D>::for_each_change(
    const MapLayers& before, const std::function<void(const CellIndex<D>&, const Vector<D>&)>& visit) const {
  for (const Named& one : layers_) {
    const Named* const other = before.find_or_null(one.name);
    std::visit(
        [&](const auto& layer) {
          const auto* const old =
              other != nullptr ? std::get_if<std::decay_t<decltype(layer)>>(&other->layer) : nullptr;
          if (old != nullptr && is_shared(layer, *old)) return;
          layer.for_each([&](const CellIndex<D>& cell, const Vector<D>& centre, const auto& value) {
            if (old == nullptr || old->of(cell).words() != value.words()) visit(cell, centre);
          });
          if (old == nullptr) return;
          old->for_each([&](const CellIndex<D>& cell, const Vector<D>& centre, const auto&) {
            if (layer.of(cell).is_empty()) visit(cell, centre);
          });
        },
        one.layer);
  }
}
template <int N, int D>
void MapLayers<N, D>::shrink_to_fit() {
  for (Named& one : layers_) std::visit([](auto& layer) { layer.tree().shrink_to_fit(); }, one.layer);
}
template <int N, int D>
std::size_t MapLayers<N, D>::memory_bytes() const {
  std::size_t bytes = 0;
  for (const Named& one : layers_)
    bytes += std::visit([](const auto& layer) { return layer.memory_bytes(); }, one.layer);
  return bytes;
}
template <int N, int D>
std::vector<StoredLayer> MapLayers<N, D>::stored() const {
  std::vector<StoredLayer> all;
  for (const Named& one : layers_)
    all.push_back(std::visit([&](const auto& layer) { return ndtree::stored(layer, one.name); }, one.layer));
  return all;
}
template <int N, int D>
void MapLayers<N, D>::restore(const std::vector<StoredLayer>& all, const LatticeGeometry<N, D>& geometry) {
  for (const StoredLayer& one : all) {
    try {
      add({one.name, one.rule}, geometry);
    } catch (const std::invalid_argument& error) {
      throw std::runtime_error(error.what());
    }
    std::visit([&](auto& layer) { layer = restored<std::decay_t<decltype(layer)>>(one, geometry); },
               layers_.back().layer);
  }
}
template <int N, int D>
const Layer<N, D, MeanValue<3>>* MapLayers<N, D>::colors() const {
  for (const Named& one : layers_)
    if (one.name == "color" || one.name == "colour")
      if (const auto* const layer = std::get_if<Layer<N, D, MeanValue<3>>>(&one.layer)) return layer;
  return nullptr;
}
template <int N, int D>
std::vector<PlyProperty> MapLayers<N, D>::ply_properties() const {
  using Type = PlyProperty::Type;
  std::vector<PlyProperty> all;
  const auto add = [&](std::string name, Type type) {
    static constexpr std::array<std::string_view, 6> kOfCells = {"x",    "y",           "z",
                                                                 "size", "probability", "state"};
    const auto is_taken = [&] {
      return std::find(kOfCells.begin(), kOfCells.end(), name) != kOfCells.end() ||
             std::any_of(all.begin(), all.end(), [&](const PlyProperty& one) { return one.name == name; });
    };
    while (is_taken()) name += "_";
    all.push_back({name, type});
  };
  for (const LayerKind& kind : kinds()) {
    if (kind.rule != MeanValue<3>::rule()) {
      add(kind.name, kind.rule == MajorityLabel::rule() ? Type::int_
                     : kind.rule == LatestStamp::rule() ? Type::double_
                                                        : Type::float_);
    } else if (kind.name == "color" || kind.name == "colour") {
      for (const char* const name : {"red", "green", "blue"}) add(name, Type::uchar);
    } else {
      for (const char* const suffix : {"_0", "_1", "_2"}) add(kind.name + suffix, Type::float_);
    }
  }
  return all;
}
template <int N, int D>
void MapLayers<N, D>::ply_numbers(const CellIndex<D>& leaf, double* numbers) const {
  for (const Named& one : layers_)
    std::visit(
        [&](const auto& layer) {
          using Value = ValueOf<decltype(layer)>;
          using Numbers = ValueNumbers<Value>;
          const Value value = leaf.level <= 0 ? layer.of(leaf) : Value{};
          std::fill_n(numbers, Numbers::kWidth,
                      std::is_same_v<Value, MajorityLabel> ? -1.0 : std::numeric_limits<double>::quiet_NaN());
          if (!value.is_empty()) Numbers::to(value, numbers);
          numbers += Numbers::kWidth;
        },
        one.layer);
}
template <int N, int D>
template <class LayerType>
bool MapLayers<N, D>::is_shared(const LayerType& one, const LayerType& other) {
  const auto own = one.tree().root();
  const auto others = other.tree().root();
  return own.index == others.index && !own.is_leaf() && !others.is_leaf() &&
         one.tree().shares_children(*own.node, other.tree(), *others.node);
}
template <int N, int D>
template <class... Values>
bool MapLayers<N, D>::choose(const std::string& rule, const LatticeGeometry<N, D>& geometry,
                             AnyLayer& layer) {
  return (... || (rule == Values::rule() && (layer = Layer<N, D, Values>(geometry), true)));
}
template <int N, int D>
template <class Value>
std::vector<typename Value::Measurement> MapLayers<N, D>::measurements(const ScanView<D>& scan,
                                                                       const LayerMeasurements& given) {
  std::vector<typename Value::Measurement> all(static_cast<std::size_t>(scan.size));
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (!ends_in_a_cell(scan, static_cast<Eigen::Index>(i))) continue;
    try {
      all[i] = ValueNumbers<Value>::from(given.numbers + i * given.width);
    } catch (const std::invalid_argument& error) {
      throw std::invalid_argument("'" + Value::rule() + "' of beam " + std::to_string(i) + " = " +
                                  error.what());
    }
  }
  return all;
}
template <int N, int D>
const typename MapLayers<N, D>::Named* MapLayers<N, D>::find_or_null(const std::string& name) const {
  for (const Named& one : layers_)
    if (one.name == name) return &one;
  return nullptr;
}
template <int N, int D>
const typename MapLayers<N, D>::Named& MapLayers<N, D>::find(const std::string& name) const {
  if (const Named* const one = find_or_null(name)) return *one;
  std::string all;
  for (const Named& one : layers_) all += (all.empty() ? "" : ", ") + describe_text(one.name);
  throw std::invalid_argument("layers: " + describe_text(name) + ": the map has " +
                              (all.empty() ? "none" : all));
}
template <int N, int D>
typename MapLayers<N, D>::Named& MapLayers<N, D>::find(const std::string& name) {
  return const_cast<Named&>(std::as_const(*this).find(name));
}

}  // namespace ndtree::python
