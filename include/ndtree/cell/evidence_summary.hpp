// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What siblings that hold evidence say together, eight at a time.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ndtree/cell/evidence_cell.hpp"
#include "ndtree/cell/evidence_model.hpp"
#include "ndtree/cell/summary.hpp"
#include "ndtree/core/simd.hpp"

namespace ndtree {

/// summary_of_siblings() of kCount nodes of the size of a cell.
template <int kCount>
class EvidenceSummary {
 public:
  explicit EvidenceSummary(const EvidenceModel& model) : model_(model), width_(Simd::width()) {
    static_assert(sizeof(EvidenceCell) == sizeof settled_, "a cell is its words");
    std::memcpy(settled_.data(), &model.settled(), sizeof settled_);
  }

  template <class NodeType>
  [[nodiscard]] SummaryOfSiblings operator()(const NodeType* siblings) const {
#ifdef NDTREE_HAS_EIGHTS
    if (width_ >= 8) return call_by_eights(siblings);
#endif
    return summary_of_siblings(siblings, kCount,
                               [this](const EvidenceCell& cell) { return model_.is_settled(cell); });
  }
#ifdef NDTREE_HAS_EIGHTS
  /// The same where it is known that the machine has AVX2.
  template <class NodeType>
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE SummaryOfSiblings
  by_eights(const NodeType* siblings) const {
    static_assert(sizeof(NodeType) == kWords * sizeof(std::uint32_t), "a node is a cell, or a link");
    return by_eights(reinterpret_cast<const int*>(siblings));
  }
#endif

 private:
  static constexpr int kWords = EvidenceCell::kNumWords;

#ifdef NDTREE_HAS_EIGHTS
  template <class NodeType>
  NDTREE_BY_EIGHTS [[nodiscard]] SummaryOfSiblings call_by_eights(const NodeType* siblings) const {
    return by_eights(siblings);
  }
  /// @param nodes words: of a leaf, the second is its log-odds; of an inner node, the first has its top bit
  ///   set, and the second is the note.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE SummaryOfSiblings by_eights(const int* nodes) const {
    const __m256i zero = _mm256_setzero_si256();
    const __m256i known = _mm256_set1_epi32(static_cast<int>(Summary::kKnown));
    const __m256i bound = _mm256_set1_epi32(static_cast<int>(Summary::kBound));
    __m256i all = zero;  // Words of all together, but for the bound; whether they are known the other way.
    __m256i most = zero;
    __m256i firsts = zero;
#pragma GCC unroll 2
    for (int from = 0; from < kCount; from += 8) {
      const __m256i place = _mm256_min_epi32(
          _mm256_add_epi32(_mm256_set1_epi32(from), _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7)),
          _mm256_set1_epi32(kCount - 1));  // The last one again does not matter.
      const __m256i word = _mm256_mullo_epi32(place, _mm256_set1_epi32(kWords));
      const __m256i first = _mm256_i32gather_epi32(nodes, word, 4);
      const __m256i second = _mm256_i32gather_epi32(nodes + 1, word, 4);
      const __m256i third = _mm256_i32gather_epi32(nodes + 2, word, 4);
      const __m256i is_inner = _mm256_srai_epi32(first, 31);
      const __m256i sign = _mm256_srli_epi32(second, 31);
      const __m256i is_settled = _mm256_and_si256(
          _mm256_and_si256(_mm256_cmpeq_epi32(first, _mm256_set1_epi32(static_cast<int>(settled_[0]))),
                           _mm256_cmpeq_epi32(third, _mm256_set1_epi32(static_cast<int>(settled_[2])))),
          _mm256_set1_epi32(model_.forgets_nothing() ? -1 : 0));
      const __m256i is_unknown =
          _mm256_castps_si256(_mm256_cmp_ps(_mm256_castsi256_ps(second), _mm256_setzero_ps(), _CMP_EQ_OQ));
      const __m256i state = _mm256_blendv_epi8(
          _mm256_sllv_epi32(_mm256_set1_epi32(static_cast<int>(Summary::flag(CellState::occupied))), sign),
          _mm256_set1_epi32(static_cast<int>(Summary::flag(CellState::unknown))), is_unknown);
      const __m256i ordered = _mm256_xor_si256(
          second,
          _mm256_or_si256(_mm256_srai_epi32(second, 31), _mm256_set1_epi32(static_cast<int>(0x80000000u))));
      const __m256i leaf = _mm256_or_si256(
          _mm256_and_si256(_mm256_add_epi32(ordered, _mm256_set1_epi32(0xff)), bound),
          _mm256_or_si256(
              _mm256_or_si256(known, state),
              _mm256_andnot_si256(is_settled, _mm256_set1_epi32(static_cast<int>(Summary::kUnsettled)))));
      const __m256i words = _mm256_blendv_epi8(leaf, second, is_inner);
      all = _mm256_or_si256(all, _mm256_xor_si256(words, known));
      most = _mm256_max_epu32(most, _mm256_and_si256(words, bound));
      firsts = _mm256_or_si256(firsts, first);
    }
    __m128i flags = _mm_or_si128(_mm256_castsi256_si128(all), _mm256_extracti128_si256(all, 1));
    __m128i top = _mm_max_epu32(_mm256_castsi256_si128(most), _mm256_extracti128_si256(most, 1));
    flags = _mm_or_si128(flags, _mm_shuffle_epi32(flags, 0x4e));
    top = _mm_max_epu32(top, _mm_shuffle_epi32(top, 0x4e));
    flags = _mm_or_si128(flags, _mm_shuffle_epi32(flags, 0xb1));
    top = _mm_max_epu32(top, _mm_shuffle_epi32(top, 0xb1));
    const auto word = static_cast<std::uint32_t>(_mm_cvtsi128_si32(flags));
    SummaryOfSiblings result;
    result.are_leaves = _mm256_movemask_ps(_mm256_castsi256_ps(firsts)) == 0;
    if ((word & Summary::kKnown) == 0)
      result.summary = Summary((word & ~Summary::kBound) | Summary::kKnown |
                               static_cast<std::uint32_t>(_mm_cvtsi128_si32(top)));
    return result;
  }
#endif

  const EvidenceModel& model_;
  int width_;
  std::array<std::uint32_t, kWords> settled_;
};

}  // namespace ndtree
