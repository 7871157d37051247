// SPDX-License-Identifier: BSD-3-Clause
// A value of one's own that cells carry: the strongest echo of the beams that ended in a cell.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <ndtree/ndtree.hpp>
#include <stdexcept>
#include <string>

/// What Layer asks of a value is listed in ndtree/layers/values.hpp.
class StrongestEcho {
 public:
  using Measurement = std::uint16_t;  // In [1, 65535].
  static constexpr int kNumWords = 1;

  static void check(Measurement echo) {
    if (echo == 0) throw std::invalid_argument("0: must be in [1, 65535]");
  }
  [[nodiscard]] bool is_empty() const { return echo_ == 0; }
  [[nodiscard]] std::uint32_t echo() const { return echo_; }
  void add(Measurement echo) { echo_ = std::max<std::uint32_t>(echo_, echo); }
  /// When cells merge, the strongest of both.
  void join(const StrongestEcho& other) { echo_ = std::max(echo_, other.echo_); }
  /// When a cell splits, each child may be where the echo came from.
  [[nodiscard]] StrongestEcho part(int /*divisor*/) const { return *this; }

  // For files: the rule's name, and the value as words, the first of which is 0 if it is empty.
  [[nodiscard]] static std::string rule() { return "strongest"; }
  [[nodiscard]] std::array<std::uint32_t, 1> words() const { return {echo_}; }
  [[nodiscard]] static StrongestEcho from_words(const std::array<std::uint32_t, 1>& words) {
    if (words[0] > 65535) throw std::invalid_argument("an echo of " + std::to_string(words[0]));
    StrongestEcho value;
    value.echo_ = words[0];
    return value;
  }

 private:
  std::uint32_t echo_ = 0;
};

int main(int argc, char** argv) {
  const std::string file = argc > 1 ? argv[1] : "echoes.ndt";
  using Map = ndtree::LayeredMap<ndtree::AdaptiveMap<2, 3>, StrongestEcho>;
  Map map;
  ndtree::Scan<3> scan;
  scan.origins = ndtree::Vector<3>(0.02, 0.02, 1.0);
  scan.endpoints.resize(3, 2);
  scan.endpoints << 2.01, 2.02, 0.51, 0.52, 1.0, 1.01;  // x of both beams, y of both, z of both.
  map.insert(scan, {120, 90});                          // An echo for each beam.
  const std::uint32_t echo = map.value<0>(scan.endpoints.col(0)).echo();
  ndtree::save(map, file);
  const auto loaded = ndtree::load_layered<Map>(file, map.names());
  std::printf("strongest echo %u\n", static_cast<unsigned>(echo));
  return echo == 120 && loaded.value<0>(scan.endpoints.col(0)).echo() == 120 ? 0 : 1;
}
