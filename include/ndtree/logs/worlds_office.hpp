// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The simulated office: walls, furniture and a way through every room, cut 0.3 m above the floor.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <vector>

#include "ndtree/core/types.hpp"
#include "ndtree/logs/path.hpp"
#include "ndtree/logs/scene.hpp"

namespace ndtree {

/// Outer size of the office [m], from the corner at the map's origin along the turned axes.
inline constexpr double kOfficeLength = 26.0;
inline constexpr double kOfficeWidth = 16.0;

/// The inside of the office's rooms in its own, not turned frame [m]: the corridor first.
inline std::vector<Box<2>> office_rooms() {
  return {{{0.3, 6.67}, {25.7, 8.93}},    {{0.3, 0.3}, {4.13, 6.53}},     {{4.27, 0.3}, {8.33, 6.53}},
          {{8.47, 0.3}, {12.93, 6.53}},   {{13.07, 0.3}, {16.33, 6.53}},  {{16.47, 0.3}, {20.93, 6.53}},
          {{21.07, 0.3}, {25.7, 6.53}},   {{0.3, 9.07}, {8.43, 15.7}},    {{8.57, 9.07}, {14.43, 15.7}},
          {{14.57, 9.07}, {17.43, 15.7}}, {{17.57, 9.07}, {21.63, 15.7}}, {{21.77, 9.07}, {25.7, 15.7}}};
}

/// The doors between the corridor and the rooms.
inline constexpr std::size_t kOfficeDoors = 12;

/// All solids and the way, turned by `yaw` [rad] about the map's origin, without the leaves of the first
/// `without_doors` doors, which then move.
Scene<2> office_scene(double yaw, std::size_t without_doors = 0);

namespace detail::office {

using Floor = Place<2>;

// Furniture, as a laser at 0.3 m cuts it. Its back is at +y, where the wall is; its user sits at -y.

inline void chair(const Floor& f) { f.legs(0.40, 0.38, 0.025); }

inline void swivel_chair(const Floor& f) {
  f.post(0.0, 0.0, 0.03);
  for (int i = 0; i < 5; ++i) f.at(0.0, 0.0, 1.2566370614 * i).post(0.30, 0.0, 0.022);
}

inline void desk(const Floor& f) {
  f.legs(1.52, 0.70, 0.04);
  f.block(0.52, 0.05, 0.42, 0.58);  // drawers
}

inline void workplace(const Floor& f) {
  desk(f);
  swivel_chair(f.at(-0.12, -0.62, 0.4));
  f.post(-0.68, 0.10, 0.12);  // waste-paper basket
}

inline void shelf(const Floor& f) { f.block(0.0, 0.0, 0.90, 0.35); }
inline void cabinet(const Floor& f) { f.block(0.0, 0.0, 0.80, 0.45); }
inline void rack(const Floor& f) { f.block(0.0, 0.0, 0.60, 1.00); }
inline void copier(const Floor& f) { f.block(0.0, 0.0, 0.95, 0.68); }
inline void carton(const Floor& f) { f.block(0.0, 0.0, 0.42, 0.31); }
inline void counter(const Floor& f) { f.block(0.0, 0.0, 2.40, 0.60); }
inline void fridge(const Floor& f) { f.block(0.0, 0.0, 0.60, 0.65); }
inline void column(const Floor& f) { f.block(0.0, 0.0, 0.35, 0.35); }
inline void plant(const Floor& f) { f.post(0.0, 0.0, 0.19); }

inline void bench(const Floor& f) {  // laboratory bench: steel frame with one cabinet under it
  f.legs(2.30, 0.70, 0.05);
  f.block(-0.85, 0.0, 0.60, 0.62);
}

inline void sofa(const Floor& f) {
  f.block(0.0, 0.06, 1.80, 0.72);
  f.block(-0.99, 0.0, 0.18, 0.84);
  f.block(0.99, 0.0, 0.18, 0.84);
}

inline void meeting_table(const Floor& f) {
  f.legs(2.90, 1.00, 0.06);
  for (const double x : {-1.05, -0.35, 0.35, 1.05}) {
    chair(f.at(x, 0.78 + 0.06 * x, 0.1 * x));
    chair(f.at(x + 0.05, -0.80, 0.2 - 0.15 * x));
  }
}

inline void round_table(const Floor& f) {
  f.post(0.0, 0.0, 0.045);
  for (int i = 0; i < 3; ++i) chair(f.at(0.0, 0.0, 0.5 + 2.0943951024 * i).at(0.72, 0.0, 1.5));
}

struct Furniture {
  void (*put)(const Floor&);
  double x;
  double y;
  double degrees;  // 0: its back looks along +y
};

inline constexpr std::array kFurniture = {
    // corridor
    Furniture{copier, 9.50, 8.57, 0.0}, Furniture{plant, 0.65, 8.60, 0.0},
    Furniture{cabinet, 13.40, 8.68, 0.0}, Furniture{plant, 19.70, 6.98, 0.0},
    Furniture{carton, 20.75, 8.65, 24.0}, Furniture{shelf, 12.70, 6.87, 180.0},
    // 1, office
    Furniture{workplace, 0.74, 3.40, 90.0}, Furniture{workplace, 0.76, 1.30, 93.0},
    Furniture{shelf, 2.50, 0.50, 180.0}, Furniture{shelf, 3.45, 0.50, 180.0},
    Furniture{cabinet, 3.88, 2.60, -90.0}, Furniture{plant, 0.62, 6.10, 0.0},
    Furniture{carton, 3.75, 4.10, 31.0},
    // 2, office
    Furniture{workplace, 7.90, 3.90, -90.0}, Furniture{workplace, 5.20, 0.74, 180.0},
    Furniture{shelf, 7.60, 0.50, 180.0}, Furniture{cabinet, 4.52, 3.10, 90.0},
    Furniture{chair, 6.90, 5.70, -40.0}, Furniture{plant, 8.00, 6.15, 0.0},
    // 3, office for four
    Furniture{workplace, 9.75, 2.62, 180.0}, Furniture{workplace, 9.75, 1.78, 0.0},
    Furniture{workplace, 12.05, 2.62, 180.0}, Furniture{workplace, 12.05, 1.78, 0.0},
    Furniture{shelf, 8.68, 5.30, 90.0}, Furniture{shelf, 8.68, 4.38, 90.0},
    Furniture{cabinet, 12.68, 5.40, -90.0}, Furniture{copier, 12.50, 4.35, -96.0},
    // 4, tea kitchen
    Furniture{counter, 15.05, 0.62, 180.0}, Furniture{fridge, 13.42, 0.66, 180.0},
    Furniture{round_table, 15.55, 3.10, 12.0}, Furniture{cabinet, 13.32, 4.60, 90.0},
    Furniture{plant, 16.00, 6.15, 0.0},
    // 5, office
    Furniture{workplace, 20.48, 2.40, -84.0}, Furniture{workplace, 18.20, 0.76, 176.0},
    Furniture{shelf, 16.68, 3.20, 90.0}, Furniture{shelf, 16.68, 2.28, 90.0},
    Furniture{sofa, 20.40, 5.00, -90.0},
    // 6, office with a round table
    Furniture{workplace, 24.60, 1.00, 205.0}, Furniture{round_table, 24.30, 4.60, 50.0},
    Furniture{shelf, 21.28, 1.40, 90.0}, Furniture{shelf, 21.28, 2.33, 90.0},
    Furniture{cabinet, 22.60, 0.54, 180.0}, Furniture{plant, 25.35, 6.20, 0.0},
    Furniture{carton, 21.55, 3.60, -17.0},
    // 7, laboratory
    Furniture{bench, 1.90, 15.20, 0.0}, Furniture{bench, 4.50, 15.20, 0.0},
    Furniture{bench, 7.10, 15.20, 0.0}, Furniture{bench, 3.20, 12.05, 0.0},
    Furniture{bench, 3.20, 11.30, 180.0}, Furniture{column, 5.60, 12.10, 0.0},
    Furniture{rack, 0.62, 12.60, 0.0}, Furniture{rack, 0.62, 11.50, 0.0},
    Furniture{shelf, 8.22, 12.60, -90.0}, Furniture{swivel_chair, 2.60, 14.40, 10.0},
    Furniture{swivel_chair, 6.60, 14.45, 33.0}, Furniture{swivel_chair, 3.90, 10.55, 5.0},
    Furniture{carton, 5.30, 9.45, 8.0}, Furniture{carton, 5.75, 9.40, -20.0},
    // 8, meeting room
    Furniture{meeting_table, 11.50, 13.20, 2.0}, Furniture{cabinet, 8.82, 11.20, 90.0},
    Furniture{cabinet, 8.82, 12.02, 90.0}, Furniture{plant, 14.05, 15.35, 0.0},
    Furniture{plant, 8.90, 15.35, 0.0}, Furniture{chair, 14.05, 10.00, -80.0},
    Furniture{chair, 14.05, 10.60, -92.0},
    // 9, store
    Furniture{rack, 14.90, 14.90, 0.0}, Furniture{rack, 14.90, 13.85, 0.0},
    Furniture{rack, 14.90, 12.80, 0.0}, Furniture{shelf, 17.23, 13.80, -90.0},
    Furniture{shelf, 17.23, 12.88, -90.0}, Furniture{carton, 16.30, 15.35, 4.0},
    Furniture{carton, 16.80, 15.10, 38.0}, Furniture{carton, 14.90, 11.60, -12.0},
    // 10, office
    Furniture{workplace, 18.90, 15.22, 0.0}, Furniture{workplace, 21.18, 12.90, -90.0},
    Furniture{shelf, 17.78, 12.60, 90.0}, Furniture{shelf, 17.78, 11.66, 90.0},
    Furniture{cabinet, 20.90, 9.34, 180.0}, Furniture{chair, 20.60, 14.90, 130.0},
    // 11, office
    Furniture{workplace, 22.25, 14.20, 90.0}, Furniture{workplace, 22.25, 12.10, 87.0},
    Furniture{sofa, 25.22, 13.20, -90.0}, Furniture{shelf, 24.30, 15.50, 0.0},
    Furniture{plant, 25.40, 15.40, 0.0}, Furniture{cabinet, 22.04, 10.20, 90.0}};

// Doors on the two sides of the corridor: where their middle is, and how far the leaf stands open. The leaf
// hangs on the side of smaller x if the angle is positive, and opens into the room.
struct Door {
  double x;
  double degrees;
};
inline constexpr double kDoorWidth = 0.95;
inline constexpr double kSouthWall = 6.60;
inline constexpr double kNorthWall = 9.00;
inline constexpr std::array kSouthDoors = {Door{3.30, 98.0},  Door{5.20, -105.0}, Door{10.60, 92.0},
                                           Door{14.80, 96.0}, Door{17.40, 88.0},  Door{22.20, 110.0}};
inline constexpr std::array kNorthDoors = {Door{2.00, 94.0},  Door{7.40, -90.0},  Door{11.40, 100.0},
                                           Door{16.00, 86.0}, Door{18.60, 103.0}, Door{24.40, -97.0}};

static_assert(kSouthDoors.size() + kNorthDoors.size() == kOfficeDoors);

/// Where a door's leaf hangs in the office's own frame, and its headings there, open and closed [m, rad].
struct Hinge {
  double x;
  double y;
  double open;
  double closed;
};

/// Of door i < kOfficeDoors: those of the south side from the west, then those of the north side.
inline Hinge hinge_of(std::size_t i) {
  constexpr double radians = 0.017453292519943295;
  constexpr double half_turn = 3.14159265358979324;
  const bool south = i < kSouthDoors.size();
  const Door& door = south ? kSouthDoors[i] : kNorthDoors[i - kSouthDoors.size()];
  const double inward = south ? -1.0 : 1.0;
  const double side = door.degrees > 0.0 ? 1.0 : -1.0;
  const double closed = side > 0.0 ? 0.0 : half_turn;
  const double open = inward * side * std::abs(door.degrees) * radians + closed;
  return {door.x - side * 0.5 * kDoorWidth, (south ? kSouthWall : kNorthWall) + 0.09 * inward, open, closed};
}

/// From its hinge along x.
inline void door_leaf(const Floor& floor) { floor.block(0.46, 0.0, 0.90, 0.04); }

/// One side of the corridor, with its doorways.
template <typename Doors>
void add_corridor_wall(const Floor& floor, double y, const Doors& doors) {
  std::vector<Opening> openings;
  for (const Door& door : doors) openings.push_back({door.x - 0.5 * kDoorWidth, door.x + 0.5 * kDoorWidth});
  add_wall(floor.at(0.0, y), kOfficeLength, 0.14, 0.0, 1.0, openings);
}

inline void add_walls(const Floor& floor) {
  constexpr double outer = 0.30;
  constexpr double half = 0.5 * outer;
  constexpr double right_angle = 1.57079632679489662;
  add_wall(floor.at(0.0, half), kOfficeLength, outer, 0.0, 1.0);
  add_wall(floor.at(0.0, kOfficeWidth - half), kOfficeLength, outer, 0.0, 1.0);
  add_wall(floor.at(half, 0.0, right_angle), kOfficeWidth, outer, 0.0, 1.0);
  add_wall(floor.at(kOfficeLength - half, 0.0, right_angle), kOfficeWidth, outer, 0.0, 1.0);
  add_corridor_wall(floor, kSouthWall, kSouthDoors);
  add_corridor_wall(floor, kNorthWall, kNorthDoors);
  for (const double x : {4.2, 8.4, 13.0, 16.4, 21.0})
    add_wall(floor.at(x, 0.0, right_angle), kSouthWall, 0.14, 0.0, 1.0);
  for (const double x : {8.5, 14.5, 17.5, 21.7})
    add_wall(floor.at(x, kNorthWall, right_angle), kOfficeWidth - kNorthWall, 0.14, 0.0, 1.0);
}

// x, y, turn: from the corridor's west end through the laboratory, then room by room eastwards, and back.
inline constexpr std::array kWay = {
    Waypoint{1.2, 7.8, 3.1},   Waypoint{2.0, 7.8, 0.0},   Waypoint{2.0, 10.0, 0.0},
    Waypoint{1.4, 10.6, 0.0},  Waypoint{1.4, 13.4, 0.0},  Waypoint{4.6, 13.4, 0.0},
    Waypoint{6.8, 13.3, 0.0},  Waypoint{7.3, 11.0, 0.0},  Waypoint{7.4, 7.8, 0.0},
    Waypoint{3.3, 7.8, 0.0},   Waypoint{3.3, 5.4, 0.0},   Waypoint{2.5, 3.4, 0.0},
    Waypoint{2.6, 1.6, 0.0},   Waypoint{3.3, 5.4, 0.0},   Waypoint{3.3, 7.8, 0.0},
    Waypoint{5.2, 7.8, 0.0},   Waypoint{5.2, 5.2, 0.0},   Waypoint{6.2, 3.6, 0.0},
    Waypoint{6.6, 1.9, 0.0},   Waypoint{5.2, 5.2, 0.0},   Waypoint{5.2, 7.8, 0.0},
    Waypoint{10.6, 7.8, 0.0},  Waypoint{10.6, 5.2, 0.0},  Waypoint{10.9, 4.1, 0.0},
    Waypoint{10.9, 0.8, 0.0},  Waypoint{10.9, 4.1, 0.0},  Waypoint{10.6, 5.4, 0.0},
    Waypoint{10.6, 7.8, 0.0},  Waypoint{11.4, 7.8, 0.0},  Waypoint{11.4, 10.5, 0.0},
    Waypoint{13.7, 11.8, 0.0}, Waypoint{13.7, 14.6, 0.0}, Waypoint{9.4, 14.9, 0.0},
    Waypoint{9.5, 11.4, 0.0},  Waypoint{11.4, 10.4, 0.0}, Waypoint{11.4, 7.8, 0.0},
    Waypoint{14.8, 7.8, 0.0},  Waypoint{14.8, 5.2, 0.0},  Waypoint{14.2, 3.4, 0.0},
    Waypoint{14.2, 1.6, 0.0},  Waypoint{14.2, 3.4, 0.0},  Waypoint{14.8, 5.2, 0.0},
    Waypoint{14.8, 7.8, 0.0},  Waypoint{16.0, 7.8, 0.0},  Waypoint{16.0, 10.5, 0.0},
    Waypoint{16.1, 14.2, 0.0}, Waypoint{16.0, 10.5, 0.0}, Waypoint{16.0, 7.8, 0.0},
    Waypoint{17.4, 7.8, 0.0},  Waypoint{17.4, 5.2, 0.0},  Waypoint{18.6, 3.8, 0.0},
    Waypoint{18.9, 2.1, 0.0},  Waypoint{17.4, 5.2, 0.0},  Waypoint{17.4, 7.8, 0.0},
    Waypoint{18.6, 7.8, 0.0},  Waypoint{18.6, 10.4, 0.0}, Waypoint{19.2, 12.0, 0.0},
    Waypoint{19.4, 13.8, 0.0}, Waypoint{18.6, 10.4, 0.0}, Waypoint{18.6, 7.8, 0.0},
    Waypoint{22.2, 7.8, 0.0},  Waypoint{22.2, 5.2, 0.0},  Waypoint{22.7, 3.0, 0.0},
    Waypoint{22.8, 1.8, 0.0},  Waypoint{22.2, 5.2, 0.0},  Waypoint{22.2, 7.8, 0.0},
    Waypoint{24.4, 7.8, 0.0},  Waypoint{24.4, 10.4, 0.0}, Waypoint{23.9, 12.6, 0.0},
    Waypoint{23.9, 14.6, 0.0}, Waypoint{24.4, 10.4, 0.0}, Waypoint{24.4, 7.8, 0.0},
    Waypoint{25.0, 7.8, 0.0},  Waypoint{16.0, 7.8, 0.0}};

}  // namespace detail::office

inline Scene<2> office_scene(double yaw, std::size_t without_doors) {
  constexpr double radians = 0.017453292519943295;
  Scene<2> scene;
  const Place<2> floor(scene, yaw);
  detail::office::add_walls(floor);
  for (std::size_t i = without_doors; i < kOfficeDoors; ++i) {
    const detail::office::Hinge hinge = detail::office::hinge_of(i);
    detail::office::door_leaf(floor.at(hinge.x, hinge.y, hinge.open));
  }
  for (const detail::office::Furniture& item : detail::office::kFurniture)
    item.put(floor.at(item.x, item.y, item.degrees * radians));
  for (const Waypoint& stop : detail::office::kWay) floor.pass(stop.x, stop.y, stop.spin);
  return scene;
}

}  // namespace ndtree
