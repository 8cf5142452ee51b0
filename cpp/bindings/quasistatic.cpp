// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>

#include "bindings.hpp"
#include "followthrough/quasistatic/over_quasistatic.hpp"

namespace py = pybind11;

namespace followthrough {

void bind_quasistatic(py::module_& m) {
  py::class_<EquilibriumSettings>(m, "EquilibriumSettings")
      .def_static("preview", &EquilibriumSettings::preview)
      .def_static("fine", &EquilibriumSettings::fine)
      .def_static("converged", &EquilibriumSettings::converged)
      .def_readwrite("tolerance", &EquilibriumSettings::tolerance)
      .def_readwrite("most_iterations", &EquilibriumSettings::most_iterations)
      .def_readwrite("most_linear_iterations", &EquilibriumSettings::most_linear_iterations);

  py::class_<Quasistatic>(m, "Quasistatic", "Static equilibria. Use followthrough.quasistatic.Quasistatic.")
      .def(py::init([](const ElasticBody& body, const std::string& material, ConstMask constrained,
                       const EquilibriumSettings& settings, const Eigen::Vector3d& gravity, const Vector& pin_stiffness) {
             return Quasistatic(body, material_named(material), constrained, settings, {gravity, pin_stiffness});
           }),
           py::arg("body"), py::arg("material"), py::arg("constrained"), py::arg("settings"), py::arg("gravity"),
           py::arg("pin_stiffness"), py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("vertex_count", &Quasistatic::vertex_count)
      .def_property_readonly("last_solve", &Quasistatic::last_solve)
      .def("forget", &Quasistatic::forget)
      .def(
          "solve",
          [](Quasistatic& layer, const ArrayOfPositions& reference) {
            const Eigen::Map<const Positions> pose = positions_of("reference", reference);
            const Positions* found = nullptr;
            {
              const py::gil_scoped_release release;
              found = &layer.solve(pose);
            }
            return array_of(*found);
          },
          py::arg("reference"), "Equilibrium (n, 3) of a pose, m.");

  py::class_<OverQuasistatic, Solver>(m, "OverQuasistatic",
                                      "A solver over static equilibria. Use followthrough.quasistatic.OverQuasistatic.")
      .def(py::init<Quasistatic&, Solver*>(), py::arg("layer"), py::arg("solver") = py::none(), py::keep_alive<1, 2>(),
           py::keep_alive<1, 3>())
      .def_property_readonly("last_solve", &OverQuasistatic::last_solve);
}

}  // namespace followthrough
