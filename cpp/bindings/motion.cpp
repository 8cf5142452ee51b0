// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <deque>
#include <memory>
#include <optional>
#include <utility>

#include "bindings.hpp"
#include "followthrough/errors.hpp"
#include "followthrough/motion/rigged_motion.hpp"

namespace py = pybind11;

namespace followthrough {
namespace {

py::tuple as_tuple(MotionFrame frame) {
  return py::make_tuple(std::move(frame.offsets), std::move(frame.displacements), frame.largest_displacement,
                        frame.largest_residual);
}

using RoundedOffsets = py::array_t<float, py::array::c_style>;

/// A motion with the arrays that its frames under way are written to.
class BoundMotion {
 public:
  BoundMotion(RiggedCharacter character, Solver& solver, int threads)
      : vertices_(character.surface_bones.rows()), motion_(std::move(character), solver, threads) {}

  RiggedMotion& motion() { return motion_; }

  void begin(const RigPose& pose, const RigPose* next, std::optional<RoundedOffsets> offsets) {
    if (offsets && (offsets->ndim() != 2 || offsets->shape(0) != vertices_ || offsets->shape(1) != 3)) {
      throw InvalidInput("offsets", "expected as many rows of three as the surface has vertices");
    }
    float* const target = offsets ? offsets->mutable_data() : nullptr;
    offsets_.push_back(std::move(offsets));
    motion_.begin(pose, next ? std::make_unique<RigPose>(*next) : nullptr, target);
  }

  py::tuple finish() {
    MotionFrame frame;
    try {
      const py::gil_scoped_release unlocked;
      frame = motion_.finish();
    } catch (...) {
      offsets_.clear();
      throw;
    }
    offsets_.pop_front();
    return as_tuple(std::move(frame));
  }

  void abandon() {
    {
      const py::gil_scoped_release unlocked;
      motion_.abandon();
    }
    offsets_.clear();
  }

 private:
  Eigen::Index vertices_;
  std::deque<std::optional<RoundedOffsets>> offsets_;
  RiggedMotion motion_;  // last: it ends before the arrays do
};

}  // namespace

void bind_motion(py::module_& m) {
  py::class_<RigPose>(m, "RigPose", "One frame of a rig.")
      .def(py::init([](ConstMatrices4 bone_matrices, const Eigen::Matrix4d& armature, const Eigen::Matrix4d& world) {
             return RigPose{bone_matrices, armature, world};
           }),
           py::arg("bone_matrices"), py::arg("armature"), py::arg("world"));

  py::class_<BoundMotion>(m, "RiggedMotion", "One character's frames. Use followthrough.secondary_motion.SecondaryMotion.")
      .def(py::init([](ConstPositions volume_rest_positions, ConstIndexTable volume_bones, ConstValues volume_weights,
                       ConstTets tets, ConstIndices embedding_tets, ConstWeights4 embedding_weights, ConstIndexTable surface_bones,
                       ConstValues surface_weights, ConstMatrices4 bone_rest_matrices, bool dual_quaternion, double minimum_stretch,
                       Solver& solver, int threads) {
             return std::make_unique<BoundMotion>(RiggedCharacter{volume_rest_positions,
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
      .def(
          "reset", [](BoundMotion& bound, const RigPose& pose) { bound.motion().reset(pose); }, py::arg("pose"),
          py::call_guard<py::gil_scoped_release>())
      .def(
          "reference", [](BoundMotion& bound, const RigPose& pose) { return bound.motion().reference(pose); }, py::arg("pose"),
          py::call_guard<py::gil_scoped_release>())
      .def(
          "step",
          [](BoundMotion& bound, const RigPose& pose, const RigPose* next) {
            MotionFrame frame;
            {
              const py::gil_scoped_release unlocked;
              frame = bound.motion().step(pose, next);
            }
            return as_tuple(std::move(frame));
          },
          py::arg("pose"), py::arg("next"))
      .def("begin", &BoundMotion::begin, py::arg("pose"), py::arg("next"), py::arg("offsets").noconvert().none(true))
      .def(
          "wait", [](BoundMotion& bound, double seconds) { return bound.motion().wait(seconds); }, py::arg("seconds"),
          py::call_guard<py::gil_scoped_release>())
      .def("finish", &BoundMotion::finish)
      .def("abandon", &BoundMotion::abandon);
}

}  // namespace followthrough
