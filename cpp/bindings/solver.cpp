// SPDX-License-Identifier: GPL-3.0-or-later
// The interface that every solver shares; solvers themselves are bound with their topics and derive from it.
#include "followthrough/solver.hpp"

#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <optional>

#include "bindings.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

ArrayOfPositions step(Solver& solver, const ArrayOfPositions& reference, const std::optional<ArrayOfPositions>& next_reference) {
  const Eigen::Map<const Positions> end = positions_of("reference", reference);
  const std::optional<Positions> after = copy_of("next_reference", next_reference);
  const Positions* dynamic = nullptr;
  {
    const py::gil_scoped_release release;
    dynamic = &solver.step(end, after ? &*after : nullptr);
  }
  return array_of(*dynamic);
}

}  // namespace

void bind_solver(py::module_& m) {
  py::class_<Solver>(m, "Solver", "A dynamics method. Use followthrough.solver.Solver.")
      .def_property_readonly("vertex_count", &Solver::vertex_count)
      .def(
          "reset",
          [](Solver& solver, const ArrayOfPositions& reference) {
            const Eigen::Map<const Positions> start = positions_of("reference", reference);
            const py::gil_scoped_release release;
            solver.reset(start);
          },
          py::arg("reference"), "Starts over on the reference (n, 3), m.")
      .def("step", &step, py::arg("reference"), py::arg("next_reference") = py::none(),
           "Takes one frame; returns positions (n, 3), m.")
      .def(
          "state",
          [](const Solver& solver) {
            SolverState state = solver.state();
            return py::make_tuple(std::move(state.arrays), std::move(state.counters));
          },
          "Arrays and counters that are carried from frame to frame.")
      .def(
          "restore",
          [](Solver& solver, std::vector<Positions> arrays, std::vector<std::int64_t> counters) {
            solver.restore(SolverState{std::move(arrays), std::move(counters)});
          },
          py::arg("arrays"), py::arg("counters"), "Goes back to a state.");
}

}  // namespace followthrough
