# SPDX-License-Identifier: GPL-3.0-or-later
"""The training loop: one frame ahead, with checkpoints that a killed run continues from, to the same end as one that was not."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from followthrough import __version__
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.evaluation import evaluate
from followthrough.npz_files import written_whole
from followthrough.sequences import Sequence
from followthrough.training.examples import DataSet
from followthrough.training.newton_examples import NewtonDataSet
from followthrough.training.optimizers import OPTIMIZERS
from followthrough.training.settings import NewtonSettings, TrainingSettings

_FORMAT = "followthrough training 1"


@dataclass(frozen=True)
class Score:
    """Of the averaged network, on sequences that it does not learn from.

    Attributes
    ----------
    step : int
        Steps taken.
    single_frame, rollout_24 : float
        Means over the sequences of what `followthrough evaluate` prints, in the network's metres.
    """

    step: int
    single_frame: float
    rollout_24: float


class Trainer:
    """A training run.

    Parameters
    ----------
    data
        What to learn from.
    settings
        How.
    trained_on
        The network's units; its stiffness range is taken from the data.
    validation
        Sequences to measure on, with their true motion.
    device
        "cpu" or "cuda".
    """

    def __init__(
        self,
        data: DataSet | NewtonDataSet,
        settings: TrainingSettings | NewtonSettings,
        trained_on: TrainedOn,
        validation: Iterable[Sequence] = (),
        device: str = "cpu",
    ) -> None:
        self.data = data
        self.settings = settings
        self.trained_on = replace(trained_on, stiffness_range=data.stiffness_range)
        self.validation = list(validation)
        self.device = device
        torch.manual_seed(settings.seed)
        self.network = settings.network().to(device)
        self.average = copy.deepcopy(self.network)
        make_optimizer = OPTIMIZERS[settings.optimizer]
        self.optimizer = make_optimizer(self.network, settings.learning_rate, settings.weight_decay)
        self.step = 0
        self.seconds = 0.0
        self.losses: list[float] = []
        self.scores: list[Score] = []

    def take_step(self) -> float:
        """Learn from one batch; returns the loss, a weighted mean square error."""
        start = time.perf_counter()
        loss = self.data.loss(self.network, self.settings, self.step, self.device)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.largest_gradient)
        value = float(loss.detach())
        if not np.isfinite(value):
            raise ValueError(
                f"step {self.step}: found a loss of {value}, expected a finite one (a lower learning_rate may help; the checkpoint is "
                "of an earlier step)"
            )
        self.optimizer.step(self.settings.learning_rate_at(self.step))
        keep = min(self.settings.average, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for mean, new in zip(self.average.parameters(), self.network.parameters(), strict=True):
                mean.lerp_(new, 1 - keep)
        self.losses.append(value)
        self.step += 1
        self.seconds += time.perf_counter() - start
        return value

    def measure(self) -> Score | None:
        """Score the averaged network on the validation sequences, by the native emulator; None where there are none."""
        if not self.validation:
            return None
        weights = self.weights()
        errors = []
        for sequence in self.validation:
            emulator = Emulator.of_sequence(sequence, weights)
            scores = evaluate(sequence, emulator)
            scale = self.trained_on.edge_length / emulator.edge_length
            errors.append((scale * scores.single_frame, scale * scores.rollout_24))
        single, rollout = np.mean(errors, axis=0)
        score = Score(self.step, float(single), float(rollout))
        self.scores = [old for old in self.scores if old.step != self.step] + [score]
        return score

    def weights(self) -> EmulatorWeights:
        """The averaged network, with how it was made."""
        manifest = {
            "followthrough": __version__,
            "torch": torch.__version__,
            "settings": self.settings.as_dict(),
            "data": {
                "sequences": len(self.data.examples),
                "frames": self.data.frame_count,
                "digest": self.data.digest,
            },
            "steps": self.step,
            "seconds": round(self.seconds, 1),
            "loss": float(np.mean(self.losses[-100:])) if self.losses else None,
            "scores": [vars(score) for score in self.scores if np.isfinite(score.rollout_24)][-1:],
        }
        weights: EmulatorWeights = self.average.to_weights(self.trained_on, manifest)
        return weights

    def save_checkpoint(self, path: Path) -> None:
        """Write everything that `resume` needs, all or nothing."""
        content = {
            "format": _FORMAT,
            "settings": self.settings.as_dict(),
            "data": self.data.digest,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
            "losses": torch.tensor(self.losses, dtype=torch.float64),
            "scores": [vars(score) for score in self.scores],
        }
        with written_whole(path) as temporary:
            torch.save(content, temporary)

    def resume(self, path: Path) -> None:
        """Continue from a checkpoint; the result is that of a run that was never stopped.

        Raises
        ------
        ValueError
            Where the file is damaged, or of other settings or data.
        """
        try:
            content: dict[str, Any] = torch.load(path, map_location=self.device, weights_only=True)
            if content["format"] != _FORMAT:
                raise KeyError("format")
        except Exception as error:
            raise ValueError(
                f"{path}: found no readable checkpoint ({' '.join(str(error).split())[:200]}); remove it to start over"
            ) from None
        settings = self.settings.as_dict()
        different = [name for name, value in settings.items() if content["settings"].get(name) != value]
        if different:
            name = different[0]
            raise ValueError(
                f"{path}: found a run with {name} {content['settings'].get(name)}, expected {settings[name]} "
                "(remove the file to start over, or write to another one)"
            )
        if content["data"] != self.data.digest:
            raise ValueError(
                f"{path}: found a run on other data (remove the file to start over, or write to another one)"
            )
        self.network.load_state_dict(content["network"])
        self.average.load_state_dict(content["average"])
        self.optimizer.load_state_dict(content["optimizer"])
        self.step, self.seconds = content["step"], content["seconds"]
        self.losses = content["losses"].tolist()
        self.scores = [Score(**score) for score in content["scores"]]

    def run(
        self,
        checkpoint: Path,
        *,
        checkpoint_minutes: float = 5.0,
        report: Callable[[Trainer], None] = lambda trainer: None,
    ) -> None:
        """Take the steps that are left, writing checkpoints as time passes, at the end, and when interrupted.

        Parameters
        ----------
        checkpoint
            The file; continued from where it is there.
        checkpoint_minutes
            Between two checkpoints; the network is measured then, too.
        report
            Called after every step.
        """
        if checkpoint.exists():
            self.resume(checkpoint)
        written = time.monotonic()
        try:
            while self.step < self.settings.steps:
                self.take_step()
                report(self)
                if time.monotonic() - written > 60 * checkpoint_minutes:
                    self.measure()
                    self.save_checkpoint(checkpoint)
                    written = time.monotonic()
            self.measure()
        finally:
            self.save_checkpoint(checkpoint)


def plot_losses(trainer: Trainer, path: Path) -> None:
    """Draw the loss and the scores over the steps into a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(xlabel="step", ylabel="error, in the network's metres", yscale="log")
    window = max(1, len(trainer.losses) // 200)
    usable = len(trainer.losses) // window * window
    means = np.sqrt(np.reshape(trainer.losses[:usable], (-1, window)).mean(axis=1))
    axes.plot((np.arange(len(means)) + 0.5) * window, means, label="root of the training loss")
    for name in ("single_frame", "rollout_24"):
        points = [(score.step, getattr(score, name)) for score in trainer.scores if np.isfinite(getattr(score, name))]
        if points:
            axes.plot(*zip(*points, strict=True), marker="o", label=f"validation, {name.replace('_', ' ')}")
    axes.legend()
    with written_whole(path) as temporary:
        figure.savefig(temporary, format="png", dpi=120)
