# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames that the guides of Newton steps learn from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self, cast

import numpy as np
import torch
from torch import Tensor, nn

from followthrough.character import FloatArray
from followthrough.newton_patches import NewtonPatches
from followthrough.sequences import Sequence
from followthrough.training.examples import load_sequences
from followthrough.training.newton_network import Frame, GuidedNewtonNetwork
from followthrough.training.settings import LearningSettings, NewtonSettings

#: Mean square error, edges squared, below which a frame counts no more than one with so much.
_LEAST_ERROR = 1e-6


@dataclass(frozen=True, eq=False)
class NewtonExample:
    """A sequence and its volume.

    Attributes
    ----------
    sequence : Sequence
        With its true motion.
    scene : NewtonPatches
        Its volume.
    """

    sequence: Sequence
    scene: NewtonPatches

    def frame(self, t: int) -> tuple[Frame, FloatArray]:
        """What is known before frame t + 1, and the truth (n, 3), m. Before frame 0 stands frame 0."""
        dynamic, reference = cast(FloatArray, self.sequence.dynamic), self.sequence.reference
        past = [max(t - k, 0) for k in range(4)]
        return Frame(dynamic[past], reference[[t + 1, *past[:3]]]), dynamic[t + 1]


class NewtonDataSet:
    """All sequences of a folder, or of several, in memory.

    Parameters
    ----------
    sequences
        Their names and what they hold.
    digest
        Of the files, so that a run is continued on the same data.
    """

    def __init__(self, sequences: dict[str, Sequence], digest: str) -> None:
        self.examples = [
            NewtonExample(sequence, NewtonPatches.of_sequence(sequence)) for sequence in sequences.values()
        ]
        self.digest = digest
        steps = np.array([sequence.frame_count - 1 for sequence in sequences.values()])
        self.frame_count = int(steps.sum())
        sizes = np.array([len(example.scene.free_vertices) for example in self.examples])
        self._chances = steps * np.sqrt(sizes) / (steps * np.sqrt(sizes)).sum()

    @classmethod
    def load(cls, folders: list[Path]) -> Self:
        """Read every .npz of some folders.

        Raises
        ------
        ValueError
            Where there is none, or one is not a sequence with its true motion; names the file.
        """
        return cls(*load_sequences(folders))

    @property
    def stiffness_range(self) -> tuple[float, float]:
        """Smallest and largest dimensionless stiffness of a free vertex."""
        free = [example.scene.stiffness[example.scene.free_vertices] for example in self.examples]
        return float(min(map(np.min, free))), float(max(map(np.max, free)))

    def loss(self, network: nn.Module, settings: LearningSettings, step: int, device: str) -> Tensor:
        """Sum over the passes of their mean square errors, edges squared, each frame weighted by its error before the pass to the
        power of minus `settings.evenness`; on random frames that the seed and the step's number decide."""
        assert isinstance(network, GuidedNewtonNetwork) and isinstance(settings, NewtonSettings)
        random = np.random.default_rng([settings.seed, step])
        count = min(settings.frames_a_step, len(self.examples))
        chosen = [self.examples[k] for k in random.choice(len(self.examples), count, replace=False, p=self._chances)]
        known = [example.frame(int(random.integers(example.sequence.frame_count - 1))) for example in chosen]
        scenes = [example.scene for example in chosen]
        total = torch.zeros((), device=device)
        for before, steps in network(scenes, [frame for frame, _ in known], settings.repeats):
            targets = [
                ((truth - estimate)[scene.free_vertices] / scene.edge_length).astype(np.float32)
                for scene, estimate, (_, truth) in zip(scenes, before, known, strict=True)
            ]
            errors = [np.mean(np.sum(target**2, axis=1)) + _LEAST_ERROR for target in targets]
            weights = [
                np.full(len(target), error**-settings.evenness / (len(target) * count), dtype=np.float32)
                for target, error in zip(targets, errors, strict=True)
            ]
            wanted, weight = (torch.from_numpy(np.concatenate(parts)).to(device) for parts in (targets, weights))
            total = total + ((steps - wanted).square().sum(dim=1) * weight).sum()
        return total
