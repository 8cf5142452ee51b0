# SPDX-License-Identifier: GPL-3.0-or-later
"""Taking objects out of the modes in which a mesh's data lies elsewhere, and back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def object_mode(*names: str) -> Iterator[None]:
    """Take the objects out of Edit and Sculpt Mode, and back at the end."""
    modes = leave_modes(names)
    try:
        yield
    finally:
        enter_modes(modes)


def leave_modes(names: Iterable[str]) -> dict[str, str]:
    """Take the objects out of Edit and Sculpt Mode; returns the modes for `enter_modes`."""
    modes = {}
    for name in names:
        obj = bpy.data.objects.get(name)
        if obj is not None and obj.mode in {"EDIT", "SCULPT"}:
            modes[name] = obj.mode
            _set_mode(obj, "OBJECT")
    return modes


def enter_modes(modes: dict[str, str]) -> None:
    """Undo `leave_modes`."""
    for name, mode in modes.items():
        obj = bpy.data.objects.get(name)
        if obj is not None and obj.mode != mode:
            _set_mode(obj, mode)


def _set_mode(obj: bpy.types.Object, mode: str) -> None:
    with bpy.context.temp_override(active_object=obj, object=obj, selected_objects=[obj]):
        bpy.ops.object.mode_set(mode=mode)
