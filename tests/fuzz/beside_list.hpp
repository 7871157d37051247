// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps beside a list of cells of which each is clipped against each beam.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <type_traits>

#include "flat_map.hpp"
#include "flat_scan_map.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/tree/visit.hpp"
#include "options.hpp"
#include "target.hpp"

namespace ndtree::fuzz {

/// Beams within (-size, size), on a grid or beside it.
template <int D>
Scan<D> small_scan_from(Bytes& bytes, double size, double grid, double sigma) {
  Scan<D> scan;
  const auto beams = static_cast<Eigen::Index>(1 + bytes.below(16));
  const bool is_on_grid = bytes.flag();
  const bool has_noise = bytes.flag();
  scan.origins.resize(D, beams);
  scan.endpoints.resize(D, beams);
  scan.returned.resize(beams);
  if (has_noise) scan.range_sigma.resize(beams);
  const auto place = [&] {
    const double at = size * static_cast<double>(static_cast<std::int8_t>(bytes.byte())) / 128.0;
    return is_on_grid ? std::trunc(at / grid) * grid : at;
  };
  for (Eigen::Index i = 0; i < beams; ++i) {
    const std::uint8_t how = bytes.byte();
    const bool has_own_origin = i == 0 || (how & 2u) != 0;
    for (int a = 0; a < D; ++a) scan.origins(a, i) = has_own_origin ? place() : scan.origins(a, 0);
    for (int a = 0; a < D; ++a) scan.endpoints(a, i) = place();
    scan.returned[i] = (how & 1u) != 0;
    if (has_noise) scan.range_sigma[i] = sigma * static_cast<double>(1u + (how >> 2)) / 64.0;
  }
  return scan;
}

/// One of some numbers.
template <std::size_t K>
double one_of(Bytes& bytes, const double (&numbers)[K]) {
  return numbers[bytes.below(K)];
}

/// Evidence is exact: every leaf that has any, to the last unit, and the counters.
template <class Map>
class EvidenceBesideList {
 public:
  static constexpr int N = Map::kBranching;
  static constexpr int D = Map::kDim;

  EvidenceBesideList(const MapOptions& options, Bytes& bytes) : list_(changed(options, bytes), -2, 2) {}

  [[nodiscard]] const MapOptions& options() const { return options_; }
  void insert(const Scan<D>& scan) { list_.insert(scan, kUnlimitedRange); }
  void expect_equal(const Map& map) const {
    std::size_t known = 0;
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      if (leaf.cell() == EvidenceCell{}) return;
      ++known;
      const auto found = list_.cells.find(leaf.index);
      require(found != list_.cells.end() && found->second == leaf.cell(), "leaves are those of the list");
    });
    for (const auto& [index, cell] : list_.cells) known -= cell != EvidenceCell{};
    require(known == 0, "there are as many cells as in the list");
    require(map.counters().updates == list_.updates && map.counters().splits == list_.splits &&
                map.counters().merges == list_.merges,
            "the counters are those of the list");
  }

 private:
  const MapOptions& changed(MapOptions options, Bytes& bytes) {
    options.noise_sigmas = one_of(bytes, {1.0, 0.0, 1.5, 3.0});
    options.merge_loss = one_of(bytes, {4.0, 1.0, 0.3});
    options.evidence_memory = one_of(bytes, {200.0, 20.0, 5.0});
    options.free_memory = one_of(bytes, {200.0, 20.0, 2.0, 1.0});
    options.scan_beams = one_of(bytes, {1e6, 8.0, 1.0});
    options.known_evidence = one_of(bytes, {50.0, 2.0, 1.0});
    options.sample_beams = one_of(bytes, {1e6, 0.3, 0.05});
    options.covered_share = one_of(bytes, {0.0, 0.75, 0.9, 1.0});
    options.coverage_cells = one_of(bytes, {2.0, 1.0, 8.0});
    return options_ = options;
  }

  MapOptions options_;
  test::FlatScanMap<N, D> list_;
};

/// Beam by beam: counts are exact, log-odds but for rounding.
template <class Map>
class BeamsBesideList {
 public:
  static constexpr int N = Map::kBranching;
  static constexpr int D = Map::kDim;

  BeamsBesideList(const MapOptions& options, Bytes&)
      : options_(options), list_(options, options.num_levels(N), kIsAdaptive, -2, 2) {
    if constexpr (!kIsAdaptive) {  // The same space, all of it in smallest cells.
      const auto coarsest = static_cast<int>(std::lround(options.max_cell_size / options.min_cell_size));
      list_.cells.clear();
      for (const auto& [index, cell] :
           test::FlatMap<N, D>(options, 0, false, -2 * coarsest, 2 * coarsest).cells)
        list_.cells[CellIndex<D>{index.lower, -options.num_levels(N)}] = cell;
    }
  }

  [[nodiscard]] const MapOptions& options() const { return options_; }
  void insert(const Scan<D>& scan) {
    for (Eigen::Index i = 0; i < scan.size(); ++i)
      list_.insert(scan.origins.col(i), scan.endpoints.col(i), scan.returned[i], kUnlimitedRange);
  }
  void expect_equal(const Map& map) const {
    std::size_t observed = 0;
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      const OccupancyCell& cell = leaf.cell();
      if (!cell.observed()) return;
      ++observed;
      const auto found = list_.cells.find(leaf.index);
      require(found != list_.cells.end() && found->second.observed, "leaves are those of the list");
      require(found->second.hits == cell.hits() && found->second.misses == cell.misses(),
              "so are their counts");
      require(std::abs(found->second.log_odds - cell.log_odds()) < 1e-3f, "and their log-odds");
    });
    for (const auto& [index, cell] : list_.cells) observed -= cell.observed;
    require(observed == 0, "there are as many cells as in the list");
  }

 private:
  static constexpr bool kIsAdaptive = std::is_same_v<typename Map::RefinementType, PaperRefinement>;

  MapOptions options_;
  test::FlatMap<N, D> list_;
};

template <class Map>
void compare_with_list(Bytes& bytes) {
  constexpr bool kIsEvidence = std::is_same_v<typename Map::RefinementType, EvidenceRefinement>;
  constexpr bool kIsFixed = std::is_same_v<typename Map::RefinementType, FixedRefinement>;
  constexpr double kUnit = 0.25;
  // In four dimensions there are 4^4 coarsest cells; of a fixed map smallest ones.
  const double coarsest = kUnit * (kIsFixed && Map::kDim == 4 ? 1
                                   : Map::kBranching == 2     ? 4
                                                              : Map::kBranching);
  MapOptions options = test::spelled_out_options(kUnit, coarsest);
  options.range_sigma = one_of(bytes, {0.06, 0.02, 0.1});
  options.merge_free_below = 0.42;  // One beam is enough, so that much merges.
  options.merge_occupied_above = 0.65;
  const double sigma =
      std::max(options.range_sigma, kIsEvidence ? EvidenceRefinement::least_sigma(options) : 0.0);
  const double size = 2.0 * coarsest - 3.0 * sigma - kUnit / 8.0;
  std::conditional_t<kIsEvidence, EvidenceBesideList<Map>, BeamsBesideList<Map>> list(options, bytes);
  Map map(list.options());
  for (std::size_t scans = 1 + bytes.below(4); scans > 0; --scans) {
    Scan<Map::kDim> scan =
        small_scan_from<Map::kDim>(bytes, size, kUnit / 4.0, kIsEvidence ? options.range_sigma : 0.0);
    if (!kIsEvidence) scan.range_sigma.resize(0);
    map.insert(scan);
    map.check_invariants();
    list.insert(scan);
    list.expect_equal(map);
  }
}

}  // namespace ndtree::fuzz
