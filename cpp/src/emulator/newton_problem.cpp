// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/newton_problem.hpp"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numeric>

#include "aggregates.hpp"
#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

// Frames that one thread does after threads have been in each other's way: twice as many each time, until they are not.
constexpr int fewest_frames_alone = 64, most_frames_alone = 512;
// Of the work of a pass that is worth a thread, nanoseconds.
constexpr double least_share = 30'000;

struct Kernels {
  decltype(&baseline::add_tets) add_tets;
  decltype(&baseline::add_blocks) add_blocks;
  decltype(&baseline::assemble_rows) assemble_rows;
  decltype(&baseline::assemble_blocks) assemble_blocks;
  decltype(&baseline::restrict_rows) restrict_rows;
  decltype(&baseline::multiply_rows) multiply_rows;
  decltype(&baseline::advance_rows) advance_rows;
  decltype(&baseline::turn_rows) turn_rows;
  decltype(&baseline::unscale_rows) unscale_rows;
  decltype(&baseline::neighbour_means) neighbour_means;
};

Kernels kernels() {
  return {FOLLOWTHROUGH_KERNEL(add_tets),        FOLLOWTHROUGH_KERNEL(add_blocks),    FOLLOWTHROUGH_KERNEL(assemble_rows),
          FOLLOWTHROUGH_KERNEL(assemble_blocks), FOLLOWTHROUGH_KERNEL(restrict_rows), FOLLOWTHROUGH_KERNEL(multiply_rows),
          FOLLOWTHROUGH_KERNEL(advance_rows),    FOLLOWTHROUGH_KERNEL(turn_rows),     FOLLOWTHROUGH_KERNEL(unscale_rows),
          FOLLOWTHROUGH_KERNEL(neighbour_means)};
}

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

}  // namespace

double NewtonProblem::sum(int which) const {
  double lanes[kNewtonGroup] = {}, total = 0;
  for (const LaneSums& part : lane_sums) {
    for (int lane = 0; lane < kNewtonGroup; ++lane) lanes[lane] += static_cast<double>(part.sums[which][lane]);
  }
  for (const double lane : lanes) total += lane;
  return total;
}

// As many as are worthwhile, but one where more are in each other's way. Results are the same.
int NewtonProblem::threads(double nanoseconds_a_row) const {
  return frames_alone > 0 || barrier.crowded() ? 1 : worthwhile_threads(padded, nanoseconds_a_row, least_share);
}

void NewtonProblem::begin(const NewtonHistory& h) {
  if (barrier.crowded()) {
    frames_alone = next_frames_alone;
    next_frames_alone = std::min(2 * next_frames_alone, most_frames_alone);
  } else if (frames_alone > 0) {
    --frames_alone;
  } else {
    next_frames_alone = fewest_frames_alone;
  }
  barrier.forget();
#pragma omp parallel for schedule(static) num_threads(threads(30.0))
  for (std::int32_t row = 0; row < row_count; ++row) {
    const Index v = vertices[size(row)];
    const bool moves = row < free_count;
    float* record = records.data() + std::int64_t{row} * kNewtonRecord;
    for (int k = 0; k < 3; ++k) {
      // Frame t + n as it is seen from a frame of reference that falls.
      const auto seen = [&, k](const ConstPositions& where, double n) { return where(v, k) * inverse_length - n * n * fall[k]; };
      const double u0 = seen(h.dynamic[0], 0), u1 = seen(h.dynamic[1], -1), u2 = seen(h.dynamic[2], -2),
                   u3 = seen(h.dynamic[3], -3);
      const double x1 = seen(h.reference[0], 1), x0 = seen(h.reference[1], 0), before = seen(h.reference[2], -1),
                   before_that = seen(h.reference[3], -2);
      const double ahead = u0 + (u0 - u1), acceleration = (u0 - u1) - (u1 - u2);
      const std::size_t place = 3 * size(row) + size(k);
      inertial[place] = ahead;
      last[place] = u0;
      positions[place] = start[place] = moves ? ahead : x1;
      record[k] = static_cast<float>(moves ? (x1 - x0) - (u0 - u1) : x1 - ahead);
      record[3 + k] = static_cast<float>(acceleration);
      record[6 + k] = static_cast<float>(u0 - x0);
      offsets.data()[4 * offset_row(row) + k] = static_cast<float>(positions[place] - ahead);
      if (!moves) continue;
      float* to = history.data() + std::int64_t{k} * padded + row;
      const std::int64_t next = 3 * std::int64_t{padded};
      for (int c = 0; c < 3; ++c) to[c * next] = record[3 * c + k];
      to[3 * next] = static_cast<float>((x1 - x0) - (x0 - before));
      to[4 * next] = static_cast<float>(acceleration - ((u1 - u2) - (u2 - u3)));
      to[5 * next] = static_cast<float>((x0 - before) - (before - before_that));
      if (pins.data()) ways.data()[std::int64_t{k} * padded + row] = static_cast<float>(x1 - ahead);
    }
  }
  std::fill_n(motion.data(), 3 * size(padded), 0.0f);
  now = h.dynamic[0];
  target = h.reference[0];
  began = true;
  evaluated = false;
}

double NewtonProblem::assemble(Tangent tangent) {
  const double left = assemble_as(tangent);
  return tangent == Tangent::exact && indefinite() ? assemble_as(Tangent::convex) : left;
}

// Whether a diagonal block is known not to be positive definite.
bool NewtonProblem::indefinite() const { return !(sum(3) == 0.0); }

double NewtonProblem::assemble_as(Tangent tangent) {
  const Kernels kernel = kernels();
  tet_frame.exact = tangent == Tangent::exact;
#pragma omp parallel num_threads(threads(150.0))
  {
    const TeamShare share(parts);
    for (std::int32_t part = share.first; part < share.last; ++part) {
      std::fill(sums.data() + part_sums[size(part)], sums.data() + part_sums[size(part) + 1], 0.0f);
      kernel.add_tets(tet_frame, part_tets[size(part)], part_tets[size(part) + 1]);
    }
    barrier.wait();
    for (std::int32_t part = share.first; part < share.last; ++part) {
      const std::int32_t halo = halo_starts[size(part)];
      kernel.add_blocks(halo_places.data() + halo, (halo_starts[size(part) + 1] - halo) / 2, sums.data(), sums.data());
      kernel.assemble_rows(row_frame, part * part_groups, last_group(part), &lane_sums[size(part)]);
      double& elastic = part_numbers[size(part)] = 0.0;
      for (std::int32_t tet = part_tets[size(part)] * kNewtonGroup; tet < part_tets[size(part) + 1] * kNewtonGroup; ++tet) {
        elastic += static_cast<double>(energies.data()[tet]);
      }
    }
  }
  for (std::int64_t axis = 0; axis < 3; ++axis) {  // rows to spare move with no aggregate
    std::fill(roots.data() + axis * padded + free_count, roots.data() + (axis + 1) * padded, 0.0f);
  }
  residual_square = sum(0);
  energy = std::accumulate(part_numbers.begin(), part_numbers.end(), sum(2));
  evaluated = true;
  return free_count ? std::sqrt(sum(1) / (3.0 * free_count)) : 0.0;
}

// The coarse system of the tets' sums, and its share of the first direction. By all threads.
void NewtonProblem::make_coarse(std::int32_t first_part, std::int32_t last_part) {
  const Kernels kernel = kernels();
  for (std::int32_t part = first_part; part < last_part; ++part) {
    coarse->add_part(part, sums.data());
    kernel.restrict_rows(row_frame, part * part_groups, last_group(part));
  }
  barrier.wait();
  if (omp_get_thread_num() == 0) coarse->compute();
  barrier.wait();
}

// The coarse system's share of the preconditioned residual. By all threads.
// @return what it has of the product with the residual
double NewtonProblem::correct(std::int32_t first_part, std::int32_t last_part) {
  for (std::int32_t part = first_part; part < last_part; ++part) coarse->correct_part(part);
  barrier.wait();
  if (omp_get_thread_num() == 0) coarse->solve_nodes();
  barrier.wait();
  for (std::int32_t part = first_part; part < last_part; ++part) coarse->add_nodes(part);
  return coarse->slope();
}

// Every thread adds up the same sums and so goes the same way. The two that an iteration needs have places of their own, as one
// thread may still be reading the first when another comes to the second, and so has what is summed up after the last one.
void NewtonProblem::solve(int most, double tolerance) {
  if (solve_as_assembled(most, tolerance) || !tet_frame.exact) return;
  assemble_as(Tangent::convex);
  solve_as_assembled(most, tolerance);
}

// False where the tangent turned out not to be positive definite: the solution is then the last one before that showed.
bool NewtonProblem::solve_as_assembled(int most, double tolerance) {
  const Kernels kernel = kernels();
  bool definite = true;
#pragma omp parallel num_threads(threads(10.0 * most))
  {
    const TeamShare share(parts);
    const std::int32_t first_group = share.first * part_groups, end_group = last_group(share.last - 1);
    double square = residual_square, decrease = 0;
    kernel.assemble_blocks(row_frame, first_group, end_group);
    if (coarse && most > 0) {
      make_coarse(share.first, share.last);
      square += correct(share.first, share.last);
      kernel.turn_rows(row_frame, 0.0f, first_group, end_group);
    }
    const double enough = tolerance * tolerance * square;
    int taken = 0;
    for (; taken < most && square > enough && square > 0.0; ++taken) {
      barrier.wait();
      for (std::int32_t part = share.first; part < share.last; ++part) {
        kernel.multiply_rows(row_frame, part * part_groups, last_group(part), &lane_sums[size(part)]);
      }
      barrier.wait();
      const double curvature = sum(0);
      if (!(curvature > 0.0)) {
        if (omp_get_thread_num() == 0) definite = false;
        if (taken > 0) break;
        decrease = residual_square;
        for (std::int64_t axis = 0; axis < 3 && first_group < end_group; ++axis) {
          const std::int64_t first_row = axis * padded + first_group * kNewtonGroup;
          std::copy_n(preconditioned.data() + first_row, (end_group - first_group) * kNewtonGroup, solution.data() + first_row);
        }
        break;
      }
      const auto length = static_cast<float>(square / curvature);
      decrease += square / curvature * square;
      for (std::int32_t part = share.first; part < share.last; ++part) {
        kernel.advance_rows(row_frame, length, part * part_groups, last_group(part), &lane_sums[size(part)]);
      }
      double next = coarse ? correct(share.first, share.last) : 0.0;
      if (!coarse) barrier.wait();
      next += sum(1);
      kernel.turn_rows(row_frame, static_cast<float>(next / square), first_group, end_group);
      square = next;
    }
    for (std::int32_t part = share.first; part < share.last; ++part) {
      kernel.unscale_rows(row_frame, part * part_groups, last_group(part), &lane_sums[size(part)]);
    }
    if (omp_get_thread_num() == 0) {
      slope = -decrease;
      iterations = taken;
    }
  }
  return definite;
}

double NewtonProblem::direction_length() const { return free_count ? std::sqrt(sum(2) / (3.0 * free_count)) : 0.0; }

// Constrained rows come after the padding.
std::int32_t NewtonProblem::offset_row(std::int32_t row) const { return row < free_count ? row : row + padded - free_count; }

std::int32_t NewtonProblem::last_group(std::int32_t part) const { return std::min((part + 1) * part_groups, groups); }

GuideInputs NewtonProblem::inputs_of(const std::vector<const float*>& vectors, const std::vector<const float*>& scalars) const {
  return {padded,
          static_cast<std::int32_t>(vectors.size()),
          vectors.data(),
          inverse_squares.data(),
          static_cast<std::int32_t>(scalars.size()),
          scalars.data(),
          steps.data()};
}

GuideInputs NewtonProblem::start_inputs() const { return inputs_of(start_vectors, start_scalars); }

GuideInputs NewtonProblem::pass_inputs() const { return inputs_of(pass_vectors, pass_scalars); }

void NewtonProblem::record(std::int32_t row) {
  const float* averaged[] = {solution.data(), preconditioned.data()};
  float* to = records.data() + std::int64_t{row} * kNewtonRecord;
  for (int c = 0; c < 6; ++c) {
    to[c] = row < free_count ? averaged[c / 3][(c % 3) * std::int64_t{padded} + row] : 0.0f;
  }
  if (row < free_count) log_diagonals.data()[row] = 0.5f * std::log(traces.data()[row] / 3.0f / lumped_masses[size(row)]);
}

// Means, the sum of squares, and its logarithm.
void NewtonProblem::describe(const GuideInputs& inputs, std::int32_t group) {
  kernels().neighbour_means(records.data(), edge_starts.data(), edge_rows.data(), free_count, padded, group, group + 1,
                            means.data());
  const std::int32_t end_row = std::min((group + 1) * kNewtonGroup, free_count);
  for (std::int32_t row = group * kNewtonGroup; row < end_row; ++row) {
    float square = 1e-18f;
    for (std::int32_t v = 0; v < inputs.vector_count; ++v) {
      for (int k = 0; k < 3; ++k) {
        const float value = inputs.vectors[v][std::int64_t{k} * padded + row];
        square += value * value;
      }
    }
    inverse_squares.data()[row] = 1.0f / square;
    log_squares.data()[row] = 0.125f * std::clamp(std::log(square), -24.0f, 6.0f) + 0.75f;
  }
}

GuideInputs NewtonProblem::describe_start() {
  const GuideInputs inputs = start_inputs();
  for (std::int32_t group = 0; group < groups; ++group) describe(inputs, group);
  return inputs;
}

GuideInputs NewtonProblem::describe_pass() {
  const GuideInputs inputs = pass_inputs();
  for (std::int32_t row = 0; row < row_count; ++row) record(row);
  for (std::int32_t group = 0; group < groups; ++group) describe(inputs, group);
  return inputs;
}

void NewtonProblem::move_group(const float* step, std::int32_t group) {
  const std::int32_t end_row = std::min((group + 1) * kNewtonGroup, free_count);
  for (std::int32_t row = group * kNewtonGroup; row < end_row; ++row) {
    for (int k = 0; k < 3; ++k) {
      const std::size_t place = 3 * size(row) + size(k);
      positions[place] += static_cast<double>(step[std::int64_t{k} * padded + row]);
      offsets.data()[4 * offset_row(row) + k] = static_cast<float>(positions[place] - inertial[place]);
    }
  }
}

void NewtonProblem::have_moved(const float* step, bool of_pass) {
  if (of_pass) {
    std::copy_n(step, 3 * size(padded), motion.data());
  } else if (finite()) {
    start = positions;
  }
}

void NewtonProblem::move(const float* step, bool of_pass) {
#pragma omp parallel for schedule(static) num_threads(threads(15.0))
  for (std::int32_t group = 0; group < groups; ++group) move_group(step, group);
  have_moved(step, of_pass);
}

void NewtonProblem::move_along_direction() { move(solution.data(), true); }

void NewtonProblem::save() {
  std::copy_n(positions.begin(), saved.size(), saved.begin());
  std::copy_n(solution.data(), 3 * size(padded), saved_solution.data());
}

void NewtonProblem::go_back_and_move(double share) {
  std::copy_n(saved.begin(), saved.size(), positions.begin());
  for (std::size_t k = 0; k < 3 * size(padded); ++k) solution.data()[k] = static_cast<float>(share) * saved_solution.data()[k];
  move_along_direction();
}

double NewtonProblem::slope_along_saved() const {
  double sum = 0;
  for (std::int64_t row = 0; row < free_count; ++row) {
    for (std::int64_t k = 0; k < 3; ++k) {
      const std::int64_t place = k * padded + row;
      sum -= static_cast<double>(residual.data()[place]) / scales.data()[4 * row + k] * saved_solution.data()[place];
    }
  }
  return sum;
}

// As it is seen from a frame of reference that falls.
Eigen::RowVector3d NewtonProblem::in_edges(ConstPositions there, std::int32_t row) const {
  return there.row(vertices[size(row)]) * inverse_length - fall;
}

void NewtonProblem::put(std::int32_t row, const Eigen::RowVector3d& there) {
  for (int k = 0; k < 3; ++k) {
    const std::size_t place = 3 * size(row) + size(k);
    positions[place] = there[k];
    offsets.data()[4 * offset_row(row) + k] = static_cast<float>(positions[place] - inertial[place]);
  }
}

void NewtonProblem::go_to(ConstPositions there) {
  std::fill_n(motion.data(), 3 * size(padded), 0.0f);
  for (std::int32_t row = 0; row < free_count; ++row) put(row, in_edges(there, row));
}

void NewtonProblem::go_to_reference(const std::vector<bool>& chosen) {
  std::fill_n(motion.data(), 3 * size(padded), 0.0f);
  for (std::int32_t row = 0; row < free_count; ++row) {
    if (chosen[islands[size(row)]]) put(row, in_edges(target, row));
  }
}

double NewtonProblem::lumped_inertia(std::int32_t row, const Eigen::RowVector3d& there) const {
  double sum = 0;
  for (int k = 0; k < 3; ++k) {
    const double away = there[k] - inertial[3 * size(row) + size(k)];
    sum += 0.5 * static_cast<double>(lumped_masses[size(row)]) * away * away;
  }
  return sum;
}

std::vector<double> NewtonProblem::island_energies() const {
  if (island_count == 1) return {energy};
  std::vector<double> sums_of(island_count, 0.0);
  for (std::int32_t row = 0; row < free_count; ++row) {
    const Eigen::RowVector3d there = Eigen::RowVector3d::Map(positions.data() + 3 * size(row));
    double& sum = sums_of[islands[size(row)]] += lumped_inertia(row, there);
    if (pins.data()) sum += 0.5 * static_cast<double>(pins.data()[row]) * (there - in_edges(target, row)).squaredNorm();
  }
  for (std::int32_t group = 0; group < part_tets.back(); ++group) {
    for (std::int32_t lane = 0; lane < kNewtonGroup; ++lane) {
      // Its first row is a free one.
      const std::int32_t row = corners[size(4 * group * kNewtonGroup + lane)];
      sums_of[islands[size(row)]] += static_cast<double>(energies.data()[group * kNewtonGroup + lane]);
    }
  }
  return sums_of;
}

std::vector<double> NewtonProblem::island_inertia_at_reference() const {
  std::vector<double> sums_of(island_count, 0.0);
  for (std::int32_t row = 0; row < free_count; ++row) {
    sums_of[islands[size(row)]] += lumped_inertia(row, in_edges(target, row));
  }
  return sums_of;
}

bool NewtonProblem::finite() const {
  for (const double value : positions) {
    if (!std::isfinite(value)) return false;
  }
  return true;
}

void NewtonProblem::start_over() { positions = start; }

void NewtonProblem::write_estimate(Positions& out) const {
  for (std::int32_t row = 0; row < free_count; ++row) {
    const Index v = vertices[size(row)];
    // From u(t) on: what does not move keeps its digits.
    for (int k = 0; k < 3; ++k) {
      const std::size_t place = 3 * size(row) + size(k);
      out(v, k) = now(v, k) + (positions[place] - last[place] + fall[k]) * edge_length;
    }
  }
  for (std::int32_t row = free_count; row < row_count; ++row) out.row(vertices[size(row)]) = target.row(vertices[size(row)]);
  for (const Index v : unused) out.row(v) = target.row(v);
}

}  // namespace followthrough
