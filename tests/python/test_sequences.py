# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequence files: what goes in comes out, and nothing else is let in."""

import io
import pickle
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from followthrough.npz_files import written_whole
from followthrough.sequences import Sequence

FRAMES, VERTICES = 3, 5


def arrays() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    return {
        "rest_positions": rng.normal(size=(VERTICES, 3)),
        "tets": np.array([[0, 1, 2, 3], [1, 2, 3, 4]], dtype=np.int32),
        "constrained": np.array([True, False, False, False, False]),
        "youngs_modulus": np.full(VERTICES, 5e4),
        "density": np.array(1000.0),
        "poisson_ratio": np.array(0.45),
        "compression_resistance": np.array(1e5),
        "dt": np.array(1 / 24),
        "reference": rng.normal(size=(FRAMES, VERTICES, 3)),
        "dynamic": rng.normal(size=(FRAMES, VERTICES, 3)),
    }


def sequence(**changes: Any) -> Sequence:
    return Sequence(**{**arrays(), **changes})


def assert_equal(a: Sequence, b: Sequence) -> None:
    for field in fields(Sequence):
        np.testing.assert_array_equal(getattr(a, field.name), getattr(b, field.name), err_msg=field.name)


@pytest.mark.parametrize("changes", [{}, {"density": np.linspace(500, 900, VERTICES)}, {"dynamic": None}])
def test_saved_and_loaded_it_is_the_same(tmp_path: Path, changes: dict[str, Any]) -> None:
    original = sequence(**changes)
    original.save(tmp_path / "a.npz")
    assert_equal(Sequence.load(tmp_path / "a.npz"), original)
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_the_file_is_plain_npz_with_the_documented_keys(tmp_path: Path) -> None:
    sequence().save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as file:
        assert set(file.files) == set(arrays())
        for name, expected in arrays().items():
            assert file[name].shape == np.shape(expected)
            assert file[name].dtype == expected.dtype


def test_what_may_be_left_out_has_its_documented_value(tmp_path: Path) -> None:
    needed = {
        k: v for k, v in arrays().items() if k not in ("density", "poisson_ratio", "compression_resistance", "dynamic")
    }
    np.savez(tmp_path / "a.npz", **needed)
    loaded = Sequence.load(tmp_path / "a.npz")
    assert (loaded.density, loaded.poisson_ratio, loaded.compression_resistance) == (1000.0, 0.45, 1e5)
    assert loaded.dynamic is None
    assert (loaded.frame_count, loaded.vertex_count) == (FRAMES, VERTICES)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rest_positions": np.zeros((VERTICES, 2))}, r"rest_positions: found shape \(5, 2\), expected \(n, 3\)"),
        ({"rest_positions": np.zeros((0, 3))}, "rest_positions: found no vertices"),
        ({"rest_positions": np.full((VERTICES, 3), "a")}, "rest_positions: found <U1, expected real numbers"),
        ({"tets": np.zeros((2, 3), dtype=int)}, r"tets: found shape \(2, 3\), expected \(m, 4\)"),
        ({"tets": np.zeros((2, 4))}, "tets: found float64, expected integers"),
        ({"tets": np.array([[0, 1, 2, 3], [0, 1, 2, 5]])}, r"tets: found 5 at \[1, 3\], expected indices 0 to 4"),
        ({"tets": np.array([[0, 1, 2, -1]])}, "tets: found -1"),
        ({"constrained": np.zeros(VERTICES)}, "constrained: found float64, expected bool"),
        ({"constrained": np.zeros(3, dtype=bool)}, r"constrained: found shape \(3,\), expected \(5,\)"),
        ({"youngs_modulus": np.zeros(VERTICES)}, r"youngs_modulus: found 0.0 at \[0\], expected more than 0"),
        ({"youngs_modulus": np.ones(4)}, r"youngs_modulus: found shape \(4,\), expected \(5,\)"),
        ({"density": -1.0}, "density: found -1.0, expected more than 0"),
        ({"density": np.ones(4)}, r"density: found shape \(4,\), expected \(\) or \(5,\)"),
        ({"poisson_ratio": 0.5}, "poisson_ratio: found 0.5"),
        ({"poisson_ratio": np.ones(2)}, r"poisson_ratio: found shape \(2,\), expected a single number"),
        ({"compression_resistance": -1.0}, "compression_resistance: found -1"),
        ({"dt": 0.0}, "dt: found 0, expected a positive"),
        ({"dt": np.nan}, "dt: found nan"),
        ({"reference": np.zeros((0, VERTICES, 3))}, "reference: found no frames"),
        ({"reference": np.zeros((2, 4, 3))}, r"reference: found shape \(2, 4, 3\), expected \(frames, 5, 3\)"),
        ({"reference": np.full((1, VERTICES, 3), np.inf)}, r"reference: found inf at \[0, 0, 0\], expected finite"),
        ({"dynamic": np.zeros((2, VERTICES, 3))}, r"dynamic: found shape \(2, 5, 3\), expected \(3, 5, 3\)"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sequence(**changes)
    path = tmp_path / "bad.npz"
    np.savez(path, **{**arrays(), **changes})
    with pytest.raises(ValueError, match=f"bad.npz: {message}"):
        Sequence.load(path)


def test_missing_and_unknown_keys_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **{k: v for k, v in arrays().items() if k not in ("tets", "dt")})
    with pytest.raises(ValueError, match=r"a.npz: found no tets, dt, expected"):
        Sequence.load(path)
    np.savez(path, **arrays(), colour=np.zeros(3))
    with pytest.raises(ValueError, match=r"a.npz: found unknown colour, expected only rest_positions"):
        Sequence.load(path)


def test_a_file_cut_short_anywhere_is_refused_by_name(tmp_path: Path) -> None:
    sequence().save(tmp_path / "whole.npz")
    whole = (tmp_path / "whole.npz").read_bytes()
    path = tmp_path / "cut.npz"
    for length in range(0, len(whole), 97):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match=r"cut.npz"):
            Sequence.load(path)


def test_a_damaged_file_is_refused_or_harmless(tmp_path: Path) -> None:
    sequence().save(tmp_path / "whole.npz")
    whole = bytearray((tmp_path / "whole.npz").read_bytes())
    path = tmp_path / "damaged.npz"
    rng = np.random.default_rng(1)
    for _ in range(200):
        damaged = whole.copy()
        for place in rng.integers(0, len(whole), 3):
            damaged[place] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            Sequence.load(path)
        except ValueError as error:
            assert "damaged.npz" in str(error)


def test_foreign_files_are_refused_by_name(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.npz"
    single, text_zip = io.BytesIO(), io.BytesIO()
    np.save(single, np.zeros(3))
    with zipfile.ZipFile(text_zip, "w") as archive:
        archive.writestr("readme.txt", "hello")
    for content in (b"", b"hello", b"\x00" * 1000, pickle.dumps({"a": 1}), single.getvalue(), text_zip.getvalue()):
        foreign.write_bytes(content)
        with pytest.raises(ValueError, match=r"foreign.npz"):
            Sequence.load(foreign)
    np.savez(foreign, **{**arrays(), "reference": np.array([{"code": 1}], dtype=object)})
    with pytest.raises(ValueError, match=r"foreign.npz: reference"):
        Sequence.load(foreign)
    with pytest.raises(ValueError, match=r"nothing.npz: found no such file"):
        Sequence.load(tmp_path / "nothing.npz")
    with pytest.raises(ValueError, match="found a folder"):
        Sequence.load(tmp_path)


def test_saving_fails_whole(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="is not there"):
        sequence().save(tmp_path / "missing" / "a.npz")
    target = tmp_path / "a.npz"
    target.write_text("precious")
    with pytest.raises(KeyboardInterrupt), written_whole(target) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert target.read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]


def test_a_changed_copy_is_checked_too() -> None:
    with pytest.raises(ValueError, match="dynamic"):
        replace(sequence(), dynamic=np.zeros((1, 1, 3)))
