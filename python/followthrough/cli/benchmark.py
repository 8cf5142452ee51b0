# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough benchmark`: every solver's time and error side by side on this machine."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

from followthrough import _core
from followthrough.benchmarking import plot
from followthrough.benchmarking.machine import this_machine
from followthrough.benchmarking.measurement import Frames, SizeResult, measure
from followthrough.benchmarking.methods import METHODS, emulator, select
from followthrough.benchmarking.report import Benchmark, as_markdown, as_values
from followthrough.benchmarking.scene import LEAST_VERTICES, make_scene
from followthrough.cli import benchmark_emulator
from followthrough.cli.progress import with_progress
from followthrough.npz_files import written_whole

SIZES = (1500, 5000, 15000, 40000)
FRAMES = 96
SECONDS = 600.0


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "benchmark",
        help="time every solver beside its error",
        description="Let a soft body dance at several sizes, and print how long a frame takes with every solver and quality, and how "
        "far it is from the converged simulation. Every solver takes a frame before any takes the next, in rotating order. "
        "The table is Markdown.",
        epilog=f"methods: {', '.join(method.name for method in METHODS)}",
    )
    parser.add_argument(
        "--sizes",
        metavar="N",
        type=int,
        nargs="+",
        default=list(SIZES),
        help="numbers of vertices (default %(default)s)",
    )
    parser.add_argument(
        "--frames", metavar="N", type=int, default=FRAMES, help="frames at each size (default %(default)s)"
    )
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=float,
        default=SECONDS,
        help="time for everything (default %(default)g): a size that has spent its share stops early, and what is left out is said",
    )
    parser.add_argument(
        "--solvers",
        metavar="NAME",
        nargs="+",
        help="methods below, or all of a solver, as implicit-euler (default: all)",
    )
    parser.add_argument(
        "--weights",
        metavar="WEIGHTS.npz",
        type=Path,
        nargs="+",
        default=[],
        help="also measure the emulator with these weights, as emulator/WEIGHTS",
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=int,
        nargs="+",
        help="numbers of threads; each is measured (default: all that there are)",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        type=Path,
        help="also write benchmark.md, benchmark.json and benchmark.png there",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    benchmark_emulator.add_parser(parser.add_subparsers(title="more benchmarks", dest="benchmark", metavar="emulator"))


def run(args: argparse.Namespace) -> int:
    """Do it."""
    if args.benchmark == "emulator":
        return benchmark_emulator.run(args)
    for path in args.weights:
        if sum(other.stem == path.stem for other in args.weights) > 1:
            raise ValueError(f"--weights: found two files {path.name}, expected another name for each")
    methods = select(args.solvers, [*METHODS, *(emulator(path) for path in args.weights)])
    threads = list(dict.fromkeys(args.threads or [_core.threads()]))
    _check(args, threads)
    pictures = args.output is not None
    if pictures and (missing := plot.missing_package()):
        print(f"followthrough: warning: no plot will be made: {missing}", file=sys.stderr)
        pictures = False
    machine = this_machine()
    sizes: list[SizeResult] = []
    left_out: list[str] = []
    end = time.perf_counter() + args.seconds
    for place, vertices in enumerate(sorted(set(args.sizes))):
        left = end - time.perf_counter()
        share = left / (len(set(args.sizes)) - place)
        if share <= 0:
            left_out.append(f"{vertices} vertices, as the {args.seconds:g} seconds were spent")
            continue
        begun = time.perf_counter()
        scene = make_scene(vertices, args.frames)
        size = measure(
            scene,
            methods,
            threads,
            share - (time.perf_counter() - begun),
            _progress(vertices, args.quiet),
        )
        sizes.append(size)
        if size.frames < size.frames_wanted:
            left_out.append(
                f"{size.frames_wanted - size.frames} of {size.frames_wanted} frames at {size.vertices} vertices, "
                f"as their share of the {args.seconds:g} seconds was spent"
            )
    benchmark = Benchmark(machine, sizes, left_out)
    table = as_markdown(benchmark)
    values = json.dumps(as_values(benchmark))
    if args.output is not None:
        _write(args.output, table, values)
        if pictures:
            plot.write_plot(benchmark, args.output / "benchmark.png")
    print(values if args.json else table, end="\n" if args.json else "")
    return 0


def _check(args: argparse.Namespace, threads: list[int]) -> None:
    for name, values, least in (
        ("sizes", args.sizes, LEAST_VERTICES),
        ("frames", [args.frames], 1),
        ("threads", threads, 1),
    ):
        for value in values:
            if value < least:
                raise ValueError(f"--{name}: found {value}, expected {least} or more")
    if not args.seconds > 0:
        raise ValueError(f"--seconds: found {args.seconds:g}, expected more than 0")
    if args.output is None:
        return
    folder = args.output if args.output.exists() else args.output.parent
    if not folder.is_dir():
        raise ValueError(
            f"--output: {folder} is no folder, expected the folder to write to, or a new one in one that is there"
        )
    if not os.access(folder, os.W_OK):
        raise ValueError(f"--output: {folder} cannot be written to")


def _progress(vertices: int, quiet: bool) -> Frames:
    return lambda frames: with_progress(frames, f"{vertices} vertices", quiet=quiet)


def _write(folder: Path, table: str, values: str) -> None:
    folder.mkdir(exist_ok=True)
    for name, text in (("benchmark.md", table), ("benchmark.json", values + "\n")):
        with written_whole(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
