# SPDX-License-Identifier: GPL-3.0-or-later
"""The patch network of [DE] in PyTorch; `cpp/include/followthrough/emulator/patch_network.hpp` defines its inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from followthrough import sequences
from followthrough.character import FloatArray
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.training.patches import PatchBatch, Scene

RINGS = ("edge_mlp", "edge_mlp_2", "edge_mlp_3")


class PatchNetwork(nn.Module):
    """Three perceptrons that take vertices one frame further. The defaults are the published sizes, 237,571 parameters.

    Parameters
    ----------
    inertia, force
        Widths of `point_mlp` and of every `edge_mlp`, layer by layer, the output's last.
    displacement
        Widths of the hidden layers of `instance_mlp`.
    rings
        How many edges away a vertex is seen, 1 to 3 [DE, A.5].
    sees_reference
        False: the ablation of [DE, section 4.2].
    biases
        Whether layers have them.
    """

    def __init__(
        self,
        *,
        inertia: Sequence[int] = (64,) * 5,
        force: Sequence[int] = (128,) * 5,
        displacement: Sequence[int] = (192,) * 4,
        rings: int = 1,
        sees_reference: bool = True,
        biases: bool = True,
    ) -> None:
        super().__init__()
        if not 1 <= rings <= len(RINGS):
            raise ValueError(f"rings: found {rings}, expected 1 to {len(RINGS)}")
        self.rings = rings
        self.sees_reference = sees_reference
        centre, edge = (18, 37) if sees_reference else (9, 19)
        self.point_mlp = _perceptron((centre, *inertia), biases)
        for name in RINGS[:rings]:
            self.add_module(name, _perceptron((edge, *force), biases))
        self.instance_mlp = _perceptron((inertia[-1] + rings * force[-1], *displacement, 3), biases)

    def forward(self, batch: PatchBatch) -> Tensor:
        """u(t+1) - u(t) of the batch's centres, (b, 3), in the network's metres."""
        dynamic, reference = batch.dynamic, batch.reference
        if self.sees_reference:
            origin = reference[1][batch.centres]
            own = torch.cat([dynamic, reference[[0, 2]]])
            seen = torch.cat([dynamic, reference])
        else:
            dynamic = torch.where(batch.constrained[None, :, None], reference, dynamic)
            origin = dynamic[0][batch.centres]
            own, seen = dynamic[1:], dynamic
        moved = (own[:, batch.centres] - origin).transpose(0, 1).flatten(1)
        centre = torch.cat([moved, batch.material[batch.centres]], dim=1)
        joined = [self.point_mlp(centre)]
        for name, ring in zip(RINGS, batch.neighbours, strict=False):
            perceptron = cast(nn.Sequential, self.get_submodule(name))
            joined.append(_sum_of_forces(perceptron, batch, ring, seen, origin, centre))
        change: Tensor = self.instance_mlp(torch.cat(joined, dim=1))
        return change

    @classmethod
    def from_weights(cls, weights: EmulatorWeights) -> Self:
        """The network of a weights file.

        Raises
        ------
        ValueError
            Where its rings differ in their widths, or only some of its layers have biases, or it corrects Newton steps.
        """
        if weights.newton is not None:
            raise ValueError("weights: found a network that guides Newton steps (guided-newton), expected patch")

        def widths(name: str) -> list[int]:
            return [len(weight) for weight, _ in weights.layers(name)]

        network = cls(
            inertia=widths("point_mlp"),
            force=widths("edge_mlp"),
            displacement=widths("instance_mlp")[:-1],
            rings=weights.rings,
            sees_reference=weights.sees_reference,
            biases=weights.layers("point_mlp")[0][1] is not None,
        )
        try:
            network.load_state_dict(
                {name: torch.from_numpy(array.copy()) for name, array in weights.parameters.items()}
            )
        except RuntimeError as error:
            raise ValueError(
                f"weights: found rings of different widths or biases in some layers only ({' '.join(str(error).split())})"
            ) from None
        return network

    def to_weights(
        self, trained_on: TrainedOn | None = None, manifest: Mapping[str, Any] | None = None
    ) -> EmulatorWeights:
        """What a weights file holds."""
        parameters = {name: tensor.detach().cpu().numpy() for name, tensor in self.state_dict().items()}
        return EmulatorWeights(parameters, trained_on or TrainedOn(), manifest or {})


def load_weights(path: Path | str) -> tuple[PatchNetwork, TrainedOn]:
    """The network of a weights file, and what it was trained on.

    Raises
    ------
    ValueError
        Where the file cannot be read or is not a weights file.
    """
    weights = EmulatorWeights.load(path)
    return PatchNetwork.from_weights(weights), weights.trained_on


def save_weights(
    network: PatchNetwork,
    path: Path | str,
    trained_on: TrainedOn | None = None,
    manifest: Mapping[str, Any] | None = None,
) -> None:
    """Write a weights file that `followthrough rollout` runs.

    Raises
    ------
    ValueError
        Where the folder is missing, or a parameter is not finite.
    """
    network.to_weights(trained_on, manifest).save(path)


def import_state_dict(path: Path | str) -> EmulatorWeights:
    """Read a state dict that PyTorch has saved, for example one of the paper's; only tensors are unpickled.

    Raises
    ------
    ValueError
        Where the file cannot be read or holds something else.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        state = {str(name): tensor.detach().numpy() for name, tensor in state.items()}
    except Exception as error:
        raise ValueError(f"{path}: found no state dict of tensors ({' '.join(str(error).split())[:200]})") from None
    try:
        return EmulatorWeights(state)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


@torch.no_grad()
def rollout(network: PatchNetwork, sequence: sequences.Sequence, trained_on: TrainedOn | None = None) -> FloatArray:
    """Dynamic positions (F, n, 3), each frame from the last ones that were predicted: what `Emulator` does, in PyTorch."""
    scene = Scene.of_sequence(sequence, trained_on or TrainedOn(), network.rings)
    device = next(network.parameters()).device
    x = scene.displacements(sequence.reference)
    frames: list[NDArray[np.float32]] = [x[0]] * 3
    for t in range(1, len(x)):
        batch = scene.batch(np.stack(frames[-1:-4:-1]), np.stack([x[t], x[t - 1], x[max(t - 2, 0)]]))
        now = x[t].copy()
        now[scene.centres] = frames[-1][scene.centres] + network(batch.to(device)).cpu().numpy()
        frames.append(now)
    return scene.rest_positions + np.stack(frames[2:]).astype(np.float64) / scene.scale


def _perceptron(widths: Sequence[int], biases: bool) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs, bias=biases), nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def _sum_of_forces(
    perceptron: nn.Sequential, batch: PatchBatch, ring: Tensor, seen: Tensor, origin: Tensor, centre: Tensor
) -> Tensor:
    """Sum of a ring's forces on the centres, (b, outputs). The last layer is linear: it comes after the sum."""
    present = ring >= 0
    near = ring.clamp(min=0)
    moved = (seen[:, near] - origin[:, None]).permute(1, 2, 0, 3).flatten(2)
    constrained = batch.constrained[near][..., None].to(moved.dtype)
    edges = torch.cat([constrained, moved, centre[:, None].expand(-1, ring.shape[1], -1)], dim=2)
    summed = (perceptron[:-1](edges) * present[..., None]).sum(dim=1)
    last = cast(nn.Linear, perceptron[-1])
    result = summed @ last.weight.T
    if last.bias is not None:
        result = result + present.sum(dim=1, keepdim=True) * last.bias
    return result
