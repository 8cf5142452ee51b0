# SPDX-License-Identifier: GPL-3.0-or-later
"""A benchmark's results as Markdown and as plain values for JSON."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from followthrough.benchmarking.dancer import DT
from followthrough.benchmarking.machine import Machine
from followthrough.benchmarking.measurement import Result, SizeResult
from followthrough.benchmarking.methods import TRUTH
from followthrough.benchmarking.scene import YOUNGS_MODULUS

_HEADINGS = (
    "method",
    "threads",
    "ms a frame",
    "10th to 90th percentile",
    "times as fast as converged",
    "single frame",
    "rollout 24",
    "rollout all",
    "largest",
    "a frame takes",
)


@dataclass(frozen=True)
class Benchmark:
    """A whole run.

    Attributes
    ----------
    machine
        What it ran on.
    sizes
        What was measured, by number of vertices.
    left_out
        What was asked for and not measured, and why.
    """

    machine: Machine
    sizes: list[SizeResult]
    left_out: list[str]


def as_values(benchmark: Benchmark) -> dict[str, Any]:
    """Dictionaries, lists, strings and numbers; infinity and what was not measured are None."""
    values = asdict(benchmark)
    values["scene"] = {"youngs_modulus": YOUNGS_MODULUS, "dt": DT}
    plain: dict[str, Any] = _plain(values)
    return plain


def as_markdown(benchmark: Benchmark) -> str:
    """A heading and a table for each size."""
    blocks = list(conditions(benchmark.machine))
    blocks[-1] += "; `largest` is one vertex in one frame."
    for size in benchmark.sizes:
        blocks.append(heading(size))
        blocks.append(_table(size))
        blocks += [f"{result.name} was left out: {result.skipped}." for result in size.results if result.skipped]
        blocks += [f"{name}: {note}." for name, note in notes(size)]
        if size.unconverged:
            blocks.append(f"The truth itself has not converged in {size.unconverged} of {size.frames} frames.")
    blocks += [f"Left out: {what}." for what in benchmark.left_out]
    return "\n\n".join(blocks) + "\n"


def conditions(machine: Machine) -> tuple[str, str]:
    """What it ran on, and what was measured: a sentence that may go on."""
    return (
        f"{machine.processor}, {machine.cores} cores{_load(machine)}; {machine.system}, Python {machine.python}, "
        f"NumPy {machine.numpy}, Followthrough {machine.followthrough}.",
        f"A body 5 m tall of {YOUNGS_MODULUS:g} Pa dances, {DT:.4g} s a frame. Errors against `{TRUTH}` in m, root mean square over "
        "frames, vertices and axes",
    )


def _load(machine: Machine) -> str:
    return "" if machine.load is None else f" (load {machine.load:g} before)"


def heading(size: SizeResult) -> str:
    """Of a size: its counts."""
    frames = f"{size.frames} frames"
    if size.frames < size.frames_wanted:
        frames = f"{size.frames} of {size.frames_wanted} frames"
    return (
        f"### {size.vertices:,} vertices\n\n{size.free_vertices:,} of them free, {size.tets:,} tets, edge {size.edge:.3g} m, "
        f"s = {size.dimensionless_stiffness:.3g}; {frames}."
    )


def notes(size: SizeResult) -> list[tuple[str, str]]:
    """By method, each once, however many numbers of threads there are."""
    return list(dict.fromkeys((result.name, note) for result in size.results for note in result.notes))


def _table(size: SizeResult) -> str:
    true_times = {result.threads: result.ms_median for result in size.results if result.name == TRUTH}
    lines = [row(_HEADINGS), row(["---"] + ["---:"] * (len(_HEADINGS) - 2) + ["---"])]
    for result in size.results:
        if not result.skipped:
            lines.append(row(_cells(result, true_times.get(result.threads))))
    return "\n".join(lines)


def _cells(result: Result, true_time: float | None) -> list[str]:
    truth = result.name == TRUTH
    return [
        result.name,
        str(result.threads),
        _milliseconds(result.ms_median),
        f"{_milliseconds(result.ms_low)} to {_milliseconds(result.ms_high)}",
        "" if true_time is None else f"{true_time / result.ms_median:,.3g}",
        *("truth" if truth else error_cell(value) for value in (result.single_frame, result.rollout_24)),
        *("truth" if truth else error_cell(value) for value in (result.rollout_all, result.largest)),
        ", ".join(f"{amount:.3g} {name}" for name, amount in result.work.items() if name != "unconverged"),
    ]


def _milliseconds(value: float) -> str:
    return f"{value:.3g}" if value < 1000 else f"{value:,.0f}"


def error_cell(value: float | None) -> str:
    """An error in m."""
    if value is None:
        return ""
    return f"{value:.3g}" if math.isfinite(value) else "explodes"


def row(cells: Any) -> str:
    """A row of a Markdown table."""
    return f"| {' | '.join(cells)} |"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
