# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough benchmark emulator`: the native kernel beside PyTorch, ONNX Runtime and the finite elements."""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

from followthrough.benchmarking import plot
from followthrough.benchmarking.emulator_report import speed_markdown, speed_values, write_speed_plot
from followthrough.benchmarking.emulator_speed import measure_speed, published_weights
from followthrough.benchmarking.machine import this_machine
from followthrough.benchmarking.measurement import SizeResult
from followthrough.benchmarking.methods import MethodUnavailableError
from followthrough.benchmarking.report import Benchmark
from followthrough.benchmarking.scene import LEAST_VERTICES, make_scene_of_free
from followthrough.benchmarking.whole_frame import WholeFrame, measure_whole_frame
from followthrough.cli.progress import with_progress
from followthrough.emulator_weights import EmulatorWeights

SIZES = (400, 1000, 2500, 6000, 15000, 40000)
THREADS = (1, 2)
FRAMES = 48
SECONDS = 600.0


def add_parser(subparsers: Any) -> None:
    """Add the arguments."""
    parser = subparsers.add_parser(
        "emulator",
        help="time the emulator beside other runtimes and the finite elements",
        description="Time the native kernel on a network of the published size beside PyTorch and ONNX Runtime on the same weights, "
        "each with its fastest batching, the shipped network, and the finite elements; everything takes a frame before anything takes "
        "the next, and so does the matrix product that the peak is measured with. Then a whole frame of a character, with its parts. "
        "What is not installed is left out, and that is said.",
    )
    # Options of the same name have defaults of their own here.
    parser.add_argument(
        "--sizes", metavar="N", type=int, nargs="+", default=list(SIZES), help="free vertices (default %(default)s)"
    )
    parser.add_argument(
        "--threads",
        metavar="N",
        type=int,
        nargs="+",
        default=list(THREADS),
        help="numbers of threads; each is measured (default %(default)s)",
    )
    parser.add_argument(
        "--frames", metavar="N", type=int, default=FRAMES, help="frames at each size (default %(default)s)"
    )
    parser.add_argument(
        "--seconds",
        metavar="S",
        type=float,
        default=SECONDS,
        help="time for everything (default %(default)g); what does not fit is left out, and that is said",
    )
    parser.add_argument(
        "--weights",
        metavar="WEIGHTS.npz",
        type=Path,
        help="a network of the paper with one ring that sees the reference (default: random weights of the published size)",
    )
    parser.add_argument("--plot", metavar="FILE.png", type=Path, help="also draw time a frame over free vertices")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    threads = list(dict.fromkeys(args.threads))
    _check(args, threads)
    weights = published_weights() if args.weights is None else _load(args.weights)
    sizes: list[SizeResult] = []
    left_out: list[str] = []
    machine = this_machine()
    wanted = sorted(set(args.sizes))
    end = time.perf_counter() + args.seconds
    whole_frames: list[WholeFrame] = []
    status = 0
    try:
        try:
            whole_frames = measure_whole_frame(
                threads, args.frames, lambda frames: with_progress(frames, "a whole frame", quiet=args.quiet)
            )
        except MethodUnavailableError as error:
            left_out.append(f"a whole frame, as {error}")
        for place, free in enumerate(wanted):
            begun = time.perf_counter()
            share = (end - begun) / (len(wanted) - place)
            if share <= 0:
                left_out.append(f"{free} free vertices, as the {args.seconds:g} seconds were spent")
                continue
            scene = make_scene_of_free(free, args.frames)
            rest = share - (time.perf_counter() - begun)

            def progress(frames: range, title: str = f"{free} free vertices") -> Any:
                return with_progress(frames, title, quiet=args.quiet)

            size = measure_speed(scene, weights, threads, rest, progress)
            sizes.append(size)
            if size.frames < size.frames_wanted:
                left_out.append(
                    f"{size.frames_wanted - size.frames} of {size.frames_wanted} frames at {size.free_vertices} free vertices, "
                    f"as their share of the {args.seconds:g} seconds was spent"
                )
    except KeyboardInterrupt:
        if not sizes:
            raise
        print("followthrough: interrupted, only whole sizes are shown", file=sys.stderr)
        left_out += [f"{free} free vertices, as the run was interrupted" for free in wanted[len(sizes) :]]
        status = 130
    benchmark = Benchmark(machine, sizes, left_out)
    if args.plot is not None:
        write_speed_plot(benchmark, args.plot)
    print(
        json.dumps(speed_values(benchmark, whole_frames)) if args.json else speed_markdown(benchmark, whole_frames),
        end="\n" if args.json else "",
    )
    return status


def _check(args: argparse.Namespace, threads: list[int]) -> None:
    for name, values, least in (
        ("sizes", args.sizes, LEAST_VERTICES),
        ("frames", [args.frames], 4),
        ("threads", threads, 1),
    ):
        for value in values:
            if value < least:
                raise ValueError(f"--{name}: found {value}, expected {least} or more")
    if not args.seconds > 0:
        raise ValueError(f"--seconds: found {args.seconds:g}, expected more than 0")
    if args.plot is not None:
        if not args.plot.parent.is_dir():
            raise ValueError(f"--plot: {args.plot.parent} is no folder, expected a file in one that is there")
        if args.plot.suffix.lower() != ".png":
            raise ValueError(f"--plot: found {args.plot.name}, expected a name that ends in .png")
        if missing := plot.missing_package():
            raise ValueError(f"--plot: {missing}")


def _load(path: Path) -> EmulatorWeights:
    weights = EmulatorWeights.load(path)
    if weights.newton is not None or weights.rings != 1 or not weights.sees_reference:
        raise ValueError(
            f"--weights: {path} holds a {weights.network} network, expected a patch network of one ring that sees the reference"
        )
    return weights
