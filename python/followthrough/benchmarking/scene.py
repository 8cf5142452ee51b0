# SPDX-License-Identifier: GPL-3.0-or-later
"""What the methods are measured on: the dancer's volume at a chosen number of vertices, and its skinned motion.

The dancer, its flesh and its dance are the same at every size: a larger size is a finer mesh of the same problem, so errors in
metres compare across sizes (the characters of `followthrough.datasets` are made of cubes of one size). The dimensionless
stiffness s = E h² / (rho L²) grows with it, as edges L get shorter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from followthrough.benchmarking import dancer
from followthrough.character import distances_to_segments
from followthrough.elastic import ElasticBody, MaterialName
from followthrough.mesh import TetMesh, tetrahedralize
from followthrough.sequences import Sequence
from followthrough.skinning import pose_vertices

#: The softest flesh of [DE], Pa, and its density, kg/m³.
YOUNGS_MODULUS = 5e4
DENSITY = 1000.0
#: Vertices nearer to a bone than this are constrained, m: about two thirds of a limb's, at every size.
CORE_RADIUS = 0.2
#: The least size: below it the cells are wider than the limbs.
LEAST_VERTICES = 200
#: How far the number of vertices may be from what was asked for.
_CLOSE_ENOUGH = 0.01


@dataclass(frozen=True, eq=False)
class Scene:
    """A volume in motion.

    Attributes
    ----------
    sequence
        Volume, material and reference.
    edge
        Of a cube of the volume, m.
    """

    sequence: Sequence
    edge: float

    @property
    def dimensionless_stiffness(self) -> float:
        """s = E h² / (rho L²)."""
        return YOUNGS_MODULUS * self.sequence.dt**2 / (DENSITY * self.edge**2)

    def body(self, material: MaterialName = "invertible-stvk") -> ElasticBody:
        """The volume as an elastic body."""
        return ElasticBody.of_sequence(self.sequence, material)


def make_scene(vertices: int, frames: int) -> Scene:
    """The dancer with about so many tet vertices, for so many frames after the first.

    Raises
    ------
    ValueError
        Where there are too few of either.
    """
    if vertices < LEAST_VERTICES:
        raise ValueError(f"sizes: found {vertices}, expected {LEAST_VERTICES} vertices or more")
    if frames < 1:
        raise ValueError(f"frames: found {frames}, expected 1 or more")
    volume = _volume_of(vertices)
    rest = volume.vertices
    bones, weights = dancer.bone_weights(rest)
    reference = np.empty((frames + 1, *rest.shape))
    for frame in range(frames + 1):
        reference[frame] = pose_vertices(rest, bones, weights, dancer.pose(frame))
    reference[0] = rest  # without the rounding of skinning
    sequence = Sequence(
        rest_positions=rest,
        tets=volume.tets,
        constrained=distances_to_segments(rest, dancer.segments()) < CORE_RADIUS,
        youngs_modulus=np.full(len(rest), YOUNGS_MODULUS),
        density=DENSITY,
        dt=dancer.DT,
        reference=reference,
    )
    return Scene(sequence, volume.cell_size)


def make_scene_of_free(free: int, frames: int) -> Scene:
    """The dancer with about so many free tet vertices (`make_scene`)."""
    vertices = round(1.12 * free)
    best = math.inf, vertices
    for _ in range(4):
        found = int(np.count_nonzero(~make_scene(vertices, 1).sequence.constrained))
        best = min(best, (abs(found / free - 1.0), vertices))
        if best[0] <= _CLOSE_ENOUGH:
            break
        vertices = max(round(vertices * free / found), LEAST_VERTICES)
    return make_scene(best[1], frames)


def _volume_of(vertices: int) -> TetMesh:
    skin = dancer.surface()
    edge = 0.2 * (1500 / vertices) ** (1 / 3)
    best: TetMesh | None = None
    for _ in range(12):
        volume = tetrahedralize(skin.vertices, skin.triangles, cell_size=edge)
        if best is None or _miss(volume, vertices) < _miss(best, vertices):
            best = volume
        if _miss(best, vertices) <= _CLOSE_ENOUGH:
            break
        edge *= (len(volume.vertices) / vertices) ** (1 / 3)
    assert best is not None
    return best


def _miss(volume: TetMesh, vertices: int) -> float:
    return abs(len(volume.vertices) / vertices - 1.0)


def motion_size(sequence: Sequence) -> float:
    """How far the reference moves in a frame, root mean square, m: to tell how violent a motion is."""
    return float(np.sqrt(np.mean(np.sum(np.diff(sequence.reference, axis=0) ** 2, axis=-1))))
