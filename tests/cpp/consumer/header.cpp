// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Finds and compiles the headers, without what takes a compiler long: for trying many versions of CMake.
#include <ndtree/mapping/map_options.hpp>
#include <ndtree/tree/lattice.hpp>

int main() {
  const ndtree::LatticeGeometry<2, 3> geometry(ndtree::MapOptions{}.min_cell_size, 5);
  return geometry.in_reach(ndtree::Vector<3>::Zero()) ? 0 : 1;
}
