// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "binders.hpp"
#include "docstrings.hpp"
#include "ndtree/logs/carmen.hpp"
#include "ndtree/logs/simulator.hpp"
#include "ndtree/logs/xyz.hpp"
#include "numpy.hpp"
#include "released.hpp"
#include "simulated_log.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

/// (endpoints (n, dim), origin (dim,) or (n, dim), returned (n,) bool, stamp).
template <int D>
py::tuple to_tuple(const Scan<D>& scan) {
  const py::ssize_t n = scan.size();
  py::array_t<double> endpoints({n, py::ssize_t{D}}, scan.endpoints.data());
  py::object origin;
  if (scan.origins.cols() == 1) {
    origin = py::array_t<double>(py::ssize_t{D}, scan.origins.data());
  } else {
    origin = py::array_t<double>({n, py::ssize_t{D}}, scan.origins.data());
  }
  py::array_t<bool> returned(n);
  for (py::ssize_t i = 0; i < n; ++i) returned.mutable_at(i) = scan.returned.size() == 0 || scan.returned[i];
  return py::make_tuple(endpoints, origin, returned, scan.stamp);
}

template <int D>
py::object to_tuple_or_none(const std::optional<Scan<D>>& scan) {
  if (!scan) return py::none();
  return to_tuple(*scan);
}

/// The parsers report lines of a file as std::runtime_error; for Python a bad line is a ValueError.
template <class Function>
auto as_value_error(Function&& function) {
  try {
    return function();
  } catch (const std::runtime_error& error) {
    throw std::invalid_argument(error.what());
  }
}

template <int D>
void bind_xyz(py::module_& module, const char* name) {
  py::class_<XyzParser<D>>(module, name, doc::XyzParser2)
      .def(py::init<>())
      .def(
          "parse_line",
          [](XyzParser<D>& parser, const std::string& line) {
            return as_value_error([&] { return to_tuple_or_none<D>(parser.parse_line(line)); });
          },
          "line"_a, doc::XyzParser2_parse_line)
      .def(
          "finish", [](XyzParser<D>& parser) { return to_tuple_or_none<D>(parser.finish()); },
          doc::XyzParser2_finish)
      .def_property_readonly("line_number", &XyzParser<D>::line_number, doc::CarmenParser_line_number);
}

template <int D>
void bind_simulated(py::module_& module, const char* name) {
  using Log = SimulatedLog<D>;
  using Point = Eigen::Map<const Vector<D>>;
  py::class_<Log>(module, name, doc::SimulatedLog2)
      .def_property_readonly("dim", [](const Log&) { return D; })
      .def("__len__", &Log::size)
      .def(
          "scan",
          [](const Log& log, std::size_t i) {
            if (i >= log.size())
              throw py::index_error("scan " + std::to_string(i) + ": there are " +
                                    std::to_string(log.size()));
            std::optional<Scan<D>> scan;
            {
              const Released released;
              scan = log.scan(i);
            }
            return to_tuple(*scan);
          },
          "i"_a, doc::SimulatedLog2_scan)
      .def(
          "moved",
          [](const Log& log, std::size_t i) {
            if (i >= log.size())
              throw py::index_error("scan " + std::to_string(i) + ": there are " +
                                    std::to_string(log.size()));
            std::vector<bool> moved;
            {
              const Released released;
              moved = log.moved(i);
            }
            py::array_t<bool> out(static_cast<py::ssize_t>(moved.size()));
            std::copy(moved.begin(), moved.end(), out.mutable_data());
            return out;
          },
          "i"_a, doc::SimulatedLog2_moved)
      .def(
          "contains",
          [](const Log& log, const py::object& object) {
            const DoubleArray points = as_points(object, "points", D);
            const py::ssize_t n = points.shape(0);
            py::array_t<bool> out(n);
            bool* const results = out.mutable_data();
            const double* const data = points.data();
            const Released released;
            for (py::ssize_t i = 0; i < n; ++i)
              results[i] = log.world.contains(Vector<D>(Point(data + i * D)));
            return out;
          },
          "points"_a, doc::SimulatedLog2_contains)
      .def(
          "distance",
          [](const Log& log, const py::object& origins, const py::object& directions, double max_range) {
            const DoubleArray d = as_points(directions, "directions", D);
            const py::ssize_t n = d.shape(0);
            const DoubleArray o = as_points_or_one(origins, "origins", D, n);
            const py::ssize_t step = o.ndim() == 2 ? D : 0;
            py::array_t<double> out(n);
            double* const results = out.mutable_data();
            const double* const pd = d.data();
            const double* const po = o.data();
            for (py::ssize_t i = 0; i < n; ++i)
              if (!(Point(pd + i * D).norm() > 0.0))
                throw py::value_error("directions[" + std::to_string(i) + "]: must not be zero or nan");
            const Released released;
            for (py::ssize_t i = 0; i < n; ++i)
              results[i] = log.world
                               .distance(Vector<D>(Point(po + i * step)),
                                         Vector<D>(Point(pd + i * D).normalized()), max_range)
                               .value_or(std::numeric_limits<double>::quiet_NaN());
            return out;
          },
          "origins"_a, "directions"_a, py::kw_only(), "max_range"_a = std::numeric_limits<double>::infinity(),
          doc::SimulatedLog2_distance);
}

constexpr std::int64_t kMostThings = 1000;  // Of one kind that move in a simulated world.

py::object simulate(const std::string& world, std::uint64_t seed, std::optional<std::size_t> scans,
                    const py::kwargs& settings) {
  SimulationOptions options;
  options.seed = seed;
  options.scans = scans;
  for (const auto& [key, value] : settings) {
    const auto name = key.cast<std::string>();
    double* place = name == "noise_scale"      ? &options.noise_scale
                    : name == "outlier_rate"   ? &options.outlier_rate
                    : name == "no_return_rate" ? &options.no_return_rate
                    : name == "position_sigma" ? &options.position_sigma
                    : name == "heading_sigma"  ? &options.heading_sigma
                    : name == "yaw"            ? &options.yaw
                                               : nullptr;
    std::size_t* count = name == "people"  ? &options.people
                         : name == "doors" ? &options.doors
                         : name == "cars"  ? &options.cars
                                           : nullptr;
    if (place != nullptr) {
      *place = value.cast<double>();
    } else if (count != nullptr) {
      const auto given = value.cast<std::int64_t>();
      if (given < 0 || given > kMostThings)
        throw OptionError(name, std::to_string(given), "in [0, " + std::to_string(kMostThings) + "]");
      *count = static_cast<std::size_t>(given);
    } else {
      throw py::type_error("simulate() got an unexpected keyword argument '" + name + "'");
    }
  }
  if (world == "office") return py::cast(simulate_office(options));
  if (world == "apartment") return py::cast(simulate_apartment(options));
  if (world == "street") return py::cast(simulate_street(options));
  throw OptionError("world", "'" + world + "'", "'office', 'apartment' or 'street'");
}

}  // namespace

template <int D>
const SimulatedLog<D>* simulated_log(const py::object& simulation) {
  if (simulation.is_none()) return nullptr;
  if (!py::isinstance<SimulatedLog<D>>(simulation))
    throw py::value_error("simulation: must be a simulated log with dim = " + std::to_string(D) +
                          ", as the scans");
  return &simulation.cast<const SimulatedLog<D>&>();
}

template const SimulatedLog<2>* simulated_log<2>(const py::object&);
template const SimulatedLog<3>* simulated_log<3>(const py::object&);

void bind_logs(py::module_& module) {
  py::class_<CarmenParser>(module, "CarmenParser", doc::CarmenParser)
      .def(py::init([](std::optional<double> max_range, std::optional<double> field_of_view) {
             CarmenOptions options;
             if (max_range) options.max_range = *max_range;
             options.field_of_view = field_of_view;
             return CarmenParser(options);
           }),
           py::kw_only(), "max_range"_a = py::none(), "field_of_view"_a = py::none())
      .def(
          "parse_line",
          [](CarmenParser& parser, const std::string& line) {
            return as_value_error([&] { return to_tuple_or_none<2>(parser.parse_line(line)); });
          },
          "line"_a, doc::CarmenParser_parse_line)
      .def_property_readonly(
          "field_of_view",
          [](const CarmenParser& parser) -> std::optional<std::pair<double, std::string>> {
            const auto found = parser.field_of_view();
            if (!found) return std::nullopt;
            constexpr const char* names[] = {"option", "param", "beams", "none"};
            return std::make_pair(found->first, std::string(names[static_cast<int>(found->second)]));
          },
          doc::CarmenParser_field_of_view)
      .def_property_readonly("line_number", &CarmenParser::line_number, doc::CarmenParser_line_number);
  bind_xyz<2>(module, "XyzParser2");
  bind_xyz<3>(module, "XyzParser3");
  bind_simulated<2>(module, "SimulatedLog2");
  bind_simulated<3>(module, "SimulatedLog3");
  module.def("simulate", &simulate, "world"_a, py::kw_only(), "seed"_a = 1, "scans"_a = py::none(),
             doc::simulate);
}

}  // namespace ndtree::python
