// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a range sensor would see anew from a pose.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "ndtree/cell/hit_rate.hpp"
#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/body.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/parallel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/ray.hpp"
#include "ndtree/tree/beam_traversal.hpp"

namespace ndtree {

/// The beams of a range sensor, in its own frame.
template <int D>
struct BeamPattern {
  Points<D> directions;  ///< Of length 1, one column a beam.
  /// Angle that each beam stands for at right angles to it, on one axis and in space on another one [rad]:
  /// mostly that to its neighbours; infinity: a beam sees as much beside it as a smallest cell is wide.
  Eigen::Matrix<double, D - 1, Eigen::Dynamic> spacing;
  double max_range = 0.0;  ///< [m]
  /// Of beams in unknown space [m]: of those that have a metre of it before them, exp(-1 / this) go through.
  /// Infinity: nothing unknown occludes.
  double mean_free_path = std::numeric_limits<double>::infinity();

  /// @throws std::invalid_argument that names the first value out of its limits.
  void validate() const {
    if (directions.cols() == 0) throw std::invalid_argument("directions: must be at least one");
    if (spacing.cols() != directions.cols())
      throw std::invalid_argument("spacing: is of " + std::to_string(spacing.cols()) + " beams, must be of " +
                                  std::to_string(directions.cols()));
    for (Eigen::Index i = 0; i < directions.cols(); ++i) {
      if (!(std::abs(directions.col(i).norm() - 1.0) <= kRounding))
        throw std::invalid_argument("directions[" + std::to_string(i) + "]: must have the length 1");
      if (!(spacing.col(i).array() > 0.0).all())
        throw std::invalid_argument("spacing[" + std::to_string(i) + "]: must be > 0");
    }
    if (!(max_range > 0.0) || !std::isfinite(max_range))
      throw std::invalid_argument("max_range = " + describe_number(max_range) + " m: must be > 0 and finite");
    if (!(mean_free_path > 0.0))
      throw std::invalid_argument("mean_free_path = " + describe_number(mean_free_path) + " m: must be > 0");
  }

 private:
  static constexpr double kRounding = 1e-6;
};

/// What a scan is expected to see anew.
struct InformationGain {
  double volume = 0.0;  ///< Of unknown space [m^D].
  double bits = 0.0;    ///< About the rates at which beams end in smallest cells; see HitRate.
};

namespace detail {

/// The integral of t^j exp(-y t) over t in [0, 1] for j = 0, 1 and 2, and y >= 0.
[[nodiscard]] inline std::array<double, 3> moments_of_decay(double y) {
  std::array<double, 3> moments{};
  if (y < 1.0) {  // By the series of exp: differences below would cancel.
    constexpr int kTerms = 17;
    double term = 1.0;
    for (int n = 0; n < kTerms; term *= -y / ++n)
      for (std::size_t j = 0; j < 3; ++j) moments[j] += term / (n + static_cast<int>(j) + 1);
    return moments;
  }
  const double left = std::exp(-y);
  moments[0] = (1.0 - left) / y;
  for (std::size_t j = 1; j < 3; ++j) moments[j] = (static_cast<double>(j) * moments[j - 1] - left) / y;
  return moments;
}

/// Adds up what one beam sees, from piece to piece of its way. At a range r it is as wide as its spacing
/// times r on each axis at right angles to it, but at most a smallest cell.
template <int D>
class GainOfBeam {
 public:
  template <class Spacing>
  GainOfBeam(const Spacing& spacing, double cell_size, double mean_free_path, InformationGain& gain)
      : cell_size_(cell_size), volume_of_cell_(std::pow(cell_size, D)), path_(mean_free_path), gain_(gain) {
    for (std::size_t k = 0; k + 1 < D; ++k) spacing_[k] = spacing[static_cast<Eigen::Index>(k)];
    std::sort(spacing_.begin(), spacing_.end());  // The widest reaches its limit first.
  }
  /// @param from, to [m]. @param bits of a smallest cell.
  void add(double from, double to, bool is_unknown, double bits) {
    if (!(to > from)) return;
    double seen = 0.0;
    double begin = from;
    for (std::size_t narrow = D - 1;; --narrow) {  // Axes on which it is narrower than a cell.
      const double end = narrow == 0 ? to : std::min(to, cell_size_ / spacing_[narrow - 1]);
      if (end > begin) {
        seen += piece(narrow, begin, end, is_unknown ? begin - from : 0.0, is_unknown);
        begin = end;
      }
      if (narrow == 0 || !(begin < to)) break;
    }
    if (is_unknown) {
      gain_.volume += seen;
      passed_ += to - from;
    }
    gain_.bits += seen / volume_of_cell_ * bits;
  }

 private:
  /// Volume times the fraction of beams that get there, where the width is constant on the other axes.
  [[nodiscard]] double piece(std::size_t narrow, double from, double to, double unknown_before,
                             bool is_unknown) const {
    const double length = to - from;
    const auto moments = moments_of_decay(is_unknown ? length / path_ : 0.0);
    // (from + length t)^narrow, t in [0, 1].
    const std::array<double, 3> factors =
        narrow == 0   ? std::array<double, 3>{1.0, 0.0, 0.0}
        : narrow == 1 ? std::array<double, 3>{from, length, 0.0}
                      : std::array<double, 3>{from * from, 2.0 * from * length, length * length};
    double sum = 0.0;
    for (std::size_t j = 0; j < 3; ++j) sum += factors[j] * moments[j];
    for (std::size_t k = 0; k + 1 < D; ++k) sum *= k < narrow ? spacing_[k] : cell_size_;
    return sum * length * std::exp(-(passed_ + unknown_before) / path_);
  }

  std::array<double, std::size_t{D - 1}> spacing_{};
  double cell_size_;
  double volume_of_cell_;
  double path_;
  double passed_ = 0.0;  // Of unknown space, on the way [m].
  InformationGain& gain_;
};

/// Follows a beam up to what occludes it.
template <class Map>
class GainVisitor : public BeamVisitor {
  static constexpr int D = Map::kDim;

 public:
  GainVisitor(const HitRateModel& model, double bits_of_unknown, double surface, GainOfBeam<D>& beam)
      : model_(model), bits_of_unknown_(bits_of_unknown), surface_(surface), beam_(beam) {}

  template <class Ref>
  bool leaf(const Ref& leaf, double t_enter, double t_exit) {
    beam_.add(reached_, t_enter, true, bits_of_unknown_);  // Before it enters the map.
    reached_ = t_exit;
    const auto& cell = leaf.cell();
    const double bits = cell.observed() ? model_(cell, 1.0).bits_of_next() : bits_of_unknown_;
    beam_.add(t_enter, t_exit, cell.state() == CellState::unknown, bits);
    return t_enter < surface_;
  }
  [[nodiscard]] double reached() const { return reached_; }

 private:
  const HitRateModel& model_;
  double bits_of_unknown_;
  double surface_;
  GainOfBeam<D>& beam_;
  double reached_ = 0.0;
};

template <class Map>
[[nodiscard]] InformationGain gain_of_beams(const Map& map, const Pose<Map::kDim>& pose,
                                            const BeamPattern<Map::kDim>& sensor, Eigen::Index first,
                                            Eigen::Index last) {
  constexpr int D = Map::kDim;
  const double cell_size = map.smallest_cell();
  const HitRateModel model(map.options());
  const double bits_of_unknown = model(typename Map::Tree::Cell{}, 1.0).bits_of_next();
  InformationGain gain;
  for (Eigen::Index i = first; i < last; ++i) {
    const Vector<D> direction = pose.rotation * sensor.directions.col(i);
    const auto end = first_surface(map, pose.translation, direction, sensor.max_range, false);
    const double surface = end.t.value_or(sensor.max_range);
    // Of what occludes, it sees the outermost smallest cell.
    const double t_end = std::min(end.t ? surface + cell_size : surface, sensor.max_range);
    GainOfBeam<D> beam(sensor.spacing.col(i), cell_size, sensor.mean_free_path, gain);
    GainVisitor<Map> visitor(model, bits_of_unknown, surface, beam);
    traverse_beam(map.tree(), pose.translation, direction, 0.0, t_end, visitor);
    if (!end.t) beam.add(visitor.reached(), t_end, true, bits_of_unknown);
  }
  return gain;
}

}  // namespace detail

/// What a scan from each of several poses is expected to see anew. Each beam sees along its way, through free
/// and unknown space, up to what ends cast_ray(): there, the outermost smallest cell. Smallest cells count by
/// the part of them that is seen; larger ones as the smallest ones that they stand for.
/// @param threads that work at once, >= 1: the result is the same, bit for bit.
/// @throws std::invalid_argument if the sensor is wrong, or a pose not finite. Cancelled, see CancelScope.
/// O(poses · beams · leaves on a beam).
template <class Map>
[[nodiscard]] std::vector<InformationGain> information_gain(const Map& map,
                                                            const std::vector<Pose<Map::kDim>>& poses,
                                                            const BeamPattern<Map::kDim>& sensor,
                                                            std::size_t threads = 1) {
  constexpr Eigen::Index kBeamsOfTask = 256;
  sensor.validate();
  for (std::size_t i = 0; i < poses.size(); ++i)
    if (!poses[i].rotation.allFinite() || !poses[i].translation.allFinite())
      throw std::invalid_argument("poses[" + std::to_string(i) + "]: must be finite");
  const Eigen::Index beams = sensor.directions.cols();
  const auto tasks = static_cast<std::size_t>((beams + kBeamsOfTask - 1) / kBeamsOfTask);
  std::vector<InformationGain> parts(poses.size() * tasks);
  Workers workers(std::max<std::size_t>(1, threads));
  workers.for_each_task(parts.size(), [&](std::size_t, std::size_t task) {
    checkpoint();
    const Eigen::Index first = static_cast<Eigen::Index>(task % tasks) * kBeamsOfTask;
    parts[task] =
        detail::gain_of_beams(map, poses[task / tasks], sensor, first, std::min(beams, first + kBeamsOfTask));
  });
  std::vector<InformationGain> gains(poses.size());
  for (std::size_t task = 0; task < parts.size(); ++task) {
    gains[task / tasks].volume += parts[task].volume;
    gains[task / tasks].bits += parts[task].bits;
  }
  return gains;
}

}  // namespace ndtree
