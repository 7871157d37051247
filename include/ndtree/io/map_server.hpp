// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Maps for navigation as ROS's map_server and nav2 read them: a grey image (PGM) and a YAML file about it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "ndtree/cell/occupancy_cell.hpp"
#include "ndtree/cell/thin_things.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/io/coarser.hpp"
#include "ndtree/io/wall_fronts.hpp"
#include "ndtree/tree/visit.hpp"

namespace ndtree {

/// What to put into the image.
struct MapServerOptions {
  std::optional<double> cell_size;  ///< Edge of a pixel [m]; the map's min_cell_size if left out.
  /// Of a 3-D map, only cells that overlap [first, second) in z [m]; all if left out.
  std::optional<std::pair<double, double>> height;
  /// How far behind free space occupied cells larger than the smallest are drawn [m], see WallFronts; beyond
  /// they are unknown. All of each if left out.
  std::optional<double> wall_depth = std::nullopt;
};

/// A grey image, the upper row first, and where it lies. Pixels begin at whole numbers of cell_size from 0.
struct MapServerImage {
  static constexpr std::uint8_t kFree = 254;
  static constexpr std::uint8_t kOccupied = 0;
  static constexpr std::uint8_t kUnknown = 205;

  std::size_t width = 0;                 ///< Pixels along x.
  std::size_t height = 0;                ///< Pixels along y.
  double cell_size = 0.0;                ///< Edge of a pixel [m].
  Vector<2> origin = Vector<2>::Zero();  ///< Lower left corner of the pixel at the lower left [m].
  std::vector<std::uint8_t> pixels;

  /// Pixels of columns [x0, x1) in rows [y0, y1), from the upper left.
  struct Rectangle {
    std::int64_t x0, x1, y0, y1;
  };
  /// Makes those of some rectangles occupied that share no side with an occupied pixel, and have none.
  void occupy_single(std::vector<Rectangle> some) {
    const auto any_occupied = [&](const Rectangle& in) {
      for (std::int64_t y = std::max<std::int64_t>(in.y0, 0);
           y < std::min(in.y1, static_cast<std::int64_t>(height)); ++y)
        for (std::int64_t x = std::max<std::int64_t>(in.x0, 0);
             x < std::min(in.x1, static_cast<std::int64_t>(width)); ++x)
          if (at(x, y) == kOccupied) return true;
      return false;
    };
    const auto is_beside_wall = [&](const Rectangle& one) {
      return any_occupied({one.x0 - 1, one.x1 + 1, one.y0, one.y1}) ||
             any_occupied({one.x0, one.x1, one.y0 - 1, one.y1 + 1});
    };
    some.erase(std::remove_if(some.begin(), some.end(), is_beside_wall), some.end());
    for (const Rectangle& one : some)
      for (std::int64_t y = one.y0; y < one.y1; ++y)
        for (std::int64_t x = one.x0; x < one.x1; ++x) at(x, y) = kOccupied;
  }
  [[nodiscard]] std::uint8_t& at(std::int64_t column, std::int64_t row) {
    return pixels[static_cast<std::size_t>(row) * width + static_cast<std::size_t>(column)];
  }
  /// Binary PGM (P5).
  [[nodiscard]] std::string pgm() const {
    std::string bytes = "P5\n" + std::to_string(width) + " " + std::to_string(height) + "\n255\n";
    bytes.append(reinterpret_cast<const char*>(pixels.data()), pixels.size());
    return bytes;
  }
  /// @param image the image file's name, relative to the YAML file.
  [[nodiscard]] std::string yaml(const std::string& image) const {
    std::string quoted = "'";
    for (const char c : image) quoted += c == '\'' ? std::string("''") : std::string(1, c);
    const auto number = [](double value) {  // YAML 1.1 takes 1e-05 for text.
      std::string text = shortest_text(value);
      const std::size_t exponent = text.find('e');
      if (text.find('.') == std::string::npos) text.insert(std::min(exponent, text.size()), ".0");
      return text;
    };
    return "image: " + quoted + "'\nmode: trinary\nresolution: " + number(cell_size) + "\norigin: [" +
           number(origin.x()) + ", " + number(origin.y()) +
           ", 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
  }
};

/// The image of a 2-D map, or of a slice through a 3-D one: a pixel is occupied if some occupied cell
/// overlaps it, else free if some free one does, else unknown. Free cells that hold something thin, see
/// ThinThings, are occupied, too: in a 2-D map those alone that share no side with an occupied pixel, as
/// walls would become a pixel thicker. Of large occupied cells only what is near free space is drawn, see
/// MapServerOptions::wall_depth. It is as large as what is known.
/// @throws std::invalid_argument if an option is out of bounds or does not fit the map, if nothing is known
///   there, or if the image had more than 2^30 pixels.
template <class Map>
[[nodiscard]] MapServerImage map_server_image(const Map& map, const MapServerOptions& options = {}) {
  constexpr int D = Map::kDim;
  static_assert(D == 2 || D == 3, "an image is of a 2-D map, or of a slice through a 3-D one");
  const double unit = map.options().min_cell_size;
  const double pixel = options.cell_size.value_or(unit);
  const CellsAlong axis(unit, 0.0, pixel);
  double bottom = -std::numeric_limits<double>::infinity();
  double top = std::numeric_limits<double>::infinity();
  const auto wrong_height = [&](const char* expected) {
    return OptionError(
        "height",
        describe_number(options.height->first) + " to " + describe_number(options.height->second) + " m",
        expected);
  };
  if (options.height) {
    if (D != 3) throw OptionError("height", "", "a map in the plane has none");
    if (!(options.height->first < options.height->second)) throw wrong_height("from low to high");
    bottom = CellsAlong::whole(options.height->first / unit);
    top = CellsAlong::whole(options.height->second / unit);
  }
  const WallFronts fronts(map, options.wall_depth);
  const auto& geometry = map.tree().geometry();
  const ThinThings things(map);
  constexpr std::uint8_t kLarge = 1;  // Until its fronts are drawn.
  constexpr std::uint8_t kThin = 2;   // Until what is around it is drawn.
  // Calls visit(first x, last x, first y, last y, pixel) for what is known, in pixels about 0.
  const auto for_each_known = [&](const auto& visit) {
    for_each_leaf(map.tree(), [&](const auto& leaf) {
      const CellState state = things.state_in_column(leaf.cell());
      if (state == CellState::unknown) return;
      const std::int64_t edge = geometry.edge(leaf.index.level);
      const auto& lower = leaf.index.lower;
      if constexpr (D == 3)
        if (!(static_cast<double>(lower[2]) < top && static_cast<double>(lower[2] + edge) > bottom)) return;
      const bool is_large = edge > 1 && !fronts.draw_all();
      const std::uint8_t drawn = state == CellState::free               ? MapServerImage::kFree
                                 : D == 2 && things.are_in(leaf.cell()) ? kThin
                                 : is_large                             ? kLarge
                                                                        : MapServerImage::kOccupied;
      visit(axis.first(lower[0]), axis.last(lower[0] + edge), axis.first(lower[1]),
            axis.last(lower[1] + edge), drawn);
    });
  };
  constexpr std::int64_t kMost = std::numeric_limits<std::int64_t>::max();
  std::int64_t left = kMost, right = -kMost, low = kMost, high = -kMost;
  for_each_known([&](std::int64_t x0, std::int64_t x1, std::int64_t y0, std::int64_t y1, std::uint8_t) {
    left = std::min(left, x0);
    right = std::max(right, x1);
    low = std::min(low, y0);
    high = std::max(high, y1);
  });
  if (left == kMost && options.height) throw wrong_height("heights of observed cells");
  if (left == kMost) throw std::invalid_argument("the map is empty: there is nothing to draw");
  if (static_cast<double>(right - left) * static_cast<double>(high - low) > 0x1p30)
    throw std::invalid_argument("an image of " + std::to_string(right - left) + " x " +
                                std::to_string(high - low) +
                                " pixels: at most 2^30; choose a larger cell_size");
  MapServerImage image;
  image.width = static_cast<std::size_t>(right - left);
  image.height = static_cast<std::size_t>(high - low);
  image.cell_size = pixel;
  image.origin = Vector<2>(static_cast<double>(left) * pixel, static_cast<double>(low) * pixel);
  image.pixels.assign(image.width * image.height, MapServerImage::kUnknown);
  std::vector<MapServerImage::Rectangle> thin;
  for_each_known([&](std::int64_t x0, std::int64_t x1, std::int64_t y0, std::int64_t y1, std::uint8_t value) {
    if (value == kThin) {
      thin.push_back({x0 - left, x1 - left, high - y1, high - y0});
      value = MapServerImage::kFree;
    }
    for (std::int64_t y = y0; y < y1; ++y) {
      auto* const row = image.pixels.data() + static_cast<std::size_t>(high - 1 - y) * image.width;
      for (std::int64_t x = x0 - left; x < x1 - left; ++x)  // Occupied cells stay, whichever comes first.
        row[x] = row[x] == MapServerImage::kUnknown ? value : std::min(row[x], value);
    }
  });
  fronts.draw<2>(image.pixels.data(), {image.height, image.width}, pixel, kLarge, MapServerImage::kFree,
                 MapServerImage::kOccupied, MapServerImage::kUnknown);
  image.occupy_single(std::move(thin));
  return image;
}

/// Writes an image as .pgm beside the YAML file of the same name; see commit_together().
/// @param path must end in .yaml, or std::invalid_argument is thrown.
/// @throws std::filesystem::filesystem_error naming a file that cannot be written, and the system's reason.
inline void save_map_server(const MapServerImage& image, const std::filesystem::path& path) {
  if (path.extension() != ".yaml")
    throw std::invalid_argument(path.string() + ": the name of a map_server file must end in .yaml");
  std::filesystem::path pgm = path;
  pgm.replace_extension(".pgm");
  std::vector<ReplacedFile> files;
  files.emplace_back(pgm);
  files.emplace_back(path);
  files[0].write(image.pgm());
  files[1].write(image.yaml(pgm.filename().string()));
  commit_together(files);
}

}  // namespace ndtree
