// SPDX-License-Identifier: BSD-3-Clause
#include "no_returns.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <optional>
#include <variant>
#include <vector>

#include "ndtree/mapping/map_options.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "ndtree/query/ray.hpp"

namespace ndtree {
namespace {

// As in ndtree.sampling and ndtree.no_returns.
constexpr std::size_t kRun = 4, kRuns = 40;
constexpr Eigen::Index kMostBeamsOfScan = 4000;
constexpr double kFarthest = 1e9;
constexpr double kMargin = 3.0;
constexpr std::size_t kLeastBeams = 30;
constexpr double kMostWrong = 0.2;
constexpr std::size_t kMostBeams = 100'000;

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

/// Beams, those of them that cross a surface, and the metres that they claim to be free up to it.
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
void add(const FixedMap<2, D>& surfaces, const Scan<D>& scan, bool returned, std::size_t stride,
         Count& count) {
  std::size_t number = 0;
  for (Eigen::Index i = 0; i < scan.size(); ++i) {
    if ((scan.returned.size() == 0 || scan.returned[i]) != returned) continue;
    const Vector<D> origin = scan.origins.col(scan.origins.cols() == 1 ? 0 : i);
    const Vector<D> way = scan.endpoints.col(i) - origin;
    const double length = way.norm();
    if (!(std::isfinite(length) && length > 0.0)) continue;
    if (number++ % stride != 0) continue;
    const double end = length - kMargin * kCell<D>;
    const std::optional<double> first =
        cast_ray(surfaces, origin, way, std::numeric_limits<double>::infinity());
    const bool crosses = first && *first < end;
    ++count.beams;
    count.crossing += crosses;
    count.metres += crosses ? *first : std::max(end, 0.0);
  }
}

template <int D>
NoReturns judge(const std::vector<Scan<D>>& scans) {
  NoReturns found;
  const std::vector<Scan<D>> sample = spread(scans);
  found.share = silent_share(sample);
  if (found.share == 0.0) return found;
  MapOptions options;
  options.min_cell_size = kCell<D>;
  options.range_sigma = kCell<D> / 4.0;
  FixedMap<2, D> surfaces(options);
  std::size_t others = 0;
  for (std::size_t i = 0; i < sample.size(); ++i) {
    if (i % 2 != 0) {
      others += static_cast<std::size_t>(sample[i].size());
      continue;
    }
    const Scan<D> hits = sample[i].returned_only();
    if (hits.size() != 0) surfaces.insert(hits);
  }
  const std::size_t stride = std::max<std::size_t>(1, (others + kMostBeams - 1) / kMostBeams);
  Count silent, returned;
  for (std::size_t i = 1; i < sample.size(); i += 2) {
    add(surfaces, sample[i], true, stride, returned);
    add(surfaces, sample[i], false, stride, silent);
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
  if (beams == 0) return "every beam returned";
  char begin[80], found[120];
  std::snprintf(begin, sizeof begin, "beams without return (%.1f %%)", 100.0 * share);
  if (beams < kLeastBeams)
    return std::string(begin) + " are taken for free space: " + std::to_string(beams) +
           " are too few to tell otherwise";
  std::snprintf(found, sizeof found,
                "%.0f %% of %zu cross surfaces that others found, %.0f %% would by errors alone",
                100.0 * crossing, beams, 100.0 * expected);
  return std::string(begin) + (are_free ? " are taken for free space: " : " say nothing: ") + found;
}

NoReturns judge_no_returns(const Log& log) {
  if (!std::holds_alternative<std::monostate>(log.simulation)) return {};
  return std::visit([](const auto& scans) { return judge(scans); }, log.scans);
}

}  // namespace ndtree
