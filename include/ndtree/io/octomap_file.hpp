// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// OctoMap's own files, .bt and .ot: any 3-D map into them, and them into a map.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/map_builder.hpp"
#include "ndtree/io/octomap_reader.hpp"
#include "ndtree/io/octomap_sampler.hpp"
#include "ndtree/io/octomap_tree.hpp"

namespace ndtree {

/// A 3-D map as the bytes of an OctoMap file.
///
/// Cells of OctoMap's follow from the map's by the rule of coarser.hpp. With the map's own min_cell_size that
/// is exact: cells of both have the same borders. Equal siblings are joined, so that leaves of every size
/// stay as large as they are, or become larger. Unknown space, and a log-odds of exactly 0, has no node.
/// @param cell_size OctoMap's resolution [m]; the map's min_cell_size if left out.
/// @param colors of the map's cells, may be null: with them, an .ot is of a ColorOcTree.
/// @throws std::invalid_argument if the cell size is not > 0, or something known lies beyond OctoMap's reach,
///   32768 cells from 0.
template <class Map>
[[nodiscard]] std::string octomap_bytes(const Map& map, OctomapFormat format,
                                        std::optional<double> cell_size = {},
                                        const OctomapColors<Map>* colors = nullptr) {
  static_assert(Map::kDim == 3, "OctoMap has three dimensions");
  const double size = cell_size.value_or(map.options().min_cell_size);
  const bool binary = format == OctomapFormat::binary;
  const bool colored = colors != nullptr && !binary;
  const std::vector<detail::OctomapNode> nodes =
      detail::OctomapSampler<Map>(map, format, size, colored ? colors : nullptr).nodes();
  ByteWriter out;
  out.bytes().append(binary ? detail::kOctomapBinaryMagic : detail::kOctomapFullMagic);
  out.bytes() += std::string(colored ? "\nid ColorOcTree" : "\nid OcTree") + "\nsize " +
                 std::to_string(nodes.size()) + "\nres " + shortest_text(size) + "\ndata\n";
  if (nodes.empty()) return std::move(out.bytes());
  if (binary)
    detail::write_octomap_binary(nodes, 0, out);
  else
    detail::write_octomap_full(nodes, colored, out);
  return std::move(out.bytes());
}

/// What a file of this name holds. @throws std::invalid_argument unless it ends in .bt or .ot.
[[nodiscard]] inline OctomapFormat octomap_format_of(const std::filesystem::path& path) {
  if (path.extension() == ".bt") return OctomapFormat::binary;
  if (path.extension() == ".ot") return OctomapFormat::full;
  throw std::invalid_argument(path.string() + ": the name of an OctoMap file must end in .bt or .ot");
}

/// Writes octomap_bytes() to a file, .bt or .ot; it appears whole or not at all.
/// @throws std::invalid_argument as octomap_bytes() and octomap_format_of().
/// @throws std::filesystem::filesystem_error naming the file and the system's reason.
template <class Map>
void save_octomap(const Map& map, const std::filesystem::path& path, std::optional<double> cell_size = {}) {
  write_file(path, octomap_bytes(map, octomap_format_of(path), cell_size));
}

/// The map in an OctoMap file's bytes: leaves of the same borders and states, which MapBuilder gives their
/// log-odds. Leaves of a .bt file get log_odds_min or log_odds_max. Those at exactly 0 are unknown here.
/// @param options of the map, but for min_cell_size, which is the file's resolution; max_cell_size and the
///   bounds of the log-odds are widened to what the file holds.
/// @param colors if given, becomes the colours of a ColorOcTree's .ot, and empty for any other file.
/// @throws std::runtime_error if the bytes are not those of such a file, MemoryLimitReached if the map would
///   hold more than max_memory.
template <class Map>
[[nodiscard]] Map octomap_from_bytes(std::string_view bytes, typename Map::Options options = {},
                                     std::optional<OctomapColors<Map>>* colors = nullptr) {
  static_assert(Map::kDim == 3, "OctoMap has three dimensions");
  options.validate();
  const detail::OctomapHeader header = detail::read_octomap_header(bytes);
  detail::OctomapReader reader(header, static_cast<float>(options.log_odds_min),
                               static_cast<float>(options.log_odds_max));
  options.min_cell_size = header.cell_size;
  int largest = 0;
  double cells = 0.0;
  reader.for_each_leaf([&](const detail::OctomapLeaf& leaf) {  // The data are whole from here on.
    largest = std::max(largest, leaf.level);
    if (state_of(leaf.log_odds) != CellState::unknown) cells += std::ldexp(1.0, 3 * leaf.level);
    if (!std::isfinite(leaf.log_odds)) return;
    options.log_odds_min = std::min(options.log_odds_min, static_cast<double>(leaf.log_odds));
    options.log_odds_max = std::max(options.log_odds_max, static_cast<double>(leaf.log_odds));
  });
  options.max_cell_size = std::max(options.max_cell_size, std::ldexp(header.cell_size, largest));
  try {
    MapBuilder<Map> builder(options);
    builder.expect_cells(cells);
    reader.for_each_leaf([&](const detail::OctomapLeaf& leaf) {
      Lattice<3> lower, upper;
      for (std::size_t a = 0; a < 3; ++a) {
        lower[a] = leaf.key[a] - detail::kOctomapZero;
        upper[a] = lower[a] + (std::int64_t{1} << leaf.level);
      }
      builder.fill(lower, upper, leaf.log_odds);
    });
    Map map = std::move(builder).finish();
    if (colors != nullptr) {
      colors->reset();
      if (header.colored) *colors = detail::colors_of(map, reader);
    }
    return map;
  } catch (const std::invalid_argument& error) {  // A resolution that no map can have.
    throw std::runtime_error(std::string("'res' or a leaf's log-odds: ") + error.what());
  }
}

/// Whether bytes begin as those of an OctoMap file do.
[[nodiscard]] inline bool is_octomap_file(std::string_view bytes) {
  const auto begins_with = [&](std::string_view text) { return bytes.substr(0, text.size()) == text; };
  return begins_with(detail::kOctomapFullMagic) || begins_with(detail::kOctomapBinaryMagic) ||
         begins_with(detail::kOctomapLegacyMagic);
}

/// Reads an OctoMap file, .bt or .ot, whatever its name.
/// @throws std::filesystem::filesystem_error if it cannot be read, std::runtime_error naming it if it is
///   damaged.
template <class Map>
[[nodiscard]] Map load_octomap(const std::filesystem::path& path, const typename Map::Options& options = {}) {
  const std::string bytes = read_file(path);
  try {
    return octomap_from_bytes<Map>(bytes, options);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(path.string() + ": " + error.what());
  }
}

}  // namespace ndtree
