// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/emulator.hpp"

#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <optional>
#include <string>
#include <utility>

#include "bindings.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

using FloatArray = py::array_t<float, py::array::c_style>;
using Layers = std::vector<std::pair<FloatArray, std::optional<FloatArray>>>;

Perceptron perceptron_of(const char* name, const Layers& layers) {
  Perceptron perceptron;
  for (const auto& [weight, bias] : layers) {
    if (weight.ndim() != 2 || (bias && bias->ndim() != 1)) {
      throw InvalidInput(name, "found weights or biases of other dimensions, expected (outputs, inputs) and (outputs,)");
    }
    DenseLayer layer;
    layer.weight = Eigen::Map<const decltype(layer.weight)>(weight.data(), weight.shape(0), weight.shape(1));
    if (bias) layer.bias = Eigen::Map<const Eigen::VectorXf>(bias->data(), bias->shape(0));
    perceptron.push_back(std::move(layer));
  }
  return perceptron;
}

Precision precision_named(const std::string& name) {
  if (name == "float32") return Precision::float32;
  if (name == "bfloat16") return Precision::bfloat16;
  throw InvalidInput("precision", "found '" + name + "', expected 'float32' or 'bfloat16'");
}

Emulator make(ConstPositions rest_positions, ConstTets tets, ConstMask constrained, const Vector& youngs_modulus,
              const Vector& density, double dt, double edge_length, const Layers& inertia, const std::vector<Layers>& forces,
              const Layers& displacement, double network_edge_length, double network_dt, double network_density,
              const Eigen::Vector3d& gravity, const std::string& precision) {
  PatchNetwork network;
  network.inertia = perceptron_of("point_mlp", inertia);
  for (const Layers& force : forces) network.forces.push_back(perceptron_of("edge_mlp", force));
  network.displacement = perceptron_of("instance_mlp", displacement);
  EmulatedBody body{rest_positions, tets, constrained, youngs_modulus, density, dt, edge_length, gravity};
  const py::gil_scoped_release release;
  return Emulator(body, network, {network_edge_length, network_dt, network_density}, precision_named(precision));
}

}  // namespace

void bind_emulator(py::module_& m) {
  py::class_<Emulator, Solver>(m, "Emulator", "Dynamics by a patch network. Use followthrough.emulator.Emulator.")
      .def(py::init(&make), py::arg("rest_positions"), py::arg("tets"), py::arg("constrained"), py::arg("youngs_modulus"),
           py::arg("density"), py::arg("dt"), py::arg("edge_length"), py::arg("inertia"), py::arg("forces"),
           py::arg("displacement"), py::arg("network_edge_length"), py::arg("network_dt"), py::arg("network_density"),
           py::arg("gravity"), py::arg("precision"))
      .def_property_readonly("vertex_count", &Emulator::vertex_count)
      .def_property_readonly("free_vertex_count", &Emulator::free_vertex_count)
      .def_property_readonly("edge_count", &Emulator::edge_count)
      .def_property_readonly("multiply_adds", &Emulator::multiply_adds)
      .def_property_readonly("edge_length", &Emulator::edge_length)
      .def_property_readonly("stiffness", &Emulator::stiffness);
}

}  // namespace followthrough
