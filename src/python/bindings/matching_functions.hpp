// SPDX-License-Identifier: BSD-3-Clause
/// @file
/// What matching.hpp declares, for one dimension: each is compiled in a file of its own.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
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
                                               const std::vector<double>& size, double smallest,
                                               const StatesOf& states, const MatchOptions& options) {
  SurfaceOfBoxes<D> boxes(smallest);
  for (std::size_t i = 0; i < size.size(); ++i) {
    const Vector<D> corner = Eigen::Map<const Vector<D>>(lower.data() + i * D);
    boxes.add({corner, corner.array() + size[i]});
  }
  const Points<D> beside = boxes.beside();
  std::vector<std::int8_t> found(static_cast<std::size_t>(beside.cols()));
  states(beside.data(), found.size(), found.data());
  return std::make_shared<const Matcher<D>>(boxes.surface(found), options);
}
template <int D>
Match<D> match(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& guess,
               const MatchWindow<D>& window, const MotionMatrix<D>& information, bool second) {
  return matcher.match(points, guess, window, information, second);
}
template <int D>
std::vector<Match<D>> modes(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& guess,
                            const MatchWindow<D>& window, std::size_t most,
                            const MotionMatrix<D>& information) {
  return matcher.modes(points, guess, window, most, information);
}
template <int D>
double score(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& pose) {
  return matcher.score(points, pose);
}
template <int D>
Box<D> reach_of_match(const Points<D>& points, const Pose<D>& guess, const Motion<D>& half) {
  return reach_of<D>(points, guess, half);
}

/// Compiles all of it.
#define NDTREE_PYTHON_MATCHING(D)                                                                            \
  template std::shared_ptr<const Matcher<D>> make_matcher(const Points<D>&, const MatchOptions&);            \
  template std::shared_ptr<const Matcher<D>> make_matcher<D>(                                                \
      const std::vector<double>&, const std::vector<double>&, double, const StatesOf&, const MatchOptions&); \
  template Match<D> match(const Matcher<D>&, const Points<D>&, const Pose<D>&, const MatchWindow<D>&,        \
                          const MotionMatrix<D>&, bool);                                                     \
  template std::vector<Match<D>> modes(const Matcher<D>&, const Points<D>&, const Pose<D>&,                  \
                                       const MatchWindow<D>&, std::size_t, const MotionMatrix<D>&);          \
  template double score(const Matcher<D>&, const Points<D>&, const Pose<D>&);                                \
  template Box<D> reach_of_match(const Points<D>&, const Pose<D>&, const Motion<D>&)

}  // namespace ndtree::python
