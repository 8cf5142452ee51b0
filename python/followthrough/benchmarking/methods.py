# SPDX-License-Identifier: GPL-3.0-or-later
"""What is measured: a table of methods. Another one is another line of `METHODS`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from followthrough.benchmarking.scene import Scene
from followthrough.character import FloatArray
from followthrough.elastic import (
    QUALITIES,
    CentralDifferences,
    ImplicitEuler,
    MaterialName,
    PredictorCorrector,
    Quality,
)
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, are_shipped
from followthrough.quasistatic import OverQuasistatic, Quasistatic
from followthrough.simulation import uniform_constants
from followthrough.solver import Solver, SolverState
from followthrough.springs import Springs

#: The method that the others are measured against.
TRUTH = "implicit-euler/converged"


class MethodUnavailableError(Exception):
    """A method cannot run here; says why, and what would make it run."""


@dataclass(frozen=True)
class Method:
    """A solver with its settings.

    Attributes
    ----------
    name
        "solver" or "solver/setting".
    summary
        What it is, in a few words.
    make
        Makes it for a scene; raises `MethodUnavailableError` where it cannot.
    work
        What the last step has taken, by name, of a solver that `make` has made; averaged over the frames.
    forecast
        How many seconds a frame will take, of a solver that may take minutes for one; it may step the solver.
    notes
        What there is to say about a solver that `make` has made.
    same_bits
        Whether results must not depend on the number of threads.
    has_errors
        Whether single frames from true history say anything about it.
    afterglow
        Seconds for which threads of its own go on spinning after a frame; whoever comes next waits for as long.
    """

    name: str
    summary: str
    make: Callable[[Scene], Solver]
    work: Callable[[Any], Mapping[str, float]] = lambda solver: {}
    forecast: Callable[[Any, Scene], float] | None = None
    notes: Callable[[Any], list[str]] = lambda solver: []
    same_bits: bool = True
    has_errors: bool = True
    afterglow: float = 0.0


class SkinningAlone(Solver):
    """No secondary motion at all: what a method must be better than."""

    def __init__(self) -> None:
        super().__init__(None)
        self._positions = np.zeros((0, 3))

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return len(self._positions)

    def reset(self, reference: ArrayLike) -> FloatArray:
        """Start over on the reference."""
        self._positions = np.asarray(reference, dtype=np.float64)
        return self._positions

    def step(self, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """The reference."""
        self._positions = np.array(reference, dtype=np.float64)
        return self._positions

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames that are known: nothing is carried over."""
        self._positions = reference[-1]

    def state(self) -> SolverState:
        """The positions."""
        return SolverState((self._positions,), 0)

    def restore(self, state: SolverState) -> None:
        """Go back to a state."""
        (self._positions,) = state.arrays


def _springs(scene: Scene) -> Solver:
    sequence = scene.sequence
    return Springs(*uniform_constants(sequence.vertex_count), sequence.dt, sequence.constrained)


def _implicit_euler(quality: Quality, material: MaterialName) -> Callable[[Scene], Solver]:
    return lambda scene: ImplicitEuler(
        scene.body(material), scene.sequence.constrained, scene.sequence.dt, quality=quality
    )


def few_iterations(most: int) -> Method:
    """Backward Euler with at most so many Newton iterations a frame: points of its time over its error between the qualities."""

    def make(scene: Scene) -> Solver:
        sequence = scene.sequence
        return ImplicitEuler(scene.body(), sequence.constrained, sequence.dt, quality="fine", most_iterations=most)

    return Method(f"implicit-euler/{most}", f"backward Euler, at most {most} Newton iterations", make, _newton_work)


def _over_quasistatic(springs: bool) -> Callable[[Scene], Solver]:
    return lambda scene: OverQuasistatic(
        Quasistatic(scene.body(), scene.sequence.constrained, quality="fine"), _springs(scene) if springs else None
    )


def _equilibrium_work(solver: OverQuasistatic) -> Mapping[str, float]:
    last = solver.last_solve
    return {"Newton": last.iterations, "CG": last.linear_iterations, "unconverged": not last.converged}


def _newton_work(solver: ImplicitEuler) -> Mapping[str, float]:
    last = solver.last_step
    return {"Newton": last.iterations, "CG": last.linear_iterations, "unconverged": not last.converged}


def _correction_work(solver: PredictorCorrector) -> Mapping[str, float]:
    last = solver.last_step
    return {"Newton": last.iterations, "CG": last.linear_iterations}


def _central_differences(substeps: int | None) -> Callable[[Scene], Solver]:
    return lambda scene: CentralDifferences(
        scene.body(), scene.sequence.constrained, scene.sequence.dt, substeps=substeps
    )


def _central_differences_forecast(solver: CentralDifferences, scene: Scene) -> float:
    # A frame at rest: one that bends and squeezes needs shorter substeps still.
    solver.reset(scene.sequence.reference[0])
    begun = time.perf_counter()
    solver.step(scene.sequence.reference[0])
    return time.perf_counter() - begun


def _elastic(quality: Quality, material: MaterialName) -> Method:
    name, what = (
        ("implicit-euler", "the sequence's material")
        if material == "invertible-stvk"
        else ("corotational", "the cheap material")
    )
    return Method(
        f"{name}/{quality}", f"backward Euler, {what}, {quality}", _implicit_euler(quality, material), _newton_work
    )


def _emulator(weights: Callable[[], EmulatorWeights], corrections: int = 0) -> Callable[[Scene], Solver]:
    def make(scene: Scene) -> Solver:
        sequence = scene.sequence
        predictor = Emulator.of_sequence(sequence, weights(), edge_length=scene.edge)
        if not corrections:
            return predictor
        corrector = ImplicitEuler(
            scene.body(), sequence.constrained, sequence.dt, quality="fine", most_iterations=corrections
        )
        return PredictorCorrector(predictor, corrector)

    return make


def _shipped_weights() -> EmulatorWeights:
    if not are_shipped():
        raise MethodUnavailableError("this version brings no weights for it (--weights measures those of a file)")
    return EmulatorWeights.shipped()


def _shipped_emulator(corrections: int) -> Method:
    what = f"followed by at most {corrections} iteration{'s' if corrections > 1 else ''} of the true solver"
    return Method(
        f"emulator/{corrections}",
        f"the network, {what if corrections else 'alone'}",
        _emulator(_shipped_weights, corrections),
        _correction_work if corrections else lambda solver: {},
    )


METHODS: tuple[Method, ...] = (
    Method("skinning", "no secondary motion", lambda scene: SkinningAlone()),
    Method("springs", "zero-restlength springs, default constants", _springs),
    Method("quasistatic", "every pose's static equilibrium", _over_quasistatic(False), _equilibrium_work),
    Method(
        "quasistatic/springs",
        "springs that follow the static equilibria",
        _over_quasistatic(True),
    ),
    *(_shipped_emulator(corrections) for corrections in (0, 1, 2, 3)),
    *(_elastic(quality, "invertible-stvk") for quality in QUALITIES),
    *(_elastic(quality, "corotational") for quality in QUALITIES[:-1]),  # converged has the same error
    *(
        Method(
            f"central-differences/{substeps or 'stable'}",
            f"explicit, {substeps or 'as many as are stable'} substeps",
            _central_differences(substeps),
            lambda solver: {"substeps": solver.last_substeps},
            _central_differences_forecast,
        )
        for substeps in (100, None)
    ),
)


def emulator(path: Path) -> Method:
    """The emulator with the weights of a file.

    Raises
    ------
    ValueError
        Where it holds none.
    """
    weights = EmulatorWeights.load(path)
    return Method(
        f"emulator/{path.stem}",
        f"{weights.network} network of {weights.parameter_count:,} parameters",
        _emulator(lambda: weights),
    )


def select(names: SequenceOf[str] | None, methods: SequenceOf[Method] = METHODS) -> list[Method]:
    """The methods of these names, or of these solvers (what is before the slash), in the table's order; None: all.

    Raises
    ------
    ValueError
        Where a name is none of theirs.
    """
    if names is None:
        return list(methods)
    known = dict.fromkeys(name for method in methods for name in (method.name.split("/")[0], method.name))
    for name in names:
        if name not in known:
            raise ValueError(f"solvers: found {name}, expected some of {', '.join(known)}")
    return [method for method in methods if method.name in names or method.name.split("/")[0] in names]


def truth_method() -> Method:
    """The method that the others are measured against."""
    return next(method for method in METHODS if method.name == TRUTH)
