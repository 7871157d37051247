// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The layers of a Python map: named, of rules that are chosen when the map is made, and numbers in and out.
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "ndtree/core/body.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/io/ply.hpp"
#include "ndtree/layers/layer.hpp"
#include "ndtree/layers/packed_measurements.hpp"
#include "ndtree/layers/values.hpp"
#include "ndtree/mapping/map_cells.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/lattice_motion.hpp"

namespace ndtree::python {

/// A layer's name, and its values' rule.
struct LayerKind {
  std::string name;
  std::string rule;
};
/// The measurements of a scan for a layer: `width` numbers a beam.
struct LayerMeasurements {
  std::string name;
  const double* numbers = nullptr;
  std::size_t width = 1;
};

/// The measurements of a scan that is kept, of the layers that it has some for.
struct PackedLayers {
  struct One {
    std::size_t layer = 0;  ///< Of the map's.
    std::variant<PackedMeasurements<MeanValue<1>>, PackedMeasurements<MeanValue<3>>,
                 PackedMeasurements<MajorityLabel>, PackedMeasurements<LatestStamp>>
        measurements;
  };
  std::vector<One> all;

  [[nodiscard]] std::size_t memory_bytes() const {
    std::size_t bytes = sizeof(*this) + all.capacity() * sizeof(One);
    for (const One& one : all)
      bytes += std::visit([](const auto& m) { return m.memory_bytes() - sizeof(m); }, one.measurements);
    return bytes;
  }
};
/// Measurements as numbers, `width` a beam: nan for beams that did not return.
struct LayerNumbers {
  LayerKind kind;
  std::size_t width = 1;
  std::vector<double> numbers;
};

/// What layers ask of their map, whatever its cells, so that they are compiled once for all refinements.
template <int N, int D>
class LayeredCells {
 public:
  static constexpr int kBranching = N;
  static constexpr int kDim = D;
  struct Leaf {
    CellIndex<D> index;
    bool is_observed = false;

    [[nodiscard]] const Leaf& cell() const { return *this; }
    [[nodiscard]] bool observed() const { return is_observed; }
  };

  virtual ~LayeredCells() = default;
  [[nodiscard]] const LayeredCells& tree() const { return *this; }
  [[nodiscard]] virtual const LatticeGeometry<N, D>& geometry() const = 0;
  [[nodiscard]] virtual int coarsest_level() const = 0;
  [[nodiscard]] virtual std::optional<Leaf> find_leaf(const Vector<D>& point) const = 0;
  [[nodiscard]] virtual KnownPart known_part(const CellIndex<D>& cell) const = 0;
};
template <int N, int D>
[[nodiscard]] KnownPart known_part(const LayeredCells<N, D>& cells, const CellIndex<D>& cell) {
  return cells.known_part(cell);
}

/// A view of a map's cells.
template <class Cells>
class LayeredCellsOf final : public LayeredCells<Cells::kBranching, Cells::kDim> {
  static constexpr int D = Cells::kDim;
  using Leaf = typename LayeredCells<Cells::kBranching, D>::Leaf;

 public:
  explicit LayeredCellsOf(const Cells& cells) : cells_(cells) {}
  [[nodiscard]] const LatticeGeometry<Cells::kBranching, D>& geometry() const override {
    return cells_.tree().geometry();
  }
  [[nodiscard]] int coarsest_level() const override { return cells_.coarsest_level(); }
  [[nodiscard]] std::optional<Leaf> find_leaf(const Vector<D>& point) const override {
    const auto leaf = cells_.tree().find_leaf(point);
    return leaf ? std::optional(Leaf{leaf->index, leaf->cell().observed()}) : std::nullopt;
  }
  [[nodiscard]] KnownPart known_part(const CellIndex<D>& cell) const override {
    return ndtree::known_part(cells_.tree(), cell);
  }

 private:
  const Cells& cells_;
};
template <int N, int D, class Cell>
LayeredCellsOf(const MapCells<N, D, Cell>&) -> LayeredCellsOf<MapCells<N, D, Cell>>;

/// All layers of a map with cells of N^D children. What they do is compiled once, see layer_functions.hpp.
template <int N, int D>
class MapLayers {
  using AnyLayer = std::variant<Layer<N, D, MeanValue<1>>, Layer<N, D, MeanValue<3>>,
                                Layer<N, D, MajorityLabel>, Layer<N, D, LatestStamp>>;
  struct Named {
    std::string name;
    AnyLayer layer;
  };
  template <class LayerType>
  using ValueOf = typename std::decay_t<LayerType>::ValueType;

 public:
  MapLayers();
  MapLayers(const MapLayers&);
  MapLayers(MapLayers&&) noexcept;
  MapLayers& operator=(const MapLayers&);
  MapLayers& operator=(MapLayers&&) noexcept;
  ~MapLayers();

  [[nodiscard]] bool empty() const { return layers_.empty(); }
  [[nodiscard]] std::vector<LayerKind> kinds() const;
  /// @throws std::invalid_argument for a rule that there is not.
  void add(const LayerKind& kind, const LatticeGeometry<N, D>& geometry);

  /// @throws std::invalid_argument naming the layer, and what of it is wrong.
  void check(const ScanView<D>& scan, const std::vector<LayerMeasurements>& all) const;
  /// After a map has taken a scan. @param max_memory of map and layers, of which the map holds `map_bytes`.
  /// @pre check() has passed.
  void add_scan(const LayeredCells<N, D>& map, std::size_t map_bytes, std::size_t max_memory,
                const ScanView<D>& scan, const std::vector<LayerMeasurements>& all, double max_range,
                const std::optional<Box<D>>& window);
  /// What of a scan's measurements is kept. @throws as check().
  [[nodiscard]] PackedLayers packed(const ScanView<D>& scan, const std::vector<LayerMeasurements>& all) const;
  /// add_scan() of what was kept, into cubes of max_cell_size. @param scan as it is unpacked.
  void add_packed(const LayeredCells<N, D>& map, std::size_t map_bytes, std::size_t max_memory,
                  const ScanView<D>& scan, const PackedLayers& measured, double max_range,
                  const CubeSet<D>& cubes);
  /// Grows as add_packed() does. @param ends see ends_of().
  void grow_to(const Box<D>& ends, const PackedLayers& measured);
  /// Copies the values of a map with the same layers in cubes of max_cell_size, or in all others, in which
  /// these have none. @param max_memory of all layers together. @throws MemoryLimitReached, Cancelled.
  void adopt_inside(const CubeSet<D>& cubes, const MapLayers& others, std::size_t max_memory);
  void adopt_outside(const CubeSet<D>& cubes, const MapLayers& others, std::size_t max_memory);
  /// The same layers without any value; their roots have grown as these.
  [[nodiscard]] MapLayers emptied() const;
  /// Of a scan. @param scan as it is unpacked.
  [[nodiscard]] std::vector<LayerNumbers> numbers(const ScanView<D>& scan,
                                                  const PackedLayers& measured) const;
  /// Of the cells around points, `width` numbers each: nan where there are none.
  void values_at(const LayeredCells<N, D>& map, const std::string& name, const double* points, std::size_t n,
                 std::vector<double>& numbers) const;
  void keep_known(const LayeredCells<N, D>& tree, const std::function<bool(const Box<D>&)>& may_differ);
  /// Adds those of another map, of which some may be new. @param max_memory of all layers together.
  /// @throws std::invalid_argument if rules differ, MemoryLimitReached.
  void join(const MapLayers& others, const LayeredCells<N, D>& tree, std::size_t max_memory);
  /// The values at their new places in a map that was moved. @param motion as which the pose moves its cells.
  /// @param max_memory of all layers together. @throws MemoryLimitReached.
  [[nodiscard]] MapLayers transformed(const LayeredCells<N, D>& moved, const Pose<D>& pose,
                                      const std::optional<LatticeMotion<D>>& motion,
                                      std::size_t max_memory) const;
  /// Calls `visit(cell, centre)` for values that are not what they were: cells of the layers, perhaps several
  /// times. O(values) of layers that are not the same all over.
  void for_each_change(const MapLayers& before,
                       const std::function<void(const CellIndex<D>&, const Vector<D>&)>& visit) const;
  void shrink_to_fit();
  [[nodiscard]] std::size_t memory_bytes() const;

  [[nodiscard]] std::vector<StoredLayer> stored() const;
  /// @throws std::runtime_error for one that is damaged, or of a rule that there is not.
  void restore(const std::vector<StoredLayer>& all, const LatticeGeometry<N, D>& geometry);

  /// The first layer of three numbers that is called colour or color; null if there is none.
  [[nodiscard]] const Layer<N, D, MeanValue<3>>* colors() const;

  /// Columns of a PLY file: three numbers called colour or color as red, green and blue.
  [[nodiscard]] std::vector<PlyProperty> ply_properties() const;
  void ply_numbers(const CellIndex<D>& leaf, double* numbers) const;

 private:
  /// Adds a scan's measurements to one of the layers. @param cubes see with_scan().
  template <class Value>
  void add_to(Layer<N, D, Value>& layer, const LayeredCells<N, D>& map, std::size_t map_bytes,
              std::size_t max_memory, const ScanView<D>& scan, const typename Value::Measurement* of_beams,
              double max_range, const std::optional<Box<D>>& window, const CubeSet<D>* cubes = nullptr);
  template <class IsWanted>
  void adopt(const MapLayers& others, const IsWanted& is_wanted, std::size_t max_memory);
  template <class LayerType>
  [[nodiscard]] static bool is_shared(const LayerType& one, const LayerType& other);
  template <class... Values>
  static bool choose(const std::string& rule, const LatticeGeometry<N, D>& geometry, AnyLayer& layer);
  /// @throws std::invalid_argument naming the beam.
  template <class Value>
  static std::vector<typename Value::Measurement> measurements(const ScanView<D>& scan,
                                                               const LayerMeasurements& given);
  [[nodiscard]] const Named* find_or_null(const std::string& name) const;
  [[nodiscard]] const Named& find(const std::string& name) const;
  [[nodiscard]] Named& find(const std::string& name);

  std::vector<Named> layers_;
};

}  // namespace ndtree::python
