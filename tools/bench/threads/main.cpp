// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What more threads than this machine has cores would gain: their tasks one after the other, timed, and
/// scheduled on paper. What cores take from each other, and what it takes to wake threads, is not in it.
///
/// usage: ndtree-bench-threads LOG [--first N] [--cell M] [--sigma M] [--sigma-quadratic A] [--repetitions N]
///
/// Each task counts with its least time of several repetitions, which do the same to the last bit.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <exception>
#include <map>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "log_input.hpp"
#include "ndtree/ndtree.hpp"

namespace {

using namespace ndtree;
using Phases = std::vector<WorkPhase>;

template <int D>
Phases phases_of(const std::vector<Scan<D>>& scans, const MapOptions& options, int workers) {
  AdaptiveMap<2, D> map(options);
  Phases all;
  for (const Scan<D>& scan : scans) {
    Workers::begin();
    map.insert(scan, kUnlimitedRange, workers);
    for (WorkPhase& phase : Workers::end()) all.push_back(std::move(phase));
  }
  return all;
}
void keep_least(Phases& least, const Phases& others) {
  for (std::size_t p = 0; p < least.size(); ++p) {
    least[p].alone = std::min(least[p].alone, others[p].alone);
    for (std::size_t t = 0; t < least[p].tasks.size(); ++t)
      least[p].tasks[t] = std::min(least[p].tasks[t], others[p].tasks[t]);
  }
}

template <int D>
void run(const std::vector<Scan<D>>& scans, const MapOptions& options, int repetitions) {
  std::map<int, Phases> least;
  for (int i = 0; i < repetitions; ++i)
    for (const int workers : {1, 2, 4, 8}) {
      const Phases phases = phases_of(scans, options, workers);
      const auto [place, is_new] = least.try_emplace(workers, phases);
      if (!is_new) keep_least(place->second, phases);
    }
  std::printf("| threads | ms | times as fast | all work, ms | one thread alone |\n|--:|--:|--:|--:|--:|\n");
  double of_one = 0.0;
  for (const auto& [workers, phases] : least) {
    double seconds = 0.0;
    double work = 0.0;
    double alone = 0.0;
    for (const WorkPhase& phase : phases) {
      seconds += phase.seconds();
      work += phase.work();
      alone += phase.alone;
    }
    if (workers == 1) of_one = seconds;
    std::printf("| %d | %.1f | %.2f | %.1f | %.0f %% |\n", workers, 1e3 * seconds, of_one / seconds,
                1e3 * work, 100.0 * alone / seconds);
  }
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app("What more threads than this machine has cores would gain.");
  std::string log;
  std::size_t first = static_cast<std::size_t>(-1);
  int repetitions = 7;
  MapOptions options;
  options.range_sigma = 0.005;
  app.add_option("LOG", log, "A recording")->required();
  app.add_option("--first", first, "Scans of the log, from the first");
  app.add_option("--cell", options.min_cell_size, "Edge of the smallest cells [m]");
  app.add_option("--sigma", options.range_sigma, "Noise of a range [m]");
  app.add_option("--sigma-quadratic", options.range_sigma_quadratic, "Its growth [1/m]");
  app.add_option("--repetitions", repetitions, "Of which the least time counts")->check(CLI::Range(1, 1000));
  CLI11_PARSE(app, argc, argv);
  options.max_cell_size = 32.0 * options.min_cell_size;
  try {
    const Log scans = read_log(log, {}, first);
    std::visit([&](const auto& of_log) { run(of_log, options, repetitions); }, scans.scans);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "ndtree-bench-threads: %s\n", error.what());
    return 1;
  }
  return 0;
}
