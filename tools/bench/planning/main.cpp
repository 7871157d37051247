// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Paths of a ball between random places, beside A* and Lazy Theta* over the grid of smallest cells.
///
/// usage: ndtree-bench-planning MAP [--radius M] [--unknown blocked|free] [--pairs N] [--seed S] [--greed G]
/// [--no-grid] [--expanded FILE]
///
/// MAP is an OctoMap file, or an adaptive .ndt. Pairs are drawn by volume among the places of one
/// connected part of the free space. All searches ask the same free space, which is built before they are
/// timed, but for the first question of a planner, `cold`. Times are of the processor. Paths of the grids are
/// not pulled tight. FILE gets the cells that the first pair's searches looked at, for a picture: a line
/// each, of the search, the lower corner and the edge [m]: draw_expanded.py draws them.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <ctime>
#include <exception>
#include <limits>
#include <random>
#include <string>
#include <unordered_map>
#include <vector>

#include "grid_search.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/io/octomap_file.hpp"
#include "ndtree/ndtree.hpp"

namespace {

using namespace ndtree;

struct Call {
  std::string map;
  double radius = 0.35;
  std::string unknown = "blocked";
  int pairs = 60;
  std::uint64_t seed = 1;
  double greed = PlannerOptions().greed;
  bool has_grid = true;
  std::string expanded;
};

double milliseconds() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) * 1e3 + static_cast<double>(now.tv_nsec) * 1e-6;
}
double quantile(std::vector<double> values, double share) {
  if (values.empty()) return std::nan("");
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1,
                         static_cast<std::size_t>(share * static_cast<double>(values.size())))];
}

/// What one way of searching took, by pair.
struct Column {
  std::string name;
  std::vector<double> time, length, expanded;
};

/// Draws pairs of places that are connected.
template <class Map>
class Pairs {
 public:
  static constexpr int D = Map::kDim;

  Pairs(FreeSpace<Map>& space, double unit, std::uint64_t seed) : unit_(unit), random_(seed) {
    std::unordered_map<std::uint64_t, std::size_t> places;
    space.for_each_in(space.limits(), [&](const PlaceCell<D>& cell) {
      places[cell.number] = cells_.size();
      cells_.push_back(cell);
    });
    parts_.assign(cells_.size(), 0);
    std::vector<std::size_t> open;
    for (std::size_t first = 0; first < cells_.size(); ++first) {
      if (parts_[first] != 0) continue;
      parts_[first] = ++count_;
      open.push_back(first);
      while (!open.empty()) {
        const std::size_t at = open.back();
        open.pop_back();
        space.for_each_beside(cells_[at], [&](const PlaceCell<D>& cell) {
          const std::size_t beside = places[cell.number];
          if (parts_[beside] != 0) return;
          parts_[beside] = count_;
          open.push_back(beside);
        });
      }
    }
    double sum = 0.0;
    for (const PlaceCell<D>& cell : cells_)
      sums_.push_back(sum += std::pow(static_cast<double>(cell.edge), D));
  }
  [[nodiscard]] std::size_t cells() const { return cells_.size(); }
  [[nodiscard]] std::uint32_t parts() const { return count_; }
  std::pair<Vector<D>, Vector<D>> draw() {
    const std::size_t start = draw_cell();
    std::size_t goal = draw_cell();
    while (parts_[goal] != parts_[start]) goal = draw_cell();
    return {point_in(cells_[start]), point_in(cells_[goal])};
  }

 private:
  double uniform() { return static_cast<double>(random_() >> 11) * 0x1p-53; }
  std::size_t draw_cell() {
    const auto found = std::upper_bound(sums_.begin(), sums_.end(), uniform() * sums_.back());
    return std::min(static_cast<std::size_t>(found - sums_.begin()), cells_.size() - 1);
  }
  Vector<D> point_in(const PlaceCell<D>& cell) {
    Vector<D> point;
    for (int a = 0; a < D; ++a)
      point[a] = unit_ * (static_cast<double>(cell.lower[static_cast<std::size_t>(a)]) +
                          static_cast<double>(cell.edge) * uniform());
    return point;
  }

  double unit_;
  std::mt19937_64 random_;
  std::vector<PlaceCell<D>> cells_;
  std::vector<std::uint32_t> parts_;
  std::uint32_t count_ = 0;
  std::vector<double> sums_;
};

/// Writes cells that searches looked at.
class CellsFile {
 public:
  CellsFile(const std::string& path, double unit)
      : file_(path.empty() ? nullptr : std::fopen(path.c_str(), "w")), unit_(unit) {}
  CellsFile(const CellsFile&) = delete;
  CellsFile& operator=(const CellsFile&) = delete;
  ~CellsFile() { close(); }
  template <int D>
  void add(const char* search, const PlaceCell<D>& cell) {
    if (file_ == nullptr) return;
    std::fprintf(file_, "%s", search);
    for (const std::int64_t x : cell.lower) std::fprintf(file_, " %.9g", static_cast<double>(x) * unit_);
    std::fprintf(file_, " %.9g\n", static_cast<double>(cell.edge) * unit_);
  }
  template <int D>
  void add(const std::vector<Vector<D>>& path) {
    for (const Vector<D>& point : path) {
      if (file_ == nullptr) return;
      std::fprintf(file_, "path");
      for (int a = 0; a < D; ++a) std::fprintf(file_, " %.9g", point[a]);
      std::fprintf(file_, " 0\n");
    }
  }
  void close() {
    if (file_ != nullptr) std::fclose(file_);
    file_ = nullptr;
  }

 private:
  std::FILE* file_;
  double unit_;
};

/// What the planner's first two searches look at: coarse cells of all places where the body may be free, from
/// the goal, and those in which it is free wherever it stands.
template <class Map>
void add_expanded(CellsFile& file, const Map& map, const Body<Map::kDim>& body, FreeSpace<Map>& sure,
                  double unknown_cost, const Vector<Map::kDim>& start, const Vector<Map::kDim>& goal) {
  constexpr int D = Map::kDim;
  FreeSpace<Map> possible(map, body, unknown_cost, *bounds(map),
                          D == 2 ? detail::Touches::from_each : detail::Touches::from_centre);
  const auto anchor = [&](const Vector<D>& at) {
    return detail::Anchor<D>{at, sure.cell_at(detail::cell_ahead<D>(at, Vector<D>::Zero()))};
  };
  const auto never = std::chrono::steady_clock::time_point::max();
  detail::CoarseGuide<Map> guide(possible, 1.0);
  (void)guide.run({anchor(start)}, {anchor(goal)}, start, never);
  guide.for_each_expanded([&](const PlaceCell<D>& cell) { file.add("coarse", cell); });
  detail::PathSearch<FreeSpace<Map>, detail::CoarseGuide<Map>> search(sure, 1.0, PlannerOptions().greed,
                                                                      &guide);
  search.add_start(anchor(start));
  search.add_goal(anchor(goal));
  (void)search.run(goal, never);
  search.for_each_expanded([&](const PlaceCell<D>& cell) { file.add("planner", cell); });
}

template <class Map>
int run(const Map& map, const Call& call) {
  constexpr int D = Map::kDim;
  const double unit = map.tree().geometry().unit();
  const Body<D> body{Capsule<D>{Vector<D>::Zero(), Vector<D>::Zero(), call.radius}};
  PlannerOptions options;
  options.greed = call.greed;
  if (call.unknown == "free") options.unknown_cost = 1.0;
  Planner<Map> planner(map, body, options);
  FreeSpace<Map> space(map, inflated(body, 4e-6 * unit), options.unknown_cost, *bounds(map));
  double begin = milliseconds();
  Pairs<Map> pairs(space, unit, call.seed);
  std::printf("%s, %s: %zu cells in %u parts, all built and joined in %.0f ms, %.1f MB\n", call.map.c_str(),
              call.unknown.c_str(), pairs.cells(), pairs.parts(), milliseconds() - begin,
              static_cast<double>(space.memory_bytes()) * 1e-6);
  std::vector<Column> columns{{"cold", {}, {}, {}},
                              {"warm", {}, {}, {}},
                              {"Lazy Theta*, grid", {}, {}, {}},
                              {"A*, grid", {}, {}, {}}};
  CellsFile cells(call.expanded, unit);
  std::size_t most_bytes = 0;
  std::size_t not_accepted = 0;
  for (int i = 0; i < call.pairs; ++i) {
    const auto [start, goal] = pairs.draw();
    const auto add = [](Column& column, double time, double length, std::size_t expanded) {
      column.time.push_back(time);
      column.length.push_back(length);
      column.expanded.push_back(static_cast<double>(expanded));
    };
    begin = milliseconds();
    Planner<Map> fresh(map, body, options);
    const Path<D> first = fresh.plan(start, goal);
    add(columns[0], milliseconds() - begin, first.length, first.expanded);
    (void)planner.plan(start, goal);
    begin = milliseconds();
    const Path<D> path = planner.plan(start, goal);
    add(columns[1], milliseconds() - begin, path.length, path.expanded);
    most_bytes = std::max(most_bytes, planner.memory_bytes());
    for (std::size_t k = 0; k + 1 < path.points.size(); ++k) {
      Pose<D> from, to;
      from.translation = path.points[k];
      to.translation = path.points[k + 1];
      not_accepted += collides_between(map, body, from, to, planner.unknown());
    }
    if (!call.has_grid) continue;
    begin = milliseconds();
    const GridAnswer theta = lazy_theta_on_grid(space, Vector<D>(start / unit), Vector<D>(goal / unit),
                                                [&](const PlaceCell<D>& cell) { cells.add("grid", cell); });
    add(columns[2], milliseconds() - begin, theta.length * unit, theta.expanded);
    if (i == 0) {
      add_expanded(cells, map, body, space, options.unknown_cost, Vector<D>(start / unit),
                   Vector<D>(goal / unit));
      cells.add(path.points);
      cells.close();
    }
    begin = milliseconds();
    const GridAnswer star = a_star_on_grid(space, Vector<D>(start / unit), Vector<D>(goal / unit));
    add(columns[3], milliseconds() - begin, star.length * unit, star.expanded);
  }
  std::printf("%zu segments not accepted by collides_between; planner at most %.1f MB\n", not_accepted,
              static_cast<double>(most_bytes) * 1e-6);
  std::printf("%-18s %8s %9s %9s %10s %10s %8s %8s\n", "search", "found", "ms", "95 %", "expanded", "95 %",
              "length", "95 %");
  for (const Column& column : columns) {
    if (column.time.empty()) continue;
    std::vector<double> ratios;
    for (std::size_t i = 0; i < column.length.size(); ++i) {
      double best = column.length[i];
      for (const Column& other : columns)
        if (!other.length.empty()) best = std::min(best, other.length[i]);
      if (std::isfinite(column.length[i])) ratios.push_back(column.length[i] / best);
    }
    std::printf("%-18s %4zu/%-3zu %9.2f %9.2f %10.0f %10.0f %8.4f %8.4f\n", column.name.c_str(),
                ratios.size(), column.length.size(), quantile(column.time, 0.5), quantile(column.time, 0.95),
                quantile(column.expanded, 0.5), quantile(column.expanded, 0.95), quantile(ratios, 0.5),
                quantile(ratios, 0.95));
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  Call call;
  CLI::App app("Paths of a ball between random places, beside searches over the grid of smallest cells.");
  app.add_option("MAP", call.map)->required();
  app.add_option("--radius", call.radius);
  app.add_option("--unknown", call.unknown)->check(CLI::IsMember({"blocked", "free"}));
  app.add_option("--pairs", call.pairs);
  app.add_option("--seed", call.seed);
  app.add_option("--greed", call.greed);
  app.add_flag("!--no-grid", call.has_grid);
  app.add_option("--expanded", call.expanded);
  CLI11_PARSE(app, argc, argv);
  try {
    if (is_octomap_file(read_file(call.map))) return run(load_octomap<FixedMap<2, 3>>(call.map), call);
    return map_file_header(read_file(call.map)).dim == 2 ? run(load<AdaptiveMap<2, 2>>(call.map), call)
                                                         : run(load<AdaptiveMap<2, 3>>(call.map), call);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
