// SPDX-License-Identifier: BSD-3-Clause
// A sensor model of one's own, for maps that are updated beam by beam: `refinement="paper"` or fixed.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <ndtree/ndtree.hpp>

/// A range whose error has heavy tails, as of stereo or sonar: the obstacle's distance has the logistic
/// distribution F(x) = 1 / (1 + exp(-(x - range) / s)), and s grows linearly with the range.
class HeavyTailedModel {
 public:
  explicit HeavyTailedModel(const ndtree::SensorOptions& options) : options_(options) {}

  /// Scale s of a range [m]: half of the standard deviation at the sensor, and 0.2 % of the range.
  [[nodiscard]] double sigma(double range) const { return 0.5 * options_.range_sigma + 0.002 * range; }
  /// F, in metres from the sensor.
  [[nodiscard]] static double cdf(double distance, double range, double sigma) {
    return 1.0 / (1.0 + std::exp((range - distance) / sigma));
  }
  /// Log-odds that a cell is occupied, from F where the beam enters and leaves it.
  [[nodiscard]] float log_odds(double cdf_entry, double cdf_exit) const {
    const double p = cdf_exit - 0.5 * cdf_entry;
    return static_cast<float>(
        ndtree::log_odds(std::clamp(p, options_.probability_min, options_.probability_max)));
  }
  /// Log-odds of a cell that a beam has passed.
  [[nodiscard]] float log_odds_free() const {
    return static_cast<float>(ndtree::log_odds(options_.probability_min));
  }
  /// Cells that end before this distance [m] get log_odds_free(): F alone is below probability_min there.
  [[nodiscard]] double clearly_free_until(double range, double sigma) const {
    return range + sigma * ndtree::log_odds(options_.probability_min);
  }
  /// Where a beam ends, 1 being its end point: five scales behind it, or where a miss ends.
  template <int D>
  [[nodiscard]] static double t_end(const ndtree::Beam<D>& beam, double sigma) {
    return beam.outcome == ndtree::BeamOutcome::returned ? 1.0 + 5.0 * sigma / beam.range : beam.t_free;
  }

 private:
  ndtree::SensorOptions options_;
};

int main() {
  ndtree::OccupancyMap<2, 2, ndtree::FixedRefinement, HeavyTailedModel> map;  // Or PaperRefinement.
  ndtree::FixedMap<2, 2> normal;  // BeamSensorModel, whose errors are normal.
  ndtree::Scan<2> scan;
  scan.origins = ndtree::Vector<2>(0.02, 0.02);
  scan.endpoints = ndtree::Vector<2>(4.02, 0.52);
  for (int i = 0; i < 5; ++i) map.insert(scan), normal.insert(scan);
  const double heavy_tailed = ndtree::probability(map, scan.endpoints);
  const double of_normal = ndtree::probability(normal, scan.endpoints);
  std::printf("occupied at the end point: %.2f, with normal errors %.2f\n", heavy_tailed, of_normal);
  return heavy_tailed > 0.5 && heavy_tailed < of_normal ? 0 : 1;  // Less sure where the surface is.
}
