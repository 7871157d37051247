// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// A comparison as a table, as JSON and as CSV, and how these get into a file.
#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "comparison.hpp"

namespace ndtree {

/// The whole comparison. Counts and not shares; seconds, metres and bytes; null for what is unknown, does not
/// apply or is infinite. `ratios` has the adaptive map against the fixed one, and against each other map
/// under that map's name.
[[nodiscard]] nlohmann::ordered_json to_json(const Comparison& comparison);

/// What to_json() returns as a file's text, indented. Bytes of a path that are not UTF-8 are replaced.
[[nodiscard]] std::string to_text(const nlohmann::ordered_json& comparison);

/// The table of the paper's Fig. 7, extended, from what to_json() returns. Ends with a line break.
[[nodiscard]] std::string to_table(const nlohmann::ordered_json& comparison);

/// One header line, and a line for each map, from what to_json() returns.
[[nodiscard]] std::string to_csv(const nlohmann::ordered_json& comparison);

/// Whether a file of this name could be written. @throws std::runtime_error with the reason if not.
void check_writable(const std::string& path);

/// Writes as ReplacedFile does: the file is never half there.
/// @throws std::runtime_error naming the file.
void write_report(const std::string& path, const std::string& text);

}  // namespace ndtree
