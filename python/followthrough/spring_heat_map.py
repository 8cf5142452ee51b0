# SPDX-License-Identifier: GPL-3.0-or-later
"""Where springs are stiff, damped, and how they swing, as a picture ([ZS] figure 8), and the scales that all such pictures share."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from followthrough.character import FloatArray, IntArray
from followthrough.npz_files import written_whole

Quantity = Literal["stiffness", "damping", "regime"]
QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)
#: What each of them is called on a legend.
LABELS = {"stiffness": "log10 ks (1/s²)", "damping": "log10 kd (1/s)", "regime": "kd² - 4 ks (1/s²), ± log10"}
#: Of the greyness of vertices that nothing was learned of.
UNKNOWN_COLOUR = (0.55, 0.55, 0.55)
#: Where kd² - 4 ks is smaller than this, 1/s², it counts as critical damping.
_CRITICAL = 1.0
#: Low, middle and high end of the scales: blue, grey, red, and between them straight lines.
_DIVERGING = np.array(
    [(0.23, 0.30, 0.75), (0.45, 0.67, 0.98), (0.87, 0.87, 0.87), (0.96, 0.60, 0.47), (0.71, 0.02, 0.15)]
)
_SEQUENTIAL = np.array(
    [(0.27, 0.00, 0.33), (0.23, 0.32, 0.55), (0.13, 0.57, 0.55), (0.37, 0.79, 0.38), (0.99, 0.91, 0.14)]
)


@dataclass(frozen=True)
class HeatMap:
    """One quantity of some vertices on a colour scale.

    Attributes
    ----------
    quantity
        What is shown.
    values : (n,) float64
        On the scale: log10 ks, log10 kd, or the sign of kd² - 4 ks times log10(1 + its size).
    low, high
        Ends of the scale; `regime` has them the same distance from 0, which is critical damping.
    known : (n,) bool
        Vertices that have the quantity at all.
    """

    quantity: Quantity
    values: FloatArray
    low: float
    high: float
    known: NDArray[np.bool_]

    @property
    def label(self) -> str:
        """What the legend says."""
        return LABELS[self.quantity]

    def colours(self) -> FloatArray:
        """Red, green and blue (n, 3), 0 to 1, as they are shown (sRGB)."""
        colours = palette(self.quantity, (self.values - self.low) / (self.high - self.low))
        colours[~self.known] = UNKNOWN_COLOUR
        return colours


def palette(quantity: Quantity, places: FloatArray) -> FloatArray:
    """Colours (n, 3) at places (n,) from 0 to 1 of a quantity's scale."""
    stops = _DIVERGING if quantity == "regime" else _SEQUENTIAL
    at = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(np.clip(places, 0.0, 1.0), at, stops[:, channel]) for channel in range(3)], axis=1)


def heat_map(
    quantity: Quantity, stiffness: FloatArray, damping: FloatArray, known: NDArray[np.bool_] | None = None
) -> HeatMap:
    """Put a quantity on its scale, which reaches from the 1st to the 99th percentile of what is known.

    Parameters
    ----------
    quantity
        Which.
    stiffness, damping : (n,) float
        ks, 1/s², and kd, 1/s.
    known : (n,) bool, optional
        Vertices that have constants.

    Raises
    ------
    ValueError
        Where there is no such quantity.
    """
    if quantity not in QUANTITIES:
        raise ValueError(f"quantity: found {quantity!r}, expected {', '.join(QUANTITIES)}")
    there = np.ones(len(stiffness), dtype=np.bool_) if known is None else known
    tiny = np.finfo(np.float64).tiny
    if quantity == "regime":
        difference = damping**2 - 4.0 * stiffness
        values = np.sign(difference) * np.log10(1.0 + np.abs(difference) / _CRITICAL)
        high = float(np.percentile(np.abs(values[there]), 99)) if there.any() else 1.0
        low = -high
    else:
        values = np.log10(np.maximum(stiffness if quantity == "stiffness" else damping, tiny))
        low, high = (float(end) for end in np.percentile(values[there], [1, 99])) if there.any() else (0.0, 1.0)
    if high - low < 1e-6:
        low, high = low - 0.5, high + 0.5
    return HeatMap(quantity, values, low, high, there)


def missing_package() -> str | None:
    """What to install before `write_heat_map`; None where nothing is missing."""
    if importlib.util.find_spec("matplotlib") is None:
        return "matplotlib is not installed (pip install followthrough[plot])"
    return None


def boundary_faces(tets: IntArray) -> IntArray:
    """Faces (f, 3) of a tet mesh that only one tet has: its surface."""
    faces = np.concatenate([tets[:, corners] for corners in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    outside: IntArray = faces[np.sort(first[count == 1])]
    return outside


def write_heat_map(
    path: Path | str,
    positions: FloatArray,
    faces: IntArray,
    stiffness: FloatArray,
    damping: FloatArray,
    known: NDArray[np.bool_] | None = None,
) -> None:
    """Write log ks, log kd and kd² - 4 ks of a character side by side as a picture, all or nothing.

    Parameters
    ----------
    path
        .png, or another ending that matplotlib knows.
    positions : (n, 3) float
        m.
    faces : (f, 3) int
        Triangles; without any, vertices are drawn as dots.
    stiffness, damping, known
        As for `heat_map`; what is not known is grey.

    Raises
    ------
    ImportError
        Where matplotlib is missing.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LinearSegmentedColormap, Normalize
    from matplotlib.figure import Figure

    across, up, depth = _view(positions)
    size = np.ptp(positions[:, [across, up]], axis=0)
    height = 5.0 * float(np.clip(size[1] / max(float(size[0]), 1e-12), 0.5, 2.0))
    figure = Figure(figsize=(13.0, height), layout="constrained")
    for panel, quantity in zip(figure.subplots(1, 3), QUANTITIES, strict=True):
        shown = heat_map(quantity, stiffness, damping, known)
        _draw(panel, positions, faces, shown.colours(), (across, up, depth))
        panel.set(aspect="equal", title=shown.label)
        panel.axis("off")
        panel.autoscale_view()
        stops = palette(quantity, np.linspace(0.0, 1.0, 64))
        scale = ScalarMappable(
            Normalize(shown.low, shown.high), LinearSegmentedColormap.from_list(quantity, list(stops))
        )
        figure.colorbar(scale, ax=panel, orientation="horizontal", shrink=0.8)
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=120)


def _view(positions: FloatArray) -> tuple[int, int, int]:
    """Axes that go across, up and away: z is up, unless the character lies flat there; away is the shorter of the others."""
    sizes = np.ptp(positions, axis=0)
    up = 2 if sizes[2] >= 0.2 * sizes.max() and sizes[2] >= 0.5 * sizes[1] else 1
    others = sorted({0, 1, 2} - {up}, key=lambda axis: -sizes[axis])
    return others[0], up, others[1]


def _draw(panel: Any, positions: FloatArray, faces: IntArray, colours: FloatArray, axes: tuple[int, int, int]) -> None:
    from matplotlib.collections import PolyCollection

    across, up, depth = axes
    if not len(faces):
        order = np.argsort(-positions[:, depth], kind="stable")
        panel.scatter(positions[order, across], positions[order, up], c=colours[order], s=4)
        return
    corners = positions[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    facing = np.abs(normals[:, depth]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    order = np.argsort(-corners[:, :, depth].mean(axis=1), kind="stable")
    shaded = colours[faces].mean(axis=1) * (0.75 + 0.25 * facing)[:, None]
    panel.add_collection(
        PolyCollection(
            list(corners[order][:, :, [across, up]]), facecolors=shaded[order], edgecolors=shaded[order], linewidths=0.3
        )
    )
