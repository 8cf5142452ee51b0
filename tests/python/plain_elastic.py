# SPDX-License-Identifier: GPL-3.0-or-later
"""Invertible St. Venant-Kirchhoff with compression resistance in plain NumPy, as its formulas read: what the core is checked against."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class PlainBody:
    """Forces and consistent mass of a tet mesh, all tets at once, no cleverness."""

    def __init__(
        self,
        rest: Array,
        tets: NDArray[np.int32],
        modulus: Array,
        density: Array,
        poisson: float = 0.45,
        resistance: float = 1e5,
    ) -> None:
        edges = np.stack([rest[tets[:, k]] - rest[tets[:, 0]] for k in (1, 2, 3)], axis=2)
        self.inverse_edges = np.linalg.inv(edges)
        self.volumes = np.abs(np.linalg.det(edges)) / 6
        self.tets = tets
        modulus = modulus[tets].mean(axis=1)
        self.mu = modulus / (2 * (1 + poisson))
        self.lam = modulus * poisson / ((1 + poisson) * (1 - 2 * poisson))
        self.c = resistance * modulus
        self.masses = density[tets].mean(axis=1) * self.volumes

    def stretches(self, positions: Array) -> tuple[Array, Array, Array]:
        """u, signed stretches, v^T of every tet's deformation gradient."""
        edges = np.stack([positions[self.tets[:, k]] - positions[self.tets[:, 0]] for k in (1, 2, 3)], axis=2)
        u, s, vt = np.linalg.svd(edges @ self.inverse_edges)
        for turned in (np.linalg.det(u) < 0, np.linalg.det(vt) < 0):
            s[turned, 2] *= -1
        u[np.linalg.det(u) < 0, :, 2] *= -1
        vt[np.linalg.det(vt) < 0, 2, :] *= -1
        return u, s, vt

    def forces(self, positions: Array, used: NDArray[np.bool_] | None = None) -> Array:
        """f of M a + f = 0, of all tets or of some."""
        u, s, vt = self.stretches(positions)
        s = np.maximum(s, 0.1)
        green = (s**2 - 1) / 2
        volume = s.prod(axis=1, keepdims=True)
        stress = s * (2 * self.mu[:, None] * green + self.lam[:, None] * green.sum(axis=1, keepdims=True))
        stress -= self.c[:, None] * np.maximum(1 - volume, 0) ** 2 / 576 * volume / s
        piola = (u * stress[:, None, :]) @ vt
        if used is not None:
            piola[~used] = 0
        at_corners = self.volumes[:, None, None] * (piola @ self.inverse_edges.transpose(0, 2, 1))
        forces = np.zeros_like(positions)
        for k in range(3):
            np.add.at(forces, self.tets[:, k + 1], at_corners[:, :, k])
            np.add.at(forces, self.tets[:, 0], -at_corners[:, :, k])
        return forces

    def mass_product(self, values: Array) -> Array:
        """The consistent mass matrix times values."""
        corners = values[self.tets]
        share = self.masses[:, None, None] / 20 * (corners + corners.sum(axis=1, keepdims=True))
        product = np.zeros_like(values)
        np.add.at(product, self.tets, share)
        return product
