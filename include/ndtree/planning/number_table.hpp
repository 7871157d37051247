// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A hash table from the numbers of cells to positions in an array.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

namespace ndtree::detail {

/// Open addressing, at most half full; nothing is ever taken out.
class NumberTable {
 public:
  static constexpr std::uint32_t kNone = ~std::uint32_t{0};

  NumberTable() : entries_(1024) {}

  [[nodiscard]] std::uint32_t find(std::uint64_t number) const { return entries_[slot_of(number)].position; }
  /// The position of a number; kNone if it is new: the caller writes it.
  [[nodiscard]] std::uint32_t& operator[](std::uint64_t number) {
    if (2 * ++used_ > entries_.size()) grow();
    Entry& entry = entries_[slot_of(number)];
    if (entry.position != kNone) --used_;
    entry.number = number;
    return entry.position;
  }
  [[nodiscard]] std::size_t memory_bytes() const { return entries_.capacity() * sizeof(Entry); }

 private:
  struct Entry {
    std::uint64_t number = 0;
    std::uint32_t position = kNone;
  };

  [[nodiscard]] std::size_t slot_of(std::uint64_t number) const {
    const std::size_t mask = entries_.size() - 1;
    std::size_t slot = (number * 0x9e3779b97f4a7c15u >> 20) & mask;
    while (entries_[slot].position != kNone && entries_[slot].number != number) slot = (slot + 1) & mask;
    return slot;
  }
  void grow() {
    std::vector<Entry> old(2 * entries_.size());
    old.swap(entries_);
    for (const Entry& entry : old)
      if (entry.position != kNone) entries_[slot_of(entry.number)] = entry;
  }

  std::vector<Entry> entries_;
  std::size_t used_ = 0;
};

}  // namespace ndtree::detail
