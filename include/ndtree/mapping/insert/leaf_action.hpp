// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What a scan can do to a leaf.
#pragma once

#include <cstdint>

namespace ndtree {

/// What a scan does to a leaf.
enum class LeafAction : std::uint8_t {
  update,                ///< It takes the scan's evidence.
  update_without_split,  ///< It would split, but its children would re-merge:
                         ///< EvidenceModel::update_without_split().
  judge_coverage,        ///< Beams have only passed a leaf that is not known to be covered:
                         ///< CoverageModel::judge() decides.
  judge_ends,            ///< Beams ended right before an unknown leaf: if one grazed the cells before its
                         ///< border, it splits (LeafEvidence::any_grazes()), else it is as if they had not.
  judge_passes,          ///< All beams passed an occupied smallest cell: whether so clearly that it looks
                         ///< empty (LeafEvidence::add_passes()), ChangeDetection has to know. The walk's own.
  split,                 ///< Its beams go on to its children, which sample them anew.
};

}  // namespace ndtree
