// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Plain array types that every topic shares. Rows are items (vertices, tets, bones), stored row by row as NumPy does, so that
/// arrays cross the language border without a copy.
#pragma once

#include <cstdint>

#include <Eigen/Core>

namespace followthrough {

using Index = std::int32_t;

using Positions = Eigen::Matrix<double, Eigen::Dynamic, 3, Eigen::RowMajor>;               ///< (n,3), metres
using Values = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;     ///< (n,k)
using Weights4 = Eigen::Matrix<double, Eigen::Dynamic, 4, Eigen::RowMajor>;                ///< (n,4), barycentric
using Triangles = Eigen::Matrix<Index, Eigen::Dynamic, 3, Eigen::RowMajor>;                ///< (t,3)
using Tets = Eigen::Matrix<Index, Eigen::Dynamic, 4, Eigen::RowMajor>;                     ///< (m,4)
using Indices = Eigen::Matrix<Index, Eigen::Dynamic, 1>;                                   ///< (n,)
using IndexTable = Eigen::Matrix<Index, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;  ///< (n,k)
using Vector = Eigen::VectorXd;                                                            ///< (n,)
using Mask = Eigen::Matrix<bool, Eigen::Dynamic, 1>;                                       ///< (n,)
using Matrices3 = Eigen::Matrix<double, Eigen::Dynamic, 9, Eigen::RowMajor>;               ///< (n,9): 3x3 matrices, row by row
using Matrices4 = Eigen::Matrix<double, Eigen::Dynamic, 16, Eigen::RowMajor>;              ///< (b,16): 4x4 matrices, row by row

using ConstPositions = Eigen::Ref<const Positions>;
using ConstValues = Eigen::Ref<const Values>;
using ConstWeights4 = Eigen::Ref<const Weights4>;
using ConstTriangles = Eigen::Ref<const Triangles>;
using ConstTets = Eigen::Ref<const Tets>;
using ConstIndices = Eigen::Ref<const Indices>;
using ConstIndexTable = Eigen::Ref<const IndexTable>;
using ConstVector = Eigen::Ref<const Vector>;
using ConstMask = Eigen::Ref<const Mask>;
using ConstMatrices3 = Eigen::Ref<const Matrices3>;
using ConstMatrices4 = Eigen::Ref<const Matrices4>;

}  // namespace followthrough
