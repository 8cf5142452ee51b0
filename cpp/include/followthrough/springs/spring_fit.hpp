// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Learning the springs' constants from simulated motion ([ZS] section 6): the ks and kd of every vertex whose spring comes closest
/// to where the simulation put it.
///
/// Each vertex is a problem of its own in two unknowns, log ks and log kd, and its answer does not depend on other vertices or on
/// the number of threads. A few generations of a genetic algorithm find where to start; Gauss-Newton steps with Levenberg's and
/// Marquardt's damping, on exact derivatives through the whole recursion (eqs. 15 to 20), find the minimum.
#pragma once

#include <cstdint>
#include <span>

#include "followthrough/types.hpp"

namespace followthrough {

/// A simulated motion to learn from. The springs start on the first frame's reference, moving with it, as Springs::reset does.
struct SpringTraining {
  ConstValues reference;  ///< (F, 3 n) what the springs hang on, m: a frame a row, three numbers a vertex
  ConstValues dynamic;    ///< (F, 3 n) where the simulation put them, m
  double dt;              ///< s a frame, more than 0
};

struct SpringFitSettings {
  /// How strongly motion that springs cannot describe holds them back. Where the best constants leave a share e of the simulated
  /// motion unexplained (loss over loss without springs), r = regularization * e times the springs' own motion is added to the
  /// loss: the minimum is that of a fit to 1 / (1 + r) of the motion, the same shape, smaller ([ZS] section 7, figure 3); and a
  /// weak pull to the usual constants, unless that would be worse than no springs. Motion that springs describe exactly is found
  /// exactly. 0: none.
  double regularization = 1.0;
  /// Share of every vertex's frames, those of the greatest error, that is left out of a second fit ([ZS] figure 7). 0: none.
  double dropped_share = 0.0;
  std::uint64_t seed = 0;  ///< of the genetic algorithm
  int population = 24;     ///< 4 or more
  int generations = 4;     ///< of the genetic algorithm, 1 or more
};

/// What is known about a vertex's constants.
enum class SpringFitStatus : std::uint8_t {
  fitted = 0,
  unmoved = 1,  ///< its reference never accelerates, so its motion says nothing of the constants; they are the usual ones
  rigid = 2,    ///< it never leaves its reference: as stiff as can be told apart, critically damped
  skipped = 3,  ///< not asked for; the usual constants
};

struct SpringFit {
  Vector stiffness;  ///< (m,) ks, 1/s^2
  Vector damping;    ///< (m,) kd, 1/s
  Vector loss;       ///< (m,) sum over all frames of the squared distance to the simulation, m^2: [ZS] eq. 14, nothing left out
  Vector reference_loss;  ///< (m,) the same without springs
  Indices status;         ///< (m,) SpringFitStatus
};

/// Constants of a vertex that nothing is known about: those of Springs that nobody has set.
inline constexpr double usual_stiffness = 1000.0;            ///< 1/s^2
inline constexpr double usual_damping = 15.811388300841896;  ///< 1/s, a quarter of critical damping

/// @brief Fits the springs of vertices [first, first + count).
/// @param motions one or more, of the same n vertices; their losses are added
/// @param skipped (n,) vertices that are left out, or empty: none
/// @param first, count which vertices; m = count
/// @throws InvalidInput where there are no motions, one has fewer than two frames, shapes do not fit, positions are not finite
/// (naming
///   motion, frame and vertex), or a setting is out of its range
SpringFit fit_springs(std::span<const SpringTraining> motions, ConstMask skipped, Eigen::Index first, Eigen::Index count,
                      const SpringFitSettings& settings = {});

/// Loss ([ZS] eq. 14) of given constants, without regularization, and its derivatives.
struct SpringLoss {
  Vector loss;          ///< (n,) m^2
  Vector by_stiffness;  ///< (n,) d/d log ks
  Vector by_damping;    ///< (n,) d/d log kd
};

/// @brief The loss of every vertex.
/// @param motions as for fit_springs
/// @param stiffness, damping (n,) ks and kd, 0 or more
/// @throws InvalidInput as fit_springs does
SpringLoss spring_loss(std::span<const SpringTraining> motions, ConstVector stiffness, ConstVector damping);

}  // namespace followthrough
