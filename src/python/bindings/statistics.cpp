// SPDX-License-Identifier: BSD-3-Clause
#include <pybind11/numpy.h>

#include "docstrings.hpp"
#include "ndtree/cell/sensor_model.hpp"
#include "ndtree/cell/split_test.hpp"
#include "ndtree/core/chi_square.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

void bind_statistics(py::module_& module) {
  module.def("normal_quantile", py::vectorize(&normal_quantile), "p"_a, doc::normal_quantile);
  module.def("chi_square_quantile", py::vectorize(&chi_square_quantile), "significance"_a,
             doc::chi_square_quantile);
  module.def("sensor_probability", py::vectorize(&BeamSensorModel::probability), "entry"_a, "exit"_a,
             "range"_a, "sigma"_a, doc::sensor_probability);
  module.def(
      "splits",
      [](const py::array_t<std::uint32_t>& hits, const py::array_t<std::uint32_t>& misses,
         double miss_given_occupied, double hit_given_free, double significance) {
        MapOptions options;
        options.miss_given_occupied = miss_given_occupied;
        options.hit_given_free = hit_given_free;
        options.significance = significance;
        options.validate();
        const ChiSquareSplitTest test(options);
        return py::vectorize([&](std::uint32_t h, std::uint32_t m) { return test(h, m); })(hits, misses);
      },
      "hits"_a, "misses"_a, py::kw_only(), "miss_given_occupied"_a, "hit_given_free"_a, "significance"_a,
      doc::splits);
}

}  // namespace ndtree::python
