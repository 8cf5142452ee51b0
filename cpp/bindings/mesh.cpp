// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>

#include "bindings.hpp"

namespace followthrough {

void bind_mesh(pybind11::module_& m) { (void)m; }

}  // namespace followthrough
