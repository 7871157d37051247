// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Saves a map of scans that every machine computes alike: all coordinates are whole numbers of 1/1024 m.
///
/// usage: same_map FILE NUMBERS_AT_A_TIME

#include <cstdint>
#include <cstdio>
#include <cstdlib>

#include "ndtree/core/simd.hpp"
#include "ndtree/io/map_file.hpp"
#include "ndtree/map.hpp"
#include "random.hpp"

namespace {

/// A whole number in [-most, most], in units of 1/1024 m.
double some_length(ndtree::test::Random& random, int most) { return random.integer(-most, most) / 1024.0; }

/// Beams from somewhere in a room of 8 m, to its rough walls and to what stands in it.
ndtree::Scan<3> scan_of(std::uint32_t number, int beams) {
  ndtree::test::Random random(number);
  ndtree::Scan<3> scan;
  scan.origins.resize(3, 1);
  for (int a = 0; a < 3; ++a) scan.origins(a, 0) = some_length(random, 1000);  // In this order.
  scan.endpoints.resize(3, beams);
  for (int i = 0; i < beams; ++i) {
    for (int a = 0; a < 3; ++a) scan.endpoints(a, i) = some_length(random, 4096);
    double& across = scan.endpoints(i % 3, i);
    if (i % 37 != 0) across = (across < 0.0 ? -4.0 : 4.0) + some_length(random, 20);
  }
  return scan;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  ndtree::Simd::limit(std::atoi(argv[2]));
  ndtree::MapOptions options;
  options.min_cell_size = 0.05;
  options.range_sigma_quadratic = 0.004;
  ndtree::AdaptiveMap<2, 3> map(options);
  for (std::uint32_t s = 0; s < 10; ++s)
    map.insert(scan_of(s, s % 3 == 0 ? 300 : 2000), s % 4 == 3 ? 6.0 : ndtree::kUnlimitedRange, 1);
  ndtree::save(map, argv[1]);
  std::printf("%d\n", ndtree::Simd::width());
  return 0;
}
