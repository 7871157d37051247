// SPDX-License-Identifier: BSD-3-Clause
#include "no_returns.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <optional>
#include <stdexcept>
#include <unordered_map>
#include <variant>
#include <vector>

#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree {
namespace {

// As in ndtree.evaluation.sampling and ndtree.evaluation.no_returns.
constexpr std::size_t kRun = 4, kRuns = 40;
constexpr Eigen::Index kMostBeamsOfScan = 4000;
constexpr double kFarthest = 1e9;
constexpr double kMargin = 3.0;
constexpr std::size_t kLeastBeams = 30;
constexpr double kMostWrong = 0.2;
constexpr std::size_t kMostBeams = 100'000;
constexpr double kInside = 1e-3;
constexpr std::int64_t kFarthestCell = std::int64_t{1} << 20;

template <int D>
constexpr double kCell = D == 2 ? 0.1 : 0.2;

/// Some of a scan's beams, and none that ends absurdly far away.
template <int D>
Scan<D> some_of(const Scan<D>& scan) {
  const Eigen::Index stride =
      std::max<Eigen::Index>(1, (scan.size() + kMostBeamsOfScan - 1) / kMostBeamsOfScan);
  std::vector<Eigen::Index> kept;
  for (Eigen::Index i = 0; i < scan.size(); i += stride) {
    const auto origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
    if ((scan.endpoints.col(i).array().abs() > kFarthest).any() || (origin.array().abs() > kFarthest).any())
      continue;
    kept.push_back(i);
  }
  const auto n = static_cast<Eigen::Index>(kept.size());
  Scan<D> result;
  result.endpoints.resize(D, n);
  result.origins.resize(D, scan.origins.cols() == 1 ? 1 : n);
  if (scan.origins.cols() == 1) result.origins = scan.origins;
  if (scan.returned.size() != 0) result.returned.resize(n);
  for (Eigen::Index k = 0; k < n; ++k) {
    const Eigen::Index i = kept[static_cast<std::size_t>(k)];
    result.endpoints.col(k) = scan.endpoints.col(i);
    if (scan.origins.cols() != 1) result.origins.col(k) = scan.origins.col(i);
    if (scan.returned.size() != 0) result.returned[k] = scan.returned[i];
  }
  return result;
}

/// Runs of scans that follow each other, evenly over the log: 40 to 80 of them, if it is long enough.
template <int D>
std::vector<Scan<D>> spread(const std::vector<Scan<D>>& scans) {
  const std::size_t runs = (scans.size() + kRun - 1) / kRun;
  std::size_t step = 1;
  while ((runs + step - 1) / step > 2 * kRuns) step *= 2;
  std::vector<Scan<D>> sample;
  for (std::size_t i = 0; i < scans.size(); ++i)
    if (i / kRun % step == 0) sample.push_back(some_of(scans[i]));
  return sample;
}

/// The first origin that is finite, in cells, rounded; zero without one.
template <int D>
Vector<D> first_cell(const std::vector<Scan<D>>& sample) {
  for (std::size_t i = 0; i < sample.size(); i += 2)
    for (Eigen::Index k = 0; k < sample[i].origins.cols(); ++k)
      if (sample[i].origins.col(k).allFinite())
        return (sample[i].origins.col(k) / kCell<D>).unaryExpr([](double x) { return std::nearbyint(x); });
  return Vector<D>::Zero();
}

/// Cells of one size that every second scan hit, each with the first and the last of these that did.
template <int D>
class Surfaces {
 public:
  explicit Surfaces(const std::vector<Scan<D>>& sample) : map_(options()), start_(first_cell(sample)) {
    for (std::size_t i = 0; i < sample.size(); i += 2) {
      const Scan<D> hits = sample[i].returned_only();
      if (hits.size() == 0) continue;
      try {
        map_.insert(hits);
      } catch (const std::invalid_argument&) {
        continue;  // A scan that no map takes is left out here; mapping itself refuses it by name.
      }
      for (Eigen::Index k = 0; k < hits.size(); ++k)
        if (hits.endpoints.col(k).allFinite()) note(hits.endpoints.col(k), i / 2);
    }
  }

  struct Hit {
    double distance;  ///< Infinite without one [m].
    bool was_there;   ///< Hit both before, or by the first of the two scans that the ray lies between, and
                      ///< after.
  };
  /// The first surface on a ray of a scan between those with this number and the next.
  /// @param direction of length 1.
  [[nodiscard]] Hit first_on(std::size_t number, const Vector<D>& origin, const Vector<D>& direction) const {
    constexpr double kInfinity = std::numeric_limits<double>::infinity();
    const std::optional<double> at = cast_ray(map_, origin, direction, kInfinity);
    if (!at) return {kInfinity, false};
    const auto found = seen_.find(key(origin + (*at + kInside * kCell<D>)*direction));
    return {*at, found != seen_.end() && found->second.first <= number && found->second.last > number};
  }

 private:
  struct Seen {
    std::size_t first, last;
  };

  static MapOptions options() {
    MapOptions options;
    options.min_cell_size = kCell<D>;
    options.range_sigma = kCell<D> / 4.0;
    return options;
  }

  void note(const Vector<D>& point, std::size_t number) {
    seen_.try_emplace(key(point), Seen{number, number}).first->second.last = number;
  }

  /// One number for each cell near the first scan.
  [[nodiscard]] std::int64_t key(const Vector<D>& point) const {
    constexpr auto kLimit = static_cast<double>(kFarthestCell);
    std::int64_t key = 0;
    for (int a = 0; a < D; ++a) {
      const double step = std::clamp(std::floor(point[a] / kCell<D>) - start_[a], -kLimit, kLimit - 1.0);
      key = 2 * kFarthestCell * key + static_cast<std::int64_t>(step) + kFarthestCell;
    }
    return key;
  }

  FixedMap<2, D> map_;
  Vector<D> start_;
  std::unordered_map<std::int64_t, Seen> seen_;
};

/// Beams, those of them that cross a surface, and the metres that they claim to be free up to it. Beams whose
/// first surface had left by then, or came later, or was not looked at again, are left out.
struct Count {
  std::size_t beams = 0;
  std::size_t crossing = 0;
  double metres = 0.0;
};

template <int D>
double silent_share(const std::vector<Scan<D>>& sample) {
  std::size_t beams = 0, silent = 0;
  for (const Scan<D>& scan : sample) {
    beams += static_cast<std::size_t>(scan.size());
    for (Eigen::Index i = 0; i < scan.returned.size(); ++i)
      silent += !scan.returned[i] && scan.endpoints.col(i).allFinite();
  }
  return beams == 0 ? 0.0 : static_cast<double>(silent) / static_cast<double>(beams);
}

/// Every `stride`-th beam that returned, or did not, against the surfaces.
template <int D>
void add(const Surfaces<D>& surfaces, std::size_t number, const Scan<D>& scan, bool returned,
         std::size_t stride, Count& count) {
  std::size_t beam = 0;
  for (Eigen::Index i = 0; i < scan.size(); ++i) {
    if ((scan.returned.size() == 0 || scan.returned[i]) != returned) continue;
    const Vector<D> origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
    const Vector<D> way = scan.endpoints.col(i) - origin;
    double square = 0.0;
    for (const double x : way) square += x * x;  // In this order, as NumPy adds.
    const double length = std::sqrt(square);
    if (!(std::isfinite(length) && length > 0.0)) continue;
    if (beam++ % stride != 0) continue;
    const double end = std::max(length - kMargin * kCell<D>, 0.0);
    const auto [first, was_there] = surfaces.first_on(number, origin, way / length);
    const bool crosses = first < end;
    if (crosses && !was_there) continue;
    ++count.beams;
    count.crossing += crosses;
    count.metres += std::min(first, end);
  }
}

template <int D>
NoReturns judge(const std::vector<Scan<D>>& scans) {
  NoReturns found;
  const std::vector<Scan<D>> sample = spread(scans);
  found.share = silent_share(sample);
  if (found.share == 0.0) return found;
  const Surfaces<D> surfaces(sample);
  std::size_t others = 0;
  for (std::size_t i = 1; i < sample.size(); i += 2) others += static_cast<std::size_t>(sample[i].size());
  const std::size_t stride = std::max<std::size_t>(1, (others + kMostBeams - 1) / kMostBeams);
  Count silent, returned;
  for (std::size_t i = 1; i < sample.size(); i += 2) {
    add(surfaces, i / 2, sample[i], true, stride, returned);
    add(surfaces, i / 2, sample[i], false, stride, silent);
  }
  if (silent.beams == 0) return found;
  const auto beams = static_cast<double>(silent.beams);
  const double rate = returned.metres > 0.0 ? static_cast<double>(returned.crossing) / returned.metres : 0.0;
  found.beams = silent.beams;
  found.crossing = static_cast<double>(silent.crossing) / beams;
  found.expected = 1.0 - std::exp(-rate * silent.metres / beams);
  found.are_free = silent.beams < kLeastBeams || found.wrong() < kMostWrong;
  return found;
}

}  // namespace

double NoReturns::wrong() const {
  return std::max(0.0, (crossing - expected) / std::max(1.0 - expected, 1e-9));
}

std::string NoReturns::to_text() const {
  if (share == 0.0) return "every beam returned";
  char begin[80], found[120];
  std::snprintf(begin, sizeof begin, "beams without return (%.1f %%)", 100.0 * share);
  if (beams < kLeastBeams)
    return std::string(begin) + " mean free space: only " + std::to_string(beams) +
           " of them could be checked";
  std::snprintf(found, sizeof found,
                "%.0f %% of %zu go through walls that other scans saw, %.0f %% would by pose errors",
                100.0 * crossing, beams, 100.0 * expected);
  return std::string(begin) + (are_free ? " mean free space: " : " are left out: ") + found;
}

NoReturns judge_no_returns(const Log& log) {
  return std::visit([](const auto& scans) { return judge(scans); }, log.scans);
}

}  // namespace ndtree
