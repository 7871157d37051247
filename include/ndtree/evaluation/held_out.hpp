// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Which scans of a log are not mapped, but tell how true the map is.
#pragma once

#include <cstddef>

namespace ndtree {

/// Whether scan `i` of a log, counted from 0, is held out: the last of every `held_out` scans; none if 0.
[[nodiscard]] constexpr bool is_held_out(std::size_t i, std::size_t held_out) {
  return held_out != 0 && i % held_out == held_out - 1;
}

}  // namespace ndtree
