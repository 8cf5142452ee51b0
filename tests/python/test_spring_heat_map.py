# SPDX-License-Identifier: GPL-3.0-or-later
"""Heat maps of springs' constants."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from test_spring_fit import run_springs, sequence_of, waves

from followthrough import spring_heat_map
from followthrough.cli import main
from followthrough.spring_heat_map import UNKNOWN_COLOUR, boundary_faces, heat_map, palette

HAS_MATPLOTLIB = importlib.util.find_spec("matplotlib") is not None


def test_quantities_are_on_their_scales() -> None:
    stiffness, damping = np.array([1.0, 100.0, 1e4]), np.array([1.0, 20.0, 1e3])
    assert np.allclose(heat_map("stiffness", stiffness, damping).values, [0, 2, 4])
    assert np.allclose(heat_map("damping", stiffness, damping).values, [0, np.log10(20), 3])
    regime = heat_map("regime", stiffness, damping)
    assert np.array_equal(np.sign(regime.values), [-1, 0, 1])
    assert regime.low == -regime.high
    with pytest.raises(ValueError, match="quantity"):
        heat_map("speed", stiffness, damping)  # type: ignore[arg-type]


def test_colours_tell_high_from_low_and_known_from_unknown() -> None:
    stiffness = np.geomspace(1, 1e4, 50)
    known = np.arange(50) != 7
    colours = heat_map("stiffness", stiffness, stiffness, known).colours()
    assert colours.shape == (50, 3)
    assert ((colours >= 0) & (colours <= 1)).all()
    assert np.allclose(colours[7], UNKNOWN_COLOUR)
    assert np.allclose(colours[0], palette("stiffness", np.zeros(1))[0])
    assert np.allclose(colours[-1], palette("stiffness", np.ones(1))[0])
    # Critical damping is the neutral middle.
    even = heat_map("regime", np.array([1.0, 25.0]), np.array([2.0, 10.0])).colours()
    assert np.allclose(even, palette("regime", np.array([0.5]))[0])
    nothing = heat_map("damping", stiffness, stiffness, np.zeros(50, dtype=bool)).colours()
    assert np.allclose(nothing, UNKNOWN_COLOUR)


def test_the_boundary_of_two_tets_has_no_inner_face() -> None:
    faces = boundary_faces(np.array([[0, 1, 2, 3], [1, 2, 3, 4]], dtype=np.int32))
    assert len(faces) == 6
    assert [1, 2, 3] not in np.sort(faces, axis=1).tolist()
    assert boundary_faces(np.zeros((0, 4), dtype=np.int32)).shape == (0, 3)


def test_the_command_draws_or_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    reference = waves(20, 6, 1)
    dynamic = run_springs(reference, np.full(6, 200.0), np.geomspace(1, 100, 6))
    sequence_of(reference, dynamic).save(tmp_path / "seq.npz")
    picture, springs = tmp_path / "map.png", tmp_path / "s.npz"
    arguments = ["fit-springs", str(tmp_path / "seq.npz"), "-o", str(springs), "--heat-map", str(picture), "--quiet"]
    if HAS_MATPLOTLIB:
        assert main(arguments) == 0
        assert picture.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    else:
        assert main(arguments) == 2
        assert "pip install followthrough[plot]" in capsys.readouterr().err
        assert not springs.exists()


def test_without_matplotlib_nothing_is_begun(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(spring_heat_map, "missing_package", lambda: "matplotlib is not installed")
    sequence_of(waves(5, 2, 1), waves(5, 2, 1)).save(tmp_path / "seq.npz")
    arguments = [
        "fit-springs",
        str(tmp_path / "seq.npz"),
        "-o",
        str(tmp_path / "s.npz"),
        "--heat-map",
        str(tmp_path / "m.png"),
    ]
    assert main(arguments) == 2
    assert "--heat-map: matplotlib is not installed" in capsys.readouterr().err
