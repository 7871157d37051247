// SPDX-License-Identifier: BSD-3-Clause
// Maps of all kinds that Python offers, made from bytes.
#include "maps.hpp"

#include <algorithm>
#include <string>
#include <vector>

#include "ndtree/io/octomap_file.hpp"

namespace ndtree::fuzz {

template <>
std::array<MapKind, 3> map_kinds<2, 2>();
template <>
std::array<MapKind, 3> map_kinds<3, 2>();
template <>
std::array<MapKind, 3> map_kinds<4, 2>();
template <>
std::array<MapKind, 3> map_kinds<2, 3>();
template <>
std::array<MapKind, 3> map_kinds<3, 3>();
template <>
std::array<MapKind, 3> map_kinds<4, 3>();
template <>
std::array<MapKind, 3> map_kinds<2, 4>();

namespace {

const std::vector<MapKind>& all_kinds() {
  static const std::vector<MapKind> all = [] {
    std::vector<MapKind> kinds;
    for (const auto& some : {map_kinds<2, 2>(), map_kinds<3, 2>(), map_kinds<4, 2>(), map_kinds<2, 3>(),
                             map_kinds<3, 3>(), map_kinds<4, 3>(), map_kinds<2, 4>()})
      kinds.insert(kinds.end(), some.begin(), some.end());
    return kinds;
  }();
  return all;
}

/// A map's file around a payload, with the checksum that belongs there.
std::string mended(std::string_view payload, bool has_layers) {
  ByteWriter file;
  file.bytes().append(detail::kMapFileMagic);
  file.put(has_layers ? detail::kMapFileVersion : detail::kMapFileVersionOfMap);
  file.put(static_cast<std::uint64_t>(payload.size()));
  file.bytes().append(payload);
  file.put(crc32(file.bytes()));
  return file.bytes();
}

}  // namespace

/// The first byte: the kind of map, and whether it stands beside a list.
void insertion(Bytes bytes) {
  const std::vector<MapKind>& kinds = all_kinds();
  const std::size_t chosen = bytes.below(2 * kinds.size());
  const MapKind& kind = kinds[chosen % kinds.size()];
  chosen < kinds.size() ? kind.insert_scans(bytes) : kind.compare_with_list(bytes);
}

/// The first byte: whether the rest is a payload, and one with layers; the second, how much of the end is a
/// scan.
void map_file(Bytes bytes) {
  const std::uint8_t how = bytes.byte();
  const bool is_payload = (how & 3u) != 0;
  const std::size_t tail = bytes.byte();
  const std::string_view all = bytes.rest();
  const std::string_view payload = all.substr(0, all.size() - std::min(tail, all.size()));
  Bytes more(reinterpret_cast<const std::uint8_t*>(all.data()) + payload.size(), all.size() - payload.size());
  const std::string file = is_payload ? mended(payload, (how & 4u) != 0) : std::string(payload);
  MapFileHeader header;
  if (!accepted([&] { header = map_file_header(file); })) return;
  for (const MapKind& kind : all_kinds())  // A file says which of them it is.
    if (header.dim == kind.dim && header.branching == kind.branching && header.refinement == kind.refinement)
      return kind.read_map(file, more);
  accepted([&] { (void)from_bytes<AdaptiveMap<2, 2>>(file); });
}

void octomap_file(Bytes bytes) {
  const std::uint8_t kind = bytes.byte();
  const std::string file(bytes.rest());
  MapOptions options;
  options.max_memory = kMostMemory;
  accepted([&] {
    if ((kind & 1u) != 0) {
      octomap_from_bytes<FixedMap<2, 3>>(file, options).check_invariants();
      return;
    }
    const auto map = octomap_from_bytes<AdaptiveMap<2, 3>>(file, options);
    map.check_invariants();
    const std::string written = octomap_bytes(map, OctomapFormat::full);
    const auto again = octomap_from_bytes<AdaptiveMap<2, 3>>(written, options);
    require(octomap_bytes(again, OctomapFormat::full).size() == written.size(),
            "a file of a file's map has as many nodes");
  });
}

}  // namespace ndtree::fuzz
