// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// One function a topic; each adds its bindings to the module. And how positions come in without a copy.
#pragma once

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <memory>
#include <optional>
#include <string>

#include "followthrough/elastic/material.hpp"
#include "followthrough/errors.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

void bind_controls(pybind11::module_& m);
void bind_elastic(pybind11::module_& m);
void bind_emulator(pybind11::module_& m);
void bind_emulator_newton(pybind11::module_& m);
void bind_mesh(pybind11::module_& m);
void bind_skinning(pybind11::module_& m);
void bind_motion(pybind11::module_& m);
void bind_quasistatic(pybind11::module_& m);
void bind_solver(pybind11::module_& m);
void bind_springs(pybind11::module_& m);

using ArrayOfPositions = pybind11::array_t<double, pybind11::array::c_style>;

/// @return a view of a dense (n,3) NumPy array
inline Eigen::Map<const Positions> positions_of(const char* name, const ArrayOfPositions& array) {
  if (array.ndim() != 2 || array.shape(1) != 3) {
    throw InvalidInput(name, "found " + std::to_string(array.ndim()) + " dimensions, expected shape (n, 3)");
  }
  return {array.data(), array.shape(0), 3};
}

/// @return a NumPy array of its own
inline ArrayOfPositions array_of(const Positions& positions) {
  return ArrayOfPositions({positions.rows(), Eigen::Index{3}}, positions.data());
}

/// @return a copy, which stays when the interpreter goes on
inline std::optional<Positions> copy_of(const char* name, const std::optional<ArrayOfPositions>& array) {
  if (!array) return std::nullopt;
  return Positions(positions_of(name, *array));
}

/// @throws InvalidInput where there is none of that name
std::shared_ptr<const Material> material_named(const std::string& name);

}  // namespace followthrough
