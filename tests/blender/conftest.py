# SPDX-License-Identifier: GPL-3.0-or-later
"""Every test starts from an empty file in a real Blender."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

bpy = pytest.importorskip("bpy", reason="these tests need Blender's Python module, bpy")


@pytest.fixture(autouse=True)
def fresh_scene() -> Iterator[None]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield
