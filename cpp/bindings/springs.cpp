// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/springs.hpp"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <string>

#include "bindings.hpp"
#include "followthrough/errors.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

using Array = py::array_t<double, py::array::c_style>;

// A view of a dense (n,3) NumPy array; springs.py has converted it.
Eigen::Map<const Positions> positions_of(const char* name, const Array& array) {
  if (array.ndim() != 2 || array.shape(1) != 3) {
    throw InvalidInput(name, "found " + std::to_string(array.ndim()) + " dimensions, expected shape (n, 3)");
  }
  return {array.data(), array.shape(0), 3};
}

std::optional<Positions> copy_of(const char* name, const std::optional<Array>& array) {
  if (!array) {
    return std::nullopt;
  }
  return Positions(positions_of(name, *array));
}

Array step(Springs& springs, const Array& reference, const std::optional<Array>& next_reference) {
  const Eigen::Map<const Positions> end = positions_of("reference", reference);
  const std::optional<Positions> after = copy_of("next_reference", next_reference);
  const Positions* dynamic = nullptr;
  {
    py::gil_scoped_release release;
    dynamic = &springs.step(end, after ? &*after : nullptr);
  }
  return Array({dynamic->rows(), Eigen::Index{3}}, dynamic->data());
}

Array evaluate(const Springs& springs, double fraction, const Array& reference, const std::optional<Array>& next_reference) {
  const Eigen::Map<const Positions> end = positions_of("reference", reference);
  const std::optional<Positions> after = copy_of("next_reference", next_reference);
  Positions dynamic;
  {
    py::gil_scoped_release release;
    dynamic = springs.evaluate(fraction, end, after ? &*after : nullptr);
  }
  return Array({dynamic.rows(), Eigen::Index{3}}, dynamic.data());
}

}  // namespace

void bind_springs(py::module_& m) {
  py::class_<Springs, Solver>(m, "Springs", "Analytic zero-restlength springs. Use followthrough.springs.Springs.")
      .def(py::init<ConstVector, ConstVector, double, ConstMask>(), py::arg("stiffness"), py::arg("damping"), py::arg("dt"),
           py::arg("pinned"), py::call_guard<py::gil_scoped_release>())
      .def_property_readonly("vertex_count", &Springs::vertex_count)
      .def(
          "reset",
          [](Springs& springs, const Array& reference) {
            const Eigen::Map<const Positions> start = positions_of("reference", reference);
            py::gil_scoped_release release;
            springs.reset(start);
          },
          py::arg("reference"), "Starts over on the reference (n, 3), m.")
      .def("step", &step, py::arg("reference"), py::arg("next_reference") = py::none(),
           "Takes one frame; returns positions (n, 3), m.")
      .def("evaluate", &evaluate, py::arg("fraction"), py::arg("reference"), py::arg("next_reference") = py::none(),
           "Positions (n, 3) within the frame to come; changes nothing.")
      .def("state",
           [](const Springs& springs) {
             SolverState state = springs.state();
             return py::make_tuple(std::move(state.arrays), std::move(state.counters));
           })
      .def(
          "restore",
          [](Springs& springs, std::vector<Positions> arrays, std::vector<std::int64_t> counters) {
            springs.restore(SolverState{std::move(arrays), std::move(counters)});
          },
          py::arg("arrays"), py::arg("counters"));
}

}  // namespace followthrough
