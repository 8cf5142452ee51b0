// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/sparse_cholesky.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#include <Eigen/OrderingMethods>

#include "elastic/dense_front.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

// A front may have this share of zeros for being joined with its parent; a narrow one more.
constexpr double zeros_allowed = 0.05, zeros_allowed_narrow = 0.2;
constexpr Index narrow = 6;
// Pivots below this share of the diagonal are noise.
constexpr float smallest_pivot = 1e-6f;

struct Kernels {
  decltype(&baseline::eliminate) eliminate;
  decltype(&baseline::solve_lower) lower;
  decltype(&baseline::solve_upper) upper;
};

Kernels kernels() {
  return {FOLLOWTHROUGH_KERNEL(eliminate), FOLLOWTHROUGH_KERNEL(solve_lower), FOLLOWTHROUGH_KERNEL(solve_upper)};
}

int padded(int rows) { return (rows + front_lanes - 1) / front_lanes * front_lanes; }

template <typename Number>
Number* aligned(Number* from) {
  constexpr std::size_t line = 64 / sizeof(Number);
  const std::size_t place = reinterpret_cast<std::uintptr_t>(from) / sizeof(Number) % line;
  return from + (line - place) % line;
}

std::vector<Index> least_fill_order(const BlockMatrix& pattern) {
  const auto rows = static_cast<int>(pattern.row_count());
  Eigen::SparseMatrix<double> graph(rows, rows);
  std::vector<Eigen::Triplet<double>> entries;
  for (int row = 0; row < rows; ++row) {
    for (Index k = pattern.starts()[row]; k < pattern.starts()[row + 1]; ++k) entries.emplace_back(row, pattern.columns()[k], 1.0);
  }
  graph.setFromTriplets(entries.begin(), entries.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> permutation;
  Eigen::AMDOrdering<int>()(graph.selfadjointView<Eigen::Lower>(), permutation);
  return {permutation.indices().data(), permutation.indices().data() + rows};  // old row of every new one
}

// Rows below the diagonal of every column of the factor.
std::vector<std::vector<Index>> symbolic_columns(const BlockMatrix& pattern, const std::vector<Index>& order) {
  const auto rows = static_cast<Index>(order.size());
  std::vector<Index> place(order.size());
  for (Index row = 0; row < rows; ++row) place[order[row]] = row;
  std::vector<std::vector<Index>> columns(order.size()), children(order.size());
  std::vector<Index> seen(order.size(), -1);
  for (Index column = 0; column < rows; ++column) {
    std::vector<Index>& below = columns[column];
    const auto take = [&](Index row) {
      if (row <= column || seen[row] == column) return;
      seen[row] = column;
      below.push_back(row);
    };
    for (Index k = pattern.starts()[order[column]]; k < pattern.starts()[order[column] + 1]; ++k) take(place[pattern.columns()[k]]);
    for (const Index child : children[column]) {
      for (const Index row : columns[child]) take(row);
    }
    std::sort(below.begin(), below.end());
    if (!below.empty()) children[below.front()].push_back(column);
  }
  return columns;
}

// The columns renumbered so that every subtree of the elimination tree is a range.
std::vector<Index> post_order(const std::vector<std::vector<Index>>& columns) {
  const auto count = static_cast<Index>(columns.size());
  std::vector<std::vector<Index>> children(columns.size());
  std::vector<Index> stack, order;
  for (Index column = count; column-- > 0;) {
    if (columns[column].empty()) {
      stack.push_back(column);
    } else {
      children[columns[column].front()].push_back(column);
    }
  }
  while (!stack.empty()) {  // parents first, and then the other way round
    const Index column = stack.back();
    stack.pop_back();
    order.push_back(column);
    stack.insert(stack.end(), children[column].begin(), children[column].end());
  }
  std::reverse(order.begin(), order.end());
  return order;
}

}  // namespace

SparseCholesky::SparseCholesky(const BlockMatrix& pattern) : order_(least_fill_order(pattern)) {
  std::vector<std::vector<Index>> columns = symbolic_columns(pattern, order_);
  const std::vector<Index> post = post_order(columns);
  const std::size_t count = order_.size();
  std::vector<Index> renumbered(count), order(count);
  for (std::size_t k = 0; k < count; ++k) {
    renumbered[post[k]] = static_cast<Index>(k);
    order[k] = order_[post[k]];
  }
  order_ = std::move(order);
  place_.resize(count);
  for (std::size_t k = 0; k < count; ++k) place_[order_[k]] = static_cast<Index>(k);

  // Fronts: a column joins the ones before it where they then share a pattern, or nearly so.
  for (std::size_t k = 0; k < count; ++k) {
    Front front;
    front.first = static_cast<Index>(k);
    front.count = 1;
    for (const Index row : columns[post[k]]) front.rows.push_back(renumbered[row]);
    std::sort(front.rows.begin(), front.rows.end());
    while (!fronts_.empty()) {
      const Front& child = fronts_.back();
      const bool own = !child.rows.empty() && child.rows.front() >= front.first && child.rows.front() < front.first + front.count;
      if (!own || child.first + child.count != front.first) break;
      const auto area = [](double width, double below) { return width * (width + 1) / 2 + width * below; };
      const auto below = static_cast<double>(front.rows.size());
      const double joined = area(child.count + front.count, below);
      const double zeros = joined - area(child.count, static_cast<double>(child.rows.size())) - area(front.count, below);
      const bool thin = child.count <= narrow || front.count <= narrow;
      if (zeros > (thin ? zeros_allowed_narrow : zeros_allowed) * joined && zeros > 0) break;
      front.first = child.first;
      front.count += child.count;
      fronts_.pop_back();
    }
    fronts_.push_back(std::move(front));
  }
  std::vector<Index> front_of(count);
  std::size_t numbers = 0, largest = 0;
  for (std::size_t f = 0; f < fronts_.size(); ++f) {
    Front& front = fronts_[f];
    for (Index k = 0; k < front.count; ++k) front_of[front.first + k] = static_cast<Index>(f);
    front.stride = padded(front.size());
    front.factor = numbers;
    numbers += static_cast<std::size_t>(front.stride) * 3 * front.count;
    largest = std::max(largest, static_cast<std::size_t>(front.stride) * front.size());
    const double size = front.size(), below = 3.0 * static_cast<double>(front.rows.size());
    work_ += (size * size * size - below * below * below) / 6;
  }
  for (std::size_t f = 0; f < fronts_.size(); ++f) {
    if (!fronts_[f].rows.empty()) fronts_[front_of[fronts_[f].rows.front()]].children.push_back(static_cast<Index>(f));
  }
  numbers_ = numbers + 16;
  work_numbers_ = largest + 16;
  updates_.resize(fronts_.size());
  local_.resize(count);
  right_.resize(3 * count);
  int longest = 0;
  for (const Front& front : fronts_) longest = std::max(longest, front.stride);
  local_right_.resize(static_cast<std::size_t>(longest) + 16);
}

void SparseCholesky::add_matrix(const BlockMatrix& matrix, const Front& front, float* to) {
  for (Index c = 0; c < front.count; ++c) {
    const Index column = front.first + c, old = order_[column];
    for (Index k = matrix.starts()[old]; k < matrix.starts()[old + 1]; ++k) {
      const Index other = matrix.columns()[k], row = place_[other];
      if (row < column) continue;
      const BlockMatrix::Block& block = matrix.blocks()[k];  // at row `old`, column `other`: the transpose of what is wanted
      float* corner = to + static_cast<std::size_t>(3 * c) * front.stride + 3 * local_[row];
      for (int j = 0; j < 3; ++j) {
        const double scale = scale_[3 * std::size_t(old) + j];
        for (int i = 0; i < 3; ++i) {
          corner[static_cast<std::size_t>(j) * front.stride + i] +=
              static_cast<float>(scale * scale_[3 * std::size_t(other) + i] * block(j, i));
        }
      }
    }
  }
}

bool SparseCholesky::compute(const BlockMatrix& matrix) {
  const Kernels kernel = kernels();
  factor_.resize(numbers_);
  work_space_.resize(work_numbers_);
  scale_.resize(3 * order_.size());
  for (std::size_t row = 0; row < order_.size(); ++row) {
    const BlockMatrix::Block& block = matrix.blocks()[matrix.diagonal()[row]];
    for (int k = 0; k < 3; ++k) scale_[3 * row + k] = block(k, k) > 0 ? 1 / std::sqrt(block(k, k)) : 1.0;
  }
  factor_offset_ = static_cast<std::size_t>(aligned(factor_.data()) - factor_.data());
  float* const space = aligned(work_space_.data());
  for (std::size_t f = 0; f < fronts_.size(); ++f) {
    const Front& front = fronts_[f];
    const int size = front.size(), pivots = static_cast<int>(3 * front.count), stride = front.stride;
    for (int j = 0; j < size; ++j) {  // the lower half
      const int first = j / front_lanes * front_lanes;
      std::memset(space + static_cast<std::size_t>(j) * stride + first, 0, sizeof(float) * (stride - first));
    }
    for (Index c = 0; c < front.count; ++c) local_[front.first + c] = c;
    for (std::size_t k = 0; k < front.rows.size(); ++k) local_[front.rows[k]] = front.count + static_cast<Index>(k);
    add_matrix(matrix, front, space);
    for (const Index child : front.children) {
      const std::vector<Index>& rows = fronts_[child].rows;
      const float* from = updates_[child].data();
      for (std::size_t c = 0; c < rows.size(); ++c) {
        for (int j = 0; j < 3; ++j) {
          float* column = space + static_cast<std::size_t>(3 * local_[rows[c]] + j) * stride;
          for (std::size_t r = c; r < rows.size(); ++r, from += 3) {
            float* to = column + 3 * local_[rows[r]];
            to[0] += from[0];
            to[1] += from[1];
            to[2] += from[2];
          }
        }
      }
      updates_[child].clear();
    }
    if (!kernel.eliminate(space, stride, size, pivots, smallest_pivot)) return false;
    float* panel = factor_.data() + factor_offset_ + front.factor;
    for (int j = 0; j < pivots; ++j) {
      float* column = panel + static_cast<std::size_t>(j) * stride;
      const int first = j / front_lanes * front_lanes;
      std::fill(column + first, column + j, 0.0f);
      std::memcpy(column + j, space + static_cast<std::size_t>(j) * stride + j, sizeof(float) * (stride - j));
    }
    std::vector<float>& update = updates_[f];
    const std::size_t below = 3 * front.rows.size();
    update.resize(3 * front.rows.size() * (front.rows.size() + 1) / 2 * 3);
    float* to = update.data();
    for (std::size_t j = 0; j < below; ++j) {
      const std::size_t first = j / 3 * 3, length = below - first;
      std::memcpy(to, space + (pivots + j) * static_cast<std::size_t>(stride) + pivots + first, sizeof(float) * length);
      to += length;
    }
  }
  return true;
}

void SparseCholesky::apply(const Vector& r, Vector& z) const {
  const Kernels kernel = kernels();
  double largest = r.cwiseAbs().maxCoeff();
  if (!(largest > 0)) largest = 1;  // single precision has a short range
  for (std::size_t k = 0; k < order_.size(); ++k) {
    for (int i = 0; i < 3; ++i) {
      const std::size_t old = 3 * std::size_t(order_[k]) + i;
      right_[3 * k + i] = static_cast<float>(scale_[old] * (r[static_cast<Eigen::Index>(old)] / largest));
    }
  }
  float* const x = aligned(local_right_.data());
  const float* const factor = factor_.data() + factor_offset_;
  const auto gather = [&](const Front& front) {
    std::memcpy(x, right_.data() + 3 * std::size_t(front.first), sizeof(float) * 3 * front.count);
    float* to = x + 3 * front.count;
    for (const Index row : front.rows) {
      const float* from = right_.data() + 3 * std::size_t(row);
      for (int i = 0; i < 3; ++i) *to++ = from[i];
    }
    std::fill(to, x + front.stride, 0.0f);
  };
  for (const Front& front : fronts_) {
    gather(front);
    kernel.lower(factor + front.factor, front.stride, static_cast<int>(3 * front.count), x);
    std::memcpy(right_.data() + 3 * std::size_t(front.first), x, sizeof(float) * 3 * front.count);
    const float* from = x + 3 * front.count;
    for (const Index row : front.rows) {
      for (int i = 0; i < 3; ++i) right_[3 * std::size_t(row) + i] = *from++;
    }
  }
  for (std::size_t f = fronts_.size(); f-- > 0;) {
    const Front& front = fronts_[f];
    gather(front);
    kernel.upper(factor + front.factor, front.stride, static_cast<int>(3 * front.count), x);
    std::memcpy(right_.data() + 3 * std::size_t(front.first), x, sizeof(float) * 3 * front.count);
  }
  for (std::size_t k = 0; k < order_.size(); ++k) {
    for (int i = 0; i < 3; ++i) {
      const std::size_t old = 3 * std::size_t(order_[k]) + i;
      z[static_cast<Eigen::Index>(old)] = largest * scale_[old] * static_cast<double>(right_[3 * k + i]);
    }
  }
}

}  // namespace followthrough
