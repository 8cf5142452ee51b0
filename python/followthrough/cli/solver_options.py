# SPDX-License-Identifier: GPL-3.0-or-later
"""Arguments that choose a solver and its constants, the same for every command that runs one."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from followthrough.cli.progress import with_progress
from followthrough.controls import Amplified, RelativeDamping
from followthrough.elastic import (
    MATERIALS,
    QUALITIES,
    CentralDifferences,
    ElasticBody,
    ImplicitEuler,
    MaterialName,
    PredictorCorrector,
)
from followthrough.emulator import PRECISIONS, Emulator
from followthrough.emulator_weights import EmulatorWeights
from followthrough.quasistatic import OverQuasistatic, Quasistatic
from followthrough.simulation import DEFAULT_DAMPING_RATIO, DEFAULT_STIFFNESS, load_constants, uniform_constants
from followthrough.springs import Springs

if TYPE_CHECKING:
    from followthrough.sequences import Sequence
    from followthrough.settings import SolverName
    from followthrough.solver import Solver

#: Options of the static equilibria that springs may hang on.
LAYER_OPTIONS = ("quality", "tolerance", "material", "gravity")

#: Solver -> the options that it has.
OPTIONS = {
    "springs": ("springs", "stiffness", "damping", "over", "gravity"),
    "emulator": ("weights", "corrections", "relative_damping", "edge_length", "gravity", "precision"),
    "implicit-euler": ("quality", "tolerance", "material", "gravity", "mass_damping", "stiffness_damping"),
    "central-differences": ("substeps", "material", "gravity"),
    "quasistatic": LAYER_OPTIONS,
}

#: Options that tell which solver is meant where none is named.
_TELLING = {"emulator": ("weights",), "springs": ("springs", "stiffness", "damping", "over")}


def add_arguments(parser: argparse.ArgumentParser, default: SolverName = "springs") -> None:
    """Add them to a command that runs a solver where none is named."""
    parser.set_defaults(default_solver=default)
    usual = "springs (default)" if default == "springs" else "springs (default where one of their options is given)"
    whose = "default where --weights is given" if default == "springs" else "default"
    parser.add_argument(
        "--solver",
        metavar="NAME",
        help=f"{usual}, emulator ({whose}), or finite elements of the sequence's own material: "
        "implicit-euler, central-differences, or quasistatic (no motion of its own: every frame rests in its pose)",
    )
    springs = parser.add_argument_group("springs")
    springs.add_argument(
        "--springs",
        metavar="SPRINGS.npz",
        type=Path,
        help="constants of every vertex: arrays ks (n,), 1/s², and kd (n,), 1/s",
    )
    springs.add_argument(
        "--stiffness", metavar="KS", type=float, help=f"ks of every vertex, 1/s² (default {DEFAULT_STIFFNESS:g})"
    )
    springs.add_argument(
        "--damping",
        metavar="KD",
        type=float,
        help=f"kd of every vertex, 1/s (default {DEFAULT_DAMPING_RATIO:g} of critical damping, 2 sqrt(ks))",
    )
    springs.add_argument(
        "--over",
        choices=("quasistatic",),
        help="what the springs hang on: the static equilibrium of each pose, with the options of that solver "
        "(default: the skinned positions)",
    )
    add_emulator_arguments(parser)
    elastic = parser.add_argument_group("finite elements")
    elastic.add_argument(
        "--quality",
        choices=QUALITIES,
        help=f"of implicit-euler and quasistatic: {', '.join(QUALITIES[:-1])} or {QUALITIES[-1]} (default)",
    )
    elastic.add_argument(
        "--tolerance",
        metavar="T",
        type=float,
        help="of implicit-euler and quasistatic: relative residual at which a frame has converged (default: the quality's)",
    )
    elastic.add_argument(
        "--substeps",
        metavar="N",
        type=int,
        help="of central-differences: steps a frame (default: as many as are stable)",
    )
    elastic.add_argument(
        "--material",
        choices=MATERIALS,
        help=f"{MATERIALS[0]} (default) or {MATERIALS[1]}, linear and without resistance",
    )
    elastic.add_argument(
        "--mass-damping", metavar="ALPHA", type=float, help="of implicit-euler: Rayleigh's alpha, 1/s (default 0)"
    )
    elastic.add_argument(
        "--stiffness-damping", metavar="BETA", type=float, help="of implicit-euler: Rayleigh's beta, s (default 0)"
    )
    add_gravity_argument(parser)


def add_gravity_argument(parser: argparse.ArgumentParser) -> None:
    """Of every solver."""
    parser.add_argument("--gravity", metavar=("X", "Y", "Z"), type=float, nargs=3, help="m/s² (default: none)")


def add_amplitude_argument(parser: argparse.ArgumentParser) -> None:
    """Of every solver, too."""
    parser.add_argument(
        "--amplitude",
        metavar="A",
        type=float,
        default=1.0,
        help="how far the motion goes: 0 is the reference, 1 (default) what the solver says",
    )


def add_weights_arguments(group: argparse._ArgumentGroup) -> None:
    """How the emulator is run, whatever it moves."""
    group.add_argument(
        "--weights",
        metavar="WEIGHTS.npz",
        type=Path,
        help="the network's weights (default: those that come with followthrough)",
    )
    group.add_argument(
        "--corrections",
        metavar="N",
        type=int,
        help="Newton iterations of the true solver, at most, that start from each of the network's frames (default 0)",
    )


def add_layer_arguments(group: argparse._ArgumentGroup) -> None:
    """Options of the static equilibria alone."""
    group.add_argument("--quality", choices=QUALITIES, help=f"{', '.join(QUALITIES[:-1])} or {QUALITIES[-1]} (default)")
    group.add_argument("--tolerance", metavar="T", type=float, help="relative residual (default: the quality's)")
    group.add_argument("--material", choices=MATERIALS, help=f"{MATERIALS[0]} (default) or {MATERIALS[1]}")
    group.add_argument("--gravity", metavar=("X", "Y", "Z"), type=float, nargs=3, help="m/s² (default: none)")


def add_emulator_arguments(parser: argparse.ArgumentParser) -> None:
    """Those of the emulator alone."""
    emulator = parser.add_argument_group("emulator")
    add_weights_arguments(emulator)
    emulator.add_argument(
        "--relative-damping",
        metavar="R",
        type=float,
        help="rate at which velocities relative to the reference die down, 1/s; 2 w is critical for what swings at w radians a second "
        "(default 0)",
    )
    emulator.add_argument(
        "--edge-length",
        metavar="L",
        type=float,
        help="edge of the volume's cubes, m (default: found from the tets' volumes)",
    )
    emulator.add_argument(
        "--precision",
        choices=PRECISIONS,
        help="of the paper's network: float32 (default), or bfloat16, which is faster and coarser and needs a processor with AMX "
        "or AMD's AVX-512 (from Zen 4 on)",
    )


def check(args: argparse.Namespace) -> None:
    """Choose the default solver, refuse one that is not there, and options of another one.

    Raises
    ------
    ValueError
        Naming the option.
    """
    if args.solver is None:
        asked_for = [
            name for name in ("emulator", "springs") if any(getattr(args, key) is not None for key in _TELLING[name])
        ]
        args.solver = (asked_for or [args.default_solver])[0]
    over = OPTIONS[args.over] if args.solver == "springs" and args.over is not None else ()
    check_owners(args, OPTIONS | {"springs": OPTIONS["springs"] + over})
    if args.springs is not None and (args.stiffness is not None or args.damping is not None):
        raise ValueError(
            "--springs: found together with --stiffness or --damping, expected either the file or the numbers"
        )


def check_owners(args: argparse.Namespace, options: Mapping[str, tuple[str, ...]]) -> None:
    """Refuse a solver that has no entry in `options`, and options that only others have."""
    if args.solver not in options:
        raise ValueError(f"--solver: {args.solver} is not a solver, expected {' or '.join(options)}")
    for name in sorted({name for names in options.values() for name in names} - set(options[args.solver])):
        if getattr(args, name) is not None:
            owners = " or ".join(solver for solver, names in options.items() if name in names)
            flag = name.replace("_", "-")
            raise ValueError(f"--{flag}: found together with --solver {args.solver}, expected only with {owners}")


def make_solver(sequence: Sequence, args: argparse.Namespace) -> Solver:
    """The solver that the arguments ask for, made for a sequence. What is odd about it goes to standard error.

    Raises
    ------
    ValueError
        Where sequence and arguments do not make one.
    """
    solver = _make_plain_solver(sequence, args)
    amplitude = getattr(args, "amplitude", 1.0)
    return solver if amplitude == 1.0 else Amplified(solver, amplitude)


def _make_plain_solver(sequence: Sequence, args: argparse.Namespace) -> Solver:
    if args.solver == "emulator":
        return make_emulator(sequence, args)
    if args.solver == "springs":
        return _make_springs(sequence, args)
    if args.solver == "quasistatic":
        return OverQuasistatic(_make_layer(sequence, args.sequence, args))
    body, gravity = _make_body(sequence, args), args.gravity or (0.0, 0.0, 0.0)
    if args.solver == "central-differences":
        return CentralDifferences(body, sequence.constrained, sequence.dt, substeps=args.substeps, gravity=gravity)
    return ImplicitEuler(
        body,
        sequence.constrained,
        sequence.dt,
        quality=args.quality or "converged",
        tolerance=args.tolerance,
        gravity=gravity,
        mass_damping=args.mass_damping or 0.0,
        stiffness_damping=args.stiffness_damping or 0.0,
    )


def _make_springs(sequence: Sequence, args: argparse.Namespace) -> Solver:
    _require_free_vertex(sequence, args.sequence)
    if args.springs is not None:
        stiffness, damping = load_constants(args.springs, sequence.vertex_count)
    else:
        stiffness, damping = uniform_constants(sequence.vertex_count, args.stiffness, args.damping)
    gravity = (0.0, 0.0, 0.0) if args.gravity is None or args.over is not None else args.gravity
    springs = Springs(stiffness, damping, sequence.dt, sequence.constrained, gravity=gravity)
    if args.over is not None:  # equilibria sag as it is
        return OverQuasistatic(_make_layer(sequence, args.sequence, args), springs)
    if len(sequence.tets):  # springs can do without; but not with some that no other solver takes
        sound_body(sequence, args.sequence)
    return springs


def _make_layer(sequence: Sequence, path: Path, args: argparse.Namespace) -> Quasistatic:
    return Quasistatic(
        sound_body(sequence, path, args.material or MATERIALS[0]),
        sequence.constrained,
        quality=args.quality or "converged",
        tolerance=args.tolerance,
        gravity=args.gravity or (0.0, 0.0, 0.0),
    )


def over_equilibria(sequence: Sequence, path: Path, args: argparse.Namespace) -> Sequence:
    """The sequence with every pose's static equilibrium for its reference. Frames that have not converged are warned of."""
    layer = _make_layer(sequence, path, args)
    reference = np.empty_like(sequence.reference)
    unconverged = []
    for frame in with_progress(range(sequence.frame_count), "equilibria", quiet=args.quiet):
        reference[frame] = layer.solve(sequence.reference[frame])
        if not layer.last_solve.converged:
            unconverged.append(frame)
    if unconverged and args.quality in (None, "converged"):
        print(
            f"followthrough: warning: {path}: {len(unconverged)} equilibria have not converged, the first is frame {unconverged[0]}",
            file=sys.stderr,
        )
    return replace(sequence, reference=reference)


def first_frames(sequence: Sequence, count: int) -> Sequence:
    """The first frames of a sequence.

    Raises
    ------
    ValueError
        Where it has fewer.
    """
    if count > sequence.frame_count:
        raise ValueError(f"--frames: found {count}, expected at most the {sequence.frame_count} that the sequence has")
    dynamic = None if sequence.dynamic is None else sequence.dynamic[:count]
    return replace(sequence, reference=sequence.reference[:count], dynamic=dynamic)


def _make_body(sequence: Sequence, args: argparse.Namespace) -> ElasticBody:
    return sound_body(sequence, args.sequence, args.material or MATERIALS[0])


def sound_body(sequence: Sequence, path: Path, material: MaterialName = MATERIALS[0]) -> ElasticBody:
    """The sequence as an elastic body; every solver wants the same of it. Inverted tets are warned of.

    Raises
    ------
    ValueError
        Naming the file, where tets have no volume, there are none, or no vertex is free.
    """
    _require_free_vertex(sequence, path)
    with _warnings_of(path):
        try:
            return ElasticBody.of_sequence(sequence, material)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


def _require_free_vertex(sequence: Sequence, path: Path) -> None:
    if sequence.constrained.all():
        raise ValueError(f"{path}: constrained: found no free vertex, expected at least one")


def make_emulator(sequence: Sequence, args: argparse.Namespace) -> Solver:
    """The emulator with the weights that the arguments name, or those that come with the package, and what corrects and damps it."""
    weights = EmulatorWeights.shipped() if args.weights is None else EmulatorWeights.load(args.weights)
    body = sound_body(sequence, args.sequence)
    if (args.corrections or 0) < 0:
        raise ValueError(f"--corrections: found {args.corrections}, expected 0 or more")
    gravity = args.gravity or (0.0, 0.0, 0.0)
    with _warnings_of(args.sequence):
        solver: Solver = Emulator.of_sequence(
            sequence, weights, gravity=gravity, edge_length=args.edge_length, precision=args.precision or PRECISIONS[0]
        )
    if args.corrections:
        corrector = ImplicitEuler(
            body,
            sequence.constrained,
            sequence.dt,
            quality="fine",
            most_iterations=args.corrections,
            gravity=gravity,
        )
        solver = PredictorCorrector(solver, corrector)
    if args.relative_damping:
        solver = RelativeDamping(solver, args.relative_damping, sequence.dt)
    return solver


@contextmanager
def _warnings_of(path: Path) -> Iterator[None]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        print(f"followthrough: warning: {path}: {warning.message}", file=sys.stderr)
