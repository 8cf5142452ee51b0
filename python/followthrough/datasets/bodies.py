# SPDX-License-Identifier: GPL-3.0-or-later
"""Bodies: a volume of cubes around a surface, bones in it, and what they hold. Lengths are in edges of a cube."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from followthrough import mesh
from followthrough.character import FloatArray, IntArray
from followthrough.datasets.skeletons import Pose, Skeleton, skinned
from followthrough.datasets.surfaces import Surface

#: A tet of a posed rest shape has at least this share of a regular one's volume.
LEAST_VOLUME = 0.15


@dataclass(frozen=True, eq=False)
class Body:
    """A volume with bones.

    Attributes
    ----------
    vertices : (n, 3) float64
        In edges of a cube.
    tets : (m, 4) int32
    skeleton : Skeleton
    weights : (n, b) float64
        Of the bones.
    constrained : (n,) bool
        What the bones hold.
    """

    vertices: FloatArray
    tets: IntArray
    skeleton: Skeleton
    weights: FloatArray
    constrained: NDArray[np.bool_]

    def reference(self, pose: Pose) -> FloatArray:
        """Where the bones alone put the vertices, (F, n, 3)."""
        return skinned(self.vertices, self.weights, self.skeleton, pose)

    def paced(self, pose: Pose, acceleration: float, speed: float) -> Pose:
        """The motion made smaller, or a little larger, until what is held accelerates so many edges a frame, a frame, at
        most, and is no faster than so many edges a frame."""
        held = replace(self, vertices=self.vertices[self.constrained], weights=self.weights[self.constrained])
        places = held.reference(pose)
        fastest = float(np.linalg.norm(np.diff(places, axis=0), axis=2).max())
        hardest = float(np.linalg.norm(np.diff(places, 2, axis=0), axis=2).max())
        return pose.scaled(min(1.5, acceleration / max(hardest, 1e-9), speed / max(fastest, 1e-9)))

    def least_volume(self, vertices: FloatArray) -> float:
        """Of the tets with the vertices elsewhere, relative to a regular one's."""
        return float(_volumes(vertices, self.tets).min()) * 6.0

    def bent(self, turns: FloatArray, warp: FloatArray) -> tuple[Body, FloatArray]:
        """The body in another rest shape, and the turns (b, 3) that give it: the bones turned and the vertices displaced
        (n, 3), less of both where tets would be squashed by it."""
        for share in (1.0, 0.7, 0.5, 0.3, 0.15):
            first = np.concatenate([turns[:1], share * turns[1:]])
            warped = replace(self, vertices=self.vertices + share * warp)
            if warped.least_volume(warped.reference(Pose(first[None], np.zeros((1, 3))))[0]) >= LEAST_VOLUME:
                return warped, first
        return self, np.zeros_like(turns)


def body_of(
    surface: Surface,
    skeleton: Skeleton,
    constrained_radius: float,
    held: list[int],
    span: tuple[float, float] = (0.0, 1.0),
    most_held: float = 0.6,
) -> Body:
    """Fill a surface with cubes of edge 1 and hold what is near some of the bones.

    Parameters
    ----------
    surface
        In edges.
    skeleton
        In edges.
    constrained_radius
        How far a bone holds.
    held
        The bones that do.
    span
        Which part of their length does.
    most_held
        Share of the vertices that is held at most; where it would be more, those that are farther are free.
    """
    volume = mesh.tetrahedralize(surface.vertices, surface.triangles, cell_size=1.0)
    near = np.sort(distances := skeleton.distances(volume.vertices, span)[:, held].min(axis=1))
    # A bone that is farther from all vertices than it holds has those next to it.
    radius = np.clip(constrained_radius, near[min(7, len(near) - 1)], near[int(most_held * (len(near) - 1))]) + 1e-9
    constrained = distances <= radius
    return Body(volume.vertices, volume.tets, skeleton, skeleton.weights(volume.vertices), constrained)


def _volumes(vertices: FloatArray, tets: IntArray) -> FloatArray:
    corners = vertices[tets]
    edges = corners[:, 1:] - corners[:, :1]
    volumes: FloatArray = (edges[:, 0] * np.cross(edges[:, 1], edges[:, 2])).sum(axis=1) / 6.0
    return volumes
