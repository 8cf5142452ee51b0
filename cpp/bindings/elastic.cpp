// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <memory>
#include <string>

#include "bindings.hpp"
#include "followthrough/elastic/central_differences.hpp"
#include "followthrough/elastic/implicit_euler.hpp"
#include "followthrough/elastic/predictor_corrector.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

using release = py::call_guard<py::gil_scoped_release>;

Definiteness definiteness(bool semidefinite) { return semidefinite ? Definiteness::kSemidefinite : Definiteness::kExact; }

}  // namespace

std::shared_ptr<const Material> material_named(const std::string& name) {
  if (name == "invertible-stvk") return std::make_shared<InvertibleStVK>();
  if (name == "corotational") return std::make_shared<CorotationalLinear>();
  throw InvalidInput("material", "found '" + name + "', expected 'invertible-stvk' or 'corotational'");
}

void bind_elastic(py::module_& m) {
  m.def(
      "signed_svd",
      [](const Eigen::Matrix3d& matrix) {
        if (!matrix.allFinite()) throw InvalidInput("matrix", "found NaN or infinity, expected finite numbers");
        const SignedSvd svd = signed_svd(matrix);
        return py::make_tuple(svd.u, svd.stretches, svd.v);
      },
      py::arg("matrix"), "Rotations u, v and signed stretches of a 3x3 matrix.");

  py::class_<ElasticBody>(m, "ElasticBody", "Linear finite elements. Use followthrough.elastic.ElasticBody.")
      .def(py::init([](ConstPositions rest_positions, ConstTets tets, const Vector& youngs_modulus, const Vector& density,
                       double poisson_ratio, double compression_resistance) {
             return ElasticBody(rest_positions, tets, {youngs_modulus, density, poisson_ratio, compression_resistance});
           }),
           py::arg("rest_positions"), py::arg("tets"), py::arg("youngs_modulus"), py::arg("density"), py::arg("poisson_ratio"),
           py::arg("compression_resistance"), release())
      .def_property_readonly("vertex_count", &ElasticBody::vertex_count)
      .def_property_readonly("inverted_rest_tets", &ElasticBody::inverted_rest_tets)
      .def_property_readonly("lumped_mass", &ElasticBody::lumped_mass)
      .def(
          "energy",
          [](const ElasticBody& body, ConstPositions positions, const std::string& material) {
            return body.energy(positions, *material_named(material));
          },
          py::arg("positions"), py::arg("material"), release())
      .def(
          "internal_forces",
          [](const ElasticBody& body, ConstPositions positions, const std::string& material) {
            return body.internal_forces(positions, *material_named(material));
          },
          py::arg("positions"), py::arg("material"), release())
      .def(
          "stiffness_product",
          [](const ElasticBody& body, ConstPositions positions, ConstPositions change, const std::string& material,
             bool semidefinite) {
            return body.stiffness_product(positions, change, *material_named(material), definiteness(semidefinite));
          },
          py::arg("positions"), py::arg("change"), py::arg("material"), py::arg("semidefinite"), release())
      .def("mass_product", &ElasticBody::mass_product, py::arg("values"), release());

  py::class_<NewtonSettings>(m, "NewtonSettings")
      .def_static("preview", &NewtonSettings::preview)
      .def_static("fine", &NewtonSettings::fine)
      .def_static("converged", &NewtonSettings::converged)
      .def_readwrite("tolerance", &NewtonSettings::tolerance)
      .def_readwrite("most_iterations", &NewtonSettings::most_iterations)
      .def_readwrite("most_linear_iterations", &NewtonSettings::most_linear_iterations);

  py::class_<StepReport>(m, "StepReport")
      .def_readonly("converged", &StepReport::converged)
      .def_readonly("iterations", &StepReport::iterations)
      .def_readonly("linear_iterations", &StepReport::linear_iterations)
      .def_readonly("residual", &StepReport::residual);

  py::class_<ImplicitEuler, Solver>(m, "ImplicitEuler", "Backward Euler finite elements. Use followthrough.elastic.ImplicitEuler.")
      .def(py::init([](const ElasticBody& body, const std::string& material, ConstMask constrained, double dt,
                       const NewtonSettings& newton, const Eigen::Vector3d& gravity, double mass_damping, double stiffness_damping,
                       const Vector& pin_stiffness) {
             return std::make_unique<ImplicitEuler>(body, material_named(material), constrained, dt, newton,
                                                    ExternalForces{gravity, mass_damping, stiffness_damping, pin_stiffness});
           }),
           py::arg("body"), py::arg("material"), py::arg("constrained"), py::arg("dt"), py::arg("newton"), py::arg("gravity"),
           py::arg("mass_damping"), py::arg("stiffness_damping"), py::arg("pin_stiffness"), release())
      .def_property_readonly("last_step", &ImplicitEuler::last_step);

  py::class_<PredictorCorrector, Solver>(
      m, "PredictorCorrector", "A prediction that the true solver improves. Use followthrough.elastic.PredictorCorrector.")
      .def(py::init<Solver&, ImplicitEuler&>(), py::arg("predictor"), py::arg("corrector"), py::keep_alive<1, 2>(),
           py::keep_alive<1, 3>())
      .def_property_readonly("last_step", &PredictorCorrector::last_step);

  py::class_<CentralDifferences, Solver>(m, "CentralDifferences",
                                         "Explicit finite elements. Use followthrough.elastic.CentralDifferences.")
      .def(py::init([](const ElasticBody& body, const std::string& material, ConstMask constrained, double dt, int substeps,
                       const Eigen::Vector3d& gravity, double mass_damping) {
             return std::make_unique<CentralDifferences>(body, material_named(material), constrained, dt, substeps, gravity,
                                                         mass_damping);
           }),
           py::arg("body"), py::arg("material"), py::arg("constrained"), py::arg("dt"), py::arg("substeps"), py::arg("gravity"),
           py::arg("mass_damping"), release())
      .def_property_readonly("last_substeps", &CentralDifferences::last_substeps)
      .def("stable_step", &CentralDifferences::stable_step, py::arg("positions"), release());
}

}  // namespace followthrough
