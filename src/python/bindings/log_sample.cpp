// SPDX-License-Identifier: BSD-3-Clause
#include "ndtree/evaluation/log_sample.hpp"

#include <cstddef>
#include <string>
#include <vector>

#include "docstrings.hpp"
#include "ndtree/evaluation/no_returns.hpp"
#include "ndtree/mapping/occupancy_map.hpp"
#include "numpy.hpp"
#include "python_map.hpp"

namespace ndtree::python {

using namespace pybind11::literals;  // NOLINT(google-build-using-namespace): "name"_a

namespace {

template <int D>
NoReturns judged(const std::vector<BeamPointers>& scans) {
  std::vector<ScanView<D>> views;
  views.reserve(scans.size());
  for (const BeamPointers& scan : scans) views.push_back(scan.view<D>());
  const Released released;
  const CallInProgress call;
  return judge_no_returns<FixedMap<2, D>>(views);
}

NoReturns judge(const py::iterable& scans) {
  const ScanArrays arrays(scans);
  if (arrays.beams.empty()) return {};
  if (arrays.dim == 2) return judged<2>(arrays.pointers());
  if (arrays.dim == 3) return judged<3>(arrays.pointers());
  return judged<4>(arrays.pointers());
}

template <int D>
py::array_t<bool> which_near(const BeamArrays& beams) {
  const ScanView<D> scan = beams.pointers().view<D>();
  py::array_t<bool> near(static_cast<py::ssize_t>(scan.size));
  for (Eigen::Index i = 0; i < scan.size; ++i) near.mutable_data()[i] = is_near(scan, i);
  return near;
}

py::array_t<bool> sampled(const py::object& scan) {
  const int dim = ScanArrays::dim_of(scan, 0);
  const BeamArrays beams(scan.attr("endpoints"), scan.attr("origin"), scan.attr("returned"), dim);
  return dim == 2 ? which_near<2>(beams) : dim == 3 ? which_near<3>(beams) : which_near<4>(beams);
}

}  // namespace

void bind_log_sample(py::module_& module) {
  module.attr("sample_run") = kSampleRun;
  module.attr("sample_runs") = kSampleRuns;
  module.def("is_held_out", &is_held_out, "i"_a, "held_out"_a, doc::is_held_out);
  module.def("sample_step", &sample_step, "scans"_a, doc::sample_step);
  module.def("sample_stride", &sample_stride, "beams"_a, doc::sample_stride);
  module.def("may_be_sampled", &sampled, "scan"_a, doc::may_be_sampled);
  module.def("judge_no_returns", &judge, "scans"_a, doc::judge_no_returns);
  py::class_<NoReturns>(module, "NoReturns")
      .def_property_readonly("choice", [](const NoReturns& n) { return n.choice(); })
      .def_readonly("beams", &NoReturns::beams)
      .def_readonly("crossing", &NoReturns::crossing)
      .def_readonly("expected", &NoReturns::expected)
      .def_readonly("surfaces", &NoReturns::surfaces)
      .def_readonly("erased", &NoReturns::erased)
      .def_readonly("share", &NoReturns::share)
      .def_property_readonly("are_judged", [](const NoReturns& n) { return n.are_judged(); })
      .def_property_readonly("text", [](const NoReturns& n) { return n.to_text(); });
}

}  // namespace ndtree::python
