// SPDX-License-Identifier: GPL-3.0-or-later
#include <pybind11/eigen.h>

#include "bindings.hpp"
#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/surface_follower.hpp"
#include "followthrough/mesh/surface_queries.hpp"
#include "followthrough/mesh/surface_transfer.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"

namespace followthrough {
namespace py = pybind11;

void bind_mesh(py::module_& m) {
  using Released = py::call_guard<py::gil_scoped_release>;

  py::class_<TetVolume>(m, "TetVolume", "Tets around a surface, and where its vertices lie in them.")
      .def_readonly("vertices", &TetVolume::vertices)
      .def_readonly("tets", &TetVolume::tets)
      .def_readonly("embedding_tets", &TetVolume::embedding_tets)
      .def_readonly("embedding_weights", &TetVolume::embedding_weights)
      .def_readonly("cell_count", &TetVolume::cell_count)
      .def_readonly("cell_size", &TetVolume::cell_size)
      .def_readonly("own_offsets", &TetVolume::own_offsets)
      .def_readonly("own_triangles", &TetVolume::own_triangles);

  m.def(
      "tetrahedralize",
      [](ConstPositions vertices, ConstTriangles triangles, Index cells, double cell_size, bool split_parts) {
        return tetrahedralize(vertices, triangles, {cells, cell_size, split_parts});
      },
      py::arg("vertices"), py::arg("triangles"), py::arg("cells"), py::arg("cell_size"), py::arg("split_parts"),
      "Voxel tets around a surface; cell_size 0: from cells.", Released());

  m.def("connected_parts", &connected_parts, py::arg("tets"), py::arg("vertex_count"), "Piece of the tet mesh of each vertex.",
        Released());

  m.def(
      "embed",
      [](ConstPositions points, ConstPositions vertices, ConstTets tets) {
        Embedding embedding;
        {
          const py::gil_scoped_release released;
          embedding = embed(points, vertices, tets);
        }
        return py::make_tuple(std::move(embedding.tets), std::move(embedding.weights));
      },
      py::arg("points"), py::arg("vertices"), py::arg("tets"), "The tet that carries each point, and its barycentric weights.");

  m.def("interpolate", &interpolate, py::arg("values"), py::arg("tets"), py::arg("embedding_tets"), py::arg("embedding_weights"),
        "Values at embedded points.", Released());

  m.def(
      "closest_points",
      [](ConstPositions points, ConstPositions vertices, ConstTriangles triangles) {
        ClosestPoints closest;
        {
          const py::gil_scoped_release released;
          closest = closest_points(points, vertices, triangles);
        }
        return py::make_tuple(std::move(closest.triangles), std::move(closest.barycentric), std::move(closest.distances));
      },
      py::arg("points"), py::arg("vertices"), py::arg("triangles"), "Closest triangles, weights in them, and distances.");

  m.def("winding_numbers", &winding_numbers, py::arg("points"), py::arg("vertices"), py::arg("triangles"),
        "Generalized winding number of the surface around each point.", Released());

  py::class_<SurfaceTransfer>(m, "SurfaceTransfer", "Carries values from a surface into the volume around it.")
      .def(py::init<ConstPositions, ConstTriangles, ConstPositions, ConstTets, ConstIndices, ConstIndices>(),
           py::arg("surface_vertices"), py::arg("triangles"), py::arg("vertices"), py::arg("tets"), py::arg("own_offsets"),
           py::arg("own_triangles"), Released())
      .def("__call__", &SurfaceTransfer::operator(), py::arg("values"), Released());

  py::class_<SurfaceFollower>(m, "SurfaceFollower", "Moves a volume with the surface in it.")
      .def(py::init<ConstPositions, ConstTriangles, ConstPositions, ConstTets, ConstIndices, ConstIndices>(),
           py::arg("surface_vertices"), py::arg("triangles"), py::arg("vertices"), py::arg("tets"), py::arg("own_offsets"),
           py::arg("own_triangles"), Released())
      .def("__call__", &SurfaceFollower::operator(), py::arg("positions"), Released());
}

}  // namespace followthrough
