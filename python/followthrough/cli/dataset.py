# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough dataset`: makes training sequences."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from followthrough.cli.progress import ProgressBar
from followthrough.datasets import HeldOutRecipe, ShapesRecipe, SphereRecipe, generate
from followthrough.datasets.generation import PRECISIONS
from followthrough.datasets.motions import PUBLISHED_FRAMES
from followthrough.datasets.spheres import PUBLISHED_STIFFNESSES
from followthrough.datasets.varied import STIFFNESS_RANGE

if TYPE_CHECKING:
    from followthrough.datasets import Recipe, Summary


def add_parser(subparsers: Any) -> None:
    """Add the command's arguments."""
    parser = subparsers.add_parser(
        "dataset",
        help="make training sequences",
        description="Simulate training sequences, converged, into a folder with a manifest. The same seed gives the same "
        "bytes. Run the same command again to continue where it was interrupted, or with more motions to add some.",
    )
    kinds = parser.add_subparsers(title="kinds", metavar="KIND", required=True, dest="kind")
    sphere = kinds.add_parser(
        "sphere",
        help="a sphere that its core shakes, at seven stiffnesses",
        description="The training data of the deep emulator: a sphere of 1,015 vertices whose core goes out and back, and "
        "rings out.",
    )
    _add_common(sphere, "motions of the core, each at every stiffness (the paper has 80)", PUBLISHED_FRAMES)
    sphere.add_argument(
        "--stiffnesses",
        metavar="E",
        type=float,
        nargs="+",
        default=list(PUBLISHED_STIFFNESSES),
        help=f"Young's moduli, Pa (default {' '.join(f'{modulus:g}' for modulus in PUBLISHED_STIFFNESSES)})",
    )
    shapes = kinds.add_parser(
        "shapes",
        help="many shapes in lively motions, of any stiffness and painted materials",
        description="Slabs, blobs, dumbbells, limbs, ears, tails, rings and forks, moved by one or several bones with fast "
        "turns, jumps, stops, twists and swings; each of its own size, frame rate, stiffness and density.",
    )
    _add_common(shapes, "sequences, each of a shape, a motion and a material of its own", ShapesRecipe.frames)
    shapes.add_argument(
        "--stiffness-range",
        metavar=("LOW", "HIGH"),
        type=float,
        nargs=2,
        default=list(STIFFNESS_RANGE),
        help="of E h^2 / (density edge^2), drawn evenly in its logarithm "
        f"(default {' '.join(f'{bound:g}' for bound in STIFFNESS_RANGE)})",
    )
    held_out = kinds.add_parser(
        "held-out",
        help="characters that dance, to measure on and never to train on",
        description="A fat, a thin-limbed, and an eared and tailed character of 5e4 Pa with softer and stiffer regions, in "
        "dances with fast turns, jumps and stops. Shapes and motions are made by other means than those of the training "
        "data. Files begin with the half that they are of: validation or test.",
    )
    _add_common(held_out, "dances of each character in each half", HeldOutRecipe.frames, HeldOutRecipe.seed)


def _add_common(parser: argparse.ArgumentParser, motions: str, frames: int, seed: int | None = None) -> None:
    how_many = "" if seed is None else " (default %(default)s)"
    parser.add_argument("--motions", metavar="N", type=int, required=seed is None, default=2, help=motions + how_many)
    parser.add_argument(
        "--seed",
        metavar="S",
        type=int,
        required=seed is None,
        default=seed,
        help="what the random numbers start from" + how_many,
    )
    parser.add_argument("-o", "--output", metavar="DIR", type=Path, required=True, help="folder of the data set")
    parser.add_argument(
        "--frames", metavar="F", type=int, default=frames, help="frames of a motion (default %(default)s)"
    )
    parser.add_argument(
        "--precision", choices=PRECISIONS, default="float32", help="of positions in the files (default %(default)s)"
    )
    parser.add_argument("--jobs", metavar="J", type=int, help="processes, each on one thread (default: one a core)")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


def run(args: argparse.Namespace) -> int:
    """Do it."""
    return _make(_recipe(args), args)


def _recipe(args: argparse.Namespace) -> Recipe:
    if args.kind == "sphere":
        return SphereRecipe(args.seed, tuple(args.stiffnesses), args.frames)
    if args.kind == "held-out":
        return HeldOutRecipe(args.seed, args.frames)
    return ShapesRecipe(args.seed, args.frames, tuple(args.stiffness_range))


def _make(recipe: Recipe, args: argparse.Namespace) -> int:
    try:
        with ProgressBar("dataset", quiet=args.quiet) as bar:

            def begin(frames: int, kept: int) -> None:
                if kept:
                    print(f"followthrough: {kept} sequences are there already", file=sys.stderr)
                bar.begin(frames)

            summary = generate(
                recipe,
                args.output,
                args.motions,
                precision=args.precision,
                jobs=args.jobs,
                begin=begin,
                frames_done=bar.advance,
            )
    except KeyboardInterrupt:
        print(
            "followthrough: interrupted; what is finished is kept, and the same command continues from there",
            file=sys.stderr,
        )
        return 130
    _report(summary, args.output)
    return 0


def _report(summary: Summary, directory: Path) -> None:
    entries = summary.manifest.files.values()
    size = sum(entry.size for entry in entries) / 1e6
    print(
        f"{directory}: {sum(entry.sha256 is not None for entry in entries)} sequences, "
        f"{sum(entry.frames for entry in entries)} frames, {size:.1f} MB; {summary.made} made, {summary.kept} kept"
    )
    if summary.stopped:
        name = summary.stopped[0]
        print(
            f"followthrough: warning: {len(summary.stopped)} sequences end early, before a frame that did not converge, "
            f"the first is {name} (frame {summary.manifest.files[name].stopped_at}); the manifest lists them",
            file=sys.stderr,
        )
