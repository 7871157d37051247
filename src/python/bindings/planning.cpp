// SPDX-License-Identifier: BSD-3-Clause
// Paths through maps.
#include <cmath>
#include <limits>
#include <memory>
#include <string>
#include <utility>

#include "arguments.hpp"
#include "docstrings.hpp"
#include "map_queries.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

struct PythonPath {
  py::array points;
  std::string status, reason;
  double length, clearance;
  std::size_t expanded;
};
struct PythonPlanner {
  std::unique_ptr<AnyPlanner> planner;
  int dim;
  mutable SharedLock lock;
};

double unknown_cost_from(const py::object& unknown) {
  if (py::isinstance<py::str>(unknown)) {
    const auto name = unknown.cast<std::string>();
    if (name == "blocked") return std::numeric_limits<double>::infinity();
    if (name == "free") return 1.0;
    throw py::value_error("unknown = '" + name + "': must be 'blocked', 'free' or a cost >= 1");
  }
  double cost = 0.0;
  try {
    if (py::isinstance<py::bool_>(unknown) ||
        py::isinstance(unknown, py::module_::import("numpy").attr("bool_")))
      throw py::cast_error();
    cost = unknown.cast<double>();
  } catch (const py::cast_error&) {
    throw py::type_error("unknown = " + py::repr(unknown).cast<std::string>() +
                         ": must be 'blocked', 'free' or a cost >= 1");
  }
  return cost;
}
PlannerOptions options_from(double clearance, const py::object& unknown) {
  PlannerOptions options;
  options.clearance = clearance;
  options.unknown_cost = unknown_cost_from(unknown);
  options.validate();
  return options;
}
double seconds_from(const py::object& seconds) {
  if (seconds.is_none()) return std::numeric_limits<double>::infinity();
  const auto value = seconds.cast<double>();
  if (!(value >= 0.0)) throw py::value_error("max_seconds = " + number_text(value) + ": must be >= 0");
  return value;
}
DoubleArray point_from(const py::object& object, const char* name, int dim, const char* other = "") {
  DoubleArray point = as_doubles(object, name);
  if (point.ndim() != 1 || point.shape(0) != dim)
    throw py::value_error(std::string(name) + ": shape " + shape_text(point) + ", expected (" +
                          std::to_string(dim) + ",)" + other);
  return point;
}
/// A point; or, in the plane, x, y and yaw.
DoubleArray place_from(const py::object& object, const char* name, int dim) {
  DoubleArray place = as_doubles(object, name);
  if (dim == 2 && place.ndim() == 1 && place.shape(0) == 3) {
    pose_from(place, dim, name);  // Checks it, and warns of degrees.
    return place;
  }
  return point_from(object, name, dim, dim == 2 ? ", or (3,) of x, y and yaw" : "");
}
PythonPath to_python(AnyPath&& any, int dim) {
  const char* const status = any.status == PathStatus::found  ? "found"
                             : any.status == PathStatus::none ? "none"
                                                              : "out of time";
  return {take(std::move(any.points), dim), status, any.reason, any.length, any.clearance, any.expanded};
}

/// Calls `question(planner)` without the interpreter's lock.
template <class Question>
auto ask(const PythonPlanner& planner, SharedLock::Use use, const Question& question) {
  const Released released;
  const CallInProgress call;
  const SharedLock::Holder holder(planner.lock, use);
  return question(*planner.planner);
}
PythonPath plan_with(const PythonPlanner& planner, const py::object& start, const py::object& goal,
                     const py::object& max_seconds, int headings) {
  const double seconds = seconds_from(max_seconds);
  const DoubleArray from = place_from(start, "start", planner.dim);
  const DoubleArray to = place_from(goal, "goal", planner.dim);
  if (from.shape(0) != to.shape(0))
    throw py::value_error("goal: shape " + shape_text(to) + ", expected " + shape_text(from) + " as start");
  const bool turns = from.shape(0) > planner.dim;
  AnyPath path = ask(planner, SharedLock::Use::change, [&, a = from.data(), b = to.data()](AnyPlanner& p) {
    return turns ? p.plan_turning(a, b, headings, seconds) : p.plan(a, b, seconds);
  });
  return to_python(std::move(path), turns ? 3 : planner.dim);
}
std::unique_ptr<PythonPlanner> planner_of(const PythonMap& map, const PythonShape& body, double clearance,
                                          const py::object& unknown) {
  const PlannerOptions options = options_from(clearance, unknown);
  auto planner = std::make_unique<PythonPlanner>();
  planner->dim = map.constant().dim();
  planner->planner =
      map.read([&](const MapInterface& m) { return m.queries()->planner(body.parts, options); });
  return planner;
}
/// The search reads a snapshot, so writers of the map do not wait for it.
PythonPath plan_once(const PythonMap& map, const py::object& start, const py::object& goal,
                     const PythonShape& body, double clearance, const py::object& unknown,
                     const py::object& max_seconds, int headings) {
  return plan_with(*planner_of(map, body, clearance, unknown), start, goal, max_seconds, headings);
}

struct GainArrays {
  py::array volume, bits;
};
GainArrays information_gain(const PythonMap& map, const py::object& poses, const py::object& sensor,
                            int threads) {
  const int dim = map.constant().dim();
  const Poses placed = poses_from(poses, dim);
  if (threads < 0) throw py::value_error("threads = " + std::to_string(threads) + ": must be >= 0");
  for (const char* const name : {"directions", "spacing", "max_range", "mean_free_path"})
    if (!py::hasattr(sensor, name)) throw py::type_error("sensor: must be a RangeSensor");
  const DoubleArray directions = as_doubles(sensor.attr("directions"), "sensor.directions");
  const DoubleArray spacing = as_doubles(sensor.attr("spacing"), "sensor.spacing");
  if (directions.ndim() != 2 || directions.shape(1) != dim)
    throw py::value_error("sensor: directions of shape " + shape_text(directions) + ", expected (n, " +
                          std::to_string(dim) + ") of a map with dim = " + std::to_string(dim));
  if (spacing.ndim() != 2 || spacing.shape(0) != directions.shape(0) || spacing.shape(1) != dim - 1)
    throw py::value_error("sensor: spacing of shape " + shape_text(spacing) + ", expected (" +
                          std::to_string(directions.shape(0)) + ", " + std::to_string(dim - 1) + ")");
  const AnyBeamPattern pattern{
      directions.data(), spacing.data(), static_cast<std::size_t>(directions.shape(0)),
      sensor.attr("max_range").cast<double>(), sensor.attr("mean_free_path").cast<double>()};
  py::array_t<double> volume(static_cast<py::ssize_t>(placed.count));
  py::array_t<double> bits(static_cast<py::ssize_t>(placed.count));
  map.read([&, v = volume.mutable_data(), b = bits.mutable_data()](const MapInterface& m) {
    m.queries()->information_gain(placed.numbers.data(), placed.count, pattern,
                                  static_cast<std::size_t>(threads), v, b);
  });
  return {volume, bits};
}

void bind_path(py::module_& module) {
  py::class_<GainArrays>(module, "InformationGain")
      .def_readonly("volume", &GainArrays::volume)
      .def_readonly("bits", &GainArrays::bits);
  py::class_<PythonPath>(module, "Path")
      .def_readonly("points", &PythonPath::points)
      .def_readonly("status", &PythonPath::status)
      .def_readonly("reason", &PythonPath::reason)
      .def_readonly("length", &PythonPath::length)
      .def_readonly("clearance", &PythonPath::clearance)
      .def_readonly("expanded", &PythonPath::expanded);
}

}  // namespace

void bind_planning(py::module_& module) {
  bind_path(module);
  py::class_<PythonMap> map_type = module.attr("OccupancyMap");
  map_type.def("plan", &plan_once, "start"_a, "goal"_a, py::kw_only(), "body"_a, "clearance"_a = 0.0,
               "unknown"_a = "blocked", "max_seconds"_a = py::none(), "headings"_a = 16,
               doc::OccupancyMap_plan);
  map_type.def("information_gain", &information_gain, "poses"_a, "sensor"_a, py::kw_only(), "threads"_a = 0,
               doc::OccupancyMap_information_gain);
  py::class_<PythonPlanner>(module, "Planner", doc::Planner)
      .def(py::init(&planner_of), "map"_a, "body"_a, py::kw_only(), "clearance"_a = 0.0,
           "unknown"_a = "blocked")
      .def("plan", &plan_with, "start"_a, "goal"_a, py::kw_only(), "max_seconds"_a = py::none(),
           "headings"_a = 16, doc::Planner_plan)
      .def(
          "ways",
          [](const PythonPlanner& planner, const py::object& start, const py::object& goals,
             const py::object& max_seconds) {
            const double seconds = seconds_from(max_seconds);
            const DoubleArray from = point_from(start, "start", planner.dim);
            const DoubleArray to = as_points(goals, "goals", planner.dim);
            py::array_t<double> lengths(to.shape(0));
            ask(planner, SharedLock::Use::change,
                [&, a = from.data(), b = to.data(), n = static_cast<std::size_t>(to.shape(0)),
                 out = lengths.mutable_data()](AnyPlanner& p) { p.ways(a, b, n, seconds, out); });
            return lengths;
          },
          "start"_a, "goals"_a, py::kw_only(), "max_seconds"_a = py::none(), doc::Planner_ways)
      .def(
          "update",
          [](const PythonPlanner& planner, const PythonMap& map) {
            return map.read([&](const MapInterface& m) {
              const SharedLock::Holder holder(planner.lock, SharedLock::Use::change);
              return planner.planner->update(*m.queries());
            });
          },
          "map"_a, doc::Planner_update)
      .def(
          "first_blocked",
          [](const PythonPlanner& planner, const py::object& points) {
            DoubleArray path = as_doubles(points, "points");
            const bool turns = planner.dim == 2 && path.ndim() == 2 && path.shape(1) == 3;
            if (!turns) path = as_points(points, "points", planner.dim);
            const auto n = static_cast<std::size_t>(path.shape(0));
            return ask(planner, SharedLock::Use::look, [n, turns, p = path.data()](const AnyPlanner& one) {
              return turns ? one.first_blocked_turning(p, n) : one.first_blocked(p, n);
            });
          },
          "points"_a, doc::Planner_first_blocked)
      .def(
          "corridors",
          [](const PythonPlanner& planner, const py::object& points, double reach) {
            const DoubleArray path = as_points(points, "points", planner.dim);
            const auto n = static_cast<std::size_t>(path.shape(0));
            auto all = ask(
                planner, SharedLock::Use::look,
                [n, reach, p = path.data()](const AnyPlanner& one) { return one.corridors(p, n, reach); });
            py::list corridors;
            for (std::vector<double>& planes : all)
              corridors.append(take(std::move(planes), planner.dim + 1));
            return corridors;
          },
          "points"_a, py::kw_only(), "reach"_a = 1.0, doc::Planner_corridors)
      .def_property_readonly(
          "memory_bytes",
          [](const PythonPlanner& planner) {
            return ask(planner, SharedLock::Use::look,
                       [](const AnyPlanner& one) { return one.memory_bytes(); });
          },
          doc::Planner_memory_bytes);
}

}  // namespace ndtree::python
