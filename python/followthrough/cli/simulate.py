# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough simulate`: fills in a sequence's secondary motion."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from followthrough.cli.progress import with_progress
from followthrough.npz_files import require_output_folder
from followthrough.sequences import Sequence
from followthrough.simulation import (
    DEFAULT_DAMPING_RATIO,
    DEFAULT_STIFFNESS,
    load_constants,
    simulate,
    uniform_constants,
)
from followthrough.springs import Springs

AVAILABLE_SOLVERS = ("springs",)
PLANNED_SOLVERS = ("implicit-euler", "central-differences")


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "simulate",
        help="fill in a sequence's secondary motion with a solver",
        description="Run a solver over a sequence file and write the sequence with its array `dynamic` filled in. "
        "The first frame is the reference's; constrained vertices follow the reference exactly.",
    )
    parser.add_argument("sequence", metavar="SEQ.npz", type=Path, help="sequence file")
    parser.add_argument("-o", "--output", metavar="OUT.npz", type=Path, required=True, help="where to write the result")
    parser.add_argument("--solver", metavar="NAME", default="springs", help="springs (default)")
    parser.add_argument(
        "--springs",
        metavar="SPRINGS.npz",
        type=Path,
        help="constants of every vertex: arrays ks (n,), 1/s², and kd (n,), 1/s",
    )
    parser.add_argument(
        "--stiffness", metavar="KS", type=float, help=f"ks of every vertex, 1/s² (default {DEFAULT_STIFFNESS:g})"
    )
    parser.add_argument(
        "--damping",
        metavar="KD",
        type=float,
        help=f"kd of every vertex, 1/s (default {DEFAULT_DAMPING_RATIO:g} of critical damping, 2 sqrt(ks))",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    if args.solver not in AVAILABLE_SOLVERS:
        known = "is not available in this version" if args.solver in PLANNED_SOLVERS else "is not a solver"
        raise ValueError(f"--solver: {args.solver} {known}, expected {' or '.join(AVAILABLE_SOLVERS)}")
    if args.springs is not None and (args.stiffness is not None or args.damping is not None):
        raise ValueError(
            "--springs: found together with --stiffness or --damping, expected either the file or the numbers"
        )
    require_output_folder(args.output)
    sequence = Sequence.load(args.sequence)
    if args.springs is not None:
        stiffness, damping = load_constants(args.springs, sequence.vertex_count)
    else:
        stiffness, damping = uniform_constants(sequence.vertex_count, args.stiffness, args.damping)
    solver = Springs(stiffness, damping, sequence.dt, sequence.constrained)
    result = simulate(sequence, solver, lambda frames: with_progress(frames, "simulate", quiet=args.quiet))
    result.save(args.output)
    print(f"{args.output}: {result.frame_count} frames of {result.vertex_count} vertices")
    return 0
