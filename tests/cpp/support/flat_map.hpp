// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The map of the paper without a tree: a list of cells, each clipped against each beam. Slow and plain.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <set>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/mapping/map_options.hpp"
#include "ndtree/tree/lattice.hpp"
#include "trees.hpp"

namespace ndtree::test {

struct Evidence {
  float log_odds = 0.0f;
  std::uint32_t hits = 0;
  std::uint32_t misses = 0;
  bool observed = false;
};

/// Cells of [first, last) level-0 cells on each axis; beams must not leave them.
template <int N, int D>
class FlatMap {
 public:
  LeafMap<D, Evidence> cells;
  std::uint64_t updates = 0;
  std::uint64_t splits = 0;
  std::uint64_t merges = 0;

  /// @param adaptive false: nothing splits or merges.
  FlatMap(const MapOptions& options, int num_levels, bool adaptive, int first, int last)
      : options_(options), num_levels_(num_levels), adaptive_(adaptive) {
    for (const auto& cell : cells_within(CellIndex<D>{}, edge(0), first, last)) cells[cell] = {};
  }

  void insert(const Vector<D>& origin, const Vector<D>& endpoint, bool returned, double max_range) {
    const Vector<D> path = endpoint - origin;
    const double range = path.norm();
    if (!std::isfinite(range) || range == 0.0) return;
    const bool cut = range > max_range;
    const double t_free = cut ? max_range / range : 1.0;
    returned = returned && !cut;
    const double sigma = options_.range_sigma + options_.range_sigma_quadratic * range * range;
    const auto crossed = crossings(origin, path, returned ? 1.0 + 3.0 * sigma / range : t_free);

    const Crossing* hit = nullptr;
    for (const Crossing& c : crossed)  // The first that goes on behind the end point.
      if (c.exit >= 1.0 + 1e-12 && (!hit || c.enter < hit->enter)) hit = &c;

    std::vector<CellIndex<D>> updated;
    for (const Crossing& c : crossed) {
      Evidence& cell = cells[c.index];
      double p = options_.probability_min;
      if (returned) {
        p = normal_cdf_of((c.exit - 1.0) * range / sigma) -
            0.5 * normal_cdf_of((c.enter - 1.0) * range / sigma);
        p = std::min(std::max(p, options_.probability_min), options_.probability_max);
        if (&c == hit) ++cell.hits;
        if (c.exit <= hit->enter) ++cell.misses;
      } else {
        ++cell.misses;
      }
      cell.log_odds += static_cast<float>(std::log(p / (1.0 - p)));
      cell.log_odds = std::max(cell.log_odds, static_cast<float>(options_.log_odds_min));
      cell.log_odds = std::min(cell.log_odds, static_cast<float>(options_.log_odds_max));
      cell.observed = true;
      ++updates;
      updated.push_back(c.index);
    }
    if (!adaptive_) return;
    std::set<CellIndex<D>, IndexLess> touched;
    for (const auto& index : updated) {
      if (index.level > -num_levels_ && contradicts(cells[index].hits, cells[index].misses)) {
        cells.erase(index);
        for (const auto& child : children_of<N, D>(index, edge(index.level - 1))) cells[child] = {};
        ++splits;
      } else {
        touched.insert(index);
      }
    }
    // Parents of what was updated, the finest first; a merged parent counts as updated.
    for (int level = -num_levels_; level < 0; ++level) {
      std::set<CellIndex<D>, IndexLess> parents;
      for (const auto& index : touched)
        if (index.level == level) parents.insert(parent_of(index));
      for (const auto& parent : parents)
        if (merge(parent)) touched.insert(parent);
    }
  }

 private:
  struct Crossing {
    CellIndex<D> index;
    double enter;
    double exit;
  };

  static double normal_cdf_of(double z) { return 0.5 * std::erfc(-z / std::sqrt(2.0)); }

  [[nodiscard]] std::int64_t edge(int level) const { return edge_above<N>(-num_levels_, level); }
  [[nodiscard]] double border(std::int64_t k) const {
    return static_cast<double>(k) * options_.min_cell_size;
  }

  /// Cells that the beam crosses over more than a point of (0, t_end).
  [[nodiscard]] std::vector<Crossing> crossings(const Vector<D>& origin, const Vector<D>& path,
                                                double t_end) const {
    std::vector<Crossing> result;
    for (const auto& [index, evidence] : cells) {
      double enter = 0.0;
      double exit = t_end;
      for (int a = 0; a < D && enter < exit; ++a) {
        const std::int64_t lower = index.lower[static_cast<std::size_t>(a)];
        const double to_lower = border(lower) - origin[a];
        const double to_upper = border(lower + edge(index.level)) - origin[a];
        if (path[a] == 0.0) {
          if (to_lower > 0.0 || to_upper <= 0.0) exit = enter;
          continue;
        }
        enter = std::max(enter, std::min(to_lower / path[a], to_upper / path[a]));
        exit = std::min(exit, std::max(to_lower / path[a], to_upper / path[a]));
      }
      if (enter < exit) result.push_back({index, enter, exit});
    }
    return result;
  }

  /// Sec. III-A, with the critical value for 0.995.
  [[nodiscard]] bool contradicts(double hits, double misses) const {
    const double n = hits + misses;
    const double misses_occ = n * options_.miss_given_occupied;
    const double hits_free = n * options_.hit_given_free;
    if (misses <= misses_occ || hits <= hits_free) return false;
    const double occ = std::pow(misses - misses_occ, 2) * (1.0 / misses_occ + 1.0 / (n - misses_occ));
    const double free = std::pow(hits - hits_free, 2) * (1.0 / hits_free + 1.0 / (n - hits_free));
    return std::min(occ, free) > 7.879438576622417;
  }

  [[nodiscard]] CellIndex<D> parent_of(CellIndex<D> cell) const {
    const std::int64_t size = edge(++cell.level);
    for (auto& lower : cell.lower) lower -= ((lower % size) + size) % size;
    return cell;
  }

  bool merge(const CellIndex<D>& parent) {
    const auto children = children_of<N, D>(parent, edge(parent.level - 1));
    bool all_free = true;
    bool all_occupied = true;
    double sum = 0.0;
    Evidence joined;
    joined.observed = true;
    for (const auto& child : children) {
      const auto found = cells.find(child);
      if (found == cells.end()) return false;
      const double p = 1.0 / (1.0 + std::exp(-static_cast<double>(found->second.log_odds)));
      all_free = all_free && p <= options_.merge_free_below;
      all_occupied = all_occupied && p >= options_.merge_occupied_above;
      sum += p;
      joined.hits += found->second.hits;
      joined.misses += found->second.misses;
    }
    if (!all_free && !all_occupied) return false;
    if (contradicts(joined.hits, joined.misses)) return false;
    const double mean = sum / static_cast<double>(children.size());
    joined.log_odds = static_cast<float>(std::log(mean / (1.0 - mean)));
    for (const auto& child : children) cells.erase(child);
    cells[parent] = joined;
    ++merges;
    return true;
  }

  MapOptions options_;
  int num_levels_;
  bool adaptive_;
};

}  // namespace ndtree::test
