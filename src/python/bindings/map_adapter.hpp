// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The C++ maps behind the interface that Python sees.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <variant>

#include "beam_pointers.hpp"
#include "map_interface.hpp"
#include "map_layers.hpp"
#include "map_shapes.hpp"
#include "ndtree/cell/hit_rate.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/forget_rule.hpp"
#include "ndtree/core/memory.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/disputed.hpp"
#include "ndtree/query/nearest.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "ndtree/query/transform.hpp"
#include "ndtree/tree/visit.hpp"
#include "query_adapter.hpp"

namespace ndtree::python {

/// Of our own maps, what does not depend on their rules: queries, and values that cells carry.
template <class Cells>
class CellsAdapter : public QueryAdapter<Cells, Cells::kDim> {
 protected:
  static constexpr int D = Cells::kDim;
  static constexpr std::size_t kStepsOfInterval = 1000;  // Two quantiles.
  using Layers = MapLayers<Cells::kBranching, D>;

 public:
  explicit CellsAdapter(Layers layers) : layers_(std::move(layers)) {}

  [[nodiscard]] int branching() const final { return Cells::kBranching; }
  [[nodiscard]] const MapOptions& options() const final { return cells().options(); }
  [[nodiscard]] std::vector<LayerKind> layers() const final { return layers_.kinds(); }
  [[nodiscard]] std::vector<double> layer(const std::string& name, const double* points,
                                          std::size_t n) const final {
    std::vector<double> numbers;
    layers_.values_at(LayeredCellsOf(cells()), name, points, n, numbers);
    return numbers;
  }
  [[nodiscard]] ChangeArrays changes(const MapInterface& before, ChangeOf what,
                                     const std::optional<AnyBox>& part) const final {
    const Cells& map = cells();
    const auto& geometry = map.tree().geometry();
    const auto region = part ? std::optional(box(part->lower, part->upper)) : std::nullopt;
    std::optional<LatticeBox<D>> inside;
    if (region) inside = geometry.cells_in(*region, geometry.finest_level());
    ChangeArrays arrays;
    const auto add = [&](const Change<D>& change) {
      if (inside && !inside->overlaps(change.index, geometry.edge(change.index.level))) return;
      for (const std::int64_t coordinate : change.index.lower)
        arrays.lower.push_back(geometry.border(coordinate));
      arrays.size.push_back(geometry.cell_size(change.index.level));
      arrays.before.push_back(static_cast<std::int8_t>(static_cast<int>(change.before) + change.was_large));
      arrays.after.push_back(static_cast<std::int8_t>(static_cast<int>(change.after) + change.is_large));
    };
    const CellsAdapter& old = same_kind(before);
    for_each_change(old.cells(), map, add, what, region);
    if (what == ChangeOf::cells) for_each_changed_value(old, add);
    return arrays;
  }
  void update_field(AnyField& field, const MapInterface& before) const final {
    auto* const same = std::get_if<DistanceField<D>>(&field.field);
    if (same == nullptr)
      throw std::invalid_argument("a field with dim = " + std::to_string(field.dim()) +
                                  " of a map with dim = " + std::to_string(D));
    update(*same, same_kind(before).cells(), cells());
  }
  void probability(const double* points, std::size_t n, float* out) const final {
    for_each_cell_at(cells(), points, n, [out](std::size_t i, const auto& cell) {
      out[i] = static_cast<float>(cell.probability());
    });
  }
  void moved(const double* points, std::size_t n, float* out) const final {
    probability_moved(cells(), points, n, out);
  }
  void hit_rate(const double* points, std::size_t n, double interval, const HitRateArrays& out) const final {
    Pace pace;
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      const auto rate = ndtree::hit_rate(cells(), Vector<D>(Eigen::Map<const Vector<D>>(points + i * D)));
      if (!rate) {
        out.value[i] = std::numeric_limits<float>::quiet_NaN();
        if (interval > 0.0) out.lower[i] = out.upper[i] = out.value[i];
        return;
      }
      out.value[i] = static_cast<float>(rate->mean());
      if (!(interval > 0.0)) return;
      pace.spend(kStepsOfInterval);
      out.lower[i] = std::min(out.value[i], static_cast<float>(rate->quantile(0.5 - 0.5 * interval)));
      out.upper[i] = std::max(out.value[i], static_cast<float>(rate->quantile(0.5 + 0.5 * interval)));
    });
  }
  void state(const double* points, std::size_t n, std::int8_t* out) const final {
    for_each_cell_at(cells(), points, n, [out](std::size_t i, const auto& cell) {
      out[i] = static_cast<std::int8_t>(cell.state());
    });
  }
  void cell_size(const double* points, std::size_t n, double* out) const final {
    const auto& tree = cells().tree();
    for_each_paced(n, kStepsOfQuery, [&](std::size_t i) {
      const auto leaf = tree.find_leaf(Vector<D>(Eigen::Map<const Vector<D>>(points + i * D)));
      out[i] = leaf ? tree.geometry().cell_size(leaf->index.level) : std::numeric_limits<double>::quiet_NaN();
    });
  }
  [[nodiscard]] std::string to_bytes() const final {
    return detail::to_bytes(cells(), this->refinement().c_str(), layers_.stored());
  }
  [[nodiscard]] std::unique_ptr<MapExports> exports() const final {
    return std::make_unique<MapExportsOf<Cells>>(cells(), layers_);
  }
  [[nodiscard]] std::unique_ptr<MapQueries> queries() const final {
    return std::make_unique<MapQueriesOf<Cells>>(cells(), this->refinement());
  }
  [[nodiscard]] LeafArrays leaves() const final {
    const std::size_t n = cells().tree().num_leaves();
    LeafArrays arrays;
    arrays.lower.reserve(n * D);
    arrays.size.reserve(n);
    arrays.log_odds.reserve(n);
    arrays.hits.reserve(n);
    arrays.misses.reserve(n);
    arrays.observed.reserve(n);
    arrays.disputed.reserve(n);
    arrays.thin.reserve(n);
    const ThinThings thin(cells());
    for_each_leaf(cells().tree(), [&](const auto& leaf) { add(leaf, thin, arrays); });
    return arrays;
  }
  [[nodiscard]] std::map<double, LeafCounts> leaf_counts() const final {
    std::map<int, LeafCounts> by_level;
    for_each_leaf(cells().tree(), [&](const auto& leaf) {
      const auto& cell = leaf.cell();
      if (!cell.observed()) return;
      LeafCounts& counts = by_level[leaf.index.level];
      ++counts.observed;
      counts.free += cell.state() == CellState::free;
      counts.occupied += cell.state() == CellState::occupied;
      counts.disputed += is_disputed(cell);
    });
    std::map<double, LeafCounts> by_size;
    for (const auto& [level, counts] : by_level)
      by_size.emplace(cells().tree().geometry().cell_size(level), counts);
    return by_size;
  }
  [[nodiscard]] LeafArrays leaves_in(const double* lower, const double* upper,
                                     const RegionStates& states) const final {
    LeafArrays arrays;
    const ThinThings thin(cells());
    for_each_leaf_of(cells(), box(lower, upper), states, [&](const auto& leaf) { add(leaf, thin, arrays); });
    return arrays;
  }

 protected:
  [[nodiscard]] const Cells& cells() const override = 0;

  [[nodiscard]] static Box<D> box(const double* lower, const double* upper) {
    return {Eigen::Map<const Vector<D>>(lower), Eigen::Map<const Vector<D>>(upper)};
  }
  /// @throws std::invalid_argument if it is of another kind.
  [[nodiscard]] const CellsAdapter& same_kind(const MapInterface& other) const {
    const auto* const same = dynamic_cast<const CellsAdapter*>(&other);
    if (same == nullptr || other.refinement() != this->refinement())
      throw std::invalid_argument("a map with " + kind_of(other) + " beside one with " + kind_of(*this) +
                                  ": both must be of the same kind");
    return *same;
  }
  /// Bytes that layers may hold beside a map.
  template <class Map>
  [[nodiscard]] static std::size_t memory_for_layers(const Map& map) {
    return memory_beside(map.memory_bytes(), map.options().memory_limit());
  }

  Layers layers_;

 private:
  /// Calls `add(change)` for the cells that are what they were but for their layers, each once.
  template <class Add>
  void for_each_changed_value(const CellsAdapter& before, const Add& add) const {
    std::set<std::pair<int, Lattice<D>>> added;
    layers_.for_each_change(before.layers_, [&](const CellIndex<D>&, const Vector<D>& centre) {
      const auto now = cells().tree().find_leaf(centre);
      const auto then = before.cells().tree().find_leaf(centre);
      if (!now || !then || now->index != then->index || !(now->cell() == then->cell())) return;
      if (!added.emplace(now->index.level, now->index.lower).second) return;
      add(Change<D>{now->index, now->cell().state(), now->cell().state()});
    });
  }
  [[nodiscard]] static std::string kind_of(const MapInterface& map) {
    return "dim = " + std::to_string(map.dim()) + ", branching = " + std::to_string(map.branching()) +
           ", refinement = '" + map.refinement() + "'";
  }
  void add(const typename Cells::Tree::ConstRef& leaf, const ThinThings& thin, LeafArrays& arrays) const {
    const auto& geometry = cells().tree().geometry();
    for (const std::int64_t coordinate : leaf.index.lower)
      arrays.lower.push_back(geometry.border(coordinate));
    arrays.size.push_back(geometry.cell_size(leaf.index.level));
    arrays.log_odds.push_back(leaf.cell().log_odds());
    arrays.hits.push_back(leaf.cell().hits());
    arrays.misses.push_back(leaf.cell().misses());
    arrays.observed.push_back(leaf.cell().observed());
    arrays.disputed.push_back(is_disputed(leaf.cell()));
    arrays.thin.push_back(thin.are_in(leaf.cell()));
  }
};

/// Our own maps: what changes them.
template <class Map>
class MapAdapter final : public CellsAdapter<typename Map::Cells> {
  using Base = CellsAdapter<typename Map::Cells>;
  using Base::box;
  using Base::D;
  using Base::layers_;
  using Base::memory_for_layers;
  using typename Base::Layers;

 public:
  explicit MapAdapter(Map map, Layers layers = {}) : Base(std::move(layers)), map_(std::move(map)) {}

  [[nodiscard]] std::unique_ptr<MapInterface> clone() const override {
    return std::make_unique<MapAdapter>(map_, layers_);
  }
  [[nodiscard]] std::string refinement() const override { return Map::RefinementType::kName; }
  InsertReport insert(const BeamPointers& beams, double max_range, int threads,
                      const std::optional<AnyBox>& window,
                      const std::vector<LayerMeasurements>& measurements) override {
    const ScanView<D> scan = beams.view<D>();
    const std::optional<Box<D>> region =
        window ? std::optional(box(window->lower, window->upper)) : std::nullopt;
    layers_.check(scan, measurements);
    if (layers_.empty()) return map_.insert(scan, max_range, threads, region);
    return change([&](Map& map, Layers& layers) {
      const InsertReport report = map.insert(scan, max_range, threads, region);
      const std::size_t limit = map.options().memory_limit();
      layers.add_scan(LayeredCellsOf(map.cells()), map.memory_bytes(), limit, scan, measurements, max_range,
                      region);
      if (map.memory_bytes() + layers.memory_bytes() > limit) throw MemoryLimitReached(limit);
      return report;
    });
  }
  void add_layer(const LayerKind& kind) override {
    layers_.add(kind, map_.tree().geometry());
    require_room_for_empty(map_.memory_bytes() + layers_.memory_bytes(), map_.options().memory_limit());
  }
  void merge(const MapInterface& other) override {
    const MapAdapter& beside = same_kind(other);
    change(
        [&](Map& map, Layers& layers) {
          map.merge(beside.map_);
          layers.join(beside.layers_, LayeredCellsOf(map.cells()), memory_for_layers(map));
          return 0;
        },
        !beside.layers_.empty());
  }
  void adopt(const MapInterface& other, const std::optional<AnyBox>& window) override {
    const MapAdapter& beside = same_kind(other);
    const auto region = window ? std::optional(box(window->lower, window->upper)) : std::nullopt;
    change(
        [&](Map& map, Layers& layers) {
          map.adopt(beside.map_, region);
          if (beside.layers_.empty()) return 0;
          Map adopted(map.options());  // What lies in the box, alone.
          adopted.adopt(beside.map_, region);
          layers.join(beside.layers_, LayeredCellsOf(adopted.cells()), memory_for_layers(map));
          return 0;
        },
        !beside.layers_.empty());
  }
  [[nodiscard]] std::unique_ptr<MapInterface> transformed(const double* pose) const override {
    const auto motion = pose_of<D>(pose);
    Map moved = ndtree::transformed(map_, motion);
    Layers layers = naming_whole_limit([&] {
      return layers_.transformed(LayeredCellsOf(moved.cells()), motion, lattice_motion_of(map_, motion),
                                 memory_for_layers(moved));
    });
    return std::make_unique<MapAdapter>(std::move(moved), std::move(layers));
  }
  CompressReport compress(const CompressBudget& budget) override {
    if constexpr (std::is_same_v<typename Map::RefinementType, EvidenceRefinement>)
      return map_.compress(budget);
    else
      return MapInterface::compress(budget);
  }
  void shrink_to_fit() override {
    map_.shrink_to_fit();
    layers_.shrink_to_fit();
  }
  [[nodiscard]] PythonStats stats() const override {
    PythonStats stats{map_.stats(), {}};
    stats.memory_bytes += layers_.memory_bytes();
    return stats;
  }
  void crop(const double* lower, const double* upper) override {
    const Box<D> region = map_.tree().geometry().on_borders(box(lower, upper));
    forget(CropRule<D>{region}, [&](Map& map) { map.crop(region); });
  }
  void clear(const AnyPlace& place) override {
    if (const auto* const corners = std::get_if<AnyBox>(&place)) {
      const Box<D> region = map_.tree().geometry().on_borders(box(corners->lower, corners->upper));
      forget(ClearRule<D>{region}, [&](Map& map) { map.clear(region); });
    } else if constexpr (D <= 3) {
      const auto [body, pose] = placed(std::get<PlacedShape>(place));
      forget(ShapeRule<D>{moved(body, pose)},
             [&body = body, &pose = pose](Map& map) { map.clear(body, pose); });
    } else {
      throw_no_shapes();
    }
  }
  void mark(const AnyPlace& place, CellState state, int beams) override {
    if (const auto* const corners = std::get_if<AnyBox>(&place)) {
      const Box<D> region = box(corners->lower, corners->upper);
      mark_by([&](Map& map) { map.mark(region, state, beams); });
    } else if constexpr (D <= 3) {
      const auto [body, pose] = placed(std::get<PlacedShape>(place));
      mark_by([&, &body = body, &pose = pose](Map& map) { map.mark(body, pose, state, beams); });
    } else {
      throw_no_shapes();
    }
  }
  void keep_near(const double* center, double radius) override {
    const Vector<D> middle = Eigen::Map<const Vector<D>>(center);
    forget(NearRule<D>{middle, radius}, [&](Map& map) { map.keep_near(middle, radius); });
  }

 private:
  [[nodiscard]] const typename Map::Cells& cells() const override { return map_; }

  /// @throws std::invalid_argument if it is of another kind.
  [[nodiscard]] const MapAdapter& same_kind(const MapInterface& other) const {
    return static_cast<const MapAdapter&>(Base::same_kind(other));  // Cells and refinement are the type.
  }
  /// What is thrown where a layer may not take what is left names the limit of all.
  template <class Function>
  auto naming_whole_limit(const Function& function) const {
    try {
      return function();
    } catch (const MemoryLimitReached&) {
      throw MemoryLimitReached(map_.options().memory_limit());
    }
  }
  /// Changes map and layers, or neither. @param may_add whether there may be more layers afterwards.
  template <class Change>
  auto change(const Change& change, bool may_add = false) {
    if (layers_.empty() && !may_add) {
      Layers none;
      const auto result = change(map_, none);  // Which has made its last checkpoint.
      layers_ = std::move(none);
      return result;
    }
    Map map = map_;
    Layers layers = layers_;
    const auto result = naming_whole_limit([&] { return change(map, layers); });
    last_checkpoint();
    map_ = std::move(map);
    layers_ = std::move(layers);
    return result;
  }
  template <class Rule, class Forget>
  void forget(const Rule& rule, const Forget& forget) {
    change([&](Map& map, Layers& layers) {
      forget(map);
      layers.keep_known(LayeredCellsOf(map.cells()),
                        [&](const Box<D>& region) { return takes_from(rule, region); });
      return 0;
    });
  }
  template <class Mark>
  void mark_by(const Mark& mark) {
    change([&](Map& map, Layers& layers) {
      mark(map);
      const std::size_t limit = map.options().memory_limit();
      if (map.memory_bytes() + layers.memory_bytes() > limit) throw MemoryLimitReached(limit);
      return 0;
    });
  }
  [[nodiscard]] static std::pair<Body<D>, Pose<D>> placed(const PlacedShape& shape) {
    return {body_of<D>(shape.parts), pose_of<D>(shape.pose)};
  }

  Map map_;
};

/// A map and its layers behind the interface.
template <class Map>
std::unique_ptr<MapInterface> adapted(const Map& map, const MapLayers<Map::kBranching, Map::kDim>& layers) {
  return std::make_unique<MapAdapter<Map>>(map, layers);
}

template <class T>
struct TypeOf {
  using type = T;
};

/// Makes a map of this refinement by `make(TypeOf<Map>)`. All refinements of one branching and dimension are
/// compiled in a file of their own.
template <int N, int D, class Make>
std::unique_ptr<MapInterface> with_refinement(std::string_view refinement, const Make& make) {
  const auto made = [&](auto type) {
    return std::make_unique<MapAdapter<typename decltype(type)::type>>(make(type));
  };
  if (refinement == FixedRefinement::kName) return made(TypeOf<FixedMap<N, D>>{});
  if (refinement == PaperRefinement::kName) return made(TypeOf<PaperMap<N, D>>{});
  return made(TypeOf<AdaptiveMap<N, D>>{});
}

template <int N, int D>
std::unique_ptr<MapInterface> make_map(std::string_view refinement, const MapOptions& options) {
  return with_refinement<N, D>(refinement, [&](auto type) { return typename decltype(type)::type(options); });
}

template <int N, int D>
std::unique_ptr<MapInterface> map_from_bytes(std::string_view bytes, const std::string& refinement) {
  return with_refinement<N, D>(refinement, [&](auto type) {
    using Map = typename decltype(type)::type;
    std::vector<StoredLayer> stored;
    Map map = from_bytes<Map>(bytes, &stored);
    MapLayers<N, D> layers;
    layers.restore(stored, map.tree().geometry());
    return MapAdapter<Map>(std::move(map), std::move(layers));
  });
}

}  // namespace ndtree::python
