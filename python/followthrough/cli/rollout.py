# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough rollout`: fills in a sequence's secondary motion with the emulator."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from followthrough.cli import solver_options
from followthrough.cli.progress import with_progress
from followthrough.npz_files import require_output_folder
from followthrough.sequences import Sequence
from followthrough.simulation import simulate


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "rollout",
        help="fill in a sequence's secondary motion with the emulator",
        description="Run the emulator over a sequence file, each frame from its own last ones, and write the sequence with its "
        "array `dynamic` filled in. The first frame is the reference's; constrained vertices follow the reference exactly.",
    )
    parser.add_argument("sequence", metavar="SEQ.npz", type=Path, help="sequence file")
    parser.add_argument("-o", "--output", metavar="OUT.npz", type=Path, required=True, help="where to write the result")
    solver_options.add_emulator_arguments(parser)
    solver_options.add_gravity_argument(parser)
    solver_options.add_amplitude_argument(parser)
    parser.set_defaults(solver="emulator")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    require_output_folder(args.output)
    sequence = Sequence.load(args.sequence)
    emulator = solver_options.make_solver(sequence, args)
    result = simulate(sequence, emulator, lambda frames: with_progress(frames, "rollout", quiet=args.quiet))
    result.save(args.output)
    print(f"{args.output}: {result.frame_count} frames of {result.vertex_count} vertices")
    return 0
