// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "arguments.hpp"
#include "binders.hpp"
#include "docstrings.hpp"
#include "history_interface.hpp"
#include "numpy.hpp"
#include "pose_sigma.hpp"
#include "python_map.hpp"
#include "released.hpp"
#include "shared_lock.hpp"

namespace py = pybind11;
using namespace pybind11::literals;

namespace ndtree::python {

NDTREE_PYTHON_HISTORY(extern, 2, 2);
NDTREE_PYTHON_HISTORY(extern, 2, 3);

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
using Key = HistoryInterface::Key;

/// A history that threads share: any number of calls look, or one changes it. A call that waits hears
/// signals, one of a signal's handler is refused instead of waiting for itself, and a fork waits, as with
/// PythonMap.
struct PythonHistory {
  std::unique_ptr<HistoryInterface> history;
  mutable SharedLock lock;

  PythonHistory(int dim, const MapOptions& options, const std::vector<LayerKind>& layers)
      : history(make(dim, options, layers)) {}

  static std::unique_ptr<HistoryInterface> make(int dim, const MapOptions& options,
                                                const std::vector<LayerKind>& layers) {
    if (dim == 2) return make_history<2, 2>(options, layers);
    if (dim == 3) return make_history<2, 3>(options, layers);
    throw py::value_error("dim = " + std::to_string(dim) + ": must be 2 or 3; C++ has all others");
  }
  template <class Use>
  auto with(const Use& use) const {
    return held(SharedLock::Use::look, [&] { return use(std::as_const(*history)); });
  }
  template <class Use>
  auto with(const Use& use) {
    return held(SharedLock::Use::change, [&] { return use(*history); });
  }

 private:
  template <class Function>
  auto held(SharedLock::Use use, const Function& function) const {
    const Released released;
    const CallInProgress call;
    const SharedLock::Holder holder(lock, use);
    return function();
  }
};

/// What std::out_of_range says becomes a KeyError.
template <class Use>
auto finding_key(const Use& use) {
  try {
    return use();
  } catch (const std::out_of_range& error) {
    throw py::key_error(error.what());
  }
}

InsertReport insert(PythonHistory& h, Key key, const py::object& points, const py::object& pose,
                    const py::object& origin, const py::object& returned, const py::object& range_sigma,
                    double max_range, int threads, const py::object& pose_covariance,
                    const py::object& layers, const std::optional<std::int64_t>& number) {
  const int dim = h.history->dim();
  const py::object from =
      origin.is_none()
          ? py::object(py::tuple(py::cast(std::vector<double>(static_cast<std::size_t>(dim), 0.0))))
          : origin;
  BeamArrays beams(points, from, returned, dim, range_sigma);
  beams.require_scale(h.history->options().min_cell_size, max_range);
  const Poses one = pose_from(pose, dim);
  beams.range_sigma =
      with_pose_covariance(beams, pose_covariance, dim, h.history->options(), one.numbers.data());
  beams.set_number(number);
  const LayerArguments of_layers(layers, beams.endpoints.shape(0));
  return h.with([&, pointers = beams.pointers()](HistoryInterface& history) {
    return history.insert(key, pointers, one.numbers.data(), of_layers.all(), max_range, threads);
  });
}

/// @throws TypeError or OverflowError naming what it is.
Key key_from(const py::handle& object) {
  const auto index = py::reinterpret_steal<py::object>(PyNumber_Index(object.ptr()));
  if (!index) {
    PyErr_Clear();
    throw py::type_error("key " + std::string(py::repr(object)) + ": must be an int");
  }
  const long long key = PyLong_AsLongLong(index.ptr());
  if (key == -1 && PyErr_Occurred() != nullptr) throw py::error_already_set();
  return key;
}

HistoryReport move(PythonHistory& h, const py::dict& poses, int threads) {
  std::vector<Key> keys;
  std::vector<double> numbers;
  for (const auto& [key, pose] : poses) {
    keys.push_back(key_from(key));
    const std::string name = "the pose of key " + std::to_string(keys.back());
    const Poses one = pose_from(py::reinterpret_borrow<py::object>(pose), h.history->dim(), name.c_str());
    numbers.insert(numbers.end(), one.numbers.begin(), one.numbers.end());
  }
  return finding_key([&] {
    return h.with([&](HistoryInterface& history) { return history.move(keys, numbers.data(), threads); });
  });
}

/// A (dim + 1, dim + 1) matrix.
py::array_t<double> pose_of_scan(const PythonHistory& h, Key key) {
  const std::vector<double> numbers =
      finding_key([&] { return h.with([&](const HistoryInterface& history) { return history.pose(key); }); });
  return matrix_of(numbers, h.history->dim());
}

py::object scan_of(const PythonHistory& h, Key key) {
  StoredScan scan =
      finding_key([&] { return h.with([&](const HistoryInterface& history) { return history.scan(key); }); });
  const int dim = h.history->dim();
  py::array_t<bool> returned(static_cast<py::ssize_t>(scan.returned.size()));
  std::copy(scan.returned.begin(), scan.returned.end(), returned.mutable_data());
  const bool has_one_origin = scan.origins.size() == static_cast<std::size_t>(dim);
  py::object origin = has_one_origin ? py::object(take(std::move(scan.origins)))
                                     : py::object(take(std::move(scan.origins), dim));
  const py::object sigma =
      scan.range_sigma.empty() ? py::object(py::none()) : py::object(take(std::move(scan.range_sigma)));
  return py::module_::import("ndtree.base.scan")
      .attr("Scan")(take(std::move(scan.endpoints), dim), origin, returned, 0.0, sigma);
}

py::dict measurements_of(const PythonHistory& h, Key key) {
  std::vector<LayerNumbers> all = finding_key(
      [&] { return h.with([&](const HistoryInterface& history) { return history.measurements(key); }); });
  py::dict dict;
  for (LayerNumbers& one : all)
    dict[py::str(one.kind.name)] = as_layer_array(one.kind.rule, std::move(one.numbers));
  return dict;
}

}  // namespace

void bind_history(py::module_& module) {
  py::class_<HistoryReport>(module, "HistoryReport")
      .def_readonly("moved", &HistoryReport::moved)
      .def_readonly("replayed", &HistoryReport::replayed)
      .def_readonly("cubes", &HistoryReport::cubes)
      .def_readonly("cube_scans", &HistoryReport::cube_scans)
      .def_readonly("all_cube_scans", &HistoryReport::all_cube_scans)
      .def_readonly("seconds", &HistoryReport::seconds);

  py::class_<PythonHistory>(module, "ScanHistory", doc::ScanHistory)
      .def(py::init([](int dim, const py::object& layers, const py::kwargs& options) {
             const std::vector<LayerKind> kinds = layer_kinds(layers);
             return std::make_unique<PythonHistory>(
                 dim, options_from_keywords(options, EvidenceRefinement::kName, "ScanHistory"), kinds);
           }),
           py::kw_only(), "dim"_a = 2, "layers"_a = py::none())
      .def_property_readonly(
          "dim", [](const PythonHistory& h) { return h.history->dim(); }, doc::ScanHistory_dim)
      .def_property_readonly(
          "map",
          [](const PythonHistory& h) {
            return to_python(h.with([](const HistoryInterface& history) { return history.map(); }));
          },
          doc::ScanHistory_map)
      .def_property_readonly(
          "memory_bytes",
          [](const PythonHistory& h) {
            return h.with([](const HistoryInterface& history) { return history.memory_bytes(); });
          },
          doc::ScanHistory_memory_bytes)
      .def("insert", &insert, "key"_a, "points"_a, "pose"_a, py::kw_only(), "origin"_a = py::none(),
           "returned"_a = py::none(), "range_sigma"_a = py::none(), "max_range"_a = kInfinity,
           "threads"_a = 0, "pose_covariance"_a = py::none(), "layers"_a = py::none(),
           "number"_a = py::none(), doc::ScanHistory_insert)
      .def_property_readonly(
          "layers",
          [](const PythonHistory& h) {
            return as_dict(h.with([](const HistoryInterface& history) { return history.layers(); }));
          },
          doc::ScanHistory_layers)
      .def("move", &move, "poses"_a, py::kw_only(), "threads"_a = 0, doc::ScanHistory_move)
      .def(
          "remove",
          [](PythonHistory& h, const std::vector<Key>& keys, int threads) {
            return finding_key([&] {
              return h.with([&](HistoryInterface& history) { return history.remove(keys, threads); });
            });
          },
          "keys"_a, py::kw_only(), "threads"_a = 0, doc::ScanHistory_remove)
      .def(
          "freeze",
          [](PythonHistory& h, std::int64_t count, int threads) {
            if (count < 0) throw py::value_error("count = " + std::to_string(count) + ": must be >= 0");
            h.with([&](HistoryInterface& history) {
              history.freeze(static_cast<std::size_t>(count), threads);
              return 0;
            });
          },
          "count"_a, py::kw_only(), "threads"_a = 0, doc::ScanHistory_freeze)
      .def_property_readonly(
          "num_frozen",
          [](const PythonHistory& h) {
            return h.with([](const HistoryInterface& history) { return history.num_frozen(); });
          },
          doc::ScanHistory_num_frozen)
      .def(
          "keys",
          [](const PythonHistory& h) {
            return h.with([](const HistoryInterface& history) { return history.keys(); });
          },
          doc::ScanHistory_keys)
      .def("pose", &pose_of_scan, "key"_a, doc::ScanHistory_pose)
      .def("scan", &scan_of, "key"_a, doc::ScanHistory_scan)
      .def("measurements", &measurements_of, "key"_a, doc::ScanHistory_measurements)
      .def("__len__",
           [](const PythonHistory& h) {
             return h.with([](const HistoryInterface& history) { return history.keys().size(); });
           })
      .def("__contains__",
           [](const PythonHistory& h, Key key) {
             return h.with([&](const HistoryInterface& history) { return history.contains(key); });
           })
      .def("__repr__", [](const PythonHistory& h) {
        const std::size_t scans =
            h.with([](const HistoryInterface& history) { return history.keys().size(); });
        return "ScanHistory(dim=" + std::to_string(h.history->dim()) + ", scans=" + std::to_string(scans) +
               ")";
      });
}

}  // namespace ndtree::python
