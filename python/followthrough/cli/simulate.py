# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough simulate`: fills in a sequence's secondary motion."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from followthrough.cli.progress import with_progress
from followthrough.elastic import MATERIALS, QUALITIES, ElasticBody, ImplicitEuler
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

if TYPE_CHECKING:
    from followthrough.secondary_motion import Solver

AVAILABLE_SOLVERS = ("springs", "implicit-euler")
PLANNED_SOLVERS = ("central-differences",)


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
    parser.add_argument("--solver", metavar="NAME", default="springs", help="springs (default) or implicit-euler")
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
    elastic = parser.add_argument_group("implicit-euler", "finite elements of the sequence's own material")
    elastic.add_argument(
        "--quality", metavar="NAME", choices=QUALITIES, help=f"{', '.join(QUALITIES[:-1])} or {QUALITIES[-1]} (default)"
    )
    elastic.add_argument(
        "--tolerance",
        metavar="T",
        type=float,
        help="relative residual at which a frame has converged (default: the quality's)",
    )
    elastic.add_argument(
        "--material", metavar="NAME", choices=MATERIALS, help=f"{MATERIALS[0]} (default) or {MATERIALS[1]}"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    if args.solver not in AVAILABLE_SOLVERS:
        known = "is not available in this version" if args.solver in PLANNED_SOLVERS else "is not a solver"
        raise ValueError(f"--solver: {args.solver} {known}, expected {' or '.join(AVAILABLE_SOLVERS)}")
    solver_options = {
        "springs": ("springs", "stiffness", "damping"),
        "implicit-euler": ("quality", "tolerance", "material"),
    }
    for other, names in solver_options.items():
        for name in names:
            if other != args.solver and getattr(args, name) is not None:
                raise ValueError(f"--{name}: found together with --solver {args.solver}, expected only with {other}")
    if args.springs is not None and (args.stiffness is not None or args.damping is not None):
        raise ValueError(
            "--springs: found together with --stiffness or --damping, expected either the file or the numbers"
        )
    require_output_folder(args.output)
    sequence = Sequence.load(args.sequence)
    if args.solver == "implicit-euler":
        solver = _elastic_solver(sequence, args)
    else:
        solver = _springs(sequence, args)
    unconverged = []

    def progress(frames: range) -> Iterator[int]:
        for frame in with_progress(frames, "simulate", quiet=args.quiet):
            yield frame
            if isinstance(solver, ImplicitEuler) and not solver.last_step.converged:
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


def _springs(sequence: Sequence, args: argparse.Namespace) -> Solver:
    if args.springs is not None:
        stiffness, damping = load_constants(args.springs, sequence.vertex_count)
    else:
        stiffness, damping = uniform_constants(sequence.vertex_count, args.stiffness, args.damping)
    return Springs(stiffness, damping, sequence.dt, sequence.constrained)


def _elastic_solver(sequence: Sequence, args: argparse.Namespace) -> Solver:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        body = ElasticBody.of_sequence(sequence, args.material or MATERIALS[0])
    for warning in caught:
        print(f"followthrough: warning: {args.sequence}: {warning.message}", file=sys.stderr)
    return ImplicitEuler(
        body, sequence.constrained, sequence.dt, quality=args.quality or "converged", tolerance=args.tolerance
    )
