// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The simulated street: façades, pavements, trees, poles and parked cars on either side of a road.
#pragma once

#include <array>
#include <vector>

#include "ndtree/logs/path.hpp"
#include "ndtree/logs/scene.hpp"

namespace ndtree {

/// All solids and the way along the road, turned by `yaw` [rad] about the vertical through the map's origin.
/// The road's surface is z = 0; the street runs from x = -15 m to 125 m about y = 0.
Scene<3> street_scene(double yaw);

namespace detail::street {

using Ground = Place<3>;

inline constexpr double kRoadHalf = 4.5;    // the kerb
inline constexpr double kFacade = 7.6;      // where the houses begin
inline constexpr double kPavement = 0.13;   // height of the pavement
inline constexpr double kCrossFrom = 52.0;  // a street that crosses
inline constexpr double kCrossTo = 61.0;

// Things at the roadside have their front, or the road, at -y.

inline void lamp_post(const Ground& g) {
  g.post(0.0, 0.0, 0.09, kPavement, 1.2);
  g.post(0.0, 0.0, 0.06, 1.2, 6.2);
  g.block(0.0, -0.75, 0.08, 1.50, 6.2, 6.28);
  g.block(0.0, -1.35, 0.22, 0.60, 6.08, 6.2);
}
inline void sign(const Ground& g) {
  g.post(0.0, 0.0, 0.05, kPavement, 2.75);
  g.block(0.0, -0.06, 0.60, 0.02, 2.15, 2.75);
}
inline void bollard(const Ground& g) { g.post(0.0, 0.0, 0.06, kPavement, 1.0); }
inline void bin(const Ground& g) { g.post(0.0, 0.0, 0.22, kPavement, 0.95); }
inline void hedge(const Ground& g) { g.block(0.0, 0.0, 5.0, 0.6, kPavement, 1.15); }
inline void bench(const Ground& g) {
  for (const double x : {-0.7, 0.7}) g.block(x, 0.0, 0.06, 0.42, kPavement, 0.55);
  g.block(0.0, 0.0, 1.7, 0.45, 0.55, 0.60);
  g.block(0.0, 0.20, 1.7, 0.05, 0.70, 1.00);
}
inline void broad_tree(const Ground& g) {
  g.post(0.0, 0.0, 0.17, kPavement, 2.9);
  g.ellipsoid(0.0, 0.0, 3.6, 3.4, 2.3, 6.4);
  g.ellipsoid(0.8, -0.3, 2.4, 2.2, 2.6, 5.2);
  g.ellipsoid(-0.7, 0.4, 2.2, 2.4, 3.4, 7.0);
}
inline void slim_tree(const Ground& g) {
  g.post(0.0, 0.0, 0.11, kPavement, 2.4);
  g.ellipsoid(0.0, 0.0, 2.0, 2.0, 1.9, 6.0);
}
inline void wheels(const Ground& g, double base, double track) {
  for (const double x : {-0.5 * base, 0.5 * base})
    for (const double y : {-0.5 * track, 0.5 * track}) g.ellipsoid(x, y, 0.64, 0.24, 0.0, 0.64);
}
inline void car(const Ground& g) {  // ahead is +x
  wheels(g, 2.60, 1.56);
  g.block(0.0, 0.0, 4.25, 1.76, 0.24, 0.72);
  g.block(-0.15, 0.0, 3.95, 1.70, 0.72, 0.90);
  g.block(-0.35, 0.0, 2.40, 1.52, 0.90, 1.44);
  for (const double y : {-0.93, 0.93}) g.block(0.70, y, 0.10, 0.16, 0.92, 1.06);
}
inline void van(const Ground& g) {
  wheels(g, 3.10, 1.70);
  g.block(0.0, 0.0, 5.20, 1.94, 0.28, 1.10);
  g.block(-0.45, 0.0, 4.30, 1.90, 1.10, 2.25);
}

/// A house with its front along x from 0 to `width`. The front is a layer with windows before the body.
struct House {
  double from;   // along the street [m]
  double width;  // [m]
  int storeys;
  int bays;      // windows a storey
  int door_bay;  // the one with the door, on the ground floor
};

inline void add_house(const Ground& g, const House& house) {
  constexpr double storey_height = 3.1;
  constexpr double layer = 0.25;  // depth of the window recesses
  constexpr double depth = 9.0;
  const double top = storey_height * house.storeys + 0.7;
  g.block(0.5 * house.width, layer + 0.5 * depth, house.width, depth, 0.0, top);
  const double bay = house.width / house.bays;
  for (int storey = 0; storey < house.storeys; ++storey) {
    const double floor = kPavement + storey_height * storey;
    std::vector<Opening> openings;
    for (int i = 0; i < house.bays; ++i) {
      const double middle = bay * (i + 0.5);
      const bool is_door = storey == 0 && i == house.door_bay;
      const double half = is_door ? 0.55 : 0.31 * bay;
      openings.push_back({middle - half, middle + half, floor + (is_door ? 0.0 : 0.85), floor + 2.35});
      if (!is_door) g.block(middle, -0.03, 2.0 * half + 0.16, 0.18, floor + 0.79, floor + 0.85);
    }
    add_wall(g.at(0.0, 0.5 * layer), house.width, layer, floor, floor + storey_height, openings);
  }
  g.block(0.5 * house.width, 0.0, house.width, 0.30, top - 0.55, top);                    // cornice
  g.block((house.door_bay + 0.5) * bay, -0.30, 1.60, 0.60, kPavement, kPavement + 0.16);  // door step
  g.block(0.5 * house.width, 0.5 * depth, 1.1, 0.7, top, top + 1.4);                      // chimney
}

inline constexpr std::array kNorthHouses = {House{-15.0, 13.0, 3, 5, 2}, House{-2.0, 11.0, 4, 4, 1},
                                            House{9.0, 14.0, 3, 5, 3},   House{25.5, 12.0, 3, 4, 0},
                                            House{37.5, 14.5, 4, 6, 2},  House{61.0, 12.0, 4, 5, 4},
                                            House{73.0, 10.5, 2, 4, 1},  House{87.0, 13.0, 3, 5, 2},
                                            House{100.0, 11.0, 4, 4, 0}, House{111.0, 14.0, 3, 5, 2}};
// Seen from the road, so `from` is the end with the larger x.
inline constexpr std::array kSouthHouses = {House{-4.0, 11.0, 3, 4, 1},  House{8.5, 12.5, 4, 5, 2},
                                            House{21.0, 12.5, 3, 5, 0},  House{33.0, 10.0, 2, 4, 2},
                                            House{52.0, 15.0, 3, 6, 3},  House{74.0, 13.0, 3, 5, 1},
                                            House{86.0, 12.0, 4, 4, 3},  House{97.5, 11.5, 3, 4, 2},
                                            House{114.0, 13.5, 4, 5, 0}, House{125.0, 11.0, 3, 4, 1}};

struct Thing {
  void (*put)(const Ground&);
  double x;
  double y;
  double degrees;  // 0: its front looks along -y, a car along +x
};

inline constexpr std::array kThings = {
    // north side
    Thing{lamp_post, -6.0, 5.0, 0.0}, Thing{lamp_post, 18.0, 5.0, 0.0}, Thing{lamp_post, 42.0, 5.0, 0.0},
    Thing{lamp_post, 66.0, 5.0, 0.0}, Thing{lamp_post, 90.0, 5.0, 0.0}, Thing{lamp_post, 114.0, 5.0, 0.0},
    Thing{broad_tree, 0.5, 5.7, 10.0}, Thing{broad_tree, 11.5, 5.7, 80.0},
    Thing{broad_tree, 23.8, 5.7, 200.0}, Thing{broad_tree, 35.0, 5.7, 140.0},
    Thing{broad_tree, 71.5, 5.7, 300.0}, Thing{broad_tree, 83.5, 5.7, 30.0},
    Thing{broad_tree, 96.0, 5.7, 250.0}, Thing{broad_tree, 107.0, 5.7, 110.0}, Thing{car, -4.5, 3.45, 180.0},
    Thing{car, 4.8, 3.50, 179.0}, Thing{car, 10.4, 3.42, 182.0}, Thing{van, 16.4, 3.40, 180.0},
    Thing{car, 28.3, 3.50, 181.0}, Thing{car, 33.9, 3.46, 178.0}, Thing{car, 46.2, 3.44, 180.5},
    Thing{car, 69.3, 3.50, 180.0}, Thing{car, 75.0, 3.40, 183.0}, Thing{car, 80.9, 3.48, 179.5},
    Thing{van, 93.0, 3.38, 180.0}, Thing{car, 103.7, 3.47, 180.0}, Thing{sign, 50.6, 4.9, 90.0},
    Thing{sign, 62.4, 4.9, -90.0}, Thing{bin, 21.0, 5.0, 0.0}, Thing{bin, 65.0, 5.0, 0.0},
    Thing{bench, 38.8, 6.9, 0.0}, Thing{bench, 98.6, 6.9, 0.0}, Thing{hedge, 24.2, 9.6, 90.0},
    Thing{hedge, 85.3, 8.2, 0.0},
    // south side
    Thing{lamp_post, 6.0, -5.0, 180.0}, Thing{lamp_post, 30.0, -5.0, 180.0},
    Thing{lamp_post, 78.0, -5.0, 180.0}, Thing{lamp_post, 102.0, -5.0, 180.0},
    Thing{slim_tree, -1.0, -5.4, 0.0}, Thing{slim_tree, 14.0, -5.4, 0.0}, Thing{slim_tree, 22.5, -5.4, 0.0},
    Thing{slim_tree, 45.5, -5.4, 0.0}, Thing{slim_tree, 68.0, -5.4, 0.0}, Thing{slim_tree, 88.5, -5.4, 0.0},
    Thing{slim_tree, 110.0, -5.4, 0.0}, Thing{broad_tree, 35.0, -11.0, 60.0},
    Thing{broad_tree, 100.0, -10.5, 15.0}, Thing{car, 1.5, -3.50, 1.0}, Thing{car, 17.9, -3.44, -2.0},
    Thing{car, 23.6, -3.50, 0.0}, Thing{car, 40.7, -3.47, 0.5}, Thing{van, 47.4, -3.40, 0.0},
    Thing{car, 66.2, -3.46, -1.0}, Thing{car, 85.0, -3.50, 2.0}, Thing{car, 90.8, -3.43, 0.0},
    Thing{car, 108.4, -3.48, 0.0}, Thing{bollard, 49.6, -4.8, 0.0}, Thing{bollard, 50.8, -4.8, 0.0},
    Thing{bollard, 62.2, -4.8, 0.0}, Thing{bollard, 63.4, -4.8, 0.0}, Thing{sign, 11.0, -4.9, 180.0},
    Thing{sign, 72.5, -4.9, 180.0}, Thing{bin, 31.2, -5.0, 0.0}, Thing{bench, 55.2, -15.5, 90.0},
    Thing{hedge, 35.3, -7.9, 0.0}, Thing{hedge, 99.6, -7.9, 0.0}};

// The left of the right lane, with a swerve around the van in front of the crossing.
inline constexpr std::array kWay = {Waypoint{2.0, -1.1, 0.0},  Waypoint{36.0, -1.1, 0.0},
                                    Waypoint{44.0, -0.4, 0.0}, Waypoint{52.0, -0.4, 0.0},
                                    Waypoint{60.0, -1.1, 0.0}, Waypoint{102.0, -1.0, 0.0}};

}  // namespace detail::street

inline Scene<3> street_scene(double yaw) {
  namespace s = detail::street;
  constexpr double radians = 0.017453292519943295;
  constexpr double half_turn = 3.14159265358979324;
  Scene<3> scene;
  const Place<3> ground(scene, yaw);
  ground.block(55.0, 0.0, 300.0, 200.0, -1.0, 0.0);
  for (const double side : {-1.0, 1.0}) {
    const double y = side * 0.5 * (s::kRoadHalf + 27.0);  // the pavement runs on under the houses and yards
    const double depth = 27.0 - s::kRoadHalf;
    ground.block(0.5 * (-40.0 + s::kCrossFrom), y, s::kCrossFrom + 40.0, depth, -0.5, s::kPavement);
    ground.block(0.5 * (s::kCrossTo + 150.0), y, 150.0 - s::kCrossTo, depth, -0.5, s::kPavement);
  }
  for (const s::House& house : s::kNorthHouses) s::add_house(ground.at(house.from, s::kFacade), house);
  for (const s::House& house : s::kSouthHouses)
    s::add_house(ground.at(house.from, -s::kFacade, half_turn), house);
  for (const s::Thing& thing : s::kThings) thing.put(ground.at(thing.x, thing.y, thing.degrees * radians));
  for (const Waypoint& stop : s::kWay) ground.pass(stop.x, stop.y, stop.spin);
  return scene;
}

}  // namespace ndtree
