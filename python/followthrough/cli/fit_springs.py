# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough fit-springs`: learns the springs' constants from simulated motion."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from followthrough import spring_heat_map
from followthrough.cli import solver_options
from followthrough.cli.progress import with_progress
from followthrough.npz_files import require_output_folder
from followthrough.sequences import Sequence
from followthrough.spring_fit import FitSettings, FitStatus, SpringFit, Training, fit_springs, share_stiff_constants
from followthrough.springs import Springs
from followthrough.surface_springs import load_embedding, on_surface

#: Share of frames that `--robust` alone leaves out, as [ZS] does.
_ROBUST_SHARE = 0.1
#: Springs are made, and frames stepped, so many times for the time that shared constants save.
_TIMED = 21


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    settings = FitSettings()
    parser = subparsers.add_parser(
        "fit-springs",
        help="learn the springs' constants from simulated motion",
        description="Find the spring constants of every vertex that come closest to the `dynamic` of one or more sequences of the "
        "same character. A hundred frames of one lively motion are enough. `simulate --solver springs --springs` uses the result.",
    )
    parser.add_argument(
        "sequences", metavar="SEQ.npz", type=Path, nargs="+", help="sequence files with `dynamic`, of the same volume"
    )
    parser.add_argument(
        "-o", "--output", metavar="SPRINGS.npz", type=Path, required=True, help="where to write ks and kd"
    )
    parser.add_argument("--frames", metavar="N", type=int, help="learn from the first N frames of each sequence alone")
    parser.add_argument(
        "--robust",
        metavar="SHARE",
        type=float,
        nargs="?",
        const=_ROBUST_SHARE,
        default=0.0,
        help=f"fit, leave out this share of each vertex's frames, those of the greatest error, and fit again (default {_ROBUST_SHARE:g})",
    )
    parser.add_argument(
        "--regularization",
        metavar="R",
        type=float,
        default=settings.regularization,
        help="how strongly motion that springs cannot describe holds them back; 0: not at all (default %(default)g)",
    )
    parser.add_argument(
        "--share-stiff",
        action="store_true",
        help="one pair of constants for all stiff, overdamped vertices; says what that saves and costs",
    )
    parser.add_argument(
        "--surface",
        metavar="VOLUME.npz",
        type=Path,
        help="put springs on the surface that tetrahedralize embedded in this volume, not on the volume's vertices",
    )
    parser.add_argument(
        "--seed", metavar="S", type=int, default=settings.seed, help="of the genetic algorithm (default %(default)s)"
    )
    parser.add_argument(
        "--heat-map", metavar="OUT.png", type=Path, help="also draw log ks, log kd and kd² - 4 ks on the character"
    )
    layer = parser.add_argument_group("what the springs hang on")
    layer.add_argument(
        "--over",
        choices=("quasistatic",),
        help="the static equilibrium of each pose (default: the skinned positions); simulate with the same --over",
    )
    solver_options.add_layer_arguments(layer)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of sentences")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    _check(args)
    sequences = [_load(path, args.frames) for path in args.sequences]
    _require_same_volume(sequences, args.sequences)
    motions, shown = _motions(sequences, args)
    settings = FitSettings(regularization=args.regularization, dropped_share=args.robust, seed=args.seed)
    begun = time.perf_counter()

    def blocks(of_vertices: Any) -> Iterable[range]:
        return with_progress(of_vertices, "fit", "block", args.quiet)

    fit = fit_springs(motions, settings, skipped=shown.constrained, blocks=blocks)
    seconds = time.perf_counter() - begun
    report = _values(fit, seconds)
    if args.share_stiff:
        fit, report["shared"] = _shared(fit, motions, shown)
    fit.save(args.output)
    if args.heat_map is not None:
        faces = spring_heat_map.boundary_faces(shown.tets)
        spring_heat_map.write_heat_map(
            args.heat_map, shown.rest_positions, faces, fit.stiffness, fit.damping, fit.learned
        )
    if args.json:
        print(json.dumps(report))
    else:
        _print(args, report)
    return 0


def _check(args: argparse.Namespace) -> None:
    require_output_folder(args.output)
    if args.frames is not None and args.frames < 2:
        raise ValueError(f"--frames: found {args.frames}, expected 2 or more")
    if not 0.0 <= args.robust <= 0.9:
        raise ValueError(f"--robust: found {args.robust:g}, expected a share of 0 to 0.9")
    if args.seed < 0:
        raise ValueError(f"--seed: found {args.seed}, expected 0 or more")
    if args.over is None:
        for name in solver_options.LAYER_OPTIONS:
            if getattr(args, name) is not None:
                raise ValueError(f"--{name}: found without --over quasistatic, expected only with it")
    if args.heat_map is not None:
        require_output_folder(args.heat_map)
        if missing := spring_heat_map.missing_package():
            raise ValueError(f"--heat-map: {missing}")


def _load(path: Path, frames: int | None) -> Sequence:
    sequence = Sequence.load(path)
    if sequence.dynamic is None:
        raise ValueError(
            f"{path}: found no dynamic, expected a simulated motion to learn from (followthrough simulate "
            "--solver implicit-euler fills it in)"
        )
    if sequence.frame_count < 2:
        raise ValueError(f"{path}: found one frame, expected two or more: nothing can be learned from a still")
    if sequence.constrained.all():
        raise ValueError(f"{path}: constrained: found no free vertex, expected at least one")
    if frames is None:
        return sequence
    return solver_options.first_frames(sequence, frames)


def _require_same_volume(sequences: list[Sequence], paths: list[Path]) -> None:
    first = sequences[0]
    for sequence, path in zip(sequences, paths, strict=True):
        if not (np.array_equal(sequence.tets, first.tets) and np.array_equal(sequence.constrained, first.constrained)):
            raise ValueError(
                f"{path}: found tets or constrained vertices that are not those of {paths[0]}, expected the same character"
            )


def _motions(sequences: list[Sequence], args: argparse.Namespace) -> tuple[list[Training], Sequence]:
    """What is learned from, and the first sequence as its springs see it."""
    embedding = None if args.surface is None else load_embedding(args.surface, sequences[0])
    motions = []
    shown = sequences[0]
    for place, (sequence, path) in enumerate(zip(sequences, args.sequences, strict=True)):
        based = sequence
        if args.over is not None:
            based = solver_options.over_equilibria(sequence, path, args)
        if embedding is not None:
            based = on_surface(based, *embedding)
        if place == 0:
            shown = based
        assert based.dynamic is not None  # _load has seen to it
        motions.append(Training(based.reference, based.dynamic, based.dt))
    return motions, shown


def _values(fit: SpringFit, seconds: float) -> dict[str, Any]:
    fitted = fit.status == FitStatus.FITTED
    return {
        "vertices": len(fit.status),
        "fitted": int(fitted.sum()),
        "rigid": int((fit.status == FitStatus.RIGID).sum()),
        "unmoved": int((fit.status == FitStatus.UNMOVED).sum()),
        "constrained": int((fit.status == FitStatus.SKIPPED).sum()),
        "overdamped": int((fit.overdamped & fitted).sum()),
        "frames": fit.steps,
        "rmse_before": fit.reference_rmse,
        "rmse": fit.rmse,
        "seconds": seconds,
    }


def _shared(fit: SpringFit, motions: list[Training], shown: Sequence) -> tuple[SpringFit, dict[str, Any]]:
    """Share constants, and measure what that does."""
    shared, stiff = share_stiff_constants(fit, motions)

    def springs(of: SpringFit) -> Springs:
        return Springs(of.stiffness, of.damping, shown.dt, shown.constrained)

    before, after = (_median_seconds(lambda of=of: springs(of)) for of in (fit, shared))
    steps = []
    for of in (fit, shared):
        solver = springs(of)
        solver.reset(shown.reference[0])
        steps.append(_median_seconds(lambda solver=solver: solver.step(shown.reference[0])))
    facts = {
        "vertices": int(stiff.sum()),
        "ks": float(shared.stiffness[stiff][0]) if stiff.any() else None,
        "kd": float(shared.damping[stiff][0]) if stiff.any() else None,
        "rmse": shared.rmse,
        "setup_ms_before": 1000.0 * before,
        "setup_ms": 1000.0 * after,
        "step_ms_before": 1000.0 * steps[0],
        "step_ms": 1000.0 * steps[1],
    }
    return shared, facts


def _median_seconds(work: Any) -> float:
    seconds = []
    for _ in range(_TIMED):
        begun = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - begun)
    return float(np.median(seconds))


def _print(args: argparse.Namespace, report: dict[str, Any]) -> None:
    print(
        f"{args.output}: {report['fitted']} of {report['vertices']} vertices fitted on {report['frames']} frames in "
        f"{report['seconds']:.1f} s, {report['overdamped']} of them overdamped"
    )
    print(
        f"error {report['rmse']:.4g} m, without springs {report['rmse_before']:.4g} m (root mean square, free vertices)"
    )
    for name, meaning in (
        ("rigid", "never leave their reference and are made stiff"),
        ("unmoved", "are never accelerated and keep the usual constants"),
    ):
        if report[name]:
            print(f"followthrough: {report[name]} vertices {meaning}", file=sys.stderr)
    if "shared" in report:
        shared = report["shared"]
        print(
            f"{shared['vertices']} stiff, overdamped vertices share one pair of constants: error {shared['rmse']:.4g} m; making "
            f"the springs takes {shared['setup_ms']:.3g} ms instead of {shared['setup_ms_before']:.3g}, a frame "
            f"{shared['step_ms']:.3g} ms instead of {shared['step_ms_before']:.3g}"
        )
