// SPDX-License-Identifier: BSD-3-Clause
// Insert scans, ask at points, along a ray and around a point, save and load.
#include <cmath>
#include <cstdio>
#include <ndtree/ndtree.hpp>
#include <string>

using Map = ndtree::AdaptiveMap<2, 2>;  // N = 2 children per axis, D = 2 dimensions
using Point = ndtree::Vector<2>;

/// A laser at `origin` in a square room whose walls are 3 m from (0, 0) [m].
ndtree::Scan<2> scan_of_room(const Point& origin) {
  constexpr int kBeams = 720;
  ndtree::Scan<2> scan;
  scan.origins = origin;
  scan.endpoints.resize(2, kBeams);  // One column a beam, in the map's frame.
  for (int i = 0; i < kBeams; ++i) {
    const double angle = 2.0 * 3.14159265358979 * (i + 0.5) / kBeams;
    const Point direction(std::cos(angle), std::sin(angle));
    double range = 1e9;
    for (int axis = 0; axis < 2; ++axis)
      range = std::fmin(range, (std::copysign(3.0, direction[axis]) - origin[axis]) / direction[axis]);
    scan.endpoints.col(i) = origin + range * direction;
  }
  return scan;
}

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "room.ndt";
  ndtree::MapOptions options;
  options.min_cell_size = 0.05;  // No cell gets smaller [m].
  options.range_sigma = 0.02;    // Noise of the ranges, pose errors included [m].
  Map map(options);
  ndtree::InsertReport report;
  for (int i = 0; i < 20; ++i) report = map.insert(scan_of_room(Point(0.1 * i - 1.0, 0.3)), 20.0);
  std::printf("last scan: %llu beams, %llu splits, %.1f ms\n", static_cast<unsigned long long>(report.beams),
              static_cast<unsigned long long>(report.splits), 1e3 * report.seconds);

  const bool is_free = ndtree::state(map, Point(1.0, 1.0)) == ndtree::CellState::free;
  const bool is_unknown = ndtree::state(map, Point(9.0, 9.0)) == ndtree::CellState::unknown;
  const auto ahead = ndtree::cast_ray(map, Point(0.0, 0.0), Point(1.0, 0.0), 20.0);  // [m], if anything
  const bool is_near = ndtree::occupied_within(map, Point(2.8, 0.0), 0.3);
  std::printf("%zu cells; wall %.2f m ahead\n", map.stats().observed_leaves, ahead.value_or(-1.0));

  ndtree::save(map, file);  // Whole or not at all.
  const bool is_same = ndtree::to_bytes(ndtree::load<Map>(file)) == ndtree::to_bytes(map);
  return is_free && is_unknown && is_near && is_same && ahead && std::abs(*ahead - 3.0) < 0.1 ? 0 : 1;
}
