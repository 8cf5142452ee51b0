# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against time, a panel a size, as PNG. Needs matplotlib, the plot extra."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

from followthrough.benchmarking.measurement import Result, SizeResult
from followthrough.benchmarking.methods import TRUTH
from followthrough.benchmarking.report import Benchmark
from followthrough.npz_files import written_whole

_MARKERS = "os^Dv"
#: 60 frames a second.
_REAL_TIME_MS = 1000 / 60


def missing_package() -> str | None:
    """What to install first; None where nothing is missing."""
    if importlib.util.find_spec("matplotlib") is None:
        return "matplotlib is not installed (pip install followthrough[plot])"
    return None


def write_plot(benchmark: Benchmark, path: Path) -> None:
    """Write the plot, all or nothing.

    Raises
    ------
    ImportError
        Where matplotlib is missing.
    """
    from matplotlib.figure import Figure

    columns = max(min(2, len(benchmark.sizes)), 1)
    rows = max(math.ceil(len(benchmark.sizes) / columns), 1)
    figure = Figure(figsize=(6.2 * columns, 4.6 * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True).flat
    for panel, size in zip(panels, benchmark.sizes, strict=False):
        _draw(panel, size)
    for panel in list(figure.axes)[len(benchmark.sizes) :]:
        panel.remove()
    handles: dict[str, Any] = {}
    for panel in figure.axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    figure.legend(
        list(handles.values()), list(handles), loc="outside lower center", ncols=3, fontsize="small", frameon=False
    )
    figure.suptitle(
        "Filled: the whole rollout. Hollow: one frame from true history. Bars: 10th to 90th percentile.",
        fontsize="small",
    )
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=120)


def _draw(panel: Any, size: SizeResult) -> None:
    panel.set_title(f"{size.vertices:,} vertices, {size.frames} frames", fontsize="medium")
    panel.set(xscale="log", yscale="log", xlabel="ms a frame", ylabel="error, m (root mean square)")
    panel.grid(True, which="major", alpha=0.3)
    panel.axvline(_REAL_TIME_MS, color="0.6", linestyle=":", label="60 frames a second")
    names = list(dict.fromkeys(result.name for result in size.results))
    threads = sorted({result.threads for result in size.results})
    for result in size.results:
        if result.skipped:
            continue
        colour = f"C{names.index(result.name) % 10}"
        if result.name == TRUTH:
            panel.axvline(result.ms_median, color=colour, linestyle="--", label=_label(result, threads))
        elif result.name == "skinning":
            if math.isfinite(result.rollout_all):
                panel.axhline(result.rollout_all, color=colour, linestyle="--", label="skinning")
        else:
            _draw_point(
                panel, result, colour, _MARKERS[threads.index(result.threads) % len(_MARKERS)], _label(result, threads)
            )


def _draw_point(panel: Any, result: Result, colour: str, marker: str, label: str) -> None:
    spread = [[result.ms_median - result.ms_low], [result.ms_high - result.ms_median]]
    if math.isfinite(result.rollout_all) and result.rollout_all > 0:
        panel.errorbar(
            result.ms_median, result.rollout_all, xerr=spread, fmt=marker, color=colour, capsize=2, label=label
        )
    if math.isfinite(result.single_frame) and result.single_frame > 0:
        panel.plot(result.ms_median, result.single_frame, marker, color=colour, fillstyle="none")


def _label(result: Result, threads: list[int]) -> str:
    name = "converged, the truth" if result.name == TRUTH else result.name
    return name if len(threads) == 1 else f"{name}, {result.threads} threads"
