# SPDX-License-Identifier: GPL-3.0-or-later
"""Listening to what happens to the file, for as long as the add-on is enabled."""

from collections.abc import Callable, Mapping
from typing import Any

import bpy

#: What is called, by the name of its list in `bpy.app.handlers`.
Handlers = Mapping[str, Callable[..., Any]]


def listen(handlers: Handlers) -> None:
    """Call them from now on."""
    for name, handler in handlers.items():
        getattr(bpy.app.handlers, name).append(handler)


def listen_no_longer(handlers: Handlers) -> None:
    """Call them no longer, where nobody has taken them out before."""
    for name, handler in handlers.items():
        registered = getattr(bpy.app.handlers, name)
        if handler in registered:
            registered.remove(handler)
