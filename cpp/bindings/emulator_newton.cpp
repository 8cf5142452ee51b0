// SPDX-License-Identifier: GPL-3.0-or-later
// Newton passes that a network corrects, and what its training sees of them.
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <string>
#include <utility>

#include "bindings.hpp"
#include "followthrough/emulator/newton_patches.hpp"
#include "followthrough/emulator/patch_newton.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

using FloatArray = py::array_t<float, py::array::c_style>;
using Layer = std::pair<FloatArray, std::optional<FloatArray>>;
using Layers = std::vector<Layer>;

DenseLayer layer_of(const std::string& name, const Layer& arrays) {
  const auto& [weight, bias] = arrays;
  if (weight.ndim() != 2 || (bias && bias->ndim() != 1)) {
    throw InvalidInput(name, "found weights or biases of other dimensions, expected (outputs, inputs) and (outputs,)");
  }
  DenseLayer layer;
  layer.weight = Eigen::Map<const decltype(layer.weight)>(weight.data(), weight.shape(0), weight.shape(1));
  if (bias) layer.bias = Eigen::Map<const Eigen::VectorXf>(bias->data(), bias->shape(0));
  return layer;
}

NewtonPass make_pass(int iterations, std::string channels, const Layers& edge, const std::optional<Layer>& centre,
                     const Layers& instance, const std::optional<Layer>& out, float skip) {
  NewtonPass pass;
  pass.iterations = iterations;
  pass.channels = std::move(channels);
  for (const Layer& layer : edge) pass.edge.push_back(layer_of("edge", layer));
  if (centre) pass.centre = layer_of("centre", *centre);
  for (const Layer& layer : instance) pass.instance.push_back(layer_of("instance", layer));
  if (out) pass.out = layer_of("out", *out);
  pass.skip = skip;
  return pass;
}

NewtonBody body_of(ConstPositions rest_positions, ConstTets tets, ConstMask constrained, const Vector& youngs_modulus,
                   const Vector& density, double dt, double edge_length, double poisson_ratio, double compression_resistance) {
  return {{rest_positions, tets, constrained, youngs_modulus, density, dt, edge_length}, poisson_ratio, compression_resistance};
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
          [](NewtonPatches& patches, ConstPositions now, ConstPositions before, ConstPositions before_that,
             ConstPositions reference_before, ConstPositions reference_now, ConstPositions reference_next, double beta) {
            const py::gil_scoped_release release;
            patches.begin({now, before, before_that, reference_before, reference_now, reference_next}, beta);
          },
          py::arg("now"), py::arg("before"), py::arg("before_that"), py::arg("reference_before"), py::arg("reference_now"),
          py::arg("reference_next"), py::arg("beta"))
      .def("evaluate", &NewtonPatches::evaluate, py::arg("iterations"), py::call_guard<py::gil_scoped_release>())
      .def(
          "features",
          [](NewtonPatches& patches, const std::string& channels) {
            PatchFeatures features;
            {
              const py::gil_scoped_release release;
              features = patches.features(channels);
            }
            return py::make_tuple(std::move(features.edges), std::move(features.centres), std::move(features.sizes),
                                  std::move(features.rotations));
          },
          py::arg("channels"))
      .def("direction", &NewtonPatches::direction)
      .def("move", &NewtonPatches::move, py::arg("step"))
      .def("estimate", &NewtonPatches::estimate);
}

}  // namespace

void bind_emulator_newton(py::module_& m) {
  bind_patches(m);
  py::class_<NewtonPass>(m, "NewtonPass", "A pass of PatchNewton.")
      .def(py::init(&make_pass), py::arg("iterations"), py::arg("channels") = "", py::arg("edge") = Layers{},
           py::arg("centre") = py::none(), py::arg("instance") = Layers{}, py::arg("out") = py::none(), py::arg("skip") = 0.0f);
  py::class_<PatchNewton, Solver>(m, "PatchNewton", "Dynamics by corrected Newton steps. Use followthrough.emulator.Emulator.")
      .def(py::init([](ConstPositions rest_positions, ConstTets tets, ConstMask constrained, const Vector& youngs_modulus,
                       const Vector& density, double dt, double edge_length, double poisson_ratio, double compression_resistance,
                       const std::vector<NewtonPass>& passes, double beta, int extra_passes, int extra_iterations) {
             const NewtonBody body = body_of(rest_positions, tets, constrained, youngs_modulus, density, dt, edge_length,
                                             poisson_ratio, compression_resistance);
             const py::gil_scoped_release release;
             return PatchNewton(body, {passes, beta, extra_passes, extra_iterations});
           }),
           py::arg("rest_positions"), py::arg("tets"), py::arg("constrained"), py::arg("youngs_modulus"), py::arg("density"),
           py::arg("dt"), py::arg("edge_length"), py::arg("poisson_ratio"), py::arg("compression_resistance"), py::arg("passes"),
           py::arg("beta"), py::arg("extra_passes"), py::arg("extra_iterations"))
      .def_property_readonly("vertex_count", &PatchNewton::vertex_count)
      .def_property_readonly("free_vertex_count", &PatchNewton::free_vertex_count)
      .def_property_readonly("edge_count", &PatchNewton::edge_count)
      .def_property_readonly("multiply_adds", &PatchNewton::multiply_adds)
      .def_property_readonly("edge_length", &PatchNewton::edge_length)
      .def_property_readonly("stiffness", &PatchNewton::stiffness);
}

}  // namespace followthrough
