// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Distance fields that follow a map.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/cells.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/distance_field.hpp"
#include "ndtree/query/field_grid.hpp"
#include "ndtree/query/point_packet.hpp"
#include "ndtree/query/region.hpp"

namespace ndtree {

namespace detail {

/// What a change of a map changes in a field. Points are looked at in small packets: of these, only those
/// are touched for which something that came or went is no farther than what was nearest.
template <class Map>
class FieldUpdate {
 public:
  static constexpr int D = Map::kDim;
  using Shape = typename FieldGrid<D>::Shape;
  using Block = GridBlock<D>;
  using Packet = PointPacket<D>;
  using Values = typename Packet::Values;
  struct NewValue {
    std::size_t index;
    float value;
  };

  /// @param came, went boxes that have become obstacles, and that are none any longer.
  FieldUpdate(const Map& map, const DistanceField<D>& field, const std::vector<Box<D>>& came,
              const std::vector<Box<D>>& went)
      : field_(field),
        limit_(field.max_distance()),
        states_(map, field.unknown()),
        obstacles_(map, states_.obstacles, pace_),
        others_(map, states_.others, pace_),
        outside_(outside_of(map.tree().box(map.tree().root().index),
                            field.grid().box().inflated(field.max_distance()))),
        came_(came),
        went_(went) {}

  /// The points whose values are others now.
  [[nodiscard]] std::vector<NewValue> run() {
    for_each_part(
        Block{{}, field_.shape()}, kPackets * Packet::kSide, Packet::kSide,
        [&](const Block& block) { return any_within(field_.grid().box_of(block), field_.max_distance()); },
        [&](const Block& block) { look_at_packets(block); });
    return std::move(changed_);
  }

 private:
  /// More than errors of rounding, of a squared distance in float32 and of its root, relatively ...
  static constexpr double kRounding = 1e-6;
  /// The rounding of distances whose square is too small for that: the root of the smallest normal number
  /// [m].
  static constexpr double kSmallest = 1.1e-19;
  /// Along each side of a block.
  static constexpr std::size_t kPackets = 4;

  [[nodiscard]] bool any_within(const Box<D>& points, double distance) const {
    const double reach = distance * (1.0 + 2.0 * kRounding) + kSmallest;
    return came_.any_within(points, reach) || went_.any_within(points, reach);
  }
  void look_at_packets(const Block& block) {
    // The largest distance of each packet, by rows of packets.
    Shape sides;
    sides.fill(Packet::kSide);
    Shape bar = sides;
    bar[D - 1] *= kPackets;
    farthest_.clear();
    for_each_tile(block, bar, [&](const Block& packets) {
      std::array<float, kPackets * Packet::kSide> largest{};
      for_each_row(packets, [&](const Shape& at, std::size_t length) {
        pace_.spend();
        const float* const row = field_.values().data() + field_.index(at);
        for (std::size_t i = 0; i < length; ++i) largest[i] = larger(largest[i], std::abs(row[i]));
      });
      for (std::size_t i = packets.first[D - 1]; i < packets.last[D - 1]; i += Packet::kSide) {
        const float* const first = largest.data() + (i - packets.first[D - 1]);
        farthest_.push_back(*std::max_element(first, first + Packet::kSide));
      }
    });
    const float* farthest = farthest_.data();
    const float largest = *std::max_element(farthest_.begin(), farthest_.end());
    if (!any_within(field_.grid().box_of(block), static_cast<double>(largest))) return;
    for_each_tile(block, sides, [&](const Block& packet) {
      const Box<D> points = field_.grid().box_of(packet);
      if (any_within(points, static_cast<double>(*farthest++))) look_at(packet, points);
    });
  }
  // By value, and in lanes, so that compilers make vectors of loops.
  [[nodiscard]] static float larger(float a, float b) { return a < b ? b : a; }
  [[nodiscard]] static float largest_of(const Values& values) {
    constexpr std::size_t kLanes = std::min<std::size_t>(4, Packet::kPoints);
    std::array<float, kLanes> largest;
    std::copy_n(values.begin(), kLanes, largest.begin());
    for (std::size_t i = 0; i < Packet::kPoints; i += kLanes)
      for (std::size_t k = 0; k < kLanes; ++k) largest[k] = larger(largest[k], values[i + k]);
    return *std::max_element(largest.begin(), largest.end());
  }

  /// @param points around those of the block.
  void look_at(const Block& block, const Box<D>& points) {
    pace_.spend(16);
    Packet packet(field_.grid(), block);
    Values before;
    before.fill(std::numeric_limits<float>::quiet_NaN());
    for_each_row(block, [&](const Shape& at, std::size_t length) {
      const float* const row = field_.values().data() + field_.index(at);
      float* const values = before.data() + Packet::lane(block, at);
      for (std::size_t i = 0; i < length; ++i) values[i] = row[i];
    });
    Values outside;  // Squared distances below which something matters, of some points; -1 for the others.
    Values inside;
    constexpr auto kRounded = static_cast<float>(1.0 + kRounding);
    for (std::size_t i = 0; i < Packet::kPoints; ++i) {
      const float squared = larger(before[i] * before[i] * kRounded, std::numeric_limits<float>::min());
      const float reach = squared < limit_.squared() ? squared : limit_.squared();
      outside[i] = before[i] > 0.0f ? reach : -1.0f;
      inside[i] = before[i] <= 0.0f ? reach : -1.0f;
    }
    // Of a point outside obstacles, its value is the distance to the nearest: what came may be nearer; only
    // if the nearest is among what went, all have to be looked at. Inside it is the other way round.
    Values after = before;
    Values open;
    open.fill(-1.0f);
    bool any = false;
    const auto decide = [&](const BoxTree<D>& gained, const BoxTree<D>& lost, Values& reach, float sign) {
      if (show(gained, points, reach, packet)) {
        any = true;
        for (std::size_t i = 0; i < Packet::kPoints; ++i) {
          const float squared = packet.squared()[i];
          const float distance = limit_.distance(squared);
          if (!(squared < reach[i]) || distance > std::abs(before[i])) continue;
          if (squared > 0.0f)
            after[i] = sign * distance;
          else
            open[i] = limit_.squared();
          reach[i] = -1.0f;
        }
      }
      if (show(lost, points, reach, packet)) {
        any = true;
        for (std::size_t i = 0; i < Packet::kPoints; ++i)
          if (packet.squared()[i] < reach[i]) open[i] = limit_.squared();
      }
    };
    decide(came_, went_, outside, 1.0f);
    decide(went_, came_, inside, -1.0f);
    if (!any) return;
    find(open, packet, after);
    for_each_row(block, [&](const Shape& at, std::size_t length) {
      const std::size_t index = field_.index(at);
      const std::size_t first = Packet::lane(block, at);
      for (std::size_t i = 0; i < length; ++i)
        if (after[first + i] != before[first + i]) changed_.push_back({index + i, after[first + i]});
    });
  }
  /// Shows some points what is in reach of them, and whether there is anything.
  [[nodiscard]] bool show(const BoxTree<D>& boxes, const Box<D>& points, const Values& reach,
                          Packet& packet) const {
    const auto farthest = static_cast<double>(largest_of(reach));
    bool any = false;
    if (farthest < 0.0) return false;
    packet.squared() = reach;
    boxes.for_each_within(
        points, farthest * (1.0 + kRounding), [&](const Box<D>& box) { return packet.is_nearer(box); },
        [&](std::uint32_t number) {
          packet.take(boxes.box(number));
          any = true;
        });
    return any;
  }

  /// Values of open points, as for a new field. @param open squared distances that matter, or -1.
  void find(const Values& open, Packet& packet, Values& after) const {
    if (largest_of(open) < 0.0f) return;
    packet.squared() = open;
    show(obstacles_, states_.obstacles.unknown, packet);
    Values inside = open;
    for (std::size_t i = 0; i < Packet::kPoints; ++i) {
      const float squared = packet.squared()[i];
      if (squared >= 0.0f) after[i] = limit_.distance(squared);
      if (squared != 0.0f) inside[i] = -1.0f;
    }
    if (largest_of(inside) < 0.0f) return;
    packet.squared() = inside;
    show(others_, states_.others.unknown, packet);
    for (std::size_t i = 0; i < Packet::kPoints; ++i)
      if (packet.squared()[i] >= 0.0f) after[i] = 0.0f - limit_.distance(packet.squared()[i]);
  }
  void show(const PacketSearch<Map>& cells, bool is_unknown_wanted, Packet& packet) const {
    cells.show(packet);
    if (is_unknown_wanted)
      for (const Box<D>& box : outside_) packet.take(box);
  }

  const DistanceField<D>& field_;
  DistanceLimit limit_;
  ObstacleStates states_;
  Pace pace_;
  PacketSearch<Map> obstacles_;
  PacketSearch<Map> others_;
  std::vector<Box<D>> outside_;  // Of the map: unknown space.
  BoxTree<D> came_;
  BoxTree<D> went_;
  std::vector<float> farthest_;  // Of each packet of a block.
  std::vector<NewValue> changed_;
};

}  // namespace detail

/// Brings a field up to date after a map has changed: as distance_field() would fill it in now. Only points
/// are visited for which something that changed is no farther than their nearest obstacle was; they search
/// the map again only if that nearest obstacle has changed.
/// @param before the map as it was when the field was made or updated, its snapshot().
/// @throws std::bad_alloc, Cancelled; the field is then as it was. As changes().
template <class Map>
void update(DistanceField<Map::kDim>& field, const Map& before, const Map& map) {
  constexpr int D = Map::kDim;
  const RegionStates obstacles = obstacles_of(map, field.unknown());
  const Box<D> reach = field.grid().box().inflated(field.max_distance());
  std::vector<Box<D>> came;
  std::vector<Box<D>> went;
  Pace pace;
  const auto note = [&](const Change<D>& change) {
    pace.spend();
    const bool is_obstacle = contains(obstacles, change.after);
    if (contains(obstacles, change.before) == is_obstacle) return;
    const Box<D> box = map.tree().geometry().box(change.index);
    if (box.touches(reach)) (is_obstacle ? came : went).push_back(box);
  };
  for_each_change(before, map, note, ChangeOf::columns);
  if (came.empty() && went.empty()) return;
  const auto new_values = detail::FieldUpdate<Map>(map, field, came, went).run();
  last_checkpoint();
  for (const auto& [index, value] : new_values) field.values()[index] = value;
}

}  // namespace ndtree
