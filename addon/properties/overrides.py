# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeping what is set on library overrides.

Blender keeps what differs from the linked object. Where that has no settings at all, because nobody has added Followthrough in its own
file, they would be kept as a whole, which Blender cannot; so it is given default ones, in memory alone, before they are compared.
"""

from typing import Any

import bpy
from bpy.app.handlers import persistent

from ..handlers import listen, listen_no_longer


def prepare(obj: bpy.types.Object) -> None:
    """Let the object that this one overrides have settings."""
    override = obj.override_library
    if override is not None and override.reference is not None:
        _ = override.reference.followthrough.is_added  # reading makes them


@persistent
def _prepare_all(*_: Any) -> None:
    for obj in bpy.data.objects:
        if obj.type == "MESH":
            prepare(obj)


_HANDLERS = dict.fromkeys(("load_post", "save_pre"), _prepare_all)


def register_handlers() -> None:
    """Listen to files that are opened and saved."""
    listen(_HANDLERS)


def unregister_handlers() -> None:
    """No longer."""
    listen_no_longer(_HANDLERS)
