// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// One function a topic; each adds its bindings to the module.
#pragma once

#include <pybind11/pybind11.h>

namespace followthrough {

void bind_elastic(pybind11::module_& m);
void bind_mesh(pybind11::module_& m);
void bind_skinning(pybind11::module_& m);
void bind_motion(pybind11::module_& m);
void bind_springs(pybind11::module_& m);

}  // namespace followthrough
