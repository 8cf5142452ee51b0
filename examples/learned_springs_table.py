# SPDX-License-Identifier: GPL-3.0-or-later
"""How well springs that were learned on 96 frames of one dance do in other dances: the table of docs/learned-springs.md.

    python examples/learned_springs_table.py [--stiffer 1 16] [--dances 3] [--frames 145]

Characters and dances are those of `followthrough dataset held-out`; the truth is the converged simulation. With `--stiffer K` the
flesh is K times as stiff as there. Some minutes.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from followthrough.datasets import HeldOutRecipe
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.quasistatic import Quasistatic
from followthrough.sequences import Sequence
from followthrough.simulation import simulate, uniform_constants
from followthrough.spring_fit import FitSettings, Training, fit_springs
from followthrough.springs import Springs

CHARACTERS = ("fat", "thin", "eared")
TRAINING_FRAMES = 96


@dataclass
class Row:
    """One dance of one character; errors in m, root mean square over all vertices, frames and axes."""

    character: str
    stiffer: float
    dance: str
    skinning: float
    default: float
    learned: float
    equilibria: float
    over_equilibria: float


def dances(character: str, stiffer: float, count: int, frames: int) -> list[Sequence]:
    """Simulated dances of a character of the validation half."""
    recipe = HeldOutRecipe(frames=frames)
    items = [item for item in recipe.items(count) if item.name.startswith(f"validation-{character}-")]
    sequences = []
    for item in items:
        made = recipe.make(item)
        made = replace(made, youngs_modulus=made.youngs_modulus * stiffer)
        sequences.append(simulate(made, ImplicitEuler(ElasticBody.of_sequence(made), made.constrained, made.dt)))
        print(f"{item.name}, {stiffer:g} times as stiff: simulated", file=sys.stderr)
    return sequences


def with_equilibria(sequence: Sequence) -> Sequence:
    """The same, hanging on each pose's static equilibrium."""
    layer = Quasistatic(ElasticBody.of_sequence(sequence), sequence.constrained, quality="fine")
    return replace(sequence, reference=np.array([layer.solve(pose) for pose in sequence.reference]))


def learn(sequence: Sequence) -> Springs:
    """Springs of the first frames of a dance."""
    assert sequence.dynamic is not None
    first = slice(0, TRAINING_FRAMES)
    training = Training(sequence.reference[first], sequence.dynamic[first], sequence.dt)
    fit = fit_springs([training], FitSettings(), skipped=sequence.constrained)
    return Springs(fit.stiffness, fit.damping, sequence.dt, sequence.constrained)


def error(sequence: Sequence, springs: Springs) -> float:
    """Of springs in a dance."""
    found = simulate(sequence, springs).dynamic
    assert found is not None
    return distance(found, sequence)


def distance(positions: NDArray[np.float64], sequence: Sequence) -> float:
    """Of positions (F, n, 3) to the truth."""
    assert sequence.dynamic is not None
    return float(np.sqrt(np.mean((positions - sequence.dynamic) ** 2)))


def measure(character: str, stiffer: float, count: int, frames: int) -> list[Row]:
    """All dances of a character, the one that was learned from first."""
    sequences = dances(character, stiffer, count + 1, frames)
    resting = [with_equilibria(sequence) for sequence in sequences]
    learned, learned_over = learn(sequences[0]), learn(resting[0])
    first = sequences[0]
    default = Springs(*uniform_constants(first.vertex_count), first.dt, first.constrained)
    rows = []
    for place, (sequence, rests) in enumerate(zip(sequences, resting, strict=True)):
        rows.append(
            Row(
                character,
                stiffer,
                "learned from" if place == 0 else f"new, {place}",
                distance(sequence.reference, sequence),
                error(sequence, default),
                error(sequence, learned),
                distance(rests.reference, sequence),
                error(rests, learned_over),
            )
        )
    return rows


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--stiffer", metavar="K", type=float, nargs="+", default=[1.0, 16.0])
    parser.add_argument("--dances", metavar="N", type=int, default=3, help="that were not learned from")
    parser.add_argument("--frames", metavar="N", type=int, default=145, help="of each, 96 or more")
    args = parser.parse_args()
    print(
        "| character | E, Pa | dance | skinning, m | default springs | learned springs | equilibria | springs over equilibria |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for stiffer in args.stiffer:
        for character in CHARACTERS:
            for row in measure(character, stiffer, args.dances, args.frames):
                print(
                    f"| {row.character} | {5e4 * row.stiffer:.0e} | {row.dance} | {row.skinning:.4f} | {row.default:.4f} | "
                    f"{row.learned:.4f} ({row.learned / row.skinning:.2f}) | {row.equilibria:.4f} "
                    f"({row.equilibria / row.skinning:.2f}) | {row.over_equilibria:.4f} ({row.over_equilibria / row.skinning:.2f}) |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
