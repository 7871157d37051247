// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What is tried with maps of each kind: insertion of scans that no sensor measures, small scans beside a
/// list of cells, and files that no map has written. A file of this folder has the kinds of one N and D.
#pragma once

#include <Eigen/Core>
#include <array>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

#include "beside_list.hpp"
#include "layers.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/point.hpp"
#include "ndtree/query/ray.hpp"
#include "target.hpp"

namespace ndtree::fuzz {

/// Maps of one N, D and refinement.
struct MapKind {
  int branching;
  int dim;
  std::string_view refinement;
  void (*insert_scans)(Bytes&);
  void (*compare_with_list)(Bytes&);
  void (*read_map)(std::string_view, Bytes&);
};

/// Refined by evidence, as the paper has it, and fixed.
template <int N, int D>
std::array<MapKind, 3> map_kinds();

inline constexpr double kMostMemory = 6e4;

/// An option at one of its ends, somewhere between, or as it is.
inline MapOptions options_from(Bytes& bytes) {
  MapOptions options;
  options.min_cell_size = 0.05;
  options.max_cell_size = 0.8;
  for (std::size_t changes = bytes.below(4); changes > 0; --changes) {
    const OptionRow& row = kOptionTable[bytes.below(kOptionTable.size())];
    const std::size_t how = bytes.below(4);
    const double share = static_cast<double>(bytes.byte()) / 255.0;
    const double between = row.bounds.least + share * share * share * (row.bounds.most - row.bounds.least);
    options.*row.member = how == 0 ? row.bounds.least : how == 1 ? row.bounds.most : between;
  }
  options.max_memory = kMostMemory;
  return options;
}

template <int D>
Scan<D> scan_from(Bytes& bytes, double unit) {
  Scan<D> scan;
  const std::uint8_t flags = bytes.byte();
  const auto beams = static_cast<Eigen::Index>(bytes.below(20));
  const bool own_origins = (flags & 1u) != 0;
  scan.origins.resize(D, own_origins ? beams : 1);
  scan.endpoints.resize(D, beams);
  if ((flags & 2u) != 0) scan.returned.resize(beams);
  if ((flags & 4u) != 0) scan.range_sigma.resize(beams);
  for (Eigen::Index c = 0; c < scan.origins.cols(); ++c)
    for (int a = 0; a < D; ++a) scan.origins(a, c) = bytes.length(unit);
  for (Eigen::Index i = 0; i < beams; ++i) {
    for (int a = 0; a < D; ++a) scan.endpoints(a, i) = bytes.length(unit);
    if (scan.returned.size() != 0) scan.returned[i] = bytes.flag();
    if (scan.range_sigma.size() != 0) scan.range_sigma[i] = std::abs(bytes.length(0.1 * unit));
  }
  if ((flags & 0xfcu) != 0xa8u || beams == 0) return scan;
  // Enough for several threads: copies, turned a little.
  constexpr Eigen::Index kMany = 2100;
  Scan<D> many = scan;
  many.endpoints.resize(D, kMany);
  if (own_origins) many.origins.resize(D, kMany);
  if (many.returned.size() != 0) many.returned.resize(kMany);
  if (many.range_sigma.size() != 0) many.range_sigma.resize(kMany);
  for (Eigen::Index i = 0; i < kMany; ++i) {
    many.endpoints.col(i) = scan.endpoints.col(i % beams);
    many.endpoints(static_cast<int>(i) % D, i) += static_cast<double>(i / beams) * 0.37 * unit;
    if (own_origins) many.origins.col(i) = scan.origins.col(i % beams);
    if (many.returned.size() != 0) many.returned[i] = scan.returned[i % beams];
    if (many.range_sigma.size() != 0) many.range_sigma[i] = scan.range_sigma[i % beams];
  }
  return many;
}

template <class Map>
void query(const Map& map, Bytes& bytes) {
  constexpr int D = Map::kDim;
  for (int i = 0; i < 3; ++i) {
    Vector<D> point, direction;
    for (int a = 0; a < D; ++a) {
      point[a] = bytes.length(map.options().min_cell_size);
      direction[a] = bytes.length(1.0);
    }
    const double p = probability(map, point);
    require(p >= 0.0 && p <= 1.0, "probabilities lie between 0 and 1");
    accepted([&] {
      const auto hit = cast_ray(map, point, direction, 1e3);
      require(!hit || (*hit >= 0.0 && *hit <= 1e3 * (1.0 + 1e-9)), "rays end within their range");
    });
  }
}

template <class Map>
void save_and_go_on(Map& map, const Scan<Map::kDim>& scan) {
  const std::string bytes = to_bytes(map);
  Map again = from_bytes<Map>(bytes);
  require(to_bytes(again) == bytes, "what is saved and read is the same");
  const bool taken = accepted([&] { map.insert(scan, kUnlimitedRange, 1); });
  // How full its memory was is not in a file.
  if (taken && accepted([&] { again.insert(scan, kUnlimitedRange, 1); }))
    require(to_bytes(again) == to_bytes(map), "what was saved goes on as what was not");
}

template <class Map>
void insert_scans(Bytes& bytes) {
  constexpr int D = Map::kDim;
  const MapOptions options = options_from(bytes);
  accepted([&] {
    Map map(options);
    Map other = map;
    Scan<D> scan;
    const auto threads = static_cast<int>(1 + bytes.below(4));
    bool is_full = false;
    for (std::size_t scans = 1 + bytes.below(3); scans > 0 && !is_full; --scans) {
      scan = scan_from<D>(bytes, options.min_cell_size);
      const double max_range = bytes.below(3) == 0 ? bytes.length(options.min_cell_size) : kUnlimitedRange;
      const std::string before = to_bytes(map);
      const bool taken = accepted([&] {
        const InsertReport report = map.insert(scan, max_range, threads);
        require(report.beams == static_cast<std::uint64_t>(scan.size()) &&
                    report.beams ==
                        report.returned + report.not_returned + report.beyond_max_range + report.invalid,
                "every beam is counted once");
      });
      require(map.memory_bytes() <= static_cast<std::size_t>(kMostMemory) || before == to_bytes(map),
              "no map holds more than max_memory");
      require(taken || before == to_bytes(map), "a scan that is refused leaves the map as it was");
      map.check_invariants();
      if (threads == 1) continue;
      const bool other_taken = accepted([&] { other.insert(scan, max_range, 1); });
      is_full = taken != other_taken;  // Arenas of threads hold some more.
      require(is_full || to_bytes(map) == to_bytes(other), "maps are the same for any number of threads");
    }
    query(map, bytes);
    if constexpr (std::is_same_v<typename Map::RefinementType, EvidenceRefinement>) {
      if (bytes.flag()) {
        accepted([&] { map.compress({bytes.raw_double(), {}, {}}); });
        map.check_invariants();
      }
    }
    accepted([&] {
      Vector<D> lower, upper;
      for (int a = 0; a < D; ++a) {
        lower[a] = bytes.length(options.min_cell_size);
        upper[a] = bytes.length(options.min_cell_size);
      }
      bytes.flag() ? map.crop({lower, upper}) : map.clear({lower, upper});
    });
    map.check_invariants();
    save_and_go_on(map, scan);
  });
}

template <class Map>
void read_map(std::string_view bytes, Bytes& more) {
  accepted([&] {
    std::vector<StoredLayer> layers;
    Map map = from_bytes<Map>(bytes, &layers);
    map.check_invariants();
    query(map, more);
    require(to_bytes(from_bytes<Map>(to_bytes(map))) == to_bytes(map), "what is saved and read is the same");
    const Scan<Map::kDim> scan = scan_from<Map::kDim>(more, map.options().min_cell_size);
    MapOptions options = map.options();
    options.max_memory = kMostMemory;
    Map bounded(options, map.tree(), map.counters());
    accepted([&] { bounded.insert(scan, kUnlimitedRange, 1); });
    bounded.check_invariants();
    // The same code for all, but for N and D.
    if constexpr (Map::kBranching == 2 && std::is_same_v<typename Map::RefinementType, EvidenceRefinement>)
      read_layers(layers, bounded, scan, more);
  });
}

template <class Map>
MapKind map_kind() {
  return {Map::kBranching,         Map::kDim,     Map::RefinementType::kName, &insert_scans<Map>,
          &compare_with_list<Map>, &read_map<Map>};
}

/// Of each N and D that Python offers.
#define NDTREE_FUZZ_KINDS(N, D)                                                                     \
  template <>                                                                                       \
  std::array<MapKind, 3> map_kinds<N, D>() {                                                        \
    return {map_kind<AdaptiveMap<N, D>>(), map_kind<PaperMap<N, D>>(), map_kind<FixedMap<N, D>>()}; \
  }

}  // namespace ndtree::fuzz
