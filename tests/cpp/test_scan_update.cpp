// SPDX-License-Identifier: BSD-3-Clause
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <map>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/core/simd.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "options.hpp"
#include "random.hpp"
#include "shapes.hpp"
#include "trees.hpp"

namespace ndtree::test::test_scan_update {
namespace {

/// The map without a tree: a list of cells, each clipped against each beam of a scan. Slow and plain. What a
/// cell makes of its evidence, and when siblings join, is taken from their models, which have their own
/// tests.
template <int N, int D>
class FlatScanMap {
 public:
  LeafMap<D, EvidenceCell> cells;
  std::uint64_t updates = 0;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  std::uint64_t whole_again = 0;   ///< Splits undone by the same scan, which count as neither.
  std::uint64_t for_coverage = 0;  ///< Splits of cells of which only a part was seen ...
  std::uint64_t partly_seen = 0;   ///< ... and updates of those that did not split.
  std::uint64_t sampled = 0;       ///< Pairs of a cell and a beam that was in no sample.

  /// Level-0 cells of [first, last) on each axis; beams must not leave them.
  FlatScanMap(const MapOptions& options, int first, int last)
      : options_(options),
        num_levels_(options.num_levels(N)),
        sensor_(options),
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
    measure_faces();
    std::vector<CellIndex<D>> waiting;
    for (const auto& [index, cell] : cells) waiting.push_back(index);
    std::set<CellIndex<D>, IndexLess> split_now;
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
      sampled += num_beams(next, false, next, 1e9) - num_beams(next, false, next, sample_beams);
      const Coverage coverage = coverage_of(next, cell, scan_evidence, sample_beams);
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
      } else if (next.level > -num_levels_ && (coverage.splits || splits_now(cell, scan_evidence))) {
        for_coverage += coverage.splits;
        const EvidenceCell parent = cell;
        cells.erase(next);
        for (const auto& child : children_of<N, D>(next, edge(next.level - 1))) {
          cells[child] = model_.inherited(parent, kShare, num_beams(child, true, next, sample_beams),
                                          num_beams(next, false, next, sample_beams), part_of(child, next));
          waiting.push_back(child);
        }
        split_now.insert(next);
        mark(next);
        ++splits;
      } else if (scan_evidence.beams > 0) {
        const EvidenceCell before = cell;
        model_.update(cell, scan_evidence);
        if (cell == before) continue;
        mark(next);
        updates += scan_evidence.beams;
      }
    }
    // Parents of which a cell changed, the finest first.
    for (int level = -num_levels_; level < 0; ++level) {
      std::set<CellIndex<D>, IndexLess> parents;
      for (const auto& [index, cell] : cells)
        if (index.level == level) parents.insert(parent_of(index));
      for (const auto& parent : parents) {
        if (changed.count(parent) == 0 || !merge(parent)) continue;
        if (split_now.count(parent) != 0) {
          --splits;
          ++whole_again;
        } else {
          ++merges;
        }
      }
    }
  }

  /// What the beams of the last scan say about a cell, of each face's a sample.
  [[nodiscard]] ScanEvidence evidence(const CellIndex<D>& index, double sample_beams) const {
    const float size = size_of(index);
    const bool finest = index.level == -num_levels_;
    const auto noise_sigmas = static_cast<float>(options_.noise_sigmas);
    ScanEvidence sum;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, index, sample_beams)) continue;
      const auto child_size =
          static_cast<float>(static_cast<double>(edge(index.level) / N) * options_.min_cell_size);
      const bool resolvable = !finest && child_size >= noise_sigmas * beam.sigma;
      // Of the way of a beam in the mean, a miss is worth one.
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
        if (exit < beam.range || !contains(index, beam.free_end)) count_miss();
        continue;
      }
      // A surface is never thinner than 5/3 of the noise, or the cells that are small would say less than it.
      const bool small = finest || size <= 2.0f * beam.sigma;
      if (small) exit = std::max(exit, enter + beam.surface);
      if (exit < beam.clear) {
        count_miss();
        continue;
      }
      const float per_sigma = 1.0f / beam.sigma;
      const float nats =
          sensor_.tabulated_log_odds((enter - beam.range) * per_sigma, (exit - beam.range) * per_sigma);
      const bool hit = contains(index, cell_of_hit(beam));
      const bool behind = !hit && enter >= beam.range;
      if (behind && !small) continue;
      if (nats > 0.0f)
        sum.occupied +=
            std::lrint(EvidenceModel::probability_inside_table()(std::min(beam.sigma * (1.0f / size), 0.6f)) *
                       nats * 256.0f);
      else
        sum.free += std::lrint(-nats * 256.0f);
      if (hit) {
        ++sum.hits;
        sum.resolvable_hits += resolvable;
        sum.deep_hits += resolvable && ((beam.range - enter) * per_sigma > 3.0f || size > 3.0f * beam.sigma);
      } else if (!behind) {
        ++sum.misses;
      }
      ++sum.beams;
    }
    model_.limit(sum);
    return sum;
  }

 private:
  struct FlatBeam;
  /// The smallest cell that counts the hit: that of the end point, or the next if the beam only touches that
  /// one.
  [[nodiscard]] CellIndex<D> cell_of_hit(const FlatBeam& beam) const {
    const auto cell_at = [&](const Vector<D>& point) {
      CellIndex<D> cell;
      cell.level = -num_levels_;
      for (std::size_t a = 0; a < D; ++a)
        cell.lower[a] =
            static_cast<std::int64_t>(std::floor(point[static_cast<int>(a)] / options_.min_cell_size));
      return cell;
    };
    const CellIndex<D> cell = cell_at(beam.endpoint);
    return is_crossed(beam, cell) ? cell : cell_at(beam.endpoint + 1e-9 * (beam.endpoint - beam.origin));
  }

  struct FlatBeam {
    Vector<D> origin;
    Vector<D> path;
    Vector<D> endpoint;
    Vector<D> free_end;
    std::array<float, D> inverse;  ///< Metres of the beam for one along an axis.
    float range;                   ///< Distances from the origin [m].
    float sigma;
    float reach;
    float clear;
    float surface;
    float slant;  ///< Depth over range.
    bool returned;
    std::array<double, D + 2> face;  ///< Where it comes from, and the axis and sense in which it mainly goes.
    std::uint32_t chance;
  };
  /// All beams through one side of a cube around one origin.
  struct Face {
    std::array<float, D> lower, upper;
    int beams = 0;
    float density = 0.0f;  ///< Places of one beam in a row of length 1.
    std::array<float, D> places;
  };
  static constexpr int kShare = static_cast<int>(integer_power(N, D)) / N;

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
    for (int a = 1; a < D; ++a)  // The first of the longest.
      if (std::abs(path[a]) > std::abs(path[axis])) axis = a;
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
    beam.free_end = cut ? Vector<D>(origin + t_free * path) : endpoint;
    beam.inverse = inverse;
    beam.range = cut ? static_cast<float>(t_free * range) : length;
    const auto metres = static_cast<double>(beam.range);
    const double noise = range_sigma >= 0.0
                             ? range_sigma
                             : options_.range_sigma + options_.range_sigma_quadratic * metres * metres;
    beam.sigma = static_cast<float>(noise);
    beam.reach = returned ? static_cast<float>(metres + 3.0 * noise) : beam.range;
    beam.clear = returned ? static_cast<float>(sensor_.clearly_free_until(metres, noise)) : beam.range;
    beam.surface = returned ? static_cast<float>(5.0 / 3.0) * beam.sigma : 0.0f;
    beam.slant = depth / length;
    beam.returned = returned;
    beam.face = face;
    beam.chance = chance_of<D>(displacement);
    beams_.push_back(beam);
  }

  /// The bins of a face are squares of one beam each in the mean, over the part of it that beams go through.
  void measure_faces() {
    faces_.clear();
    for (const FlatBeam& beam : beams_) {
      const auto [found, is_new] = faces_.emplace(beam.face, Face{});
      Face& face = found->second;
      ++face.beams;
      for (std::size_t a = 0; a < D; ++a) {
        const float place = static_cast<float>(beam.path[static_cast<int>(a)]) /
                            static_cast<float>(beam.path.cwiseAbs().maxCoeff());
        face.lower[a] = is_new ? place : std::min(face.lower[a], place);
        face.upper[a] = is_new ? place : std::max(face.upper[a], place);
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
        face.places[a] = static_cast<float>(
            1.0 +
            std::floor((static_cast<double>(face.upper[a]) - static_cast<double>(face.lower[a])) / width));
    }
  }
  /// Places of the beam's face that a cube at the cell's centre covers.
  [[nodiscard]] float places_of(const FlatBeam& beam, const CellIndex<D>& index, float size) const {
    const Face& face = faces_.at(beam.face);
    const auto axis = static_cast<std::size_t>(beam.face[D]);
    const double lower = border(index.lower[axis]);
    const double upper = border(index.lower[axis] + edge(index.level));
    const double centre = 0.5 * (lower + upper) - beam.origin[static_cast<int>(axis)];
    const auto depth = static_cast<float>(std::max(0.5 * (upper - lower), std::abs(centre)));
    float places = 1.0f;
    for (std::size_t a = 0; a < D; ++a)
      if (a != axis) places *= std::min(size * face.density / depth, face.places[a]);
    return places;
  }
  /// Of the beams of the beam's face, those that count; of one that is alone there, all.
  [[nodiscard]] float share_of(const FlatBeam& beam, const CellIndex<D>& index, double sample_beams) const {
    if (faces_.at(beam.face).beams == 1) return 1.0f;
    return static_cast<float>(sample_beams) / places_of(beam, index, static_cast<float>(smallest()));
  }
  [[nodiscard]] bool is_in_sample(const FlatBeam& beam, const CellIndex<D>& index,
                                  double sample_beams) const {
    const float share = share_of(beam, index, sample_beams);
    return share >= 1.0f || static_cast<float>(beam.chance) / 16777216.0f < share;
  }
  [[nodiscard]] double smallest() const {
    return static_cast<double>(edge(-num_levels_)) * options_.min_cell_size;
  }
  /// Cells that know much take fewer beams, unless they know of free space only and too many end there.
  [[nodiscard]] double sample_beams_of(const CellIndex<D>& index, const EvidenceCell& cell) const {
    const bool is_known = static_cast<double>(cell.occupied_evidence() + cell.free_evidence()) >=
                          std::floor(options_.known_evidence * 256.0 + 0.5);
    const double learning = 4.0 * options_.sample_beams;
    std::map<std::array<double, D + 2>, std::pair<int, float>>
        ends;  // Of each face, and beams expected there.
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
                     : std::max(1.0f, std::min(1.0f, share_of(beam, index, learning)) *
                                          places_of(beam, index, size_of(index)));
    }
    double blocked = 0.0;
    for (const auto& [face, of_face] : ends) blocked += of_face.first / static_cast<double>(of_face.second);
    const bool contradicted = model_.is_settled(cell) && blocked > options_.hit_given_free;
    return (is_known && !contradicted ? 1.0 : 4.0) * options_.sample_beams;
  }

  struct Coverage {
    bool enough = true;
    bool splits = false;
    std::uint32_t parts = 0;
  };
  /// Which of the 2^D parts of a cell, up to 16 of them, a child lies in.
  [[nodiscard]] int part_of(const CellIndex<D>& child, const CellIndex<D>& parent) const {
    int part = 0;
    for (std::size_t a = 0; a < static_cast<std::size_t>(std::min(D, 4)); ++a)
      if (2 * (child.lower[a] - parent.lower[a]) >= edge(parent.level)) part += 1 << a;
    return part;
  }
  /// What was seen of a cell that was not seen enough of before.
  [[nodiscard]] Coverage coverage_of(const CellIndex<D>& index, const EvidenceCell& cell,
                                     const ScanEvidence& scan, double sample_beams) const {
    Coverage result;
    if (options_.covered_share == 0.0 || cell.observed() || index.level == -num_levels_ || scan.beams == 0 ||
        scan.hits > 0 || scan.occupied > 0)
      return result;
    const double size = static_cast<double>(edge(index.level)) * options_.min_cell_size;
    const auto children = children_of<N, D>(index, edge(index.level - 1));
    const float per_child = 1.0f / size_of(children.front());
    constexpr float kUnits = 1 << 20;
    const auto across = [](float width) {
      float area = 1.0f;
      for (int a = 1; a < D; ++a) area *= width;
      return area;
    };
    std::vector<double> seen(children.size(), 0.0);  // In kUnits.
    double all = 0.0;
    double wide = 0.0;
    double way = 0.0;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, index, sample_beams)) continue;
      const Face& face = faces_.at(beam.face);
      const float share = std::min(1.0f, share_of(beam, index, sample_beams));
      const float widening = D < 2    ? 1.0f
                             : D == 2 ? 1.0f / share
                             : D == 3 ? 1.0f / std::sqrt(share)
                                      : std::pow(share, -1.0f / static_cast<float>(D - 1));
      for (std::size_t j = 0; j < children.size(); ++j) {
        if (!clip(beam, children[j], enter, exit) || enter >= beam.range) continue;
        exit = std::min(exit, beam.range);
        const float width = face.beams == 1
                                ? static_cast<float>(smallest()) * per_child
                                : 0.5f * (enter + exit) * beam.slant *
                                      (std::min(0.1f, 1.0f / face.density) * widening * per_child);
        const float chord = (exit - enter) * beam.slant * per_child * kUnits;
        seen[j] += static_cast<double>(std::nearbyint(chord * across(std::min(1.0f, width))));
        wide += static_cast<double>(std::nearbyint(chord * across(std::min(static_cast<float>(N), width))));
        way += static_cast<double>(std::nearbyint(chord));
      }
    }
    for (const double child : seen) all += child;
    const double least = std::min(0.25, 1.0 - std::sqrt(2.0 / (all > 0.0 ? way / all : 0.0)));
    const double smallest_cells = size / smallest();
    if (cell.is_partly_seen()) result.parts = cell.seen_parts();
    const auto seen_before = [before = result.parts](int part) { return (before & 1u << part) != 0; };
    std::map<int, std::pair<double, int>> parts;
    for (std::size_t j = 0; j < children.size(); ++j) {
      auto& [of_part, count] = parts[part_of(children[j], index)];
      of_part += std::min(1.0, seen[j] / static_cast<double>(kUnits));
      ++count;
      if (seen[j] / static_cast<double>(kUnits) < least && !seen_before(part_of(children[j], index)) &&
          smallest_cells > options_.coverage_cells * (1.0 + 1e-9))
        result.splits = true;
    }
    int seen_children = 0;
    for (const auto& [part, of_part] : parts) {
      if (of_part.first >= (1.0 - 1e-4) * 0.25 * of_part.second) result.parts |= 1u << part;
      if ((result.parts & 1u << part) != 0) seen_children += of_part.second;
    }
    double enough = (1.0 - 1e-4) * options_.covered_share;
    for (int a = 0; a < D; ++a) enough *= 1.0 - 1.0 / smallest_cells;
    const auto count = static_cast<double>(children.size());
    result.enough = !result.splits &&
                    std::max(wide / static_cast<double>(kUnits) / count, seen_children / count) >= enough;
    return result;
  }

  [[nodiscard]] bool splits_now(const EvidenceCell& cell, const ScanEvidence& scan) const {
    if (cell.log_odds() < 0.0f) return scan.resolvable_hits > 0;
    if (cell.log_odds() == 0.0f) return scan.deep_hits > 0;
    return (scan.resolvable_misses > 0 || scan.deep_hits > 0) &&
           partial_occupancy_(cell.hits() + scan.hits, cell.misses() + scan.misses + scan.deep_hits).partial >
               options_.split_probability;
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
  [[nodiscard]] bool contains(const CellIndex<D>& cell, const Vector<D>& point) const {
    for (int a = 0; a < D; ++a) {
      const std::int64_t lower = cell.lower[static_cast<std::size_t>(a)];
      if (point[a] < border(lower) || point[a] >= border(lower + edge(cell.level))) return false;
    }
    return true;
  }
  /// @returns whether the beam crosses the cell over more than a point of (0, reach), as floats have it.
  [[nodiscard]] bool clip(const FlatBeam& beam, const CellIndex<D>& index, float& enter, float& exit) const {
    enter = 0.0f;
    exit = beam.reach;
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
  /// The same in double.
  [[nodiscard]] bool is_crossed(const FlatBeam& beam, const CellIndex<D>& index) const {
    double enter = 0.0;
    double exit = HUGE_VAL;
    for (int a = 0; a < D; ++a) {
      const std::int64_t lower = index.lower[static_cast<std::size_t>(a)];
      const double to_lower = border(lower) - beam.origin[a];
      const double to_upper = border(lower + edge(index.level)) - beam.origin[a];
      if (beam.path[a] == 0.0) {
        if (to_lower > 0.0 || to_upper <= 0.0) return false;
        continue;
      }
      enter = std::max(enter, std::min(to_lower / beam.path[a], to_upper / beam.path[a]));
      exit = std::min(exit, std::max(to_lower / beam.path[a], to_upper / beam.path[a]));
    }
    return enter < exit;
  }
  /// Beams of a parent's sample that cross a cell; only those that passed it, which it is clearly before the
  /// end of, or all.
  [[nodiscard]] std::size_t num_beams(const CellIndex<D>& index, bool passed, const CellIndex<D>& parent,
                                      double sample_beams) const {
    std::size_t n = 0;
    for (const FlatBeam& beam : beams_) {
      float enter = 0.0f;
      float exit = 0.0f;
      if (!clip(beam, index, enter, exit) || !is_in_sample(beam, parent, sample_beams)) continue;
      n += !passed || !beam.returned || exit < beam.clear;
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
    const auto merged = merge_rule_(nodes.data(), static_cast<int>(nodes.size()), kShare);
    if (!merged) return false;
    for (const auto& child : children) cells.erase(child);
    cells[parent] = *merged;
    return true;
  }

  MapOptions options_;
  int num_levels_;
  BeamSensorModel sensor_;
  EvidenceModel model_;
  EvidenceMergeRule merge_rule_;
  PartialOccupancyModel partial_occupancy_;
  std::vector<FlatBeam> beams_;
  std::map<std::array<double, D + 2>, Face> faces_;
};

template <int D>
Scan<D> scan_of(const std::vector<Vector<D>>& origins, const std::vector<Vector<D>>& endpoints) {
  Scan<D> scan;
  scan.origins.resize(D, static_cast<Eigen::Index>(origins.size()));
  scan.endpoints.resize(D, static_cast<Eigen::Index>(endpoints.size()));
  for (std::size_t i = 0; i < origins.size(); ++i)
    scan.origins.col(static_cast<Eigen::Index>(i)) = origins[i];
  for (std::size_t i = 0; i < endpoints.size(); ++i)
    scan.endpoints.col(static_cast<Eigen::Index>(i)) = endpoints[i];
  return scan;
}

/// Beams within (-size, size), of which many come from one place and end in one wall: measured numbers, or
/// exact ones on a grid, often parallel to an axis, sometimes of no length.
template <int D>
Scan<D> random_scan(Random& random, int count, double size, double grid, double wall) {
  Scan<D> scan;
  scan.origins.resize(D, count);
  scan.endpoints.resize(D, count);
  scan.returned.resize(count);
  const auto place = [&](double x) { return grid > 0.0 ? std::round(x / grid) * grid : x; };
  for (Eigen::Index i = 0; i < count; ++i) {
    const bool from_one_place = random.chance(0.7);
    for (int a = 0; a < D; ++a) {
      scan.origins(a, i) = place(from_one_place ? -0.8 * size : random.uniform(-size, size));
      scan.endpoints(a, i) = place(random.uniform(-size, size));
      if (grid > 0.0 && random.chance(0.3)) scan.endpoints(a, i) = scan.origins(a, i);
    }
    if (random.chance(0.6)) scan.endpoints(0, i) = place(wall);
    scan.returned[i] = random.chance(0.8);
  }
  return scan;
}

template <int D>
Scan<D> shuffled(Random& random, const Scan<D>& scan) {
  Scan<D> result = scan;
  for (auto i = static_cast<int>(scan.size()) - 1; i > 0; --i) {
    const int j = random.integer(0, i);
    result.origins.col(i).swap(result.origins.col(j));
    result.endpoints.col(i).swap(result.endpoints.col(j));
    std::swap(result.returned[i], result.returned[j]);
  }
  return result;
}

/// The sum of twelve uniform numbers: nearly normal, and never beyond six.
inline double normal(Random& random) {
  double sum = -6.0;
  for (int i = 0; i < 12; ++i) sum += random.uniform();
  return sum;
}

/// A sensor in the empty room [-half, half]^D that looks in the same directions in every scan.
template <int D>
struct Room {
  Vector<D> origin;
  double half;
  std::vector<Vector<D>> directions;

  Room(Random& random, const Vector<D>& from, double half_edge, int count) : origin(from), half(half_edge) {
    for (int i = 0; i < count; ++i) {
      Vector<D> direction;
      for (int a = 0; a < D; ++a) direction[a] = normal(random);
      directions.push_back(direction.normalized());
    }
  }
  [[nodiscard]] Scan<D> scan(Random& random, double sigma) const {
    std::vector<Vector<D>> endpoints;
    for (const Vector<D>& direction : directions) {
      double range = HUGE_VAL;
      for (int a = 0; a < D; ++a)
        if (direction[a] != 0.0)
          range = std::min(range, (std::copysign(half, direction[a]) - origin[a]) / direction[a]);
      endpoints.push_back(origin + (range + sigma * normal(random)) * direction);
    }
    return scan_of<D>({origin}, endpoints);
  }
};

template <class Cells>
auto passed_of(const Cells& cells) {
  Cells observed;
  for (const auto& [index, cell] : cells)
    if (cell != EvidenceCell{}) observed.emplace(index, cell);
  return observed;
}

std::string text_of(const EvidenceCell& cell) {
  return std::to_string(cell.occupied_evidence()) + " for, " + std::to_string(cell.free_evidence()) +
         " against, " + std::to_string(cell.hits()) + " hits, " + std::to_string(cell.misses()) + " misses";
}

/// Every leaf that beams have passed, to the last unit, and the counters.
template <class Map, class Flat>
void expect_equal(const Map& map, const Flat& flat) {
  const auto leaves = passed_of(leaves_of(map.tree()));
  const auto expected = passed_of(flat.cells);
  int wrong = 0;
  for (const auto& [index, cell] : leaves) {
    const auto found = expected.find(index);
    if (found != expected.end() && found->second == cell) continue;
    if (wrong++ == 0)
      ADD_FAILURE() << "level " << index.level << " at " << index.lower[0] << " ...: " << text_of(cell)
                    << "; expected " << (found == expected.end() ? "another cell" : text_of(found->second));
  }
  EXPECT_EQ(wrong, 0);
  EXPECT_EQ(leaves.size(), expected.size());
  EXPECT_EQ(map.counters().updates, flat.updates);
  EXPECT_EQ(map.counters().splits, flat.splits);
  EXPECT_EQ(map.counters().merges, flat.merges);
}

template <class S>
class ScanUpdateOf : public ::testing::Test {};
TYPED_TEST_SUITE(ScanUpdateOf, Shapes, ShapeNames);

constexpr double kUnit = 0.25;

TYPED_TEST(ScanUpdateOf, EveryCellOfOneSizeGetsTheSumOverTheBeams) {
  NDTREE_SHAPE;
  Random random(130);
  SCOPED_TRACE(random.trace());
  struct Row {
    double range_sigma, evidence_memory, max_range;
  };
  const Row rows[] = {{0.06, 200.0, kUnlimitedRange}, {0.2, 200.0, 1.0}, {0.2, 2.0, kUnlimitedRange}};
  const int cells = D <= 2 ? 12 : D == 3 ? 6 : 4;  // From -cells to cells on each axis.
  int beams = 0;
  std::uint64_t hits = 0;
  for (const Row& row : rows)
    for (const double grid : {0.0, kUnit / 4.0}) {
      MapOptions options = spelled_out_options(kUnit, kUnit);
      options.range_sigma = row.range_sigma;
      options.evidence_memory = row.evidence_memory;
      AdaptiveMap<N, D> map(options);
      FlatScanMap<N, D> flat(options, -cells, cells);
      const double size = cells * kUnit - 3.0 * row.range_sigma - 0.01;
      for (int i = 0; i < 4; ++i) {
        const Scan<D> scan = random_scan<D>(random, 25, size, grid, 0.125);
        const std::uint64_t before = flat.updates;
        const InsertReport report = map.insert(scan, row.max_range);
        flat.insert(scan, row.max_range);
        EXPECT_EQ(report.updates, flat.updates - before);
        EXPECT_EQ(report.splits + report.merges, 0u);
        expect_equal(map, flat);
        ASSERT_NO_THROW(map.check_invariants());
        beams += 25;
      }
      for (const auto& [index, cell] : flat.cells) hits += cell.hits();
    }
  EXPECT_EQ(beams, 3 * 2 * 4 * 25);
  EXPECT_GT(hits, 100u);
}

TYPED_TEST(ScanUpdateOf, EqualsEveryCellClippedAgainstEveryBeam) {
  NDTREE_SHAPE;
  Random random(131);
  SCOPED_TRACE(random.trace());
  struct Row {
    double range_sigma, range_sigma_quadratic, noise_sigmas, merge_loss, evidence_memory, free_memory,
        scan_beams, known_evidence, sample_beams, covered_share, coverage_cells;
  };
  const Row rows[] = {
      {0.06, 0.0, 1.0, 4.0, 200.0, 200.0, 1e6, 1.0, 1e6, 0.75, 1.0},
      {0.06, 0.0, 1.0, 4.0, 200.0, 20.0, 8.0, 2.0, 0.3, 0.9, 2.0},
      {0.02, 0.0, 1.0, 4.0, 20.0, 20.0, 64.0, 50.0, 0.05, 1.0, 8.0},
      {0.06, 0.0, 1.0, 4.0, 200.0, 200.0, 1e6, 1.0, 1e6, 0.0, 2.0},
      {0.06, 0.0, 1.0, 4.0, 200.0, 2.0, 3.0, 2.0, 0.3, 0.0, 2.0},  // Free space is settled soon.
      {0.3, 0.0, 0.0, 1.0, 200.0, 20.0, 16.0, 1.0, 1e6, 0.0,
       2.0},  // Cells of all sizes are small beside the noise ...
      {0.2, 0.0, 1.5, 2.0, 20.0, 200.0, 16.0, 3.0, 0.1, 0.0, 2.0},   // ... and may not all be split.
      {0.02, 0.002, 3.0, 0.3, 5.0, 1.0, 1.0, 1.0, 0.05, 0.0, 2.0}};  // Every beam has noise of its own.
  const int levels = N == 2 ? 2 : 1;
  const double coarsest = kUnit * std::pow(N, levels);
  int scans = 0;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  std::uint64_t whole_again = 0;
  std::uint64_t sampled = 0;
  std::uint64_t for_coverage = 0;
  std::uint64_t partly_seen = 0;
  for (const Row& row : rows)
    for (const double grid : {0.0, kUnit / 4.0}) {
      MapOptions options = spelled_out_options(kUnit, coarsest);
      options.range_sigma = row.range_sigma;
      options.range_sigma_quadratic = row.range_sigma_quadratic;
      options.noise_sigmas = row.noise_sigmas;
      options.merge_loss = row.merge_loss;
      options.evidence_memory = row.evidence_memory;
      options.free_memory = row.free_memory;
      options.scan_beams = row.scan_beams;
      options.known_evidence = row.known_evidence;
      options.sample_beams = row.sample_beams;
      options.covered_share = row.covered_share;
      options.coverage_cells = row.coverage_cells;
      ASSERT_EQ(options.num_levels(N), levels);
      SCOPED_TRACE("row " + std::to_string(&row - rows) + ", grid " + std::to_string(grid));
      AdaptiveMap<N, D> map(options);
      FlatScanMap<N, D> flat(options, -2, 2);
      const double reach = 2.0 * coarsest;
      const double size =
          reach - 3.0 * (row.range_sigma + row.range_sigma_quadratic * 4.0 * D * reach * reach) - kUnit / 4.0;
      for (int i = 0; i < 12; ++i, ++scans) {  // Half-way the wall is taken away.
        Scan<D> scan = random_scan<D>(random, 30, size, grid, (i < 6 ? 0.2 : 0.9) * size);
        if (i % 4 == 3) scan.range_sigma = Eigen::ArrayXd::LinSpaced(30, 0.1, 1.0) * row.range_sigma;
        Simd::limit(i % 3 == 0 ? 1 : 8);
        map.insert(scan);
        Simd::limit(8);
        flat.insert(scan, kUnlimitedRange);
        expect_equal(map, flat);
        ASSERT_NO_THROW(map.check_invariants());
        if (this->HasFailure()) return;
      }
      splits += flat.splits;
      merges += flat.merges;
      whole_again += flat.whole_again;
      sampled += flat.sampled;
      for_coverage += flat.for_coverage;
      partly_seen += flat.partly_seen;
    }
  EXPECT_EQ(scans, 8 * 2 * 12);
  EXPECT_GE(for_coverage, D == 1 ? 0u : N == 2 ? 20u : 5u);
  EXPECT_GE(partly_seen, D == 1 ? 0u : N == 2 ? 30u : 5u);
  EXPECT_GE(splits, 30u);
  EXPECT_GE(merges, 5u);
  EXPECT_GE(whole_again, 5u);
  EXPECT_GE(sampled, D == 1 ? 0u : 1000u);
}

TYPED_TEST(ScanUpdateOf, OneHitForEachBeamThatReturned) {
  NDTREE_SHAPE;
  Random random(132);
  SCOPED_TRACE(random.trace());
  int beams = 0;
  for (int i = 0; i < 40; ++i) {
    AdaptiveMap<N, D> map(spelled_out_options(kUnit, kUnit));
    // Exact ones, that pass and end on borders, but not where a border meets another.
    Scan<D> scan = random_scan<D>(random, 10, 1.5, i % 2 == 0 ? 0.0 : kUnit / 4.0, 0.0);
    if (i % 2 != 0) scan.endpoints.bottomRows(D - 1).array() += kUnit / 3.0;
    const InsertReport report = map.insert(scan);
    std::uint64_t hits = 0;
    for_each_leaf(map.tree(), [&](const auto& leaf) { hits += leaf.cell().hits(); });
    ASSERT_EQ(hits, report.returned);
    beams += 10;
  }
  EXPECT_EQ(beams, 400);
}

TYPED_TEST(ScanUpdateOf, TheOrderOfAScansBeamsDoesNotMatter) {
  NDTREE_SHAPE;
  Random random(133);
  SCOPED_TRACE(random.trace());
  int orders = 0;
  for (const double grid : {0.0, 0.025}) {
    MapOptions options = spelled_out_options(0.1, 0.1 * N * N);
    options.evidence_memory = 20.0;
    options.covered_share = 0.75;
    AdaptiveMap<N, D> map(options);
    for (int i = 0; i < 5; ++i) {
      const Scan<D> scan = random_scan<D>(random, 80, 2.0, grid, 0.3 * i);
      AdaptiveMap<N, D> others[3] = {map, map, map};
      map.insert(scan, 3.0);
      ASSERT_NO_THROW(map.check_invariants());
      const std::string bytes = to_bytes(map);
      Scan<D> backwards = scan;
      backwards.origins = scan.origins.rowwise().reverse().eval();
      backwards.endpoints = scan.endpoints.rowwise().reverse().eval();
      backwards.returned = scan.returned.reverse().eval();
      others[0].insert(backwards, 3.0);
      others[1].insert(shuffled(random, scan), 3.0);
      others[2].insert(shuffled(random, scan), 3.0);
      for (const auto& other : others) {
        ASSERT_TRUE(to_bytes(other) == bytes);
        ++orders;
      }
    }
    EXPECT_GT(map.stats().observed_leaves, 10u);
  }
  EXPECT_EQ(orders, 30);
}

TYPED_TEST(ScanUpdateOf, AnyNumberOfThreadsGivesTheSameMap) {
  NDTREE_SHAPE;
  Random random(139);
  SCOPED_TRACE(random.trace());
  MapOptions options = spelled_out_options(0.1, 0.1 * N * N);
  options.free_memory = 5.0;
  options.sample_beams = 0.02;  // Not all beams count.
  options.covered_share = 0.75;
  AdaptiveMap<N, D> alone(options);
  AdaptiveMap<N, D> others[3] = {alone, alone, alone};
  int scans = 0;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;
  for (; scans < 4; ++scans) {
    Scan<D> scan = random_scan<D>(random, 2500, D >= 4 ? 0.8 : 2.0, 0.0, 0.3 * scans);
    if (scans % 2 == 0) scan.origins = scan.origins.leftCols(1).eval();  // All from one place.
    const InsertReport report = alone.insert(scan, 3.0, 1);
    ASSERT_NO_THROW(alone.check_invariants());
    splits += report.splits;
    merges += report.merges;
    const std::string bytes = to_bytes(alone);
    for (int i = 0; i < 3; ++i) {
      if (i == 1) Simd::limit(1);  // As machines without vectors do it.
      const InsertReport other = others[i].insert(scan, 3.0, (i + 2) * (i + 1));  // 2, 6, 12
      Simd::limit(8);
      ASSERT_TRUE(to_bytes(others[i]) == bytes);
      ASSERT_NO_THROW(others[i].check_invariants());
      EXPECT_EQ(other.updates, report.updates);
      EXPECT_EQ(other.splits, report.splits);
      EXPECT_EQ(other.merges, report.merges);
    }
  }
  EXPECT_EQ(scans, 4);
  EXPECT_GT(splits, 5u);
  AdaptiveMap<N, D> map(options);
  EXPECT_THROW(map.insert(random_scan<D>(random, 5, 1.0, 0.0, 0.3), 3.0, -1), std::invalid_argument);
  EXPECT_EQ(map.stats().nodes, 1u);
}

TYPED_TEST(ScanUpdateOf, ThreadsMayBeMoreThanCoarseCells) {
  NDTREE_SHAPE;
  Random random(140);
  SCOPED_TRACE(random.trace());
  const MapOptions options = spelled_out_options(0.5, 0.5 * N * N * N);
  AdaptiveMap<N, D> alone(options);
  AdaptiveMap<N, D> shared(options);
  for (int i = 0; i < 20; ++i) {
    Scan<D> scan = random_scan<D>(random, 20003, 0.5, 0.0, 0.0);
    scan.origins = scan.origins.leftCols(1).eval();
    alone.insert(scan, 3.0, 1);
    shared.insert(scan, 3.0, 20);
    ASSERT_TRUE(to_bytes(shared) == to_bytes(alone));
  }
}

TYPED_TEST(ScanUpdateOf, FilesHoldAllOfAMap) {
  NDTREE_SHAPE;
  Random random(134);
  SCOPED_TRACE(random.trace());
  AdaptiveMap<N, D> map(spelled_out_options(0.1, 0.1 * N * N));
  int scans = 0;
  for (; scans < 6; ++scans) {
    map.insert(random_scan<D>(random, 60, 2.0, 0.0, 0.5));
    const std::string bytes = to_bytes(map);
    AdaptiveMap<N, D> again = from_bytes<AdaptiveMap<N, D>>(bytes);
    ASSERT_TRUE(to_bytes(again) == bytes);
    ASSERT_EQ(leaves_of(again.tree()), leaves_of(map.tree()));
    ASSERT_EQ(map_file_header(bytes).refinement, "evidence");
    const Scan<D> next = random_scan<D>(random, 20, 2.0, 0.0, -0.5);
    map.insert(next);
    again.insert(next);
    ASSERT_TRUE(to_bytes(again) == to_bytes(map)) << "a loaded map goes on as the original";
  }
  EXPECT_EQ(scans, 6);
}

TYPED_TEST(ScanUpdateOf, ALongWayAndAHitSplitUnknownSpaceAtOnce) {
  NDTREE_SHAPE;
  Random random(135);
  SCOPED_TRACE(random.trace());
  const int levels = N == 2 ? 5 : N == 3 ? 3 : 2;
  int beams = 0;
  int finest = 0;
  int noisy = 0;
  int clear = 0;
  for (const double sigma : {0.002, 0.03, 0.11})
    for (const double noise_sigmas : {0.0, 1.0, 4.0})
      for (int i = 0; i < 40; ++i, ++beams) {
        MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, levels));
        options.range_sigma = sigma;
        options.noise_sigmas = noise_sigmas;
        AdaptiveMap<N, D> map(options);
        const auto& geometry = map.tree().geometry();
        const double size = geometry.cell_size(0);
        const Box<D> whole{Vector<D>::Zero(), Vector<D>::Constant(size)};
        Vector<D> from = random_point(random, whole);
        Vector<D> to = random_point(random, whole);
        while ((to - from).norm() < 0.5 * size) {
          from = random_point(random, whole);
          to = random_point(random, whole);
        }
        const double range = (to - from).norm();
        map.insert(scan_of<D>({from}, {to}));
        ASSERT_NO_THROW(map.check_invariants());

        const auto end = *map.tree().find_leaf(to);
        double way = 0.0;   // Through the cell of the end point, up to it ...
        double rest = 0.0;  // ... and from there.
        traverse_beam(map.tree(), from, Vector<D>(to - from), 0.0, 1.0 + 3.0 * sigma / range,
                      [&](const auto& leaf, double t_enter, double t_exit) {
                        if (leaf.index == end.index) {
                          way = (1.0 - t_enter) * range;
                          rest = (t_exit - 1.0) * range;
                        }
                        // F(exit + 5/3) < probability_min = 0.4, by a margin.
                        if ((t_exit - 1.0) * range < -1.93 * sigma) {
                          EXPECT_EQ(leaf.cell().state(), CellState::free) << text_of(leaf.cell());
                        }
                      });
        if (way > 0.5 * sigma &&
            rest > 0.5 * sigma) {  // F(0.5) - F(-0.5) / 2 = 0.54: more occupied than not.
          EXPECT_EQ(end.cell().state(), CellState::occupied);
          ++clear;
        }
        // As fine as possible, as the noise allows, or as the hit asks for. On a line all siblings can join.
        const double end_size = geometry.cell_size(end.index.level);
        const bool is_finest = end.index.level == geometry.finest_level();
        const bool is_noisy = end_size / N < noise_sigmas * sigma;
        const bool is_shallow = end_size <= 3.0 * sigma && way <= 3.0 * sigma;
        EXPECT_TRUE(D == 1 || is_finest || is_noisy || is_shallow) << end_size << ", way " << way;
        EXPECT_TRUE(D == 1 || is_noisy || end.index.level < 0);
        EXPECT_EQ(map.counters().splits, static_cast<std::uint64_t>(-end.index.level));
        finest += is_finest;
        noisy += !is_finest && is_noisy;
        for_each_leaf(map.tree(), [&](const auto& leaf) {
          EXPECT_TRUE(leaf.index.level >= 0 || geometry.cell_size(leaf.index.level) >= noise_sigmas * sigma);
        });
        if (this->HasFailure()) return;
      }
  EXPECT_EQ(beams, 3 * 3 * 40);
  EXPECT_GT(finest, 40);
  EXPECT_GT(noisy, 40);
  EXPECT_GT(clear, 200);
}

TYPED_TEST(ScanUpdateOf, NothingIsOccupiedWithoutAHitNearby) {
  NDTREE_SHAPE;
  Random random(136);
  SCOPED_TRACE(random.trace());
  int occupied = 0;
  int worlds = 0;
  for (; worlds < 12; ++worlds) {
    MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, N == 2 ? 4 : 2));
    options.range_sigma = random.uniform(0.01, 0.1);
    options.range_sigma_quadratic = worlds % 3 == 2 ? 0.03 : 0.0;
    options.noise_sigmas = worlds % 4 == 0 ? 1.0 : 4.0;
    AdaptiveMap<N, D> map(options);
    const Room<D> room(random, Vector<D>::Constant(random.uniform(-0.5, 0.5)), 1.51, 50);
    std::vector<std::pair<Vector<D>, double>> ends;  // With three standard deviations.
    for (int i = 0; i < 10; ++i) {
      const Scan<D> scan = worlds % 2 == 0 ? room.scan(random, options.range_sigma)
                                           : random_scan<D>(random, 50, 2.0, 0.0, i < 6 ? 0.5 : 1.9);
      map.insert(scan);
      for (Eigen::Index k = 0; k < scan.size(); ++k) {
        if (scan.returned.size() != 0 && !scan.returned[k]) continue;
        const auto origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : k);
        const double squared_range = (scan.endpoints.col(k) - origin).squaredNorm();
        ends.emplace_back(scan.endpoints.col(k),
                          3.0 * (options.range_sigma + options.range_sigma_quadratic * squared_range));
      }
    }
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      if (leaf.cell().state() != CellState::occupied) return;
      const Box<D> box = map.tree().box(leaf.index);
      const double size = map.tree().geometry().cell_size(leaf.index.level);
      EXPECT_TRUE(std::any_of(
          ends.begin(), ends.end(),
          [&](const auto& end) { return std::sqrt(box.squared_distance(end.first)) <= end.second + size; }))
          << "level " << leaf.index.level << ", " << text_of(leaf.cell());
      ++occupied;
    });
  }
  EXPECT_EQ(worlds, 12);
  EXPECT_GT(occupied, 30);
}

TYPED_TEST(ScanUpdateOf, StationaryInputSettles) {
  NDTREE_SHAPE;
  Random random(137);
  SCOPED_TRACE(random.trace());
  const int count = D == 1 ? 2 : 200;
  int scans = 0;
  for (const bool noisy : {false, true}) {
    MapOptions options = spelled_out_options(0.05, 0.05 * std::pow(N, N == 2 ? 4 : 2));
    options.range_sigma = 0.03;
    AdaptiveMap<N, D> map(options);
    const Room<D> room(random, Vector<D>::Constant(0.13), 1.01, count);
    const Scan<D> first = room.scan(random, options.range_sigma);
    std::uint64_t in_second_half = 0;
    std::uint64_t changes = 0;
    for (int i = 0; i < 240; ++i, ++scans) {
      const InsertReport report = map.insert(noisy ? room.scan(random, options.range_sigma) : first);
      changes += report.splits + report.merges;
      if (i >= 120) in_second_half += report.splits + report.merges;
    }
    const MapStats stats = map.stats();
    EXPECT_GT(changes, 0u);
    EXPECT_LE(changes, 60 + 2 * stats.observed_leaves);
    // In 120 scans, fifteen and of a hundred cells two. Noise moves end points between cells: forty.
    const double share = noisy ? 0.4 : 0.02;
    EXPECT_LE(static_cast<double>(in_second_half), 15.0 + share * static_cast<double>(stats.observed_leaves));
  }
  EXPECT_EQ(scans, 480);
}

TYPED_TEST(ScanUpdateOf, ChildrenKnowWhatTheirParentKnew) {
  NDTREE_SHAPE;
  Random random(138);
  SCOPED_TRACE(random.trace());
  const int levels = N == 2 ? 3 : 2;
  const double size = 0.05 * std::pow(N, levels);
  MapOptions options = spelled_out_options(0.05, size);
  options.range_sigma = 0.005;
  AdaptiveMap<N, D> map(options);
  const Box<D> whole{Vector<D>::Zero(), Vector<D>::Constant(size)};
  std::vector<Vector<D>> origins;
  std::vector<Vector<D>> endpoints;
  for (int i = 0; i < 120; ++i) {  // Through the whole cell, without a hit in it.
    origins.push_back(random_point(random, whole));
    origins.back()[0] = -0.5 * size;
    endpoints.push_back(origins.back());
    endpoints.back()[0] = 2.5 * size;
  }
  map.insert(scan_of<D>(origins, endpoints));
  const Vector<D> middle = Vector<D>::Constant(0.5 * size);
  const auto before = *map.tree().find_leaf(middle);
  ASSERT_EQ(before.index, CellIndex<D>{});
  const EvidenceCell coarse = before.cell();
  ASSERT_EQ(coarse.misses(), 120u);
  ASSERT_EQ(coarse.state(), CellState::free);

  Vector<D> from = Vector<D>::Constant(0.02);  // Along the first row of cells, into the last.
  from[0] = -0.02;
  Vector<D> hit = from;
  hit[0] = size - 0.02;
  map.insert(scan_of<D>({from}, std::vector<Vector<D>>(10, hit)));
  EXPECT_EQ(map.tree().geometry().cell_size(map.tree().find_leaf(hit)->index.level), options.min_cell_size);
  int cases = 0;
  int unvisited = 0;
  for_each_leaf_in(map.tree(), whole, [&](const auto& leaf) {
    const Box<D> box = map.tree().box(leaf.index);
    if (!whole.contains(box.lower)) return;
    ++cases;
    if (box.squared_distance(hit) > 0.0) {
      EXPECT_NE(leaf.cell().state(), CellState::occupied) << text_of(leaf.cell());
    }
    bool crossed = true;
    for (int a = 1; a < D; ++a) crossed = crossed && box.lower[a] == 0.0;
    if (crossed) {
      EXPECT_TRUE(leaf.cell().observed());
      return;
    }
    ++unvisited;
    // None of ten beams came here, nor passed the parent's siblings, in which they ended.
    const double mean = 1.0 / static_cast<double>(integer_power(N, D - 1));
    const double share = 0.05 * mean + 0.95 * (0.0 + 2.0 * mean) / (10.0 + 2.0);
    auto evidence = static_cast<double>(coarse.free_evidence());
    auto misses = static_cast<double>(coarse.misses());
    for (int level = 0; level > leaf.index.level; --level) {
      evidence = std::floor(evidence * share);
      misses = std::floor(misses * share);
    }
    EXPECT_EQ(leaf.cell().observed(), evidence >= 104.0) << evidence;  // Of one beam.
    if (!leaf.cell().observed()) return;
    EXPECT_EQ(leaf.cell().state(), CellState::free) << text_of(leaf.cell());
    EXPECT_NEAR(static_cast<double>(leaf.cell().free_evidence()), evidence, 2.0);  // Rounded at each level.
    EXPECT_EQ(leaf.cell().occupied_evidence(), 0);
    EXPECT_NEAR(leaf.cell().misses(), misses, 2.0);
  });
  EXPECT_GT(cases, 3);
  EXPECT_EQ(unvisited == 0, D == 1);
}

/// The end point where two or more borders meet belongs to one cell, though the beam may only touch it.
TEST(ScanUpdate, EndPointsOnCornersCountOneHit) {
  struct Row {
    Vector<2> origin;
    Vector<2> endpoint;
  };
  const Row rows[] = {{{0.25, 0.25}, {1.0, 1.0}}, {{1.75, 1.75}, {1.0, 1.0}}, {{1.75, 1.0}, {1.0, 1.0}},
                      {{1.0, 0.25}, {1.0, 1.0}},  {{0.25, 1.75}, {1.0, 1.0}}, {{1.75, 0.25}, {1.0, 1.0}}};
  int cases = 0;
  for (const Row& row : rows) {
    SCOPED_TRACE(cases);
    AdaptiveMap<2, 2> map(spelled_out_options(0.5, 0.5));
    map.insert(scan_of<2>({row.origin}, {row.endpoint}));
    std::uint32_t hits = 0;
    for_each_leaf(map.tree(), [&](const auto& leaf) { hits += leaf.cell().hits(); });
    EXPECT_EQ(hits, 1u);
    ++cases;
  }
  EXPECT_EQ(cases, 6);
}

}  // namespace
}  // namespace ndtree::test::test_scan_update
