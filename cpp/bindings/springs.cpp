// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/springs.hpp"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>

#include "bindings.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

ArrayOfPositions evaluate(const Springs& springs, double fraction, const ArrayOfPositions& reference,
                          const std::optional<ArrayOfPositions>& next_reference) {
  const Eigen::Map<const Positions> end = positions_of("reference", reference);
  const std::optional<Positions> after = copy_of("next_reference", next_reference);
  Positions dynamic;
  {
    const py::gil_scoped_release release;
    dynamic = springs.evaluate(fraction, end, after ? &*after : nullptr);
  }
  return array_of(dynamic);
}

}  // namespace

void bind_springs(py::module_& m) {
  py::class_<Springs, Solver>(m, "Springs", "Analytic zero-restlength springs. Use followthrough.springs.Springs.")
      .def(py::init<ConstVector, ConstVector, double, ConstMask, const Eigen::Vector3d&>(), py::arg("stiffness"),
           py::arg("damping"), py::arg("dt"), py::arg("pinned"), py::arg("gravity"), py::call_guard<py::gil_scoped_release>())
      .def("evaluate", &evaluate, py::arg("fraction"), py::arg("reference"), py::arg("next_reference") = py::none(),
           "Positions (n, 3) within the frame to come; changes nothing.");
}

}  // namespace followthrough
