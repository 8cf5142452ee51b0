// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/patches.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <utility>

namespace followthrough {
namespace {

// Adjacency of the vertices in one flat array, ascending in every row.
struct Graph {
  std::vector<std::size_t> starts;
  std::vector<Index> neighbours;
};

Graph edges_of(ConstTets tets, Eigen::Index count) {
  Graph graph;
  graph.starts.assign(static_cast<std::size_t>(count) + 1, 0);
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    for (int a = 0; a < 4; ++a) graph.starts[static_cast<std::size_t>(tets(t, a)) + 1] += 3;
  }
  for (std::size_t v = 0; v < static_cast<std::size_t>(count); ++v) graph.starts[v + 1] += graph.starts[v];
  graph.neighbours.resize(graph.starts.back());
  std::vector<std::size_t> end(graph.starts.begin(), graph.starts.end() - 1);
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        if (a != b) graph.neighbours[end[static_cast<std::size_t>(tets(t, a))]++] = tets(t, b);
      }
    }
  }
  std::size_t kept = 0;
  for (std::size_t v = 0; v < static_cast<std::size_t>(count); ++v) {
    const auto first = graph.neighbours.begin() + static_cast<std::ptrdiff_t>(graph.starts[v]);
    const auto last = graph.neighbours.begin() + static_cast<std::ptrdiff_t>(graph.starts[v + 1]);
    std::sort(first, last);
    graph.starts[v] = kept;
    for (auto n = first; n != last; ++n) {
      const bool repeated = n != first && *n == *(n - 1);
      if (!repeated && *n != static_cast<Index>(v)) graph.neighbours[kept++] = *n;
    }
  }
  graph.starts.back() = kept;
  graph.neighbours.resize(kept);
  return graph;
}

// Spreads 21 bits to every third place.
std::uint64_t spread(std::uint64_t bits) {
  bits = (bits | bits << 32) & 0x001f00000000ffffULL;
  bits = (bits | bits << 16) & 0x001f0000ff0000ffULL;
  bits = (bits | bits << 8) & 0x100f00f00f00f00fULL;
  bits = (bits | bits << 4) & 0x10c30c30c30c30c3ULL;
  return (bits | bits << 2) & 0x1249249249249249ULL;
}

std::vector<Index> along_a_curve(const std::vector<Index>& vertices, ConstPositions rest_positions) {
  if (vertices.empty()) return {};
  const Eigen::RowVector3d low = rest_positions.colwise().minCoeff();
  const double longest = (rest_positions.colwise().maxCoeff() - low).maxCoeff();
  const double scale = longest > 0 ? 2097151.0 / longest : 0.0;
  std::vector<std::pair<std::uint64_t, Index>> places;
  for (const Index v : vertices) {
    std::uint64_t code = 0;
    for (int axis = 0; axis < 3; ++axis) {
      code |= spread(static_cast<std::uint64_t>((rest_positions(v, axis) - low[axis]) * scale)) << axis;
    }
    places.emplace_back(code, v);
  }
  std::sort(places.begin(), places.end());
  std::vector<Index> ordered;
  ordered.reserve(places.size());
  for (const auto& place : places) ordered.push_back(place.second);
  return ordered;
}

}  // namespace

Patches find_patches(ConstPositions rest_positions, ConstTets tets, ConstMask constrained, int ring_count) {
  const Eigen::Index count = rest_positions.rows();
  const Graph graph = edges_of(tets, count);
  // Vertices so far from each free vertex, by a search that stops at the last ring.
  std::vector<std::vector<std::vector<Index>>> rings(static_cast<std::size_t>(ring_count));
  std::vector<Index> free, seen_by(static_cast<std::size_t>(count), -1);
  std::vector<bool> wanted(static_cast<std::size_t>(count), false);
  std::vector<std::size_t> place(static_cast<std::size_t>(count), 0);
  for (Index v = 0; v < count; ++v) {
    if (constrained[v]) continue;
    place[static_cast<std::size_t>(v)] = free.size();
    free.push_back(v);
    wanted[static_cast<std::size_t>(v)] = true;
    seen_by[static_cast<std::size_t>(v)] = v;
    std::vector<Index> front{v};
    for (auto& ring : rings) {
      std::vector<Index> next;
      for (const Index from : front) {
        for (std::size_t e = graph.starts[static_cast<std::size_t>(from)]; e < graph.starts[static_cast<std::size_t>(from) + 1];
             ++e) {
          const auto to = static_cast<std::size_t>(graph.neighbours[e]);
          if (seen_by[to] == v) continue;
          seen_by[to] = v;
          wanted[to] = true;
          next.push_back(graph.neighbours[e]);
        }
      }
      std::sort(next.begin(), next.end());
      ring.push_back(next);
      front = std::move(next);
    }
  }
  std::vector<Index> vertices;
  for (Index v = 0; v < count; ++v) {
    if (wanted[static_cast<std::size_t>(v)]) vertices.push_back(v);
  }
  Patches patches;
  patches.vertices = along_a_curve(vertices, rest_positions);
  std::vector<Index> row_of(static_cast<std::size_t>(count), -1);
  for (std::size_t row = 0; row < patches.vertices.size(); ++row) {
    const Index v = patches.vertices[row];
    row_of[static_cast<std::size_t>(v)] = static_cast<Index>(row);
    if (!constrained[v]) patches.free.push_back(static_cast<Index>(row));
  }
  for (const auto& near : rings) {
    Ring ring;
    ring.starts.push_back(0);
    for (const Index row : patches.free) {
      const auto v = static_cast<std::size_t>(patches.vertices[static_cast<std::size_t>(row)]);
      for (const Index n : near[place[v]]) ring.neighbours.push_back(row_of[static_cast<std::size_t>(n)]);
      ring.starts.push_back(static_cast<Index>(ring.neighbours.size()));
    }
    patches.rings.push_back(std::move(ring));
  }
  return patches;
}

}  // namespace followthrough
