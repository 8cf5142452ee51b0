# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters to measure on: sound, lively, painted, and of other makers than what is trained on."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from followthrough import cli, datasets, mesh
from followthrough.datasets import HeldOutRecipe, Manifest
from followthrough.datasets.choreography import dance
from followthrough.sequences import Sequence

TRAINING = {"shapes", "gestures", "varied", "motions"}
HELD_OUT = {"characters", "choreography"}


@pytest.fixture(scope="module")
def sequences() -> dict[str, Sequence]:
    recipe = HeldOutRecipe(frames=80)
    return {item.name: recipe.make(item) for item in recipe.items(1)}


def imports(module: str) -> set[str]:
    """Modules of the package that a module uses, through others too."""
    package = Path(datasets.__file__).parent
    found: set[str] = set()
    waiting = [module]
    while waiting:
        tree = ast.parse((package / f"{waiting.pop()}.py").read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("followthrough.datasets."):
                name = str(node.module).split(".")[2]
                if name not in found:
                    found.add(name)
                    waiting.append(name)
    return found


def test_measuring_and_training_share_no_makers() -> None:
    for module in HELD_OUT:
        assert not imports(module) & TRAINING, module
    for module in TRAINING:
        assert not imports(module) & HELD_OUT, module
    assert "bodies" in imports("characters") & imports("shapes")  # the check sees what is shared


def test_characters_are_whole_and_alike_only_in_being_characters(sequences: dict[str, Sequence]) -> None:
    assert list(sequences) == [
        f"{half}-{name}-0000.npz" for half in ("validation", "test") for name in ("fat", "thin", "eared")
    ]
    for sequence in sequences.values():
        assert (mesh.connected_parts(sequence.tets, sequence.vertex_count) == 0).all()
        assert 600 < sequence.vertex_count < 2500
        assert 0.05 < sequence.constrained.mean() < 0.4
        np.testing.assert_array_equal(sequence.reference[0], sequence.rest_positions)
        x = sequence.rest_positions[sequence.tets]
        np.testing.assert_allclose(np.linalg.det(x[:, 1:] - x[:, :1]), 0.2**3, rtol=1e-9)
        modulus = sequence.youngs_modulus
        assert modulus.min() < 3e4 and modulus.max() > 1.5e5 and 3e4 < np.median(modulus) < 7e4
    counts = [sequence.vertex_count for sequence in sequences.values()]
    assert len(set(counts)) == 6  # the halves' builds differ, too


def test_dances_turn_jump_and_stop() -> None:
    bones = ("hips", "chest", "head", "left arm", "right leg", "tail")
    stops, jumps, turns = 0, 0, 0.0
    for seed in range(10):
        pose = dance(np.random.default_rng(seed), 240, bones)
        assert (pose.turns[0] == 0).all() and (pose.translations[0] == 0).all()
        assert (pose.turns[:, 5] == 0).all()
        speed = np.linalg.norm(np.diff(pose.translations, axis=0), axis=1) + np.abs(np.diff(pose.turns, axis=0)).max(
            (1, 2)
        )
        stops += int((speed[20:] == 0).sum())
        jumps += int(pose.translations[:, 2].max() > 1.5)
        turns = max(turns, float(np.abs(np.diff(pose.turns[:, 0, 2])).max()))
    assert stops > 50 and jumps >= 8 and turns > 0.2


def test_dances_are_hard_but_within_bounds(sequences: dict[str, Sequence]) -> None:
    for name, sequence in sequences.items():
        held = sequence.reference[:, sequence.constrained] / 0.2
        hardest = np.linalg.norm(np.diff(held, 2, axis=0), axis=2).max()
        assert 0.4 < hardest < 4, name


def test_halves_differ_and_every_dance_is_its_own() -> None:
    recipe = HeldOutRecipe(frames=40)
    items = {item.name: item for item in recipe.items(2)}
    lengths = {name: recipe.make(item).reference for name, item in items.items()}
    assert lengths["test-fat-0000.npz"].shape != lengths["validation-fat-0000.npz"].shape
    assert not np.array_equal(lengths["test-fat-0000.npz"], lengths["test-fat-0001.npz"])
    again = HeldOutRecipe(frames=40).make(items["test-fat-0001.npz"])
    np.testing.assert_array_equal(again.reference, lengths["test-fat-0001.npz"])


def test_held_out_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["dataset", "held-out", "--motions=1", "--frames=20", "--jobs=1", "-o", str(tmp_path / "set")]
    assert cli.main(command) == 0
    assert "6 sequences, 120 frames" in capsys.readouterr().out
    manifest = Manifest.load(tmp_path / "set")
    assert manifest.seed == 0
    assert all(entry.worst_residual <= 1e-8 and entry.stopped_at is None for entry in manifest.files.values())
    assert manifest.files["test-thin-0000.npz"].facts == {"half": "test", "character": "thin"}
