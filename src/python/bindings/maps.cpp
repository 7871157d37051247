// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "arguments.hpp"
#include "docstrings.hpp"
#include "ndtree/io/byte_stream.hpp"
#include "pose_sigma.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Leaves {
  py::array lower, size, log_odds, probability, hits, misses, observed, state, disputed, thin;
};

Leaves to_python(LeafArrays&& arrays, int dim) {
  const std::size_t n = arrays.size.size();
  std::vector<float> probabilities(n);
  std::vector<std::int8_t> states(n);
  for (std::size_t i = 0; i < n; ++i) {
    probabilities[i] = static_cast<float>(probability(static_cast<double>(arrays.log_odds[i])));
    states[i] = static_cast<std::int8_t>(state_of(arrays.log_odds[i]));
  }
  Leaves leaves;
  leaves.lower = take(std::move(arrays.lower), dim);
  leaves.size = take(std::move(arrays.size));
  leaves.log_odds = take(std::move(arrays.log_odds));
  leaves.probability = take(std::move(probabilities));
  leaves.hits = take(std::move(arrays.hits));
  leaves.misses = take(std::move(arrays.misses));
  leaves.observed = take(std::move(arrays.observed)).view("bool");
  leaves.state = take(std::move(states));
  leaves.disputed = take(std::move(arrays.disputed)).view("bool");
  leaves.thin = take(std::move(arrays.thin)).view("bool");
  return leaves;
}

double or_nan(std::optional<double> value) {
  return value.value_or(std::numeric_limits<double>::quiet_NaN());
}

RegionStates states_from(const std::optional<std::vector<std::string>>& names) {
  RegionStates states;
  if (!names) states.free = states.occupied = states.unknown = true;
  for (const std::string& name : names.value_or(std::vector<std::string>{})) {
    if (name == "free")
      states.free = true;
    else if (name == "occupied")
      states.occupied = true;
    else if (name == "unknown")
      states.unknown = true;
    else
      throw py::value_error("states: '" + name + "': must be 'free', 'occupied' or 'unknown'");
  }
  return states;
}

/// Calls `fill(map, points, n, out)`, or that member of the map, without the interpreter's lock, for an (n,)
/// result.
template <class T, class Fill>
py::array_t<T> per_point(const PythonMap& map, const py::object& object, Fill&& fill) {
  const DoubleArray points = as_points(object, "points", map.constant().dim());
  py::array_t<T> out(points.shape(0));
  T* const results = out.mutable_data();
  const double* const data = points.data();
  const auto n = static_cast<std::size_t>(points.shape(0));
  map.read([&](const MapInterface& m) { std::invoke(fill, m, data, n, results); });
  return out;
}

py::object probability_of(const PythonMap& map, const py::object& points,
                          const std::optional<std::string>& of, const std::optional<double>& interval) {
  const std::string what = of.value_or(interval ? "hit" : "occupied");
  if (what != "occupied" && what != "hit")
    throw py::value_error("of = '" + what + "': must be 'occupied' or 'hit'");
  if (interval && !(*interval > 0.0 && *interval < 1.0))
    throw py::value_error("interval = " + number_text(*interval) + ": must be in (0, 1)");
  if (interval && what != "hit")
    throw py::value_error("interval: is of 'hit', the fraction of beams that end in a cell");
  if (what == "occupied") return per_point<float>(map, points, &MapInterface::probability);
  py::array_t<float> lower(interval ? as_points(points, "points", map.constant().dim()).shape(0) : 0);
  py::array_t<float> upper(lower.shape(0));
  py::array_t<float> value = per_point<float>(
      map, points,
      [bounds = interval.value_or(0.0), low = lower.mutable_data(), high = upper.mutable_data()](
          const MapInterface& m, const double* p, std::size_t n, float* out) {
        m.hit_rate(p, n, bounds, {out, low, high});
      });
  if (!interval) return value;
  return py::make_tuple(value, lower, upper);
}

py::object cast_rays(const PythonMap& map, const py::object& origins, const py::object& directions,
                     double max_range, const std::string& unknown, const std::string& at, bool details) {
  if (unknown != "pass" && unknown != "stop")
    throw py::value_error("unknown = '" + unknown + "': must be 'pass' or 'stop'");
  if (at != "cell" && at != "surface")
    throw py::value_error("at = '" + at + "': must be 'cell' or 'surface'");
  const RayAim aim = at == "cell" ? RayAim::cell : RayAim::surface;
  const int dim = map.constant().dim();
  const DoubleArray d = as_points(directions, "directions", dim);
  const DoubleArray o = as_points_or_one(origins, "origins", dim, d.shape(0));
  for (py::ssize_t i = 0; i < d.shape(0); ++i) {  // Name the ray, before any is cast.
    bool is_zero = true;
    for (int a = 0; a < dim; ++a) {
      const double origin = o.data()[(o.ndim() == 2 ? i * dim : 0) + a];
      const double direction = d.data()[i * dim + a];
      is_zero = is_zero && direction == 0.0;
      if (!std::isfinite(direction) || !std::isfinite(origin))
        throw py::value_error("ray " + std::to_string(i) + ": origin and direction must be finite");
    }
    if (is_zero) throw py::value_error("ray " + std::to_string(i) + ": the direction must not be zero");
  }
  if (details || unknown == "stop") {
    const py::object ends = trace_rays(map, o, d, max_range, unknown == "stop", aim);
    return details ? ends : ends.attr("distance");
  }
  py::array_t<double> out(d.shape(0));
  double* const results = out.mutable_data();
  const std::size_t step = o.ndim() == 2 ? static_cast<std::size_t>(dim) : 0;
  map.read([&, po = o.data(), pd = d.data(), n = static_cast<std::size_t>(d.shape(0))](
               const MapInterface& m) { m.cast_rays(po, step, pd, n, max_range, aim, results); });
  return out;
}

HeldOutTruth evaluate(const PythonMap& map, const py::object& points, const py::object& origin,
                      const py::object& returned, double max_range, std::optional<HeldOutTruth> truth) {
  const BeamArrays beams(points, origin, returned, map.constant().dim());
  HeldOutTruth result = truth ? std::move(*truth) : HeldOutTruth{};
  map.read(
      [&, pointers = beams.pointers()](const MapInterface& m) { m.evaluate(pointers, max_range, result); });
  return result;
}

/// Options of a map, without the constants of the method.
py::dict options_dict(const MapOptions& options, std::string_view refinement) {
  py::dict dict;
  for (const OptionRow& row : kOptionTable)
    if (!row.is_constant() && row.is_read_by(refinement)) dict[row.name] = options.*row.member;
  return dict;
}

/// A keyword's value. @throws py::type_error naming it if it is no number.
double number_of(const char* name, py::handle value) {
  const double number = PyFloat_AsDouble(value.ptr());
  if (PyErr_Occurred() == nullptr) return number;
  py::error_already_set error;
  if (!error.matches(PyExc_TypeError) && !error.matches(PyExc_ValueError) &&
      !error.matches(PyExc_OverflowError))
    throw error;
  const std::string text =
      std::string(name) + " = " + py::repr(value).cast<std::string>() + ": must be a number";
  py::raise_from(error, PyExc_TypeError, text.c_str());
  throw py::error_already_set();
}

/// The row of an option; of a constant, if constants are meant.
const OptionRow* row_of(std::string_view name, bool constant) {
  const auto* const row = std::find_if(kOptionTable.begin(), kOptionTable.end(),
                                       [&](const OptionRow& one) { return one.name == name; });
  return row != kOptionTable.end() && row->is_constant() == constant ? row : nullptr;
}

py::list option_table() {
  py::list table;
  const MapOptions defaults;
  for (const OptionRow& row : kOptionTable) {
    py::list readers;
    for (const char* const kind : {"evidence", "paper", "fixed", "octomap"})
      if (row.is_read_by(kind)) readers.append(kind);
    const py::object placeholder = row.is_constant() ? py::object(py::none()) : py::str(row.placeholder);
    table.append(py::make_tuple(row.name, defaults.*row.member, row.bounds.least, row.bounds.most,
                                row.bounds.unit, readers, placeholder, row.help, row.when));
  }
  return table;
}

std::string sizes_text(const MapOptions& options, bool adaptive) {
  if (!adaptive) return "min_cell_size=" + number_text(options.min_cell_size);
  return "min_cell_size=" + number_text(options.min_cell_size) +
         ", max_cell_size=" + number_text(options.max_cell_size);
}

py::bytes to_bytes(const PythonMap& map) {
  return py::bytes(map.read([](const MapInterface& m) { return m.to_bytes(); }));
}

std::unique_ptr<MapInterface> from_bytes(std::string_view bytes) {
  const Released released;
  return map_from_bytes(bytes);
}

template <class Type>
void bind_own_map(py::module_& module, const char* name, bool adaptive, const char* doc) {
  py::class_<Type, PythonMap>(module, name, doc)
      .def(py::init([name, adaptive](int dim, int branching, const std::string& refinement,
                                     const py::object& layers, const py::kwargs& options) {
             if (adaptive && refinement != EvidenceRefinement::kName && refinement != PaperRefinement::kName)
               throw OptionError("refinement", "'" + refinement + "'", "'evidence' or 'paper'");
             if (!adaptive && refinement != FixedRefinement::kName)
               throw OptionError("refinement", "'" + refinement + "'", "'fixed'");
             const std::vector<LayerKind> kinds = layer_kinds(layers);
             auto map =
                 make_map(refinement, branching, dim, options_from_keywords(options, refinement, name));
             for (const LayerKind& kind : kinds) map->add_layer(kind);
             return Type(std::move(map));
           }),
           py::kw_only(), "dim"_a = 2, "branching"_a = 2,
           "refinement"_a = adaptive ? EvidenceRefinement::kName : FixedRefinement::kName,
           "layers"_a = py::none())
      .def(
          "cell_size",
          [](const Type& map, const py::object& points) {
            return per_point<double>(map, points, &MapInterface::cell_size);
          },
          "points"_a, doc::AdaptiveMap_cell_size)
      .def("__repr__", [name, adaptive](const Type& map) { return describe(name, map, adaptive); })
      .def("__copy__",
           [](const Type& map) { return Type(map.read([](const MapInterface& m) { return m.clone(); })); })
      .def("__deepcopy__",
           [](const Type& map, const py::dict&) {
             return Type(map.read([](const MapInterface& m) { return m.clone(); }));
           })
      .def(py::pickle([](const Type& map) { return to_bytes(map); },
                      [](const py::bytes& state) { return Type(from_bytes(std::string_view(state))); }));
}

}  // namespace

py::object to_python(std::unique_ptr<MapInterface> map) {
  if (map->refinement() == FixedRefinement::kName) return py::cast(PythonFixedMap(std::move(map)));
  return py::cast(PythonAdaptiveMap(std::move(map)));
}

MapOptions options_from_keywords(const py::kwargs& keywords, std::string_view refinement, const char* type) {
  MapOptions options;
  for (const auto& [key, value] : keywords) {
    const auto name = key.cast<std::string>();
    if (name == "constants") {  // Of a map that was made by an older version, and of trials: no option.
      for (const auto& [constant, number] : value.cast<py::dict>())
        if (const OptionRow* const row = row_of(constant.cast<std::string>(), true))
          options.*row->member = number_of(row->name, number);
        else
          throw py::type_error(py::str(constant).cast<std::string>() + ": is no constant of the maps");
      continue;
    }
    const bool one_size = refinement == FixedRefinement::kName || refinement == kOctomap;
    const OptionRow* const row = row_of(one_size && name == "cell_size" ? "min_cell_size" : name, false);
    if (row == nullptr || !row->is_read_by(refinement))
      throw py::type_error(std::string(type) + "() got an unexpected keyword argument '" + name + "'");
    options.*row->member = number_of(name.c_str(), value);
  }
  if (refinement == FixedRefinement::kName || refinement == kOctomap)
    options.max_cell_size = std::max(options.max_cell_size, options.min_cell_size);
  return options;
}

std::string describe(const char* type, const PythonMap& map, bool adaptive) {
  const MapInterface& m = map.constant();
  const PythonStats stats = map.read([](const MapInterface& one) { return one.stats(); });
  return std::string(type) + "(dim=" + std::to_string(m.dim()) +
         ", branching=" + std::to_string(m.branching()) + ", " + sizes_text(m.options(), adaptive) +
         "): " + std::to_string(stats.observed_leaves) + " observed leaves, " +
         std::to_string(stats.updates) + " updates, " + std::to_string(stats.memory_bytes) + " bytes";
}

void bind_maps(py::module_& module) {
  // Dataclasses of ndtree/_native/results take the place of results, here and in other files: docstrings,
  // texts and lengths are theirs.
  py::class_<InsertReport>(module, "InsertReport")
      .def_readonly("beams", &InsertReport::beams)
      .def_readonly("returned", &InsertReport::returned)
      .def_readonly("not_returned", &InsertReport::not_returned)
      .def_readonly("beyond_max_range", &InsertReport::beyond_max_range)
      .def_readonly("invalid", &InsertReport::invalid)
      .def_readonly("updates", &InsertReport::updates)
      .def_readonly("splits", &InsertReport::splits)
      .def_readonly("merges", &InsertReport::merges)
      .def_readonly("seconds", &InsertReport::seconds)
      .def_property_readonly("moved", [](const InsertReport& r) -> py::object {
        if (!r.moved) return py::none();
        return py::array_t<float>(static_cast<py::ssize_t>(r.moved->size()), r.moved->data());
      });

  py::class_<CompressReport>(module, "CompressReport")
      .def_readonly("leaves_before", &CompressReport::leaves_before)
      .def_readonly("leaves", &CompressReport::leaves)
      .def_readonly("bytes_before", &CompressReport::bytes_before)
      .def_readonly("bytes", &CompressReport::bytes)
      .def_readonly("merges", &CompressReport::merges)
      .def_readonly("loss", &CompressReport::loss);

  py::class_<PythonStats>(module, "MapStats")
      .def_readonly("leaves", &PythonStats::leaves)
      .def_readonly("observed_leaves", &PythonStats::observed_leaves)
      .def_readonly("nodes", &PythonStats::nodes)
      .def_readonly("scans", &PythonStats::scans)
      .def_readonly("updates", &PythonStats::updates)
      .def_readonly("splits", &PythonStats::splits)
      .def_readonly("merges", &PythonStats::merges)
      .def_readonly("memory_bytes", &PythonStats::memory_bytes)
      .def_readonly("pruned_leaves", &PythonStats::pruned_leaves);

  py::class_<Leaves>(module, "Leaves")
      .def_readonly("lower", &Leaves::lower)
      .def_readonly("size", &Leaves::size)
      .def_readonly("log_odds", &Leaves::log_odds)
      .def_readonly("probability", &Leaves::probability)
      .def_readonly("hits", &Leaves::hits)
      .def_readonly("misses", &Leaves::misses)
      .def_readonly("observed", &Leaves::observed)
      .def_readonly("state", &Leaves::state)
      .def_readonly("disputed", &Leaves::disputed)
      .def_readonly("thin", &Leaves::thin);

  py::class_<HeldOutTruth>(module, "HeldOutTruth", doc::HeldOutTruth)
      .def(py::init<>())
      .def_property_readonly(
          "samples", [](const HeldOutTruth& t) { return t.samples(); }, doc::HeldOutTruth_samples)
      .def_property_readonly(
          "free", [](const HeldOutTruth& t) { return or_nan(t.free_share()); }, doc::HeldOutTruth_free)
      .def_property_readonly(
          "occupied", [](const HeldOutTruth& t) { return or_nan(t.occupied_share()); },
          doc::HeldOutTruth_occupied)
      .def_property_readonly(
          "unknown", [](const HeldOutTruth& t) { return or_nan(t.unknown_share()); },
          doc::HeldOutTruth_unknown)
      .def_property_readonly(
          "endpoints", [](const HeldOutTruth& t) { return t.endpoints; }, doc::HeldOutTruth_endpoints)
      .def_property_readonly(
          "endpoints_near", [](const HeldOutTruth& t) { return or_nan(t.endpoints_near_share()); },
          doc::HeldOutTruth_endpoints_near)
      .def_property_readonly(
          "casts", [](const HeldOutTruth& t) { return t.casts(); }, "Rays cast.")
      .def_property_readonly(
          "casts_within", [](const HeldOutTruth& t) { return or_nan(t.casts_within_share()); },
          doc::HeldOutTruth_casts_within)
      .def_property_readonly(
          "balanced_accuracy", [](const HeldOutTruth& t) { return or_nan(t.balanced_accuracy()); },
          doc::HeldOutTruth_balanced_accuracy)
      .def_property_readonly(
          "log_score", [](const HeldOutTruth& t) { return or_nan(t.log_score()); },
          doc::HeldOutTruth_log_score)
      .def_property_readonly(
          "median_error", [](const HeldOutTruth& t) { return or_nan(t.median_cast_error()); },
          doc::HeldOutTruth_median_error)
      .def_property_readonly(
          "surfaces_within", [](const HeldOutTruth& t) { return or_nan(t.surfaces_within_share()); },
          doc::HeldOutTruth_surfaces_within)
      .def_property_readonly(
          "surface_error", [](const HeldOutTruth& t) { return or_nan(t.median_surface_error()); },
          doc::HeldOutTruth_surface_error)
      .def(
          "figures",
          [](const HeldOutTruth& t) {
            py::dict figures;
            for_each_figure(t, [&](const char* name, const auto& value) { figures[name] = value; });
            return figures;
          },
          doc::HeldOutTruth_figures)
      .def("__iadd__",
           [](HeldOutTruth& a, const HeldOutTruth& b) -> HeldOutTruth& {
             a.add(b);
             return a;
           })
      .def(py::pickle(
          [](const HeldOutTruth& t) {
            return py::make_tuple(t.free, t.occupied, t.unknown, t.endpoints, t.endpoints_near,
                                  t.casts_within, t.surfaces_within, t.free_log_likelihood,
                                  t.endpoint_log_likelihood, t.cast_errors, t.surface_errors);
          },
          [](const py::tuple& state) {
            HeldOutTruth t;
            std::uint64_t* const counts[] = {&t.free,           &t.occupied,       &t.unknown,
                                             &t.endpoints,      &t.endpoints_near, &t.casts_within,
                                             &t.surfaces_within};
            std::size_t next = 0;
            for (std::uint64_t* const count : counts) *count = state[next++].cast<std::uint64_t>();
            t.free_log_likelihood = state[next++].cast<double>();
            t.endpoint_log_likelihood = state[next++].cast<double>();
            t.cast_errors = state[next++].cast<std::vector<double>>();
            t.surface_errors = state[next].cast<std::vector<double>>();
            return t;
          }));

  py::class_<PythonMap>(module, "OccupancyMap", doc::OccupancyMap)
      .def_property_readonly(
          "dim", [](const PythonMap& m) { return m.constant().dim(); }, doc::OccupancyMap_dim)
      .def_property_readonly(
          "branching", [](const PythonMap& m) { return m.constant().branching(); },
          doc::OccupancyMap_branching)
      .def_property_readonly(
          "refinement", [](const PythonMap& m) { return m.constant().refinement(); },
          doc::OccupancyMap_refinement)
      .def_property_readonly(
          "options",
          [](const PythonMap& m) { return options_dict(m.constant().options(), m.constant().refinement()); },
          doc::OccupancyMap_options)
      .def(
          "insert",
          [](PythonMap& map, const py::object& points, const py::object& origin, const py::object& returned,
             const py::object& range_sigma, double max_range, int threads, const py::object& window,
             const py::object& layers, const std::optional<std::int64_t>& number, bool moved,
             const py::object& pose_covariance) {
            const int dim = map.constant().dim();
            BeamArrays beams(points, origin, returned, dim, range_sigma);
            beams.range_sigma = with_pose_covariance(beams, pose_covariance, dim, map.constant().options());
            beams.set_number(number);
            const LayerArguments of_layers(layers, beams.endpoints.shape(0));
            std::optional<BoxArgument> box;
            if (!window.is_none()) box.emplace(window, dim, "window");
            beams.require_scale(map.constant().options().min_cell_size, max_range);
            return map.write([&, pointers = beams.pointers(),
                              region = box ? std::optional<AnyBox>(*box) : std::nullopt](MapInterface& m) {
              std::optional<std::vector<float>> before;
              if (moved) before = moved_before(m, pointers, max_range);
              InsertReport report = m.insert(pointers, max_range, threads, region, of_layers.all());
              report.moved = std::move(before);
              return report;
            });
          },
          "points"_a, "origin"_a, py::kw_only(), "returned"_a = py::none(), "range_sigma"_a = py::none(),
          "max_range"_a = kInfinity, "threads"_a = 0, "window"_a = py::none(), "layers"_a = py::none(),
          "number"_a = py::none(), "moved"_a = false, "pose_covariance"_a = py::none(),
          doc::OccupancyMap_insert)
      .def(
          "compress",
          [](PythonMap& map, std::optional<double> max_loss, std::optional<std::size_t> max_leaves,
             std::optional<std::size_t> max_bytes) {
            return map.write([&](MapInterface& m) { return m.compress({max_loss, max_leaves, max_bytes}); });
          },
          py::kw_only(), "max_loss"_a = py::none(), "max_leaves"_a = py::none(), "max_bytes"_a = py::none(),
          doc::OccupancyMap_compress)
      .def_property_readonly(
          "layers",
          [](const PythonMap& map) {
            return as_dict(map.read([](const MapInterface& m) { return m.layers(); }));
          },
          doc::OccupancyMap_layers)
      .def(
          "layer",
          [](const PythonMap& map, const py::str& text, const py::object& object) -> py::object {
            const std::string name = text_of(text);
            const DoubleArray points = as_points(object, "points", map.constant().dim());
            const auto n = static_cast<std::size_t>(points.shape(0));
            std::string rule;
            std::vector<double> numbers = map.read([&, data = points.data()](const MapInterface& m) {
              for (const LayerKind& kind : m.layers())
                if (kind.name == name) rule = kind.rule;
              return m.layer(name, data, n);
            });
            return as_layer_array(rule, std::move(numbers));
          },
          "name"_a, "points"_a, doc::OccupancyMap_layer)
      .def(
          "shrink_to_fit", [](PythonMap& map) { map.write([](MapInterface& m) { m.shrink_to_fit(); }); },
          doc::OccupancyMap_shrink_to_fit)
      .def("probability", &probability_of, "points"_a, py::kw_only(), "of"_a = py::none(),
           "interval"_a = py::none(), doc::OccupancyMap_probability)
      .def(
          "state",
          [](const PythonMap& map, const py::object& points) {
            return per_point<std::int8_t>(map, points, &MapInterface::state);
          },
          "points"_a, doc::OccupancyMap_state)
      .def(
          "occupied_within",
          [](const PythonMap& map, const py::object& points, double radius) {
            if (!(radius >= 0.0))
              throw py::value_error("radius = " + number_text(radius) + " m: must be >= 0");
            return per_point<bool>(
                map, points, [radius](const MapInterface& m, const double* p, std::size_t n, bool* out) {
                  m.occupied_within(p, n, radius, out);
                });
          },
          "points"_a, "radius"_a, doc::OccupancyMap_occupied_within)
      .def("cast_rays", &cast_rays, "origins"_a, "directions"_a, py::kw_only(), "max_range"_a = kInfinity,
           "unknown"_a = "pass", "at"_a = "surface", "details"_a = false, doc::OccupancyMap_cast_rays)
      .def("evaluate", &evaluate, "points"_a, "origin"_a, py::kw_only(), "returned"_a = py::none(),
           "max_range"_a = kInfinity, "truth"_a = py::none(), doc::OccupancyMap_evaluate)
      .def(
          "leaves",
          [](const PythonMap& map, const py::object& box,
             const std::optional<std::vector<std::string>>& states) {
            const int dim = map.constant().dim();
            if (box.is_none() && !states)
              return to_python(map.read([](const MapInterface& m) { return m.leaves(); }), dim);
            const RegionStates wanted = states_from(states);
            DoubleArray corners;
            std::vector<double> all(static_cast<std::size_t>(2 * dim), kInfinity);
            std::fill_n(all.begin(), dim, -kInfinity);
            const double* lower = all.data();
            if (!box.is_none()) {
              corners = as_corners(box, "box", dim);
              lower = corners.data();
              for (int a = 0; a < dim; ++a)
                if (!(lower[a] <= lower[dim + a]))
                  throw py::value_error("box: axis " + std::to_string(a) + " is from " +
                                        number_text(lower[a]) + " to " + number_text(lower[dim + a]) +
                                        " m, must be from low to high");
            }
            return to_python(
                map.read([&](const MapInterface& m) { return m.leaves_in(lower, lower + dim, wanted); }),
                dim);
          },
          "box"_a = py::none(), py::kw_only(), "states"_a = py::none(), doc::OccupancyMap_leaves)
      .def(
          "stats",
          [](const PythonMap& map) { return map.read([](const MapInterface& m) { return m.stats(); }); },
          doc::OccupancyMap_stats)
      .def("to_bytes", &to_bytes, doc::OccupancyMap_to_bytes)
      .def(
          "save",
          [](const PythonMap& map, const std::filesystem::path& path) {
            map.read([&](const MapInterface& m) { write_file(path, m.file_bytes()); });
          },
          "path"_a, doc::OccupancyMap_save);

  bind_own_map<PythonAdaptiveMap>(module, "AdaptiveMap", true, doc::AdaptiveMap);
  bind_own_map<PythonFixedMap>(module, "FixedMap", false, doc::FixedMap);

  module.def(
      "default_options",
      [] {
        py::dict dict;
        const MapOptions options;
        for (const OptionRow& row : kOptionTable)
          if (!row.is_constant()) dict[row.name] = options.*row.member;
        return dict;
      },
      doc::default_options);
  module.def(
      "leaf_counts",
      [](const PythonMap& map) {
        std::vector<std::tuple<double, std::size_t, std::size_t, std::size_t, std::size_t>> rows;
        for (const auto& [size, counts] : map.read([](const MapInterface& m) { return m.leaf_counts(); }))
          rows.emplace_back(size, counts.observed, counts.free, counts.occupied, counts.disputed);
        return rows;
      },
      "m"_a, doc::leaf_counts);
  module.def("option_table", &option_table, doc::option_table);
}

}  // namespace ndtree::python
