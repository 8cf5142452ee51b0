// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>
#include <pybind11/stl.h>

#include <memory>
#include <optional>
#include <utility>

#include "bindings.hpp"
#include "followthrough/motion/rigged_motion.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

py::tuple as_tuple(MotionFrame frame) {
  return py::make_tuple(std::move(frame.offsets), std::move(frame.displacements), frame.largest_displacement,
                        frame.largest_residual);
}

}  // namespace

void bind_motion(py::module_& m) {
  py::class_<RigPose>(m, "RigPose", "One frame of a rig.")
      .def(py::init([](ConstMatrices4 bone_matrices, const Eigen::Matrix4d& armature, const Eigen::Matrix4d& world) {
             return RigPose{bone_matrices, armature, world};
           }),
           py::arg("bone_matrices"), py::arg("armature"), py::arg("world"));

  py::class_<RiggedMotion>(m, "RiggedMotion", "One character's frames. Use followthrough.secondary_motion.SecondaryMotion.")
      .def(py::init([](ConstPositions volume_rest_positions, ConstIndexTable volume_bones, ConstValues volume_weights,
                       ConstTets tets, ConstIndices embedding_tets, ConstWeights4 embedding_weights, ConstIndexTable surface_bones,
                       ConstValues surface_weights, ConstMatrices4 bone_rest_matrices, bool dual_quaternion, double minimum_stretch,
                       Solver& solver, int threads) {
             return std::make_unique<RiggedMotion>(RiggedCharacter{volume_rest_positions,
                                                                   volume_bones,
                                                                   volume_weights,
                                                                   tets,
                                                                   {embedding_tets, embedding_weights},
                                                                   surface_bones,
                                                                   surface_weights,
                                                                   bone_rest_matrices,
                                                                   dual_quaternion ? Skinning::dual_quaternion : Skinning::linear,
                                                                   minimum_stretch},
                                                   solver, threads);
           }),
           py::arg("volume_rest_positions"), py::arg("volume_bones"), py::arg("volume_weights"), py::arg("tets"),
           py::arg("embedding_tets"), py::arg("embedding_weights"), py::arg("surface_bones"), py::arg("surface_weights"),
           py::arg("bone_rest_matrices"), py::arg("dual_quaternion"), py::arg("minimum_stretch"), py::arg("solver"),
           py::arg("threads"), py::keep_alive<1, 13>())
      .def("reset", &RiggedMotion::reset, py::arg("pose"), py::call_guard<py::gil_scoped_release>())
      .def("reference", &RiggedMotion::reference, py::arg("pose"), py::call_guard<py::gil_scoped_release>())
      .def(
          "step",
          [](RiggedMotion& motion, const RigPose& pose, const RigPose* next) {
            MotionFrame frame;
            {
              const py::gil_scoped_release unlocked;
              frame = motion.step(pose, next);
            }
            return as_tuple(std::move(frame));
          },
          py::arg("pose"), py::arg("next"))
      .def(
          "begin",
          [](RiggedMotion& motion, const RigPose& pose, const RigPose* next) {
            motion.begin(pose, next ? std::make_unique<RigPose>(*next) : nullptr);
          },
          py::arg("pose"), py::arg("next"))
      .def("wait", &RiggedMotion::wait, py::arg("seconds"), py::call_guard<py::gil_scoped_release>())
      .def("finish", [](RiggedMotion& motion) {
        MotionFrame frame;
        {
          const py::gil_scoped_release unlocked;
          frame = motion.finish();
        }
        return as_tuple(std::move(frame));
      });
}

}  // namespace followthrough
