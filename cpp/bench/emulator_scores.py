# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors and times of the emulator, and of what a sceptic would put in its place, on sequences with their true motion.

Prints a Markdown table: root mean squares over all sequences, in edges of a cube divided by 5 (the paper's units, in which a
character is 5 long and an edge 0.2), single frames from true history, rollouts of 24, 48 and all frames; the least elastic energy, its
standard deviation and the largest, each over that of the truth; milliseconds a frame and microseconds a free vertex, the medians over the
sequences.
"""

from __future__ import annotations

import argparse
import statistics
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from followthrough.benchmarking.methods import SkinningAlone
from followthrough.character import FloatArray
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.emulator import PRECISIONS, Emulator, Precision
from followthrough.emulator_weights import EmulatorWeights
from followthrough.evaluation import Scores, evaluate
from followthrough.newton_weights import PASS_SIZE, START_SIZE, NewtonSchedule, guide_inputs
from followthrough.sequences import Sequence
from followthrough.solver import Solver, SolverState

Maker = Callable[[Sequence], Solver]


class InertiaAlone(SkinningAlone):
    """The last two frames carried on, constrained vertices on the reference."""

    def __init__(self, constrained: NDArray[np.bool_]) -> None:
        super().__init__()
        self._constrained = constrained

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames that are known."""
        self._positions, self._before = dynamic[-1], dynamic[max(len(dynamic) - 2, 0)]

    def state(self) -> SolverState:
        """The last two frames."""
        return SolverState((self._positions, self._before), 0)

    def restore(self, state: SolverState) -> None:
        """Go back to a state."""
        self._positions, self._before = state.arrays

    def step(self, reference: FloatArray, next_reference: FloatArray | None = None) -> FloatArray:
        """One frame further."""
        ahead: FloatArray = 2 * self._positions - self._before
        ahead[self._constrained] = reference[self._constrained]
        self._positions, self._before = ahead, self._positions
        return ahead


def untrained(schedule: NewtonSchedule) -> EmulatorWeights:
    """The same truncated Newton steps, guided by nothing: the start half way between inertia and the reference, every step whole."""
    parameters = {}
    for guide, size in schedule.guides().items():
        parameters[f"{guide}.0.weight"] = np.zeros((size[0], guide_inputs(size)), np.float32)
        bias = np.zeros(size[0], np.float32)
        bias[0] = 0.5 if size == START_SIZE and guide == "start" else 1.0
        parameters[f"{guide}.0.bias"] = bias
    assert PASS_SIZE != START_SIZE
    return EmulatorWeights(parameters, newton=schedule)


def emulator(
    weights: EmulatorWeights,
    most_passes: int | None = None,
    tolerance: float | None = None,
    precision: Precision = "float32",
) -> Maker:
    """An emulator with a number of passes, or a precision, of its own."""
    if weights.newton is not None and most_passes is not None:
        kept = weights.newton.tolerance if tolerance is None else tolerance
        weights = replace(weights, newton=replace(weights.newton, most_passes=most_passes, tolerance=kept))
    return lambda sequence: Emulator.of_sequence(sequence, weights, precision=precision)


def simulation(quality: str) -> Maker:
    """The elastic simulator."""
    return lambda sequence: ImplicitEuler(
        ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt, quality=quality
    )


def with_iterations(weights: EmulatorWeights, iterations: int) -> Maker:
    """An emulator with so many iterations of conjugate gradients a pass."""
    assert weights.newton is not None
    every = (iterations,) * len(weights.newton.iterations)
    return emulator(replace(weights, newton=replace(weights.newton, iterations=every)))


def methods(
    weights: EmulatorWeights, others: list[Path], iterations: list[int], precisions: list[Precision]
) -> dict[str, Maker]:
    """What is compared, by name."""
    found: dict[str, Maker] = {
        "reference only": lambda sequence: SkinningAlone(),
        "inertial guess": lambda sequence: InertiaAlone(sequence.constrained),
    }
    if weights.newton is not None:
        plain = untrained(weights.newton)
        for passes in range(4):
            found[f"guides, {passes} passes"] = emulator(weights, passes, 0.0)
            found[f"no guides, {passes} passes"] = emulator(plain, passes, 0.0)
        for count in iterations:
            found[f"guides, {count} iterations"] = with_iterations(weights, count)
            found[f"no guides, {count} iterations"] = with_iterations(plain, count)
        found["no guides, as shipped"] = emulator(plain)
    found["as shipped"] = emulator(weights)
    for path in others:
        for precision in precisions:
            found[f"{path.stem}, {precision}"] = emulator(EmulatorWeights.load(path), precision=precision)
    for quality in ("preview", "fine"):
        found[f"simulation, {quality}"] = simulation(quality)
    return found


def measured(
    paths: list[Path], compared: dict[str, Maker], frames: int | None = None
) -> dict[str, list[tuple[Scores, float]]]:
    """Scores of every method on every sequence, each with the paper's units a metre of the scene; methods take turns."""
    found: dict[str, list[tuple[Scores, float]]] = {name: [] for name in compared}
    for path in paths:
        sequence = Sequence.load(path)
        if frames:
            assert sequence.dynamic is not None
            sequence = replace(sequence, reference=sequence.reference[:frames], dynamic=sequence.dynamic[:frames])
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            scale = 0.2 / Emulator.of_sequence(sequence, EmulatorWeights.shipped()).edge_length
            for name, make in compared.items():
                found[name].append((evaluate(sequence, make(sequence)), scale))
    return found


def table(scores: dict[str, list[tuple[Scores, float]]]) -> str:
    """A row a method, in Markdown."""
    rows = [
        "| method | single | rollout 24 | rollout 48 | rollout all | energy / truth: min, stdev, max | ms a frame | µs a free vertex |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name, all_scores in scores.items():
        columns = [
            float(np.sqrt(np.mean([(scale * getattr(score, field)) ** 2 for score, scale in all_scores])))
            for field in ("single_frame", "rollout_24", "rollout_48", "rollout_all")
        ]
        energy = ", ".join(
            f"{statistics.median(getattr(s.predicted, kind) / getattr(s.truth, kind) for s, _ in all_scores):.3g}"
            for kind in ("min", "stdev", "max")
        )
        time = statistics.median(score.ms_per_frame for score, _ in all_scores)
        each = statistics.median(1000 * score.ms_per_frame / score.free_vertices for score, _ in all_scores)
        rows.append(
            f"| {name} | {' | '.join(f'{value:.2g}' for value in columns)} | {energy} | {time:.3g} | {each:.3g} |"
        )
    return "\n".join(rows)


def main() -> None:
    """Measure, one sequence after the other, every method in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="sequences with their true motion")
    parser.add_argument("--weights", type=Path, help="default: those that are shipped")
    parser.add_argument(
        "--other", type=Path, nargs="*", default=[], help="more weights files, for example the paper's network"
    )
    parser.add_argument(
        "--precision", choices=PRECISIONS, nargs="+", default=["float32"], help="of the other weights files"
    )
    parser.add_argument("--iterations", type=int, nargs="*", default=[], help="a pass, to compare beside its own")
    parser.add_argument("--pattern", default="*.npz")
    parser.add_argument("--frames", type=int)
    arguments = parser.parse_args()
    weights = EmulatorWeights.shipped() if arguments.weights is None else EmulatorWeights.load(arguments.weights)
    compared = methods(weights, arguments.other, arguments.iterations, arguments.precision)
    paths = sorted(arguments.folder.glob(arguments.pattern))
    if not paths:
        parser.error(f"{arguments.folder}: found no file like {arguments.pattern}, expected sequences")
    print(table(measured(paths, compared, arguments.frames)))


if __name__ == "__main__":
    main()
