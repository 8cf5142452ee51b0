// SPDX-License-Identifier: GPL-3.0-or-later
// The extension module followthrough._core. One file a topic; argument checks and docstrings, no logic.
#include "bindings.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "Native core of followthrough. Use the followthrough package, which is typed and documented.";
  m.attr("__version__") = FOLLOWTHROUGH_VERSION;
  followthrough::bind_mesh(m);
  followthrough::bind_skinning(m);
  followthrough::bind_springs(m);
}
