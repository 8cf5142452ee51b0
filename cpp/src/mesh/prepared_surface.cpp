// SPDX-License-Identifier: GPL-3.0-or-later
#include "prepared_surface.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <string>
#include <unordered_map>
#include <vector>

#include "box_tree.hpp"
#include "bucket_sort.hpp"
#include "disjoint_sets.hpp"
#include "followthrough/errors.hpp"
#include "surface_edges.hpp"

namespace followthrough {
namespace {

constexpr double kWeldDistance = 1e-6;  // of the longest side

// Joins vertices closer than `distance`: each looks into its own bucket and those that its neighbourhood reaches.
std::vector<Index> weld(ConstPositions vertices, const std::vector<char>& open, const Eigen::Vector3d& origin, double distance,
                        Index& count) {
  using Key = std::array<std::int64_t, 3>;
  struct Hash {
    std::size_t operator()(const Key& key) const noexcept {
      std::uint64_t h = 0;
      for (const std::int64_t k : key) h = (h ^ static_cast<std::uint64_t>(k)) * 0x9E3779B97F4A7C15ull, h ^= h >> 29;
      return static_cast<std::size_t>(h);
    }
  };
  const double bucket = 16 * distance;
  std::unordered_map<Key, Index, Hash> heads;
  heads.reserve(static_cast<std::size_t>(vertices.rows()));
  std::vector<Index> next(static_cast<std::size_t>(vertices.rows()), -1);
  DisjointSets sets(static_cast<std::size_t>(vertices.rows()));
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    if (!open[static_cast<std::size_t>(v)]) continue;
    const Eigen::Vector3d scaled = (Eigen::Vector3d(vertices.row(v)) - origin) / bucket;
    const double reach = distance / bucket;
    Key low, high;
    for (std::size_t k = 0; k < 3; ++k) {
      low[k] = static_cast<std::int64_t>(std::floor(scaled[static_cast<Eigen::Index>(k)] - reach));
      high[k] = static_cast<std::int64_t>(std::floor(scaled[static_cast<Eigen::Index>(k)] + reach));
    }
    for (std::int64_t x = low[0]; x <= high[0]; ++x) {
      for (std::int64_t y = low[1]; y <= high[1]; ++y) {
        for (std::int64_t z = low[2]; z <= high[2]; ++z) {
          const auto found = heads.find({x, y, z});
          if (found == heads.end()) continue;
          for (Index other = found->second; other >= 0; other = next[static_cast<std::size_t>(other)]) {
            if ((vertices.row(other) - vertices.row(v)).squaredNorm() <= distance * distance)
              sets.join(other, static_cast<Index>(v));
          }
        }
      }
    }
    // Only the first of its set needs to be found again by position, so crowds of coincident vertices stay cheap.
    if (sets.find(static_cast<Index>(v)) != v) continue;
    const Key own = {static_cast<std::int64_t>(std::floor(scaled[0])), static_cast<std::int64_t>(std::floor(scaled[1])),
                     static_cast<std::int64_t>(std::floor(scaled[2]))};
    const auto [place, fresh] = heads.try_emplace(own, -1);
    next[static_cast<std::size_t>(v)] = place->second;
    place->second = static_cast<Index>(v);
  }
  return sets.labels(count);
}

// Vertices on a border: an edge with one face only. Where all faces around a vertex hang together, it has no seam to close, and one
// that happens to lie in the same place belongs to another part of the body.
std::vector<char> on_border(ConstTriangles triangles, Eigen::Index vertex_count) {
  const std::vector<DirectedEdge> edges = sorted_edges(triangles, vertex_count);
  std::vector<char> border(static_cast<std::size_t>(vertex_count), 0);
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    if (last - first != 1) return;
    border[static_cast<std::size_t>(edges[first].low)] = border[static_cast<std::size_t>(edges[first].high)] = 1;
  });
  return border;
}

struct Patches {
  std::vector<Index> labels;  // patch of each triangle
  Index count = 0;
};

// Turns faces so that neighbours across edges of exactly two faces agree.
Patches make_consistent(PreparedSurface& surface, const std::vector<DirectedEdge>& edges) {
  const auto count = static_cast<std::size_t>(surface.triangles.rows());
  struct Neighbours {
    std::array<std::pair<Index, bool>, 3> list;  // neighbour, must be turned relative to this one
    std::size_t count = 0;
    void add(Index other, bool turn) { list[count++] = {other, turn}; }
  };
  std::vector<Neighbours> neighbours(count);
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    if (last - first != 2) return;
    const auto& a = edges[first];
    const auto& b = edges[first + 1];
    const bool turn = a.direction == b.direction;
    neighbours[static_cast<std::size_t>(a.triangle)].add(b.triangle, turn);
    neighbours[static_cast<std::size_t>(b.triangle)].add(a.triangle, turn);
  });
  Patches patches;
  patches.labels.assign(count, -1);
  std::vector<char> turned(count, 0);
  std::vector<Index> patch;
  for (std::size_t seed = 0; seed < count; ++seed) {
    if (patches.labels[seed] >= 0) continue;
    patch.assign(1, static_cast<Index>(seed));
    patches.labels[seed] = patches.count;
    double balance = 0;  // area as it was minus area turned round
    for (std::size_t at = 0; at < patch.size(); ++at) {
      const auto t = static_cast<std::size_t>(patch[at]);
      const Eigen::Vector3d a = surface.vertices.row(surface.triangles(patch[at], 0));
      const Eigen::Vector3d b = surface.vertices.row(surface.triangles(patch[at], 1));
      const Eigen::Vector3d c = surface.vertices.row(surface.triangles(patch[at], 2));
      balance += (turned[t] ? -1 : 1) * (b - a).cross(c - a).norm();
      for (std::size_t k = 0; k < neighbours[t].count; ++k) {
        const auto [other, turn] = neighbours[t].list[k];
        const auto o = static_cast<std::size_t>(other);
        if (patches.labels[o] >= 0) continue;
        patches.labels[o] = patches.count;
        turned[o] = static_cast<char>(turned[t] != static_cast<char>(turn));
        patch.push_back(other);
      }
    }
    for (const Index t : patch) {
      if (static_cast<bool>(turned[static_cast<std::size_t>(t)]) == (balance >= 0)) {
        std::swap(surface.triangles(t, 1), surface.triangles(t, 2));
      }
    }
    ++patches.count;
  }
  return patches;
}

// Turns patches so that what they enclose is positive.
void turn_outside(PreparedSurface& surface, const Patches& patches, const std::vector<DirectedEdge>& edges) {
  const auto count = static_cast<std::size_t>(patches.count);
  std::vector<Eigen::Vector3d> rim(count, Eigen::Vector3d::Zero());
  std::vector<Index> rim_edges(count, 0);
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    for (std::size_t k = first; k < last; ++k) {
      const auto patch = patches.labels[static_cast<std::size_t>(edges[k].triangle)];
      Index own = 0;
      for (std::size_t m = first; m < last; ++m) own += patches.labels[static_cast<std::size_t>(edges[m].triangle)] == patch;
      if (own % 2 == 0) continue;
      rim[static_cast<std::size_t>(patch)] +=
          0.5 * (surface.vertices.row(edges[k].low) + surface.vertices.row(edges[k].high)).transpose();
      ++rim_edges[static_cast<std::size_t>(patch)];
    }
  });
  std::vector<double> volumes(count, 0), areas(count, 0);
  std::vector<char> seen(count, 0);
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    const auto patch = static_cast<std::size_t>(patches.labels[static_cast<std::size_t>(t)]);
    const Eigen::Vector3d a = surface.vertices.row(surface.triangles(t, 0));
    const Eigen::Vector3d b = surface.vertices.row(surface.triangles(t, 1));
    const Eigen::Vector3d c = surface.vertices.row(surface.triangles(t, 2));
    if (!seen[patch]) {
      seen[patch] = 1;
      rim[patch] = rim_edges[patch] ? Eigen::Vector3d(rim[patch] / rim_edges[patch]) : a;
    }
    const Eigen::Vector3d normal = (b - a).cross(c - a);
    volumes[patch] += normal.dot(a - rim[patch]) / 6;
    areas[patch] += normal.norm() / 2;
  }
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    const auto patch = static_cast<std::size_t>(patches.labels[static_cast<std::size_t>(t)]);
    // 1 for a sphere, 0 for anything flat.
    const double roundness = 36 * std::numbers::pi * volumes[patch] * volumes[patch];
    const double enough = rim_edges[patch] ? 0.02 : 1e-14;
    if (volumes[patch] < 0 && roundness > enough * areas[patch] * areas[patch] * areas[patch]) {
      std::swap(surface.triangles(t, 1), surface.triangles(t, 2));
    }
  }
}

// A closed patch is a shell of its own; the others of a piece of the mesh are one together.
void number_shells(PreparedSurface& surface, const Patches& patches, const std::vector<DirectedEdge>& edges) {
  std::vector<char> open(static_cast<std::size_t>(patches.count), 0);
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    for (std::size_t k = first; k < last; ++k) {
      const Index patch = patches.labels[static_cast<std::size_t>(edges[k].triangle)];
      int balance = 0;
      for (std::size_t m = first; m < last; ++m) {
        if (patches.labels[static_cast<std::size_t>(edges[m].triangle)] == patch) balance += edges[m].direction;
      }
      if (balance != 0) open[static_cast<std::size_t>(patch)] = 1;
    }
  });
  std::vector<Index> of_patch(open.size(), -1), of_component(static_cast<std::size_t>(surface.component_count), -1);
  surface.shells.resize(surface.triangles.rows());
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    const auto patch = static_cast<std::size_t>(patches.labels[static_cast<std::size_t>(t)]);
    const bool first_of_patch = of_patch[patch] < 0;
    Index& shell = open[patch] ? of_component[static_cast<std::size_t>(surface.components[t])] : of_patch[patch];
    if (shell < 0) {
      shell = static_cast<Index>(surface.shell_crossings.size());
      surface.shell_crossings.push_back(open[patch] ? Crossings::kCountInside : Crossings::kCount);
    } else if (open[patch] && first_of_patch) {
      surface.shell_crossings[static_cast<std::size_t>(shell)] = Crossings::kAskEverywhere;
    }
    of_patch[patch] = shell;
    surface.shells[t] = shell;
  }
  // A wall or fin alone, on a closed patch, hangs on an edge of three faces as well.
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    if (last - first < 3) return;
    for (std::size_t k = first; k < last; ++k) {
      Crossings& way = surface.shell_crossings[static_cast<std::size_t>(surface.shells[edges[k].triangle])];
      if (way == Crossings::kCountInside) way = Crossings::kAskEverywhere;
    }
  });
}

// Vertices and edges as one list, a vertex before the edges of which it is the lower end.
void number_elements(PreparedSurface& surface, const std::vector<DirectedEdge>& edges) {
  surface.vertex_elements.resize(surface.vertices.rows());
  surface.edge_elements.resize(surface.triangles.rows(), 3);
  Index vertex = 0;  // the next one
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    for (; vertex <= edges[first].low; ++vertex) surface.vertex_elements[vertex] = surface.element_count++;
    for (std::size_t k = first; k < last; ++k) {
      const auto corners = surface.triangles.row(edges[k].triangle);
      const Index from = edges[k].direction > 0 ? edges[k].low : edges[k].high;
      surface.edge_elements(edges[k].triangle, corners[0] == from ? 0 : (corners[1] == from ? 1 : 2)) = surface.element_count;
    }
    ++surface.element_count;
  });
  for (; vertex < surface.vertices.rows(); ++vertex) surface.vertex_elements[vertex] = surface.element_count++;
}

// Each face once, whichever corner it starts with and way it is turned; the first one counts. None with a repeated corner.
std::vector<Index> distinct_faces(ConstTriangles triangles, const std::vector<Index>& labels, Index label_count) {
  struct Face {
    std::array<Index, 3> corners;
    Index source;
  };
  std::vector<Face> faces;
  faces.reserve(static_cast<std::size_t>(triangles.rows()));
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    std::array<Index, 3> corners{};
    for (std::size_t k = 0; k < 3; ++k) corners[k] = labels[static_cast<std::size_t>(triangles(t, static_cast<Eigen::Index>(k)))];
    std::sort(corners.begin(), corners.end());
    if (corners[0] != corners[1] && corners[1] != corners[2]) faces.push_back({corners, static_cast<Index>(t)});
  }
  faces = bucket_sorted(
      faces, static_cast<std::size_t>(label_count), [](const Face& face) { return face.corners[0]; },
      [](const Face& a, const Face& b) { return a.corners < b.corners; });
  std::vector<char> first(static_cast<std::size_t>(triangles.rows()), 0);
  for (std::size_t k = 0; k < faces.size(); ++k) {
    if (k == 0 || faces[k].corners != faces[k - 1].corners) first[static_cast<std::size_t>(faces[k].source)] = 1;
  }
  std::vector<Index> result;
  result.reserve(faces.size());
  for (std::size_t t = 0; t < first.size(); ++t) {
    if (first[t]) result.push_back(static_cast<Index>(t));
  }
  return result;
}

}  // namespace

PreparedSurface prepare_surface(ConstPositions vertices, ConstTriangles triangles) {
  if (vertices.rows() == 0) throw InvalidInput("vertices", "is empty, expected a surface");
  if (triangles.rows() == 0) throw InvalidInput("triangles", "is empty, expected a surface of at least one triangle");
  require_finite("vertices", vertices);
  require_indices("triangles", triangles, vertices.rows());

  Box bounds;
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    for (int k = 0; k < 3; ++k) bounds.extend(Eigen::Vector3d(vertices.row(triangles(t, k))));
  }
  const double longest = bounds.sizes().maxCoeff();
  // Below the last digits of the coordinates a surface has no size either.
  const double magnitude = std::max(bounds.min().cwiseAbs().maxCoeff(), bounds.max().cwiseAbs().maxCoeff());
  if (!(longest > 1e-12 * magnitude) || !std::isfinite(longest) || longest < 1e-150) {
    throw InvalidInput("vertices", "all triangles lie in one point, expected a surface with some extent");
  }

  PreparedSurface surface;
  Index distinct = 0;
  const std::vector<Index> labels =
      weld(vertices, on_border(triangles, vertices.rows()), bounds.min(), kWeldDistance * longest, distinct);
  surface.welded = Eigen::Map<const Indices>(labels.data(), static_cast<Eigen::Index>(labels.size()));
  surface.vertices.resize(distinct, 3);
  for (Eigen::Index v = vertices.rows(); v-- > 0;) surface.vertices.row(labels[static_cast<std::size_t>(v)]) = vertices.row(v);

  const std::vector<Index> faces = distinct_faces(triangles, labels, distinct);
  if (faces.empty()) throw InvalidInput("triangles", "every one is degenerate, expected at least one with three distinct corners");
  const auto count = static_cast<Eigen::Index>(faces.size());
  surface.triangles.resize(count, 3);
  surface.sources.resize(count);
  DisjointSets pieces(static_cast<std::size_t>(distinct));
  for (Eigen::Index t = 0; t < count; ++t) {
    surface.sources[t] = faces[static_cast<std::size_t>(t)];
    for (int k = 0; k < 3; ++k) {
      surface.triangles(t, k) = labels[static_cast<std::size_t>(triangles(surface.sources[t], k))];
      pieces.join(surface.triangles(t, 0), surface.triangles(t, k));
    }
  }
  std::vector<DirectedEdge> edges = sorted_edges(surface.triangles, distinct);
  const Patches patches = make_consistent(surface, edges);
  turn_outside(surface, patches, edges);
  update_directions(surface.triangles, edges);

  surface.closed = true;
  for_each_edge(edges, [&](std::size_t first, std::size_t last) {
    int balance = 0;
    for (std::size_t k = first; k < last; ++k) balance += edges[k].direction;
    if (balance != 0) surface.closed = false;
  });

  // Number the pieces in the order of their first triangles; vertices without a triangle are no piece.
  surface.components.resize(count);
  std::vector<Index> number(static_cast<std::size_t>(distinct), -1);
  for (Eigen::Index t = 0; t < count; ++t) {
    Index& own = number[static_cast<std::size_t>(pieces.find(surface.triangles(t, 0)))];
    if (own < 0) own = surface.component_count++;
    surface.components[t] = own;
  }
  number_shells(surface, patches, edges);
  number_elements(surface, edges);
  return surface;
}

}  // namespace followthrough
