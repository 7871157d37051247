// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The beams of a scan by where they point: which of them may cross a cell, and whether all of them pass it.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <map>
#include <memory_resource>
#include <optional>
#include <vector>

#include "ndtree/core/parallel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/tree/beam_traversal.hpp"

namespace ndtree {

/// What the update of a cell needs to know of a beam. Its points are origin + t * path, the end point at 1.
template <int D>
struct ScanBeam {
  Vector<D> path;          ///< [m]
  double range;            ///< [m]
  double sigma;            ///< Standard deviation of the range [m].
  double t_end;            ///< Last point that it says anything about.
  double t_clearly_free;   ///< Cells that end before it were passed ...
  double t_surface = 0.0;  ///< ... small cells only if they end by so much before it.
  Lattice<D> end;          ///< The smallest cell that it ends in.
  bool returned;
  float chance = 0.0f;     ///< In [0, 1), as if drawn: it is in all samples of a larger share.
  std::uint32_t face = 0;  ///< Of the index that holds it.
};

/// A number in [0, 1) that seems to be drawn, but depends on the end point alone: the same beams are in a
/// sample, in whatever order they come.
template <int D>
[[nodiscard]] float chance_of(const Vector<D>& endpoint) {
  constexpr std::uint64_t kSpread = 0x9e3779b97f4a7c15u;  // 2^64 over the golden ratio.
  std::uint64_t hash = 0;
  for (int a = 0; a < D; ++a) {
    std::uint64_t bits = 0;
    std::memcpy(&bits, &endpoint[a], sizeof bits);
    hash = (hash ^ bits) * kSpread;
    hash ^= hash >> 32;
  }
  return static_cast<float>(hash * kSpread >> 40) * 0x1p-24f;
}

/// A beam that crosses a box over more than a point.
template <int D>
struct Crossing {
  const ScanBeam<D>* beam;
  double t_enter;
  double t_exit;
};

/// Every scan becomes an image: around each origin stands a cube, each of whose faces is divided into bins of
/// equal width, about as many as beams pass through it; and over the bins stands a pyramid of how far their
/// beams are known to be free, and how far they reach. Laser scans in a plane, depth images, rings of lidars
/// and unordered points need nothing else, whatever order they come in.
///
/// A box casts a shadow on a face, within a rectangle that costs two divisions: the beams of the rectangle's
/// bins are all that may cross it. Depths are measured along the axis of the face, as in a depth image.
///
/// Of a scan that is denser than any cell needs, only the beams are kept that may be in some cell's sample.
template <int D>
class ScanIndex {
  static constexpr std::size_t kAxes = D - 1;  // Of a face.

 public:
  static constexpr std::uint32_t kNoFace = 0xffffffffu;  ///< No face has this number.

 private:
  struct Face {
    Vector<D> origin;
    int axis;
    bool negative;
    std::uint32_t num_beams = 0;
    std::array<double, kAxes> lower;  // Coordinates of the beams.
    std::array<double, kAxes> upper;
    double density = 0.0;  // Of all beams: places of one beam each, in a row of length 1 ...
    std::array<std::int32_t, kAxes> places{};
    std::uint32_t num_kept = 0;
    double bins_per_unit = 0.0;  // ... and bins of one beam each of those that are kept.
    std::array<std::int32_t, kAxes> bins{};
    std::size_t first_bin = 0;
    std::size_t first_level = 0;
    float largest_chance = 0.0f;  // Of the beams that are kept.
    std::size_t first_sample = 0;
    std::size_t num_samples = 0;  // Besides that of all beams.

    Face(const Vector<D>& at, int along, bool is_negative) : origin(at), axis(along), negative(is_negative) {
      lower.fill(std::numeric_limits<double>::infinity());
      upper.fill(-std::numeric_limits<double>::infinity());
    }
  };
  [[nodiscard]] static std::size_t bins_of(const std::array<std::int32_t, kAxes>& size) {
    std::size_t n = 1;
    for (const std::int32_t bins : size) n *= static_cast<std::size_t>(bins);
    return n;
  }
  /// A beam of which is not known yet whether it is kept.
  struct Waiting {
    float depth;  // Of its end, or slightly more.
    float chance;
    std::uint32_t face;
    std::uint32_t number;
  };
  /// The cubes around the origins, in the order in which they are asked for.
  class Cubes {
   public:
    [[nodiscard]] std::size_t number_of(const Vector<D>& origin) {
      std::array<double, D> key;
      for (int a = 0; a < D; ++a) key[static_cast<std::size_t>(a)] = origin[a];
      const auto [found, is_new] = cubes_.emplace(key, cubes_.size());
      if (is_new) faces_.resize(faces_.size() + 2 * D, kNoFace);
      return found->second;
    }
    /// The number that a face was given.
    [[nodiscard]] std::uint32_t& face(std::size_t cube, int axis, bool negative) {
      return faces_[2 * (D * cube + static_cast<std::size_t>(axis)) + static_cast<std::size_t>(negative)];
    }

   private:
    std::map<std::array<double, D>, std::size_t> cubes_;  // By origin.
    std::vector<std::uint32_t> faces_;                    // 2 D of each.
  };
  /// Where a beam meets the face, in [-1, 1], on its k-th axis.
  [[nodiscard]] static double coordinate(const Face& face, const Vector<D>& path, std::size_t k) {
    const int a = static_cast<int>(k) + (static_cast<int>(k) >= face.axis);
    return path[a] / std::abs(path[face.axis]);
  }

 public:
  /// At most so many crossings are visited at a time.
  static constexpr std::uint32_t kBatch = 32;

  /// The beams of one face of one origin's cube that may cross a box: those of a rectangle of bins.
  struct View {
    std::uint32_t face = 0;
    bool all_pass = false;  ///< All beams that cross the box pass it, whatever the size of the cells in it.
    bool no_end = false;    ///< No beam that returned ends in the box.
    std::array<std::int32_t, kAxes> first{};  ///< Bins, both ends included.
    std::array<std::int32_t, kAxes> last{};
  };

  /// How many beams a cell may take: fewer than `beams` for each smallest cell that lies side by side in it.
  struct Sampling {
    double beams;
    double smallest_cell;  ///< [m]
    double largest_cell;   ///< [m]
  };

  /// Some beams of a scan, added by one thread.
  class alignas(64) Part {
   public:
    /// @param origin [m], finite. @param path of a length > 0 [m]. @param t_end, sigma, chance of the beam.
    /// @param number of the beam, that make_beam() in sort() knows it by.
    void add(const Vector<D>& origin, const Vector<D>& path, double t_end, double sigma, float chance,
             std::uint32_t number) {
      if (faces_.empty() || origin != last_origin_) {
        last_cube_ = cubes_.number_of(origin);
        last_origin_ = origin;
      }
      int axis = 0;
      for (int a = 1; a < D; ++a)
        if (std::abs(path[a]) > std::abs(path[axis])) axis = a;
      const double depth = std::abs(path[axis]);
      std::uint32_t& face_number = cubes_.face(last_cube_, axis, path[axis] < 0.0);
      if (face_number == kNoFace) {
        face_number = static_cast<std::uint32_t>(faces_.size());
        faces_.emplace_back(origin, axis, path[axis] < 0.0);
      }
      Face& face = faces_[face_number];
      ++face.num_beams;
      for (std::size_t k = 0; k < kAxes; ++k) {
        const double place = coordinate(face, path, k);
        face.lower[k] = std::min(face.lower[k], place);
        face.upper[k] = std::max(face.upper[k], place);
      }
      waiting_.push_back({rounded_up(depth * t_end), chance, face_number, number});
      largest_sigma_ = std::max(largest_sigma_, sigma);
    }

   private:
    friend ScanIndex;
    Cubes cubes_;
    Vector<D> last_origin_ = Vector<D>::Zero();
    std::size_t last_cube_ = 0;
    std::vector<Face> faces_;
    std::vector<Waiting> waiting_;
    double largest_sigma_ = 0.0;
    std::vector<std::uint32_t> face_of_scan_;  // The number that a face has in the whole scan.
    std::vector<std::uint32_t> num_kept_;      // Of each face.
    std::vector<std::uint32_t> place_;         // Of each beam that is kept: its bin, then where it is sorted.
  };

  /// @param parts in which the beams will be added, each with at most so many beams.
  void begin(std::size_t parts, std::size_t beams_of_part) {
    parts_.resize(parts);
    for (Part& part : parts_) part.waiting_.reserve(beams_of_part);
  }
  [[nodiscard]] Part& part(std::size_t number) { return parts_[number]; }

  /// Beams that were added.
  [[nodiscard]] std::size_t num_beams() const { return num_added_; }
  [[nodiscard]] std::size_t num_faces() const { return faces_.size(); }
  /// Of all beams that were added [m].
  [[nodiscard]] double largest_sigma() const { return largest_sigma_; }

  /// After the last beam.
  /// @param path_of, make_beam the path and the ScanBeam of a number; both may be called by several threads.
  template <class PathOf, class MakeBeam>
  void sort(const Sampling& sampling, Workers& workers, PathOf&& path_of, MakeBeam&& make_beam) {
    for (Part& part : parts_) join(part);
    for (Face& face : faces_) divide(face, face.num_beams, 1.0, face.density, face.places);
    const auto for_each_part = [&](auto&& visit) {
      workers.for_each_task(parts_.size(), [&](std::size_t, std::size_t p) { visit(parts_[p]); });
    };
    for_each_part([&](Part& part) { leave_out(part, sampling); });
    std::size_t num_kept = 0;
    for (const Part& part : parts_) {
      num_kept += part.waiting_.size();
      for (std::size_t f = 0; f < part.num_kept_.size(); ++f)
        faces_[part.face_of_scan_[f]].num_kept += part.num_kept_[f];
    }
    std::size_t num_bins = 0;
    for (Face& face : faces_) {
      divide(face, face.num_kept, kNarrowestBin, face.bins_per_unit, face.bins);
      face.first_bin = num_bins;
      num_bins += bins_of(face.bins);
    }
    sorting_.emplace(num_kept, num_bins, faces_.size());
    for_each_part([&](Part& part) {
      part.place_.reserve(part.waiting_.size());
      for (const Waiting& beam : part.waiting_)
        part.place_.push_back(
            static_cast<std::uint32_t>(bin_at(faces_[part.face_of_scan_[beam.face]], path_of(beam.number))));
    });
    for (const Part& part : parts_)
      for (const std::uint32_t bin : part.place_) ++sorting_->first_in_bin[bin + 1];
    for (std::size_t b = 0; b < num_bins; ++b) sorting_->first_in_bin[b + 1] += sorting_->first_in_bin[b];
    sorting_->next.assign(sorting_->first_in_bin.begin(), sorting_->first_in_bin.end() - 1);
    for (Part& part : parts_)
      for (std::uint32_t& place : part.place_) place = sorting_->next[place]++;
    for_each_part([&](const Part& part) {
      for (std::size_t i = 0; i < part.waiting_.size(); ++i) {
        const Waiting& waiting = part.waiting_[i];
        ScanBeam<D>& beam = sorting_->beams[part.place_[i]];
        beam = make_beam(waiting.number);
        beam.chance = waiting.chance;
        beam.face = part.face_of_scan_[waiting.face];
        Sorted& sorted = sorting_->sorted[part.place_[i]];
        for (std::size_t a = 0; a < D; ++a) {
          const double d = beam.path[static_cast<int>(a)];
          sorted.inverse[a] = d == 0.0 ? kAlmostParallel : 1.0 / d;
        }
        sorted.t_end = beam.t_end;
        sorted.beam = part.place_[i];
        sorted.chance = beam.chance;
      }
    });
    parts_.clear();
    for (Face& face : faces_) {
      raise_pyramid(face);
      draw_samples(face);
    }
  }

  /// Where the beams of a face come from [m].
  [[nodiscard]] const Vector<D>& origin(std::uint32_t face) const { return faces_[face].origin; }

  /// Beams of a face that would cross a cube of this size at a cell's centre if they were spread evenly over
  /// the face: so many bins does it cover.
  [[nodiscard]] double expected_beams(std::uint32_t number, const Box<D>& cell, double size) const {
    const Face& face = faces_[number];
    const int axis = face.axis;
    return expected_at(face,
                       std::max(0.5 * (cell.upper[axis] - cell.lower[axis]),
                                std::abs(0.5 * (cell.lower[axis] + cell.upper[axis]) - face.origin[axis])),
                       size);
  }

  /// How far a beam reaches along the axis of its face [m].
  [[nodiscard]] double depth_of(const ScanBeam<D>& beam) const {
    return std::abs(beam.path[faces_[beam.face].axis]);
  }
  /// Edge of the square that a beam stands for, if those of its face are spread evenly [m]: its share of the
  /// solid angle, but not more than a tenth of the depth. Of a lone beam nobody knows it: `if_alone`.
  [[nodiscard]] double width_of_beam(std::uint32_t number, double depth, double if_alone) const {
    constexpr double kWidest = 0.1;
    const Face& face = faces_[number];
    return face.num_beams > 1 ? depth * std::min(kWidest, 1.0 / face.density) : if_alone;
  }

  /// @returns false if no beam of the face crosses the box.
  bool look(std::uint32_t number, const Box<D>& box, View& view) const {
    const Face& face = faces_[number];
    const int axis = face.axis;
    const double from_lower = box.lower[axis] - face.origin[axis];
    const double from_upper = box.upper[axis] - face.origin[axis];
    const double far = face.negative ? -from_lower : from_upper;
    if (!(far > 0.0)) return false;
    const double near = std::max(0.0, face.negative ? -from_upper : from_lower);
    const double over_far = 1.0 / far;
    const double over_near = near > 0.0 ? 1.0 / near : kFarAway;
    for (std::size_t k = 0; k < kAxes; ++k) {
      const int a = static_cast<int>(k) + (static_cast<int>(k) >= axis);
      const double lower = box.lower[a] - face.origin[a];
      const double upper = box.upper[a] - face.origin[a];
      const double first =
          (lower * (lower < 0.0 ? over_near : over_far) - face.lower[k]) * face.bins_per_unit - kMargin;
      const double last =
          (upper * (upper > 0.0 ? over_near : over_far) - face.lower[k]) * face.bins_per_unit + kMargin;
      if (!(last >= 0.0) || !(first < face.bins[k])) return false;
      view.first[k] = first > 0.0 ? static_cast<std::int32_t>(first) : 0;
      view.last[k] = last < face.bins[k] ? static_cast<std::int32_t>(last) : face.bins[k] - 1;
    }
    const Depths depths = depths_in(face, coarse_level(view), view);
    if (!(static_cast<double>(depths.farthest) > near)) return false;
    view.face = number;
    view.all_pass = far < static_cast<double>(depths.nearest_free);
    view.no_end = far < static_cast<double>(depths.nearest_end);
    return true;
  }

  /// Bins that the view's beams are in; about as many as beams.
  [[nodiscard]] static std::int64_t num_bins(const View& view) {
    std::int64_t n = 1;
    for (std::size_t k = 0; k < kAxes; ++k) n *= view.last[k] - view.first[k] + 1;
    return n;
  }

  /// Calls `visit(beam)` for beams of the view that returned until it returns false, for all of those that
  /// end in a box. Goes down the pyramid, and there only into bins with beams that end at the box's depth.
  template <class Visit>
  void for_each_end(const View& view, const Box<D>& box, Visit&& visit) const {
    if (view.no_end) return;
    const Face& face = faces_[view.face];
    const double near = face.negative ? face.origin[face.axis] - box.upper[face.axis]
                                      : box.lower[face.axis] - face.origin[face.axis];
    const double far = face.negative ? face.origin[face.axis] - box.lower[face.axis]
                                     : box.upper[face.axis] - face.origin[face.axis];
    const auto visit_bin = [&](std::size_t bin) {
      for (std::uint32_t i = sorting_->first_in_bin[face.first_bin + bin];
           i < sorting_->first_in_bin[face.first_bin + bin + 1]; ++i) {
        const ScanBeam<D>& beam = sorting_->beams[sorting_->sorted[i].beam];
        if (beam.returned && !visit(beam)) return false;
      }
      return true;
    };
    for_each_bin_between(face, coarse_level(view), view.first, view.last, view, near, far, visit_bin);
  }

  /// Calls `visit(crossings, n)` with the beams of the view that cross the box over more than a point, some
  /// at a time, until it returns false. @returns whether it did not.
  /// @param share of all beams: a sample is enough that has all those in it whose chance is below this.
  template <class Visit>
  bool for_each_crossing(const View& view, const Box<D>& box, Visit&& visit, double share = 1.0) const {
    const Face& face = faces_[view.face];
    const std::size_t sample = sample_of(face, share);
    const Sample& bins = samples_[face.first_sample + sample];
    std::array<std::int32_t, kAxes> first;
    std::array<std::int32_t, kAxes> last;
    for (std::size_t k = 0; k < kAxes; ++k) {
      first[k] = view.first[k] >> times_joined(sample, k);
      last[k] = view.last[k] >> times_joined(sample, k);
    }
    const Vector<D> to_lower = box.lower - face.origin;
    const Vector<D> to_upper = box.upper - face.origin;
    std::array<Crossing<D>, kBatch> crossings;
    std::size_t found = 0;
    const bool goes_on = for_each_row_of(bins.size, first, last, [&](std::size_t from, std::size_t to) {
      const std::uint32_t end = sorting_->first_in_bin[bins.first_bin + to + 1];
      for (std::uint32_t i = sorting_->first_in_bin[bins.first_bin + from]; i < end; ++i) {
        const Sorted& sorted = sorting_->sorted[i];
        double t_enter = 0.0;
        double t_exit = sorted.t_end;
        for (std::size_t a = 0; a < D; ++a) {
          const double t0 = to_lower[static_cast<int>(a)] * sorted.inverse[a];
          const double t1 = to_upper[static_cast<int>(a)] * sorted.inverse[a];
          t_enter = std::max(t_enter, std::min(t0, t1));
          t_exit = std::min(t_exit, std::max(t0, t1));
        }
        // Without a branch, for nobody could foresee it.
        crossings[found] = {&sorting_->beams[sorted.beam], t_enter, t_exit};
        found += t_exit - t_enter > -kTouch;
        if (found < kBatch) continue;
        found = without_touches(crossings, found, to_lower, to_upper);
        if (found > 0 && !visit(crossings.data(), found)) return false;
        found = 0;
      }
      return true;
    });
    if (!goes_on) return false;
    found = without_touches(crossings, found, to_lower, to_upper);
    return found == 0 || visit(crossings.data(), found);
  }

 private:
  static constexpr double kFarAway = 1e300;
  static constexpr double kAlmostParallel = 1e300;  // Instead of 1 / 0: times 0 it is not NaN.
  static constexpr double kMargin = 1e-6;           // Of a bin, above all rounding.
  static constexpr double kNarrowestBin = 1e-6;
  static constexpr double kTouch = 1e-9;  // Of a beam's length, above all rounding.
  static constexpr float kRounding = 1e-6f;

  struct Depths {
    float nearest_free = std::numeric_limits<float>::infinity();  // No beam has a surface before it.
    float nearest_end = std::numeric_limits<float>::infinity();   // No beam that returned ends before it.
    float farthest = -std::numeric_limits<float>::infinity();     // No beam reaches beyond it.
  };
  /// What tells whether a beam crosses a box.
  struct Sorted {
    std::array<double, D> inverse;  // Of the path.
    double t_end;
    std::uint32_t beam;
    float chance;
  };
  /// All in one block of memory: malloc then keeps it for the next scan, instead of giving pages back and
  /// forth.
  struct Sorting {
    std::pmr::monotonic_buffer_resource memory;
    std::pmr::vector<ScanBeam<D>> beams{&memory};           // Those that are kept, bin by bin.
    std::pmr::vector<Sorted> sorted{&memory};               // The same; then the samples, level by level.
    std::pmr::vector<std::uint32_t> first_in_bin{&memory};  // In sorted, of each bin, and the end; also of
                                                            // the samples' bins.
    std::pmr::vector<std::uint32_t> next{&memory};          // While beams are sorted.
    std::pmr::vector<Depths> depths{&memory};

    Sorting(std::size_t num_beams, std::size_t num_bins, std::size_t num_faces)
        : memory(bytes(num_beams, num_bins, num_faces)) {
      beams.resize(num_beams);
      sorted.reserve(with_samples(num_beams));
      sorted.resize(num_beams);
      first_in_bin.reserve(with_samples(num_bins) + kRounded * num_faces);
      first_in_bin.resize(num_bins + 1);
      next.reserve(num_bins);
      depths.reserve(with_samples(num_bins) + kRounded * num_faces);
    }

   private:
    static constexpr std::size_t kRounded = 4;  // Of a face, in the mean.

    /// So many, and half of them, and so on, or fewer.
    [[nodiscard]] static std::size_t with_samples(std::size_t n) { return 2 * n + n / 8; }
    [[nodiscard]] static std::size_t bytes(std::size_t num_beams, std::size_t num_bins,
                                           std::size_t num_faces) {
      constexpr std::size_t kMore = 1024;  // For alignment.
      return num_beams * sizeof(ScanBeam<D>) + with_samples(num_beams) * sizeof(Sorted) +
             (with_samples(num_bins) + kRounded * num_faces) * (sizeof(std::uint32_t) + sizeof(Depths)) +
             num_bins * sizeof(std::uint32_t) + kMore;
    }
  };
  struct Level {
    std::size_t first;  // In depths.
    std::array<std::int32_t, kAxes> size;
  };
  struct Sample {
    std::size_t first_bin;  // In first_in_bin.
    std::array<std::int32_t, kAxes> size;
  };

  /// Products are as good as quotients, but for beams that only touch the box, or end at its border.
  static std::size_t without_touches(std::array<Crossing<D>, kBatch>& crossings, std::size_t n,
                                     const Vector<D>& to_lower, const Vector<D>& to_upper) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < n; ++i) {
      Crossing<D> crossing = crossings[i];
      const double nearest =
          std::min(crossing.t_exit - crossing.t_enter,
                   std::min(std::abs(crossing.t_enter - 1.0), std::abs(crossing.t_exit - 1.0)));
      bool crosses = true;
      if (nearest < kTouch) {
        crossing.t_enter = 0.0;
        crossing.t_exit = crossing.beam->t_end;
        crosses = clip_to_box<D>(to_lower, to_upper, crossing.beam->path, crossing.t_enter, crossing.t_exit);
      }
      crossings[kept] = crossing;
      kept += crosses;
    }
    return kept;
  }

  [[nodiscard]] static double expected_at(const Face& face, double depth, double size) {
    const double row = size * face.density / depth;
    double expected = 1.0;
    for (const std::int32_t n : face.places) expected *= std::min(row, static_cast<double>(n));
    return expected;
  }

  /// Adds a part's faces to those of the scan.
  void join(Part& part) {
    for (const Face& of_part : part.faces_) {
      std::uint32_t& number = cubes_.face(cubes_.number_of(of_part.origin), of_part.axis, of_part.negative);
      if (number == kNoFace) {
        number = static_cast<std::uint32_t>(faces_.size());
        faces_.emplace_back(of_part.origin, of_part.axis, of_part.negative);
      }
      part.face_of_scan_.push_back(number);
      Face& face = faces_[number];
      face.num_beams += of_part.num_beams;
      for (std::size_t k = 0; k < kAxes; ++k) {
        face.lower[k] = std::min(face.lower[k], of_part.lower[k]);
        face.upper[k] = std::max(face.upper[k], of_part.upper[k]);
      }
    }
    num_added_ += part.waiting_.size();
    largest_sigma_ = std::max(largest_sigma_, part.largest_sigma_);
  }
  /// No cell takes a beam that none takes at the depth of its end, or behind it by half a cell.
  void leave_out(Part& part, const Sampling& sampling) const {
    part.num_kept_.assign(part.faces_.size(), 0);
    std::size_t kept = 0;
    for (const Waiting& beam : part.waiting_) {
      const double expected =
          expected_at(faces_[part.face_of_scan_[beam.face]],
                      static_cast<double>(beam.depth) + 0.5 * sampling.largest_cell, sampling.smallest_cell);
      const bool is_kept = static_cast<double>(beam.chance) * expected < sampling.beams;
      part.waiting_[kept] = beam;
      kept += is_kept;
      part.num_kept_[beam.face] += is_kept;
    }
    part.waiting_.resize(kept);
  }
  [[nodiscard]] static float rounded_up(double x) {
    return static_cast<float>(x) * (1.0f + kRounding) + std::numeric_limits<float>::min();
  }

  [[nodiscard]] static std::size_t bin_at(const Face& face, const Vector<D>& path) {
    std::size_t bin = 0;
    for (std::size_t k = kAxes; k-- > 0;) {
      const auto n =
          static_cast<std::int32_t>((coordinate(face, path, k) - face.lower[k]) * face.bins_per_unit);
      bin = bin * static_cast<std::size_t>(face.bins[k]) +
            static_cast<std::size_t>(std::clamp(n, 0, face.bins[k] - 1));
    }
    return face.first_bin + bin;
  }

  /// Squares of about one beam each, over the part of a face that beams go through.
  /// @param width_of_place of the only square, if that part is but one place.
  static void divide(const Face& face, std::uint32_t num_beams, double width_of_place, double& per_unit,
                     std::array<std::int32_t, kAxes>& squares) {
    num_beams = std::max(num_beams, 1u);
    double area = 1.0;  // Of the part of the face that beams pass through, without axes that do not matter.
    int axes = 0;
    for (std::size_t k = 0; k < kAxes; ++k) {
      const double extent = face.upper[k] - face.lower[k];
      if (extent <= kNarrowestBin) continue;
      area *= extent;
      ++axes;
    }
    double width =
        axes == 0 ? width_of_place : std::max(kNarrowestBin, std::pow(area / num_beams, 1.0 / axes));
    for (std::size_t k = 0; k < kAxes; ++k)  // No more bins on an axis than beams.
      width = std::max(width, (face.upper[k] - face.lower[k]) / num_beams);
    for (std::size_t k = 0; k < kAxes; ++k) {
      squares[k] = 1 + static_cast<std::int32_t>((face.upper[k] - face.lower[k]) / width);
    }
    per_unit = 1.0 / width;
  }

  static constexpr std::uint32_t kFewBeams = 64;  // Of which no sample is worth its work.

  [[nodiscard]] static std::size_t sample_of(const Face& face, double share) {
    std::size_t sample = 0;
    for (double kept = 0.5 * static_cast<double>(face.largest_chance);
         sample < face.num_samples && share <= kept; kept *= 0.5)
      ++sample;
    return sample;
  }
  /// How often the bins of a sample are two that were side by side on the k-th axis: each sample has half the
  /// beams of the one before, and half the bins, the axes taking turns.
  [[nodiscard]] static std::size_t times_joined(std::size_t sample, std::size_t k) {
    return (sample + kAxes - 1 - k) / kAxes;
  }

  void draw_samples(Face& face) {
    face.first_sample = samples_.size();
    samples_.push_back({face.first_bin, face.bins});
    if constexpr (kAxes > 0) {
      auto& first_in_bin = sorting_->first_in_bin;
      double share = 0.5 * static_cast<double>(face.largest_chance);
      for (std::size_t axis = 0;; axis = (axis + 1) % kAxes, share *= 0.5) {
        const Sample below = samples_.back();
        if (first_in_bin[below.first_bin + bins_of(below.size)] - first_in_bin[below.first_bin] < kFewBeams)
          return;
        Sample sample{first_in_bin.size(), below.size};
        sample.size[axis] = (below.size[axis] + 1) / 2;
        std::size_t stride = 1;  // From a bin below to the next on the axis.
        for (std::size_t k = 0; k < axis; ++k) stride *= static_cast<std::size_t>(below.size[k]);
        const auto row = static_cast<std::size_t>(below.size[axis]);
        const std::size_t rows = bins_of(below.size) / (stride * row);
        for (std::size_t r = 0; r < rows; ++r) {
          for (std::size_t i = 0; i < row; i += 2) {
            for (std::size_t j = 0; j < stride; ++j) {
              const std::size_t bin = below.first_bin + (r * row + i) * stride + j;
              first_in_bin.push_back(static_cast<std::uint32_t>(sorting_->sorted.size()));
              draw(bin, share);
              if (i + 1 < row) draw(bin + stride, share);
            }
          }
        }
        first_in_bin.push_back(static_cast<std::uint32_t>(sorting_->sorted.size()));
        samples_.push_back(sample);
        ++face.num_samples;
      }
    }
  }
  /// Adds to a sample what is in a bin.
  void draw(std::size_t bin, double share) {
    auto& sorted = sorting_->sorted;
    for (std::uint32_t i = sorting_->first_in_bin[bin]; i < sorting_->first_in_bin[bin + 1]; ++i)
      if (static_cast<double>(sorted[i].chance) < share) sorted.push_back(Sorted(sorted[i]));
  }

  void raise_pyramid(Face& face) {
    face.first_level = levels_.size();
    Level level{sorting_->depths.size(), face.bins};
    sorting_->depths.resize(sorting_->depths.size() + bins_of(face.bins));
    for (std::size_t b = 0; b < bins_of(face.bins); ++b) {
      Depths& depths = sorting_->depths[level.first + b];
      for (std::uint32_t i = sorting_->first_in_bin[face.first_bin + b];
           i < sorting_->first_in_bin[face.first_bin + b + 1]; ++i) {
        const ScanBeam<D>& beam = sorting_->beams[i];
        face.largest_chance = std::max(face.largest_chance, beam.chance);
        const auto depth = static_cast<float>(std::abs(beam.path[face.axis]));
        depths.nearest_free =
            std::min(depths.nearest_free,
                     static_cast<float>(beam.t_clearly_free - beam.t_surface) * depth * (1.0f - kRounding) -
                         std::numeric_limits<float>::min());
        if (beam.returned) depths.nearest_end = std::min(depths.nearest_end, depth * (1.0f - kRounding));
        depths.farthest = std::max(depths.farthest, rounded_up(beam.t_end * std::abs(beam.path[face.axis])));
      }
    }
    levels_.push_back(level);
    while (bins_of(level.size) > 1) {
      Level above{sorting_->depths.size(), {}};
      for (std::size_t k = 0; k < kAxes; ++k) above.size[k] = (level.size[k] + 1) / 2;
      const std::size_t count = bins_of(above.size);
      sorting_->depths.resize(sorting_->depths.size() + count);
      std::array<std::int32_t, kAxes> at{};
      for (std::size_t b = 0; b < count; ++b) {
        View below;
        for (std::size_t k = 0; k < kAxes; ++k) {
          below.first[k] = 2 * at[k];
          below.last[k] = std::min(2 * at[k] + 1, level.size[k] - 1);
        }
        sorting_->depths[above.first + b] = depths_at(level, below.first, below.last);
        for (std::size_t k = 0; k < kAxes && ++at[k] == above.size[k]; ++k) at[k] = 0;
      }
      levels_.push_back(above);
      level = above;
    }
  }

  /// The finest level of which a view covers at most two bins on each axis, or three beside a border.
  [[nodiscard]] static std::size_t coarse_level(const View& view) {
    std::int32_t widest = 0;
    for (std::size_t k = 0; k < kAxes; ++k) widest = std::max(widest, view.last[k] - view.first[k]);
    std::size_t level = 0;
    while (widest >> level > 1) ++level;
    return level;
  }

  /// Calls `visit(bin)` for bins of the finest level with beams that may end between two depths, until it
  /// returns false. @param first, last of a rectangle of finest bins, of which those in the view are visited.
  template <class Visit>
  bool for_each_bin_between(const Face& face, std::size_t level, const std::array<std::int32_t, kAxes>& first,
                            const std::array<std::int32_t, kAxes>& last, const View& view, double near,
                            double far, Visit&& visit) const {
    const Level& bins = levels_[face.first_level + level];
    std::array<std::int32_t, kAxes> from;
    std::array<std::int32_t, kAxes> to;
    for (std::size_t k = 0; k < kAxes; ++k) {
      from[k] = std::max(first[k], view.first[k]) >> level;
      to[k] = std::min(last[k], view.last[k]) >> level;
    }
    return for_each_bin_of(
        bins.size, from, to, [&](std::size_t b, const std::array<std::int32_t, kAxes>& at) {
          const Depths& depths = sorting_->depths[bins.first + b];
          if (static_cast<double>(depths.nearest_end) > far || static_cast<double>(depths.farthest) < near)
            return true;
          if (level == 0) return visit(b);
          std::array<std::int32_t, kAxes> lower;
          std::array<std::int32_t, kAxes> upper;
          for (std::size_t k = 0; k < kAxes; ++k) {
            lower[k] = at[k] << level;
            upper[k] = lower[k] + (std::int32_t{1} << level) - 1;
          }
          return for_each_bin_between(face, level - 1, lower, upper, view, near, far, visit);
        });
  }

  [[nodiscard]] Depths depths_in(const Face& face, std::size_t level, const View& view) const {
    std::array<std::int32_t, kAxes> first;
    std::array<std::int32_t, kAxes> last;
    for (std::size_t k = 0; k < kAxes; ++k) {
      first[k] = view.first[k] >> level;
      last[k] = view.last[k] >> level;
    }
    return depths_at(levels_[face.first_level + level], first, last);
  }
  [[nodiscard]] Depths depths_at(const Level& level, const std::array<std::int32_t, kAxes>& first,
                                 const std::array<std::int32_t, kAxes>& last) const {
    Depths sum;
    for_each_row_of(level.size, first, last, [&](std::size_t from, std::size_t to) {
      for (std::size_t b = from; b <= to; ++b) {
        sum.nearest_free = std::min(sum.nearest_free, sorting_->depths[level.first + b].nearest_free);
        sum.nearest_end = std::min(sum.nearest_end, sorting_->depths[level.first + b].nearest_end);
        sum.farthest = std::max(sum.farthest, sorting_->depths[level.first + b].farthest);
      }
      return true;
    });
    return sum;
  }

  /// Calls `visit(from, to)` with the numbers of the first and the last bin of each row of a rectangle, until
  /// it returns false. @returns whether it did not.
  template <class Visit>
  static bool for_each_row_of(const std::array<std::int32_t, kAxes>& size,
                              const std::array<std::int32_t, kAxes>& first,
                              const std::array<std::int32_t, kAxes>& last, Visit&& visit) {
    if constexpr (kAxes == 0) {
      return visit(std::size_t{0}, std::size_t{0});
    } else if constexpr (kAxes == 1) {
      return visit(static_cast<std::size_t>(first[0]), static_cast<std::size_t>(last[0]));
    } else {
      std::array<std::int32_t, kAxes> at = first;
      for (;;) {
        std::size_t row = 0;
        for (std::size_t k = kAxes; k-- > 1;)
          row = (row + static_cast<std::size_t>(at[k])) * static_cast<std::size_t>(size[k - 1]);
        if (!visit(row + static_cast<std::size_t>(first[0]), row + static_cast<std::size_t>(last[0])))
          return false;
        std::size_t k = 1;
        for (; k < kAxes && at[k] == last[k]; ++k) at[k] = first[k];
        if (k == kAxes) return true;
        ++at[k];
      }
    }
  }

  /// Calls `visit(number, place)` with each bin of a rectangle, until it returns false. @returns whether it
  /// did not.
  template <class Visit>
  static bool for_each_bin_of(const std::array<std::int32_t, kAxes>& size,
                              const std::array<std::int32_t, kAxes>& first,
                              const std::array<std::int32_t, kAxes>& last, Visit&& visit) {
    std::array<std::int32_t, kAxes> at = first;
    for (;;) {
      std::size_t number = 0;
      for (std::size_t k = kAxes; k-- > 0;)
        number = number * static_cast<std::size_t>(size[k]) + static_cast<std::size_t>(at[k]);
      if (!visit(number, at)) return false;
      std::size_t k = 0;
      for (; k < kAxes && at[k] == last[k]; ++k) at[k] = first[k];
      if (k == kAxes) return true;
      ++at[k];
    }
  }

  std::vector<Part> parts_;  // Until they are sorted.
  Cubes cubes_;
  std::vector<Face> faces_;
  std::size_t num_added_ = 0;
  double largest_sigma_ = 0.0;
  std::optional<Sorting> sorting_;
  std::vector<Level> levels_;
  std::vector<Sample> samples_;
};

}  // namespace ndtree
