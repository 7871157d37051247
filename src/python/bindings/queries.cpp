// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/stl.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "arguments.hpp"
#include "docstrings.hpp"
#include "map_queries.hpp"
#include "python_field.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

struct NearestArrays {
  py::array distance, point;
};
struct RayEnds {
  py::array distance, state, lower, size;
};
struct PythonFrontier {
  py::array center, direction, cells, size;
  double area;
};

UnknownSpace unknown_from(const std::string& name) {
  if (name == "free") return UnknownSpace::free;
  if (name == "occupied") return UnknownSpace::occupied;
  throw py::value_error("unknown = '" + name + "': must be 'free' or 'occupied'");
}

/// Calls `change(map, place)` with a Shape in a pose, or a box.
template <class Change>
void change_in(PythonMap& map, const py::object& where, const py::object& pose, const Change& change) {
  const int dim = map.constant().dim();
  if (!py::isinstance<PythonShape>(where)) {
    if (!pose.is_none())
      throw py::value_error(
          "pose: is that of a Shape, and a box of two corners has none; ndtree.Box is a Shape");
    const BoxArgument box(where, dim, "where");
    map.write([&](MapInterface& m) { change(m, AnyPlace(AnyBox(box))); });
    return;
  }
  const PythonShape shape = where.cast<PythonShape>();
  Poses placed{{}, 1};
  if (pose.is_none()) {
    for (int row = 0; row < dim; ++row)
      for (int column = 0; column < dim; ++column) placed.numbers.push_back(row == column ? 1.0 : 0.0);
    placed.numbers.resize(static_cast<std::size_t>(dim * dim + dim), 0.0);
  } else {
    placed = pose_from(pose, dim, "pose");
  }
  map.write([&](MapInterface& m) { change(m, AnyPlace(PlacedShape{shape.parts, placed.numbers.data()})); });
}

CellState marked_state(const std::string& name) {
  if (name == "free") return CellState::free;
  if (name == "occupied") return CellState::occupied;
  throw py::value_error("state = '" + name + "': must be 'free' or 'occupied'; clear() makes cells unknown");
}

NearestArrays nearest_occupied(const PythonMap& map, const py::object& object, double max_distance) {
  if (!(max_distance >= 0.0))
    throw py::value_error("max_distance = " + std::to_string(max_distance) + " m: must be >= 0");
  const DoubleArray points = as_points(object, "points", map.constant().dim());
  py::array_t<double> distance(points.shape(0));
  py::array_t<double> nearest({points.shape(0), points.shape(1)});
  map.read([&, p = points.data(), n = static_cast<std::size_t>(points.shape(0)), d = distance.mutable_data(),
            to = nearest.mutable_data()](const MapInterface& m) {
    m.queries()->nearest_occupied(p, n, max_distance, d, to);
  });
  return {distance, nearest};
}

py::object bounds(const PythonMap& map) {
  std::vector<double> corners = map.read([](const MapInterface& m) { return m.queries()->bounds(); });
  if (corners.empty()) return py::none();
  const py::array both = take(std::move(corners), map.constant().dim());
  return py::make_tuple(both[py::int_(0)], both[py::int_(1)]);
}

/// Calls `ask` with the field itself, whatever its dimension, beside other threads that do.
template <class Ask>
auto asked(const PythonField& shared, const Ask& ask) {
  return shared.read([&](const AnyField& any) { return std::visit(ask, any.field); });
}
/// As ask(), for what never changes: no lock is needed.
template <class Ask>
auto constant(const PythonField& shared, const Ask& ask) {
  return std::visit(ask, shared.constant().field);
}

py::array_t<float> values_of(const PythonField& shared) {
  py::array_t<float> values(constant(shared, [](const auto& field) {
    return std::vector<py::ssize_t>(field.shape().begin(), field.shape().end());
  }));
  asked(shared, [out = values.mutable_data()](const auto& field) {
    std::copy(field.values().begin(), field.values().end(), out);
  });
  return values;
}

py::array_t<double> distance_at(const PythonField& shared, const py::object& object) {
  const DoubleArray points = as_points(object, "points", shared.constant().dim());
  py::array_t<double> out(points.shape(0));
  shared.read([data = points.data(), n = static_cast<std::size_t>(points.shape(0)),
               results = out.mutable_data()](const AnyField& any) { any.distance(data, n, results); });
  return out;
}

py::array_t<double> gradient_at(const PythonField& shared, const py::object& object) {
  const DoubleArray points = as_points(object, "points", shared.constant().dim());
  py::array_t<double> out({points.shape(0), points.shape(1)});
  shared.read([data = points.data(), n = static_cast<std::size_t>(points.shape(0)),
               results = out.mutable_data()](const AnyField& any) { any.gradient(data, n, results); });
  return out;
}

py::array_t<double> lower_of(const PythonField& shared) {
  return constant(shared,
                  [](const auto& f) { return py::array_t<double>(f.lower().size(), f.lower().data()); });
}
double cell_size_of(const PythonField& shared) {
  return constant(shared, [](const auto& field) { return field.cell_size(); });
}
double max_distance_of(const PythonField& shared) {
  return constant(shared, [](const auto& field) { return field.max_distance(); });
}

py::tuple state_of_field(const PythonField& shared) {
  const bool unknown_is_occupied =
      constant(shared, [](const auto& field) { return field.unknown() == UnknownSpace::occupied; });
  return py::make_tuple(lower_of(shared), cell_size_of(shared), max_distance_of(shared), values_of(shared),
                        unknown_is_occupied);
}

template <int D>
std::unique_ptr<PythonField> field_from(const DoubleArray& lower, double cell_size, double max_distance,
                                        const py::array_t<float, py::array::c_style>& values,
                                        UnknownSpace unknown) {
  typename DistanceField<D>::Shape shape;
  for (std::size_t a = 0; a < D; ++a)
    shape[a] = static_cast<std::size_t>(values.shape(static_cast<py::ssize_t>(a)));
  DistanceField<D> field(Eigen::Map<const Vector<D>>(lower.data()), cell_size, shape, max_distance, unknown);
  std::copy_n(values.data(), values.size(), field.values().begin());
  return std::make_unique<PythonField>(AnyField{std::move(field)});
}

std::unique_ptr<PythonField> field_of_state(const py::tuple& state) {
  const DoubleArray lower = as_doubles(state[0], "lower");
  const auto values = state[3].cast<py::array_t<float, py::array::c_style>>();
  const auto cell_size = state[1].cast<double>();
  const auto max_distance = state[2].cast<double>();
  const auto unknown = state[4].cast<bool>() ? UnknownSpace::occupied : UnknownSpace::free;
  if (lower.ndim() == 1 && lower.shape(0) == values.ndim()) {
    if (values.ndim() == 2) return field_from<2>(lower, cell_size, max_distance, values, unknown);
    if (values.ndim() == 3) return field_from<3>(lower, cell_size, max_distance, values, unknown);
    if (values.ndim() == 4) return field_from<4>(lower, cell_size, max_distance, values, unknown);
  }
  throw py::value_error("DistanceField: is no state of one");
}

std::vector<double> as_vector(const py::object& object, const char* name) {
  if (object.is_none()) return {};
  const DoubleArray array = as_doubles(object, name);
  if (array.ndim() != 1 || array.shape(0) < 2 || array.shape(0) > 3)
    throw py::value_error(std::string(name) + ": shape " + shape_text(array) + ", expected (2,) or (3,)");
  std::vector<double> values(array.data(), array.data() + array.shape(0));
  for (const double value : values)
    if (!std::isfinite(value)) throw py::value_error(std::string(name) + ": must be finite");
  return values;
}
double checked_radius(double radius) {
  if (!(radius >= 0.0) || !std::isfinite(radius))
    throw py::value_error("radius = " + std::to_string(radius) + " m: must be >= 0 and finite");
  return radius;
}
std::string text_of(const std::vector<double>& values) {
  std::string text = "(";
  for (std::size_t i = 0; i < values.size(); ++i) text += (i > 0 ? ", " : "") + number_text(values[i]);
  return text + ")";
}

PythonShape sphere(double radius, const py::object& center) {
  AnyShapePart part;
  part.a = as_vector(center, "center");
  part.radius = checked_radius(radius);
  const std::string place = part.a.empty() ? "" : ", center=" + text_of(part.a);
  return {{part}, "Sphere(radius=" + number_text(radius) + place + ")"};
}
PythonShape capsule(const py::object& a, const py::object& b, double radius) {
  AnyShapePart part;
  part.a = as_vector(a, "a");
  part.b = as_vector(b, "b");
  if (part.a.size() != part.b.size() || part.a.empty())
    throw py::value_error("a and b: must be points of the same dimension");
  part.radius = checked_radius(radius);
  return {
      {part},
      "Capsule(a=" + text_of(part.a) + ", b=" + text_of(part.b) + ", radius=" + number_text(radius) + ")"};
}
PythonShape box_shape(const py::object& size, const py::object& center, const py::object& rotation) {
  AnyShapePart part;
  part.is_box = true;
  part.b = as_vector(size, "size");
  part.a = as_vector(center, "center");
  if (part.b.empty()) throw py::value_error("size: must be an edge length for each axis");
  if (!part.a.empty() && part.a.size() != part.b.size())
    throw py::value_error("center: has another dimension than size");
  std::string text = "Box(size=" + text_of(part.b);
  if (!part.a.empty()) text += ", center=" + text_of(part.a);
  for (double& half : part.b) {
    if (!(half >= 0.0)) throw py::value_error("size: every edge must be >= 0");
    half *= 0.5;
  }
  if (!rotation.is_none()) {
    const DoubleArray axes = as_doubles(rotation, "rotation");
    const auto dim = static_cast<py::ssize_t>(part.b.size());
    if (axes.ndim() != 2 || axes.shape(0) != dim || axes.shape(1) != dim)
      throw py::value_error("rotation: shape " + shape_text(axes) + ", expected (" + std::to_string(dim) +
                            ", " + std::to_string(dim) + ")");
    for (py::ssize_t column = 0; column < dim; ++column)
      for (py::ssize_t row = 0; row < dim; ++row) part.axes.push_back(axes.data()[row * dim + column]);
    for (py::ssize_t c = 0; c < dim; ++c)
      for (py::ssize_t d = 0; d < dim; ++d) {
        double product = 0.0;
        for (py::ssize_t k = 0; k < dim; ++k)
          product += part.axes[static_cast<std::size_t>(c * dim + k)] *
                     part.axes[static_cast<std::size_t>(d * dim + k)];
        if (!(std::abs(product - (c == d ? 1.0 : 0.0)) <= 1e-4))
          throw py::value_error("rotation: is not one");
      }
    text += ", rotation=...";
  }
  return {{part}, text + ")"};
}
PythonShape joined(const PythonShape& a, const PythonShape& b) {
  PythonShape both{a.parts, a.text + " | " + b.text};
  both.parts.insert(both.parts.end(), b.parts.begin(), b.parts.end());
  return both;
}

/// No point of a body is farther from its origin [m].
double reach_of(const PythonShape& shape) {
  const auto length = [](const std::vector<double>& v) {
    double sum = 0.0;
    for (const double x : v) sum += x * x;
    return std::sqrt(sum);
  };
  double reach = 0.0;
  for (const AnyShapePart& part : shape.parts)
    reach = std::max(reach, part.is_box ? length(part.a) + length(part.b)
                                        : std::max(length(part.a), length(part.b)) + part.radius);
  return reach;
}

void bind_shapes(py::module_& module) {
  py::class_<PythonShape>(module, "Shape", doc::Shape)
      .def("__or__", &joined, "other"_a, "The union of two.")
      .def_property_readonly("reach", &reach_of, doc::Shape_reach)
      .def("__repr__", [](const PythonShape& shape) { return shape.text; })
      .def(py::pickle(
          [](const PythonShape& shape) {
            py::list parts;
            for (const AnyShapePart& part : shape.parts)
              parts.append(py::make_tuple(part.is_box, part.a, part.b, part.axes, part.radius));
            return py::make_tuple(shape.text, parts);
          },
          [](const py::tuple& state) {
            PythonShape shape{{}, state[0].cast<std::string>()};
            for (const py::handle one : state[1]) {
              const auto part = py::reinterpret_borrow<py::tuple>(one);
              using Numbers = std::vector<double>;
              shape.parts.push_back({part[0].cast<bool>(), part[1].cast<Numbers>(), part[2].cast<Numbers>(),
                                     part[3].cast<Numbers>(), part[4].cast<double>()});
            }
            return shape;
          }));
  module.def("Sphere", &sphere, "radius"_a, "center"_a = py::none(), doc::Sphere);
  module.def("Capsule", &capsule, "a"_a, "b"_a, "radius"_a, doc::Capsule);
  module.def("Box", &box_shape, "size"_a, "center"_a = py::none(), py::kw_only(), "rotation"_a = py::none(),
             doc::Box);
}

void bind_results(py::module_& module) {
  py::class_<NearestArrays>(module, "NearestOccupied")
      .def_readonly("distance", &NearestArrays::distance)
      .def_readonly("point", &NearestArrays::point);
  py::class_<RayEnds>(module, "RayEnds")
      .def_readonly("distance", &RayEnds::distance)
      .def_readonly("state", &RayEnds::state)
      .def_readonly("lower", &RayEnds::lower)
      .def_readonly("size", &RayEnds::size);
  py::class_<PythonFrontier>(module, "Frontier")
      .def_readonly("center", &PythonFrontier::center)
      .def_readonly("direction", &PythonFrontier::direction)
      .def_readonly("area", &PythonFrontier::area)
      .def_readonly("cells", &PythonFrontier::cells)
      .def_readonly("size", &PythonFrontier::size);
  py::class_<PythonField>(module, "DistanceField", doc::DistanceField)
      .def_property_readonly("values", &values_of, doc::DistanceField_values)
      .def_property_readonly("lower", &lower_of, doc::DistanceField_lower)
      .def_property_readonly("cell_size", &cell_size_of, "[m]")
      .def_property_readonly("max_distance", &max_distance_of, doc::DistanceField_max_distance)
      .def("distance", &distance_at, "points"_a, doc::DistanceField_distance)
      .def("gradient", &gradient_at, "points"_a, doc::DistanceField_gradient)
      .def(py::pickle(&state_of_field, &field_of_state));
}

}  // namespace

py::object trace_rays(const PythonMap& map, const DoubleArray& origins, const DoubleArray& directions,
                      double max_range, bool stops_at_unknown, RayAim aim) {
  const auto n = static_cast<std::size_t>(directions.shape(0));
  const int dim = map.constant().dim();
  py::array_t<double> distance(directions.shape(0));
  py::array_t<std::int8_t> state(directions.shape(0));
  py::array_t<double> lower({directions.shape(0), directions.shape(1)});
  py::array_t<double> size(directions.shape(0));
  const RayEndArrays out{distance.mutable_data(), state.mutable_data(), lower.mutable_data(),
                         size.mutable_data()};
  const std::size_t step = origins.ndim() == 2 ? static_cast<std::size_t>(dim) : 0;
  map.read([&, o = origins.data(), d = directions.data()](const MapInterface& m) {
    m.queries()->trace_rays(o, step, d, n, max_range, stops_at_unknown, aim, out);
  });
  return py::cast(RayEnds{distance, state, lower, size});
}

py::object to_python(AnyFrontiers&& any) {
  return std::visit(
      [](const auto& all) -> py::object {
        std::vector<PythonFrontier> result;
        for (const auto& frontier : all) {
          const auto dim = static_cast<py::ssize_t>(frontier.center.size());
          std::vector<double> cells;
          std::vector<double> sizes;
          for (const auto& cell : frontier.cells) {
            cells.insert(cells.end(), cell.lower.data(), cell.lower.data() + dim);
            sizes.push_back(cell.upper[0] - cell.lower[0]);
          }
          result.push_back({py::array_t<double>(dim, frontier.center.data()),
                            py::array_t<double>(dim, frontier.direction.data()),
                            take(std::move(cells), static_cast<int>(dim)), take(std::move(sizes)),
                            frontier.area});
        }
        return py::cast(std::move(result));
      },
      std::move(any));
}

void bind_queries(py::module_& module) {
  bind_shapes(module);
  bind_results(module);
  py::class_<PythonMap> map_type = module.attr("OccupancyMap");
  map_type.def("bounds", &bounds, doc::OccupancyMap_bounds)
      .def("nearest_occupied", &nearest_occupied, "points"_a, py::kw_only(),
           "max_distance"_a = std::numeric_limits<double>::infinity(), doc::OccupancyMap_nearest_occupied)
      .def(
          "distance_field",
          [](const PythonMap& map, const py::object& box, double cell_size, double max_distance,
             const std::string& unknown) {
            const UnknownSpace taken_for = unknown_from(unknown);
            const BoxArgument region(box, map.constant().dim());
            return std::make_unique<PythonField>(map.read([&](const MapInterface& m) {
              return m.queries()->distance_field(region, cell_size, max_distance, taken_for);
            }));
          },
          "box"_a, "cell_size"_a, py::kw_only(), "max_distance"_a = 2.0, "unknown"_a = "free",
          doc::OccupancyMap_distance_field)
      .def(
          "frontiers",
          [](const PythonMap& map, const py::object& box, double min_cells) {
            std::optional<BoxArgument> region;
            if (!box.is_none()) region.emplace(box, map.constant().dim());
            return to_python(
                map.read([&](const MapInterface& m) { return m.queries()->frontiers(region, min_cells); }));
          },
          "box"_a = py::none(), py::kw_only(), "min_cells"_a = 8.0, doc::OccupancyMap_frontiers)
      .def(
          "collides",
          [](const PythonMap& map, const PythonShape& shape, const py::object& poses,
             const std::string& unknown) {
            const UnknownSpace taken_for = unknown_from(unknown);
            const Poses placed = poses_from(poses, map.constant().dim());
            py::array_t<bool> out(static_cast<py::ssize_t>(placed.count));
            bool* const results = out.mutable_data();
            map.read([&](const MapInterface& m) {
              m.queries()->collides(shape.parts, placed.numbers.data(), placed.count, taken_for, results);
            });
            return out;
          },
          "shape"_a, "poses"_a, py::kw_only(), "unknown"_a = "free", doc::OccupancyMap_collides)
      .def(
          "path_collides",
          [](const PythonMap& map, const PythonShape& shape, const py::object& poses,
             const std::string& unknown) {
            const UnknownSpace taken_for = unknown_from(unknown);
            const Poses placed = poses_from(poses, map.constant().dim());
            return map.read([&](const MapInterface& m) {
              return m.queries()->path_collides(shape.parts, placed.numbers.data(), placed.count, taken_for);
            });
          },
          "shape"_a, "poses"_a, py::kw_only(), "unknown"_a = "free", doc::OccupancyMap_path_collides)
      .def(
          "crop",
          [](PythonMap& map, const py::object& box) {
            const BoxArgument argument(box, map.constant().dim());
            const AnyBox region = argument;
            map.write([&](MapInterface& m) { m.crop(region.lower, region.upper); });
          },
          "box"_a, doc::OccupancyMap_crop)
      .def(
          "clear",
          [](PythonMap& map, const py::object& where, const py::object& pose) {
            change_in(map, where, pose, [](MapInterface& m, const AnyPlace& place) { m.clear(place); });
          },
          "where"_a, "pose"_a = py::none(), doc::OccupancyMap_clear)
      .def(
          "mark",
          [](PythonMap& map, const py::object& where, const std::string& state, const py::object& pose,
             int beams) {
            const CellState given = marked_state(state);
            change_in(map, where, pose,
                      [&](MapInterface& m, const AnyPlace& place) { m.mark(place, given, beams); });
          },
          "where"_a, "state"_a, "pose"_a = py::none(), py::kw_only(), "beams"_a = kMarkBeams,
          doc::OccupancyMap_mark)
      .def(
          "keep_near",
          [](PythonMap& map, const py::object& center, double radius) {
            const int dim = map.constant().dim();
            const DoubleArray point = as_doubles(center, "center");
            if (point.ndim() != 1 || point.shape(0) != dim)
              throw py::value_error("center: shape " + shape_text(point) + ", expected (" +
                                    std::to_string(dim) + ",)");
            map.write([&, p = point.data()](MapInterface& m) { m.keep_near(p, radius); });
          },
          "center"_a, "radius"_a, doc::OccupancyMap_keep_near)
      .def(
          "__eq__",
          [](const PythonMap& a, const py::object& other) -> py::object {
            if (!py::isinstance<PythonMap>(other))
              return py::reinterpret_borrow<py::object>(Py_NotImplemented);
            const auto& b = other.cast<const PythonMap&>();
            if (&a == &b) return py::bool_(true);
            if (a.constant().refinement() != b.constant().refinement()) return py::bool_(false);
            const std::string own = a.read([](const MapInterface& m) { return m.to_bytes(); });
            return py::bool_(b.read([&](const MapInterface& m) { return m.to_bytes() == own; }));
          },
          "other"_a, "Whether both hold the same, counters included: equal maps give equal bytes.");
  map_type.attr("__hash__") = py::none();  // Maps change.
}

}  // namespace ndtree::python
