# SPDX-License-Identifier: GPL-3.0-or-later
"""How far bakes are from the converged simulation's: `python cpp/bench/baked_error.py CHARACTER [--action NAME]`.

A character is baked as the command line does it, painted as it is or as is suggested. Root mean squares over the baked keys of all
meshes, as shares of the converged ones: what an artist sees of a solver's error.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import tempfile
import warnings
from pathlib import Path

import bpy
import numpy as np

from followthrough import cli
from followthrough.character import FloatArray

TRUTH = ["--solver", "implicit-euler", "--quality", "converged"]
METHODS = {
    "emulator": ["--solver", "emulator"],
    "simulation, preview": ["--solver", "implicit-euler", "--quality", "preview"],
    "simulation, fine": ["--solver", "implicit-euler", "--quality", "fine"],
}


def keys_of(path: Path) -> FloatArray:
    """Offsets of all baked keys of a file, one after the other, in the meshes' own units."""
    bpy.ops.wm.open_mainfile(filepath=str(path))
    offsets = []
    for mesh in sorted((m for m in bpy.data.meshes if m.shape_keys), key=lambda m: m.name):
        basis, *keys = mesh.shape_keys.key_blocks
        rest = np.empty(3 * len(mesh.vertices))
        basis.data.foreach_get("co", rest)
        for key in keys:
            positions = np.empty_like(rest)
            key.data.foreach_get("co", positions)
            offsets.append(positions - rest)
    if not offsets:
        raise SystemExit(f"{path}: found no shape keys, expected baked ones")
    return np.concatenate(offsets)


def bake(character: Path, output: Path, options: list[str]) -> FloatArray:
    """The keys that a bake with these options makes."""
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        status = cli.main(["bake", str(character), "-o", str(output), "--quiet", *options])
    if status:
        raise SystemExit(status)
    return keys_of(output)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("character", type=Path, help=".blend, .glb, .gltf or .fbx")
    parser.add_argument("--action", help="to play")
    arguments = parser.parse_args()
    chosen = [] if arguments.action is None else ["--action", arguments.action]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "baked.blend"
        truth = bake(arguments.character, output, [*TRUTH, *chosen])
        lines = ["| solver | off by, % of the secondary motion |", "| --- | ---: |"]
        for name, options in METHODS.items():
            off = bake(arguments.character, output, [*options, *chosen]) - truth
            lines.append(f"| {name} | {100 * np.sqrt(np.mean(off**2) / np.mean(truth**2)):.2g} |")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
