# SPDX-License-Identifier: GPL-3.0-or-later
"""Data sets: true throughout, the same bytes however they were made, and never half-written."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
from plain_elastic import PlainBody
from shaken_bars import BarRecipe

from followthrough import cli
from followthrough.datasets import Manifest, SphereRecipe, generate, truth
from followthrough.datasets.manifest import file_hash
from followthrough.datasets.motions import core_motion, out_and_back
from followthrough.datasets.spheres import PUBLISHED_STIFFNESSES, sphere_volume
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.sequences import Sequence


def hashes(directory: Path) -> dict[str, str]:
    return {path.name: file_hash(path) for path in directory.iterdir()}


def relative_residual(sequence: Sequence, frame: int) -> float:
    """Of the backward Euler equation at a frame, by plain NumPy."""
    body = PlainBody(
        sequence.rest_positions,
        sequence.tets,
        sequence.youngs_modulus,
        np.broadcast_to(sequence.density, sequence.vertex_count),
    )
    assert sequence.dynamic is not None
    after, now, before = sequence.dynamic[frame], sequence.dynamic[frame - 1], sequence.dynamic[max(frame - 2, 0)]
    inertial = body.mass_product(after - 2 * now + before)
    elastic = sequence.dt**2 * body.forces(after)
    free = ~sequence.constrained
    sizes = np.linalg.norm(inertial[free]) + np.linalg.norm(elastic[free])
    return float(np.linalg.norm((inertial + elastic)[free]) / sizes)


def test_the_sphere_is_the_published_one() -> None:
    volume = sphere_volume()
    assert (len(volume.vertices), len(volume.tets), volume.core.sum()) == (1015, 4320, 99)
    core = volume.vertices[volume.core]
    np.testing.assert_array_equal(np.unique(core[:, 0]), [-0.2, 0, 0.2])
    np.testing.assert_array_equal(np.unique(core[:, 2]), [-0.2, 0, 0.2])
    np.testing.assert_allclose(np.unique(core[:, 1]), np.linspace(-1, 1, 11), atol=1e-15)
    assert len(PUBLISHED_STIFFNESSES) == 7 and PUBLISHED_STIFFNESSES[0] / PUBLISHED_STIFFNESSES[-1] == 100


def test_a_core_is_still_goes_out_comes_back_and_rests() -> None:
    for seed in range(50):
        motion = core_motion(np.random.default_rng(seed))
        places, turns = motion.translations, motion.rotations
        assert len(places) == len(turns) == 457
        for still in (range(25), range(360, 457)):
            assert (places[still] == 0).all() and (turns[still] == turns[0]).all()
        assert np.abs(places[25:360]).max(axis=1).min() > 0
        np.testing.assert_array_equal(places[24:361], places[24:361][::-1])
        np.testing.assert_allclose(
            turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-14
        )
        axis = np.linalg.svd(turns[100] - np.eye(3))[2][2]
        np.testing.assert_allclose(turns @ axis, np.broadcast_to(axis, (457, 3)), atol=1e-12)
        speeds = np.linalg.norm(np.diff(places, axis=0), axis=1)
        assert 0.014 - 1e-12 <= speeds.max() <= 0.14 + 1e-12
        assert np.linalg.norm(np.diff(places, 2, axis=0), axis=1).max() <= 0.14 + 1e-12
        angles = np.arccos(
            np.clip((np.trace(turns[:-1].transpose(0, 2, 1) @ turns[1:], axis1=1, axis2=2) - 1) / 2, -1, 1)
        )
        assert 0.014 - 1e-7 <= angles.max() <= 0.14 + 1e-7


def test_acceleration_is_constant_and_reversed() -> None:
    distance = out_and_back(457, 84, 0.14)
    acceleration = np.diff(distance, 2)
    rate = 0.14 / 84
    np.testing.assert_allclose(acceleration[24:107], rate, atol=1e-14)
    np.testing.assert_allclose(acceleration[108:275], -rate, atol=1e-14)
    np.testing.assert_allclose(acceleration[276:359], rate, atol=1e-14)
    assert distance[192] == distance.max() == pytest.approx(0.14 * 84)


def test_free_vertices_refer_to_the_rigid_motion_of_the_core() -> None:
    recipe = SphereRecipe(3)
    items = recipe.items(2)
    assert [item.name for item in items[:2]] == ["motion-0000-5e6Pa.npz", "motion-0000-2.5e6Pa.npz"] and len(
        items
    ) == 14
    sequence = recipe.make(items[13])
    assert (sequence.youngs_modulus == 5e4).all() and sequence.dt**2 == pytest.approx(1e-3)
    assert np.array_equal(sequence.reference[0], sequence.rest_positions)
    frame = sequence.reference[150]
    lengths = [
        np.linalg.norm(x[sequence.tets[:, 0]] - x[sequence.tets[:, 3]], axis=1) for x in (frame, sequence.reference[0])
    ]
    np.testing.assert_allclose(*lengths, atol=1e-13)
    assert np.linalg.norm(frame - sequence.rest_positions, axis=1).min() > 0.01


def test_a_motion_depends_on_the_seed_and_its_number_alone() -> None:
    one, more, other = SphereRecipe(1, (5e4,)), SphereRecipe(1, (1e5, 5e4)), SphereRecipe(2, (5e4,))
    references = [recipe.make(recipe.items(4)[-1]).reference for recipe in (one, more, other)]
    np.testing.assert_array_equal(references[0], references[1])
    assert not np.array_equal(references[0], references[2])
    assert not np.array_equal(references[0], one.make(one.items(4)[2]).reference)


def test_files_hold_the_truth(tmp_path: Path) -> None:
    command = ["dataset", "sphere", "--motions=1", "--seed=5", "--frames=20", "--stiffnesses", "5e4"]
    assert cli.main([*command, "--precision=float64", "--quiet", "--jobs=1", "-o", str(tmp_path / "set")]) == 0
    sequence = Sequence.load(tmp_path / "set" / "motion-0000-5e4Pa.npz")
    assert sequence.dynamic is not None and sequence.dynamic.shape == (20, 1015, 3)
    for frame in (2, 3, 11, 19):  # still before
        assert relative_residual(sequence, frame) < 1e-8
    np.testing.assert_array_equal(
        sequence.dynamic[:, sequence.constrained], sequence.reference[:, sequence.constrained]
    )
    assert np.abs(sequence.dynamic - sequence.reference).max() > 0.01


def test_short_floats_are_simulated_as_they_are_stored(tmp_path: Path) -> None:
    recipe = BarRecipe(1)
    generate(recipe, tmp_path / "set", 1, jobs=1)
    stored = Sequence.load(tmp_path / "set" / "bar-0000.npz")
    with np.load(tmp_path / "set" / "bar-0000.npz") as archive:
        assert archive["reference"].dtype == archive["dynamic"].dtype == np.float32
    np.testing.assert_array_equal(stored.reference[0], stored.rest_positions)
    solver = ImplicitEuler(ElasticBody.of_sequence(stored), stored.constrained, stored.dt)
    solver.reset(stored.reference[0])
    assert stored.dynamic is not None
    for reference, dynamic in zip(stored.reference[1:], stored.dynamic[1:], strict=True):
        np.testing.assert_array_equal(solver.step(reference).astype(np.float32), dynamic)


def test_bytes_do_not_depend_on_how_it_was_made(tmp_path: Path) -> None:
    recipe = BarRecipe(7)
    frames: list[int] = []
    at_once = generate(recipe, tmp_path / "at once", 5, jobs=1, frames_done=frames.append)
    assert sum(frames) == 5 * recipe.frames and (at_once.kept, at_once.made) == (0, 5)
    expected = hashes(tmp_path / "at once")
    assert len(expected) == 6
    with zipfile.ZipFile(tmp_path / "at once" / "bar-0000.npz") as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}  # no clock in the bytes

    frames.clear()
    generate(recipe, tmp_path / "two processes", 5, jobs=2, frames_done=frames.append)
    assert sum(frames) == 5 * recipe.frames
    assert hashes(tmp_path / "two processes") == expected

    generate(recipe, tmp_path / "bit by bit", 2, jobs=1)
    (tmp_path / "bit by bit" / ".bar-0003-x1y2z3.npz").write_bytes(b"left over")
    (tmp_path / "bit by bit" / ".manifest-x1y2z3.json").write_bytes(b"left over")
    summary = generate(recipe, tmp_path / "bit by bit", 5, jobs=1)
    assert (summary.kept, summary.made) == (2, 3) and hashes(tmp_path / "bit by bit") == expected
    fewer = generate(recipe, tmp_path / "bit by bit", 1, jobs=1)
    assert (fewer.kept, fewer.made) == (5, 0) and hashes(tmp_path / "bit by bit") == expected

    damaged = tmp_path / "bit by bit" / "bar-0001.npz"
    damaged.write_bytes(damaged.read_bytes()[:-1] + b"?")
    (tmp_path / "bit by bit" / "bar-0004.npz").unlink()
    summary = generate(recipe, tmp_path / "bit by bit", 5, jobs=1)
    assert (summary.kept, summary.made) == (3, 2) and hashes(tmp_path / "bit by bit") == expected


def test_interrupted_it_keeps_what_is_finished(tmp_path: Path) -> None:
    recipe, done = BarRecipe(7), 0

    def count(frames: int) -> None:
        nonlocal done
        done += frames
        if done == 2 * recipe.frames + 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate(recipe, tmp_path / "set", 4, jobs=1, frames_done=count)
    assert sorted(hashes(tmp_path / "set")) == ["bar-0000.npz", "bar-0001.npz", "manifest.json"]
    manifest = Manifest.load(tmp_path / "set")
    assert manifest.intact(tmp_path / "set", manifest.files) == {"bar-0000.npz", "bar-0001.npz"}


def begin_and_stop(program: list[str], directory: Path, how: signal.Signals) -> tuple[int, bytes]:
    """Run a program until it has made a file, stop it, and return its exit status and what it said."""
    process = subprocess.Popen(
        [sys.executable, *program], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )
    deadline = time.monotonic() + 60
    while not list(directory.glob("*.npz")) and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(process.pid, how) if how == signal.SIGINT else process.send_signal(how)
    said, _ = process.communicate(timeout=60)  # ends when the workers, too, have let go of the pipe
    return process.returncode, said


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_ctrl_c_is_clean(tmp_path: Path) -> None:
    command = ["dataset", "sphere", "--motions=50", "--seed=1", "--frames=20", "--stiffnesses", "5e4", "--jobs=2"]
    program = ["-m", "followthrough", *command, "-o", str(tmp_path / "set")]
    status, said = begin_and_stop(program, tmp_path / "set", signal.SIGINT)
    assert status == 130, said
    assert b"Traceback" not in said and b"interrupted; what is finished is kept" in said
    manifest = Manifest.load(tmp_path / "set")
    assert {path.name for path in (tmp_path / "set").iterdir()} == {*manifest.files, "manifest.json"}
    assert manifest.intact(tmp_path / "set", manifest.files) == set(manifest.files)


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_killed_it_leaves_no_half_file_and_no_process_and_goes_on(tmp_path: Path) -> None:
    code = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from shaken_bars import BarRecipe
from followthrough.datasets import generate
generate(BarRecipe(1, frames=60), {str(tmp_path / "set")!r}, 40, jobs=2)
"""
    status, _ = begin_and_stop(["-c", code], tmp_path / "set", signal.SIGKILL)
    assert status == -signal.SIGKILL
    for path in (tmp_path / "set").glob("bar*"):
        assert Sequence.load(path).frame_count == 60
    manifest = Manifest.load(tmp_path / "set")
    assert manifest.intact(tmp_path / "set", manifest.files) == set(manifest.files)
    for directory in ("set", "at once"):
        generate(BarRecipe(1, frames=60), tmp_path / directory, 40, jobs=1)
    assert hashes(tmp_path / "set") == hashes(tmp_path / "at once")


def test_steps_that_do_not_converge_are_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(truth, "_FIRST_TRY", (1, 100))
    summary = generate(BarRecipe(1), tmp_path / "set", 1, jobs=1)
    entry = summary.manifest.files["bar-0000.npz"]
    assert entry.tried_again and entry.worst_residual <= truth.ACCEPTED_RESIDUAL and entry.stopped_at is None
    monkeypatch.undo()
    expected = generate(BarRecipe(1), tmp_path / "expected", 1, jobs=1)
    assert entry.sha256 == expected.manifest.files["bar-0000.npz"].sha256


def test_a_sequence_ends_before_a_step_that_does_not_converge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(truth, "_FIRST_TRY", (1, 1))
    monkeypatch.setattr(truth, "_PATIENCE", (1, 2))
    for still, frames in ((10, 11), (3, 0)):
        recipe, directory = BarRecipe(1, still=still), tmp_path / f"still {still}"
        done: list[int] = []
        summary = generate(recipe, directory, 1, jobs=1, frames_done=done.append)
        entry = summary.manifest.files["bar-0000.npz"]
        assert sum(done) == recipe.frames  # the progress bar ends full
        assert summary.stopped == ["bar-0000.npz"]
        assert (entry.frames, entry.stopped_at) == (frames, still + 1)
        assert entry.stopped_residual is not None and entry.stopped_residual > truth.ACCEPTED_RESIDUAL
        if frames:
            stored = Sequence.load(directory / "bar-0000.npz")
            assert stored.frame_count == frames and np.array_equal(stored.dynamic, stored.reference)
        else:
            assert entry.sha256 is None and [path.name for path in directory.iterdir()] == ["manifest.json"]
        again = generate(recipe, directory, 1, jobs=1)
        assert (again.kept, again.made) == (1, 0) and again.stopped == summary.stopped
    command = ["dataset", "sphere", "--motions=1", "--seed=1", "--frames=20", "--stiffnesses", "5e4", "--jobs=1"]
    assert cli.main([*command, "-o", str(tmp_path / "said")]) == 0
    assert "1 sequences end early, before a frame that did not converge" in capsys.readouterr().err


def test_another_data_set_is_not_mixed_with_this_one(tmp_path: Path) -> None:
    generate(BarRecipe(1), tmp_path / "set", 1, jobs=1)
    before = hashes(tmp_path / "set")
    for recipe, precision, named in (
        (BarRecipe(2), "float32", "seed 1"),
        (BarRecipe(1, frames=16), "float32", "frames 15"),
        (BarRecipe(1), "float64", "precision float32"),
        (SphereRecipe(1), "float32", "kind bar"),
    ):
        with pytest.raises(ValueError, match=f"another data set \\({named}\\), expected .* empty folder"):
            generate(recipe, tmp_path / "set", 1, precision=precision, jobs=1)  # type: ignore[arg-type]
    assert hashes(tmp_path / "set") == before

    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").write_bytes(b"")
    with pytest.raises(ValueError, match=r"found cat\.png and no manifest"):
        generate(BarRecipe(1), tmp_path / "photos", 1, jobs=1)
    for content in ("", "[]", '{"format": "other"}', '{"format": "followthrough data set 1", "files": {}}'):
        (tmp_path / "set" / "manifest.json").write_text(content)
        with pytest.raises(ValueError, match=r"manifest\.json: found"):
            generate(BarRecipe(1), tmp_path / "set", 1, jobs=1)
    (tmp_path / "set" / "manifest.json").write_text(json.dumps({}))
    with pytest.raises(ValueError, match="another format"):
        Manifest.load(tmp_path / "set")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--motions=0", "--seed=1"], "motions: found 0, expected 1 or more"),
        (["--motions=1", "--seed=-1"], "seed: found -1"),
        (["--motions=1", "--seed=1", "--jobs=0"], "jobs: found 0"),
        (["--motions=1", "--seed=1", "--frames=3"], "frames: found 3, expected 20 or more"),
        (["--motions=1", "--seed=1", "--stiffnesses", "5e4", "nan"], "stiffnesses: found nan"),
        (["--motions=1", "--seed=1", "--stiffnesses", "5e4", "50000"], "stiffnesses: found one twice"),
    ],
)
def test_bad_arguments_are_named_and_make_nothing(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["dataset", "sphere", *options, "-o", str(tmp_path / "set")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


def test_making_data_needs_neither_torch_nor_blender() -> None:
    code = "import sys, followthrough.cli.dataset; print(*{'torch', 'bpy', 'mathutils'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True).stdout.strip() == b""
