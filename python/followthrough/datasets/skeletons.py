# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones inside a body, and the reference motion that they give it: linear blend skinning with smooth weights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from followthrough.character import FloatArray
from followthrough.datasets.surfaces import combine

#: Weights fall with this power of the distance to a bone, which is never less than the second number, in edges.
_WEIGHT_FALL, _WEIGHT_CORE = 4, 0.5


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Bones that turn about their heads, each with those that hang on it.

    Attributes
    ----------
    heads, tails : (b, 3) float64
        Ends of the bones at rest.
    parents : tuple of int
        The bone that each hangs on, before it in the order; -1 for the first.
    """

    heads: FloatArray
    tails: FloatArray
    parents: tuple[int, ...]

    @property
    def bone_count(self) -> int:
        """Number of bones, b."""
        return len(self.parents)

    def distances(self, points: FloatArray, span: tuple[float, float] = (0.0, 1.0)) -> FloatArray:
        """Distances (n, b) of points (n, 3) to each bone between two shares of its length."""
        starts = self.heads + span[0] * (self.tails - self.heads)
        directions = (span[1] - span[0]) * (self.tails - self.heads)
        offsets = points[:, None] - starts
        shares = (offsets * directions).sum(axis=2) / np.maximum((directions**2).sum(axis=1), 1e-12)
        nearest = np.clip(shares, 0.0, 1.0)[:, :, None] * directions
        distances: FloatArray = np.linalg.norm(offsets - nearest, axis=2)
        return distances

    def weights(self, points: FloatArray) -> FloatArray:
        """Smooth weights (n, b) of points (n, 3) that sum to one, larger the nearer the bone."""
        nearness = (self.distances(points) + _WEIGHT_CORE) ** -_WEIGHT_FALL
        weights: FloatArray = nearness / nearness.sum(axis=1, keepdims=True)
        return weights


@dataclass(frozen=True, eq=False)
class Pose:
    """How bones are turned, frame by frame.

    Attributes
    ----------
    turns : (F, b, 3) float64
        Rotation vectors about the heads, relative to the parent, radians.
    translations : (F, 3) float64
        Of the first bone, and so of everything.
    """

    turns: FloatArray
    translations: FloatArray

    def scaled(self, share: float) -> Pose:
        """A smaller or larger copy of the motion."""
        return Pose(share * self.turns, share * self.translations)

    def after(self, first: FloatArray) -> Pose:
        """The same on top of constant turns (b, 3)."""
        return Pose(self.turns + first, self.translations)


def rotation_matrices(vectors: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    angles = np.linalg.norm(vectors, axis=-1)[..., None, None]
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*vectors.shape, 3)
    outer = vectors[..., :, None] * vectors[..., None, :]
    half = np.sinc(angles / (2.0 * np.pi))
    rotations: FloatArray = np.cos(angles) * np.eye(3) + np.sinc(angles / np.pi) * cross + 0.5 * half * half * outer
    return rotations


def skinned(points: FloatArray, weights: FloatArray, skeleton: Skeleton, pose: Pose) -> FloatArray:
    """Where points are as the bones move them.

    Parameters
    ----------
    points : (n, 3)
        At rest.
    weights : (n, b)
        Summing to one.
    skeleton, pose
        The bones and how they turn.

    Returns
    -------
    (F, n, 3) float64
    """
    local = rotation_matrices(pose.turns)
    rotations: list[FloatArray] = []
    heads: list[FloatArray] = []
    total = np.zeros((len(pose.turns), len(points), 3))
    for bone, parent in enumerate(skeleton.parents):
        if parent < 0:
            turned, head = local[:, bone], pose.translations + skeleton.heads[bone]
        else:
            turned = combine(rotations[parent], local[:, bone][:, None])
            offset = skeleton.heads[bone] - skeleton.heads[parent]
            head = heads[parent] + combine(offset[None, None], rotations[parent].swapaxes(1, 2)[:, None])[:, 0]
        rotations.append(turned)
        heads.append(head)
        moved = combine((points - skeleton.heads[bone])[None], turned.swapaxes(1, 2)[:, None]) + head[:, None]
        total += weights[:, bone, None] * moved
    return total
