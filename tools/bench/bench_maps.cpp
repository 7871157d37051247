// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Insertion, queries, and files of our maps and of OctoMap, over simulated worlds and recordings.
///
/// usage: ndtree-bench [--beams N] [LOG …] [--benchmark_…]
///
/// Candidates alternate in random order; five repetitions, of which median, mean and spread are printed.
#include <benchmark/benchmark.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <memory>
#include <random>
#include <sstream>
#include <string>
#include <type_traits>
#include <utility>
#include <variant>
#include <vector>

#include "log_input.hpp"
#include "ndtree/logs/simulator.hpp"
#include "ndtree/ndtree.hpp"
#ifdef NDTREE_HAVE_OCTOMAP
#include "octomap_baseline.hpp"
#endif

namespace {

using namespace ndtree;

/// Scans of one log, few enough for the slowest candidate.
template <int D>
struct Workload {
  std::vector<Scan<D>> scans;
  std::size_t beams = 0;
  MapOptions options;
  double max_range = kUnlimitedRange;
};

/// About `beams` beams in scans spread evenly over the log, so that all of its space is in them.
template <int D>
std::shared_ptr<const Workload<D>> thin(const std::vector<Scan<D>>& scans, std::size_t beams,
                                        const MapOptions& options, double max_range) {
  auto work = std::make_shared<Workload<D>>();
  work->options = options;
  work->max_range = max_range;
  std::size_t total = 0;
  for (const auto& scan : scans) total += static_cast<std::size_t>(scan.size());
  const std::size_t step = std::max<std::size_t>(1, total / std::max<std::size_t>(1, beams));
  for (std::size_t i = 0; i < scans.size(); i += step) {
    work->beams += static_cast<std::size_t>(scans[i].size());
    work->scans.push_back(scans[i]);
  }
  return work;
}

/// One scan into a map, by this many threads.
template <class Map, int D>
InsertReport insert(Map& map, const Scan<D>& scan, double max_range, int threads) {
  return map.insert(scan, max_range, threads);
}
#ifdef NDTREE_HAVE_OCTOMAP
template <int D>
InsertReport insert(OctomapBaseline& map, const Scan<D>& scan, double max_range, int /*threads*/) {
  return map.insert(scan, max_range);
}
#endif

template <class Map, int D>
Map built(const Workload<D>& work, Map map) {
  for (const auto& scan : work.scans) insert(map, scan, work.max_range, 1);
  return map;
}

/// The same beams, each as a scan of its own.
template <int D>
std::vector<Scan<D>> beam_by_beam(const std::vector<Scan<D>>& scans) {
  std::vector<Scan<D>> beams;
  for (const auto& scan : scans)
    for (Eigen::Index i = 0; i < scan.size(); ++i) {
      Scan<D> beam;
      beam.origins = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
      beam.endpoints = scan.endpoints.col(i);
      if (scan.returned.size() != 0) beam.returned = scan.returned.segment(i, 1);
      beams.push_back(std::move(beam));
    }
  return beams;
}

/// Every k-th beam of each scan.
template <int D>
std::vector<Scan<D>> thinned(const std::vector<Scan<D>>& scans, Eigen::Index k) {
  std::vector<Scan<D>> result;
  for (const auto& scan : scans) {
    Scan<D> thin;
    const Eigen::Index n = (scan.size() + k - 1) / k;
    thin.origins = scan.origins.leftCols(1);
    thin.endpoints.resize(D, n);
    thin.returned.resize(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      thin.endpoints.col(i) = scan.endpoints.col(i * k);
      thin.returned[i] = scan.returned.size() == 0 || scan.returned[i * k];
    }
    result.push_back(std::move(thin));
  }
  return result;
}

/// A map that grows from nothing, or that knows all of it already, once an iteration; the time is that of the
/// insertions alone.
/// @param scans_of the workload's scans, or another division of its beams.
template <int D, class Make, class ScansOf>
void insertion(benchmark::State& state, const Workload<D>& work, const Make& make, bool again, int threads,
               const ScansOf& scans_of) {
  const std::vector<Scan<D>> scans = scans_of(work.scans);
  std::uint64_t beams = 0;
  for (const auto& scan : scans) beams += static_cast<std::uint64_t>(scan.size());
  std::uint64_t updates = 0;
  auto known = make(work.options);
  if (again)
    for (const auto& scan : scans) insert(known, scan, work.max_range, 1);
  for (auto _ : state) {
    auto map = known;
    double seconds = 0.0;
    updates = 0;
    for (const auto& scan : scans) {
      const InsertReport report = insert(map, scan, work.max_range, threads);
      seconds += report.seconds;
      updates += report.updates;
    }
    state.SetIterationTime(seconds);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations() * beams));
  state.counters["updates_per_beam"] = static_cast<double>(updates) / static_cast<double>(beams);
}

/// To the bytes of a file, and back.
template <int D, class Make>
void save_and_load(benchmark::State& state, const Workload<D>& work, const Make& make) {
  const auto map = built(work, make(work.options));
  using Map = std::decay_t<decltype(map)>;
  std::size_t size = 0;
  for (auto _ : state) {
    const std::string bytes = to_bytes(map);
    size = bytes.size();
    benchmark::DoNotOptimize(from_bytes<Map>(bytes).tree().num_nodes());
  }
  state.counters["file_bytes"] = static_cast<double>(size);
  state.counters["memory_bytes"] = static_cast<double>(map.memory_bytes());
}

/// Points near end points and along beams, in random order: what a planner asks about.
template <int D>
std::vector<Vector<D>> questions(const Workload<D>& work, int count) {
  std::vector<Vector<D>> points;
  std::mt19937 random(1);
  for (int i = 0; i < count; ++i) {
    const auto& scan = work.scans[random() % work.scans.size()];
    const auto beam = static_cast<Eigen::Index>(random() % static_cast<std::size_t>(scan.size()));
    const double t = static_cast<double>(random()) / 4294967296.0 * 1.1;
    points.push_back(scan.origins.col(0) + t * (scan.endpoints.col(beam) - scan.origins.col(0)));
  }
  return points;
}

template <int D, class Map, class Visit>
void for_each_state_at(const Map& map, const std::vector<Vector<D>>& points, Visit&& visit) {
  for_each_cell_at(map, points.front().data(), points.size(),
                   [&](std::size_t, const auto& cell) { visit(cell.state()); });
}
#ifdef NDTREE_HAVE_OCTOMAP
template <int D, class Visit>
void for_each_state_at(const OctomapBaseline& map, const std::vector<Vector<D>>& points, Visit&& visit) {
  for (const auto& point : points) visit(ndtree::state(map, point));
}
#endif

template <int D, class Make>
void point_queries(benchmark::State& state, const Workload<D>& work, const Make& make) {
  const auto map = built(work, make(work.options));
  const auto points = questions(work, 1000000);
  for (auto _ : state) {
    int occupied = 0;
    for_each_state_at<D>(map, points, [&](CellState one) { occupied += one == CellState::occupied; });
    benchmark::DoNotOptimize(occupied);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations() * points.size()));
}

template <int D, class Make>
void ray_casts(benchmark::State& state, const Workload<D>& work, const Make& make) {
  const auto map = built(work, make(work.options));
  const auto points = questions(work, 10000);
  const Vector<D> origin = work.scans.front().origins.col(0);
  for (auto _ : state) {
    double sum = 0.0;
    for (const auto& point : points) {
      const Vector<D> direction = point - origin;
      if (direction.allFinite() && direction.squaredNorm() > 0.0)
        sum += ndtree::cast_ray(map, origin, direction, 30.0).value_or(0.0);
    }
    benchmark::DoNotOptimize(sum);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations() * points.size()));
}

template <int D, class Make, class ScansOf>
void add_insertion(const std::string& name, const std::shared_ptr<const Workload<D>>& work, Make make,
                   bool again, int threads, ScansOf scans_of) {
  benchmark::RegisterBenchmark(
      name.c_str(), [=](benchmark::State& s) { insertion<D>(s, *work, make, again, threads, scans_of); })
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

template <int D, class Make>
void add(const std::string& log, const char* candidate, const std::shared_ptr<const Workload<D>>& work,
         Make make) {
  const auto name = [&](const char* what) { return std::string(what) + "/" + log + "/" + candidate; };
  const auto same = [](const std::vector<Scan<D>>& scans) { return scans; };
  add_insertion<D>(name("insert"), work, make, false, 1, same);
  add_insertion<D>(name("insert again"), work, make, true, 1, same);
  benchmark::RegisterBenchmark(name("state").c_str(), [=](benchmark::State& s) {
    point_queries<D>(s, *work, make);
  })->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark(name("cast_ray").c_str(), [=](benchmark::State& s) {
    ray_casts<D>(s, *work, make);
  })->Unit(benchmark::kMillisecond);
}

template <int N, int D>
void add_own(const std::string& log, const char* candidate, const std::shared_ptr<const Workload<D>>& work) {
  add<D>(log, candidate, work, [](const MapOptions& options) { return AdaptiveMap<N, D>(options); });
}

template <int D>
void add_all(const std::string& log, const std::shared_ptr<const Workload<D>>& work) {
  add_own<2, D>(log, "adaptive", work);
  const auto make = [](const MapOptions& options) { return AdaptiveMap<2, D>(options); };
  const auto same = [](const std::vector<Scan<D>>& scans) { return scans; };
  add_insertion<D>("insert/" + log + "/adaptive, 2 threads", work, make, false, 2, same);
  add_insertion<D>("insert/" + log + "/adaptive, beam by beam", work, make, false, 1, beam_by_beam<D>);
  for (const Eigen::Index k : {4, 16})
    add_insertion<D>("insert/" + log + "/adaptive, every " + std::to_string(k) + "th beam", work, make, false,
                     1, [k](const std::vector<Scan<D>>& scans) { return thinned<D>(scans, k); });
  for (const double finer : {2.0, 4.0}) {
    auto fine = std::make_shared<Workload<D>>(*work);
    fine->options.min_cell_size /= finer;
    add_insertion<D>("insert/" + log + "/adaptive, cells 1/" + std::to_string(static_cast<int>(finer)),
                     std::shared_ptr<const Workload<D>>(fine), make, false, 1, same);
  }
  benchmark::RegisterBenchmark(("save and load/" + log + "/adaptive").c_str(), [=](benchmark::State& s) {
    save_and_load<D>(s, *work, make);
  })->Unit(benchmark::kMillisecond);
  add_own<3, D>(log, "adaptive N=3", work);
  add_own<4, D>(log, "adaptive N=4", work);
  add<D>(log, "fixed", work, [](const MapOptions& options) { return FixedMap<2, D>(options); });
#ifdef NDTREE_HAVE_OCTOMAP
  add<D>(log, "OctoMap insertRay", work,
         [](const MapOptions& options) { return OctomapBaseline(options.min_cell_size, options); });
  add<D>(log, "OctoMap insertPointCloud", work, [](const MapOptions& options) {
    return OctomapBaseline(options.min_cell_size, options, OctomapInsertion::scan_at_once);
  });
  add<D>(log, "OctoMap insertPointCloud lazy", work, [](const MapOptions& options) {
    return OctomapBaseline(options.min_cell_size, options, OctomapInsertion::scan_at_once_lazy);
  });
  add<D>(log, "OctoMap insertPointCloud discretized", work, [](const MapOptions& options) {
    return OctomapBaseline(options.min_cell_size, options, OctomapInsertion::scan_discretized);
  });
#endif
}

void add_log(const Log& log, const std::string& name, std::size_t beams, const MapOptions& options,
             double max_range) {
  std::visit(
      [&](const auto& scans) {
        constexpr int D = std::decay_t<decltype(scans[0].origins)>::RowsAtCompileTime;
        add_all<D>(name, thin<D>(scans, beams, options, max_range));
      },
      log.scans);
}

}  // namespace

int main(int argc, char** argv) {
  // Google Benchmark gets what is its own, after our defaults, so that the user's settings win.
  std::vector<std::string> ours;
  std::vector<std::string> of_benchmark{argv[0], "--benchmark_repetitions=5",
                                        "--benchmark_enable_random_interleaving=true",
                                        "--benchmark_report_aggregates_only=true"};
  for (int i = 1; i < argc; ++i) {
    const std::string argument = argv[i];
    (argument.rfind("--benchmark_", 0) == 0 ? of_benchmark : ours).push_back(argument);
  }
  std::vector<char*> pointers;
  for (std::string& one : of_benchmark) pointers.push_back(one.data());
  int count = static_cast<int>(pointers.size());
  benchmark::Initialize(&count, pointers.data());

  CLI::App app(
      "Insertion and queries of adaptive, fixed and OctoMap maps; --benchmark_… options are passed on.");
  std::size_t beams = 150000;
  double max_range = kUnlimitedRange;
  std::vector<std::string> paths;
  std::string worlds = "office,apartment,street";
  MapOptions options;
  app.add_option("LOG", paths, "Recordings beside the simulated worlds")->check(CLI::ExistingFile);
  app.add_option("--world", worlds,
                 "office, apartment, street, or images of 640 x 480; with commas between; or none")
      ->capture_default_str();
  app.add_option("--beams", beams, "Beams a log, in scans spread evenly over it")->capture_default_str();
  app.add_option("--min-cell-size", options.min_cell_size, "[m]")->capture_default_str();
  app.add_option("--max-cell-size", options.max_cell_size, "[m]")->capture_default_str();
  app.add_option("--range-sigma", options.range_sigma, "[m]")->capture_default_str();
  app.add_option("--range-sigma-quadratic", options.range_sigma_quadratic, "[1/m]")->capture_default_str();
  app.add_option("--max-range", max_range, "[m]");
  try {
    std::reverse(ours.begin(), ours.end());  // As CLI11 takes them.
    app.parse(ours);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  try {
    std::istringstream names(worlds == "none" ? "" : worlds);
    for (std::string world; std::getline(names, world, ',');)
      if (world == "images") {  // Of the apartment, 640 x 480.
        SimulationOptions few;
        few.scans = 8;
        DepthCamera camera;
        camera.width = 640;
        camera.height = 480;
        const SimulatedLog<3> log = simulate_apartment(few, camera);
        std::vector<Scan<3>> scans;
        for (std::size_t i = 0; i < log.T_map_sensor.size(); ++i) scans.push_back(log.scan(i));
        add_all<3>(world, thin<3>(scans, SIZE_MAX, options, max_range));
      } else {
        add_log(simulate_log(world, {}, SIZE_MAX), world, beams, options, max_range);
      }
    for (const std::string& path : paths) {
      const std::string file = path.substr(path.find_last_of('/') + 1);
      add_log(read_log(path, {}, SIZE_MAX), file, beams, options, max_range);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "ndtree-bench: %s\n", error.what());
    return 1;
  }
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
