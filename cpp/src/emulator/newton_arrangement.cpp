// SPDX-License-Identifier: GPL-3.0-or-later
// A body as the kernels of Newton passes take it: rows, parts, groups and slots. Nothing here runs after it has been made.
#include <Eigen/LU>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "aggregates.hpp"
#include "elastic/compact_order.hpp"
#include "emulator/newton_problem.hpp"
#include "emulator/patches.hpp"
#include "followthrough/elastic/signed_svd.hpp"
#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

constexpr double smallest_stretch = 0.1;
// Share of the cube over the longest edge below which a tet has no volume.
constexpr double smallest_volume = 1e-14;
constexpr std::int32_t part_rows = NewtonProblem::part_groups * kNewtonGroup;
// Rows from which on the matrix is kept in 16 bits a number: smaller ones fit the second-level cache as they are.
constexpr std::int32_t rounded_from = 1536;
// Rows from which on conjugate gradients have a coarse system.
constexpr std::int32_t coarse_system_from = 768;
// Rows that are sorted by their number of neighbours, so that the 16 of a group have about as many: an aggregate.
constexpr std::size_t sorting_window = aggregate_groups * kNewtonGroup;
// Rows that follow each other are compact in runs up to so many.
constexpr std::size_t longest_run = 2048;

using RowMatrix3f = Eigen::Matrix<float, 3, 3, Eigen::RowMajor>;

void raise_stretches(float* deformation_gradient) noexcept {
  Eigen::Map<RowMatrix3f> f(deformation_gradient);
  if (!f.allFinite()) return;
  const SignedSvd svd = signed_svd(f.cast<double>());
  if (svd.stretches.minCoeff() >= smallest_stretch) return;
  f = (svd.u * svd.stretches.cwiseMax(smallest_stretch).asDiagonal() * svd.v.transpose()).cast<float>();
}

void require_constants(const NewtonBody& body, Eigen::Index count) {
  require_finite("rest_positions", body.rest_positions);
  require_indices("tets", body.tets, count);
  require_rows("constrained", body.constrained.size(), count);
  const auto require_numbers = [count](const char* name, const Vector& values, bool or_zero) {
    require_rows(name, values.size(), count);
    for (Eigen::Index v = 0; v < count; ++v) {
      if (std::isfinite(values[v]) && (values[v] > 0.0 || (or_zero && values[v] == 0.0))) continue;
      throw InvalidInput(name, "found " + std::to_string(values[v]) + " at vertex " + std::to_string(v) +
                                   ", expected finite numbers, " + (or_zero ? "0 or more" : "more than 0"));
    }
  };
  require_numbers("youngs_modulus", body.youngs_modulus, false);
  require_numbers("density", body.density, false);
  if (body.pin_stiffness.size() > 0) require_numbers("pin_stiffness", body.pin_stiffness, true);
  if (!(std::isfinite(body.dt) && body.dt > 0.0)) {
    throw InvalidInput("dt", "found " + std::to_string(body.dt) + ", expected a positive number of seconds");
  }
  require_finite("gravity", body.gravity.transpose());
  if (!(std::isfinite(body.edge_length) && body.edge_length >= 0.0)) {
    throw InvalidInput("edge_length", "found " + std::to_string(body.edge_length) + ", expected a positive number of metres");
  }
  if (!(body.poisson_ratio > -1.0 && body.poisson_ratio < 0.5)) {
    throw InvalidInput("poisson_ratio",
                       "found " + std::to_string(body.poisson_ratio) + ", expected more than -1 and less than 0.5");
  }
  if (!(std::isfinite(body.compression_resistance) && body.compression_resistance >= 0.0)) {
    throw InvalidInput("compression_resistance",
                       "found " + std::to_string(body.compression_resistance) + ", expected 0 or a positive number");
  }
}

// Where a block between a row and itself or a higher one is summed up for a later part.
struct HaloBlock {
  std::int32_t row, other, place;
};

AlignedFloats floats(std::size_t count) { return AlignedFloats(count); }

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

AlignedFloats aligned(const std::vector<float>& values) {
  AlignedFloats result(values.size());
  std::copy(values.begin(), values.end(), result.data());
  return result;
}

}  // namespace

NewtonProblem::NewtonProblem(const NewtonBody& body) : count(body.rest_positions.rows()) {
  require_constants(body, count);
  arrange(body);
}

void NewtonProblem::arrange(const NewtonBody& body) {
  const Eigen::Index tet_count = body.tets.rows();
  if (tet_count == 0) throw InvalidInput("tets", "found none, expected at least one");
  // Volumes, and the edge of a cube that six tets of the median one fill.
  std::vector<double> volumes(size(tet_count));
  double total_volume = 0, total_mass = 0;
  const auto edges_of = [&](const std::array<Index, 4>& c) {
    Eigen::Matrix3d edges;
    for (int k = 0; k < 3; ++k) edges.col(k) = (body.rest_positions.row(c[k + 1]) - body.rest_positions.row(c[0])).transpose();
    return edges;
  };
  const auto mean_of = [&](const Vector& values, Eigen::Index t) {
    double sum = 0;
    for (int k = 0; k < 4; ++k) sum += values[body.tets(t, k)] / 4.0;
    return sum;
  };
  for (Eigen::Index t = 0; t < tet_count; ++t) {
    const Eigen::Matrix3d edges = edges_of({body.tets(t, 0), body.tets(t, 1), body.tets(t, 2), body.tets(t, 3)});
    double longest = edges.colwise().norm().maxCoeff();
    for (int k = 0; k < 3; ++k) longest = std::max(longest, (edges.col(k) - edges.col((k + 1) % 3)).norm());
    const double determinant = std::abs(edges.determinant());
    if (!(determinant > smallest_volume * longest * longest * longest)) {
      throw InvalidInput("rest_positions", "tet " + std::to_string(t) + " has no volume, expected every tet to fill some space");
    }
    volumes[size(t)] = determinant / 6.0;
    total_volume += volumes[size(t)];
    total_mass += volumes[size(t)] * mean_of(body.density, t);
  }
  if (body.edge_length > 0.0) {
    edge_length = body.edge_length;
  } else {
    std::vector<double> sorted = volumes;
    const auto middle = sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2);
    std::nth_element(sorted.begin(), middle, sorted.end());
    double median = *middle;
    if (sorted.size() % 2 == 0) median = 0.5 * (median + *std::max_element(sorted.begin(), middle));
    edge_length = std::cbrt(6.0 * median);
  }
  inverse_length = 1.0 / edge_length;
  const double mean_density = total_mass / total_volume;
  const double frames_per_edge = body.dt * inverse_length;
  fall = 0.5 * body.dt * frames_per_edge * body.gravity.transpose();
  stiffness = (body.youngs_modulus.array() / body.density.array() * (frames_per_edge * frames_per_edge)).matrix();

  // Rows.
  const Patches patches = find_patches(body.rest_positions, body.tets, body.constrained, 1);
  const std::vector<Index>& ring_starts = patches.rings[0].starts;
  free_count = static_cast<std::int32_t>(patches.free.size());
  std::vector<bool> is_free(patches.vertices.size(), false);
  for (const Index row : patches.free) is_free[size(row)] = true;
  std::vector<Index> compact, place_of(size(count), -1);
  for (std::int32_t i = 0; i < free_count; ++i) {
    compact.push_back(patches.vertices[size(patches.free[size(i)])]);
    place_of[size(compact.back())] = i;
  }
  order_compactly(body.rest_positions, sorting_window, longest_run, compact);
  std::vector<std::pair<std::int32_t, std::int32_t>> order;  // free neighbours, place in patches.free
  for (const Index vertex : compact) {
    const std::int32_t i = place_of[size(vertex)];
    std::int32_t free_neighbours = 0;
    for (Index e = ring_starts[size(i)]; e < ring_starts[size(i) + 1]; ++e) {
      free_neighbours += is_free[size(patches.rings[0].neighbours[size(e)])];
    }
    order.emplace_back(free_neighbours, i);
  }
  for (std::size_t first_row = 0; first_row < order.size(); first_row += sorting_window) {
    std::stable_sort(order.begin() + static_cast<std::ptrdiff_t>(first_row),
                     order.begin() + static_cast<std::ptrdiff_t>(std::min(first_row + sorting_window, order.size())),
                     [](const auto& a, const auto& b) { return a.first > b.first; });
  }
  std::vector<Index> row_of(size(count), -1);
  for (const auto& place : order) {
    vertices.push_back(patches.vertices[size(patches.free[size(place.second)])]);
    row_of[size(vertices.back())] = static_cast<Index>(vertices.size()) - 1;
  }
  free_vertices = vertices;
  for (std::size_t row = 0; row < patches.vertices.size(); ++row) {
    if (is_free[row]) continue;
    vertices.push_back(patches.vertices[row]);
    row_of[size(vertices.back())] = static_cast<Index>(vertices.size()) - 1;
  }
  row_count = static_cast<std::int32_t>(vertices.size());
  groups = (free_count + kNewtonGroup - 1) / kNewtonGroup;
  padded = groups * kNewtonGroup;
  for (Eigen::Index v = 0; v < count; ++v) {
    if (row_of[size(v)] < 0) unused.push_back(static_cast<Index>(v));
  }

  // Tets with a free corner, in the order of their lowest row.
  std::vector<RowTet> tets;
  std::vector<double> lumped(size(row_count), 0.0);
  const double nu = body.poisson_ratio;
  for (Eigen::Index t = 0; t < tet_count; ++t) {
    RowTet tet;
    bool moves = false;
    for (int k = 0; k < 4; ++k) {
      moves = moves || !body.constrained[body.tets(t, k)];
      tet.rows[size(k)] = row_of[size(body.tets(t, k))];
    }
    if (!moves) continue;
    std::sort(tet.rows.begin(), tet.rows.end());
    std::array<Index, 4> c{};
    for (std::size_t k = 0; k < 4; ++k) c[k] = vertices[size(tet.rows[k])];
    tet.gradients = (edges_of(c) * inverse_length).inverse();
    tet.volume = volumes[size(t)] * inverse_length * inverse_length * inverse_length;
    tet.mass = mean_of(body.density, t) / mean_density * tet.volume;
    const double modulus = mean_of(body.youngs_modulus, t) * frames_per_edge * frames_per_edge / mean_density;
    tet.mu = modulus / (2.0 * (1.0 + nu));
    tet.lambda = modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu));
    tet.resistance = modulus * body.compression_resistance;
    for (const std::int32_t row : tet.rows) lumped[size(row)] += tet.mass / 4.0;
    tets.push_back(tet);
  }
  std::stable_sort(tets.begin(), tets.end(), [](const RowTet& a, const RowTet& b) { return a.rows < b.rows; });
  for (std::int32_t row = 0; row < free_count; ++row) {
    if (lumped[size(row)] > 0.0) continue;
    throw InvalidInput(
        "tets", "found no volume around the free vertex " + std::to_string(vertices[size(row)]) + ", expected it to have mass");
  }
  if (body.pin_stiffness.size() > 0 && body.pin_stiffness.maxCoeff() > 0.0) {
    pins = floats(size(padded));
    ways = floats(3 * size(padded));
    const double unit = frames_per_edge * frames_per_edge * inverse_length / mean_density;  // of N/m
    for (std::int32_t row = 0; row < free_count; ++row) {
      pins.data()[row] = static_cast<float>(unit * body.pin_stiffness[vertices[size(row)]]);
    }
  }
  const std::vector<double> neighbour_masses = arrange_edges(tets);
  arrange_parts(tets);
  arrange_slots(neighbour_masses);
  arrange_coarse(neighbour_masses);

  // Numbers of the rows.
  const std::size_t vector_size = 3 * size(padded);
  masses = floats(size(padded));
  std::fill_n(masses.data(), padded, 1.0f);
  for (AlignedFloats* array : {&residual, &preconditioned, &product, &solution, &first, &saved_solution, &steps}) {
    *array = floats(vector_size);
  }
  offsets = floats(4 * size(offset_row(row_count)));
  directions = floats(4 * size(padded));
  scales = floats(4 * size(padded));
  roots = floats(vector_size);
  traces = floats(size(padded));
  const bool rounded = free_count >= rounded_from;
  if (rounded) {
    rounded_blocks.assign(slot_columns.size() * kBlock, 0);
  } else {
    blocks = floats(slot_columns.size() * kBlock);
  }
  diagonal = floats(3 * size(padded));
  inverse = floats(6 * size(padded));
  const std::size_t columns = size(padded);
  history = floats(18 * columns);
  means = floats(kNewtonRecord * columns);
  motion = floats(vector_size);
  records = floats(size(row_count) * kNewtonRecord);
  log_squares = floats(columns);
  log_diagonals = floats(columns);
  inverse_squares = floats(columns);
  lumped_masses.assign(columns, 1.0f);
  half_log_stiffness.assign(columns, 0.0f);
  fullness.assign(columns, 0.0f);
  for (std::int32_t row = 0; row < free_count; ++row) {
    const Index vertex = vertices[size(row)];
    lumped_masses[size(row)] = static_cast<float>(lumped[size(row)]);
    masses.data()[row] = static_cast<float>(0.4 * lumped[size(row)]);
    half_log_stiffness[size(row)] = static_cast<float>(0.5 * std::log(stiffness[vertex]));
    fullness[size(row)] = static_cast<float>(edge_starts[size(row) + 1] - edge_starts[size(row)]) / 14.0f - 1.0f;
  }
  find_nearness(body);
  find_islands();
  // And one to spare, which kernels read.
  for (std::vector<double>* array : {&positions, &start, &inertial, &last}) array->assign(3 * size(row_count) + 1, 0.0);
  saved.assign(3 * size(free_count), 0.0);
  lane_sums.resize(size(parts));
  part_numbers.resize(size(parts));
  now = Positions::Zero(count, 3);
  target = Positions::Zero(count, 3);

  tet_frame.corners = corners.data();
  tet_frame.gradients = gradients.data();
  tet_frame.materials = materials.data();
  tet_frame.positions = positions.data();
  tet_frame.places = places.data();
  tet_frame.sums = sums.data();
  tet_frame.energies = energies.data();
  tet_frame.raise_stretches = &raise_stretches;
  row_frame = {padded,
               row_places.data(),
               slot_starts.data(),
               slot_columns.data(),
               slot_masses.data(),
               slot_places.data(),
               slot_turned.data(),
               border_starts.data(),
               border_columns.data(),
               border_masses.data(),
               masses.data(),
               pins.data(),
               ways.data(),
               sums.data(),
               offsets.data(),
               scales.data(),
               traces.data(),
               blocks.data(),
               rounded ? rounded_blocks.data() : nullptr,
               diagonal.data(),
               inverse.data(),
               first.data(),
               residual.data(),
               preconditioned.data(),
               product.data(),
               solution.data(),
               directions.data(),
               roots.data(),
               coarse ? coarse->restricted() : nullptr,
               coarse ? coarse->corrections() : nullptr};
  for (std::int32_t v = 0; v < 6; ++v) start_vectors.push_back(history.data() + 3 * v * static_cast<std::int64_t>(padded));
  pass_vectors = {solution.data(), first.data(), preconditioned.data(), motion.data()};
  for (std::int64_t v = 0; v < 3; ++v) {
    const float* mean = means.data() + 3 * v * padded;
    start_vectors.push_back(mean);
    if (v < 2) pass_vectors.push_back(mean);
  }
  start_scalars = {log_squares.data(), nearness.data(), half_log_stiffness.data(), fullness.data()};
  pass_scalars = {log_squares.data(), log_diagonals.data(), half_log_stiffness.data(), nearness.data(), fullness.data()};
}

// Neighbours, ascending: free ones come first. Returns the mass between a row and each of them.
std::vector<double> NewtonProblem::arrange_edges(const std::vector<RowTet>& tets) {
  struct Pair {
    std::int32_t row, other;
    double mass;
  };
  std::vector<Pair> pairs;
  for (const RowTet& tet : tets) {
    for (const std::int32_t row : tet.rows) {
      for (const std::int32_t other : tet.rows) {
        if (row < free_count && row != other) pairs.push_back({row, other, tet.mass / 20.0});
      }
    }
  }
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const Pair& a, const Pair& b) { return a.row != b.row ? a.row < b.row : a.other < b.other; });
  std::vector<double> between;
  edge_starts.assign(1, 0);
  for (auto pair = pairs.begin(); pair != pairs.end();) {
    const std::int32_t row = pair->row, other = pair->other;
    double mass = 0;
    for (; pair != pairs.end() && pair->row == row && pair->other == other; ++pair) mass += pair->mass;
    edge_rows.push_back(other);
    edge_vertices.push_back(vertices[size(other)]);
    between.push_back(mass);
    if (pair == pairs.end() || pair->row != row) edge_starts.push_back(static_cast<Index>(edge_rows.size()));
  }
  return between;
}

// A row's free neighbours: the first and the last of its edges that lead to one, and the first that leads to a higher row.
NewtonProblem::FreeEdges NewtonProblem::free_edges(std::int32_t row) const {
  const auto begin = edge_rows.begin() + edge_starts[size(row)], end = edge_rows.begin() + edge_starts[size(row) + 1];
  const auto place = [&](std::int32_t other) {
    return static_cast<Index>(std::lower_bound(begin, end, other) - edge_rows.begin());
  };
  return {edge_starts[size(row)], place(row), place(free_count)};
}

// Where the block of a row and itself, or a higher one, is summed up.
std::int32_t NewtonProblem::sum_place(std::int32_t row, std::int32_t other) const {
  if (other == row) return row_places[size(row)];
  const FreeEdges edges = free_edges(row);
  const auto higher = edge_rows.begin() + edges.higher;
  const auto rank = std::lower_bound(higher, edge_rows.begin() + edges.end, other) - higher;
  return row_places[size(row)] + kBlock * (1 + static_cast<std::int32_t>(rank));
}

// Which part adds up what, and where. A part's places: one that nobody reads, its rows' own and higher blocks, its halo's.
void NewtonProblem::arrange_parts(const std::vector<RowTet>& tets) {
  parts = (groups + part_groups - 1) / part_groups;
  row_places.assign(size(padded), 0);
  part_sums.assign(1, kNewtonGroup);
  part_tets.assign(1, 0);
  std::vector<std::vector<HaloBlock>> halos(size(parts));
  std::vector<RowTet> slots;
  auto tet = tets.begin();
  for (std::int32_t part = 0; part < parts; ++part) {
    // What nobody asks for has a place for each lane, as adding to the one that was just added to would have to wait.
    const std::int32_t end_row = std::min((part + 1) * part_rows, free_count), first_nowhere = part_sums.back();
    std::int32_t next = first_nowhere + kBlock * kNewtonGroup;
    for (std::int32_t row = part * part_rows; row < end_row; ++row) {
      const FreeEdges edges = free_edges(row);
      row_places[size(row)] = next;
      next += kBlock * (1 + edges.end - edges.higher);
    }
    std::map<std::pair<std::int32_t, std::int32_t>, std::int32_t> halo;
    const auto place_of = [&](std::int32_t row, std::int32_t other, std::int32_t nowhere) {
      if (other >= free_count) return nowhere;
      if (row < end_row) return sum_place(row, other);
      const auto [found, is_new] = halo.try_emplace({row, other}, next);
      if (is_new) {
        next += kBlock;
        halos[size(row / part_rows)].push_back({row, other, found->second});
      }
      return found->second;
    };
    const auto end = std::find_if(tet, tets.end(), [&](const RowTet& t) { return t.rows[0] >= end_row; });
    const auto groups_here = static_cast<std::int32_t>((end - tet + kNewtonGroup - 1) / kNewtonGroup);
    for (std::int32_t slot = 0; slot < groups_here * kNewtonGroup; ++slot) {
      const bool real = tet + slot < end;
      const RowTet& it = slots.emplace_back(real ? tet[slot] : *(end - 1));
      if (!real) slots.back().volume = 0.0;
      const std::int32_t lane = slot % kNewtonGroup, nowhere = first_nowhere + kBlock * lane;
      if (lane == 0) places.resize(places.size() + kTetBlocks * kNewtonGroup);
      std::int32_t* place = &places[places.size() - size(kTetBlocks * kNewtonGroup - lane)];
      const auto put_next = [&](std::int32_t row, std::int32_t other) {
        *place = real ? place_of(row, other, nowhere) : nowhere;
        place += kNewtonGroup;
      };
      for (const std::int32_t row : it.rows) put_next(row, row);
      for (std::size_t a = 0; a < 4; ++a) {
        for (std::size_t b = a + 1; b < 4; ++b) put_next(it.rows[a], it.rows[b]);
      }
    }
    tet = end;
    part_tets.push_back(part_tets.back() + groups_here);
    part_sums.push_back((next + kNewtonGroup - 1) / kNewtonGroup * kNewtonGroup);
  }
  halo_starts.assign(1, 0);
  for (const std::vector<HaloBlock>& halo : halos) {
    for (const HaloBlock& block : halo) {
      halo_places.push_back(sum_place(block.row, block.other));
      halo_places.push_back(block.place);
    }
    halo_starts.push_back(static_cast<std::int32_t>(halo_places.size()));
  }
  sums = floats(size(part_sums.back()) + kNewtonGroup);
  fill_tets(slots);
}

// A group's neighbours, as many for each of its rows.
void NewtonProblem::arrange_slots(const std::vector<double>& neighbour_masses) {
  std::vector<float> slot_mass, turned, border_mass;
  slot_starts.assign(1, 0);
  border_starts.assign(1, 0);
  for (std::int32_t group = 0; group < groups; ++group) {
    const std::int32_t first_row = group * kNewtonGroup, end_row = std::min(first_row + kNewtonGroup, free_count);
    Index free_width = 0, border_width = 0;
    for (std::int32_t row = first_row; row < end_row; ++row) {
      const FreeEdges edges = free_edges(row);
      free_width = std::max(free_width, edges.end - edges.begin);
      border_width = std::max(border_width, edge_starts[size(row) + 1] - edges.end);
    }
    for (Index s = 0; s < free_width; ++s) {
      for (std::int32_t row = first_row; row < first_row + kNewtonGroup; ++row) {
        const Index edge = row < end_row ? edge_starts[size(row)] + s : 0;
        const bool there = row < end_row && edge < free_edges(row).end;
        const std::int32_t other = there ? edge_rows[size(edge)] : row;
        slot_columns.push_back(4 * other);
        slot_mass.push_back(there ? static_cast<float>(neighbour_masses[size(edge)]) : 0.0f);
        slot_places.push_back(there ? sum_place(std::min(row, other), std::max(row, other)) : 0);
        turned.push_back(other < row ? 1.0f : 0.0f);
      }
    }
    for (Index s = 0; s < border_width; ++s) {
      for (std::int32_t row = first_row; row < first_row + kNewtonGroup; ++row) {
        const Index edge = row < end_row ? free_edges(row).end + s : 0;
        const bool there = row < end_row && edge < edge_starts[size(row) + 1];
        border_columns.push_back(there ? 4 * offset_row(edge_rows[size(edge)]) : 0);
        border_mass.push_back(there ? static_cast<float>(neighbour_masses[size(edge)]) : 0.0f);
      }
    }
    slot_starts.push_back(static_cast<std::int32_t>(slot_columns.size() / kNewtonGroup));
    border_starts.push_back(static_cast<std::int32_t>(border_columns.size() / kNewtonGroup));
  }
  slot_masses = aligned(slot_mass);
  slot_turned = aligned(turned);
  border_masses = aligned(border_mass);
}

// Every free pair of neighbours, and what is on the diagonal.
void NewtonProblem::arrange_coarse(const std::vector<double>& neighbour_masses) {
  if (free_count < coarse_system_from) return;
  std::vector<CoarseEntry> entries;
  std::vector<bool> held(size(free_count), false);
  for (std::int32_t row = 0; row < free_count; ++row) {
    const FreeEdges edges = free_edges(row);
    held[size(row)] = edges.end < edge_starts[size(row) + 1];
    // Of a tet each corner has a tenth of the mass on the diagonal, twice what it has with each of the others.
    double own = 0;
    for (Index edge = edge_starts[size(row)]; edge < edge_starts[size(row) + 1]; ++edge) own += neighbour_masses[size(edge)];
    const double pin = pins.data() ? static_cast<double>(pins.data()[row]) : 0.0;
    entries.push_back({row, row, row_places[size(row)], 2.0 / 3.0 * own + pin});
    for (Index edge = edges.higher; edge < edges.end; ++edge) {
      const std::int32_t other = edge_rows[size(edge)];
      entries.push_back({row, other, sum_place(row, other), neighbour_masses[size(edge)]});
    }
  }
  coarse.emplace(free_count, part_groups, held, entries);
}

// The tets' numbers, as the groups have them.
void NewtonProblem::fill_tets(const std::vector<RowTet>& slots) {
  corners.assign(4 * slots.size(), 0);
  gradients = floats(9 * slots.size());
  materials = floats(4 * slots.size());
  energies = floats(slots.size());
  for (std::size_t slot = 0; slot < slots.size(); ++slot) {
    const RowTet& tet = slots[slot];
    const std::size_t group = slot / kNewtonGroup, lane = slot % kNewtonGroup;
    for (std::size_t k = 0; k < 4; ++k) corners[(group * 4 + k) * kNewtonGroup + lane] = tet.rows[k];
    for (int k = 0; k < 9; ++k) {
      gradients.data()[(group * 9 + size(k)) * kNewtonGroup + lane] = static_cast<float>(tet.gradients(k / 3, k % 3));
    }
    const double constants[] = {tet.volume, tet.mu, tet.lambda, tet.resistance};
    for (std::size_t k = 0; k < 4; ++k) materials.data()[(group * 4 + k) * kNewtonGroup + lane] = static_cast<float>(constants[k]);
  }
}

// One over one more than the number of tets between each free row's vertex and the nearest constrained one, 20 at most.
void NewtonProblem::find_nearness(const NewtonBody& body) {
  constexpr int farthest = 20;
  std::vector<int> hops(size(count), farthest);
  for (Eigen::Index v = 0; v < count; ++v) {
    if (body.constrained[v]) hops[size(v)] = 0;
  }
  for (int hop = 1; hop < farthest; ++hop) {
    bool farther = false;
    for (Eigen::Index t = 0; t < body.tets.rows(); ++t) {
      bool touches = false;
      for (int k = 0; k < 4; ++k) touches = touches || hops[size(body.tets(t, k))] == hop - 1;
      if (!touches) continue;
      for (int k = 0; k < 4; ++k) {
        int& mine = hops[size(body.tets(t, k))];
        if (mine > hop) {
          mine = hop;
          farther = true;
        }
      }
    }
    if (!farther) break;
  }
  nearness.assign(size(padded), 0.0f);
  for (std::int32_t row = 0; row < free_count; ++row) {
    nearness[size(row)] = 1.0f / static_cast<float>(1 + hops[size(vertices[size(row)])]);
  }
}

// Numbers the parts of the graph of free rows.
void NewtonProblem::find_islands() {
  islands.assign(size(free_count), SIZE_MAX);
  std::vector<std::int32_t> waiting;
  for (std::int32_t first_row = 0; first_row < free_count; ++first_row) {
    if (islands[size(first_row)] != SIZE_MAX) continue;
    islands[size(first_row)] = island_count;
    waiting.push_back(first_row);
    while (!waiting.empty()) {
      const std::int32_t row = waiting.back();
      waiting.pop_back();
      for (Index edge = edge_starts[size(row)]; edge < edge_starts[size(row) + 1]; ++edge) {
        const Index other = edge_rows[size(edge)];
        if (other >= free_count || islands[size(other)] != SIZE_MAX) continue;
        islands[size(other)] = island_count;
        waiting.push_back(other);
      }
    }
    ++island_count;
  }
}

}  // namespace followthrough
