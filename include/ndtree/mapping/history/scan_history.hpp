// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A map and the scans that made it: when poses are corrected, the map follows.
#pragma once

#include <Eigen/LU>
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <unordered_map>
#include <utility>
#include <vector>

#include "ndtree/core/beam.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/scan.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/mapping/history/crossed_cubes.hpp"
#include "ndtree/mapping/history/packed_scan.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/tree/cube_set.hpp"

namespace ndtree {

/// What a change of poses cost.
struct HistoryReport {
  std::size_t moved = 0;     ///< Scans whose poses changed, or that were removed.
  std::size_t replayed = 0;  ///< Scans that were mapped again, in some cubes.
  std::size_t cubes = 0;     ///< Cubes of max_cell_size that were made anew.
  /// Pairs of a scan and a cube that it crosses, that were mapped again; and all of them.
  std::uint64_t cube_scans = 0;
  std::uint64_t all_cube_scans = 0;
  double seconds = 0.0;
};

/// A map that remembers its scans, each with a key and a pose.
///
/// Invariant, tested: after any sequence of calls, each cell of the map is, bit for bit, what inserting the
/// present scans at their present poses, in the order in which they came, makes of it, and so are its layers,
/// if it has some: what was measured for them is kept with each scan. A scan keeps its number, by which its
/// beams are sampled, when others are removed. Counters of the map add up the work that was done. What a cell
/// becomes depends on the scans alone that cross its cube of max_cell_size, so only cubes are made anew that
/// a moved scan crosses, before or after, and only by the scans that cross them. Cost: insert() that of the
/// map and O(beams · cubes along a beam); move() and remove() that of the replayed scans, and O(nodes). A
/// call that throws changes nothing.
/// @tparam Map an OccupancyMap, or a LayeredMap.
template <class Map>
class ScanHistory {
 public:
  static constexpr int D = Map::kDim;
  using Key = std::int64_t;
  /// What a scan brings beside its beams: of a LayeredMap, one measurement a beam for each layer.
  using Measured = typename Map::Measured;

  /// @throws std::invalid_argument naming the first option that is out of bounds.
  explicit ScanHistory(const MapOptions& options = {}) : ScanHistory(Map(options)) {}
  /// @param empty a map of these options and layers, that has taken no scan.
  /// @throws std::invalid_argument if it has.
  explicit ScanHistory(const Map& empty) : map_(empty), frozen_(empty) {
    if (empty.counters().scans > 0 || empty.tree().num_nodes() > 1)
      throw std::invalid_argument("a map of " + std::to_string(empty.counters().scans) + " scans and " +
                                  std::to_string(empty.tree().num_nodes()) +
                                  " nodes: a history must begin with an empty one");
  }

  [[nodiscard]] const Map& map() const { return map_; }
  [[nodiscard]] std::size_t size() const { return entries_.size(); }
  [[nodiscard]] bool contains(Key key) const { return numbers_.count(key) > 0; }
  /// Of all scans, in their order.
  [[nodiscard]] std::vector<Key> keys() const {
    std::vector<Key> keys;
    keys.reserve(entries_.size());
    for (const Entry& entry : entries_) keys.push_back(entry.key);
    return keys;
  }
  /// @throws std::out_of_range if there is no such scan.
  [[nodiscard]] const Pose<D>& pose(Key key) const { return entries_[place_of(key)].pose; }
  /// @throws as pose().
  [[nodiscard]] double max_range(Key key) const { return entries_[place_of(key)].max_range; }
  /// A scan in the map's frame, as the map took it in. @throws as pose().
  [[nodiscard]] Scan<D> scan(Key key) const {
    const Entry& entry = entries_[place_of(key)];
    return entry.kept->beams.at(entry.pose);
  }
  /// What a scan measured for the layers: of a LayeredMap, a tuple of vectors, one entry a beam of scan(key);
  /// 0 for beams that did not return. @throws as pose().
  [[nodiscard]] auto measurements(Key key) const {
    const Entry& entry = entries_[place_of(key)];
    const Scan<D> scan = entry.kept->beams.at(entry.pose);
    return map_.unpacked(scan.view(), entry.kept->measured);
  }
  /// Of the map and the packed scans, and of what frozen scans made.
  [[nodiscard]] std::size_t memory_bytes() const {
    std::size_t bytes = map_.memory_bytes() + (num_frozen_ > 0 ? frozen_.memory_bytes() : 0);
    for (const Entry& entry : entries_)
      bytes += sizeof(Entry) + entry.kept->memory_bytes() + sizeof(CubeSet<D>) + entry.cubes->memory_bytes();
    return bytes;
  }

  /// Maps a scan and keeps it.
  /// @param scan in its sensor's frame; its number, if it has one, above those of all scans before, also of
  ///   those that were removed. @param pose of the sensor in the map.
  /// @param measured for a map with layers: `{colours, stamps}`, vectors with one entry a beam.
  /// @param max_range, threads as of OccupancyMap::insert().
  /// @throws std::invalid_argument if the key is there already, the number is too small, the pose is no rigid
  ///   motion, or as the map's insert().
  InsertReport insert(Key key, const ScanView<D>& scan, const Pose<D>& pose, const Measured& measured,
                      double max_range = kUnlimitedRange, int threads = 0) {
    if (contains(key))
      throw std::invalid_argument("key " + std::to_string(key) +
                                  ": is there already; move() changes its pose");
    require_rigid(pose, key);
    const std::uint64_t number = scan.number.value_or(next_number_);
    if (number < next_number_)
      throw std::invalid_argument("number = " + std::to_string(number) + ": must be at least " +
                                  std::to_string(next_number_) + ", as scans before have smaller ones");
    Entry entry{key, number, pose, max_range, {}, {}, {}};
    entry.kept = std::make_shared<Kept>(
        Kept{PackedScan<D>(scan, map_.options().min_cell_size), map_.packed(scan, measured)});
    const Scan<D> in_map = entry.kept->beams.at(pose);
    const ScanView<D> view = numbered(in_map, number);
    entry.cubes = std::make_shared<CubeSet<D>>(cubes_of(view, max_range));
    // Nothing throws behind the map's own insertion.
    if (entries_.size() == entries_.capacity()) entries_.reserve(2 * entries_.size() + 1);
    const auto place = numbers_.emplace(key, number).first;
    InsertReport report;
    try {
      if (map_.undoes_insertions()) {
        report = insert_into(map_, *entry.cubes, entry, view, threads);
      } else {
        Map changed = map_;  // Shares what stays.
        report = insert_into(changed, *entry.cubes, entry, view, threads);
        last_checkpoint();
        map_ = std::move(changed);
      }
    } catch (...) {
      numbers_.erase(place);
      throw;
    }
    report.beams += entry.kept->beams.num_left_out();
    report.invalid += entry.kept->beams.num_left_out();
    entries_.push_back(std::move(entry));
    next_number_ = number + 1;
    return report;
  }
  /// Of a map without layers.
  template <class Given = Measured, class = std::enable_if_t<std::is_same_v<Given, NoMeasurements>>>
  InsertReport insert(Key key, const ScanView<D>& scan, const Pose<D>& pose,
                      double max_range = kUnlimitedRange, int threads = 0) {
    return insert(key, scan, pose, Given{}, max_range, threads);
  }

  /// Moves scans to other poses, and makes the map anew where they were and where they are.
  /// @throws std::out_of_range naming a key that is not there, std::invalid_argument if a key is there twice
  ///   or a pose is no rigid motion, and as OccupancyMap::insert().
  HistoryReport move(const std::vector<std::pair<Key, Pose<D>>>& poses, int threads = 0) {
    const auto start = std::chrono::steady_clock::now();
    std::vector<Entry> entries = entries_;
    std::vector<bool> is_given(entries.size());
    CubeSet<D> touched;
    std::size_t moved = 0;
    for (const auto& [key, pose] : poses) {
      const std::size_t place = place_of(key);
      require_first(is_given, place, key);
      require_rigid(pose, key);
      Entry& entry = entries[place];
      if (is_same(pose, entry.pose)) continue;
      ++moved;
      touched.add(*entry.cubes);
      entry.pose = pose;
      const Scan<D> scan = entry.kept->beams.at(pose);
      entry.cubes = std::make_shared<CubeSet<D>>(cubes_of(scan.view(), entry.max_range));
      touched.add(*entry.cubes);
    }
    return make_anew(std::move(entries), touched, moved, threads, start);
  }

  /// Takes scans out of the map. @throws as move().
  HistoryReport remove(const std::vector<Key>& keys, int threads = 0) {
    const auto start = std::chrono::steady_clock::now();
    std::vector<bool> goes(entries_.size());
    for (const Key key : keys) require_first(goes, place_of(key), key);
    std::vector<Entry> entries;
    CubeSet<D> touched;
    for (std::size_t i = 0; i < entries_.size(); ++i) {
      if (goes[i])
        touched.add(*entries_[i].cubes);
      else
        entries.push_back(entries_[i]);
    }
    const HistoryReport report = make_anew(std::move(entries), touched, keys.size(), threads, start);
    for (const Key key : keys) numbers_.erase(key);
    return report;
  }

  /// From now on the first scans stay where they are: the map keeps what they made of it, their beams and
  /// keys are forgotten. So memory is bounded on a long way. The invariant holds with them as the first of
  /// the present scans. Costs mapping them once more, and the memory of a map of the frozen scans.
  /// @param count of scans. @throws std::invalid_argument if there are fewer, and as OccupancyMap::insert().
  void freeze(std::size_t count, int threads = 0) {
    if (count > entries_.size())
      throw std::invalid_argument("count = " + std::to_string(count) + ": must be at most " +
                                  std::to_string(entries_.size()) + ", the number of scans");
    Map frozen = frozen_;
    for (std::size_t i = 0; i < count; ++i) {
      Entry entry = entries_[i];
      const Scan<D> scan = entry.kept->beams.at(entry.pose);
      (void)insert_into(frozen, *entry.cubes, entry, numbered(scan, entry.number), threads);
    }
    last_checkpoint();
    std::vector<Entry> entries(entries_.begin() + static_cast<std::ptrdiff_t>(count), entries_.end());
    for (std::size_t i = 0; i < count; ++i) numbers_.erase(entries_[i].key);
    entries_ = std::move(entries);
    frozen_ = std::move(frozen);
    num_frozen_ += count;
  }
  /// Scans that freeze() was called for.
  [[nodiscard]] std::size_t num_frozen() const { return num_frozen_; }

 private:
  struct Kept {
    PackedScan<D> beams;
    typename Map::PackedMeasured measured;

    [[nodiscard]] std::size_t memory_bytes() const { return beams.memory_bytes() + measured.memory_bytes(); }
  };
  struct Entry {
    Key key;
    std::uint64_t number;  ///< ScanView::number.
    Pose<D> pose;
    double max_range;
    std::shared_ptr<const Kept> kept;
    std::shared_ptr<const CubeSet<D>> cubes;  ///< Which it may change.
    typename Map::Reach reach;
  };

  /// Which of the entries a key belongs to.
  [[nodiscard]] std::size_t place_of(Key key) const {
    const auto found = numbers_.find(key);
    if (found == numbers_.end()) throw std::out_of_range("key " + std::to_string(key) + ": no such scan");
    const auto at = std::lower_bound(entries_.begin(), entries_.end(), found->second,
                                     [](const Entry& entry, std::uint64_t n) { return entry.number < n; });
    return static_cast<std::size_t>(at - entries_.begin());
  }
  /// Notes that a key was given. @throws std::invalid_argument the second time.
  static void require_first(std::vector<bool>& is_given, std::size_t place, Key key) {
    if (is_given[place]) throw std::invalid_argument("key " + std::to_string(key) + ": is given twice");
    is_given[place] = true;
  }
  static void require_rigid(const Pose<D>& pose, Key key) {
    constexpr double kRounding = 1e-6;
    const bool is_finite = pose.rotation.allFinite() && pose.translation.allFinite();
    const Eigen::Matrix<double, D, D> product = pose.rotation * pose.rotation.transpose();
    if (!is_finite || !product.isIdentity(kRounding) || !(pose.rotation.determinant() > 0.0))
      throw std::invalid_argument("the pose of key " + std::to_string(key) +
                                  ": must be finite, with a rotation matrix of determinant 1");
  }
  [[nodiscard]] static bool is_same(const Pose<D>& a, const Pose<D>& b) {
    return a.rotation == b.rotation && a.translation == b.translation;
  }

  [[nodiscard]] static ScanView<D> numbered(const Scan<D>& scan, std::uint64_t number) {
    ScanView<D> view = scan.view();
    view.number = number;
    return view;
  }
  /// Inserts an entry's scan into cubes of a map, and notes its reach. @param scan numbered, in the map.
  static InsertReport insert_into(Map& map, const CubeSet<D>& cubes, Entry& entry, const ScanView<D>& scan,
                                  int threads) {
    return map.insert_in(cubes, scan, entry.kept->measured, entry.max_range, threads, entry.reach);
  }
  /// Which cubes a scan crosses. @throws as survey_exactly().
  [[nodiscard]] CubeSet<D> cubes_of(const ScanView<D>& scan, double max_range) const {
    return cubes_crossed(map_.tree().geometry(), map_.measurements(scan, max_range));
  }

  /// Replaces the entries and the map. @param touched cubes that are made anew. @param moved, start for the
  /// report.
  HistoryReport make_anew(std::vector<Entry> entries, const CubeSet<D>& touched, std::size_t moved,
                          int threads, std::chrono::steady_clock::time_point start) {
    HistoryReport report;
    report.moved = moved;
    Map map = frozen_.emptied(map_.counters());
    if (num_frozen_ > 0) map.adopt_inside(touched, frozen_);
    for (Entry& entry : entries) {
      report.all_cube_scans += entry.cubes->size();
      if (!entry.cubes->overlaps(touched)) {
        map.grow_to(entry.reach, entry.kept->measured);
        continue;
      }
      const Scan<D> scan = entry.kept->beams.at(entry.pose);
      (void)insert_into(map, touched, entry, numbered(scan, entry.number), threads);
      ++report.replayed;
      entry.cubes->for_each([&](const Lattice<D>& cube) { report.cube_scans += touched.contains(cube); });
    }
    map.adopt_outside(touched, map_);
    // The next scan's number, which replayed scans may have set back.
    const Scan<D> none{{D, 0}, Vector<D>::Zero(), {}, 0.0, {}};
    typename Map::Reach of_none;
    if (!entries.empty())
      (void)map.insert_in({}, numbered(none, entries.back().number), {}, kUnlimitedRange, threads, of_none);
    report.cubes = touched.size();
    entries_ = std::move(entries);
    map_ = std::move(map);
    report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return report;
  }

  Map map_;
  Map frozen_;  // Of scans whose beams are forgotten.
  std::size_t num_frozen_ = 0;
  std::vector<Entry> entries_;  // By their numbers.
  std::unordered_map<Key, std::uint64_t> numbers_;
  std::uint64_t next_number_ = 0;
};

}  // namespace ndtree
