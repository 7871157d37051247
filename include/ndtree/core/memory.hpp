// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// How much memory a map may hold.
#pragma once

#include <unistd.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <limits>
#include <new>
#include <stdexcept>
#include <string>

#include "ndtree/core/option.hpp"

namespace ndtree {

/// No bound to the memory.
inline constexpr std::size_t kUnlimitedMemory = std::numeric_limits<std::size_t>::max();

/// What is thrown where a map would hold more than its options allow.
class MemoryLimitReached : public std::bad_alloc {
 public:
  explicit MemoryLimitReached(std::size_t bytes)
      : text_("the map would hold more than max_memory = " + std::to_string(bytes) +
              " bytes: expected shorter beams (max_range), larger cells (min_cell_size) or a larger "
              "max_memory") {}
  [[nodiscard]] const char* what() const noexcept override { return text_.what(); }

 private:
  std::runtime_error text_;  // Copies of it cannot fail.
};

/// Refuses a limit that not even an empty map keeps to. @param bytes that one takes.
/// @throws std::invalid_argument.
inline void require_room_for_empty(std::size_t bytes, std::size_t limit) {
  if (bytes > limit)
    throw OptionError("max_memory", std::to_string(limit) + " bytes",
                      "at least " + std::to_string(bytes) + ", what the map takes while it is empty");
}

/// Bytes that are left of a limit beside others.
[[nodiscard]] inline std::size_t memory_beside(std::size_t others, std::size_t limit) {
  return limit == kUnlimitedMemory ? limit : limit - std::min(limit, others);
}

/// Bytes of memory that this process could have: the machine's, or what its container leaves it.
[[nodiscard]] inline std::size_t machine_memory() {
  static const std::size_t bytes = [] {
    const long pages = sysconf(_SC_PHYS_PAGES);
    const long size = sysconf(_SC_PAGE_SIZE);
    std::size_t most = kUnlimitedMemory;
    if (pages > 0 && size > 0) most = static_cast<std::size_t>(pages) * static_cast<std::size_t>(size);
    std::uint64_t of_container = 0;  // "max" if there is no limit.
    std::ifstream file("/sys/fs/cgroup/memory.max");
    if (file >> of_container) most = std::min(most, static_cast<std::size_t>(of_container));
    return most;
  }();
  return bytes;
}

}  // namespace ndtree
