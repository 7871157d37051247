// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What MRPT reads from a YAML file of map_server: the number of cells along x and y, the lower left corner
/// and the cell size; then how free each cell is, 0 to 1, from the lower left on, x first.
#include <mrpt/maps/COccupancyGridMap2D.h>

#include <cstdio>

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const auto grid = mrpt::maps::COccupancyGridMap2D::FromROSMapServerYAML(argv[1]);
  std::printf("%u %u %.9g %.9g %.9g\n", static_cast<unsigned>(grid.getSizeX()),
              static_cast<unsigned>(grid.getSizeY()), static_cast<double>(grid.getXMin()),
              static_cast<double>(grid.getYMin()), static_cast<double>(grid.getResolution()));
  for (unsigned y = 0; y < grid.getSizeY(); ++y)
    for (unsigned x = 0; x < grid.getSizeX(); ++x)
      std::printf("%.4f\n", static_cast<double>(grid.getCell(static_cast<int>(x), static_cast<int>(y))));
}
