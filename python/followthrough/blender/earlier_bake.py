# SPDX-License-Identifier: GPL-3.0-or-later
"""Hiding what an earlier bake made on an object while it is baked again or previewed, and showing it again."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from followthrough.blender import point_cache, shape_keys


@dataclass(frozen=True)
class HiddenBake:
    """What was hidden.

    Attributes
    ----------
    muted : tuple of str
        Shape keys.
    absolute : bool
        Whether the keys were absolute; they are relative now, and show the rest shape as their values are 0.
    modifiers : tuple of str
        Point caches.
    """

    muted: tuple[str, ...] = ()
    absolute: bool = False
    modifiers: tuple[str, ...] = ()


def hide_bake(obj: bpy.types.Object) -> HiddenBake:
    """Hide it; `show_bake` takes what is returned."""
    key = obj.data.shape_keys
    absolute = shape_keys.is_absolute_bake(key)
    muted = tuple(sorted(name for name in shape_keys.our_names(key) if not key.key_blocks[name].mute))
    cached = point_cache.our_modifier(obj)
    modifiers = (cached,) if cached is not None and obj.modifiers[cached].show_viewport else ()
    if absolute:
        key.use_relative = True
    _set_mute(obj, muted, True)
    for name in modifiers:
        obj.modifiers[name].show_viewport = False
    return HiddenBake(muted, absolute, modifiers)


def show_bake(name: str, hidden: HiddenBake) -> None:
    """Show what was hidden on the object of this name, as far as it is still there."""
    obj = bpy.data.objects.get(name)
    if obj is None or obj.type != "MESH":
        return
    for modifier in hidden.modifiers:
        if modifier in obj.modifiers:
            obj.modifiers[modifier].show_viewport = True
    _set_mute(obj, hidden.muted, False)
    if hidden.absolute and obj.data.shape_keys is not None:
        obj.data.shape_keys.use_relative = False


def _set_mute(obj: bpy.types.Object, names: tuple[str, ...], mute: bool) -> None:
    blocks = obj.data.shape_keys.key_blocks if obj.data.shape_keys is not None else {}
    for name in names:
        if name in blocks:
            blocks[name].mute = mute
