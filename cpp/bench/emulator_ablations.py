# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's network and its ablations [DE 4.3, A.5]: each is trained alike, from the same data, and measured beside the others.

Prints a Markdown table for motions of the training's own kind and one for dances (what the columns are: emulator_scores.py). Training
goes on where it was interrupted, and what is trained already is only measured. Needs PyTorch.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from emulator_scores import Maker, emulator, measured, table

from followthrough.emulator_weights import EmulatorWeights

#: What the networks have in common: TOML of `followthrough train`.
COMMON = """\
architecture = "patch"
optimizer = "muon"
learning_rate = 2e-3
noise = 0.001
frames_a_step = 16
vertices_a_frame = 32
"""

#: What each of them changes.
ABLATIONS = {
    "published": "",
    "no-reference": "sees_reference = false\n",
    "two-rings": "rings = 2\n",
    "three-rings": "rings = 3\n",
}


def trained(name: str, data: Path, folder: Path, steps: int) -> EmulatorWeights:
    """The weights of an ablation. `followthrough train` goes on from its checkpoint, and refuses one of other settings or data."""
    weights, settings = folder / f"{name}.npz", folder / f"{name}.toml"
    settings.write_text(f"{COMMON}steps = {steps}\n{ABLATIONS[name]}", encoding="utf-8")
    command = [sys.executable, "-m", "followthrough", "train", data, "--config", settings, "-o", weights]
    subprocess.run([str(word) for word in command], check=True)
    return EmulatorWeights.load(weights)


def main() -> None:
    """Train what is not trained yet, then measure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path, help="sequences to learn from (followthrough dataset sphere)")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the weights")
    parser.add_argument("--steps", type=int, default=2000, help="of training (default %(default)s)")
    parser.add_argument(
        "--like", type=Path, required=True, help="folder of sequences of the same kind, of another seed"
    )
    parser.add_argument(
        "--dances", type=Path, required=True, help="folder of sequences (followthrough dataset held-out)"
    )
    parser.add_argument("--pattern", default="*.npz", help="of the dances' files")
    parser.add_argument("--frames", type=int, default=120, help="of each sequence to measure on (default %(default)s)")
    arguments = parser.parse_args()
    arguments.output.mkdir(parents=True, exist_ok=True)
    compared: dict[str, Maker] = {}
    for name in ABLATIONS:
        compared[name] = emulator(trained(name, arguments.data, arguments.output, arguments.steps))
    for folder, pattern in ((arguments.like, "*.npz"), (arguments.dances, arguments.pattern)):
        print(f"\n{folder}\n")
        print(table(measured(sorted(folder.glob(pattern)), compared, arguments.frames)))


if __name__ == "__main__":
    main()
