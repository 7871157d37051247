// SPDX-License-Identifier: BSD-3-Clause
#include "bench_growth.hpp"

#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdint>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/logs/simulator.hpp"
#include "ndtree/ndtree.hpp"

namespace ndtree {

namespace {

using Map = AdaptiveMap<2, 3>;

std::vector<Scan<3>> apartment_images(int width) {
  SimulationOptions few;
  few.scans = 8;
  DepthCamera camera;
  camera.width = width;
  camera.height = width * 3 / 4;
  const SimulatedLog<3> log = simulate_apartment(few, camera);
  std::vector<Scan<3>> scans;
  for (std::size_t i = 0; i < log.T_map_sensor.size(); ++i) scans.push_back(log.scan(i));
  return scans;
}

/// Insertion of known scans into a saturated map, by one thread.
void saturated_insertion(benchmark::State& state, Map& map, const std::vector<Scan<3>>& scans) {
  std::uint64_t beams = 0;
  for (auto _ : state) {
    double seconds = 0.0;
    for (const auto& scan : scans) {
      const InsertReport report = map.insert(scan, kUnlimitedRange, 1);
      seconds += report.seconds;
      beams += report.beams;
    }
    state.SetIterationTime(seconds);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(beams));
  state.counters["leaves"] = static_cast<double>(map.tree().num_leaves());
  state.counters["memory_bytes"] = static_cast<double>(map.memory_bytes());
}

/// A map of scans, made when it is first asked for.
class LazyMap {
 public:
  LazyMap(const MapOptions& options, std::vector<Scan<3>> scans)
      : options_(options), scans_(std::move(scans)) {}
  [[nodiscard]] const std::vector<Scan<3>>& scans() const { return scans_; }
  Map& map() {
    constexpr int kUntilSaturated = 10;
    if (!map_) {
      map_ = std::make_unique<Map>(options_);
      for (int i = 0; i < kUntilSaturated; ++i)
        for (const auto& scan : scans_) map_->insert(scan, kUnlimitedRange, 1);
    }
    return *map_;
  }

 private:
  MapOptions options_;
  std::vector<Scan<3>> scans_;
  std::unique_ptr<Map> map_;
};

void add_saturated(const std::string& name, const std::shared_ptr<LazyMap>& map) {
  benchmark::RegisterBenchmark(
      name.c_str(), [map](benchmark::State& state) { saturated_insertion(state, map->map(), map->scans()); })
      ->UseManualTime()
      ->Unit(benchmark::kMillisecond);
}

/// Rooms of 6 x 6 x 3 m without end, each seen from its middle by 10,000 beams in all directions; as many
/// as make a map of this many leaves.
class Rooms {
 public:
  Rooms(const MapOptions& options, double leaves) : options_(options), leaves_(leaves) {}

  Map& map() {
    if (map_) return *map_;
    map_ = std::make_unique<Map>(options_);
    do {
      const Scan<3> scan = scan_of(num_rooms_++);
      constexpr int kUntilSaturated = 10;
      for (int i = 0; i < kUntilSaturated; ++i) map_->insert(scan, kUnlimitedRange, 1);
    } while (static_cast<double>(map_->tree().num_leaves()) < leaves_);
    return *map_;
  }
  /// Some of the rooms' scans, drawn anew each time.
  std::vector<Scan<3>> some_scans(std::size_t count) {
    std::vector<Scan<3>> scans;
    for (std::size_t i = 0; i < count; ++i)
      scans.push_back(scan_of(random_() % static_cast<std::uint32_t>(num_rooms_)));
    return scans;
  }
  /// Points in rooms, 3 numbers each.
  std::vector<double> some_points(std::size_t count) {
    std::vector<double> points;
    for (std::size_t i = 0; i < count; ++i) {
      const Vector<3> place = origin(random_() % static_cast<std::uint32_t>(num_rooms_));
      for (int a = 0; a < 3; ++a) points.push_back(place[a] + half(a) * (uniform() * 2.1 - 1.05));
    }
    return points;
  }
  double uniform() { return static_cast<double>(random_()) / 4294967296.0; }

 private:
  static double half(int axis) { return axis == 2 ? 1.5 : 3.0; }
  /// Rooms stand in a square spiral, so that maps of all sizes are about as wide as long.
  static Vector<3> origin(std::uint64_t room) {
    std::int64_t x = 0;
    std::int64_t y = 0;
    std::int64_t dx = 1;
    std::int64_t dy = 0;
    for (std::int64_t side = 1, walked = 0, turns = 0; room > 0; --room) {
      x += dx;
      y += dy;
      if (++walked < side) continue;
      walked = 0;
      const std::int64_t before = dx;
      dx = -dy;
      dy = before;
      side += ++turns % 2 == 0;
    }
    return {7.03 * static_cast<double>(x), 7.03 * static_cast<double>(y), 1.5};
  }
  static Scan<3> scan_of(std::uint64_t room) {
    constexpr Eigen::Index kBeams = 10000;
    constexpr double kGoldenAngle = 2.399963229728653;
    Scan<3> scan;
    scan.origins = origin(room);
    scan.endpoints.resize(3, kBeams);
    std::mt19937 noise(static_cast<std::uint32_t>(room));
    for (Eigen::Index i = 0; i < kBeams; ++i) {  // Evenly over the sphere.
      const double z = 1.0 - (2.0 * static_cast<double>(i) + 1.0) / kBeams;
      const double angle = kGoldenAngle * static_cast<double>(i);
      const Vector<3> direction(std::sqrt(1.0 - z * z) * std::cos(angle),
                                std::sqrt(1.0 - z * z) * std::sin(angle), z);
      double range = HUGE_VAL;
      for (int a = 0; a < 3; ++a) range = std::min(range, half(a) / std::abs(direction[a]));
      range += 0.03 * (static_cast<double>(noise()) / 4294967296.0 - 0.5);
      scan.endpoints.col(i) = scan.origins.col(0) + range * direction;
    }
    return scan;
  }

  MapOptions options_;
  double leaves_;
  std::uint64_t num_rooms_ = 0;
  std::unique_ptr<Map> map_;
  std::mt19937 random_{1};
};

void room_insertion(benchmark::State& state, Rooms& rooms) {
  Map& map = rooms.map();
  saturated_insertion(state, map, rooms.some_scans(20));
}

void room_queries(benchmark::State& state, Rooms& rooms) {
  const Map& map = rooms.map();
  constexpr std::size_t kPoints = 1000000;
  const std::vector<double> points = rooms.some_points(kPoints);
  for (auto _ : state) {
    std::size_t occupied = 0;
    for_each_cell_at(map, points.data(), kPoints,
                     [&](std::size_t, const auto& cell) { occupied += cell.state() == CellState::occupied; });
    benchmark::DoNotOptimize(occupied);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations() * kPoints));
  state.counters["leaves"] = static_cast<double>(map.tree().num_leaves());
}

void room_casts(benchmark::State& state, Rooms& rooms) {
  const Map& map = rooms.map();
  constexpr std::size_t kRays = 20000;
  const std::vector<double> points = rooms.some_points(kRays);
  std::vector<Vector<3>> directions;
  for (std::size_t i = 0; i < kRays; ++i)
    directions.emplace_back(rooms.uniform() - 0.5, rooms.uniform() - 0.5, 0.2 * (rooms.uniform() - 0.5));
  for (auto _ : state) {
    double sum = 0.0;
    for (std::size_t i = 0; i < kRays; ++i)
      sum += cast_ray(map, Vector<3>(Eigen::Map<const Vector<3>>(points.data() + 3 * i)), directions[i], 30.0)
                 .value_or(0.0);
    benchmark::DoNotOptimize(sum);
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations() * kRays));
  state.counters["leaves"] = static_cast<double>(map.tree().num_leaves());
}

}  // namespace

void add_growth(const MapOptions& options, double most_leaves) {
  for (const int width : {80, 160, 320, 640})
    add_saturated("growth/beams of a scan/" + std::to_string(width * width * 3 / 4),
                  std::make_shared<LazyMap>(options, apartment_images(width)));
  for (const double cell_size : {0.2, 0.1, 0.05, 0.025}) {
    MapOptions other = options;
    other.min_cell_size = cell_size;
    std::string text = std::to_string(cell_size);
    text.erase(text.find_last_not_of('0') + 1);
    add_saturated("growth/cell size/" + text, std::make_shared<LazyMap>(other, apartment_images(160)));
  }
  for (double leaves = 1e5; leaves <= most_leaves; leaves *= 10.0) {
    const auto rooms = std::make_shared<Rooms>(options, leaves);
    const std::string size = std::to_string(static_cast<std::int64_t>(leaves));
    benchmark::RegisterBenchmark(("growth/insert, leaves/" + size).c_str(),
                                 [rooms](benchmark::State& state) { room_insertion(state, *rooms); })
        ->UseManualTime()
        ->Unit(benchmark::kMillisecond);
    benchmark::RegisterBenchmark(("growth/state, leaves/" + size).c_str(), [rooms](benchmark::State& state) {
      room_queries(state, *rooms);
    })->Unit(benchmark::kMillisecond);
    benchmark::RegisterBenchmark(("growth/cast_ray, leaves/" + size).c_str(), [rooms](
                                                                                  benchmark::State& state) {
      room_casts(state, *rooms);
    })->Unit(benchmark::kMillisecond);
  }
}

}  // namespace ndtree
