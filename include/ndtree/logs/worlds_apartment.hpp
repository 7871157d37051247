// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// The simulated apartment: five furnished rooms around a hall, and a way through all of them.
#pragma once

#include <array>
#include <vector>

#include "ndtree/logs/path.hpp"
#include "ndtree/logs/scene.hpp"

namespace ndtree {

/// Outer size of the apartment [m], from the corner at the map's origin along the turned axes, and the height
/// of its rooms.
inline constexpr double kApartmentLength = 10.4;
inline constexpr double kApartmentWidth = 9.7;
inline constexpr double kApartmentHeight = 2.5;

/// All solids and the way, turned by `yaw` [rad] about the vertical through the map's origin. The floor's
/// surface is z = 0.
Scene<3> apartment_scene(double yaw);

namespace detail::apartment {

using Room = Place<3>;

// Furniture stands with its back to +y, where the wall is, and is used from -y.

inline void table(const Room& r, double length, double depth, double height, double leg) {
  r.legs(length - 2.0 * leg, depth - 2.0 * leg, leg, height - 0.03);
  r.block(0.0, 0.0, length, depth, height - 0.03, height);
}

inline void chair(const Room& r) {
  r.legs(0.38, 0.38, 0.03, 0.44);
  r.block(0.0, 0.0, 0.43, 0.43, 0.44, 0.47);
  r.block(-0.19, 0.20, 0.03, 0.03, 0.47, 0.92);
  r.block(0.19, 0.20, 0.03, 0.03, 0.47, 0.92);
  r.block(0.0, 0.20, 0.35, 0.02, 0.66, 0.92);
}

inline void dining_table(const Room& r) {
  table(r, 1.50, 0.85, 0.75, 0.06);
  chair(r.at(-0.36, -0.62, 3.10));
  chair(r.at(0.38, -0.70, 3.35));
  chair(r.at(-0.38, 0.60, 0.05));
  chair(r.at(0.36, 0.74, -0.35));
  r.ellipsoid(0.1, 0.02, 0.30, 0.30, 0.72, 0.86);   // fruit bowl
  r.post(0.0, 0.0, 0.012, 1.95, kApartmentHeight);  // pendant lamp
  r.ellipsoid(0.0, 0.0, 0.42, 0.42, 1.68, 1.97);
}

inline void coffee_table(const Room& r) {
  table(r, 1.05, 0.60, 0.42, 0.05);
  r.block(0.2, 0.05, 0.22, 0.30, 0.42, 0.45);
  r.post(-0.25, 0.1, 0.04, 0.42, 0.55);
}

inline void seat(const Room& r, double width) {  // sofa or armchair
  r.block(0.0, 0.0, width, 0.85, 0.08, 0.42);
  r.block(0.0, 0.33, width, 0.20, 0.42, 0.84);
  for (const double side : {-0.5, 0.5}) r.block(side * (width - 0.18), 0.0, 0.18, 0.85, 0.42, 0.62);
  r.legs(width - 0.12, 0.73, 0.05, 0.08);
}
inline void sofa(const Room& r) {
  seat(r, 2.05);
  r.at(-0.62, 0.14, 0.2).ellipsoid(0.0, 0.0, 0.42, 0.20, 0.42, 0.80);
  r.at(0.55, 0.16, -0.1).ellipsoid(0.0, 0.0, 0.42, 0.20, 0.42, 0.80);
}
inline void armchair(const Room& r) { seat(r, 0.90); }

inline void bookshelf(const Room& r) {
  r.block(-0.44, 0.0, 0.02, 0.32, 0.0, 2.02);
  r.block(0.44, 0.0, 0.02, 0.32, 0.0, 2.02);
  r.block(0.0, 0.15, 0.86, 0.02, 0.0, 2.02);
  for (int board = 0; board < 6; ++board) {
    const double z = 0.06 + 0.388 * board;
    r.block(0.0, -0.01, 0.86, 0.30, z, z + 0.02);
    if (board == 5) break;
    const double books = 0.30 + 0.11 * ((board * 3) % 5);  // a row of books that fills part of the board
    r.block(-0.42 + 0.5 * books, 0.03, books, 0.20, z + 0.02, z + 0.27);
  }
}

inline void tv_board(const Room& r) {
  r.block(0.0, 0.0, 1.60, 0.42, 0.06, 0.48);
  r.block(0.0, 0.05, 0.40, 0.22, 0.48, 0.50);
  r.block(0.0, 0.08, 0.08, 0.04, 0.50, 0.60);
  r.block(0.0, 0.06, 1.12, 0.05, 0.58, 1.22);
}

inline void floor_lamp(const Room& r) {
  r.post(0.0, 0.0, 0.15, 0.0, 0.03);
  r.post(0.0, 0.0, 0.015, 0.03, 1.45);
  r.post(0.0, 0.0, 0.19, 1.42, 1.70);
}

inline void plant(const Room& r) {
  r.post(0.0, 0.0, 0.16, 0.0, 0.34);
  r.post(0.0, 0.0, 0.02, 0.34, 0.75);
  r.ellipsoid(0.03, 0.0, 0.55, 0.48, 0.62, 1.30);
}

inline void kitchen_line(const Room& r) {  // 2.4 m of cupboards, wall cupboards and a hood
  r.block(0.0, 0.03, 2.40, 0.54, 0.0, 0.10);
  r.block(0.0, 0.0, 2.40, 0.58, 0.10, 0.87);
  r.block(0.0, 0.0, 2.42, 0.62, 0.87, 0.91);
  r.block(-0.65, 0.12, 1.10, 0.35, 1.45, 2.15);
  r.block(0.90, 0.12, 0.60, 0.35, 1.45, 2.15);
  r.block(0.25, 0.06, 0.60, 0.48, 1.60, 1.72);
  r.block(0.25, 0.18, 0.26, 0.24, 1.72, kApartmentHeight);
  r.post(-0.70, 0.22, 0.015, 0.91, 1.22);  // tap
}
inline void fridge(const Room& r) { r.block(0.0, 0.0, 0.60, 0.64, 0.02, 1.85); }

inline void bed(const Room& r) {
  r.block(0.0, 0.98, 1.70, 0.06, 0.0, 1.02);
  r.block(0.0, -0.05, 1.66, 2.04, 0.12, 0.30);
  r.block(0.0, -0.05, 1.60, 1.98, 0.30, 0.52);
  r.legs(1.50, 1.80, 0.07, 0.12);
  for (const double x : {-0.40, 0.40}) r.ellipsoid(x, 0.66, 0.66, 0.44, 0.44, 0.68);
}
inline void nightstand(const Room& r) {
  r.block(0.0, 0.0, 0.42, 0.38, 0.0, 0.48);
  r.post(0.0, 0.05, 0.05, 0.48, 0.62);
  r.post(0.0, 0.05, 0.11, 0.62, 0.82);
}
inline void wardrobe(const Room& r) { r.block(0.0, 0.0, 2.00, 0.60, 0.0, 2.20); }
inline void dresser(const Room& r) { r.block(0.0, 0.0, 1.10, 0.45, 0.06, 0.82); }
inline void shoe_cabinet(const Room& r) { r.block(0.0, 0.0, 0.90, 0.30, 0.0, 1.05); }

inline void coat_rack(const Room& r) {
  r.block(0.0, 0.13, 1.00, 0.03, 1.62, 1.74);
  for (const double x : {-0.32, 0.02, 0.30}) r.ellipsoid(x, 0.02, 0.34, 0.20, 0.72, 1.70);  // coats
}

inline void desk(const Room& r) {
  table(r, 1.50, 0.72, 0.74, 0.05);
  r.block(0.50, 0.03, 0.40, 0.55, 0.04, 0.60);
  r.block(-0.10, 0.18, 0.22, 0.16, 0.74, 0.76);
  r.block(-0.10, 0.21, 0.05, 0.03, 0.76, 0.90);
  r.block(-0.10, 0.19, 0.58, 0.03, 0.84, 1.18);
  const Room seat_place = r.at(-0.08, -0.62, 2.8);
  for (int i = 0; i < 5; ++i)
    seat_place.at(0.0, 0.0, 1.2566370614 * i).block(0.15, 0.0, 0.30, 0.04, 0.04, 0.09);
  seat_place.post(0.0, 0.0, 0.03, 0.05, 0.44);
  seat_place.block(0.0, 0.0, 0.48, 0.46, 0.44, 0.51);
  seat_place.block(0.0, 0.23, 0.42, 0.05, 0.58, 1.05);
}

inline void bathtub(const Room& r) {
  r.block(0.0, 0.0, 1.70, 0.75, 0.0, 0.14);
  r.block(0.0, 0.345, 1.70, 0.06, 0.14, 0.56);
  r.block(0.0, -0.345, 1.70, 0.06, 0.14, 0.56);
  for (const double x : {-0.81, 0.81}) r.block(x, 0.0, 0.08, 0.63, 0.14, 0.56);
}
inline void toilet(const Room& r) {
  r.block(0.0, 0.17, 0.38, 0.16, 0.40, 0.80);
  r.block(0.0, 0.12, 0.22, 0.24, 0.0, 0.40);
  r.ellipsoid(0.0, -0.12, 0.36, 0.50, 0.10, 0.46);
}
inline void washbasin(const Room& r) {
  r.block(0.0, 0.02, 0.60, 0.44, 0.72, 0.87);
  r.post(0.0, 0.10, 0.08, 0.0, 0.72);
  r.block(0.0, 0.21, 0.70, 0.06, 1.15, 1.85);  // mirror cabinet
}
inline void washing_machine(const Room& r) { r.block(0.0, 0.0, 0.60, 0.58, 0.0, 0.85); }
inline void radiator(const Room& r) { r.block(0.0, 0.0, 1.20, 0.10, 0.14, 0.74); }
inline void door_leaf(const Room& r) {
  r.block(0.44, 0.0, 0.86, 0.04, 0.01, 2.02);
}  // from its hinge along x

struct Furniture {
  void (*put)(const Room&);
  double x;
  double y;
  double degrees;  // 0: its back looks along +y
};

inline constexpr std::array kFurniture = {
    // living room, south-west
    Furniture{sofa, 2.20, 3.88, 0.0}, Furniture{coffee_table, 2.25, 2.65, 4.0},
    Furniture{tv_board, 1.75, 0.55, 180.0}, Furniture{armchair, 0.95, 2.45, 72.0},
    Furniture{bookshelf, 5.41, 3.72, -90.0}, Furniture{bookshelf, 5.41, 0.85, -90.0},
    Furniture{floor_lamp, 0.70, 3.95, 0.0}, Furniture{plant, 3.25, 0.72, 20.0},
    // kitchen, south-east
    Furniture{kitchen_line, 9.77, 1.75, -90.0}, Furniture{fridge, 9.74, 3.38, -90.0},
    Furniture{dining_table, 7.45, 1.55, 3.0}, Furniture{radiator, 8.00, 0.38, 180.0},
    // hall
    Furniture{shoe_cabinet, 9.90, 5.08, -90.0}, Furniture{coat_rack, 8.95, 5.54, 0.0},
    Furniture{plant, 0.68, 5.35, 0.0},
    // bedroom, north-west
    Furniture{bed, 1.38, 7.75, 90.0}, Furniture{nightstand, 0.54, 6.58, 90.0},
    Furniture{nightstand, 0.54, 8.92, 90.0}, Furniture{wardrobe, 3.95, 8.25, -90.0},
    Furniture{dresser, 1.90, 6.08, 180.0}, Furniture{radiator, 2.20, 9.33, 0.0},
    // bathroom
    Furniture{bathtub, 5.51, 8.98, 0.0}, Furniture{toilet, 4.70, 7.55, 90.0},
    Furniture{washbasin, 6.34, 7.00, -90.0}, Furniture{washing_machine, 6.28, 8.10, -90.0},
    // study, north-east
    Furniture{desk, 8.65, 8.98, 0.0}, Furniture{bookshelf, 9.92, 7.55, -90.0},
    Furniture{bookshelf, 9.92, 6.62, -90.0}, Furniture{armchair, 7.42, 8.35, 62.0},
    Furniture{floor_lamp, 7.05, 9.15, 0.0},
    // doors that stand open, by their hinges
    Furniture{door_leaf, 3.02, 5.87, 97.0}, Furniture{door_leaf, 5.02, 5.87, 100.0},
    Furniture{door_leaf, 8.28, 5.87, 84.0}, Furniture{door_leaf, 6.32, 4.28, -86.0}};

inline void add_shell(const Room& home) {
  constexpr double right_angle = 1.57079632679489662;
  constexpr double outer_thickness = 0.30;
  constexpr double inner_thickness = 0.12;
  constexpr double door_top = 2.05;
  home.block(0.5 * kApartmentLength, 0.5 * kApartmentWidth, kApartmentLength, kApartmentWidth, -0.25, 0.0);
  home.block(0.5 * kApartmentLength, 0.5 * kApartmentWidth, kApartmentLength, kApartmentWidth,
             kApartmentHeight, kApartmentHeight + 0.25);
  // Outer walls; a pane closes each window near the outside, behind a recess.
  const auto outer = [&](const Room& wall, double length, const std::vector<Opening>& windows) {
    add_wall(wall.at(0.0, 0.5 * outer_thickness), length, outer_thickness, 0.0, kApartmentHeight, windows);
    for (const Opening& window : windows) {
      const double middle = 0.5 * (window.from + window.to);
      wall.block(middle, 0.07, window.to - window.from, 0.02, window.bottom, window.top);
      wall.block(middle, 0.09, 0.07, 0.06, window.bottom, window.top);  // the bar between two casements
    }
  };
  outer(home, kApartmentLength, {{3.70, 5.00, 0.05, 2.20}, {7.20, 8.80, 0.95, 2.15}});
  outer(home.at(kApartmentLength, 0.0, right_angle), kApartmentWidth, {{8.15, 9.05, 1.20, 2.15}});
  outer(home.at(kApartmentLength, kApartmentWidth, 2.0 * right_angle), kApartmentLength,
        {{1.00, 2.50, 0.90, 2.15}, {7.40, 9.00, 0.90, 2.15}});
  outer(home.at(0.0, kApartmentWidth, 3.0 * right_angle), kApartmentWidth, {{6.60, 8.20, 0.90, 2.15}});
  // Hall, then the walls between the rooms.
  add_wall(home.at(0.0, 4.40), kApartmentLength, inner_thickness, 0.0, kApartmentHeight,
           {{4.25, 5.35, 0.0, door_top}, {6.30, 7.20, 0.0, door_top}});
  add_wall(home.at(0.0, 5.76), kApartmentLength, inner_thickness, 0.0, kApartmentHeight,
           {{3.00, 3.90, 0.0, door_top}, {5.00, 5.90, 0.0, door_top}, {7.40, 8.30, 0.0, door_top}});
  add_wall(home.at(5.66, 0.0, right_angle), 4.40, inner_thickness, 0.0, kApartmentHeight,
           {{1.60, 2.80, 0.0, door_top}});
  add_wall(home.at(4.36, 5.76, right_angle), kApartmentWidth - 5.76, inner_thickness, 0.0, kApartmentHeight);
  add_wall(home.at(6.66, 5.76, right_angle), kApartmentWidth - 5.76, inner_thickness, 0.0, kApartmentHeight);
}

// x, y, turn: hall, living room, kitchen, hall, study, bathroom, bedroom, hall.
inline constexpr double kAround = 6.28318530717958648;
inline constexpr std::array kWay = {
    Waypoint{4.8, 5.08, 0.0},      Waypoint{4.8, 3.5, 0.0},     Waypoint{4.0, 2.6, kAround},
    Waypoint{3.7, 1.5, 0.0},       Waypoint{2.6, 1.55, 0.0},    Waypoint{4.3, 1.9, 0.0},
    Waypoint{5.0, 2.25, 0.0},      Waypoint{6.2, 2.7, 0.0},     Waypoint{6.8, 3.3, 0.0},
    Waypoint{8.5, 3.2, kAround},   Waypoint{8.9, 1.6, 0.0},     Waypoint{8.5, 3.2, 0.0},
    Waypoint{6.8, 3.3, 0.0},       Waypoint{6.75, 5.08, 0.0},   Waypoint{7.85, 5.08, 0.0},
    Waypoint{7.85, 6.5, 0.0},      Waypoint{8.5, 7.3, kAround}, Waypoint{7.85, 6.5, 0.0},
    Waypoint{7.85, 5.08, 0.0},     Waypoint{5.45, 5.08, 0.0},   Waypoint{5.45, 6.4, 0.0},
    Waypoint{5.45, 7.6, -kAround}, Waypoint{5.45, 6.4, 0.0},    Waypoint{5.45, 5.08, 0.0},
    Waypoint{3.45, 5.08, 0.0},     Waypoint{3.45, 6.5, 0.0},    Waypoint{3.1, 6.9, kAround},
    Waypoint{2.95, 8.9, kAround},  Waypoint{3.1, 6.9, 0.0},     Waypoint{3.45, 5.08, 0.0},
    Waypoint{1.5, 5.08, 3.2},      Waypoint{2.5, 5.0, 0.0}};

}  // namespace detail::apartment

inline Scene<3> apartment_scene(double yaw) {
  constexpr double radians = 0.017453292519943295;
  Scene<3> scene;
  const Place<3> home(scene, yaw);
  detail::apartment::add_shell(home);
  for (const detail::apartment::Furniture& item : detail::apartment::kFurniture)
    item.put(home.at(item.x, item.y, item.degrees * radians));
  for (const Waypoint& stop : detail::apartment::kWay) home.pass(stop.x, stop.y, stop.spin);
  return scene;
}

}  // namespace ndtree
