// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/eigen.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "arguments.hpp"
#include "beam_pointers.hpp"
#include "binders.hpp"
#include "docstrings.hpp"
#include "matching.hpp"
#include "ndtree/core/option.hpp"
#include "ndtree/core/parallel.hpp"
#include "numpy.hpp"
#include "python_map.hpp"
#include "released.hpp"

namespace py = pybind11;
using namespace pybind11::literals;

namespace ndtree::python {
namespace {

using AnyMatcher = std::variant<std::shared_ptr<const Matcher<2>>, std::shared_ptr<const Matcher<3>>>;

struct PythonMatcher {
  AnyMatcher matcher;

  [[nodiscard]] int dim() const { return static_cast<int>(matcher.index()) + 2; }
};

/// Of any dimension; matrices by rows.
struct PythonMatch {
  Eigen::MatrixXd pose;
  Eigen::MatrixXd covariance;
  double score;
  double second;
  double inliers;
};

template <int D>
PythonMatch to_python(const Match<D>& match) {
  Eigen::MatrixXd pose = Eigen::MatrixXd::Identity(D + 1, D + 1);
  pose.topLeftCorner<D, D>() = match.pose.rotation;
  pose.topRightCorner<D, 1>() = match.pose.translation;
  return {pose, match.covariance, match.score, match.second, match.inliers};
}

template <int D>
Points<D> points_of(const DoubleArray& array) {
  return Eigen::Map<const Points<D>>(array.data(), D, array.shape(0));
}

template <int D>
Pose<D> pose_at(const Poses& poses, std::size_t i = 0) {
  return pose_of<D>(poses.numbers.data() + i * (D * D + D));
}

/// (dx, dy, dyaw), or (dx, dy, dz, dyaw[, droll, dpitch]).
template <int D>
MatchWindow<D> window_of(const DoubleArray& numbers, double apart, double apart_angle) {
  const py::ssize_t count = numbers.ndim() == 1 ? numbers.shape(0) : -1;
  if (D == 2 ? count != 3 : count != 4 && count != 6)
    throw py::value_error("window has shape " + shape_text(numbers) + ": must be " +
                          (D == 2 ? "(3,): dx, dy, dyaw" : "(4,) or (6,): dx, dy, dz, dyaw, droll, dpitch"));
  if (!(apart > 0.0) || !(apart_angle > 0.0))
    throw py::value_error("apart = " + number_text(apart) +
                          " m and apart_angle = " + number_text(apart_angle) + " rad: must be > 0");
  MatchWindow<D> window;
  for (int a = 0; a < D; ++a) window.half[a] = numbers.data()[a];
  constexpr std::array<int, 3> kAxes = D == 2 ? std::array<int, 3>{2, 2, 2} : std::array<int, 3>{5, 3, 4};
  for (int a = D; a < count; ++a) window.half[kAxes[static_cast<std::size_t>(a - D)]] = numbers.data()[a];
  window.apart = apart;
  window.apart_angle = apart_angle;
  return window;
}

template <int D>
MotionMatrix<D> information_of(const py::object& object) {
  if (object.is_none()) return MotionMatrix<D>::Zero();
  const DoubleArray array = as_doubles(object, "information");
  if (array.ndim() != 2 || array.shape(0) != kFreedoms<D> || array.shape(1) != kFreedoms<D>)
    throw py::value_error("information has shape " + shape_text(array) + ": must be (" +
                          std::to_string(kFreedoms<D>) + ", " + std::to_string(kFreedoms<D>) + ")");
  const MotionMatrix<D> matrix = Eigen::Map<const MotionMatrix<D>>(array.data());
  if (!matrix.allFinite() || !matrix.isApprox(matrix.transpose()))
    throw py::value_error("information: must be finite and symmetric");
  return matrix;
}

/// @throws TypeError naming what is no number.
double number_or(const py::object& object, const char* name, double otherwise) {
  if (object.is_none()) return otherwise;
  const double number = PyFloat_AsDouble(object.ptr());
  if (number == -1.0 && PyErr_Occurred() != nullptr) {
    PyErr_Clear();
    throw py::type_error(std::string(name) + " = " + std::string(py::repr(object)) + ": must be a number");
  }
  return number;
}

/// What a search returns; a far point is named where it makes more rotations of a window than there may be.
template <int D, class Search>
auto naming_far_points(const Points<D>& points, const MatchWindow<D>& window, const Search& search) {
  try {
    return search();
  } catch (const std::invalid_argument&) {
    constexpr double kMostMetres = 1e3;
    const double farthest = points.cols() > 0 ? points.colwise().norm().maxCoeff() : 0.0;
    if (farthest < kMostMetres || !(window.half.array() >= 0.0).all() || !window.half.allFinite()) throw;
    throw std::invalid_argument("points: the farthest is " + describe_number(farthest) +
                                " m away, where a window has too many rotations: leave it out, or give "
                                "larger cells");
  }
}

/// Matches as the library does; without points the pose is the guess.
template <int D>
Match<D> matched(const Matcher<D>& matcher, const Points<D>& points, const Pose<D>& from,
                 const MatchWindow<D>& window, const MotionMatrix<D>& information, bool second) {
  Match<D> found = naming_far_points<D>(
      points, window, [&] { return match(matcher, points, from, window, information, second); });
  if (points.cols() == 0) found.pose = from;
  return found;
}

/// @param cells that the default radius is long.
MatchOptions options_of(double cell_size, const py::object& sigma, const py::object& radius, double noise,
                        double cells = 4.0) {
  MatchOptions options;
  options.cell_size = cell_size;
  options.sigma = number_or(sigma, "sigma", cell_size);
  options.radius = number_or(radius, "radius", cells * cell_size);
  options.noise = noise;
  options.validate();
  return options;
}

PythonMatcher matcher_of_points(const py::object& points, double cell_size, const py::object& sigma,
                                const py::object& radius, double noise) {
  const MatchOptions options = options_of(cell_size, sigma, radius, noise);
  const DoubleArray any = as_doubles(points, "points");
  const int dim = any.ndim() == 2 && any.shape(1) == 3 ? 3 : 2;
  const DoubleArray array = as_points(points, "points", dim);
  const Released released;
  if (dim == 2) return {make_matcher<2>(points_of<2>(array), options)};
  return {make_matcher<3>(points_of<3>(array), options)};
}

/// Calls `use` with the matcher of one dimension, as its own type.
template <class Use>
auto with(const PythonMatcher& m, const Use& use) {
  return std::visit([&](const auto& matcher) { return use(*matcher); }, m.matcher);
}

template <int D>
PythonMatch match_one(const Matcher<D>& matcher, const py::object& points, const py::object& guess,
                      const py::object& window, const py::object& information, double apart,
                      double apart_angle, bool second) {
  const DoubleArray array = as_points(points, "points", D);
  const Pose<D> from = pose_at<D>(pose_from(guess, D, "guess"));
  const MatchWindow<D> in = window_of<D>(as_doubles(window, "window"), apart, apart_angle);
  const MotionMatrix<D> known = information_of<D>(information);
  const Released released;
  return to_python(matched<D>(matcher, points_of<D>(array), from, in, known, second));
}

template <int D>
std::vector<PythonMatch> modes_of(const Matcher<D>& matcher, const py::object& points,
                                  const py::object& guess, const py::object& window,
                                  const py::object& information, int most, double apart, double apart_angle) {
  if (most < 1) throw py::value_error("most = " + std::to_string(most) + ": must be >= 1");
  const DoubleArray array = as_points(points, "points", D);
  const Pose<D> from = pose_at<D>(pose_from(guess, D, "guess"));
  const MatchWindow<D> in = window_of<D>(as_doubles(window, "window"), apart, apart_angle);
  const MotionMatrix<D> known = information_of<D>(information);
  const Released released;
  std::vector<PythonMatch> results;
  const Points<D> scan = points_of<D>(array);
  const auto found = naming_far_points<D>(
      scan, in, [&] { return modes(matcher, scan, from, in, static_cast<std::size_t>(most), known); });
  for (const Match<D>& one : found) results.push_back(to_python(one));
  return results;
}

template <int D>
double score_of(const Matcher<D>& matcher, const py::object& points, const py::object& pose) {
  const DoubleArray array = as_points(points, "points", D);
  const Pose<D> at = pose_at<D>(pose_from(pose, D, "pose"));
  const Released released;
  return score(matcher, points_of<D>(array), at);
}

template <int D>
std::vector<PythonMatch> match_many(const Matcher<D>& matcher, const std::vector<py::object>& scans,
                                    const py::object& guesses, const py::object& window, double apart,
                                    double apart_angle, int threads) {
  const Poses from = poses_from(guesses, D, "guesses");
  if (from.count != scans.size())
    throw py::value_error("guesses: are " + std::to_string(from.count) + ", must be one for each of the " +
                          std::to_string(scans.size()) + " scans");
  if (threads < 0) throw py::value_error("threads = " + std::to_string(threads) + ": must be >= 0");
  const MatchWindow<D> in = window_of<D>(as_doubles(window, "window"), apart, apart_angle);
  std::vector<DoubleArray> arrays;
  arrays.reserve(scans.size());
  for (const py::object& scan : scans) arrays.push_back(as_points(scan, "scans", D));
  std::vector<Points<D>> points;
  points.reserve(arrays.size());
  for (const DoubleArray& array : arrays) points.push_back(points_of<D>(array));
  std::vector<PythonMatch> results(scans.size());
  const MotionMatrix<D> unknown = MotionMatrix<D>::Zero();
  const Released released;
  const unsigned cores = threads > 0 ? static_cast<unsigned>(threads) : std::thread::hardware_concurrency();
  Workers workers(std::max(1u, cores));
  workers.for_each_task(scans.size(), [&](std::size_t, std::size_t i) {
    results[i] = to_python(matched<D>(matcher, points[i], pose_at<D>(from, i), in, unknown, true));
  });
  return results;
}

/// The surfaces around where a scan may be.
template <int D>
std::shared_ptr<const Matcher<D>> matcher_of(const PythonMap& map, const Box<D>& box,
                                             const MatchOptions& options) {
  RegionStates occupied;
  occupied.occupied = true;
  return map.read([&](const MapInterface& m) {
    const LeafArrays leaves = m.leaves_in(box.lower.data(), box.upper.data(), occupied);
    const auto states = [&m](const double* points, std::size_t n, std::int8_t* out) {
      m.state(points, n, out);
    };
    return make_matcher<D>(leaves.lower, leaves.size, m.options().min_cell_size, states, options);
  });
}

void require_plane_or_space(const PythonMap& map) {
  const int dim = map.constant().dim();
  if (dim != 2 && dim != 3) throw py::value_error("dim = " + std::to_string(dim) + ": must be 2 or 3");
}

/// Of a map. Its surfaces have steps of a cell: their normals are told by more of them.
MatchOptions options_of(const PythonMap& map, const py::object& cell_size, const py::object& sigma,
                        const py::object& radius, const py::object& noise) {
  const MapOptions& of_map = map.constant().options();
  return options_of(number_or(cell_size, "cell_size", of_map.min_cell_size), sigma, radius,
                    number_or(noise, "noise", of_map.range_sigma), 10.0);
}

PythonMatcher matcher_of_map(const PythonMap& map, const py::object& box, const py::object& cell_size,
                             const py::object& sigma, const py::object& radius, const py::object& noise) {
  require_plane_or_space(map);
  const MatchOptions options = options_of(map, cell_size, sigma, radius, noise);
  const int dim = map.constant().dim();
  std::optional<BoxArgument> within;
  if (!box.is_none()) within.emplace(box, dim);
  const auto make = [&](auto dimension) -> PythonMatcher {
    constexpr int D = decltype(dimension)::value;
    constexpr double kFar = std::numeric_limits<double>::infinity();
    Box<D> region{Vector<D>::Constant(-kFar), Vector<D>::Constant(kFar)};
    if (within) {
      const AnyBox corners = *within;
      region = {Eigen::Map<const Vector<D>>(corners.lower), Eigen::Map<const Vector<D>>(corners.upper)};
    }
    return {matcher_of<D>(map, region, options)};
  };
  return dim == 2 ? make(std::integral_constant<int, 2>()) : make(std::integral_constant<int, 3>());
}

template <int D>
PythonMatch match_in_map(const PythonMap& map, const py::object& points, const py::object& guess,
                         const py::object& window, const MatchOptions& options, double apart,
                         double apart_angle) {
  const DoubleArray array = as_points(points, "points", D);
  const Pose<D> from = pose_at<D>(pose_from(guess, D, "guess"));
  const MatchWindow<D> in = window_of<D>(as_doubles(window, "window"), apart, apart_angle);
  for (int a = 0; a < kFreedoms<D>; ++a)
    if (!(in.half[a] >= 0.0 && std::isfinite(in.half[a])))
      throw py::value_error("window = " + number_text(in.half[a]) + ": must be >= 0 and finite");
  const Points<D> scan = points_of<D>(array);
  const auto matcher = matcher_of<D>(map, reach_of_match<D>(scan, from, in.half), options);
  const Released released;
  return to_python(matched<D>(*matcher, scan, from, in, MotionMatrix<D>::Zero(), true));
}

PythonMatch match_map(const PythonMap& map, const py::object& points, const py::object& guess,
                      const py::object& window, const py::object& cell_size, double apart,
                      double apart_angle) {
  require_plane_or_space(map);
  const MatchOptions options = options_of(map, cell_size, py::none(), py::none(), py::none());
  return map.constant().dim() == 2 ? match_in_map<2>(map, points, guess, window, options, apart, apart_angle)
                                   : match_in_map<3>(map, points, guess, window, options, apart, apart_angle);
}

}  // namespace

void bind_match(py::module_& module) {
  const MatchOptions defaults;
  py::class_<PythonMatch>(module, "Match")
      .def_readonly("pose", &PythonMatch::pose)
      .def_readonly("covariance", &PythonMatch::covariance)
      .def_readonly("score", &PythonMatch::score)
      .def_readonly("second", &PythonMatch::second)
      .def_readonly("inliers", &PythonMatch::inliers);

  py::class_<PythonMatcher>(module, "Matcher", doc::Matcher)
      .def(py::init(&matcher_of_points), "points"_a, py::kw_only(), "cell_size"_a = defaults.cell_size,
           "sigma"_a = py::none(), "radius"_a = py::none(), "noise"_a = defaults.noise)
      .def_property_readonly("dim", &PythonMatcher::dim, doc::Matcher_dim)
      .def(
          "match",
          [](const PythonMatcher& m, const py::object& points, const py::object& guess,
             const py::object& window, const py::object& information, double apart, double apart_angle,
             bool second) {
            return with(m, [&](const auto& matcher) {
              return match_one(matcher, points, guess, window, information, apart, apart_angle, second);
            });
          },
          "points"_a, "guess"_a, py::kw_only(), "window"_a, "information"_a = py::none(), "apart"_a = 0.5,
          "apart_angle"_a = 0.35, "second"_a = true, doc::Matcher_match)
      .def(
          "modes",
          [](const PythonMatcher& m, const py::object& points, const py::object& guess,
             const py::object& window, const py::object& information, int most, double apart,
             double apart_angle) {
            return with(m, [&](const auto& matcher) {
              return modes_of(matcher, points, guess, window, information, most, apart, apart_angle);
            });
          },
          "points"_a, "guess"_a, py::kw_only(), "window"_a, "information"_a = py::none(), "most"_a = 8,
          "apart"_a = 0.5, "apart_angle"_a = 0.35, doc::Matcher_modes)
      .def(
          "score",
          [](const PythonMatcher& m, const py::object& points, const py::object& pose) {
            return with(m, [&](const auto& matcher) { return score_of(matcher, points, pose); });
          },
          "points"_a, "pose"_a, doc::Matcher_score)
      .def(
          "match_all",
          [](const PythonMatcher& m, const std::vector<py::object>& scans, const py::object& guesses,
             const py::object& window, double apart, double apart_angle, int threads) {
            return with(m, [&](const auto& matcher) {
              return match_many(matcher, scans, guesses, window, apart, apart_angle, threads);
            });
          },
          "scans"_a, "guesses"_a, py::kw_only(), "window"_a, "apart"_a = 0.5, "apart_angle"_a = 0.35,
          "threads"_a = 0, doc::Matcher_match_all);

  auto map = py::reinterpret_borrow<py::class_<PythonMap>>(module.attr("OccupancyMap"));
  map.def("match", &match_map, "points"_a, "guess"_a, py::kw_only(), "window"_a, "cell_size"_a = py::none(),
          "apart"_a = 0.5, "apart_angle"_a = 0.35, doc::OccupancyMap_match);
  map.def("matcher", &matcher_of_map, "box"_a = py::none(), py::kw_only(), "cell_size"_a = py::none(),
          "sigma"_a = py::none(), "radius"_a = py::none(), "noise"_a = py::none(), doc::OccupancyMap_matcher);
}

}  // namespace ndtree::python
