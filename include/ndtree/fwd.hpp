// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Declares maps and what they take and give, for headers that only name them: includes neither Eigen nor the
/// map, and costs a compiler next to nothing.
#pragma once

#include <cstdint>

namespace ndtree {

enum class CellState : std::int8_t;
struct MapOptions;
struct InsertReport;
struct MapStats;

template <int D>
struct Box;
template <int D>
struct Scan;
template <int D>
struct ScanView;

class BeamSensorModel;
struct EvidenceRefinement;
struct PaperRefinement;
struct FixedRefinement;
template <int N, int D, class CellType>
class MapCells;
template <int N, int D, class Refinement, class Sensor = BeamSensorModel>
class OccupancyMap;

/// The map whose cells find their size while mapping.
template <int N, int D>
using AdaptiveMap = OccupancyMap<N, D, EvidenceRefinement>;

/// The adaptive map with exactly the rules of the paper.
template <int N, int D>
using PaperMap = OccupancyMap<N, D, PaperRefinement>;

/// The baseline: the same map, with every cell of min_cell_size.
template <int N, int D>
using FixedMap = OccupancyMap<N, D, FixedRefinement>;

template <class Map, class... Values>
class LayeredMap;
template <int N, int D, class Value>
class Layer;

template <int D>
struct Change;
template <int D>
struct Frontier;
template <class Map>
class FrontierSearch;
template <int D>
class DistanceField;

}  // namespace ndtree
