// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/springs.hpp"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <string>
#include <vector>

#include "bindings.hpp"
#include "followthrough/springs/spring_fit.hpp"

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

using ArrayOfFrames = py::array_t<double, py::array::c_style>;

// Views of (F, n, 3) arrays, which the caller keeps.
std::vector<SpringTraining> trainings_of(const std::vector<ArrayOfFrames>& references, const std::vector<ArrayOfFrames>& dynamics,
                                         const std::vector<double>& dts) {
  if (references.size() != dynamics.size() || references.size() != dts.size()) {
    throw InvalidInput("motions", "found lists of different lengths, expected a reference, a dynamic and a dt for each");
  }
  const auto frames_of = [](const char* name, const ArrayOfFrames& array) {
    if (array.ndim() != 3 || array.shape(2) != 3) {
      throw InvalidInput(name, "found " + std::to_string(array.ndim()) + " dimensions, expected shape (frames, n, 3)");
    }
    return Eigen::Map<const Values>(array.data(), array.shape(0), 3 * array.shape(1));
  };
  std::vector<SpringTraining> trainings;
  for (std::size_t m = 0; m < references.size(); ++m) {
    trainings.push_back({frames_of("reference", references[m]), frames_of("dynamic", dynamics[m]), dts[m]});
  }
  return trainings;
}

py::tuple fit(const std::vector<ArrayOfFrames>& references, const std::vector<ArrayOfFrames>& dynamics,
              const std::vector<double>& dts, const ConstMask& skipped, Eigen::Index first, Eigen::Index count,
              const SpringFitSettings& settings) {
  const std::vector<SpringTraining> trainings = trainings_of(references, dynamics, dts);
  SpringFit found;
  {
    const py::gil_scoped_release release;
    found = fit_springs(trainings, skipped, first, count, settings);
  }
  return py::make_tuple(found.stiffness, found.damping, found.loss, found.reference_loss, found.status);
}

py::tuple loss(const std::vector<ArrayOfFrames>& references, const std::vector<ArrayOfFrames>& dynamics,
               const std::vector<double>& dts, const ConstVector& stiffness, const ConstVector& damping) {
  const std::vector<SpringTraining> trainings = trainings_of(references, dynamics, dts);
  SpringLoss found;
  {
    const py::gil_scoped_release release;
    found = spring_loss(trainings, stiffness, damping);
  }
  return py::make_tuple(found.loss, found.by_stiffness, found.by_damping);
}

}  // namespace

void bind_springs(py::module_& m) {
  py::class_<Springs, Solver>(m, "Springs", "Analytic zero-restlength springs. Use followthrough.springs.Springs.")
      .def(py::init<ConstVector, ConstVector, double, ConstMask, const Eigen::Vector3d&>(), py::arg("stiffness"),
           py::arg("damping"), py::arg("dt"), py::arg("pinned"), py::arg("gravity"), py::call_guard<py::gil_scoped_release>())
      .def("evaluate", &evaluate, py::arg("fraction"), py::arg("reference"), py::arg("next_reference") = py::none(),
           "Positions (n, 3) within the frame to come; changes nothing.");

  py::class_<SpringFitSettings>(m, "SpringFitSettings", "See followthrough.spring_fit.")
      .def(py::init<>())
      .def_readwrite("regularization", &SpringFitSettings::regularization)
      .def_readwrite("dropped_share", &SpringFitSettings::dropped_share)
      .def_readwrite("seed", &SpringFitSettings::seed)
      .def_readwrite("population", &SpringFitSettings::population)
      .def_readwrite("generations", &SpringFitSettings::generations);
  m.attr("USUAL_SPRING") = py::make_tuple(usual_stiffness, usual_damping);
  m.def("fit_springs", &fit, py::arg("references"), py::arg("dynamics"), py::arg("dts"), py::arg("skipped"), py::arg("first"),
        py::arg("count"), py::arg("settings"), "ks, kd, loss, reference loss and status of some vertices.");
  m.def("spring_loss", &loss, py::arg("references"), py::arg("dynamics"), py::arg("dts"), py::arg("stiffness"), py::arg("damping"),
        "Loss of every vertex, and its derivatives with respect to log ks and log kd.");
}

}  // namespace followthrough
