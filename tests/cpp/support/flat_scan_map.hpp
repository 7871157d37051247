// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Oracle of the default map, without a tree: a list of cells, each clipped against each beam of a scan.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <set>
#include <utility>
#include <vector>

#include "ndtree/mapping/occupancy_map.hpp"
#include "trees.hpp"

namespace ndtree::test {

/// The algorithm of a scan, slow and plain. Of mapping/scan it uses sampling_key_of() alone.
///
/// Strategy: for each cell, sum the evidence of all sampled beams that cross it, then decide: partly
/// seen, split or update. A split puts the children on the list of cells to be visited. In the end
/// siblings are merged, the finest first, where one of them changed.
/// Invariants: cells partition the box of level-0 cells; all numbers are rounded as in the library, so
/// that maps are compared bit by bit. The parts of cell/ are the library's, and have tests of their own: the
/// sensor model, the weight of a hit, partial occupancy, updates of a cell, re-merge, what children start
/// with, and merging.
/// Cost: O(cells * beams) for each scan.
template <int N, int D, class Sensor = BeamSensorModel>
class FlatScanMap {
 public:
  LeafMap<D, EvidenceCell> cells;
  std::uint64_t updates = 0;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  std::uint64_t remerged = 0;  ///< Splits that re-merged after the same scan; neither splits nor merges.
  std::uint64_t predicted_remerges = 0;  ///< Splits not made, as they were predicted to re-merge.
  std::uint64_t for_coverage = 0;        ///< Splits because a part was not seen.
  std::uint64_t for_grazing_ends = 0;    ///< Splits because a beam grazed the cells before its border.
  std::uint64_t partly_seen = 0;         ///< Updates of partly seen cells that did not split.
  std::uint64_t not_sampled = 0;         ///< Pairs of a cell and a crossing beam that it did not sample.
  std::uint64_t kept_occupied = 0;       ///< Updates after which partial_probability kept a cell occupied.
  std::uint64_t unclear_passes = 0;      ///< Occupied cells that beams passed, but not clearly.
  std::uint64_t stayed_apart = 0;        ///< Merges that partial_probability forbade.

  /// One leaf for each level-0 cell of [first, last) on each axis. Beams must stay inside.
  FlatScanMap(const MapOptions& options, int first, int last)
      : options_(options),
        num_levels_(options.num_levels(N)),
        sensor_(options),
        least_sigma_(EvidenceRefinement::least_sigma(options)),
        model_(options, options),
        merge_rule_(options, model_),
        partial_occupancy_(options) {
    for (const auto& cell : cells_within(CellIndex<D>{}, edge(0), first, last)) cells[cell] = {};
  }

  void insert(const Scan<D>& scan, double max_range) {
    beams_.clear();
    for (Eigen::Index i = 0; i < scan.size(); ++i)
      add(scan.origins.col(scan.origins.cols() == 1 ? 0 : i), scan.endpoints.col(i),
          scan.returned.size() == 0 || scan.returned[i],
          scan.range_sigma.size() == 0 ? -1.0 : scan.range_sigma[i], max_range);
    ++scans_;
    const double sigma = scan.range_sigma.size() == 0 ? options_.range_sigma : scan.range_sigma.minCoeff();
    for (finest_ = -num_levels_; finest_ < 0; ++finest_)
      if (smallest() >= options_.noise_sigmas * std::max(least_sigma_, sigma)) break;
    measure_faces();
    std::vector<CellIndex<D>> waiting;
    for (const auto& [index, cell] : cells) waiting.push_back(index);
    std::map<CellIndex<D>, std::pair<EvidenceCell, ScanEvidence>, IndexLess> split_now;
    std::set<CellIndex<D>, IndexLess> changed;  // Cells that changed, and all that contain them.
    const auto mark = [&](CellIndex<D> cell) {
      for (changed.insert(cell); cell.level < 0; changed.insert(cell)) cell = parent_of(cell);
    };
    while (!waiting.empty()) {
      const CellIndex<D> next = waiting.back();
      waiting.pop_back();
      EvidenceCell& cell = cells[next];
      const double sample_beams = sample_beams_of(next, cell);
      const ScanEvidence scan_evidence = evidence(next, sample_beams);
      not_sampled += num_beams(next, false, next, 1e9) - num_beams(next, false, next, sample_beams);
      const bool was_grazed =
          next.level > finest_ && cell.log_odds() == 0.0f && is_grazed(next, sample_beams);
      const Coverage coverage =
          was_grazed ? Coverage{} : coverage_of(next, cell, scan_evidence, sample_beams);
      const bool was_observed = cell.observed();
      const bool is_asked = was_grazed || (next.level > finest_ && splits_now(cell, scan_evidence));
      const bool is_predicted_to_remerge =
          is_asked && !coverage.splits && model_.predicted_to_remerge(cell, scan_evidence, kChildrenAcross);
      if (!coverage.enough && !coverage.splits) {
        const EvidenceCell before = cell;
        cell.set_partly_seen(
            coverage.parts, std::min<std::int64_t>(cell.free_evidence() + scan_evidence.free,
                                                   std::llround(256.0 * std::min(options_.free_memory,
                                                                                 options_.evidence_memory))));
        ++partly_seen;
        if (cell == before) continue;
        mark(next);
        updates += scan_evidence.beams;
      } else if (next.level > finest_ && (coverage.splits || (is_asked && !is_predicted_to_remerge))) {
        for_coverage += coverage.splits;
        for_grazing_ends += was_grazed && !splits_now(cell, scan_evidence);
        const EvidenceCell parent = cell;
        cells.erase(next);
        for (const auto& child : children_of<N, D>(next, edge(next.level - 1))) {
          cells[child] =
              model_.initial_child(parent, kChildrenAcross, num_beams(child, true, next, sample_beams),
                                   num_beams(next, false, next, sample_beams), part_of(child, next),
                                   is_a_part(child, next), child.level <= finest_);
          waiting.push_back(child);
        }
        split_now.emplace(next, std::make_pair(parent, scan_evidence));
        mark(next);
        ++splits;
      } else if (scan_evidence.beams > 0) {
        const EvidenceCell before = cell;
        if (is_predicted_to_remerge)
          model_.update_without_split(cell, scan_evidence);
        else if (next.level <= finest_ && cell.log_odds() > 0.0f && scan_evidence.hits == 0 &&
                 scan_evidence.misses > 0)
          unclear_passes += !update_passed(next, cell, scan_evidence, sample_beams);
        else
          model_.update(cell, scan_evidence);
        if (coverage.is_asked && (!was_observed || coverage.is_covered)) {
          cell.set_covered(coverage.is_covered);
          const int levels = coverage.is_covered ? std::max(0, next.level - finest_ - 1) : 0;
          cell.set_known_levels(std::max(cell.known_levels(), static_cast<std::uint32_t>(levels)));
        }
        predicted_remerges += is_predicted_to_remerge;
        if (next.level <= finest_ && keeps_occupied() && cell.hits() > 0 &&
            (cell.streak() < 12u || cell.streak_is_of_hits()) && is_partial(cell))
          kept_occupied += model_.raise(
              cell, std::log(options_.partial_probability / (1.0 - options_.partial_probability)));
        if (cell == before) continue;
        mark(next);
        updates += scan_evidence.beams;
      }
    }
    // Merge siblings where one of them changed, the finest first.
    for (int level = -num_levels_; level < 0; ++level) {
      std::set<CellIndex<D>, IndexLess> parents;
      for (const auto& [index, cell] : cells)
        if (index.level == level) parents.insert(parent_of(index));
      for (const auto& parent : parents) {
        if (changed.count(parent) == 0 || !merge(parent)) continue;
        if (const auto split = split_now.find(parent); split != split_now.end()) {
          --splits;
          ++remerged;
          // Misses add up as if the cell had not split.
          const auto& [before, scan_evidence] = split->second;
          const EvidenceCell merged = cells[parent];
          const bool has_left = before.log_odds() > 0.0f && merged.log_odds() < 0.0f;
          if (before.observed() && scan_evidence.hits == 0 && scan_evidence.occupied == 0 && !has_left) {
            cells[parent] = before;
            model_.update_without_split(cells[parent], scan_evidence,
                                        ChangeDetection::doubting_scans(merged));
          }
        } else {
          ++merges;
        }
      }
    }
  }

  /// Width of a beam over the distance from its origin.
  [[nodiscard]] float width_per_range() const {
    return static_cast<float>(2.0 * std::tan(0.5 * options_.beam_divergence));
  }
  /// The part of a beam's cross-section that a cell covers.
  [[nodiscard]] static float part_of(float beam_width, float size) {
    float part = 1.0f;
    for (int a = 1; a < D; ++a) part *= std::min(1.0f, size / beam_width);
    return part;
  }
  /// Evidence of the last scan's beams for a cell: of each face, the beams that the cell samples.
  [[nodiscard]] ScanEvidence evidence(const CellIndex<D>& index, double sample_beams) const {
    const float size = size_of(index);
    const bool finest = index.level <= finest_;
    const auto noise_sigmas = static_cast<float>(options_.noise_sigmas);
    ScanEvidence sum;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, index, sample_beams)) continue;
      const auto child_size =
          static_cast<float>(static_cast<double>(edge(index.level) / N) * options_.min_cell_size);
      const bool resolvable = !finest && child_size >= noise_sigmas * beam.sigma;
      // A way as long as a beam's mean way through the cell counts as one miss.
      constexpr double kMeanChords[] = {1.0, 0.78539816339744831, 2.0 / 3.0, 0.58904862254808623};
      const double miss = std::round(-256.0 * static_cast<double>(log_odds_of(options_.probability_min)));
      const auto units_per_metre = static_cast<float>(
          miss / (kMeanChords[D - 1] * (static_cast<double>(edge(index.level)) * options_.min_cell_size)));
      const std::int64_t way = std::max(1L, std::lrint((exit - enter) * units_per_metre));
      const auto count_miss = [&] {
        sum.free += way;
        ++sum.misses;
        sum.resolvable_misses += resolvable;
        ++sum.beams;
      };
      if (!beam.returned) {
        count_miss();
        continue;
      }
      // A way through a small cell is at least 5/3 sigma long, or the evidence of small cells would be too
      // small.
      const bool small = finest || size <= 2.0f * beam.sigma;
      if (small) exit = std::max(exit, enter + beam.surface);
      if (exit < beam.clearly_free_until) {
        count_miss();
        continue;
      }
      const float per_sigma = 1.0f / beam.sigma;
      const bool hit = contains(index, cell_of_hit(beam));
      // The cell of a hit counts as reaching at least 0.5 sigma behind it.
      const float exit_behind = std::max((exit - beam.range) * per_sigma, hit ? 0.5f : -HUGE_VALF);
      const float nats = sensor_.quick_log_odds((enter - beam.range) * per_sigma, exit_behind);
      const bool behind_surface = !hit && enter >= beam.range;
      if (behind_surface && !small) continue;
      if (nats > 0.0f)
        sum.occupied +=
            std::lrint(BeamWeight::probability_inside_table()(std::min(beam.sigma * (1.0f / size), 0.6f)) *
                       part_of(width_per_range() * beam.range, size) * nats * 256.0f);
      else
        sum.free += std::lrint(-nats * 256.0f);
      if (hit) {
        ++sum.hits;
        sum.resolvable_hits += resolvable && child_size >= width_per_range() * beam.range;
        sum.partial_hits +=
            resolvable && ((beam.range - enter) * per_sigma > 3.0f || size > 3.0f * beam.sigma);
      } else if (!behind_surface) {
        ++sum.misses;
      }
      ++sum.beams;
    }
    model_.limit(sum);
    return sum;
  }

 private:
  struct FlatBeam;
  /// The smallest cell in which the beam is a hit: the one right behind its end point.
  [[nodiscard]] CellIndex<D> cell_of_hit(const FlatBeam& beam) const {
    const auto cell_at = [&](const Vector<D>& point) {
      CellIndex<D> cell;
      cell.level = -num_levels_;
      for (std::size_t a = 0; a < D; ++a)
        cell.lower[a] =
            static_cast<std::int64_t>(std::floor(point[static_cast<int>(a)] / options_.min_cell_size));
      return cell;
    };
    return cell_at(beam.endpoint + 1e-12 * (beam.endpoint - beam.origin));
  }

  struct FlatBeam {
    Vector<D> origin;
    Vector<D> path;
    Vector<D> endpoint;
    std::array<float, D> inverse;  ///< Inverse direction: metres along the beam for one along the axis.
    float range;                   ///< Distances from the origin [m].
    float sigma;
    float t_max;
    float clearly_free_until;
    float surface;
    float slant;  ///< Depth over range.
    bool returned;
    std::array<double, D + 2> face;  ///< Origin, main axis and its sign.
    std::uint32_t key;
  };
  /// A cube-map face.
  struct Face {
    std::array<float, D> lower, upper;
    int beams = 0;
    float density = 0.0f;  ///< Pixels in a row of length 1.
    std::array<float, D> pixels;
  };
  static constexpr int kChildrenAcross = static_cast<int>(integer_power(N, D)) / N;

  static float log_odds_of(double p) { return static_cast<float>(std::log(p / (1.0 - p))); }
  [[nodiscard]] float size_of(const CellIndex<D>& index) const {
    return static_cast<float>(static_cast<double>(edge(index.level)) * options_.min_cell_size);
  }

  void add(const Vector<D>& origin, const Vector<D>& endpoint, bool returned, double range_sigma,
           double max_range) {
    const Vector<D> path = endpoint - origin;
    const double range = path.norm();
    if (!std::isfinite(range) || range == 0.0) return;
    const bool cut = range > max_range;
    const double t_free = cut ? max_range / range : 1.0;
    returned = returned && !cut;
    int axis = 0;
    for (int a = 1; a < D; ++a)  // The first axis with the largest component, as floats.
      if (std::abs(static_cast<float>(path[a])) > std::abs(static_cast<float>(path[axis]))) axis = a;
    std::array<double, D + 2> face{};
    for (int a = 0; a < D; ++a) face[static_cast<std::size_t>(a)] = origin[a];
    face[D] = axis;
    face[D + 1] = std::copysign(1.0, path[axis]);
    std::array<float, D> displacement;
    std::array<float, D> inverse;
    float depth = 0.0f;
    float square = 0.0f;
    for (std::size_t a = 0; a < D; ++a) {
      displacement[a] = static_cast<float>(path[static_cast<int>(a)]);
      depth = std::max(depth, std::abs(displacement[a]));
      square += displacement[a] * displacement[a];
    }
    const float length = std::sqrt(square);
    for (std::size_t a = 0; a < D; ++a)
      inverse[a] =
          std::min(length / std::abs(displacement[a]), 1e12f) * (displacement[a] < 0.0f ? -1.0f : 1.0f);
    FlatBeam beam;
    beam.origin = origin;
    beam.path = path;
    beam.endpoint = endpoint;
    beam.inverse = inverse;
    beam.range = cut ? static_cast<float>(t_free * range) : length;
    const auto metres = static_cast<double>(beam.range);
    const double noise = std::max(least_sigma_, range_sigma >= 0.0 ? range_sigma : sensor_.sigma(metres));
    beam.sigma = static_cast<float>(noise);
    beam.t_max = returned ? static_cast<float>(metres + 3.0 * noise) : beam.range;
    beam.clearly_free_until =
        returned ? static_cast<float>(sensor_.clearly_free_until(metres, noise)) : beam.range;
    beam.surface = returned ? static_cast<float>(5.0 / 3.0) * beam.sigma : 0.0f;
    beam.slant = depth / length;
    beam.returned = returned;
    beam.face = face;
    beam.key = sampling_key_of<D>(displacement, scans_);
    beams_.push_back(beam);
  }

  /// Divides the part of each face that beams pass through into square pixels of one beam each in the mean.
  void measure_faces() {
    faces_.clear();
    for (const FlatBeam& beam : beams_) {
      const auto [found, is_new] = faces_.emplace(beam.face, Face{});
      Face& face = found->second;
      ++face.beams;
      for (std::size_t a = 0; a < D; ++a) {
        const float coordinate = static_cast<float>(beam.path[static_cast<int>(a)]) /
                                 static_cast<float>(beam.path.cwiseAbs().maxCoeff());
        face.lower[a] = is_new ? coordinate : std::min(face.lower[a], coordinate);
        face.upper[a] = is_new ? coordinate : std::max(face.upper[a], coordinate);
      }
    }
    for (auto& [key, face] : faces_) {
      double area = 1.0;
      double widest = 0.0;
      int axes = 0;
      for (std::size_t a = 0; a < D; ++a) {
        const double extent = static_cast<double>(face.upper[a]) - static_cast<double>(face.lower[a]);
        if (a == static_cast<std::size_t>(key[D])) continue;
        widest = std::max(widest, extent);
        if (extent <= 1e-6) continue;
        area *= extent;
        ++axes;
      }
      const double least = axes == 0 ? 1.0 : std::max(1e-6, std::pow(area / face.beams, 1.0 / axes));
      const double width = std::max(least, widest / face.beams);
      face.density = static_cast<float>(1.0 / width);
      for (std::size_t a = 0; a < D; ++a)
        face.pixels[a] = static_cast<float>(
            1.0 +
            std::floor((static_cast<double>(face.upper[a]) - static_cast<double>(face.lower[a])) / width));
    }
  }
  /// Number of pixels of the beam's face that a cube of this size at the cell's centre covers.
  [[nodiscard]] float pixels_of(const FlatBeam& beam, const CellIndex<D>& index, float size) const {
    const Face& face = faces_.at(beam.face);
    const auto axis = static_cast<std::size_t>(beam.face[D]);
    const double lower = border(index.lower[axis]);
    const double upper = border(index.lower[axis] + edge(index.level));
    const double centre = 0.5 * (lower + upper) - beam.origin[static_cast<int>(axis)];
    const auto depth = static_cast<float>(std::max(0.5 * (upper - lower), std::abs(centre)));
    float pixels = 1.0f;
    for (std::size_t a = 0; a < D; ++a)
      if (a != axis) pixels *= std::min(size * face.density / depth, face.pixels[a]);
    return pixels;
  }
  /// The cell's sampling fraction on the beam's face, may be above 1; 1 if the beam is the face's only one.
  [[nodiscard]] float fraction_of(const FlatBeam& beam, const CellIndex<D>& index,
                                  double sample_beams) const {
    if (faces_.at(beam.face).beams == 1) return 1.0f;
    return static_cast<float>(sample_beams) / pixels_of(beam, index, static_cast<float>(smallest()));
  }
  [[nodiscard]] bool is_in_sample(const FlatBeam& beam, const CellIndex<D>& index,
                                  double sample_beams) const {
    // A bucket of one to two beams in the mean is sampled as a whole or not.
    const float fraction = fraction_of(beam, index, sample_beams);
    const float buckets = std::exp2(std::floor(std::log2(static_cast<float>(faces_.at(beam.face).beams))));
    return fraction >= 1.0f ||
           std::floor(static_cast<float>(beam.key) / 16777216.0f * buckets) < fraction * buckets;
  }
  [[nodiscard]] double smallest() const {
    return static_cast<double>(edge(finest_)) * options_.min_cell_size;
  }
  /// Well observed cells sample fewer beams, unless they are saturated and too many beams end in them.
  [[nodiscard]] double sample_beams_of(const CellIndex<D>& index, const EvidenceCell& cell) const {
    const bool is_well_observed = static_cast<double>(cell.occupied_evidence() + cell.free_evidence()) >=
                                  std::floor(options_.known_evidence * 256.0 + 0.5);
    const double learning = 5.0 * options_.sample_beams;
    // For each face: number of beams that end in the cell, and number of beams expected there.
    std::map<std::array<double, D + 2>, std::pair<int, float>> ends;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!beam.returned || !clip(beam, index, enter, exit) || !contains(index, cell_of_hit(beam)) ||
          !is_in_sample(beam, index, learning))
        continue;
      auto& [count, expected] = ends[beam.face];
      ++count;
      expected = faces_.at(beam.face).beams == 1
                     ? 1.0f
                     : std::max(1.0f, std::min(1.0f, fraction_of(beam, index, learning)) *
                                          pixels_of(beam, index, size_of(index)));
    }
    double blocked = 0.0;
    for (const auto& [face, of_face] : ends) blocked += of_face.first / static_cast<double>(of_face.second);
    const bool contradicted = (model_.is_saturated(cell) && blocked > options_.hit_given_free) ||
                              (cell.log_odds() > 0.0f && cell.streak() > 0 && !cell.streak_is_of_hits());
    return is_well_observed && !contradicted ? options_.sample_beams : learning;
  }

  /// Updates an occupied cell that all beams passed. @returns whether they did so clearly: some beam on half
  /// an edge or more, and none that ends within two edges and three standard deviations behind it.
  bool update_passed(const CellIndex<D>& index, EvidenceCell& cell, const ScanEvidence& scan,
                     double sample_beams) const {
    bool goes_through = false;
    bool ends_near = false;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, index, sample_beams)) continue;
      const float near = unfused(2.0f * size_of(index)) + unfused(3.0f * beam.sigma);
      ends_near = ends_near || (beam.returned && beam.range - exit < near);
      goes_through = goes_through || exit - enter >= 0.5f * size_of(index);
    }
    model_.update_passed(cell, scan, goes_through && !ends_near);
    return goes_through && !ends_near;
  }

  struct Coverage {
    bool is_asked = false;  ///< Coverage decides whether the cell is observed.
    bool is_covered = false;
    bool enough = true;
    bool splits = false;
    std::uint32_t parts = 0;
  };
  /// The part of a cell in which a child lies, of its 2^D parts, at most 16.
  [[nodiscard]] int part_of(const CellIndex<D>& child, const CellIndex<D>& parent) const {
    int part = 0;
    for (std::size_t a = 0; a < static_cast<std::size_t>(std::min(D, 4)); ++a)
      if (2 * (child.lower[a] - parent.lower[a]) >= edge(parent.level)) part += 1 << a;
    return part;
  }
  /// Whether no other child lies in the part of a child.
  [[nodiscard]] bool is_a_part(const CellIndex<D>& child, const CellIndex<D>& parent) const {
    int in_part = 0;
    for (const auto& sibling : children_of<N, D>(parent, edge(child.level)))
      in_part += part_of(sibling, parent) == part_of(child, parent);
    return in_part == 1;
  }
  /// Whether a cell that is observed but not covered is looked at again: its misses pass a power of two.
  [[nodiscard]] bool is_looked_at_again(const EvidenceCell& cell, const ScanEvidence& scan) const {
    if (cell.is_covered() || splits_now(cell, scan)) return false;
    const double miss = std::round(-256.0 * static_cast<double>(log_odds_of(options_.probability_min)));
    const double memory = std::round(256.0 * std::min(options_.free_memory, options_.evidence_memory));
    const double most = std::max(1.0, std::min(511.0, std::floor(memory / miss)));
    for (double power = 1.0; power <= std::min(most, static_cast<double>(cell.misses() + scan.misses));
         power *= 2.0)
      if (cell.misses() < power) return true;
    return false;
  }
  /// In a plane, where beams are evenly spaced by angle: how far they are apart in the middle of a face, over
  /// their mean distance on it.
  [[nodiscard]] static float evenness(const Face& face, std::size_t axis) {
    double sum = 0.0;
    for (int i = 0; D == 2 && i < 5; ++i) {
      const auto across = static_cast<std::size_t>(D - 1) - axis;
      const auto lower = static_cast<double>(face.lower[across]);
      const double at = lower + unfused(0.25 * i * (static_cast<double>(face.upper[across]) - lower));
      sum += (i == 0 || i == 4 ? 1 : i == 2 ? 2 : 4) / (1.0 + unfused(at * at));
    }
    return D == 2 ? static_cast<float>(sum / 12.0) : 1.0f;
  }
  /// Coverage of a cell that was not observed before, or not all of it.
  [[nodiscard]] Coverage coverage_of(const CellIndex<D>& index, const EvidenceCell& cell,
                                     const ScanEvidence& scan, double sample_beams) const {
    Coverage result;
    if (options_.covered_share == 0.0 || index.level <= finest_ || scan.beams == 0 || scan.hits > 0 ||
        scan.occupied > 0 || (cell.observed() && !is_looked_at_again(cell, scan)))
      return result;
    const double size = static_cast<double>(edge(index.level)) * options_.min_cell_size;
    const auto children = children_of<N, D>(index, edge(index.level - 1));
    const float per_child = 1.0f / size_of(children.front());
    constexpr float kUnits = 1 << 20;
    std::vector<double> seen(children.size(), 0.0);  // In kUnits.
    double way = 0.0;
    double slices = 0.0;  // Of the beams, as wide as the cell at most.
    bool are_single = true;
    float sampled = 1.0f;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, index, sample_beams)) continue;
      const Face& face = faces_.at(beam.face);
      const float fraction = std::min(1.0f, fraction_of(beam, index, sample_beams));
      const float widening = D < 2    ? 1.0f
                             : D == 2 ? 1.0f / fraction
                             : D == 3 ? 1.0f / std::sqrt(fraction)
                                      : std::pow(fraction, -1.0f / static_cast<float>(D - 1));
      if (enter >= beam.range) continue;
      exit = std::min(exit, beam.range);
      const auto width_at = [&](float distance) {
        const float spacing =
            face.beams == 1
                ? 0.0f
                : std::min(0.1f, evenness(face, static_cast<std::size_t>(beam.face[D])) / face.density) *
                      widening;
        const float per_depth = std::max(spacing, width_per_range()) * per_child;
        if (per_depth == 0.0f) return static_cast<float>(smallest()) * per_child;
        return distance * (D == 2 ? per_depth / beam.slant : beam.slant * per_depth);
      };
      const float width = width_at(0.5f * (enter + exit));
      const float through = (exit - enter) * beam.slant * per_child * kUnits;
      float area_of_slice = 1.0f;
      for (int a = 1; a < D; ++a) area_of_slice *= std::min(static_cast<float>(N), width);
      way += static_cast<double>(std::nearbyint(through));
      if (std::nearbyint(through) != 0.0f) {
        are_single = are_single && face.beams == 1 && width_per_range() == 0.0f;
        sampled = std::min(sampled, fraction);
      }
      slices += static_cast<double>(std::nearbyint(through * area_of_slice));
      for (std::size_t j = 0; j < children.size(); ++j) {
        if (!clip(beam, children[j], enter, exit) || enter >= beam.range) continue;
        exit = std::min(exit, beam.range);
        const float chord = (exit - enter) * beam.slant * per_child * kUnits;
        const float width_there = width_at(0.5f * (enter + exit));
        float area = 1.0f;  // Of the beam's cross-section in the child, over that of the child.
        for (std::size_t a = 0; a < D; ++a) {
          if (a == static_cast<std::size_t>(beam.face[D])) continue;
          const float to_border =
              static_cast<float>(border(children[j].lower[a]) - beam.origin[static_cast<int>(a)]);
          const float at = 0.5f * (enter + exit) * (1.0f / beam.inverse[a] * per_child);
          const float from_middle = std::abs(at - (to_border * per_child + 0.5f));
          area *=
              std::max(0.0f, std::min(0.5f + 0.5f * width_there - from_middle, std::min(1.0f, width_there)));
        }
        seen[j] += static_cast<double>(std::nearbyint(chord * area));
      }
    }
    const double mean_area = way > 0.0 ? slices / way : 0.0;
    const double mean_width = D <= 2   ? mean_area
                              : D == 3 ? std::sqrt(mean_area)
                                       : std::pow(mean_area, 1.0 / std::max(1, D - 1));
    const double half = std::min(1.0, 0.5 * mean_width);
    double mean_share = 1.0;
    for (int a = 1; slices > 0.0 && a < D; ++a) mean_share *= half * (2.0 - half) / std::min(mean_width, 1.0);
    const double smallest_cells = size / smallest();
    const double asked = smallest_cells < 2.5 ? 0.5 : 1.0;  // Of cells of two smallest ones, half.
    const double of_part_seen =
        smallest_cells < 2.5 ? 0.5 * options_.covered_share
                             : 1.0 - (1.0 - options_.covered_share) * std::min(1.0, 2.0 * N / smallest_cells);
    const double of_child = mean_share * of_part_seen;
    const double beams_for_child = slices > 0.0 ? way / slices : 0.0;
    // In a plane beams are evenly spaced, but for those left out of a sample; in space their number scatters.
    const double left_out = D == 2 ? 1.0 - static_cast<double>(sampled) : 1.0;
    const double fewer = (D == 2 ? 0.5 / beams_for_child : 0.0) + std::sqrt(2.0 * left_out / beams_for_child);
    double least = 0.0;
    if (D == 2 && beams_for_child > (1.0 + 2.0 * left_out) * (1.0 - 1e-4))
      least = std::min(of_child, 0.95 * (1.0 - fewer * (1.0 - 1e-4)));
    if (D != 2) least = std::min(of_child, mean_share * (1.0 - fewer * std::sqrt(1.0 - 1e-4)));
    const bool may_split = smallest_cells > options_.coverage_cells * (1.0 + 1e-9);
    if (cell.is_partly_seen()) result.parts = cell.seen_parts();
    const auto seen_before = [before = result.parts](int part) { return (before & 1u << part) != 0; };
    std::map<int, std::pair<double, int>> parts;
    std::set<int> with_missing;
    result.is_asked = true;
    result.is_covered = true;
    for (std::size_t j = 0; j < children.size(); ++j) {
      auto& [of_part, count] = parts[part_of(children[j], index)];
      const double seen_fraction = seen[j] / static_cast<double>(kUnits);
      of_part += std::min(1.0, seen_fraction);
      ++count;
      if (seen_fraction < least) with_missing.insert(part_of(children[j], index));
      if (seen_fraction < least && !seen_before(part_of(children[j], index)) && may_split &&
          beams_for_child > 2.0 * (1.0 - 1e-4))
        result.splits = true;
      // Covered: each child was seen, but for one smallest cell in depth, or half of it.
      if (seen_fraction < (1.0 - 1e-4) * (1.0 - std::min(0.5, N / smallest_cells)) - 1e-6)
        result.is_covered = false;
    }
    int seen_children = 0;
    double volume = 0.0;  // Seen of the cell.
    for (const auto& [part, of_part] : parts) {
      if (of_part.first >= (1.0 - 1e-4) * mean_share * options_.covered_share * asked * of_part.second &&
          with_missing.count(part) == 0)
        result.parts |= 1u << part;
      if ((result.parts & 1u << part) != 0) seen_children += of_part.second;
      volume += of_part.first / static_cast<double>(children.size()) * std::max(1.0, mean_area);
    }
    const auto count = static_cast<double>(children.size());
    const bool are_few = beams_for_child < 2.0 && smallest_cells < N + 0.5;
    const bool has_enough =
        seen_children >= count * asked ||
        (are_few && seen_children > 0 && volume >= mean_share * options_.covered_share * (1.0 - 1e-4));
    const double miss = std::round(-256.0 * static_cast<double>(log_odds_of(options_.probability_min)));
    const double beams = static_cast<double>(cell.free_evidence() + scan.free) / miss;
    const double parts_side_by_side = std::exp2(std::min(D, 4) - 1);
    if (!has_enough && (may_split || are_few) && beams > (D == 2 ? 4.0 : 8.0) * parts_side_by_side)
      result.splits = true;
    const double most = std::round(256.0 * std::min(options_.free_memory, options_.evidence_memory));
    const bool adds_nothing = scan.free > 0 && static_cast<double>(cell.free_evidence()) >= most;
    if (!has_enough && (adds_nothing || are_single)) result.splits = true;
    result.enough = !result.splits && has_enough;
    if (cell.observed()) {
      result.splits = false;
      result.enough = true;
    }
    return result;
  }

  /// Whether a sampled beam ended right before the cell, which takes no evidence from there, and went along
  /// the smallest cells before the border through which it enters over more than the edge of one.
  [[nodiscard]] bool is_grazed(const CellIndex<D>& index, double sample_beams) const {
    const auto child_size =
        static_cast<float>(static_cast<double>(edge(index.level) / N) * options_.min_cell_size);
    const float per_smallest = 1.0f / size_of(CellIndex<D>{{}, finest_});
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, index, sample_beams)) continue;
      if (!beam.returned || enter < beam.range || contains(index, cell_of_hit(beam)) ||
          size_of(index) <= 2.0f * beam.sigma ||
          child_size < static_cast<float>(options_.noise_sigmas) * beam.sigma)
        continue;
      const float behind = (enter - beam.range) * per_smallest;
      for (std::size_t a = 0; a < D; ++a) {
        const std::int64_t near = index.lower[a] + (beam.inverse[a] < 0.0f ? edge(index.level) : 0);
        const float to_border = static_cast<float>(border(near) - beam.origin[static_cast<int>(a)]);
        if (to_border * beam.inverse[a] != enter) continue;
        const float slant = std::abs(beam.inverse[a]);
        const float cosine = 1.0f / slant;
        const float sine = std::sqrt(std::max(0.0f, 1.0f - unfused(cosine * cosine)));
        if (sine * (slant - behind) > 1.0f) return true;
      }
    }
    return false;
  }
  [[nodiscard]] bool splits_now(const EvidenceCell& cell, const ScanEvidence& scan) const {
    if (cell.log_odds() < 0.0f) return scan.resolvable_hits > 0;
    if (cell.log_odds() == 0.0f) return scan.partial_hits > 0;
    return (scan.resolvable_misses > 0 || scan.partial_hits > 0) &&
           partial_occupancy_(cell.hits() + scan.hits, cell.misses() + scan.misses + scan.partial_hits)
                   .partial > options_.split_probability;
  }

  /// Whether smallest cells that are partially occupied stay occupied.
  [[nodiscard]] bool keeps_occupied() const { return options_.partial_probability > 0.0; }
  [[nodiscard]] bool is_partial(const EvidenceCell& cell) const {
    return partial_occupancy_(cell.hits(), cell.misses()).partial > options_.split_probability;
  }

  [[nodiscard]] std::int64_t edge(int level) const { return edge_above<N>(-num_levels_, level); }
  [[nodiscard]] double border(std::int64_t k) const {
    return static_cast<double>(k) * options_.min_cell_size;
  }
  [[nodiscard]] bool contains(const CellIndex<D>& cell, const CellIndex<D>& smaller) const {
    for (std::size_t a = 0; a < D; ++a)
      if (smaller.lower[a] < cell.lower[a] || smaller.lower[a] >= cell.lower[a] + edge(cell.level))
        return false;
    return true;
  }
  /// @returns true if the beam crosses the cell over more than a point of (0, t_max), in floats.
  [[nodiscard]] bool clip(const FlatBeam& beam, const CellIndex<D>& index, float& enter, float& exit) const {
    enter = 0.0f;
    exit = beam.t_max;
    for (std::size_t a = 0; a < D; ++a) {
      const double origin = beam.origin[static_cast<int>(a)];
      const float lower = static_cast<float>(border(index.lower[a]) - origin) * beam.inverse[a];
      const float upper =
          static_cast<float>(border(index.lower[a] + edge(index.level)) - origin) * beam.inverse[a];
      enter = std::max(enter, std::min(lower, upper));
      exit = std::min(exit, std::max(lower, upper));
    }
    return enter < exit;
  }
  /// Number of beams in the parent's sample that cross a cell.
  /// @param passed only beams that clearly passed the cell.
  [[nodiscard]] std::size_t num_beams(const CellIndex<D>& index, bool passed, const CellIndex<D>& parent,
                                      double sample_beams) const {
    std::size_t n = 0;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, parent, sample_beams)) continue;
      n += !passed || !beam.returned || exit < beam.clearly_free_until;
    }
    return n;
  }
  [[nodiscard]] CellIndex<D> parent_of(CellIndex<D> cell) const {
    const std::int64_t size = edge(++cell.level);
    for (auto& lower : cell.lower) lower -= ((lower % size) + size) % size;
    return cell;
  }
  bool merge(const CellIndex<D>& parent) {
    const auto children = children_of<N, D>(parent, edge(parent.level - 1));
    std::vector<Node<EvidenceCell>> nodes(children.size());
    for (std::size_t j = 0; j < children.size(); ++j) {
      const auto found = cells.find(children[j]);
      if (found == cells.end())
        nodes[j].become_inner(1);
      else
        nodes[j].become_leaf(found->second);
    }
    const auto merged = merge_rule_(nodes.data(), static_cast<int>(nodes.size()), kChildrenAcross);
    if (!merged) return false;
    if (keeps_occupied() && merged->log_odds() > 0.0f && is_partial(*merged)) {
      ++stayed_apart;
      return false;
    }
    for (const auto& child : children) cells.erase(child);
    cells[parent] = *merged;
    return true;
  }

  MapOptions options_;
  int num_levels_;
  int finest_ = 0;  // Level of the cells that the last scan did not split.
  const Sensor sensor_;
  double least_sigma_;
  EvidenceModel model_;
  EvidenceMergeRule merge_rule_;
  PartialOccupancyModel partial_occupancy_;
  std::uint64_t scans_ = 0;
  std::vector<FlatBeam> beams_;
  std::map<std::array<double, D + 2>, Face> faces_;
};

}  // namespace ndtree::test
