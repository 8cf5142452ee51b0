// SPDX-License-Identifier: GPL-3.0-or-later
// Newton passes that a network corrects, and what its training sees of them.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <array>
#include <string>
#include <utility>
#include <vector>

#include "bindings.hpp"
#include "followthrough/emulator/newton_patches.hpp"
#include "followthrough/emulator/patch_newton.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

using FloatArray = py::array_t<float, py::array::c_style>;
using Layers = std::vector<std::pair<FloatArray, FloatArray>>;

Guide guide_of(const Layers& layers) {
  Guide guide;
  for (const auto& [weight, bias] : layers) {
    if (weight.ndim() != 2 || bias.ndim() != 1) {
      throw InvalidInput("guide", "found weights or biases of other dimensions, expected (outputs, inputs) and (outputs,)");
    }
    DenseLayer& layer = guide.emplace_back();
    layer.weight = Eigen::Map<const decltype(layer.weight)>(weight.data(), weight.shape(0), weight.shape(1));
    layer.bias = Eigen::Map<const Eigen::VectorXf>(bias.data(), bias.shape(0));
  }
  return guide;
}

py::tuple arrays_of(PatchFeatures&& features) { return py::make_tuple(std::move(features.vectors), std::move(features.scalars)); }

NewtonBody body_of(ConstPositions rest_positions, ConstTets tets, ConstMask constrained, const Vector& youngs_modulus,
                   const Vector& density, double dt, double edge_length, double poisson_ratio, double compression_resistance,
                   const Vector& pin_stiffness = {}, const Eigen::Vector3d& gravity = Eigen::Vector3d::Zero()) {
  return {{rest_positions, tets, constrained, youngs_modulus, density, dt, edge_length, gravity},
          poisson_ratio,
          compression_resistance,
          pin_stiffness};
}

py::array_t<Index> array_of_indices(const std::vector<Index>& indices) {
  return py::array_t<Index>(static_cast<py::ssize_t>(indices.size()), indices.data());
}

void bind_patches(py::module_& m) {
  py::class_<NewtonPatches>(m, "NewtonPatches",
                            "A frame's Newton steps as a network sees them. Use followthrough.emulator.NewtonPatches.")
      .def(py::init([](ConstPositions rest_positions, ConstTets tets, ConstMask constrained, const Vector& youngs_modulus,
                       const Vector& density, double dt, double edge_length, double poisson_ratio, double compression_resistance) {
             return NewtonPatches(body_of(rest_positions, tets, constrained, youngs_modulus, density, dt, edge_length,
                                          poisson_ratio, compression_resistance));
           }),
           py::arg("rest_positions"), py::arg("tets"), py::arg("constrained"), py::arg("youngs_modulus"), py::arg("density"),
           py::arg("dt"), py::arg("edge_length"), py::arg("poisson_ratio"), py::arg("compression_resistance"))
      .def_property_readonly("vertex_count", &NewtonPatches::vertex_count)
      .def_property_readonly("edge_length", &NewtonPatches::edge_length)
      .def_property_readonly("stiffness", &NewtonPatches::stiffness)
      .def_property_readonly("free_vertices", [](const NewtonPatches& p) { return array_of_indices(p.free_vertices()); })
      .def_property_readonly("edge_starts", [](const NewtonPatches& p) { return array_of_indices(p.edge_starts()); })
      .def_property_readonly("neighbours", [](const NewtonPatches& p) { return array_of_indices(p.neighbours()); })
      .def(
          "begin",
          [](NewtonPatches& patches, const std::array<Positions, 4>& dynamic, const std::array<Positions, 4>& reference) {
            const py::gil_scoped_release release;
            patches.begin(
                {{dynamic[0], dynamic[1], dynamic[2], dynamic[3]}, {reference[0], reference[1], reference[2], reference[3]}});
          },
          py::arg("dynamic"), py::arg("reference"))
      .def("start_features", [](NewtonPatches& patches) { return arrays_of(patches.start_features()); })
      .def("evaluate", &NewtonPatches::evaluate, py::arg("iterations"), py::call_guard<py::gil_scoped_release>())
      .def("features", [](NewtonPatches& patches) { return arrays_of(patches.features()); })
      .def("direction", &NewtonPatches::direction)
      .def("move", &NewtonPatches::move, py::arg("step"), py::arg("last"))
      .def("end_passes", &NewtonPatches::end_passes)
      .def("estimate", &NewtonPatches::estimate);
}

}  // namespace

void bind_emulator_newton(py::module_& m) {
  bind_patches(m);
  m.attr("start_guide_size") = py::make_tuple(start_guide_size().vectors, start_guide_size().scalars);
  m.attr("pass_guide_size") = py::make_tuple(pass_guide_size().vectors, pass_guide_size().scalars);
  py::class_<PatchNewton, Solver>(m, "PatchNewton", "Dynamics by corrected Newton steps. Use followthrough.emulator.Emulator.")
      .def(py::init([](ConstPositions rest_positions, ConstTets tets, ConstMask constrained, const Vector& youngs_modulus,
                       const Vector& density, double dt, double edge_length, const Eigen::Vector3d& gravity, double poisson_ratio,
                       double compression_resistance, const Vector& pin_stiffness, const Layers& start,
                       const std::vector<std::pair<int, Layers>>& passes, int most_passes, double tolerance, int extra_passes,
                       int extra_iterations) {
             const NewtonBody body = body_of(rest_positions, tets, constrained, youngs_modulus, density, dt, edge_length,
                                             poisson_ratio, compression_resistance, pin_stiffness, gravity);
             NewtonSchedule schedule{guide_of(start), {}, most_passes, tolerance, extra_passes, extra_iterations};
             for (const auto& [iterations, guide] : passes) schedule.passes.push_back({iterations, guide_of(guide)});
             const py::gil_scoped_release release;
             return PatchNewton(body, schedule);
           }),
           py::arg("rest_positions"), py::arg("tets"), py::arg("constrained"), py::arg("youngs_modulus"), py::arg("density"),
           py::arg("dt"), py::arg("edge_length"), py::arg("gravity"), py::arg("poisson_ratio"), py::arg("compression_resistance"),
           py::arg("pin_stiffness"), py::arg("start"), py::arg("passes"), py::arg("most_passes"), py::arg("tolerance"),
           py::arg("extra_passes"), py::arg("extra_iterations"))
      .def_property_readonly("vertex_count", &PatchNewton::vertex_count)
      .def_property_readonly("free_vertex_count", &PatchNewton::free_vertex_count)
      .def_property_readonly("edge_count", &PatchNewton::edge_count)
      .def_property_readonly("multiply_adds", &PatchNewton::multiply_adds)
      .def_property_readonly("edge_length", &PatchNewton::edge_length)
      .def_property_readonly("stiffness", &PatchNewton::stiffness);
}

}  // namespace followthrough
