// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Singular value decomposition of 3x3 matrices with proper rotations on both sides, so that an inverted element shows as a
/// negative stretch [Irving, Teran, Fedkiw 2004: Invertible finite elements].
#pragma once

#include <Eigen/Core>

namespace followthrough {

/// matrix = u * diag(stretches) * v^T.
struct SignedSvd {
  Eigen::Matrix3d u;          ///< rotation (determinant +1)
  Eigen::Vector3d stretches;  ///< descending by magnitude; only the last one, the smallest, may be negative
  Eigen::Matrix3d v;          ///< rotation (determinant +1)
};

/// @brief Decomposes by one-sided Jacobi rotations: small stretches beside large ones keep their digits, and flat, collapsed and
///   zero matrices (u = v = identity) are as good as any other.
/// @param matrix finite entries
SignedSvd signed_svd(const Eigen::Matrix3d& matrix);

}  // namespace followthrough
