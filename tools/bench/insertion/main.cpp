// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Inserts a log into a map, and nothing else: what tools/bench/instructions counts the instructions of.
///
/// usage: ndtree-bench-insertion (LOG | --world NAME) [--first N] [--cell M] [--sigma M] [--sigma-quadratic
/// A]
///                               [--returned-only] [--again] [--octomap]
///
/// Prints the number of beams that counted_insertion() was given, and how many of them loops take at a time.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "log_input.hpp"
#include "ndtree/ndtree.hpp"
#ifdef NDTREE_HAVE_OCTOMAP
#include "octomap_baseline.hpp"
#endif

namespace {

using namespace ndtree;

struct Arguments {
  std::string log;
  std::string world;
  std::size_t first = static_cast<std::size_t>(-1);
  MapOptions options;
  bool returned_only = false;
  bool again = false;
  bool octomap = false;
};

/// Whose instructions count: the callgrind option --toggle-collect=*counted_insertion* names it.
template <class Map, int D>
__attribute__((noinline)) void counted_insertion(Map& map, const std::vector<Scan<D>>& scans) {
  for (const Scan<D>& scan : scans) {
    if constexpr (std::is_constructible_v<Map, MapOptions>)
      map.insert(scan, kUnlimitedRange, 1);  // One thread.
    else
      map.insert(scan, kUnlimitedRange);
  }
}

template <class Map, int D>
void insert(Map map, const std::vector<Scan<D>>& scans, bool again) {
  if (again)
    for (const Scan<D>& scan : scans) map.insert(scan, kUnlimitedRange);
  counted_insertion(map, scans);
}

template <int D>
void run(const Arguments& arguments, const std::vector<Scan<D>>& scans) {
  std::size_t beams = 0;
  for (const Scan<D>& scan : scans) beams += static_cast<std::size_t>(scan.size());
  if (!arguments.octomap) {
    insert(AdaptiveMap<2, D>(arguments.options), scans, arguments.again);
  } else {
#ifdef NDTREE_HAVE_OCTOMAP
    insert(OctomapBaseline(arguments.options.min_cell_size, arguments.options,
                           OctomapInsertion::scan_at_once_lazy),
           scans, arguments.again);
#endif
  }
  std::printf("%zu %d\n", beams, Simd::width());
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("Inserts a log into a map, for tools that count instructions.");
  Arguments arguments;
  arguments.options.range_sigma = 0.005;
  app.add_option("LOG", arguments.log, "A recording");
  app.add_option("--world", arguments.world, "Instead of one: office, apartment or street");
  app.add_option("--first", arguments.first, "Scans of the log, from the first");
  app.add_option("--cell", arguments.options.min_cell_size, "Edge of the smallest cells [m]");
  app.add_option("--sigma", arguments.options.range_sigma, "Noise of a range [m]");
  app.add_option("--sigma-quadratic", arguments.options.range_sigma_quadratic, "Its growth [1/m]");
  app.add_flag("--returned-only", arguments.returned_only, "Beams without return say nothing");
  app.add_flag("--again", arguments.again, "Into the map that the log has made");
#ifdef NDTREE_HAVE_OCTOMAP
  app.add_flag("--octomap", arguments.octomap,
               "OctoMap's insertPointCloud, lazy, instead of the adaptive map");
#endif
  CLI11_PARSE(app, argc, argv);
  arguments.options.max_cell_size = 32.0 * arguments.options.min_cell_size;
  try {
    Log log = arguments.world.empty() ? read_log(arguments.log, {}, arguments.first)
                                      : simulate_log(arguments.world, {}, arguments.first);
    if (arguments.returned_only) keep_returned(log);
    std::visit([&](const auto& scans) { run(arguments, scans); }, log.scans);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "ndtree-bench-insertion: %s\n", error.what());
    return 1;
  }
  return 0;
}
