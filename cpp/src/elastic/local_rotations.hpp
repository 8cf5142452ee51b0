// SPDX-License-Identifier: GPL-3.0-or-later
// How the neighbourhood of every vertex turns from one pose to the next.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

class LocalRotations {
 public:
  /// @param corners tets: vertices that share one are neighbours
  /// @param vertices for which rotations are wanted
  LocalRotations(const std::vector<std::array<Index, 4>>& corners, Eigen::Index vertex_count, std::vector<Index> vertices);

  /// @brief Turns values of the given vertices as their neighbourhoods turn between two poses: by the rotation that is nearest to
  ///   the least squares fit of a linear map. Where the fit is flat or mirrored, values stay as they are. In single precision,
  ///   which is a few millionths of the values; the same bits for any number of threads and every instruction set.
  /// @param from, to (n,3) poses
  /// @param values (n,3), changed in place
  void turn(ConstPositions from, ConstPositions to, Positions& values);

 private:
  std::vector<Index> vertices_;
  std::vector<std::int32_t> own_, slot_starts_, neighbours_;  // in groups: see RotationRows
  std::vector<float> from_, to_, values_;
};

}  // namespace followthrough
