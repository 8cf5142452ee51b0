# SPDX-License-Identifier: GPL-3.0-or-later
"""The patch network of [DE] in plain NumPy, as it is defined and not as it is fast; guides of Newton steps
likewise; and random weights for both."""

import itertools
from collections.abc import Mapping

import numpy as np

from followthrough.newton_weights import NewtonSchedule, guide_inputs

Array = np.ndarray
PERCEPTRONS = ("edge_mlp", "edge_mlp_2", "edge_mlp_3")


def random_parameters(
    seed: int,
    *,
    inertia: tuple[int, ...] = (64,) * 5,
    force: tuple[int, ...] = (128,) * 5,
    displacement: tuple[int, ...] = (192,) * 4,
    rings: int = 1,
    sees_reference: bool = True,
    biases: bool = True,
    gain: float = 0.02,
) -> dict[str, Array]:
    """Weights of any architecture, the published one by default; `gain` keeps a frame's motion small."""
    rng = np.random.default_rng(seed)
    parameters: dict[str, Array] = {}

    def perceptron(name: str, widths: tuple[int, ...]) -> None:
        for k, (inputs, outputs) in enumerate(itertools.pairwise(widths)):
            parameters[f"{name}.{2 * k}.weight"] = rng.normal(size=(outputs, inputs)) / np.sqrt(inputs)
            if biases:
                parameters[f"{name}.{2 * k}.bias"] = 0.1 * rng.normal(size=outputs)

    perceptron("point_mlp", (18 if sees_reference else 9, *inertia))
    for name in PERCEPTRONS[:rings]:
        perceptron(name, (37 if sees_reference else 19, *force))
    perceptron("instance_mlp", (inertia[-1] + rings * force[-1], *displacement, 3))
    for name in (f"instance_mlp.{2 * len(displacement)}.{kind}" for kind in ("weight", "bias")):
        if name in parameters:
            parameters[name] *= gain
    return {name: array.astype(np.float32) for name, array in parameters.items()}


def evaluate(parameters: Mapping[str, Array], name: str, values: Array) -> Array:
    """One perceptron on the last axis, in double precision."""
    layer = 0
    while (weight := parameters.get(f"{name}.{layer}.weight")) is not None:
        if layer:
            values = np.tanh(values)
        values = values @ weight.T.astype(np.float64) + parameters.get(f"{name}.{layer}.bias", 0.0)
        layer += 2
    return values


def rings_of(tets: Array, vertices: int, rings: int) -> list[list[Array]]:
    """The neighbours of every vertex so many edges away, ring by ring."""
    adjacent = np.zeros((vertices, vertices), dtype=bool)
    for tet in tets:
        adjacent[np.ix_(tet, tet)] = True
    within = np.eye(vertices, dtype=bool)
    result = []
    for _ in range(rings):
        wider = (within.astype(int) @ adjacent.astype(int)) > 0
        result.append([np.flatnonzero(row) for row in wider & ~within])
        within = wider
    return result


class PlainNetwork:
    """Runs it on a mesh in the network's own units: m, MPa, kg."""

    def __init__(self, parameters: Mapping[str, Array], rest: Array, tets: Array, constrained: Array, k: Array) -> None:
        self.parameters, self.rest, self.constrained = parameters, rest, constrained
        self.sees_reference = parameters["point_mlp.0.weight"].shape[1] == 18
        corners = rest[tets]
        volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6
        mass = np.zeros(len(rest))
        np.add.at(mass, tets, 1000 * volumes[:, None] / 4)
        self.material = np.stack([k, mass, k / mass], axis=1)
        rings = sum(f"{name}.0.weight" in parameters for name in PERCEPTRONS)
        self.rings = rings_of(tets, len(rest), rings)

    def rollout(self, reference: Array) -> Array:
        """Dynamic positions (F, n, 3) of a reference (F, n, 3)."""
        x = reference - self.rest
        x = np.concatenate([x[:1], x])  # x[t + 1] is frame t
        u = [x[0]] * 3
        for t in range(1, len(reference)):
            u.append(self.step(u[-1], u[-2], u[-3], x[t + 1], x[t], x[t - 1]))
        return np.array(u[2:]) + self.rest

    def step(self, u0: Array, u1: Array, u2: Array, after: Array, here: Array, before: Array) -> Array:
        """Displacements (n, 3) of the next frame."""
        if not self.sees_reference:
            ahead = self.constrained[:, None]
            u0, u1, u2 = np.where(ahead, after, u0), np.where(ahead, here, u1), np.where(ahead, before, u2)
        result = after.copy()
        for i in np.flatnonzero(~self.constrained):
            if self.sees_reference:
                origin, own, seen = here[i], (u0, u1, u2, after, before), (u0, u1, u2, after, here, before)
            else:
                origin, own, seen = u0[i], (u1, u2), (u0, u1, u2)
            centre = np.concatenate([*(frame[i] - origin for frame in own), self.material[i]])
            joined = [evaluate(self.parameters, "point_mlp", centre)]
            for name, ring in zip(PERCEPTRONS, self.rings, strict=False):
                near = ring[i]
                frames = [frame[near] - origin for frame in seen]
                edges = [self.constrained[near, None].astype(float), *frames, np.tile(centre, (len(near), 1))]
                joined.append(evaluate(self.parameters, name, np.concatenate(edges, axis=1)).sum(axis=0))
            result[i] = u0[i] + evaluate(self.parameters, "instance_mlp", np.concatenate(joined))
        return result


def random_newton_parameters(
    seed: int, schedule: NewtonSchedule, *, widths: tuple[int, ...] = (12, 8), gain: float = 0.3
) -> dict[str, Array]:
    """Random guides of Newton steps around their usual ones: half of the start's first vector, a pass's direction."""
    random = np.random.default_rng(seed)
    parameters: dict[str, Array] = {}
    for guide, size in schedule.guides().items():
        for k, (inputs, outputs) in enumerate(itertools.pairwise((guide_inputs(size), *widths, size[0]))):
            scale = gain if k == len(widths) else 1.0
            weight = scale * random.normal(size=(outputs, inputs)) / np.sqrt(inputs)
            bias = scale * 0.1 * random.normal(size=outputs)
            if k == len(widths):
                bias[0] += 0.5 if guide == "start" else 1.0
            parameters[f"{guide}.{k}.weight"] = weight.astype(np.float32)
            parameters[f"{guide}.{k}.bias"] = bias.astype(np.float32)
    return parameters


def guided_step(parameters: Mapping[str, Array], guide: str, vectors: Array, scalars: Array) -> Array:
    """Steps (f, 3) that a guide makes of vectors (f, v, 3) and other numbers (f, k), in double precision."""
    vectors = vectors.astype(np.float64)
    products = np.einsum("fak,fbk->fab", vectors, vectors)
    squares = np.einsum("fvk,fvk->f", vectors, vectors)[:, None] + 1e-18
    pairs = products[:, *np.triu_indices(vectors.shape[1])]
    hidden = np.concatenate([np.sign(pairs) * np.sqrt(np.abs(pairs) / squares + 1e-9), scalars], axis=1)
    depth = sum(name.startswith(f"{guide}.") and name.endswith(".weight") for name in parameters)
    for k in range(depth):
        hidden = (np.tanh(hidden) if k else hidden) @ parameters[f"{guide}.{k}.weight"].T
        hidden = hidden + parameters[f"{guide}.{k}.bias"]
    return np.einsum("fv,fvk->fk", hidden, vectors)
