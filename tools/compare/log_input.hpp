// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Any log as scans: CARMEN, plain text or .npz, by its content, or a simulated world.
#pragma once

#include <cstddef>
#include <optional>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>

#include "ndtree/core/scan.hpp"
#include "ndtree/logs/simulator.hpp"

namespace ndtree {

/// The input is bad; one line: which file, where, and what was expected.
class InputError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// A whole log.
struct Log {
  std::string name;  ///< The file's path, or "world office".
  std::variant<std::vector<Scan<2>>, std::vector<Scan<3>>> scans;
  /// Of a simulated log: what was measured, in the world's own dimension.
  std::variant<std::monostate, SimulatedLog<2>, SimulatedLog<3>> simulation;

  [[nodiscard]] int dim() const { return scans.index() == 0 ? 2 : 3; }
};

/// Reads a CARMEN log or plain text (logs/carmen.hpp, logs/xyz.hpp), each as it is or gzipped, or an .npz
/// with the arrays `origins` (S, 2 or 3), `points` (P, the same), `offsets` (S + 1,), scan i being
/// points[offsets[i]:offsets[i + 1]], and `no_return` (P,), without which every beam returned. An .npz in
/// which all z of points are equal, and those of origins, is a 2-D log.
/// @param dim 2 or 3; none: the log's own. A 2-D log lies at z = 0 in 3-D, a 3-D one is 2-D if all z are
/// equal.
/// @param limit the log ends after this many scans.
/// @throws InputError
[[nodiscard]] Log read_log(const std::string& path, std::optional<int> dim, std::size_t limit);

/// @param world office, apartment or street (logs/simulator.hpp).
/// @param limit the log ends after this many scans. @throws InputError for any other name.
[[nodiscard]] Log simulate_log(const std::string& world, std::optional<int> dim, std::size_t limit);

/// Leaves out every beam that did not return.
void keep_returned(Log& log);

}  // namespace ndtree
