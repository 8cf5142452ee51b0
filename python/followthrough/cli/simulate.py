# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough simulate`: fills in a sequence's secondary motion."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from followthrough.cli import solver_options
from followthrough.cli.progress import with_progress
from followthrough.npz_files import require_output_folder
from followthrough.sequences import Sequence
from followthrough.simulation import simulate
from followthrough.surface_springs import load_embedding, on_surface


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "simulate",
        help="fill in a sequence's secondary motion with a solver",
        description="Run a solver over a sequence file and write the sequence with its array `dynamic` filled in. "
        "The first frame is the reference's, or its equilibrium where that is asked for; constrained vertices follow the "
        "reference exactly.",
    )
    parser.add_argument("sequence", metavar="SEQ.npz", type=Path, help="sequence file")
    parser.add_argument("-o", "--output", metavar="OUT.npz", type=Path, required=True, help="where to write the result")
    parser.add_argument(
        "--surface",
        metavar="VOLUME.npz",
        type=Path,
        help="of springs: simulate the surface that tetrahedralize embedded in this volume; OUT is then the surface's sequence",
    )
    solver_options.add_arguments(parser)
    solver_options.add_amplitude_argument(parser)
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def _of_surface(sequence: Sequence, args: argparse.Namespace) -> Sequence:
    """What the springs' options mean on a surface: equilibria are the volume's, everything else is the surface's."""
    if args.over is not None:
        sequence = solver_options.over_equilibria(sequence, args.sequence, args)
        args.over = None
    return on_surface(sequence, *load_embedding(args.surface, sequence))


def run(args: argparse.Namespace) -> int:
    """Do it."""
    solver_options.check(args)
    require_output_folder(args.output)
    sequence = Sequence.load(args.sequence)
    if args.surface is not None:
        if args.solver != "springs":
            raise ValueError(f"--surface: found together with --solver {args.solver}, expected only with springs")
        sequence = _of_surface(sequence, args)
    solver = solver_options.make_solver(sequence, args)
    unconverged = []

    def progress(frames: range) -> Iterator[int]:
        for frame in with_progress(frames, "simulate", quiet=args.quiet):
            yield frame
            if not solver.converged:
                unconverged.append(frame)

    result = simulate(sequence, solver, progress)
    result.save(args.output)
    print(f"{args.output}: {result.frame_count} frames of {result.vertex_count} vertices")
    if unconverged and args.quality in (None, "converged"):
        print(
            f"followthrough: warning: {len(unconverged)} frames have not converged, the first is {unconverged[0]}",
            file=sys.stderr,
        )
    return 0
