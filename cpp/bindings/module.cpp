// SPDX-License-Identifier: GPL-3.0-or-later
// The extension module followthrough._core. One file a topic; argument checks and docstrings, no logic.
#include <omp.h>

#include <stdexcept>
#include <string>

#include "bindings.hpp"

PYBIND11_MODULE(_core, m) {
  m.doc() = "Native core of followthrough. Use the followthrough package, which is typed and documented.";
  m.attr("__version__") = FOLLOWTHROUGH_VERSION;
  m.def("threads", &omp_get_max_threads, "Threads that the core works with.");
  m.def(
      "set_threads",
      [](int threads) {
        if (threads < 1) throw std::invalid_argument("threads: found " + std::to_string(threads) + ", expected 1 or more");
        omp_set_num_threads(threads);
      },
      pybind11::arg("threads"), "Sets how many threads the core works with. Results do not depend on it.");
  followthrough::bind_solver(m);  // first: the solvers derive from it
  followthrough::bind_elastic(m);
  followthrough::bind_mesh(m);
  followthrough::bind_skinning(m);
  followthrough::bind_motion(m);
  followthrough::bind_springs(m);
  followthrough::bind_quasistatic(m);
  followthrough::bind_emulator(m);
  followthrough::bind_emulator_newton(m);
  followthrough::bind_controls(m);
}
