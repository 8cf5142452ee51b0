// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>

#include "bindings.hpp"
#include "followthrough/controls/amplified.hpp"
#include "followthrough/controls/relative_damping.hpp"
#include "followthrough/controls/soft_pins.hpp"

namespace py = pybind11;

namespace followthrough {

void bind_controls(py::module_& m) {
  py::class_<Amplified, Solver>(m, "Amplified", "Motion farther or less far. Use followthrough.controls.Amplified.")
      .def(py::init<Solver&, double>(), py::arg("solver"), py::arg("amplitude"), py::keep_alive<1, 2>());

  py::class_<RelativeDamping, Solver>(m, "RelativeDamping",
                                      "Motion that dies down sooner. Use followthrough.controls.RelativeDamping.")
      .def(py::init<Solver&, double, double>(), py::arg("solver"), py::arg("rate"), py::arg("dt"), py::keep_alive<1, 2>())
      .def("damp", &RelativeDamping::damp, py::arg("reference"), py::arg("before"));

  py::class_<SoftPins, Solver>(m, "SoftPins", "Vertices drawn towards their reference. Use followthrough.controls.SoftPins.")
      .def(py::init<Solver&, Vector>(), py::arg("solver"), py::arg("share"), py::keep_alive<1, 2>());
}

}  // namespace followthrough
