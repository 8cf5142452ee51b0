# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough train`: trains the emulator's network on a folder of sequences."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from followthrough.npz_files import require_output_folder

if TYPE_CHECKING:
    from followthrough.training.trainer import Trainer


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "train",
        help="train the emulator's network",
        description="Train a network on folders of sequences with their true motion (followthrough dataset makes one) and write its "
        "weights, with the loss curve as a PNG beside them. A checkpoint is kept beside them, too: run the same command again to "
        "continue where it was interrupted or killed. Needs PyTorch: pip install followthrough[training].",
    )
    parser.add_argument("data", metavar="DIR", type=Path, nargs="+", help="folders of sequence files")
    parser.add_argument("-o", "--output", metavar="W.npz", type=Path, required=True, help="where to write the weights")
    parser.add_argument("--config", metavar="C.toml", type=Path, help="sizes of the network and how it learns")
    parser.add_argument("--steps", metavar="N", type=int, help="optimiser steps, whatever the configuration says")
    parser.add_argument(
        "--validation", metavar="DIR", type=Path, help="folder of sequences to measure on, not to learn from"
    )
    parser.add_argument("--device", help="cpu or cuda (default: cuda where there is one)")
    parser.add_argument(
        "--checkpoint-minutes", metavar="M", type=float, default=5.0, help="between checkpoints (default %(default)g)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    require_output_folder(args.output)
    if args.output.suffix != ".npz":
        raise ValueError(f"{args.output}: found a name that ends in {args.output.suffix!r}, expected .npz")
    if importlib.util.find_spec("torch") is None:
        raise ValueError("train: found no PyTorch, expected it to be installed (pip install followthrough[training])")
    import torch

    from followthrough.cli.progress import with_progress
    from followthrough.emulator_weights import TrainedOn
    from followthrough.sequences import Sequence
    from followthrough.training.examples import DataSet
    from followthrough.training.newton_examples import NewtonDataSet
    from followthrough.training.settings import NewtonSettings, load_settings
    from followthrough.training.trainer import Trainer, plot_losses

    changes = {} if args.steps is None else {"steps": args.steps}
    settings = NewtonSettings(**changes) if args.config is None else load_settings(args.config, **changes)
    device = args.device or ("cuda" if torch.cuda.is_available() else "cpu")
    if device not in ("cpu", "cuda") or (device == "cuda" and not torch.cuda.is_available()):
        raise ValueError(f"--device: found {device}, expected cpu, or cuda on a machine that has one")
    data = (
        NewtonDataSet.load(args.data)
        if isinstance(settings, NewtonSettings)
        else DataSet.load(args.data, TrainedOn(), settings.rings)
    )
    validation = (
        [] if args.validation is None else [Sequence.load(path) for path in sorted(args.validation.glob("*.npz"))]
    )
    if args.validation is not None and not validation:
        raise ValueError(f"{args.validation}: found no sequences, expected a folder of .npz files")
    trainer = Trainer(data, settings, TrainedOn(), validation, device)
    checkpoint = args.output.with_suffix(".checkpoint.pt")
    if checkpoint.exists():
        trainer.resume(checkpoint)
        print(f"{checkpoint}: continuing after step {trainer.step}", file=sys.stderr)
    bar = iter(with_progress(range(settings.steps - trainer.step), "train", unit="step", quiet=args.quiet))

    def report(_: Trainer) -> None:
        next(bar, None)

    try:
        trainer.run(checkpoint, checkpoint_minutes=args.checkpoint_minutes, report=report)
    except KeyboardInterrupt:
        print(f"followthrough: {checkpoint} is of step {trainer.step}; the same command continues", file=sys.stderr)
        raise
    next(bar, None)
    trainer.weights().save(args.output)
    plot_losses(trainer, args.output.with_suffix(".png"))
    low, high = trainer.trained_on.stiffness_range
    print(
        f"{args.output}: {sum(p.numel() for p in trainer.network.parameters())} parameters after {trainer.step} steps in "
        f"{trainer.seconds:.0f} s on {len(data.examples)} sequences ({data.frame_count} frames, stiffness {low:.3g} to {high:.3g})"
    )
    for score in trainer.scores[-1:]:
        print(
            f"validation: single frame {score.single_frame:.3g}, rollout 24 {score.rollout_24:.3g}, in the network's metres"
        )
    return 0
