# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator on scenes that are hard, and unlike what it is trained on (`followthrough.benchmarking.hard_scenes`), beside the simulation.

The truth is the converged simulation, which is kept in a folder. Prints a Markdown table, a line a scene, in the paper's units: root mean
squares of single frames from true history and of rollouts of 24, 48 and all frames; the least elastic energy, its standard deviation and
the largest, each over that of the truth where that is not next to nothing; milliseconds a frame; of the simulation single frames,
the worst of the rollouts and milliseconds. Then how many scenes meet the aims: single frames 0.003, every rollout 0.03, energies
within 20 %.
Every second scene, `--half choose`, is there to choose on; what is chosen is reported on the others.
"""

from __future__ import annotations

import argparse
import fnmatch
import math
import sys
import warnings
from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from emulator_scores import Maker, emulator, simulation

from followthrough.benchmarking.hard_scenes import HALVES, SCENES, Scene, half
from followthrough.emulator_weights import EmulatorWeights
from followthrough.evaluation import Scores, evaluate
from followthrough.sequences import Sequence
from followthrough.simulation import simulate

#: The aims, in the paper's units, and how far energies may be off.
MOST_SINGLE, MOST_ROLLOUT, MOST_ENERGY = 0.003, 0.03, 0.2
#: Share of the truth's largest energy below which there is none to speak of.
_NEXT_TO_NOTHING = 1e-4
_QUALITIES = ("preview", "fine")


def truth_of(scene: Scene, folder: Path) -> Sequence:
    """A scene with its true motion, from the folder where it has that of the same scene."""
    sequence = scene.sequence()
    path = folder / f"{scene.name}.npz"
    if path.exists():
        kept = Sequence.load(path)
        inputs = [field.name for field in fields(Sequence) if field.name != "dynamic"]
        if kept.dynamic is not None and all(
            np.array_equal(getattr(kept, name), getattr(sequence, name)) for name in inputs
        ):
            return kept
    folder.mkdir(parents=True, exist_ok=True)
    sequence = simulate(sequence, simulation("converged")(sequence))
    sequence.save(path)
    return sequence


def energy_ratios(scores: Scores) -> tuple[float, float, float]:
    """Least energy, its standard deviation and the largest over the truth's; NaN where that is next to nothing."""
    predicted, truth = scores.predicted, scores.truth
    least, deviation, most = (
        found / true if true > _NEXT_TO_NOTHING * truth.max and truth.max > 1e-6 else math.nan
        for found, true in zip(
            (predicted.min, predicted.stdev, predicted.max), (truth.min, truth.stdev, truth.max), strict=True
        )
    )
    return least, deviation, most


@dataclass(frozen=True)
class Verdict:
    """Which of the aims a method meets in a scene."""

    single: bool
    rollout: bool
    energy: bool

    @classmethod
    def of(cls, scores: Scores) -> Verdict:
        """By its scores."""
        off = (abs(ratio - 1) for ratio in energy_ratios(scores) if not math.isnan(ratio))
        return cls(
            scores.single_frame <= MOST_SINGLE,
            worst_rollout(scores) <= MOST_ROLLOUT,
            max(off, default=0.0) <= MOST_ENERGY,
        )

    @property
    def all(self) -> bool:
        """Whether it meets all three."""
        return self.single and self.rollout and self.energy

    def missed(self) -> str:
        """Those that it does not."""
        return ", ".join(field.name for field in fields(self) if not getattr(self, field.name)) or "–"


def worst_rollout(scores: Scores) -> float:
    """The largest of the rollouts' errors."""
    return max(scores.rollout_24, scores.rollout_48, scores.rollout_all)


def methods(weights: EmulatorWeights) -> dict[str, Maker]:
    """What is compared, by name."""
    return {"emulator": emulator(weights), **{quality: simulation(quality) for quality in _QUALITIES}}


def measure(scene: Scene, folder: Path, compared: dict[str, Maker]) -> dict[str, Scores]:
    """Scores of every method in a scene."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # inverted rest tets are some scenes' own
        sequence = truth_of(scene, folder)
        return {name: evaluate(sequence, make(sequence)) for name, make in compared.items()}


def row(scene: Scene, scores: dict[str, Scores]) -> str:
    """A scene's line of the table."""
    found = scores["emulator"]
    errors = (found.single_frame, found.rollout_24, found.rollout_48, found.rollout_all)
    ratios = ", ".join("–" if math.isnan(ratio) else f"{ratio:.3g}" for ratio in energy_ratios(found))
    cells = [scene.name, str(found.free_vertices), *(f"{error:.2g}" for error in errors), ratios]
    cells.append(f"{found.ms_per_frame:.3g}")
    for quality in _QUALITIES:
        if quality in scores:
            other = scores[quality]
            cells.append(f"{other.single_frame:.2g}, {worst_rollout(other):.2g}, {other.ms_per_frame:.3g}")
    return f"| {' | '.join([*cells, Verdict.of(found).missed()])} |"


def summary(all_scores: Iterable[dict[str, Scores]]) -> str:
    """How many scenes meet the aims, method by method, and their root mean squares."""
    scores = list(all_scores)
    lines = [
        "| method | all aims | single | rollouts | energy | root mean square: single, worst rollout | ms a frame |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for name in scores[0]:
        mine = [each[name] for each in scores]
        verdicts = [Verdict.of(each) for each in mine]
        met = [
            f"{sum(getattr(v, aim) for v in verdicts)} of {len(mine)}" for aim in ("all", "single", "rollout", "energy")
        ]
        roots = [
            math.sqrt(np.mean([value(each) ** 2 for each in mine]))
            for value in (lambda s: s.single_frame, worst_rollout)
        ]
        time = np.mean([each.ms_per_frame for each in mine])
        lines.append(f"| {' | '.join([name, *met])} | {roots[0]:.2g}, {roots[1]:.2g} | {time:.3g} |")
    return "\n".join(lines)


def main() -> None:
    """Measure, one scene after the other, every method in turn."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the truth is kept; made where it is not there")
    parser.add_argument("--half", choices=HALVES, help="default: all scenes")
    parser.add_argument("--pattern", default="*", help="of the scenes' names")
    parser.add_argument("--weights", type=Path, help="default: those that are shipped")
    parser.add_argument("--emulator-only", action="store_true", help="leave the simulation out")
    arguments = parser.parse_args()
    weights = EmulatorWeights.shipped() if arguments.weights is None else EmulatorWeights.load(arguments.weights)
    compared = methods(weights)
    if arguments.emulator_only:
        compared = {"emulator": compared["emulator"]}
    wanted = half(arguments.half) if arguments.half else SCENES
    wanted = tuple(scene for scene in wanted if fnmatch.fnmatch(scene.name, arguments.pattern))
    if not wanted:
        sys.exit(
            f"error: pattern: found no scene named {arguments.pattern}, expected some of: {'; '.join(s.name for s in SCENES)}"
        )
    columns = ["scene", "free", "single", "rollout 24", "48", "all", "energy / truth: min, stdev, max", "ms"]
    columns += [f"simulation, {name}: single, rollout, ms" for name in compared if name != "emulator"] + ["missed"]
    print(f"| {' | '.join(columns)} |\n| --- |{' ---: |' * (len(columns) - 2)} --- |")
    scores = []
    for scene in wanted:
        scores.append(measure(scene, arguments.folder, compared))
        print(row(scene, scores[-1]), flush=True)
    print("\n" + summary(scores))


if __name__ == "__main__":
    main()
