// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Distance fields that follow a map.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "ndtree/core/box_tree.hpp"
#include "ndtree/core/cancel.hpp"
#include "ndtree/core/types.hpp"
#include "ndtree/query/changes.hpp"
#include "ndtree/query/distance_field.hpp"
#include "ndtree/query/distance_transform.hpp"
#include "ndtree/query/field_grid.hpp"
#include "ndtree/query/region.hpp"

namespace ndtree {

namespace detail {

/// What a change of a map changes in a field.
template <class Map>
class FieldUpdate {
 public:
  static constexpr int D = Map::kDim;
  using Shape = typename FieldGrid<D>::Shape;
  using Block = GridBlock<D>;
  struct NewValue {
    std::size_t index;
    float value;
  };

  /// @param came, went boxes that have become obstacles, and that are none any longer.
  FieldUpdate(const Map& map, const DistanceField<D>& field, const std::vector<Box<D>>& came,
              const std::vector<Box<D>>& went)
      : field_(field), values_(map, field, pace_), came_(came), went_(went) {}

  /// The points whose values are others now.
  [[nodiscard]] std::vector<NewValue> run() {
    constexpr std::size_t kSide = D == 2 ? 32 : D == 3 ? 16 : 6;
    for_each_part(
        Block{{}, field_.shape()}, kSide,
        [&](const Block& block) {
          const Box<D> points = field_.grid().box_of(block);
          return came_.any_within(points, field_.max_distance()) ||
                 went_.any_within(points, field_.max_distance());
        },
        [&](const Block& block) { look_at(block); });
    return std::move(changed_);
  }

 private:
  /// Of a point outside obstacles, its value is the distance to the nearest: what came may be nearer; only if
  /// the nearest is among what went, all have to be looked at. Inside it is the other way round.
  void look_at(const Block& block) {
    float largest = 0.0f;
    any_place(block.first, block.last, [&](const Shape& at) {
      largest = std::max(largest, std::abs(field_.values()[field_.index(at)]));
      return false;
    });
    constexpr double kRounding = 1e-5;  // Of values, relatively.
    const double reach = static_cast<double>(largest) * (1.0 + kRounding) + 0.01 * field_.cell_size();
    const Box<D> around = field_.grid().box_of(block).inflated(reach);
    const std::vector<Box<D>> near_came = touching(came_, around);
    const std::vector<Box<D>> near_went = touching(went_, around);
    if (near_came.empty() && near_went.empty()) return;
    DistanceTransform<D> transform(field_.grid(), block, reach, pace_);
    const std::vector<float> to_came = transform.squared_distances(near_came);
    const std::vector<float>& to_went = transform.squared_distances(near_went);
    BlockValues<D> values(block);
    std::vector<bool> is_open(to_came.size());
    Block open;
    float largest_open = 0.0f;
    std::size_t i = 0;
    any_place(block.first, block.last, [&](const Shape& at) {
      const float before = field_.values()[field_.index(at)];
      const bool is_outside = before > 0.0f;
      const float distance = std::abs(before);
      const auto distance_to = [&](const std::vector<float>& squared) {
        return squared[i] < transform.limit() ? values_.value(squared[i], transform.limit())
                                              : std::numeric_limits<float>::infinity();
      };
      const float gain = distance_to(is_outside ? to_came : to_went);
      const float loss = distance_to(is_outside ? to_went : to_came);
      values[at] = before;
      if (gain == 0.0f || (loss <= distance && gain > distance)) {
        is_open[i] = true;
        open.add(at);
        largest_open = std::max(largest_open, distance);
      } else if (gain < distance) {
        values[at] = is_outside ? gain : 0.0f - gain;
      }
      ++i;
      return false;
    });
    // What went often was at the surface of what is still there.
    values_.find(values, open, static_cast<double>(largest_open) + 1.5 * field_.cell_size(),
                 [&](const Shape& at) { return is_open[block.index(at)]; });
    any_place(block.first, block.last, [&](const Shape& at) {
      const std::size_t index = field_.index(at);
      if (values[at] != field_.values()[index]) changed_.push_back({index, values[at]});
      return false;
    });
  }
  [[nodiscard]] static std::vector<Box<D>> touching(const BoxTree<D>& tree, const Box<D>& region) {
    std::vector<Box<D>> boxes;
    tree.for_each_touching(region, [&](std::uint32_t number) { boxes.push_back(tree.box(number)); });
    return boxes;
  }

  const DistanceField<D>& field_;
  Pace pace_;
  FieldValues<Map> values_;
  BoxTree<D> came_;
  BoxTree<D> went_;
  std::vector<NewValue> changed_;
};

}  // namespace detail

/// Brings a field up to date after a map has changed: as distance_field() would fill it in now. All that is
/// looked at again are points for which something that changed is no farther than what was nearest, and of
/// these, beside what changed, only those whose nearest has changed.
/// @param changes of the map since the field was made or updated, see changes().
/// @throws std::bad_alloc, Cancelled; the field is then as it was.
template <class Map>
void update(DistanceField<Map::kDim>& field, const Map& map, const std::vector<Change<Map::kDim>>& changes) {
  constexpr int D = Map::kDim;
  const RegionStates obstacles = detail::ObstacleStates(field.unknown()).obstacles;
  const Box<D> reach = field.grid().box().inflated(field.max_distance());
  std::vector<Box<D>> came;
  std::vector<Box<D>> went;
  for (const Change<D>& change : changes) {
    const bool is_obstacle = contains(obstacles, change.after);
    if (contains(obstacles, change.before) == is_obstacle) continue;
    const Box<D> box = map.tree().geometry().box(change.index);
    if (box.touches(reach)) (is_obstacle ? came : went).push_back(box);
  }
  if (came.empty() && went.empty()) return;
  for (const auto& [index, value] : detail::FieldUpdate<Map>(map, field, came, went).run())
    field.values()[index] = value;
}

}  // namespace ndtree
