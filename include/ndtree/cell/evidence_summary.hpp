// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The summary of siblings with evidence, eight at a time.
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
    std::array<std::uint32_t, kWords> saturated;
    static_assert(sizeof(EvidenceCell) == sizeof saturated, "a cell is its words");
    std::memcpy(saturated.data(), &model.saturated(), sizeof saturated);
    saturated_first_.fill(model.forgets_nothing() ? saturated[0] : kOfNoLeaf);
    saturated_third_.fill(saturated[2]);
    valid_.fill(Summary::kValid);
    bound_.fill(Summary::kBound);
    occupied_.fill(Summary::flag(CellState::occupied));
    unknown_.fill(Summary::flag(CellState::unknown));
    unsaturated_.fill(Summary::kUnsaturated);
  }

  template <class NodeType>
  [[nodiscard]] SummaryOfSiblings operator()(const NodeType* siblings) const {
#ifdef NDTREE_HAS_EIGHTS
    if (width_ >= 8) return call_by_eights(siblings);
#endif
    return summary_of_siblings(siblings, kCount,
                               [this](const EvidenceCell& cell) { return model_.is_saturated(cell); });
  }

 private:
  static constexpr int kWords = EvidenceCell::kNumWords;
  static constexpr std::uint32_t kOfNoLeaf = 0xffffffffu;  // A first word.
  struct alignas(32) EightWords : std::array<std::uint32_t, 8> {};

#ifdef NDTREE_HAS_EIGHTS
  template <class NodeType>
  NDTREE_BY_EIGHTS [[nodiscard]] SummaryOfSiblings call_by_eights(const NodeType* siblings) const {
    static_assert(sizeof(NodeType) == kWords * sizeof(std::uint32_t), "a node is a cell, or a link");
    return by_eights(reinterpret_cast<const int*>(siblings));
  }
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static __m256i load(const EightWords& eight) {
    return _mm256_load_si256(reinterpret_cast<const __m256i*>(eight.data()));
  }
  struct Words {
    __m256i first, second, third;
  };
  /// The words of eight nodes, or of all, some of them more than once, in any order.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE static Words words_of_eight(const int* nodes,
                                                                                  int from) {
    static_assert(kWords == 3, "three loads");
    if constexpr (kCount >= 8) {  // The last eight again if there are fewer left.
      const auto* const words = reinterpret_cast<const __m256i*>(nodes + kWords * std::min(from, kCount - 8));
      const __m256i low = _mm256_loadu_si256(words);         // Of nodes 0 0 0 1 1 1 2 2,
      const __m256i middle = _mm256_loadu_si256(words + 1);  // 2 3 3 3 4 4 4 5,
      const __m256i high = _mm256_loadu_si256(words + 2);    // 5 5 6 6 6 7 7 7.
      const __m256i first = _mm256_blend_epi32(_mm256_blend_epi32(low, middle, 0x92), high, 0x24);
      const __m256i second = _mm256_blend_epi32(_mm256_blend_epi32(low, middle, 0x24), high, 0x49);
      const __m256i third = _mm256_blend_epi32(_mm256_blend_epi32(low, middle, 0x49), high, 0x92);
      return {first, _mm256_permutevar8x32_epi32(second, _mm256_setr_epi32(1, 2, 3, 4, 5, 6, 7, 0)),
              _mm256_permutevar8x32_epi32(third, _mm256_setr_epi32(2, 3, 4, 5, 6, 7, 0, 1))};
    } else if constexpr (kCount == 4) {
      const auto* const words = reinterpret_cast<const __m128i*>(nodes);
      const __m128i low = _mm_loadu_si128(words);         // Of nodes 0 0 0 1,
      const __m128i middle = _mm_loadu_si128(words + 1);  // 1 1 2 2,
      const __m128i high = _mm_loadu_si128(words + 2);    // 2 3 3 3.
      const __m128i first = _mm_blend_epi32(_mm_blend_epi32(low, high, 0x2), middle, 0x4);
      const __m128i second = _mm_blend_epi32(_mm_blend_epi32(middle, low, 0x2), high, 0x4);
      const __m128i third = _mm_blend_epi32(_mm_blend_epi32(high, middle, 0x2), low, 0x4);
      return {_mm256_broadcastsi128_si256(first),
              _mm256_broadcastsi128_si256(_mm_shuffle_epi32(second, 0x39)),
              _mm256_broadcastsi128_si256(_mm_shuffle_epi32(third, 0x4e))};
    } else {
      std::array<EightWords, kWords> words;
      for (int i = 0; i < 8; ++i)
        for (int w = 0; w < kWords; ++w)
          words[static_cast<std::size_t>(w)][static_cast<std::size_t>(i)] =
              static_cast<std::uint32_t>(nodes[kWords * std::min(i, kCount - 1) + w]);
      return {load(words[0]), load(words[1]), load(words[2])};
    }
  }
  /// @param nodes words: of a leaf, the second is its log-odds; of an inner node, the first has its top bit
  ///   set, and the second is the note.
  NDTREE_BY_EIGHTS [[nodiscard]] NDTREE_ALWAYS_INLINE SummaryOfSiblings by_eights(const int* nodes) const {
    const __m256i zero = _mm256_setzero_si256();
    const __m256i valid = load(valid_);
    const __m256i bound = load(bound_);
    __m256i all = zero;  // All words or-ed, without the bound, and with the valid bit inverted.
    __m256i most = zero;
    __m256i firsts = zero;
#pragma GCC unroll 2
    for (int from = 0; from < kCount; from += 8) {
      const auto [first, second, third] = words_of_eight(nodes, from);
      const __m256i is_inner = _mm256_srai_epi32(first, 31);
      const __m256i sign = _mm256_srli_epi32(second, 31);
      const __m256i compared =
          _mm256_and_si256(first, _mm256_set1_epi32(static_cast<int>(EvidenceCell::kComparedBits)));
      const __m256i is_saturated = _mm256_and_si256(_mm256_cmpeq_epi32(compared, load(saturated_first_)),
                                                    _mm256_cmpeq_epi32(third, load(saturated_third_)));
      const __m256i is_unknown =
          _mm256_castps_si256(_mm256_cmp_ps(_mm256_castsi256_ps(second), _mm256_setzero_ps(), _CMP_EQ_OQ));
      const __m256i state =
          _mm256_blendv_epi8(_mm256_sllv_epi32(load(occupied_), sign), load(unknown_), is_unknown);
      const __m256i ordered = _mm256_xor_si256(
          second,
          _mm256_or_si256(_mm256_srai_epi32(second, 31), _mm256_set1_epi32(static_cast<int>(0x80000000u))));
      const __m256i leaf =
          _mm256_or_si256(_mm256_and_si256(_mm256_add_epi32(ordered, _mm256_set1_epi32(0xff)), bound),
                          _mm256_or_si256(_mm256_or_si256(valid, state),
                                          _mm256_andnot_si256(is_saturated, load(unsaturated_))));
      const __m256i words = _mm256_blendv_epi8(leaf, second, is_inner);
      all = _mm256_or_si256(all, _mm256_xor_si256(words, valid));
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
    if ((word & Summary::kValid) == 0)
      result.summary = Summary((word & ~Summary::kBound) | Summary::kValid |
                               static_cast<std::uint32_t>(_mm_cvtsi128_si32(top)));
    return result;
  }
#endif

  const EvidenceModel& model_;
  int width_;
  // Eight times each: compilers would put them together from parts for each node.
  EightWords saturated_first_;
  EightWords saturated_third_;
  EightWords valid_;
  EightWords bound_;
  EightWords occupied_;
  EightWords unknown_;
  EightWords unsaturated_;
};

}  // namespace ndtree
