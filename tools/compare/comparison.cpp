// SPDX-License-Identifier: BSD-3-Clause
#include "comparison.hpp"

#include <algorithm>
#include <iterator>
#include <map>
#include <memory>
#include <stdexcept>
#include <utility>
#include <variant>

#include "ndtree/evaluation/log_sample.hpp"
#include "ndtree/tree/visit.hpp"
#include "resident_memory.hpp"
#ifdef NDTREE_HAVE_OCTOMAP
#include "octomap_baseline.hpp"
#endif

namespace ndtree {
namespace {

/// One log and what is asked about it.
template <int D>
struct Job {
  const std::string& name;
  const std::vector<Scan<D>>& scans;
  const ComparisonOptions& options;
  const SimulatedLog<D>* simulation;  ///< Null: the log is not simulated, or not in D dimensions.

  [[nodiscard]] bool holds_out(std::size_t i) const { return is_held_out(i, options.held_out); }
};

/// What the mapped scans saw; in a simulated world, what its sensor could see from their origins.
template <int D>
SeenSpace<D> seen_space(const Job<D>& job) {
  const ComparisonOptions& options = job.options;
  std::vector<ScanView<D>> scans;
  for (std::size_t i = 0; i < job.scans.size(); ++i)
    if (!job.holds_out(i)) scans.push_back(job.scans[i].view());
  if (job.simulation == nullptr) return SeenSpace<D>(scans, options.max_range, options.claims);
  const double max_range = std::min(options.max_range, job.simulation->range.max_range);
  return SeenSpace<D>(scans, max_range, options.claims, job.simulation->world);
}

/// With one thread, for OctoMap has no more.
template <class Map, int D>
InsertReport insert_alone(Map& map, const Scan<D>& scan, double max_range) {
  return map.insert(scan, max_range, 1);
}
/// What queries need of a map: they are compiled once for several refinements.
template <int N, int D, class Cell>
const MapCells<N, D, Cell>& asked(const MapCells<N, D, Cell>& map) {
  return map;
}
#ifdef NDTREE_HAVE_OCTOMAP
const OctomapBaseline& asked(const OctomapBaseline& map) { return map; }
template <int D>
InsertReport insert_alone(OctomapBaseline& map, const Scan<D>& scan, double max_range) {
  return map.insert(scan, max_range);
}
#endif

/// All mapped scans into one map. @returns the sum of the reports.
template <class Map, int D>
InsertReport map_all(Map& map, const Job<D>& job) {
  InsertReport sum;
  for (std::size_t i = 0; i < job.scans.size(); ++i) {
    if (job.holds_out(i)) continue;
    InsertReport report;
    try {
      report = insert_alone(map, job.scans[i], job.options.max_range);
    } catch (const std::invalid_argument& error) {
      throw InputError(job.name + ": scan " + std::to_string(i) + ": " + error.what());
    }
    sum.beams += report.beams;
    sum.returned += report.returned;
    sum.not_returned += report.not_returned;
    sum.beyond_max_range += report.beyond_max_range;
    sum.invalid += report.invalid;
    sum.updates += report.updates;
    sum.seconds += report.seconds;
  }
  return sum;
}

/// Cell sizes by a number that is larger for larger cells.
using Sizes = std::map<int, CellSizeCount, std::greater<>>;

std::vector<CellSizeCount> listed(const Sizes& sizes) {
  std::vector<CellSizeCount> list;
  for (const auto& entry : sizes) list.push_back(entry.second);
  return list;
}

template <int N, int D, class Refinement, class Sensor>
void describe(const OccupancyMap<N, D, Refinement, Sensor>& map, MapResult& result) {
  const MapStats stats = map.stats();
  result.refinement = Refinement::kName;
  result.cells = stats.observed_leaves;
  result.leaves = stats.leaves;
  result.nodes = stats.nodes;
  result.updates = stats.updates;
  result.splits = stats.splits;
  result.merges = stats.merges;
  result.memory_bytes = stats.memory_bytes;
  Sizes sizes;
  for_each_leaf(map.tree(), [&](const auto& leaf) {
    CellSizeCount& count = sizes[leaf.index.level];
    count.size = map.tree().geometry().cell_size(leaf.index.level);
    count.observed += leaf.cell().observed();
    ++count.leaves;
  });
  result.cell_sizes = listed(sizes);
}

#ifdef NDTREE_HAVE_OCTOMAP
void describe(const OctomapBaseline& map, MapResult& result) {
  const OctomapStats stats = map.stats();
  switch (map.insertion()) {
    case OctomapInsertion::beam_by_beam:
      result.refinement = "insertRay";
      break;
    case OctomapInsertion::scan_at_once:
      result.refinement = "insertPointCloud, once per scan";
      break;
    case OctomapInsertion::scan_at_once_lazy:
      result.refinement = "insertPointCloud, once per scan, lazy";
      break;
    case OctomapInsertion::scan_discretized:
      result.refinement = "insertPointCloud, once per scan, lazy, one beam to a cell";
      break;
  }
  result.cells = stats.leaves_expanded;
  result.cells_pruned = stats.leaves_pruned;
  result.leaves = stats.leaves;
  result.nodes = stats.nodes;
  result.updates = stats.updates;
  result.memory_bytes = stats.memory_bytes;
  Sizes sizes;
  const OctomapLeaves leaves = map.leaves();
  for (Eigen::Index i = 0; i < leaves.size.size(); ++i) {
    CellSizeCount& count = sizes[static_cast<int>(std::lround(std::log2(leaves.size[i] / map.cell_size())))];
    count.size = leaves.size[i];
    ++count.observed;
    ++count.leaves;
  }
  result.cell_sizes = listed(sizes);
}
#endif

/// One map of the comparison, of any type.
template <int D>
struct Candidate {
  std::string name;
  std::function<std::optional<std::size_t>()> resident_bytes;
  /// All but time and resident memory.
  std::function<InsertReport(MapResult&, const SeenSpace<D>&)> measure;
  std::function<double()> seconds;
};

/// @param make makes an empty map.
template <int D, class Make>
Candidate<D> candidate(const std::string& name, const Job<D>& job, Make make) {
  Candidate<D> result;
  result.name = name;
  result.resident_bytes = [&job, make] {
    return resident_growth([&] {
      auto map = std::make_unique<decltype(make())>(make());
      map_all(*map, job);
      return map;
    });
  };
  result.measure = [&job, make](MapResult& into, const SeenSpace<D>& space) {
    auto map = make();
    const InsertReport report = map_all(map, job);
    describe(map, into);
    for (std::size_t i = 0; i < job.scans.size(); ++i)
      if (job.holds_out(i))
        evaluate(asked(map), job.scans[i].view(), job.options.max_range, into.truth, job.options.truth);
    into.claims = claims(asked(map), space);
    return report;
  };
  result.seconds = [&job, make] {
    auto map = make();
    return map_all(map, job).seconds;
  };
  return result;
}

template <int N, int D>
Candidate<D> own_candidate(const std::string& name, const Job<D>& job) {
  if (name == "adaptive") return candidate(name, job, [&job] { return AdaptiveMap<N, D>(job.options.map); });
  if (name == "paper") return candidate(name, job, [&job] { return PaperMap<N, D>(job.options.map); });
  return candidate(name, job, [&job] { return FixedMap<N, D>(job.options.map); });
}

template <int D>
Candidate<D> candidate_called(const std::string& name, const Job<D>& job) {
#ifdef NDTREE_HAVE_OCTOMAP
  const auto octomap = [&](OctomapInsertion insertion) {
    return candidate(name, job, [&job, insertion] {
      return OctomapBaseline(job.options.map.min_cell_size, job.options.map, insertion);
    });
  };
  if (name == "octomap") return octomap(OctomapInsertion::beam_by_beam);
  if (name == "octomap-scan") return octomap(OctomapInsertion::scan_at_once);
  if (name == "octomap-scan-lazy") return octomap(OctomapInsertion::scan_at_once_lazy);
  if (name == "octomap-scan-discretized") return octomap(OctomapInsertion::scan_discretized);
#endif
  if (job.options.branching == 2) return own_candidate<2, D>(name, job);
  if (job.options.branching == 3) return own_candidate<3, D>(name, job);
  return own_candidate<4, D>(name, job);
}

template <int D>
void run(const Job<D>& job, const Progress& progress, Comparison& comparison) {
  std::vector<Candidate<D>> candidates;
  for (const std::string& name : job.options.maps) candidates.push_back(candidate_called(name, job));
  comparison.maps.resize(candidates.size());

  const auto steps = static_cast<double>(candidates.size()) * (job.options.repeat + 2) + 1.0;
  double step = 0.0;
  const auto tell = [&](const std::string& what) { progress(what, step++ / steps); };

  // Memory first: a process that has freed a map already would give its pages to the next.
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    tell(candidates[i].name + ", memory");
    comparison.maps[i].resident_bytes = candidates[i].resident_bytes();
  }
  tell("what the scans saw");
  const SeenSpace<D> space = seen_space(job);
  for (std::size_t i = 0; i < candidates.size(); ++i) {
    tell(candidates[i].name + ", truth");
    comparison.maps[i].map = candidates[i].name;
    comparison.beams = candidates[i].measure(comparison.maps[i], space);
  }
  for (int r = 0; r < job.options.repeat; ++r)
    for (std::size_t i = 0; i < candidates.size(); ++i) {
      tell(candidates[i].name + ", run " + std::to_string(r + 1) + " of " +
           std::to_string(job.options.repeat));
      comparison.maps[i].seconds.push_back(candidates[i].seconds());
    }

  comparison.scans = job.scans.size();
  for (std::size_t i = 0; i < job.scans.size(); ++i) comparison.scans_mapped += !job.holds_out(i);
}

template <int D>
NoReturns judge(const std::vector<Scan<D>>& scans) {
  const std::vector<Scan<D>> sample = sample_of(scans);
  std::vector<ScanView<D>> views;
  for (const Scan<D>& scan : sample) views.push_back(scan.view());
  return judge_no_returns<FixedMap<2, D>>(views);
}

}  // namespace

void ComparisonOptions::validate() const {
  map.validate();
  truth.validate();
  claims.validate();
  require_option(branching >= 2 && branching <= 4, "branching", branching, "2, 3 or 4");
  require_option(max_range > 0.0, "max_range", max_range, "> 0 m");
  require_option(held_out != 1, "held_out", 1.0, "0, for none, or at least 2");
  require_option(repeat >= 1, "repeat", repeat, "at least 1");
  if (maps.empty()) throw std::invalid_argument("maps: must name at least one");
  for (std::size_t i = 0; i < maps.size(); ++i) {
    if (std::find(std::begin(kAllMaps), std::end(kAllMaps), maps[i]) == std::end(kAllMaps)) {
      std::string all;
      for (const char* const name : kAllMaps) all += (all.empty() ? "" : ", ") + std::string(name);
      throw std::invalid_argument("maps: '" + maps[i] + "' must be one of " + all);
    }
    if (!kHaveOctomap && maps[i].compare(0, 7, "octomap") == 0)
      throw std::invalid_argument("maps: '" + maps[i] +
                                  "' needs OctoMap, which this program was built without");
    if (std::find(maps.begin(), maps.begin() + static_cast<std::ptrdiff_t>(i), maps[i]) !=
        maps.begin() + static_cast<std::ptrdiff_t>(i))
      throw std::invalid_argument("maps: '" + maps[i] + "' must not be named twice");
  }
}

NoReturns judge_no_returns(const Log& log) {
  return std::visit([](const auto& scans) { return judge(scans); }, log.scans);
}

Comparison compare(const Log& log, const ComparisonOptions& options, const Progress& progress) {
  options.validate();
  Comparison comparison;
  comparison.log = log.name;
  comparison.dim = log.dim();
  comparison.options = options;
  if (log.dim() == 2)
    run(Job<2>{log.name, std::get<0>(log.scans), options, std::get_if<SimulatedLog<2>>(&log.simulation)},
        progress, comparison);
  else
    run(Job<3>{log.name, std::get<1>(log.scans), options, std::get_if<SimulatedLog<3>>(&log.simulation)},
        progress, comparison);
  return comparison;
}

}  // namespace ndtree
