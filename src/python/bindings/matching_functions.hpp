// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What matching.hpp declares, for one dimension: each is compiled in a file of its own.
#pragma once

#include <Eigen/Core>
#include <memory>
#include <vector>

#include "matching.hpp"
#include "ndtree/query/match.hpp"

namespace ndtree::python {

template <int D>
std::shared_ptr<const Matcher<D>> make_matcher(const Points<D>& points, const MatchOptions& options) {
  return std::make_shared<const Matcher<D>>(points, options);
}
template <int D>
std::shared_ptr<const Matcher<D>> make_matcher(const std::vector<double>& lower,
                                               const std::vector<double>& size, const MatchOptions& options) {
  PointsOfBoxes<D> surface(options.cell_size);
  for (std::size_t i = 0; i < size.size(); ++i) {
    const Vector<D> corner = Eigen::Map<const Vector<D>>(lower.data() + i * D);
    surface.add({corner, corner.array() + size[i]});
  }
  return make_matcher<D>(surface.points(), options);
}
template <int D>
Match<D> match(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& guess,
               const MatchWindow<D>& window, const MotionMatrix<D>& information, bool second) {
  return matcher.match(points, guess, window, information, second);
}
template <int D>
Box<D> reach_of_match(const Points<D>& points, const Pose<D>& guess, const Motion<D>& half) {
  return reach_of<D>(points, guess, half);
}

/// Compiles all of it.
#define NDTREE_PYTHON_MATCHING(D)                                                                     \
  template std::shared_ptr<const Matcher<D>> make_matcher(const Points<D>&, const MatchOptions&);     \
  template std::shared_ptr<const Matcher<D>> make_matcher<D>(                                         \
      const std::vector<double>&, const std::vector<double>&, const MatchOptions&);                   \
  template Match<D> match(const Matcher<D>&, const Points<D>&, const Pose<D>&, const MatchWindow<D>&, \
                          const MotionMatrix<D>&, bool);                                              \
  template Box<D> reach_of_match(const Points<D>&, const Pose<D>&, const Motion<D>&)

}  // namespace ndtree::python
