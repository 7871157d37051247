// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What every map can do when Python asks: one virtual call per bulk call, and none per cell.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "any_seen_space.hpp"
#include "beam_pointers.hpp"
#include "map_exports.hpp"
#include "map_layers.hpp"
#include "map_queries.hpp"
#include "ndtree/evaluation/calibration.hpp"
#include "ndtree/evaluation/claims.hpp"
#include "ndtree/evaluation/held_out_truth.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree::python {

/// The leaves of a map, depth first.
struct LeafArrays {
  std::vector<double> lower;  // dim a leaf
  std::vector<double> size;
  std::vector<float> log_odds;
  std::vector<std::uint32_t> hits;
  std::vector<std::uint32_t> misses;
  std::vector<std::uint8_t> observed;
  std::vector<std::uint8_t> disputed;
  std::vector<std::uint8_t> thin;
};

/// How many leaves of one edge length [m] were observed, and how many of these are what.
struct LeafCounts {
  std::size_t observed = 0;
  std::size_t free = 0;
  std::size_t occupied = 0;
  std::size_t disputed = 0;
};

/// Regions whose state is another one.
struct ChangeArrays {
  std::vector<double> lower;  // dim a region
  std::vector<double> size;
  std::vector<std::int8_t> before;
  std::vector<std::int8_t> after;
};

/// The probabilities of hits, and bounds where they are asked for, each n.
struct HitRateArrays {
  float* value;
  float* lower;
  float* upper;
};

struct PythonStats : MapStats {
  std::optional<std::size_t> pruned_leaves;  ///< After OctoMap's prune(); none for our maps.
};

/// Points and results are bare pointers, dim doubles a point: no call touches a Python object, so that all
/// may run without the interpreter's lock.
class MapInterface {
 public:
  virtual ~MapInterface() = default;
  [[nodiscard]] virtual std::unique_ptr<MapInterface> clone() const = 0;
  [[nodiscard]] virtual int branching() const = 0;
  [[nodiscard]] virtual int dim() const = 0;
  [[nodiscard]] virtual std::string refinement() const = 0;
  [[nodiscard]] virtual const MapOptions& options() const = 0;

  /// Whether clone() shares what does not change, and takes next to no time.
  [[nodiscard]] virtual bool clones_cheaply() const { return true; }

  /// @param window none, or a box: see OccupancyMap::insert(). @param layers measurements of layers.
  /// @throws std::invalid_argument for a window or layers in a map that is not ours.
  virtual InsertReport insert(const BeamPointers& beams, double max_range, int threads,
                              const std::optional<AnyBox>& window,
                              const std::vector<LayerMeasurements>& layers) = 0;
  /// What cells carry. @throws std::invalid_argument for a rule that there is not.
  virtual void add_layer(const LayerKind& /*kind*/) { (void)queries(); }
  [[nodiscard]] virtual std::vector<LayerKind> layers() const { return {}; }
  /// Values of the cells around points, nan where there is none. @returns numbers, as many a point.
  /// @throws std::invalid_argument if there is no such layer.
  [[nodiscard]] virtual std::vector<double> layer(const std::string& /*name*/, const double* /*points*/,
                                                  std::size_t /*n*/) const {
    (void)queries();
    return {};
  }
  /// @throws std::invalid_argument where the refinement cannot, or the budget cannot be met.
  virtual CompressReport compress(const CompressBudget&) {
    throw std::invalid_argument("refinement = '" + refinement() +
                                "': only a map refined by 'evidence' can be compressed");
  }
  /// Gives unused memory back, where the map can.
  virtual void shrink_to_fit() {}
  virtual void probability(const double* points, std::size_t n, float* out) const = 0;
  /// See probability_moved().
  virtual void moved(const double* points, std::size_t n, float* out) const = 0;
  /// Hit rates, NaN where nothing was observed. @param interval in (0, 1), or 0: bounds are not written.
  /// @throws std::invalid_argument for bounds of a map that keeps no counts.
  virtual void hit_rate(const double* points, std::size_t n, double interval,
                        const HitRateArrays& out) const = 0;
  virtual void state(const double* points, std::size_t n, std::int8_t* out) const = 0;
  virtual void occupied_within(const double* points, std::size_t n, double radius, bool* out) const = 0;
  /// NaN outside the tree. @throws std::invalid_argument for maps that are not ours.
  virtual void cell_size(const double*, std::size_t, double*) const {
    throw std::invalid_argument("cell_size: only a map of ndtree's own has cells of several sizes");
  }
  /// `origin_step` is dim, or 0 for one origin for all rays.
  virtual void cast_rays(const double* origins, std::size_t origin_step, const double* directions,
                         std::size_t n, double max_range, RayAim aim, double* out) const = 0;
  virtual void evaluate(const BeamPointers& beams, double max_range, HeldOutTruth& truth) const = 0;
  virtual void calibrate(const BeamPointers& beams, double max_range, Calibration& calibration) const = 0;
  /// @throws std::invalid_argument if the space has not the map's dimension.
  [[nodiscard]] virtual Claims claims(const AnySeenSpace& space) const = 0;
  [[nodiscard]] virtual LeafArrays leaves() const = 0;
  /// By edge length [m].
  [[nodiscard]] virtual std::map<double, LeafCounts> leaf_counts() const = 0;
  /// Those of some states that share a point with a closed box. @throws std::invalid_argument for maps that
  /// are not ours.
  [[nodiscard]] virtual LeafArrays leaves_in(const double* /*lower*/, const double* /*upper*/,
                                             const RegionStates& /*states*/) const {
    throw std::invalid_argument("refinement = '" + refinement() + "': must be a map of ndtree's own");
  }
  [[nodiscard]] virtual PythonStats stats() const = 0;
  /// The whole state, for pickle.
  [[nodiscard]] virtual std::string to_bytes() const = 0;
  /// @throws std::invalid_argument for maps that are not ours.
  [[nodiscard]] virtual std::unique_ptr<MapExports> exports() const {
    throw std::invalid_argument("refinement = '" + refinement() + "': must be a map of ndtree's own");
  }
  /// @throws std::invalid_argument for maps that are not ours.
  [[nodiscard]] virtual std::unique_ptr<MapQueries> queries() const {
    throw std::invalid_argument("refinement = '" + refinement() + "': must be a map of ndtree's own");
  }
  /// Forgets cells. @throws std::invalid_argument as the map's own, or for maps that are not ours.
  virtual void crop(const double* /*lower*/, const double* /*upper*/) { (void)queries(); }
  virtual void clear(const AnyPlace& /*place*/) { (void)queries(); }
  virtual void keep_near(const double* /*center*/, double /*radius*/) { (void)queries(); }
  /// Gives cells a state. @throws as clear(), MemoryLimitReached.
  virtual void mark(const AnyPlace& /*place*/, CellState /*state*/, int /*beams*/) { (void)queries(); }
  /// What is different from another map, in a box if there is one. @throws std::invalid_argument if that is
  /// of another kind, or has other cells, or for maps that are not ours.
  [[nodiscard]] virtual ChangeArrays changes(const MapInterface& /*before*/, ChangeOf /*what*/,
                                             const std::optional<AnyBox>& /*box*/) const {
    (void)queries();
    return {};
  }
  /// Brings a field of this map, as it was, up to date. @throws as changes(), or if the field has not the
  /// map's dimension.
  virtual void update_field(AnyField& /*field*/, const MapInterface& /*before*/) const { (void)queries(); }
  /// @throws as changes().
  virtual void merge(const MapInterface& /*other*/) { (void)queries(); }
  /// @param box none, or what is taken over. @throws as changes(), or if both hold cells there.
  virtual void adopt(const MapInterface& /*other*/, const std::optional<AnyBox>& /*box*/) { (void)queries(); }
  /// @param pose a rotation, row by row, and a translation.
  [[nodiscard]] virtual std::unique_ptr<MapInterface> transformed(const double* /*pose*/) const {
    (void)queries();
    return nullptr;
  }
  /// What save() writes.
  [[nodiscard]] virtual std::string file_bytes() const { return to_bytes(); }
};

/// Map for one of the branchings and dimensions that are compiled in. @param refinement a policy's kName.
/// @throws std::invalid_argument that lists them.
std::unique_ptr<MapInterface> make_map(std::string_view refinement, int branching, int dim,
                                       const MapOptions& options);

/// The map in a map file's bytes. @throws std::runtime_error if they are damaged or of a kind not compiled
/// in.
std::unique_ptr<MapInterface> map_from_bytes(std::string_view bytes);

}  // namespace ndtree::python
