# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator's speed as Markdown, as plain values for JSON, and as a plot."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from followthrough.benchmarking.emulator_speed import PUBLISHED, SHIPPED, Speeds, gflops, speeds
from followthrough.benchmarking.measurement import Result, SizeResult
from followthrough.benchmarking.methods import TRUTH
from followthrough.benchmarking.report import Benchmark, as_values, conditions, error_cell, heading, notes, row
from followthrough.benchmarking.whole_frame import PARTS, WholeFrame
from followthrough.npz_files import written_whole

_HEADINGS = (
    "method",
    "threads",
    "ms a frame",
    "10th to 90th percentile",
    "µs a free vertex",
    "GFLOP/s",
    "of sgemm",
    "single frame",
    "rollout all",
)


def speed_values(benchmark: Benchmark, whole_frames: list[WholeFrame]) -> dict[str, Any]:
    """As `report.as_values`, with `speeds` at every size, and `whole_frames`."""
    values = as_values(benchmark)
    values["whole_frames"] = [asdict(found) for found in whole_frames]
    for described, size in zip(values["sizes"], benchmark.sizes, strict=True):
        described["speeds"] = [asdict(found) for found in speeds(size)]
        for told, result in zip(described["results"], size.results, strict=True):
            told["us_a_free_vertex"] = None if result.skipped else _microseconds(result, size)
    return values


def speed_markdown(benchmark: Benchmark, whole_frames: list[WholeFrame]) -> str:
    """A heading, a table and what follows from it for each size, and a table of whole frames."""
    blocks = list(conditions(benchmark.machine))
    blocks[-1] += "."
    for size in benchmark.sizes:
        found = speeds(size)
        blocks += [heading(size), _table(size, {speed.threads: speed.peak_gflops for speed in found})]
        skipped = dict.fromkeys(f"{r.name} was left out: {r.skipped}." for r in size.results if r.skipped)
        blocks += list(skipped)
        blocks += [f"{name}: {note}." for name, note in notes(size)]
        blocks += [sentence for speed in found if (sentence := _sentence(speed))]
    if whole_frames:
        blocks += _whole_frames(whole_frames)
    blocks += [f"Left out: {what}." for what in benchmark.left_out]
    return "\n\n".join(blocks) + "\n"


def write_speed_plot(benchmark: Benchmark, path: Path) -> None:
    """Time a frame over free vertices, a curve a method and number of threads; all or nothing. Needs matplotlib."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 6.5), layout="constrained")
    panel = figure.subplots()
    curves: dict[tuple[str, int], list[tuple[float, float]]] = {}
    for size in benchmark.sizes:
        for result in size.results:
            if not result.skipped and not result.name.startswith("sgemm"):
                curves.setdefault((result.name, result.threads), []).append((size.free_vertices, result.ms_median))
        for speed in speeds(size):
            if speed.equal_error is not None and not speed.equal_error.bound:
                label = "finite elements at the shipped network's error"
                curves.setdefault((label, speed.threads), []).append((size.free_vertices, speed.equal_error.ms))
    names = list(dict.fromkeys(name for name, _ in curves))
    threads = sorted({number for _, number in curves})
    for (name, number), points in curves.items():
        style = "-" if number == threads[0] else "--"
        wide = 2.2 if name in (PUBLISHED, SHIPPED) or name.startswith("finite") else 1.0
        place = names.index(name)
        # Ten colours, then the same with another marker.
        panel.plot(
            *zip(*points, strict=True),
            style,
            marker="os"[place // 10 % 2],
            color="black" if name.startswith("finite") else f"C{place % 10}",
            linewidth=wide,
            markersize=4,
            label=f"{name}, {number} thread{'s' if number > 1 else ''}",
        )
    panel.set(xscale="log", yscale="log", xlabel="free vertices", ylabel="ms a frame (median)")
    panel.grid(True, which="major", alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, fontsize="x-small", frameon=False)
    with written_whole(path) as temporary:
        figure.savefig(temporary, dpi=120)


def _table(size: SizeResult, peaks: dict[int, float | None]) -> str:
    lines = [row(_HEADINGS), row(["---"] + ["---:"] * (len(_HEADINGS) - 1))]
    for result in size.results:
        if not result.skipped:
            lines.append(row(_cells(result, size, peaks[result.threads])))
    return "\n".join(lines)


def _whole_frames(found: list[WholeFrame]) -> list[str]:
    counts = found[0]
    lines = [
        row(("threads", "ms a frame", "10th to 90th percentile", *PARTS)),
        row(["---:"] * (3 + len(PARTS))),
        *(
            row(
                [
                    str(frame.threads),
                    f"{frame.ms_median:.3g}",
                    f"{frame.ms_low:.3g} to {frame.ms_high:.3g}",
                    *(f"{frame.parts[part]:.3g}" for part in PARTS),
                ]
            )
            for frame in found
        ),
    ]
    return [
        f"### A whole frame\n\nA character of {counts.surface_vertices:,} vertices, its volume of {counts.volume_vertices:,} "
        f"({counts.free_vertices:,} of them free) moved by the shipped network; {counts.frames} frames. The parts are timed one by one.",
        "\n".join(lines),
    ]


def _cells(result: Result, size: SizeResult, peak: float | None) -> list[str]:
    rate = gflops(result)
    judged = not math.isnan(result.single_frame)
    errors = ("truth", "truth") if result.name == TRUTH else (result.single_frame, result.rollout_all)
    return [
        result.name,
        str(result.threads),
        f"{result.ms_median:,.3g}",
        f"{result.ms_low:,.3g} to {result.ms_high:,.3g}",
        "" if result.name.startswith("sgemm") else f"{_microseconds(result, size):.3g}",
        "" if rate is None else f"{rate:.3g}",
        "" if rate is None or peak is None else f"{rate / peak:.0%}",
        *(error if isinstance(error, str) else error_cell(error) if judged else "" for error in errors),
    ]


def _microseconds(result: Result, size: SizeResult) -> float | None:
    value = 1000 * result.ms_median / size.free_vertices
    return value if math.isfinite(value) else None


def _sentence(speed: Speeds) -> str:
    parts = []
    if speed.share_of_peak is not None:
        parts.append(
            f"the published network's kernel reaches {speed.share_of_peak:.0%} of {speed.peak_gflops:.3g} GFLOP/s"
        )
    if speed.over_onnx_runtime is not None:
        parts.append(f"the kernel is {speed.over_onnx_runtime:.2f} times as fast as ONNX Runtime")
    if speed.over_pytorch is not None:
        parts.append(f"the kernel is {speed.over_pytorch:.2f} times as fast as PyTorch")
    if speed.bfloat16_over_onnx_runtime is not None and speed.bfloat16_over_pytorch is not None:
        parts.append(
            f"in bfloat16 it is {speed.bfloat16_over_onnx_runtime:.2f} times as fast as ONNX Runtime and "
            f"{speed.bfloat16_over_pytorch:.2f} times as fast as PyTorch"
        )
    if speed.speed_up is not None and speed.threads > 1:
        parts.append(f"the kernel is {speed.speed_up:.2f} times as fast as with one thread")
    if speed.shipped_share is not None:
        parts.append(f"the shipped network takes {speed.shipped_share:.2f} of the published one's time")
    if speed.shipped_speed_up is not None and speed.threads > 1:
        parts.append(f"the shipped network is {speed.shipped_speed_up:.2f} times as fast as with one thread")
    if speed.equal_error is not None and speed.over_finite_elements is not None:
        equal, ratio = speed.equal_error, speed.over_finite_elements
        bound = f"{equal.bound} " if equal.bound else ""
        # A bound decides only in its own direction.
        if ratio < 1 and equal.bound != "at least":
            verdict = f": the finite elements win by {1 / ratio:.2f} times {'or more' if bound else ''}".rstrip()
        elif ratio >= 1 and equal.bound != "at most":
            verdict = f": the network wins by {ratio:.2f} times {'or more' if bound else ''}".rstrip()
        else:
            verdict = ": which of them wins was not decided"
        parts.append(
            f"at the shipped network's error of {equal.error:.2g} m the finite elements take {bound}{equal.ms:,.3g} ms{verdict}"
        )
    if not parts:
        return ""
    return f"With {speed.threads} thread{'s' if speed.threads > 1 else ''}: {'; '.join(parts)}."
