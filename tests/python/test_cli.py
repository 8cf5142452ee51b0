# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as a script meets it: files, standard output and error, exit status."""

import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from elastic_scenes import bar

import followthrough
from followthrough import cli
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.quasistatic import Quasistatic
from followthrough.sequences import Sequence
from followthrough.simulation import DEFAULT_DAMPING_RATIO, DEFAULT_STIFFNESS, simulate, uniform_constants
from followthrough.springs import Springs

FRAMES, VERTICES = 20, 6


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    t = np.arange(FRAMES) / 24
    rest = rng.normal(size=(VERTICES, 3))
    path = tmp_path / "motion.npz"
    Sequence(
        rest_positions=rest,
        tets=np.array([[0, 1, 2, 3], [2, 3, 4, 5]], dtype=np.int32),
        constrained=np.arange(VERTICES) < 2,
        youngs_modulus=np.full(VERTICES, 5e4),
        dt=1 / 24,
        reference=rest + np.stack([np.sin(9 * t), 0 * t, t * t], axis=1)[:, None],
    ).save(path)
    return path


@pytest.fixture
def output(tmp_path: Path) -> Path:
    (tmp_path / "out").mkdir()
    return tmp_path / "out" / "result.npz"


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run a command that must fail on its input, and return the one line that it says."""
    assert cli.main([str(argument) for argument in arguments]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    lines = [line for line in said.err.splitlines() if line.startswith("followthrough: error: ")]
    assert len(lines) == 1 and said.err.splitlines()[-1] == lines[0]
    return lines[0]


def test_simulate_fills_in_the_motion(sequence: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["simulate", str(sequence), "-o", str(output)]) == 0
    said = capsys.readouterr()
    assert "20 frames of 6 vertices" in said.out and "100%" in said.err
    result, given = Sequence.load(output), Sequence.load(sequence)
    assert result.dynamic is not None
    np.testing.assert_array_equal(result.reference, given.reference)
    np.testing.assert_array_equal(result.dynamic[0], given.reference[0])
    np.testing.assert_array_equal(result.dynamic[:, :2], given.reference[:, :2])
    assert np.abs(result.dynamic - given.reference)[5:, 2:].max() > 0.01
    assert [path.name for path in output.parent.iterdir()] == ["result.npz"]


def test_constants_from_numbers_a_file_or_the_defaults_are_the_same_thing(
    sequence: Path, output: Path, tmp_path: Path
) -> None:
    springs = tmp_path / "springs.npz"
    damping = 2 * DEFAULT_DAMPING_RATIO * np.sqrt(DEFAULT_STIFFNESS)
    np.savez(springs, ks=np.full(VERTICES, DEFAULT_STIFFNESS), kd=np.full(VERTICES, damping))
    results = []
    for options in (
        [],
        ["--stiffness", str(DEFAULT_STIFFNESS), "--damping", str(damping)],
        ["--springs", str(springs)],
    ):
        assert cli.main(["simulate", str(sequence), "--quiet", "-o", str(output), *options]) == 0
        results.append(Sequence.load(output).dynamic)
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])
    assert cli.main(["simulate", str(sequence), "--quiet", "-o", str(output), "--stiffness", "1e12"]) == 0
    stiff = Sequence.load(output)
    np.testing.assert_allclose(stiff.dynamic, stiff.reference, rtol=0, atol=1e-8)


def test_solvers_that_are_not_there_are_named(sequence: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "magic is not a solver, expected springs" in refused(
        capsys, "simulate", sequence, "--solver", "magic", "-o", output
    )
    assert not output.exists()


def test_the_elastic_solver_moves_the_sequence_with_its_own_material(
    sequence: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        given = Sequence.load(sequence)
        solver = ImplicitEuler(ElasticBody.of_sequence(given), given.constrained, given.dt)
    expected = simulate(given, solver).dynamic
    command = ("simulate", str(sequence), "--solver", "implicit-euler", "-o", str(output))
    assert cli.main([*command]) == 0
    assert "20 frames of 6 vertices" in capsys.readouterr().out
    np.testing.assert_array_equal(Sequence.load(output).dynamic, expected)
    results = []
    for options in (("--material", "corotational"), ("--quality", "preview"), ("--tolerance", "1e-3")):
        assert cli.main([*command, "--quiet", *options]) == 0
        results.append(Sequence.load(output).dynamic)
        np.testing.assert_array_equal(results[-1][:, :2], given.reference[:, :2])
        assert not np.array_equal(results[-1], expected)
    output.unlink()
    capsys.readouterr()
    assert "only with springs" in refused(capsys, *command, "--stiffness", 5)
    assert "only with implicit-euler" in refused(capsys, "simulate", sequence, "--quality", "preview", "-o", output)
    assert "only with central-differences" in refused(capsys, *command, "--substeps", 5)
    assert "substeps: found 0" in refused(
        capsys, "simulate", sequence, "--solver", "central-differences", "--substeps", 0, "-o", output
    )
    assert "tolerance: found 0" in refused(capsys, *command, "--tolerance", 0)
    assert not output.exists()


def test_every_frame_rests_in_its_pose_and_springs_swing_about_that(
    tmp_path: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rest, tets = bar(4, 1, 1)
    bends = [rest + 0.1 * np.sin(frame) * rest[:, :1] ** 2 * [0, 1, 0] for frame in range(6)]
    held = (rest[:, 0] < 0.1) | (rest[:, 0] > 0.7)
    given = Sequence(rest, tets, held, np.full(len(rest), 5e4), 1 / 24, np.array(bends))
    sequence = tmp_path / "bar.npz"
    given.save(sequence)
    options = ("--gravity", "0", "0", "-9.81", "--tolerance", "1e-6")
    command = ("simulate", str(sequence), "--solver", "quasistatic", "-o", str(output))
    assert cli.main([*command, *options]) == 0
    assert "6 frames of 20 vertices" in capsys.readouterr().out
    found = Sequence.load(output).dynamic
    body = ElasticBody.of_sequence(given)
    layer = Quasistatic(body, held, tolerance=1e-6, gravity=[0, 0, -9.81])
    np.testing.assert_array_equal(found, [layer.solve(pose) for pose in given.reference])
    assert np.abs(found - given.reference).max() > 1e-3

    over = ("simulate", str(sequence), "--stiffness", "900", "--over", "quasistatic", "-o", str(output), "--quiet")
    assert cli.main([*over, *options]) == 0
    springs = Springs(*uniform_constants(len(rest), 900), given.dt, held)
    expected = simulate(replace(given, reference=found), springs).dynamic
    np.testing.assert_array_equal(Sequence.load(output).dynamic, expected)

    capsys.readouterr()
    assert cli.main([*command, "--quality", "fine", "--material", "corotational", "--quiet"]) == 0
    assert not np.array_equal(Sequence.load(output).dynamic, found)
    assert capsys.readouterr().err == ""
    torn = tmp_path / "torn.npz"
    replace(given, reference=np.array([rest, 100 * rest])).save(torn)
    assert cli.main(["simulate", str(torn), *command[2:], "--material", "corotational", "--quiet"]) == 0
    assert "1 frames have not converged, the first is 1" in capsys.readouterr().err
    assert cli.main(["simulate", str(sequence), "-o", str(sequence), "--quiet"]) == 0
    capsys.readouterr()
    scores = {}
    for solver in ([], ["--solver", "emulator"], ["--stiffness", "900"], ["--solver", "springs", "--stiffness", "900"]):
        assert cli.main(["evaluate", str(sequence), *solver, "--json", "--quiet"]) == 0
        scores[" ".join(solver)] = json.loads(capsys.readouterr().out)["rollout_all"]
    assert scores[""] == scores["--solver emulator"]
    assert scores["--stiffness 900"] == scores["--solver springs --stiffness 900"] != scores[""]
    assert cli.main(["evaluate", str(sequence), "--solver", "quasistatic", "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["rollout_all"] > 0
    output.unlink()
    assert "only with springs" in refused(capsys, *command, "--over", "quasistatic")
    assert "only with central-differences" in refused(capsys, *command, "--substeps", 5)
    assert "substeps" in refused(capsys, "simulate", sequence, "--substeps", 5, "-o", output)
    free = tmp_path / "free.npz"
    replace(given, constrained=np.zeros(len(rest), dtype=bool)).save(free)
    assert "nothing holds" in refused(capsys, "simulate", free, "--solver", "quasistatic", *options, "-o", output)
    assert not output.exists()


def test_inverted_and_flat_rest_tets(
    sequence: Path, output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = Sequence.load(sequence)
    changed = tmp_path / "changed.npz"
    for tets, words in (
        ([[0, 1, 2, 3], [2, 3, 5, 4]], "inverted at rest"),
        ([[1, 0, 2, 3], [2, 3, 5, 4]], "inverted at rest"),
    ):
        replace(given, tets=np.array(tets, dtype=np.int32)).save(changed)
        assert cli.main(["simulate", str(changed), "--solver", "implicit-euler", "--quiet", "-o", str(output)]) == 0
        warned = words in capsys.readouterr().err
        corners = given.rest_positions[np.array(tets)]
        assert warned == (np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0).any()
        output.unlink()
    flat = given.rest_positions.copy()
    flat[:4, 2] = 0
    replace(given, rest_positions=flat).save(changed)
    line = refused(capsys, "simulate", changed, "--solver", "implicit-euler", "-o", output)
    assert "tet 0 has no volume" in line
    assert not output.exists()


def test_constants_that_do_not_fit_are_refused(
    sequence: Path, output: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    springs = tmp_path / "springs.npz"
    command = ("simulate", sequence, "-o", output)
    for arrays, message in (
        ({"ks": np.ones(VERTICES)}, "found ks, expected exactly ks and kd"),
        ({"ks": np.ones(VERTICES), "kd": np.ones(3)}, "kd: found shape (3,) of float64, expected (6,)"),
        ({"ks": np.full(VERTICES, -1.0), "kd": np.ones(VERTICES)}, "ks: found negative"),
        ({"ks": np.full(VERTICES, np.nan), "kd": np.ones(VERTICES)}, "ks: found negative or non-finite"),
    ):
        np.savez(springs, **arrays)
        assert message in refused(capsys, *command, "--springs", springs)
    assert "either the file or the numbers" in refused(capsys, *command, "--springs", springs, "--damping", 1)
    assert "stiffness: found -1" in refused(capsys, *command, "--stiffness", -1)
    assert "damping: found nan" in refused(capsys, *command, "--damping", "nan")
    assert not output.exists()


def test_a_missing_output_folder_is_said_before_any_work(
    sequence: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = refused(capsys, "simulate", sequence, "-o", tmp_path / "missing" / "result.npz")
    assert f"{tmp_path / 'missing'} is not there" in line
    line = refused(capsys, "tetrahedralize", tmp_path / "a.obj", "-o", tmp_path / "missing" / "result.npz")
    assert f"{tmp_path / 'missing'} is not there" in line


def test_foreign_and_missing_input_is_named(sequence: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    foreign = sequence.with_name("foreign.npz")
    foreign.write_text("not a sequence")
    assert "foreign.npz: found no readable" in refused(capsys, "simulate", foreign, "-o", output)
    assert "gone.npz: found no such file" in refused(capsys, "simulate", sequence.with_name("gone.npz"), "-o", output)
    assert "gone.obj: found no such file" in refused(
        capsys, "tetrahedralize", sequence.with_name("gone.obj"), "-o", output
    )
    assert not output.exists()


def test_a_motion_that_leaves_the_numbers_stops_with_its_frame(
    sequence: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = Sequence.load(sequence)
    given.reference[6] = 1.7e308
    given.reference[5] = -1.7e308
    given.save(sequence)
    line = refused(capsys, "simulate", sequence, "-o", output)
    assert re.search(
        "non-finite positions in frame [45],", line
    )  # the velocity of frame 4 leaves them, its position need not
    assert not output.exists()


def write_box(path: Path) -> Path:
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 2)]
    quads = ["1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {quad}" for quad in quads]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_tetrahedralize_writes_volume_and_embedding(
    tmp_path: Path, output: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    surface = write_box(tmp_path / "box.obj")
    assert cli.main(["tetrahedralize", str(surface), "--cells", "4", "-o", str(output)]) == 0
    said = capsys.readouterr().out
    with np.load(output, allow_pickle=False) as file:
        assert set(file.files) == {"vertices", "tets", "embedding_tets", "embedding_weights"}
        vertices, tets = file["vertices"], file["tets"]
        corners, weights = tets[file["embedding_tets"]], file["embedding_weights"]
    assert tets.dtype == np.int32 and len(tets) % 6 == 0
    assert f"{len(tets) // 6} cells" in said and f"{len(vertices)} vertices, {len(tets)} tets, 1 part" in said
    box = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 2)], dtype=float)
    np.testing.assert_allclose(np.einsum("vk,vkd->vd", weights, vertices[corners]), box, rtol=0, atol=1e-12)


def test_tetrahedralize_refuses_nonsense(tmp_path: Path, output: Path, capsys: pytest.CaptureFixture[str]) -> None:
    surface = write_box(tmp_path / "box.obj")
    assert "cells" in refused(capsys, "tetrahedralize", surface, "--cells", 0, "-o", output)
    assert "cell_size" in refused(capsys, "tetrahedralize", surface, "--cell-size", -1, "-o", output)
    surface.write_text("v 0 0 nan\n")
    assert "box.obj: line 1" in refused(capsys, "tetrahedralize", surface, "-o", output)
    assert not output.exists()


def run(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join(sys.path)
    return subprocess.run(
        [sys.executable, "-m", "followthrough", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path, **environment},
    )


def test_version_and_usage() -> None:
    assert run("--version").stdout == f"followthrough {followthrough.__version__}\n"
    listing = run("--help")
    assert listing.returncode == 0
    for command in ("tetrahedralize", "simulate", "bake"):
        assert command in listing.stdout
    for wrong in ([], ["fly"], ["simulate"], ["simulate", "a.npz", "-o", "b.npz", "--speed", "3"]):
        done = run(*wrong)
        assert done.returncode == 2 and "usage: followthrough" in done.stderr


def test_only_bake_needs_blender(sequence: Path, output: Path) -> None:
    script = (
        "import sys\n"
        "sys.modules['bpy'] = None  # importing it would fail\n"
        "from followthrough.cli import main\n"
        f"status = main(['simulate', {str(sequence)!r}, '--quiet', '-o', {str(output)!r}])\n"
        "assert status == 0\n"
    )
    path = os.pathsep.join(sys.path)
    subprocess.run([sys.executable, "-c", script], env={**os.environ, "PYTHONPATH": path}, check=True)


@pytest.mark.skipif(sys.platform == "win32", reason="sends POSIX signals")
def test_interrupted_it_leaves_nothing_behind(tmp_path: Path, output: Path) -> None:
    count = 4000
    rest = np.random.default_rng(0).normal(size=(count, 3))
    Sequence(
        rest_positions=rest,
        tets=np.array([[0, 1, 2, 3]], dtype=np.int32),
        constrained=np.zeros(count, dtype=bool),
        youngs_modulus=np.ones(count),
        dt=1 / 24,
        reference=np.repeat(rest[None], 300, axis=0),
    ).save(tmp_path / "long.npz")
    process = subprocess.Popen(
        [sys.executable, "-m", "followthrough", "simulate", str(tmp_path / "long.npz"), "-o", str(output)],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stderr is not None
    process.stderr.read(10)  # the progress bar has begun; compressing the result takes longer than the steps
    time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, (out, err)
    assert b"Traceback" not in err and b"interrupted, nothing written" in err
    assert list(output.parent.iterdir()) == []


def test_inside_blender_arguments_come_after_two_dashes(
    sequence: Path, output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = ["simulate", str(sequence), "--quiet", "-o", str(output)]
    monkeypatch.setattr("sys.argv", ["blender", "--background", "--python-expr", "main()", "--", *own])
    assert cli.main() == 0
    assert output.exists()
