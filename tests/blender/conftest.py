# SPDX-License-Identifier: GPL-3.0-or-later
"""Every test starts from an empty file in a real Blender."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from followthrough import emulator_weights

bpy = pytest.importorskip("bpy", reason="these tests need Blender's Python module, bpy")


@pytest.fixture(autouse=True)
def fresh_scene() -> Iterator[None]:
    gc.collect()  # before the data that cycles may still hold is freed: Blender 4.2 can crash after it
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield


@pytest.fixture(autouse=True)
def springs_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a version without weights for the emulator: what is tested here of baking is sharp only with a motion that is known."""
    monkeypatch.setattr(emulator_weights, "SHIPPED", tmp_path / "no weights" / "emulator.npz")


_status = pytest.StashKey[int]()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    session.config.stash[_status] = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure(config: pytest.Config) -> None:
    """Leave without Python's shutdown: bpy 4.2 crashes in it where something still holds the module."""
    if _status in config.stash:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(config.stash[_status])
