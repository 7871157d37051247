// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The map's own file: options, counters and the tree, versioned and with a checksum.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "ndtree/core/cancel.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "ndtree/tree/nd_tree.hpp"

namespace ndtree {

/// What a map file says about itself: enough to choose the type to load it into.
struct MapFileHeader {
  std::uint32_t version = 0;
  int branching = 0;
  int dim = 0;
  std::string refinement;  ///< As in the refinement policy's kName.
};

// Layout, little-endian: 8 bytes magic, u32 version, u64 length of all that follows but the checksum,
// u32 branching, u32 dim, text refinement, u32 number of options, each text name and f64 value, 4 u64
// counters, i32 level and D i64 lower corner of the root, the nodes depth first, u32 CRC-32 of all before it.
// A text is u16 length and bytes. A node is the u32 0x80000000 if it has children, which follow; 0 for a leaf
// that no beam has passed; else the cell's words, each u32: first its counts, then its log-odds as f32.
// Only where there are layers is the version 6; after the nodes stand then u32 number of layers, of each text
// name, text rule, u64 number of bytes, and these: root and nodes as those of the map. Versions 3 and 4 have
// 3 counters, without that of scans.
namespace detail {

inline constexpr std::string_view kMapFileMagic{"\x89NDT\r\n\x1a\n", 8};
inline constexpr std::uint32_t kMapFileVersion = 6;          // There are layers.
inline constexpr std::uint32_t kMapFileVersionOfMap = 5;     // There are none.
inline constexpr std::uint32_t kMapFileVersionOfLayers = 4;  // There are layers, and scans are not counted.
inline constexpr std::uint32_t kOldestMapFileVersion = 2;    // No cell was partly seen.
inline constexpr std::uint32_t kInnerNode = 0x80000000u;
inline constexpr std::size_t kMapFilePreamble = 20;
inline constexpr std::size_t kStepsOfNode = 4;  // Of a Pace.

/// @param coarsest level of cells that are ever updated: above it, what is unknown is one leaf, whether or
/// not beams have passed by. @returns whether the node is written as an unknown leaf.
template <class Tree>
bool write_nodes(const Tree& tree, const typename Tree::NodeType& node, int level, int coarsest,
                 ByteWriter& out, Pace& pace) {
  if (node.is_leaf()) {
    const auto words = node.cell().words();
    for (std::size_t i = 0; i < words.size() && (i == 0 || words[0] != 0); ++i) out.put(words[i]);
    return words[0] == 0;
  }
  pace.spend(kStepsOfNode * Tree::kNumChildren);
  const std::size_t begin = out.bytes().size();
  out.put(kInnerNode);
  bool is_unknown = level > coarsest;
  for (int j = 0; j < Tree::kNumChildren; ++j)
    is_unknown = write_nodes(tree, tree.children(node)[j], level - 1, coarsest, out, pace) && is_unknown;
  if (!is_unknown) return false;
  out.bytes().resize(begin);
  out.put(std::uint32_t{0});
  return true;
}

/// The root's place, and all nodes. @param coarsest as in write_nodes().
template <class Tree>
void write_tree(const Tree& tree, int coarsest, ByteWriter& out) {
  const auto root = tree.root();
  out.put(static_cast<std::int32_t>(root.index.level));
  for (const std::int64_t coordinate : root.index.lower) out.put(coordinate);
  Pace pace;
  write_nodes(tree, *root.node, root.index.level, coarsest, out, pace);
}

template <class Tree>
void read_nodes(Tree& tree, typename Tree::NodeType& node, int level, ByteReader& in, Pace& pace) {
  const auto word = in.get<std::uint32_t>();
  if (word == kInnerNode) {
    if (level <= tree.geometry().finest_level())
      throw std::runtime_error("a node below the smallest cell is divided, at byte " +
                               std::to_string(in.position()));
    pace.spend(kStepsOfNode * Tree::kNumChildren);
    tree.split_node(node);
    auto* children = tree.children(node);
    for (int j = 0; j < Tree::kNumChildren; ++j) read_nodes(tree, children[j], level - 1, in, pace);
    return;
  }
  if (word == 0) return;  // Never observed, as the cell is already.
  std::array<std::uint32_t, Tree::Cell::kNumWords> words{word};
  for (std::size_t i = 1; i < words.size(); ++i) words[i] = in.get<std::uint32_t>();
  const auto cell = Tree::Cell::from_words(words);
  if (cell.words() != words)
    throw std::runtime_error("a cell with counts that no map writes, at byte " +
                             std::to_string(in.position()));
  node.become_leaf(cell);
}

/// Into a tree of the same lattice.
template <class Tree>
void read_tree(Tree& tree, ByteReader& in) {
  CellIndex<Tree::kDim> root;
  root.level = in.get<std::int32_t>();
  for (auto& coordinate : root.lower) coordinate = in.get<std::int64_t>();
  tree.reset(root);
  Pace pace;
  read_nodes(tree, *tree.root().node, root.level, in, pace);
}

/// Checks magic, version, length and checksum. @returns what lies between preamble and checksum.
inline std::string_view checked_payload(std::string_view bytes, MapFileHeader& header) {
  if (bytes.substr(0, kMapFileMagic.size()) != kMapFileMagic)
    throw std::runtime_error(bytes.empty() ? "the file is empty: not an ndtree map" : "not an ndtree map");
  ByteReader in(bytes.substr(kMapFileMagic.size()));
  header.version = in.get<std::uint32_t>();
  if (header.version < kOldestMapFileVersion || header.version > kMapFileVersion)
    throw std::runtime_error("format version " + std::to_string(header.version) +
                             ": this ndtree reads versions " + std::to_string(kOldestMapFileVersion) +
                             " to " + std::to_string(kMapFileVersion));
  const auto length = in.get<std::uint64_t>();
  const std::uint64_t held = bytes.size() - kMapFilePreamble;
  if (held < 4 || length != held - 4)
    throw std::runtime_error("truncated or overlong: " + std::to_string(bytes.size()) + " bytes instead of " +
                             std::to_string(length + kMapFilePreamble + 4));
  const auto stored = ByteReader(bytes.substr(bytes.size() - 4)).get<std::uint32_t>();
  if (stored != crc32(bytes.substr(0, bytes.size() - 4)))
    throw std::runtime_error("damaged: the checksum does not match");
  return bytes.substr(kMapFilePreamble, length);
}

inline void read_header(ByteReader& in, MapFileHeader& header) {
  header.branching = static_cast<int>(in.get<std::uint32_t>());
  header.dim = static_cast<int>(in.get<std::uint32_t>());
  header.refinement = in.get_text();
}

}  // namespace detail

/// A layer in a map file.
struct StoredLayer {
  std::string name;
  std::string rule;   ///< As the value's rule().
  std::string bytes;  ///< See layer_file.hpp.
};

namespace detail {

/// @param refinement name of the map's.
template <class Cells>
[[nodiscard]] std::string to_bytes(const Cells& map, const char* refinement,
                                   const std::vector<StoredLayer>& layers) {
  ByteWriter file;
  file.bytes().append(kMapFileMagic);
  file.put(layers.empty() ? kMapFileVersionOfMap : kMapFileVersion);
  file.put(std::uint64_t{0});  // The length of what follows, when it is known.
  file.put(static_cast<std::uint32_t>(Cells::kBranching));
  file.put(static_cast<std::uint32_t>(Cells::kDim));
  file.put_text(refinement);
  std::uint32_t num_options = 0;
  for_each_option(map.options(), [&](const char*, double) { ++num_options; });
  file.put(num_options);
  for_each_option(map.options(), [&](const char* name, double value) {
    file.put_text(name);
    file.put(value);
  });
  file.put(map.counters().updates);
  file.put(map.counters().splits);
  file.put(map.counters().merges);
  file.put(map.counters().scans);
  write_tree(map.tree(), map.coarsest_level(), file);
  if (!layers.empty()) file.put(static_cast<std::uint32_t>(layers.size()));
  for (const StoredLayer& layer : layers) {
    file.put_text(layer.name);
    file.put_text(layer.rule);
    file.put(static_cast<std::uint64_t>(layer.bytes.size()));
    file.bytes().append(layer.bytes);
  }

  file.put_at(kMapFilePreamble - sizeof(std::uint64_t),
              std::uint64_t{file.bytes().size() - kMapFilePreamble});
  file.put(crc32(file.bytes()));
  return std::move(file.bytes());
}

inline std::vector<StoredLayer> read_layers(ByteReader& in) {
  std::vector<StoredLayer> layers;
  for (auto remaining = in.get<std::uint32_t>(); remaining > 0; --remaining) {
    StoredLayer layer;
    layer.name = in.get_text();
    layer.rule = in.get_text();
    layer.bytes = std::string(in.take(in.get<std::uint64_t>()));
    for (const StoredLayer& other : layers)
      if (other.name == layer.name)
        throw std::runtime_error("two layers are called " + describe_text(layer.name));
    layers.push_back(std::move(layer));
  }
  return layers;
}

}  // namespace detail

/// A map as the bytes of its file. The same map gives the same bytes, however it came about.
/// @param layers that the map carries; their names are different.
template <class Map>
[[nodiscard]] std::string to_bytes(const Map& map, const std::vector<StoredLayer>& layers = {}) {
  return detail::to_bytes(map.cells(), Map::RefinementType::kName, layers);
}

/// Which kind of map these bytes hold. @throws std::runtime_error if they are not a whole, undamaged map
/// file.
[[nodiscard]] inline MapFileHeader map_file_header(std::string_view bytes) {
  MapFileHeader header;
  ByteReader in(detail::checked_payload(bytes, header));
  detail::read_header(in, header);
  return header;
}

/// The map that to_bytes() wrote.
/// @param layers if given, takes what the map carries; else that is left out.
/// @throws std::runtime_error if the bytes are damaged, or hold a map of another type than `Map`.
template <class Map>
[[nodiscard]] Map from_bytes(std::string_view bytes, std::vector<StoredLayer>* layers = nullptr) {
  using Tree = typename Map::Tree;
  MapFileHeader header;
  ByteReader in(detail::checked_payload(bytes, header));
  detail::read_header(in, header);
  if (header.branching != Map::kBranching || header.dim != Map::kDim ||
      header.refinement != Map::RefinementType::kName)
    throw std::runtime_error("holds a map with branching " + std::to_string(header.branching) + ", dim " +
                             std::to_string(header.dim) + " and refinement " +
                             describe_text(header.refinement) + ", not branching " +
                             std::to_string(Map::kBranching) + ", dim " + std::to_string(Map::kDim) +
                             " and '" + Map::RefinementType::kName + "'");
  typename Map::Options options;
  for (auto remaining = in.get<std::uint32_t>(); remaining > 0; --remaining) {
    const std::string name = in.get_text();
    const auto value = in.get<double>();
    bool known = false;
    for_each_option(options, [&](const char* option, double& place) {
      if (name == option) {
        place = value;
        known = true;
      }
    });
    if (!known)
      throw std::runtime_error("has an option " + describe_text(name) + " that this ndtree does not know");
  }
  typename Map::Counters counters;
  counters.updates = in.get<std::uint64_t>();
  counters.splits = in.get<std::uint64_t>();
  counters.merges = in.get<std::uint64_t>();
  if (header.version >= detail::kMapFileVersionOfMap) counters.scans = in.get<std::uint64_t>();
  try {
    options.validate();
    Tree tree(options.min_cell_size, options.num_levels(Map::kBranching));
    detail::read_tree(tree, in);
    std::vector<StoredLayer> stored;
    if (header.version == detail::kMapFileVersion || header.version == detail::kMapFileVersionOfLayers)
      stored = detail::read_layers(in);
    if (!in.at_end())
      throw std::runtime_error("nodes end at byte " + std::to_string(in.position()) + " too early");
    Map map(options, std::move(tree), counters);
    map.check_invariants();
    if (layers != nullptr) *layers = std::move(stored);
    return map;
  } catch (const std::logic_error& error) {  // Options or invariants that no map writes.
    throw std::runtime_error(std::string("damaged: ") + error.what());
  }
}

/// Writes a map's file; it appears whole or not at all. @throws std::runtime_error naming file and reason,
/// std::invalid_argument if the name ends as those of formats that other functions of io/ write.
template <class Map>
void save(const Map& map, const std::filesystem::path& path) {
  for (const char* const ending : {".bt", ".ot", ".yaml", ".pgm", ".ply"})
    if (path.extension() == ending)
      throw std::invalid_argument(path.string() +
                                  ": another format's ending, expected .ndt; see save_octomap(), "
                                  "save_map_server() and save_ply()");
  write_file(path, to_bytes(map));
}

/// Reads what save() wrote. @throws std::runtime_error naming file and reason.
template <class Map>
[[nodiscard]] Map load(const std::filesystem::path& path) {
  const std::string bytes = read_file(path);
  try {
    return from_bytes<Map>(bytes);
  } catch (const std::runtime_error& error) {
    throw std::runtime_error(path.string() + ": " + error.what());
  }
}

}  // namespace ndtree
