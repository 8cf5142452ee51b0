# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough evaluate`: how far a solver is from a sequence's true motion."""

from __future__ import annotations

import argparse
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

from followthrough.cli import solver_options
from followthrough.cli.progress import with_progress
from followthrough.evaluation import Scores, evaluate
from followthrough.sequences import Sequence
from followthrough.settings import default_solver


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "evaluate",
        help="measure a solver against a sequence's true motion",
        description="Run a solver over a sequence file whose array `dynamic` holds the true motion, and print how far it is off: "
        "root mean square errors over all vertices in m, from true history (single frame) and on its own "
        "(the first 24, 48 and all frames), the elastic energy in J, and the time.",
    )
    parser.add_argument("sequence", metavar="SEQ.npz", type=Path, help="sequence file with the true motion")
    solver_options.add_arguments(parser, default_solver())
    parser.add_argument("--json", action="store_true", help="print one JSON object; infinite scores are null")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    solver_options.check(args)
    sequence = Sequence.load(args.sequence)
    if sequence.dynamic is None:
        raise ValueError(
            f"{args.sequence}: found no dynamic, expected the true motion (followthrough simulate fills it in)"
        )
    if sequence.frame_count < 2:
        raise ValueError(f"{args.sequence}: dynamic: found one frame, expected at least two")
    if not len(sequence.tets):
        raise ValueError(f"{args.sequence}: tets: found none, expected at least one (the elastic energy needs them)")
    solver = solver_options.make_solver(sequence, args)
    scores = evaluate(sequence, solver, lambda frames: with_progress(frames, "evaluate", quiet=args.quiet))
    print(as_json(scores) if args.json else as_text(scores))
    return 0


def as_json(scores: Scores) -> str:
    """One JSON object."""
    values = asdict(scores)
    values["energy"] = {name: values.pop(name) for name in ("predicted", "truth")}
    return json.dumps(_without_infinity(values))


def as_text(scores: Scores) -> str:
    """Lines to read."""
    lines = [f"{scores.frames} frames of {scores.vertices} vertices, {scores.free_vertices} of them free"]
    for label, value in (
        ("single frame", scores.single_frame),
        ("rollout 24", scores.rollout_24),
        ("rollout 48", scores.rollout_48),
        ("rollout all", scores.rollout_all),
    ):
        lines.append(f"{label:<14}{value:.3g} m")
    for label, energy in (("energy", scores.predicted), ("true energy", scores.truth)):
        lines.append(f"{label:<14}{energy.min:.3g} to {energy.max:.3g} J, standard deviation {energy.stdev:.3g} J")
    lines.append(f"{'time':<14}{scores.ms_per_frame:.3g} ms a frame")
    return "\n".join(lines)


def _without_infinity(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_infinity(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
