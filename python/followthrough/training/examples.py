# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames to learn from: the sequences of a data set, and random batches of them."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from followthrough.emulator_weights import TrainedOn
from followthrough.sequences import Sequence
from followthrough.training.patches import PatchBatch, Scene
from followthrough.training.settings import LearningSettings, TrainingSettings


def load_sequences(folders: list[Path]) -> tuple[dict[str, Sequence], str]:
    """Read every sequence of some folders that has two frames and a free vertex, by the files' names, with a digest of all.

    Raises
    ------
    ValueError
        Where there is none, or one has no true motion; names the file.
    """
    digest = hashlib.sha256()
    found: dict[str, Sequence] = {}
    for folder in folders:
        paths = sorted(folder.glob("*.npz"))
        if not paths:
            raise ValueError(
                f"{folder}: found no sequences, expected a folder of .npz files (followthrough dataset makes one)"
            )
        for path in paths:
            sequence = Sequence.load(path)
            if sequence.dynamic is None:
                raise ValueError(f"{path}: found no dynamic, expected sequences with their true motion")
            if sequence.frame_count > 1 and not sequence.constrained.all():
                found[str(path)] = sequence
                digest.update(f"{path.name} {sequence.dynamic.shape}".encode() + sequence.dynamic[-1].tobytes())
    if not found:
        raise ValueError(f"{folders[0]}: found no sequence with two frames and a free vertex, expected at least one")
    return found, digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Example:
    """A sequence in the network's units.

    Attributes
    ----------
    name : str
        Of its file.
    scene : Scene
        The volume.
    dynamic, reference : (F, n, 3) float32
        Displacements from the rest shape.
    stiffness : (n,) float64
        Dimensionless, E dt² / (density edge²).
    """

    name: str
    scene: Scene
    dynamic: NDArray[np.float32]
    reference: NDArray[np.float32]
    stiffness: NDArray[np.float64]

    @classmethod
    def of_sequence(cls, name: str, sequence: Sequence, trained_on: TrainedOn, rings: int) -> Self:
        """Take a sequence that has its true motion."""
        assert sequence.dynamic is not None
        scene = Scene.of_sequence(sequence, trained_on, rings)
        edge = trained_on.edge_length / scene.scale
        return cls(
            name,
            scene,
            scene.displacements(sequence.dynamic),
            scene.displacements(sequence.reference),
            sequence.youngs_modulus * sequence.dt**2 / (sequence.density * edge**2),
        )


class DataSet:
    """All sequences of a folder, or of several, in memory.

    Parameters
    ----------
    examples
        The sequences.
    digest
        Of the files, so that a run is continued on the same data.
    """

    def __init__(self, examples: list[Example], digest: str) -> None:
        self.examples = examples
        self.digest = digest
        self._steps = np.array([len(example.dynamic) - 1 for example in examples])

    @classmethod
    def load(cls, folders: list[Path], trained_on: TrainedOn, rings: int) -> Self:
        """Read every .npz of some folders.

        Raises
        ------
        ValueError
            Where there is none, or one is not a sequence with its true motion; names the file.
        """
        sequences, digest = load_sequences(folders)
        return cls(
            [Example.of_sequence(name, sequence, trained_on, rings) for name, sequence in sequences.items()], digest
        )

    @property
    def frame_count(self) -> int:
        """Frames to predict."""
        return int(self._steps.sum())

    @property
    def stiffness_range(self) -> tuple[float, float]:
        """Smallest and largest dimensionless stiffness of a free vertex."""
        free = [example.stiffness[example.scene.centres] for example in self.examples]
        return float(min(map(np.min, free))), float(max(map(np.max, free)))

    def batch(self, settings: TrainingSettings, step: int) -> tuple[PatchBatch, Tensor]:
        """The batch of a step, which the seed and the step's number decide alone, and its true changes (b, 3)."""
        random = np.random.default_rng([settings.seed, step])
        parts: list[PatchBatch] = []
        changes: list[NDArray[np.float32]] = []
        for frame in random.integers(self.frame_count, size=settings.frames_a_step):
            which = int(np.searchsorted(np.cumsum(self._steps), frame, side="right"))
            example = self.examples[which]
            t = int(frame - self._steps[:which].sum())  # the last frame that is known
            past = [max(t - k, 0) for k in range(3)]
            dynamic = example.dynamic[past].copy()
            free = ~example.scene.constrained
            dynamic[:, free] += settings.noise * random.standard_normal(dynamic[:, free].shape, dtype=np.float32)
            count = min(settings.vertices_a_frame, len(example.scene.centres))
            rows = random.choice(len(example.scene.centres), count, replace=False)
            centres = example.scene.centres[rows]
            batch = example.scene.batch(dynamic, example.reference[[t + 1, t, max(t - 1, 0)]])
            chosen = torch.from_numpy(rows)
            parts.append(
                PatchBatch(
                    batch.dynamic,
                    batch.reference,
                    batch.constrained,
                    batch.material,
                    batch.centres[chosen],
                    tuple(ring[chosen] for ring in batch.neighbours),
                )
            )
            changes.append(example.dynamic[t + 1, centres] - dynamic[0, centres])
        return PatchBatch.join(parts), torch.from_numpy(np.concatenate(changes))

    def loss(self, network: nn.Module, settings: LearningSettings, step: int, device: str) -> Tensor:
        """Mean square error of a change, the network's metres squared, on the batch of a step."""
        assert isinstance(settings, TrainingSettings)
        batch, changes = self.batch(settings, step)
        loss: Tensor = (network(batch.to(device)) - changes.to(device)).square().mean()
        return loss
