// SPDX-License-Identifier: BSD-3-Clause
// A path for a ball through two rooms, and another one when the door closes.
#include <iostream>
#include <ndtree/ndtree.hpp>

using Map = ndtree::AdaptiveMap<2, 2>;

namespace {

void print(const ndtree::Path<2>& path) {
  if (path.status != ndtree::PathStatus::found) {
    std::cout << "no path\n";
    return;
  }
  std::cout << path.length << " m, " << path.clearance << " m from obstacles:";
  for (const ndtree::Vector<2>& point : path.points)
    std::cout << " (" << point.x() << ", " << point.y() << ")";
  std::cout << "\n";
}

}  // namespace

int main() {
  ndtree::MapOptions options;
  options.min_cell_size = 0.1;
  Map map(options);
  map.mark(ndtree::Box<2>{{-4.0, -2.0}, {4.0, 2.0}}, ndtree::CellState::free);
  map.mark(ndtree::Box<2>{{-0.1, -2.0}, {0.1, 0.8}}, ndtree::CellState::occupied);

  const ndtree::Body<2> body{ndtree::Capsule<2>{{0.0, 0.0}, {0.0, 0.0}, 0.25}};
  ndtree::Planner<Map> planner(map, body);
  const ndtree::Path<2> path = planner.plan({-3.0, -1.0}, {3.0, -1.0});
  print(path);

  map.mark(ndtree::Box<2>{{-0.1, 0.8}, {0.1, 2.0}}, ndtree::CellState::occupied);
  planner.update(map);
  if (planner.first_blocked(path.points)) print(planner.plan({-3.0, -1.0}, {3.0, -1.0}));
}
