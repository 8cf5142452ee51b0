# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything that Blender has to be told about: the classes of every feature and the settings on objects."""

import bpy

from . import bake, learning, painting, preview, properties, ui

_classes: tuple[type, ...] = (
    *properties.classes,
    *painting.classes,
    *bake.classes,
    *preview.classes,
    *learning.classes,
    *ui.classes,
)


def register() -> None:
    """Tell Blender about the add-on's classes and properties; where one is refused, the others are taken back."""
    registered: list[type] = []
    try:
        for cls in _classes:
            bpy.utils.register_class(cls)
            registered.append(cls)
    except Exception:
        for cls in reversed(registered):
            bpy.utils.unregister_class(cls)
        raise
    bpy.types.Object.followthrough = bpy.props.PointerProperty(
        type=properties.FollowthroughSettings, override=properties.OVERRIDABLE
    )
    properties.overrides.register_handlers()
    preview.register_handlers()
    learning.register_handlers()


def unregister() -> None:
    """Take all of it back. What objects had set stays in the file as it is, and is there again when the add-on is."""
    preview.unregister_handlers()
    properties.overrides.unregister_handlers()
    bake.stop()
    learning.unregister_handlers()
    del bpy.types.Object.followthrough
    for cls in reversed(_classes):
        bpy.utils.unregister_class(cls)
