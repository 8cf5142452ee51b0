# SPDX-License-Identifier: GPL-3.0-or-later
"""The guides of Newton steps in PyTorch; `followthrough/emulator/patch_newton.hpp` says what they do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self, cast

import numpy as np
import torch
from torch import Tensor, nn

from followthrough.character import FloatArray
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.newton_patches import NewtonPatches, PatchFeatures
from followthrough.newton_weights import PASS_SIZE, START_SIZE, NewtonSchedule, guide_inputs


class Guide(nn.ModuleList):
    """A perceptron that makes coefficients of vectors.

    Parameters
    ----------
    size
        Numbers of vectors and of other numbers that it is told.
    widths
        Of its hidden layers.
    first
        Coefficient of the first vector before it has learned anything; those of the others are 0.
    """

    def __init__(self, size: tuple[int, int], widths: Sequence[int], first: float) -> None:
        vectors = size[0]
        super().__init__(nn.Linear(a, b) for a, b in pairwise((guide_inputs(size), *widths, vectors)))
        last = cast(nn.Linear, self[len(self) - 1])
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        with torch.no_grad():
            last.bias[0] = first
        self._pairs = torch.triu_indices(vectors, vectors)

    def forward(self, vectors: Tensor, scalars: Tensor) -> Tensor:
        """Weighted sums (f, 3) of vectors (f, v, 3)."""
        products = vectors @ vectors.transpose(1, 2)
        squares = products.diagonal(dim1=1, dim2=2).sum(dim=1, keepdim=True) + 1e-18
        pairs = products[:, self._pairs[0], self._pairs[1]]
        hidden = torch.cat([pairs.sign() * (pairs.abs() / squares + 1e-9).sqrt(), scalars], dim=1)
        *layers, last = self
        for layer in layers:
            hidden = torch.tanh(layer(hidden))
        coefficients: Tensor = last(hidden)
        return (coefficients[:, :, None] * vectors).sum(dim=1)


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame to predict, m.

    Attributes
    ----------
    dynamic : (4, n, 3) float64
        u(t), u(t-1), u(t-2), u(t-3).
    reference : (4, n, 3) float64
        x(t+1), x(t), x(t-1), x(t-2).
    """

    dynamic: FloatArray
    reference: FloatArray


class GuidedNewtonNetwork(nn.Module):
    """A guide of the start and one of every pass. The defaults are those that ship.

    Parameters
    ----------
    iterations
        Of conjugate gradients, pass by pass.
    widths
        Of the guides' hidden layers.
    most_passes, tolerance
        How a frame ends (`newton_weights.NewtonSchedule`).
    """

    def __init__(
        self,
        *,
        iterations: Sequence[int] = NewtonSchedule.iterations,
        widths: Sequence[int] = (24, 24),
        most_passes: int = NewtonSchedule.most_passes,
        tolerance: float = NewtonSchedule.tolerance,
    ) -> None:
        super().__init__()
        self.schedule = NewtonSchedule(tuple(iterations), most_passes, tolerance)
        self.start = Guide(START_SIZE, widths, first=0.5)
        self.passes = nn.ModuleList(Guide(PASS_SIZE, widths, first=1.0) for _ in iterations)

    def forward(
        self, scenes: Sequence[NewtonPatches], frames: Sequence[Frame], repeats: int = 0
    ) -> list[tuple[list[FloatArray], Tensor]]:
        """Take frames of different scenes one further, the last pass repeated so many times.

        Returns
        -------
        list
            For the start and every pass, the scenes' estimates before it (n, 3), m, and the steps of all their free vertices
            (f, 3), edges. Each guide learns for itself: no gradient runs from one into the one before.
        """
        for scene, frame in zip(scenes, frames, strict=True):
            scene.begin(frame.dynamic, frame.reference)
        taken = [self._step(self.start, scenes, [scene.start_features() for scene in scenes])]
        return taken + self.take_passes(scenes, repeats)

    def take_passes(self, scenes: Sequence[NewtonPatches], repeats: int = 0) -> list[tuple[list[FloatArray], Tensor]]:
        """Every pass from the scenes' present estimates, as in `forward`. `NewtonPatches.end_passes` ends the frame."""
        guides = list(zip(self.schedule.iterations, self.passes, strict=True))
        guides += guides[-1:] * repeats
        taken = []
        for k, (iterations, guide) in enumerate(guides):
            for scene in scenes:
                scene.evaluate(iterations)
            features = [scene.features() for scene in scenes]
            taken.append(self._step(guide, scenes, features, last=k + 1 == len(guides)))
        return taken

    def _step(
        self,
        guide: nn.Module,
        scenes: Sequence[NewtonPatches],
        features: Sequence[PatchFeatures],
        *,
        last: bool = False,
    ) -> tuple[list[FloatArray], Tensor]:
        before = [scene.estimate() for scene in scenes]
        device = self.start[0].weight.device
        vectors, scalars = (torch.from_numpy(np.concatenate(parts)).to(device) for parts in zip(*features, strict=True))
        steps: Tensor = guide(vectors, scalars)
        ends = np.cumsum([len(part.vectors) for part in features])[:-1]
        for scene, step in zip(scenes, np.split(steps.detach().cpu().numpy(), ends), strict=True):
            scene.move(step, last=last)
        return before, steps

    @classmethod
    def from_weights(cls, weights: EmulatorWeights) -> Self:
        """The network of a weights file.

        Raises
        ------
        ValueError
            Where it is another kind of network, or its guides differ in their widths.
        """
        if weights.newton is None:
            raise ValueError("weights: found a patch network, expected one that guides Newton steps")
        depth = sum(name.startswith("start.") and name.endswith(".bias") for name in weights.parameters)
        network = cls(
            iterations=weights.newton.iterations,
            widths=[len(weights.parameters[f"start.{k}.bias"]) for k in range(depth - 1)],
            most_passes=weights.newton.most_passes,
            tolerance=weights.newton.tolerance,
        )
        try:
            network.load_state_dict(
                {name: torch.from_numpy(array.copy()) for name, array in weights.parameters.items()}
            )
        except RuntimeError as error:
            raise ValueError(f"weights: found guides of different widths ({' '.join(str(error).split())})") from None
        return network

    def to_weights(
        self, trained_on: TrainedOn | None = None, manifest: Mapping[str, Any] | None = None
    ) -> EmulatorWeights:
        """What a weights file holds."""
        parameters = {name: tensor.detach().cpu().numpy() for name, tensor in self.state_dict().items()}
        return EmulatorWeights(parameters, trained_on or TrainedOn(), manifest or {}, self.schedule)
