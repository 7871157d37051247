// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The order of a scan's beams, by face and step of chance, found by several threads at once.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace ndtree {

/// A beam that some cell may take.
struct KeptBeam {
  std::uint32_t face;    ///< By its number, see ScanUpdate.
  std::uint32_t number;  ///< In the scan.
};

/// The steps of all faces' chances, one face after the other (see ScanFace::step_of()): each thread counts
/// what it has for each, then puts its beams where they belong. Of a step, beams stay in the order of the
/// scan.
class BeamSteps {
 public:
  struct OfFace {
    std::uint32_t count;  ///< As many as there are beams for, see ScanFace::steps_within().
    int shift;            ///< See ScanFace::chance_shift.
  };
  explicit BeamSteps(const std::vector<OfFace>& faces) {
    faces_.reserve(faces.size());
    std::size_t first = 0;
    for (const OfFace& face : faces) {
      faces_.push_back({first, face});
      first += face.count;
    }
    begins_.assign(first + 1, 0);
  }

  [[nodiscard]] std::size_t count() const { return begins_.size() - 1; }
  [[nodiscard]] std::size_t of(std::uint32_t face, std::uint32_t chance) const {
    return faces_[face].first + (chance >> faces_[face].steps.shift);
  }
  [[nodiscard]] std::size_t first_of(std::size_t face) const { return faces_[face].first; }
  [[nodiscard]] std::uint32_t count_of(std::size_t face) const { return faces_[face].steps.count; }

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
  struct Face {
    std::size_t first;  // Of its steps.
    OfFace steps;
  };
  std::vector<Face> faces_;
  std::vector<std::uint32_t> begins_;
};

}  // namespace ndtree
