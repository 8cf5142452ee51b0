# SPDX-License-Identifier: GPL-3.0-or-later
"""What the patch network is given, as tensors: vertices with their histories, and who is whose neighbour."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from followthrough.character import FloatArray, IntArray
from followthrough.emulator_weights import TrainedOn
from followthrough.sequences import Sequence


@dataclass(frozen=True, eq=False)
class PatchBatch:
    """Some vertices to take one frame further. Vertices of several frames and scenes may stand one after the other.

    Attributes
    ----------
    dynamic : (3, n, 3)
        Displacements from the rest shape u(t), u(t-1), u(t-2), in the network's metres.
    reference : (3, n, 3)
        Those of the reference, x(t+1), x(t), x(t-1).
    constrained : (n,) bool
        Vertices that take the reference.
    material : (n, 3)
        k in MPa, m in kg, k/m.
    centres : (b,) int64
        The vertices to predict.
    neighbours : tuple of (b, d) int64
        Ring by ring, the vertices around each of them; -1: none.
    """

    dynamic: Tensor
    reference: Tensor
    constrained: Tensor
    material: Tensor
    centres: Tensor
    neighbours: tuple[Tensor, ...]

    @classmethod
    def join(cls, parts: Iterable[PatchBatch]) -> Self:
        """Batches of as many rings as one, their vertices one after the other."""
        parts = list(parts)
        starts = np.cumsum([0, *(len(part.constrained) for part in parts)])
        rings = []
        for tables in zip(*(part.neighbours for part in parts), strict=True):
            width = max(table.shape[1] for table in tables)
            moved = [
                torch.where(table < 0, table, table + int(start)) for table, start in zip(tables, starts, strict=False)
            ]
            rings.append(
                torch.cat([nn.functional.pad(table, (0, width - table.shape[1]), value=-1) for table in moved])
            )
        return cls(
            torch.cat([part.dynamic for part in parts], dim=1),
            torch.cat([part.reference for part in parts], dim=1),
            torch.cat([part.constrained for part in parts]),
            torch.cat([part.material for part in parts]),
            torch.cat([part.centres + int(start) for part, start in zip(parts, starts, strict=False)]),
            tuple(rings),
        )

    def to(self, device: torch.device | str) -> Self:
        """The same on another device."""
        moved = {
            name: getattr(self, name).to(device)
            for name in ("dynamic", "reference", "constrained", "material", "centres")
        }
        return replace(self, neighbours=tuple(ring.to(device) for ring in self.neighbours), **moved)


@dataclass(frozen=True, eq=False)
class Scene:
    """A volume in the network's units, with the patches of its free vertices.

    Attributes
    ----------
    scale : float
        The network's metres a metre of the scene.
    rest_positions : (n, 3) float64
        In the scene's metres.
    constrained : (n,) bool
        Vertices that take the reference.
    material : (n, 3) float32
        k in MPa, m in kg, k/m.
    centres : (f,) int64
        The free vertices.
    neighbours : tuple of (f, d) int64
        Ring by ring, -1: none.
    """

    scale: float
    rest_positions: FloatArray
    constrained: NDArray[np.bool_]
    material: NDArray[np.float32]
    centres: NDArray[np.int64]
    neighbours: tuple[NDArray[np.int64], ...]

    @classmethod
    def of_sequence(
        cls, sequence: Sequence, trained_on: TrainedOn, rings: int = 1, edge_length: float | None = None
    ) -> Self:
        """The volume of a sequence; `edge_length` of its cubes as `Emulator` takes it."""
        rest, tets = sequence.rest_positions, sequence.tets
        corners = rest[tets]
        volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
        if edge_length is None:
            edge_length = float(np.cbrt(6 * np.partition(volumes, len(volumes) // 2)[len(volumes) // 2]))
        scale = trained_on.edge_length / edge_length
        density = np.broadcast_to(sequence.density, (len(rest),))[tets].mean(axis=1)
        lightness = trained_on.density * volumes.sum() / (density * volumes).sum()
        mass = np.zeros(len(rest))
        np.add.at(mass, tets, (density * volumes / 4)[:, None])
        mass *= lightness * scale**3
        modulus = sequence.youngs_modulus * 1e-6 * lightness * (scale * sequence.dt / trained_on.dt) ** 2
        ratio = np.divide(modulus, mass, out=np.zeros_like(mass), where=mass > 0)
        centres = np.flatnonzero(~sequence.constrained)
        return cls(
            scale=scale,
            rest_positions=rest,
            constrained=sequence.constrained,
            material=np.stack([modulus, mass, ratio], axis=1).astype(np.float32),
            centres=centres,
            neighbours=tuple(_rings(tets, len(rest), centres, rings)),
        )

    def displacements(self, positions: FloatArray) -> NDArray[np.float32]:
        """Positions (..., n, 3) in the scene's metres as displacements in the network's."""
        displacements: NDArray[np.float32] = (self.scale * (positions - self.rest_positions)).astype(np.float32)
        return displacements

    def batch(self, dynamic: NDArray[np.float32], reference: NDArray[np.float32]) -> PatchBatch:
        """All free vertices, given displacements u(t), u(t-1), u(t-2) (3, n, 3) and x(t+1), x(t), x(t-1) (3, n, 3)."""
        return PatchBatch(
            torch.from_numpy(dynamic),
            torch.from_numpy(reference),
            torch.from_numpy(self.constrained),
            torch.from_numpy(self.material),
            torch.from_numpy(self.centres),
            tuple(torch.from_numpy(ring) for ring in self.neighbours),
        )


def _rings(tets: IntArray, count: int, centres: NDArray[np.int64], rings: int) -> list[NDArray[np.int64]]:
    """Vertices so many edges away from the centres, in rows that -1 fills up."""
    adjacent: list[set[int]] = [set() for _ in range(count)]
    for tet in tets.tolist():
        for corner in tet:
            adjacent[corner].update(tet)
    found: list[list[list[int]]] = [[] for _ in range(rings)]
    for centre in centres.tolist():
        within = {centre}
        for ring in found:
            wider = set().union(*(adjacent[vertex] for vertex in within)) | within
            ring.append(sorted(wider - within))
            within = wider
    tables = []
    for ring in found:
        table = np.full((len(centres), max(map(len, ring), default=0)), -1, dtype=np.int64)
        for row, near in zip(table, ring, strict=True):
            row[: len(near)] = near
        tables.append(table)
    return tables
