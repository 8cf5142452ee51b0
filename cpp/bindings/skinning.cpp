// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>

#include <utility>

#include "bindings.hpp"
#include "followthrough/skinning/inverse_skinning.hpp"
#include "followthrough/skinning/skinning.hpp"

namespace py = pybind11;

namespace followthrough {

void bind_skinning(py::module_& m) {
  const auto skinning_of = [](bool dual_quaternion) { return dual_quaternion ? Skinning::dual_quaternion : Skinning::linear; };

  m.def(
      "pose_vertices",
      [skinning_of](ConstPositions rest_positions, ConstIndexTable bone_indices, ConstValues bone_weights,
                    ConstMatrices4 bone_matrices, ConstMatrices4 bone_rest_matrices, const Eigen::Matrix4d& armature,
                    bool dual_quaternion) {
        const py::gil_scoped_release unlocked;
        return pose_vertices(rest_positions, {bone_indices, bone_weights}, {bone_matrices, bone_rest_matrices, armature},
                             skinning_of(dual_quaternion));
      },
      py::arg("rest_positions"), py::arg("bone_indices"), py::arg("bone_weights"), py::arg("bone_matrices"),
      py::arg("bone_rest_matrices"), py::arg("armature_matrix"), py::arg("dual_quaternion"),
      "Posed positions (n,3); matrices are (b,16). See followthrough.skinning.");

  m.def(
      "skinning_jacobians",
      [skinning_of](Eigen::Index vertex_count, ConstIndexTable bone_indices, ConstValues bone_weights, ConstMatrices4 bone_matrices,
                    ConstMatrices4 bone_rest_matrices, const Eigen::Matrix4d& armature, bool dual_quaternion) {
        const py::gil_scoped_release unlocked;
        return skinning_jacobians(vertex_count, {bone_indices, bone_weights}, {bone_matrices, bone_rest_matrices, armature},
                                  skinning_of(dual_quaternion));
      },
      py::arg("vertex_count"), py::arg("bone_indices"), py::arg("bone_weights"), py::arg("bone_matrices"),
      py::arg("bone_rest_matrices"), py::arg("armature_matrix"), py::arg("dual_quaternion"),
      "Derivatives (n,9). See followthrough.skinning.");

  m.def(
      "inverse_skin",
      [skinning_of](ConstIndexTable bone_indices, ConstValues bone_weights, ConstMatrices4 bone_matrices,
                    ConstMatrices4 bone_rest_matrices, const Eigen::Matrix4d& armature, ConstPositions displacements,
                    bool dual_quaternion, double minimum_stretch) {
        InverseSkinning result;
        {
          const py::gil_scoped_release unlocked;
          result = inverse_skin({bone_indices, bone_weights}, {bone_matrices, bone_rest_matrices, armature}, displacements,
                                skinning_of(dual_quaternion), minimum_stretch);
        }
        return std::make_pair(std::move(result.offsets), std::move(result.residuals));
      },
      py::arg("bone_indices"), py::arg("bone_weights"), py::arg("bone_matrices"), py::arg("bone_rest_matrices"),
      py::arg("armature_matrix"), py::arg("displacements"), py::arg("dual_quaternion"), py::arg("minimum_stretch"),
      "Offsets (n,3) and residuals (n,3). See followthrough.skinning.");

  m.def(
      "invert_displacements",
      [](ConstMatrices3 jacobians, ConstPositions displacements, double minimum_stretch) {
        InverseSkinning result;
        {
          const py::gil_scoped_release unlocked;
          result = invert_displacements(jacobians, displacements, minimum_stretch);
        }
        return std::make_pair(std::move(result.offsets), std::move(result.residuals));
      },
      py::arg("jacobians"), py::arg("displacements"), py::arg("minimum_stretch"),
      "Offsets (n,3) and residuals (n,3) of Jacobians (n,9). See followthrough.skinning.");
}

}  // namespace followthrough
