// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// Finding poses, without anything of Python's: what takes a compiler long is compiled in files of its own.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <vector>

#include "ndtree/alignment/matcher.hpp"
#include "ndtree/alignment/pose_graph.hpp"
#include "ndtree/core/types.hpp"

namespace ndtree::python {

/// As Matcher's constructor.
template <int D>
[[nodiscard]] std::shared_ptr<const Matcher<D>> make_matcher(const Points<D>& points,
                                                             const MatchOptions& options);
/// States of n points, D numbers each: as the map's.
using StatesOf = std::function<void(const double* points, std::size_t n, std::int8_t* states)>;
/// As matcher() of ndtree/query/match.hpp, of occupied cells. @param lower corners, D numbers each.
/// @param size edge lengths. @param smallest cells' [m]. @param states of the map that they are of.
template <int D>
[[nodiscard]] std::shared_ptr<const Matcher<D>> make_matcher(const std::vector<double>& lower,
                                                             const std::vector<double>& size, double smallest,
                                                             const StatesOf& states,
                                                             const MatchOptions& options);
/// As Matcher::match().
template <int D>
[[nodiscard]] Match<D> match(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& guess,
                             const MatchWindow<D>& window, const MotionMatrix<D>& information, bool second);
/// As Matcher::modes().
template <int D>
[[nodiscard]] std::vector<Match<D>> modes(const Matcher<D>& matcher, const Points<D>& points,
                                          const Pose<D>& guess, const MatchWindow<D>& window,
                                          std::size_t most, const MotionMatrix<D>& information);
/// As Matcher::score().
template <int D>
[[nodiscard]] double score(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& pose);
/// As reach_of() of ndtree/query/match.hpp.
template <int D>
[[nodiscard]] Box<D> reach_of_match(const Points<D>& points, const Pose<D>& guess, const Motion<D>& half);

/// As solve() of ndtree/alignment/pose_graph.hpp.
PoseGraphReport solve_graph(std::vector<XyYaw>& poses, const std::vector<PoseRelation>& relations,
                            int iterations);

}  // namespace ndtree::python
