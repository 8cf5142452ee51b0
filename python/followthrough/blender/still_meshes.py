# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that need not be deformed while only the poses of their rigs are read: nearly all the time of stepping goes there."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import bpy

from followthrough.blender.actions import animated_paths
from followthrough.blender.scene import Deformation

#: Users of an object whose evaluation takes nothing from it.
_CONTAINERS = (bpy.types.Collection, bpy.types.Screen, bpy.types.WindowManager, bpy.types.WorkSpace)


class StillMeshes:
    """Armature modifiers that can be switched off while bone matrices are read, and are shown again at any time.

    A mesh is left alone where its armature would then no longer be evaluated (because it is hidden), where anything that the
    poses of this bake depend on could depend on the deformed mesh, where its modifiers are animated, and where the
    file has frame handlers, which may look at anything.

    Parameters
    ----------
    deformations
        What moves each of the baked meshes, by name.
    view_layer
        The one that is stepped.
    """

    def __init__(self, deformations: Mapping[str, Deformation], view_layer: bpy.types.ViewLayer) -> None:
        self._modifiers: list[tuple[str, str]] = []
        self._still = False
        if _has_handlers():
            return
        bones = {name: found for name, found in deformations.items() if found.armature and found.skeleton}
        if not bones:
            return
        users = bpy.data.user_map()
        for name, found in bones.items():
            obj, armature = bpy.data.objects[name], bpy.data.objects[found.skeleton]
            if not armature.visible_get(view_layer=view_layer) or _animates_modifiers(obj):
                continue
            others = [bpy.data.objects[other] for other in deformations if other != name]
            rigs = [bpy.data.objects[other.skeleton] for other in deformations.values() if other.skeleton]
            if not _reaches(obj, {*others, *rigs, *(rig.data for rig in rigs)}, users):
                self._modifiers.append((name, found.armature or ""))

    def hold(self) -> None:
        """Switch the modifiers off."""
        if not self._still:
            self._still = True
            self._set_shown(False)

    def show(self) -> None:
        """Switch them on again."""
        if self._still:
            self._still = False
            self._set_shown(True)

    def _set_shown(self, shown: bool) -> None:
        for name, modifier in self._modifiers:
            obj = bpy.data.objects.get(name)
            if obj is not None and modifier in obj.modifiers:
                obj.modifiers[modifier].show_viewport = shown


def _has_handlers() -> bool:
    handlers = bpy.app.handlers
    changes, updates = (
        (handlers.frame_change_pre, handlers.frame_change_post),
        (handlers.depsgraph_update_pre, handlers.depsgraph_update_post),
    )
    return any(changes) or any(updates)


def _animates_modifiers(obj: bpy.types.Object) -> bool:
    return any(path.startswith("modifiers") for path in animated_paths(obj.animation_data))


def _reaches(
    obj: bpy.types.Object, wanted: Iterable[bpy.types.ID], users: Mapping[bpy.types.ID, set[bpy.types.ID]]
) -> bool:
    """Whether one of the data-blocks uses this object, directly or by way of others."""
    wanted = set(wanted)
    seen, left = {obj}, [obj]
    while left:
        for user in users.get(left.pop(), ()):
            if user in seen or isinstance(user, _CONTAINERS):
                continue
            if isinstance(user, bpy.types.Scene):
                if animated_paths(user.animation_data):  # a scene's drivers could pass something on
                    return True
                continue
            if user in wanted:
                return True
            seen.add(user)
            left.append(user)
    return False
