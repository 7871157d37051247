// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The occupancy map: scans in, one tree of cells, adaptive or fixed by its refinement policy (Sec. III).
#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "ndtree/cell/moved_points.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/beam.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/fwd.hpp"
#include "ndtree/mapping/edit/compress.hpp"
#include "ndtree/mapping/edit/forget.hpp"
#include "ndtree/mapping/edit/join.hpp"
#include "ndtree/mapping/edit/mark.hpp"
#include "ndtree/mapping/insert/measurements.hpp"
#include "ndtree/mapping/map_cells.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/refinement.hpp"
#include "ndtree/mapping/update_counters.hpp"
#include "ndtree/tree/adopt.hpp"
#include "ndtree/tree/cube_set.hpp"
#include "ndtree/tree/lattice.hpp"
#include "ndtree/tree/nd_tree.hpp"
#include "ndtree/tree/undo_log.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// What one call of insert() did.
struct InsertReport {
  std::uint64_t beams = 0;             ///< All beams of the call: the sum of the next four.
  std::uint64_t returned = 0;          ///< A surface at the end point.
  std::uint64_t not_returned = 0;      ///< Free space only.
  std::uint64_t beyond_max_range = 0;  ///< Returned from beyond max_range: free space up to there.
  std::uint64_t invalid = 0;           ///< Not finite or of zero length: skipped.
  std::uint64_t updates = 0;           ///< (beam, leaf) pairs that were added, see UpdateCounters.
  std::uint64_t splits = 0;            ///< Leaves that were split.
  std::uint64_t merges = 0;            ///< Parents that took the place of their children.
  double seconds = 0.0;                ///< Wall time, without that for `moved` [s].
  /// If it was asked for: of each beam the probability that what it returned from moves, by what the map was
  /// before the call, see OccupancyMap::insert().
  std::optional<std::vector<float>> moved;

  /// The count that beams of this outcome add to.
  [[nodiscard]] std::uint64_t& count(BeamOutcome outcome) {
    switch (outcome) {
      case BeamOutcome::returned:
        return returned;
      case BeamOutcome::not_returned:
        return not_returned;
      case BeamOutcome::beyond_max_range:
        return beyond_max_range;
      case BeamOutcome::invalid:
        break;
    }
    return invalid;
  }
};

/// What a scan brings beside its beams to a map without layers.
struct NoMeasurements {
  [[nodiscard]] static constexpr std::size_t memory_bytes() { return 0; }
};

/// @param threads as in insert(). @returns that number, or, for 0, the machine's number of cores.
/// @throws std::invalid_argument if it is negative.
[[nodiscard]] inline int number_of_threads(int threads) {
  if (threads < 0) throw std::invalid_argument("threads = " + std::to_string(threads) + ": must be >= 0");
  return threads > 0 ? threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
}

/// Occupancy of space: the leaves of one N^D-tree. `Refinement` decides how fine cells are, `Sensor` what a
/// range says about one. Invariants, tested by check_invariants(): those of the tree; leaves above the
/// coarsest_level() of the refinement were never observed; log-odds are within their bounds. Not for use by
/// two threads at once while one of them changes it. Copies are independent, and may be used by other
/// threads; they share the cells that neither has changed since, so that a copy, see snapshot(), takes
/// microseconds for each megabyte.
template <int N, int D, class Refinement, class Sensor>
class OccupancyMap : public MapCells<N, D, typename Refinement::Cell> {
 public:
  using Cells = MapCells<N, D, typename Refinement::Cell>;
  using RefinementType = Refinement;
  using typename Cells::Cell;
  using typename Cells::Tree;

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  explicit OccupancyMap(const MapOptions& options = {});

  /// A map that goes on from a stored state; the tree must have been made with the same options.
  OccupancyMap(const MapOptions& options, Tree tree, const UpdateCounters& counters);

  OccupancyMap(const OccupancyMap&) = default;
  OccupancyMap(OccupancyMap&&) = default;
  /// Lack of memory changes nothing.
  OccupancyMap& operator=(const OccupancyMap& other) { return *this = OccupancyMap(other); }
  OccupancyMap& operator=(OccupancyMap&&) = default;
  ~OccupancyMap() = default;

  /// Integrates a scan. EvidenceRefinement: the scan as a whole. Fixed: each cell gets its beams in the order
  /// of the scan. Paper (Sec. III): beam by beam, merging after each.
  /// @param max_range [m] beams that are longer say only that the space up to there is free.
  /// @param threads that may work on a large scan; 0: as many as the machine has cores. The map is the same,
  ///   bit for bit, for every number. The paper's has only one.
  /// @param window if given, only cells in it change, and become, bit for bit, what they would without it.
  ///   In it are all cells of max_cell_size (of a fixed map: all cells) that share a volume with the box.
  /// @param tells_moved whether the report has the probability that each beam returned from what moves: that
  ///   of probability_moved() for its end point in the map before the call, which only knows space that was
  ///   seen free earlier; 0.5 where the map is unknown, or the beam did not return within max_range.
  /// @throws std::invalid_argument if max_range is not > 0, threads is negative, the window has no volume,
  ///   the scan's one origin is not finite, a range_sigma is outside kRangeSigmaBounds, or a beam leaves what
  ///   the lattice can address or is longer than kLongestBeam of the smallest cells.
  /// @throws MemoryLimitReached if the map would hold more than its max_memory, Cancelled (see CancelScope),
  ///   std::bad_alloc, std::length_error. If a max_memory was given, or there is a CancelScope, or a copy
  ///   that still shares cells, the map is then as it was before the call; else it is valid, but some cells
  ///   may have taken the scan in, and others not.
  InsertReport insert(const ScanView<D>& scan, double max_range = kUnlimitedRange, int threads = 0,
                      const std::optional<Box<D>>& window = std::nullopt, bool tells_moved = false) {
    if (window) check(*window);
    if (!tells_moved) return integrate(scan, max_range, threads, window, nullptr, nullptr);
    std::vector<float> moved = moved_before(scan, max_range);
    InsertReport report = integrate(scan, max_range, threads, window, nullptr, nullptr);
    report.moved = std::move(moved);
    return report;
  }
  InsertReport insert(const Scan<D>& scan, double max_range = kUnlimitedRange, int threads = 0,
                      const std::optional<Box<D>>& window = std::nullopt, bool tells_moved = false) {
    return insert(scan.view(), max_range, threads, window, tells_moved);
  }

  // What a ScanHistory asks of its map; one with layers has the same.

  /// A scan's beams as the map takes them. @param number of the scan, by which it is sampled.
  [[nodiscard]] Measurements<D, Sensor> measurements(const ScanView<D>& scan, double max_range,
                                                     std::uint64_t number = 0) const {
    return Measurements<D, Sensor>(scan, max_range, sensor_, Refinement::least_sigma(options_), number);
  }
  /// What a scan brings beside its beams: nothing.
  using Measured = NoMeasurements;
  using PackedMeasured = NoMeasurements;
  [[nodiscard]] static PackedMeasured packed(const ScanView<D>& /*scan*/, const Measured& /*given*/) {
    return {};
  }
  /// Around all that a scan reaches [m]; empty without a valid beam.
  using Reach = Box<D>;
  /// Whether insert_in() leaves a map as it was when it throws, as far as insert() does.
  [[nodiscard]] static constexpr bool undoes_insertions() { return true; }

  /// As insert(), but only cells in some cubes of max_cell_size change. @param reach see grow_to().
  InsertReport insert_in(const CubeSet<D>& cubes, const ScanView<D>& scan, const PackedMeasured& /*none*/,
                         double max_range, int threads, Reach& reach) {
    return integrate(scan, max_range, threads, std::nullopt, &cubes, &reach);
  }
  /// Makes the room that a scan of this reach needs, as insert() does. @param reach as insert_in() gave it.
  void grow_to(const Reach& reach, const PackedMeasured& /*none*/) {
    if (!(reach.lower.array() <= reach.upper.array()).all()) return;
    tree_.grow_to_contain(reach.lower);
    tree_.grow_to_contain(reach.upper);
    summarise_stale(tree_, *tree_.root().node, saturated());
  }

  /// Gives the memory back that merging has freed, and puts what is near each other near each other in
  /// memory, too; no answer changes. O(nodes).
  void shrink_to_fit() { tree_.shrink_to_fit(); }

  /// Merges siblings where that loses the least information, until the budget is met; later insertions go on
  /// from there, and split again what beams contradict. O(nodes log nodes).
  /// @throws std::invalid_argument if no limit is given, or one cannot be met, std::bad_alloc, Cancelled; the
  ///   map is then unchanged.
  CompressReport compress(const CompressBudget& budget) {
    Tree compressed = tree_;
    detail::Compression compression(compressed, refinement_.merge_rule,
                                    Refinement::coarsest_level(tree_.geometry().finest_level()),
                                    sizeof(*this) - sizeof(tree_));
    const CompressReport report = compression.run(budget);
    forget_summaries(compressed);
    summarise_stale(compressed, *compressed.root().node, saturated());
    last_checkpoint();
    tree_ = std::move(compressed);
    counters_.merges += report.merges;
    return report;
  }

  /// Forgets all cells but those that share a volume with a box. O(what goes, and what lies on its border).
  /// @throws std::invalid_argument if the box has no volume, std::bad_alloc, Cancelled; the map is then
  ///   unchanged.
  void crop(const Box<D>& box) {
    check(box);
    forget(CropRule<D>{tree_.geometry().on_borders(box)});
  }
  /// Forgets the space in a box: larger cells on its border are divided, and smallest cells that share a
  /// volume with it are forgotten. @throws as crop().
  void clear(const Box<D>& box) {
    check(box);
    forget(ClearRule<D>{tree_.geometry().on_borders(box)});
  }
  /// Forgets the space that a body takes in a pose: all cells that share a point with it, borders counted in,
  /// so that it collides() with nothing afterwards. Larger cells on its border are divided. In 2-D and 3-D.
  /// O(what goes, and what lies on its border). @throws std::invalid_argument if it is not finite, and as
  /// crop().
  void clear(const Body<D>& body, const Pose<D>& pose = {}) {
    ShapeRule<D> rule{moved(body, pose)};
    check(rule.body);
    forget(rule);
  }
  /// Gives the cells that clear() would forget a state, whatever was known of them: as if `beams` beams, 1 to
  /// 511, had ended in each smallest cell, or passed it, and no others. So later beams may change it. Cells
  /// are as large as that evidence allows, see detail::Marking. Counters stay. O(what was there, and what
  /// lies on the border). @throws std::invalid_argument if the state is unknown, the beams are out of bounds,
  /// or a part lies out of reach, MemoryLimitReached, and as clear(); the map is then unchanged.
  void mark(const Box<D>& box, CellState state, int beams = kMarkBeams) {
    check(box);
    mark(detail::marked_space(tree_.geometry(), box), state, beams);
  }
  void mark(const Body<D>& body, const Pose<D>& pose, CellState state, int beams = kMarkBeams) {
    ShapeRule<D> rule{moved(body, pose)};
    check(rule.body);
    if (rule.body.empty()) return detail::check_mark(state, beams);
    mark(detail::marked_space(tree_.geometry(), rule), state, beams);
  }
  /// Forgets all cells that are farther than `radius` > 0 [m] from a point: a window that moves with a robot;
  /// infinity keeps everything. O(what goes, and what lies on its border). @throws std::invalid_argument if
  /// the centre is not finite, and as crop().
  void keep_near(const Vector<D>& center, double radius) {
    if (!center.allFinite())
      throw std::invalid_argument("center = " + describe_point(center) + ": must be finite");
    if (!(radius > 0.0))
      throw std::invalid_argument("radius = " + describe_number(radius) + " m: must be > 0");
    forget(NearRule<D>{center, radius});
  }

  /// Adds the evidence of another map of the same place: evidence and counts of cells add up (in paper and
  /// fixed maps the log-odds, clamped); where the cells of one map are larger, each of the other's gets its
  /// part. Siblings merge as while mapping. Commutes to the last bit. O(nodes of both).
  /// @throws std::invalid_argument if the sizes of cells differ, MemoryLimitReached, std::bad_alloc,
  ///   Cancelled; the map is then unchanged.
  void merge(const OccupancyMap& other) {
    require_same_sizes(other, "merged into");
    detail::Joining<Tree, Refinement> joining(options_, refinement_);
    joining.grow_around(tree_, other.tree_);
    joining.add(tree_);
    joining.add(other.tree_);
    const auto merges = joining.merge();
    Tree& joined = joining.tree();
    joined.limit_memory(kUnlimitedMemory);
    summarise_stale(joined, *joined.root().node, saturated());
    last_checkpoint();
    tree_ = std::move(joined);
    counters_.merges += other.counters_.merges + merges;
    counters_.updates += other.counters_.updates;
    counters_.splits += other.counters_.splits;
    counters_.scans += other.counters_.scans;
  }

  /// Copies another map's cells where this one is unknown, bit for bit, so that parts of space that were
  /// mapped apart become the map that one process would have made.
  /// @param box if given, only of the cubes of max_cell_size (of a fixed map: the cells) that share a volume
  ///   with it, as with the window of insert(), and counters stay this map's; else counters add up.
  ///   O(what is taken over, and nodes of both above it).
  /// @throws std::invalid_argument if an option but max_memory differs, both hold cells in one such cube, or
  ///   the box has no volume, MemoryLimitReached, std::bad_alloc, Cancelled; the map is then unchanged.
  void adopt(const OccupancyMap& other, const std::optional<Box<D>>& box = std::nullopt) {
    if (box) check(*box);
    const int coarsest = Refinement::coarsest_level(tree_.geometry().finest_level());
    const auto window = box ? std::optional(tree_.geometry().cells_in(*box, coarsest)) : std::nullopt;
    adopt_wanted(other, coarsest, [&](const CellIndex<D>& cell, std::int64_t edge) {
      return !window || window->overlaps(cell, edge);
    });
    if (box) return;
    counters_.updates += other.counters_.updates;
    counters_.splits += other.counters_.splits;
    counters_.merges += other.counters_.merges;
    counters_.scans = std::max(counters_.scans, other.counters_.scans);
  }

  /// adopt() of all cubes of max_cell_size but those of a set. Counters stay this map's.
  void adopt_outside(const CubeSet<D>& cubes, const OccupancyMap& other) {
    adopt_wanted(other, 0, detail::outside(cubes));
  }

  /// adopt() of the cubes of max_cell_size in a set. Counters stay this map's.
  void adopt_inside(const CubeSet<D>& cubes, const OccupancyMap& other) {
    adopt_wanted(other, 0, detail::inside(cubes));
  }

  /// A map whose root has grown as this one's, all of it unknown. @param counters that it goes on from.
  [[nodiscard]] OccupancyMap emptied(const UpdateCounters& counters) const {
    return OccupancyMap(options_, tree_.emptied(), counters);
  }

  /// The map as it is now, to be read by any thread while this one goes on. See changes().
  [[nodiscard]] OccupancyMap snapshot() const { return *this; }

  /// O(leaves).
  [[nodiscard]] MapStats stats() const {
    MapStats stats = this->count();
    stats.memory_bytes = memory_bytes();
    return stats;
  }

  /// Bytes held by the map, used or not.
  [[nodiscard]] std::size_t memory_bytes() const {
    return sizeof(*this) - sizeof(tree_) + tree_.memory_bytes();
  }

  /// @throws std::logic_error naming the first broken invariant. O(nodes).
  void check_invariants() const {
    tree_.check_invariants();
    const int coarsest = Refinement::coarsest_level(tree_.geometry().finest_level());
    for_each_node(tree_, [&](const auto& ref) {
      if (!ref.is_leaf()) check_summary(ref);
    });
    for_each_leaf(tree_, [&](const auto& leaf) {
      const Cell& cell = leaf.cell();
      if (leaf.index.level > coarsest && cell.observed())
        throw std::logic_error("an observed leaf of level " + std::to_string(leaf.index.level) +
                               ": the coarsest that may be updated is " + std::to_string(coarsest));
      if (!(cell.log_odds() >= static_cast<float>(options_.log_odds_min) &&
            cell.log_odds() <= static_cast<float>(options_.log_odds_max)))
        throw std::logic_error("a leaf with log-odds " + std::to_string(cell.log_odds()) + ": out of bounds");
      if (!cell.is_consistent())
        throw std::logic_error("a leaf that was never observed holds more than what was seen of it");
    });
  }

 private:
  static const MapOptions& valid(const MapOptions& options) {
    options.validate();
    return options;
  }

  /// A predicate of cells: saturated or not.
  [[nodiscard]] auto saturated() const {
    return [this](const Cell& cell) { return refinement_.is_saturated(cell); };
  }

  void require_same_options(const OccupancyMap& other) const {
    std::vector<double> others;
    for_each_option(other.options_, [&](const char*, double value) { others.push_back(value); });
    std::size_t i = 0;
    for_each_option(options_, [&](const char* name, double value) {
      const double beside = others[i++];
      if (value != beside && std::string(name) != "max_memory")
        throw std::invalid_argument(std::string(name) + " = " + describe_number(beside) +
                                    " of a map that is adopted by one with " + describe_number(value) +
                                    ": must be the same");
    });
  }
  void require_same_sizes(const OccupancyMap& other, const char* how) const {
    const auto& geometry = tree_.geometry();
    if (geometry.unit() != other.tree_.geometry().unit() ||
        geometry.finest_level() != other.tree_.geometry().finest_level())
      throw std::invalid_argument("a map with cells from " + describe_number(other.options_.min_cell_size) +
                                  " to " + describe_number(other.options_.max_cell_size) + " m cannot be " +
                                  how + " one with cells from " + describe_number(options_.min_cell_size) +
                                  " to " + describe_number(options_.max_cell_size) + " m");
  }

  /// Of each beam the probability that it returns from what moves, by the map as it is.
  [[nodiscard]] std::vector<float> moved_before(const ScanView<D>& scan, double max_range) const {
    const auto asking = [&](const auto& answer) {
      return [&](const double* points, std::size_t n, float* out) {
        for (std::size_t i = 0; i < n; ++i) {
          const auto leaf = tree_.find_leaf(Vector<D>(Eigen::Map<const Vector<D>>(points + i * D)));
          out[i] = leaf ? answer(leaf->cell()) : kMovedUnknown;
        }
      };
    };
    const auto standing = [](const auto& cell) { return probability_standing(cell); };
    const auto beside = [](const auto& cell) { return probability_beside(cell); };
    return probability_moved(scan, max_range, [&](const double* points, std::size_t n, float* out) {
      probability_moved<D>(points, n, MovedMargin::of(options_), asking(standing), asking(beside), out);
    });
  }

  InsertReport integrate(const ScanView<D>& scan, double max_range, int threads,
                         const std::optional<Box<D>>& window, const CubeSet<D>* cubes, Box<D>* reach);

  /// @param level of the cubes. @param is_wanted see detail::for_each_cube().
  template <class IsWanted>
  void adopt_wanted(const OccupancyMap& other, int level, const IsWanted& is_wanted) {
    require_same_sizes(other, "adopted by");
    require_same_options(other);
    Tree changed = tree_;
    changed.limit_memory(options_.memory_limit(), sizeof(*this) - sizeof(tree_));
    const auto is_blank = [](const Cell& cell) { return detail::is_blank(cell); };
    detail::Adopting(changed, level, is_blank).run(other.tree_, is_wanted);
    changed.limit_memory(kUnlimitedMemory);
    summarise_stale(changed, *changed.root().node, saturated());
    last_checkpoint();
    tree_ = std::move(changed);
  }

  template <class Rule>
  void forget(const Rule& rule) {
    const auto is_saturated = saturated();
    Tree changed = tree_;
    detail::Forgetting<Tree, decltype(is_saturated), Rule>(changed, is_saturated, rule).run();
    changed.shrink_if_half_empty();
    last_checkpoint();
    tree_ = std::move(changed);
  }
  template <class Rule>
  void mark(const detail::MarkedSpace<D, Rule>& space, CellState state, int beams) {
    Tree changed = detail::marked(tree_, space, state, beams, options_, refinement_, saturated(),
                                  sizeof(*this) - sizeof(tree_));
    last_checkpoint();
    tree_ = std::move(changed);
  }
  static void check(const Body<D>& body) {
    for (const BodyPart<D>& part : body) {
      const Box<D> bounds = bounds_of(part);
      if (!bounds.lower.allFinite() || !bounds.upper.allFinite())
        throw std::invalid_argument("body from " + describe_point(bounds.lower) + " to " +
                                    describe_point(bounds.upper) + " m: must be finite");
    }
  }
  static void check(const Box<D>& box) {
    if (!box.lower.allFinite() || !box.upper.allFinite() || !(box.lower.array() < box.upper.array()).all())
      throw std::invalid_argument("box from " + describe_point(box.lower) + " to " +
                                  describe_point(box.upper) + ": must be finite, and have a volume");
  }

  void check_summary(const typename Tree::ConstRef& parent) const {
    const SummaryOfSiblings expected =
        summary_of_siblings(tree_.children(*parent.node), Tree::kNumChildren, saturated());
    if (parent.node->summary_word() != expected.summary.word())
      throw std::logic_error("the summary of a node of level " + std::to_string(parent.index.level) +
                             " is not that of its children");
  }

  static void check(const ScanView<D>& scan, double max_range) {
    if (!(max_range > 0.0))
      throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0");
    if (!scan.origin_per_beam && scan.size > 0 && !scan.origin(0).allFinite())
      throw std::invalid_argument("origin = " + describe_point(scan.origin(0)) +
                                  " m: every component must be finite");
  }

  using Cells::counters_;
  using Cells::options_;
  using Cells::tree_;
  Refinement refinement_;
  Sensor sensor_;
};

template <int N, int D, class Refinement, class Sensor>
OccupancyMap<N, D, Refinement, Sensor>::OccupancyMap(const MapOptions& options)
    : OccupancyMap(options, Tree(valid(options).min_cell_size, valid(options).num_levels(N)),
                   UpdateCounters{}) {
  require_room_for_empty(memory_bytes(), options_.memory_limit());
}

template <int N, int D, class Refinement, class Sensor>
OccupancyMap<N, D, Refinement, Sensor>::OccupancyMap(const MapOptions& options, Tree tree,
                                                     const UpdateCounters& counters)
    : Cells(valid(options), std::move(tree), counters,
            Refinement::coarsest_level(-valid(options).num_levels(N))),
      refinement_(options),
      sensor_(options) {
  summarise_stale(tree_, *tree_.root().node, saturated());
}

template <int N, int D, class Refinement, class Sensor>
InsertReport OccupancyMap<N, D, Refinement, Sensor>::integrate(const ScanView<D>& scan, double max_range,
                                                               int threads,
                                                               const std::optional<Box<D>>& window,
                                                               const CubeSet<D>* cubes, Box<D>* reach) {
  const auto start = std::chrono::steady_clock::now();
  threads = number_of_threads(threads);
  check(scan, max_range);
  InsertReport report;
  report.beams = static_cast<std::uint64_t>(scan.size);
  const UpdateCounters before = counters_;
  using Update = typename Refinement::template Update<Tree, Sensor>;
  Workers workers(std::min(static_cast<std::size_t>(threads), Update::most_workers(scan.size)));
  Update update(tree_, refinement_, sensor_, options_, counters_);
  const std::uint64_t scan_number = scan.number.value_or(counters_.scans);
  const Measurements<D, Sensor> measurements = this->measurements(scan, max_range, scan_number);
  // The survey checks the whole scan before the tree grows: from then on only out-of-memory, node-id
  // exhaustion or cancellation can interrupt.
  const ScanSurvey<D> survey = update.survey(measurements, workers);
  for (const BeamOutcome outcome : {BeamOutcome::returned, BeamOutcome::not_returned,
                                    BeamOutcome::beyond_max_range, BeamOutcome::invalid})
    report.count(outcome) = survey.num(outcome);
  const bool can_undo = options_.max_memory > 0.0 || CancelScope::current() != nullptr || tree_.is_shared();
  if (can_undo) (void)tree_.root();  // Copies the root's chunk now, so that undo() need not.
  const typename UndoLog<Tree>::Begin begin(tree_);
  std::vector<UndoLog<Tree>> undo;
  try {
    tree_.limit_memory(options_.memory_limit(), sizeof(*this) - sizeof(tree_));
    if (survey.num_valid() > 0) {
      tree_.grow_to_contain(survey.reach.lower);
      tree_.grow_to_contain(survey.reach.upper);
    }
    LatticeBox<D> cells;
    if (window)
      cells = tree_.geometry().cells_in(*window, Refinement::coarsest_level(tree_.geometry().finest_level()));
    update.finish(workers, can_undo ? &undo : nullptr, ChangeWindow<D>{window ? &cells : nullptr, cubes});
    if (!tree_.shrink_if_half_empty()) last_checkpoint();
  } catch (...) {
    tree_.limit_memory(kUnlimitedMemory);
    if (can_undo) {
      UndoLog<Tree>::undo(tree_, begin, undo);
      counters_ = before;
    } else {
      forget_summaries(tree_);
      summarise_stale(tree_, *tree_.root().node, saturated());
    }
    throw;
  }
  tree_.limit_memory(kUnlimitedMemory);
  summarise_stale(tree_, *tree_.root().node, saturated());
  if (reach != nullptr) *reach = survey.reach;
  counters_.scans = scan_number + 1;
  report.updates = counters_.updates - before.updates;
  report.splits = counters_.splits - before.splits;
  report.merges = counters_.merges - before.merges;
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

}  // namespace ndtree

#ifdef NDTREE_PREBUILT
#include "ndtree/mapping/prebuilt.hpp"
#endif
