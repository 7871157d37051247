// SPDX-License-Identifier: BSD-3-Clause
// A sensor of one's own for the default map, whose beams are still packed eight at a time.
#include <cstdio>
#include <ndtree/ndtree.hpp>

/// Noise that grows linearly with the range. What else the default asks of a sensor it has from
/// BeamSensorModel.
class LinearNoise : public ndtree::BeamSensorModel {
 public:
  explicit LinearNoise(const ndtree::SensorOptions& options)
      : BeamSensorModel(options), at_sensor_(options.range_sigma) {}

  /// Standard deviation of a range [m]: largest at the nearest or the farthest range. A template, always
  /// inlined, with `Doubles` one double or ndtree::FourDoubles; a product is rounded before it is added to,
  /// at every width alike.
  template <class Doubles>
  [[nodiscard]] NDTREE_ALWAYS_INLINE Doubles sigma(const Doubles& range) const {
    return at_sensor_ + ndtree::unfused(per_metre_ * range);
  }

 private:
  double at_sensor_;
  double per_metre_ = 0.01;
};
#ifdef NDTREE_HAS_EIGHTS
static_assert(
    ndtree::kPacksByEights<LinearNoise>);  // A plain `double sigma(double)` works, too: one beam at a time.
#endif

int main() {
  ndtree::MapOptions options;
  options.range_sigma = 0.01;
  ndtree::OccupancyMap<2, 2, ndtree::EvidenceRefinement, LinearNoise> map(options);
  ndtree::AdaptiveMap<2, 2> usual(options);
  ndtree::Scan<2> scan;  // A wall at x = 8 m.
  scan.origins = ndtree::Vector<2>(0.0, 0.0);
  scan.endpoints.resize(2, 200);
  for (int i = 0; i < 200; ++i) scan.endpoints.col(i) = ndtree::Vector<2>(8.02, 0.02 * (i - 100) + 0.003);
  for (int i = 0; i < 20; ++i) map.insert(scan), usual.insert(scan);
  std::printf("cells: %zu, with noise of 1 cm at every range %zu\n", map.stats().observed_leaves,
              usual.stats().observed_leaves);
  return map.stats().observed_leaves < usual.stats().observed_leaves ? 0
                                                                     : 1;  // Noise of 9 cm needs larger ones.
}
