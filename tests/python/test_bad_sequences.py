# SPDX-License-Identifier: GPL-3.0-or-later
"""What is wrong with a sequence file is said in one line that names it, by every command and solver, and nothing is written."""

import itertools
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from followthrough import cli

SOLVERS = ("springs", "implicit-euler", "central-differences", "quasistatic")
COUNT = 8


def cube() -> dict[str, Any]:
    """A cube that swings by one side, two frames of it."""
    rest = np.array(list(itertools.product((0.0, 0.2), repeat=3)))
    tets = np.array([[0, 4, 2, 1], [4, 2, 1, 5], [2, 1, 5, 3], [4, 6, 2, 5], [6, 5, 7, 3], [6, 2, 5, 3]])
    reference = np.stack([rest, rest + np.array([0.0, 0.01, 0.0]), rest])
    return {
        "rest_positions": rest,
        "tets": tets,
        "constrained": rest[:, 0] < 0.1,
        "youngs_modulus": np.full(COUNT, 5e4),
        "dt": np.float64(math.sqrt(0.001)),
        "reference": reference,
        "dynamic": reference,
    }


def changed(name: str, place: Any, value: Any) -> Any:
    def change(arrays: dict[str, Any]) -> None:
        arrays[name] = arrays[name].copy()
        arrays[name][place] = value

    return change


def replaced(name: str, value: Any) -> Any:
    return lambda arrays: arrays.__setitem__(name, value)


BROKEN = {
    "negative modulus": (changed("youngs_modulus", 3, -1.0), "youngs_modulus: found -1.0 at [3]"),
    "zero modulus": (changed("youngs_modulus", 3, 0.0), "youngs_modulus: found 0.0 at [3]"),
    "modulus not a number": (changed("youngs_modulus", 3, np.nan), "youngs_modulus: found nan at [3]"),
    "too few moduli": (replaced("youngs_modulus", np.full(COUNT - 1, 5e4)), "youngs_modulus: found shape (7,)"),
    "mask too long": (replaced("constrained", np.zeros(COUNT + 1, dtype=bool)), "constrained: found shape (9,)"),
    "mask of numbers": (replaced("constrained", np.zeros(COUNT, dtype=int)), "constrained: found int64, expected bool"),
    "no free vertex": (replaced("constrained", np.ones(COUNT, dtype=bool)), "constrained: found no free vertex"),
    "index too large": (changed("tets", (5, 2), COUNT), "tets: found 8 at [5, 2], expected indices 0 to 7"),
    "negative index": (changed("tets", (5, 2), -1), "tets: found -1 at [5, 2]"),
    "fractional indices": (replaced("tets", np.zeros((1, 4))), "tets: found float64, expected integers"),
    "flat tet": (changed("rest_positions", 7, [0.2, 0.2, 0.0]), "rest_positions: tet 4 has no volume"),
    "a corner twice": (changed("tets", (4, 0), 5), "tet 4 has no volume"),
    "reference not finite": (changed("reference", (1, 2, 0), np.inf), "reference: found inf at [1, 2, 0]"),
    "another motion": (replaced("dynamic", np.zeros((4, COUNT, 3))), "dynamic: found shape (4, 8, 3)"),
    "no time": (replaced("dt", np.float64(0.0)), "dt: found 0, expected a positive number of seconds"),
    "no number for a time": (replaced("dt", np.float64(np.nan)), "dt: found nan, expected a finite number"),
    "incompressible": (replaced("poisson_ratio", np.float64(0.5)), "poisson_ratio: found 0.5"),
    "without mass": (replaced("density", np.float64(0.0)), "density: found 0.0"),
    "objects": (replaced("dt", np.array([{}], dtype=object)), "dt: found Python objects, expected plain numbers"),
    "unknown key": (replaced("colour", np.zeros(3)), "found unknown colour"),
    "missing key": (lambda arrays: arrays.pop("tets"), "found no tets"),
}


def said_of(path: Path, command: str, solver: str, capsys: pytest.CaptureFixture[str]) -> str:
    output = path.parent / "out" / "result.npz"
    output.parent.mkdir(exist_ok=True)
    rest = ["--json"] if command == "evaluate" else ["-o", str(output)]
    assert cli.main([command, str(path), "--solver", solver, "--quiet", *rest]) == 2
    said = capsys.readouterr()
    assert said.out == "" and not list(output.parent.iterdir())
    assert said.err.startswith(f"followthrough: error: {path}: ") and said.err.count("\n") == 1
    return said.err


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("case", BROKEN)
def test_broken_arrays(case: str, solver: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, complaint = BROKEN[case]
    arrays = cube()
    change(arrays)
    path = tmp_path / "broken.npz"
    np.savez(path, **arrays)
    for command in ("simulate", "evaluate"):
        assert complaint in said_of(path, command, solver, capsys)


def test_broken_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    whole = tmp_path / "whole.npz"
    np.savez(whole, **cube())
    content = whole.read_bytes()
    path = tmp_path / "broken.npz"
    for broken, complaint in (
        (content[: len(content) // 2], "perhaps cut short"),
        (content[:100], "perhaps cut short"),
        (b"", "it is empty"),
        (b"v 0 0 0\n", "it begins as no zip file does"),
    ):
        path.write_bytes(broken)
        for command in ("simulate", "evaluate"):
            assert complaint in said_of(path, command, "implicit-euler", capsys)
    for seed in range(20):  # damaged anywhere: read as what it was, or refused
        damaged = bytearray(content)
        damaged[np.random.default_rng(seed).integers(len(content))] ^= 0xFF
        path.write_bytes(damaged)
        status = cli.main(["evaluate", str(path), "--quiet", "--json"])
        said = capsys.readouterr()
        assert status == 0 or (status == 2 and said.out == "" and f"error: {path}: " in said.err)


@pytest.mark.parametrize("solver", SOLVERS)
def test_inverted_rest_tets_are_counted_and_taken(
    solver: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arrays = cube()
    arrays["tets"][[1, 4]] = arrays["tets"][[1, 4]][:, [1, 0, 2, 3]]
    path = tmp_path / "inverted.npz"
    np.savez(path, **arrays)
    for command, rest in (("simulate", ["-o", str(tmp_path / "result.npz")]), ("evaluate", ["--json"])):
        assert cli.main([command, str(path), "--solver", solver, "--quiet", *rest]) == 0
        said = capsys.readouterr().err
        corners = arrays["rest_positions"][arrays["tets"]]
        count = int((np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0).sum())
        assert 0 < count < 6
        assert said.count("\n") == 1
        assert f"warning: {path}: rest_positions: {count} of 6 tets are inverted at rest" in said


def test_evaluate_wants_frames_and_tets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "short.npz"
    arrays = cube()
    np.savez(path, **{**arrays, "reference": arrays["reference"][:1], "dynamic": arrays["dynamic"][:1]})
    assert "dynamic: found one frame, expected at least two" in said_of(path, "evaluate", "springs", capsys)
    np.savez(path, **{**arrays, "tets": np.zeros((0, 4), dtype=int)})
    assert "tets: found none" in said_of(path, "evaluate", "springs", capsys)
    assert cli.main(["simulate", str(path), "--quiet", "-o", str(tmp_path / "result.npz")]) == 0  # springs need none
