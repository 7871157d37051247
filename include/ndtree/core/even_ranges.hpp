// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// As many tasks for each.
#pragma once

#include <cstddef>
#include <vector>

namespace ndtree {

/// The end of each worker's range of tasks, if [0, tasks) is divided evenly among them, in order.
[[nodiscard]] inline std::vector<std::size_t> even_ranges(std::size_t tasks, std::size_t workers) {
  std::vector<std::size_t> ends(workers);
  for (std::size_t i = 0; i < workers; ++i) ends[i] = tasks * (i + 1) / workers;
  return ends;
}

}  // namespace ndtree
