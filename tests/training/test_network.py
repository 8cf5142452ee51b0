# SPDX-License-Identifier: GPL-3.0-or-later
"""The network in PyTorch against the native one."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from elastic_scenes import bar

from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.sequences import Sequence
from followthrough.simulation import simulate
from followthrough.training.network import PatchNetwork, import_state_dict, load_weights, rollout, save_weights
from followthrough.training.patches import PatchBatch, Scene

CELLS = 3

torch.set_num_threads(1)  # these networks are small: waiting for other threads costs more than they do


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    """A block of cubes that turns and swings for a hundred frames."""
    rest, tets = bar(CELLS, CELLS, CELLS)
    reference = []
    for t in range(101):
        angle = 0.5 * math.sin(0.2 * t)
        turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
        reference.append(rest @ turn.T + [0.3 * math.sin(0.15 * t), 0, 0.1 * math.sin(0.4 * t)])
    return Sequence(
        rest_positions=rest,
        tets=tets,
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.geomspace(5e4, 5e6, len(rest)),
        dt=math.sqrt(0.001),
        reference=np.array(reference),
    )


def calm(network: PatchNetwork, gain: float = 0.03) -> PatchNetwork:
    """So that a rollout stays bounded."""
    with torch.no_grad():
        for name, parameter in network.named_parameters():
            if name.startswith("instance_mlp") and parameter.shape[0] == 3:
                parameter *= gain
    return network


ARCHITECTURES = [
    {},
    {"sees_reference": False},
    {"biases": False},
    {"rings": 2, "force": (32, 32, 32)},
    {"rings": 3, "force": (24, 16), "inertia": (20, 12), "displacement": (40,), "sees_reference": False},
]


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_hundred_frames_agree_with_the_native_emulator(
    sequence: Sequence, architecture: dict, tmp_path: Path
) -> None:
    torch.manual_seed(1)
    network = calm(PatchNetwork(**architecture))
    path = tmp_path / "weights.npz"
    save_weights(network, path)
    expected = rollout(network, sequence)
    result = simulate(sequence, Emulator.of_sequence(sequence, EmulatorWeights.load(path))).dynamic
    assert result is not None
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-5)
    moved = np.abs(expected - sequence.reference).max()
    assert 0.02 < moved < 5


def test_the_published_network_has_its_names_and_size() -> None:
    network = PatchNetwork()
    expected = {
        f"{mlp}.{layer}.{kind}"
        for mlp in ("edge_mlp", "point_mlp", "instance_mlp")
        for layer in (0, 2, 4, 6, 8)
        for kind in ("weight", "bias")
    }
    assert set(network.state_dict()) == expected
    assert sum(parameter.numel() for parameter in network.parameters()) == 237_571


def test_weights_go_out_and_come_back(tmp_path: Path) -> None:
    torch.manual_seed(2)
    for architecture in ARCHITECTURES:
        network = PatchNetwork(**architecture)
        trained = TrainedOn(stiffness_range=(0.5, 150.0))
        save_weights(network, tmp_path / "weights.npz", trained, {"seed": 2})
        back, reach = load_weights(tmp_path / "weights.npz")
        assert reach == trained
        for name, tensor in network.state_dict().items():
            assert torch.equal(back.state_dict()[name], tensor)
    uneven = dict(PatchNetwork().to_weights().parameters)
    del uneven["edge_mlp.4.bias"]
    with pytest.raises(ValueError, match="biases in some layers only"):
        PatchNetwork.from_weights(EmulatorWeights(uneven))
    torch.save(PatchNetwork().state_dict(), tmp_path / "published.pt")
    assert import_state_dict(tmp_path / "published.pt").parameter_count == 237_571
    (tmp_path / "broken.pt").write_bytes(b"not a state dict")
    with pytest.raises(ValueError, match="found no state dict"):
        import_state_dict(tmp_path / "broken.pt")


def test_other_units_give_the_same_motion(sequence: Sequence) -> None:
    torch.manual_seed(3)
    network = calm(PatchNetwork(force=(32, 32)))
    short = replace(sequence, reference=sequence.reference[:20])
    scaled = replace(
        short,
        rest_positions=short.rest_positions * 100,
        reference=short.reference * 100,
        youngs_modulus=short.youngs_modulus * 1e4 / 4,
        dt=short.dt * 2,
    )
    np.testing.assert_allclose(rollout(network, scaled) / 100, rollout(network, short), rtol=0, atol=1e-5)


def test_frames_and_scenes_can_stand_in_one_batch(sequence: Sequence) -> None:
    torch.manual_seed(4)
    network = PatchNetwork()
    scene = Scene.of_sequence(sequence, TrainedOn())
    x = scene.displacements(sequence.reference)
    one = [scene.batch(x[[t, t - 1, t - 2]], x[[t + 1, t, t - 1]]) for t in (10, 50)]
    both = PatchBatch.join(one)
    expected = torch.cat([network(batch) for batch in one])
    torch.testing.assert_close(network(both), expected, rtol=0, atol=1e-6)


def test_gradients_reach_every_parameter(sequence: Sequence) -> None:
    torch.manual_seed(5)
    for architecture in ARCHITECTURES:
        network = PatchNetwork(**architecture)
        scene = Scene.of_sequence(sequence, TrainedOn(), network.rings)
        x = scene.displacements(sequence.reference)
        network(scene.batch(x[[9, 8, 7]], x[[10, 9, 8]])).square().sum().backward()
        for name, parameter in network.named_parameters():
            assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")
def test_a_gpu_gives_the_same_motion(sequence: Sequence) -> None:
    torch.manual_seed(6)
    network = calm(PatchNetwork())
    expected = rollout(network, sequence)
    np.testing.assert_allclose(rollout(network.to("cuda"), sequence), expected, rtol=0, atol=1e-4)
