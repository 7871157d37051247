// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order of a scan's beams, by face and step of chance, found by several threads at once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ndtree/mapping/scan/image.hpp"

namespace ndtree {

/// A beam that some cell may take.
struct KeptBeam {
  std::uint32_t face;    ///< By its number, see ScanUpdate.
  std::uint32_t number;  ///< In the scan.
};

/// The steps of all faces' chances, one face after the other (see ScanFace::step_of()): each thread counts
/// what it has for each, then puts its beams where they belong. Of a step, beams stay in the order of the
/// scan.
template <int D>
class BeamSteps {
 public:
  /// @param faces that know how many steps they have; they are told which is their first. They stay where
  ///   they are as long as of() is asked.
  explicit BeamSteps(std::vector<ScanFace<D>>& faces) : faces_(faces) {
    std::size_t count = 0;
    for (ScanFace<D>& face : faces) {
      face.first_step = count;
      count += face.num_steps;
    }
    begins_.assign(count + 1, 0);
  }

  [[nodiscard]] std::size_t count() const { return begins_.size() - 1; }
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t chance) const {
    return faces_[face].first_step + faces_[face].step_of(chance);
  }

  /// Lets each part's beams of a step follow those of the part before.
  /// @param places of each part and step, how many beams; then, where the first of them belongs.
  void begin(std::vector<std::vector<std::uint32_t>>& places) {
    std::uint32_t begin = 0;
    for (std::size_t s = 0; s < count(); ++s) {
      begins_[s] = begin;
      for (std::vector<std::uint32_t>& of_part : places) {
        const std::uint32_t size = of_part[s];
        of_part[s] = begin;
        begin += size;
      }
    }
    begins_.back() = begin;
  }
  /// The first beam of each step, and the end of the last.
  [[nodiscard]] std::vector<std::uint32_t>& begins() { return begins_; }

 private:
  const std::vector<ScanFace<D>>& faces_;
  std::vector<std::uint32_t> begins_;
};

}  // namespace ndtree
