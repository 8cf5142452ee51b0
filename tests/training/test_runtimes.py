# SPDX-License-Identifier: GPL-3.0-or-later
"""PyTorch and ONNX Runtime, with every batching that is timed, take the native kernel's steps."""

import warnings

import numpy as np
import pytest

from followthrough.benchmarking import runtimes
from followthrough.benchmarking.emulator_speed import published_weights
from followthrough.benchmarking.runtimes import Batching, OnnxSolver, PyTorchSolver, batchings, fastest, native_solver
from followthrough.benchmarking.scene import Scene, make_scene
from followthrough.training.patches import Scene as Patches

pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene(300, 6)


@pytest.mark.parametrize(
    ("kind", "batching"), [(kind, batching) for kind in (PyTorchSolver, OnnxSolver) for batching in batchings(kind)]
)
def test_frames_agree_with_the_native_kernel(scene: Scene, kind: type, batching: Batching) -> None:
    weights = published_weights(3)
    reference = scene.sequence.reference
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patches = Patches.of_sequence(scene.sequence, weights.trained_on, edge_length=scene.edge)
    native, other = native_solver(scene, weights), kind(patches, weights, batching)
    native.reset(reference[0])
    other.reset(reference[0])
    for frame in range(1, 7):
        expected, found = native.step(reference[frame]), other.step(reference[frame])
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5)
    assert np.abs(expected - reference[6]).max() > 1e-2


@pytest.mark.parametrize("kind", [PyTorchSolver, OnnxSolver])
def test_wrong_results_are_an_error(scene: Scene, kind: type, monkeypatch: pytest.MonkeyPatch) -> None:
    changes = kind.changes
    monkeypatch.setattr(runtimes, "CHUNKS", (None,))
    assert fastest(scene, published_weights(), kind).tried == str(len(kind.LAYOUTS))
    monkeypatch.setattr(kind, "changes", lambda *arguments: 1.01 * changes(*arguments))
    with pytest.raises(ValueError, match=f"{kind.__name__} .*from the native kernel's"):
        fastest(scene, published_weights(), kind)
