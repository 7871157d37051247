// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Initialising children: what the children of a leaf start with when it splits.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "ndtree/cell/change_detection.hpp"
#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_memory.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// Of the beams through a node, one in N^(D-1) crosses a given child on average: a beam passes through about
/// N of the N^D children.
template <class Tree>
inline constexpr int kChildrenAcross = Tree::kNumChildren / Tree::kBranching;

/// Children start with a part of their parent's evidence.
///
/// Free evidence is divided as this scan's beams are, since most earlier beams took much the same ways. Of B
/// beams in the parent, c passed the child; the child's fraction of E- is
///   s = 0.05 / N^(D-1) + 0.95 (c + k / N^(D-1)) / (B + k),
/// with k = inherited_beams evenly spread beams more, as a few beams are a poor sample, and a twentieth that
/// came from elsewhere. Where in the parent the hits were is not known: of E+ every child takes the mean
/// fraction 1 / N^(D-1), but in a parent that is not occupied no more than s, so that no child is less free
/// than the parent; and children of a free parent begin to count beams anew, so that a hit of now is not lost
/// among the misses of all the parent. A child of such a parent to which less than one beam is due is
/// unknown.
///
/// Free space is claimed only where it was seen: if the parent was not covered, a child that would be free
/// and that none of this scan's beams has passed is unknown. But if the parent has known levels, the child
/// was seen: it stays known, with the evidence of at least one beam.
class ChildInitialisation {
 public:
  explicit ChildInitialisation(const EvidenceOptions& options) : even_beams_(options.inherited_beams) {}

  /// False if all children of the cell start unknown.
  [[nodiscard]] static bool has_evidence(const EvidenceCell& parent) {
    return parent.observed() || parent.is_partly_seen();
  }
  /// @param children_across see kChildrenAcross.
  /// @param passed number of this scan's `beams` in the parent that passed the child.
  /// @param cell_part of the parent in which the child lies: the evidence of a partly seen parent goes to the
  ///   children in its seen parts only.
  /// @param part_is_child the part is this child; of an odd N, parts hold more, of which some may be unseen.
  /// @param is_finest the child cannot be divided: a beam sees all of it.
  [[nodiscard]] EvidenceCell child_of(const EvidenceCell& parent, const EvidenceMemory& memory,
                                      int children_across, std::size_t passed, std::size_t beams,
                                      int cell_part, bool part_is_child, bool is_finest) const {
    EvidenceCell child;
    const bool was_seen = parent.is_partly_seen() && (parent.seen_parts() >> cell_part & 1u) != 0;
    if (!parent.observed() && !was_seen) return child;
    const double mean = 1.0 / children_across;
    const double fraction = path_fraction(mean, static_cast<double>(passed), static_cast<double>(beams));
    std::int64_t free = EvidenceMemory::fraction_of(parent.free_evidence(), fraction);
    const bool may_be_unknown = parent.state() != CellState::occupied;
    const bool was_known = parent.known_levels() > 0;
    if (may_be_unknown && free < memory.miss_evidence()) {
      if (!was_known) return child;
      free = memory.miss_evidence();
    }
    const double hit_fraction = may_be_unknown ? std::min(mean, fraction) : mean;
    memory.assign(child, EvidenceMemory::fraction_of(parent.occupied_evidence(), hit_fraction), free);
    if (parent.state() != CellState::free)
      child.set_counts(static_cast<std::uint32_t>(EvidenceMemory::fraction_of(parent.hits(), hit_fraction)),
                       static_cast<std::uint32_t>(EvidenceMemory::fraction_of(parent.misses(), fraction)));
    const bool is_covered = parent.observed() && parent.is_covered();
    const bool all_seen = is_covered || was_known || (was_seen && part_is_child);
    if (!all_seen && passed == 0 && child.state() == CellState::free) return EvidenceCell();
    child.set_covered(is_covered || is_finest);
    if (was_known) child.set_known_levels(parent.known_levels() - 1);
    child.set_streak_of_passes(ChangeDetection::doubting_scans(parent));
    return child;
  }

  /// Fraction s of earlier beams' ways that went through a part of a cell.
  /// @param mean fraction over all parts. @param passed number of this scan's `beams` that passed the part.
  [[nodiscard]] double path_fraction(double mean, double passed, double beams) const {
    constexpr double kFromElsewhere = 0.05;
    const double fraction_now = (passed + unfused(even_beams_ * mean)) / (beams + even_beams_);
    return unfused(kFromElsewhere * mean) + unfused((1.0 - kFromElsewhere) * fraction_now);
  }

  /// A child of a cell about whose inside nothing is known, as where another map's smaller cells are joined
  /// with it; merging such children by EvidenceMergeRule gives the cell again, but for rounding up.
  [[nodiscard]] static EvidenceCell even_part_of(const EvidenceCell& cell, const EvidenceMemory& memory,
                                                 int children_across, int cell_part) {
    EvidenceCell part;
    const bool was_seen = cell.is_partly_seen() && (cell.seen_parts() >> cell_part & 1u) != 0;
    if (!cell.observed() && !was_seen) return part;
    const auto divided = [children_across](std::int64_t whole) {
      return (whole + children_across - 1) / children_across;
    };
    std::int64_t occupied = divided(cell.occupied_evidence());
    std::int64_t free = divided(cell.free_evidence());
    if (occupied == free && cell.occupied_evidence() != cell.free_evidence())  // The state stays.
      ++(cell.occupied_evidence() > cell.free_evidence() ? occupied : free);
    memory.assign(part, occupied, free);
    memory.set_counts(part, static_cast<std::uint32_t>(divided(cell.hits())),
                      static_cast<std::uint32_t>(divided(cell.misses())));
    part.set_covered(cell.observed() && cell.is_covered());
    if (cell.known_levels() > 0) part.set_known_levels(cell.known_levels() - 1);
    return part;
  }

 private:
  double even_beams_;
};

}  // namespace ndtree
