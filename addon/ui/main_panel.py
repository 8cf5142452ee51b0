# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel itself: what is missing, Add, and Bake, whose button is also the status line."""

import textwrap

import bpy
from bpy.types import Panel

from followthrough.blender import OUTPUTS, baked_range, why_not_bakeable

from ..bake.cautions import FOLLOWTHROUGH_OT_use_simulation, caution_about
from ..bake.clear import FOLLOWTHROUGH_OT_clear
from ..bake.discard import FOLLOWTHROUGH_OT_discard_stopped_bake
from ..bake.operator import FOLLOWTHROUGH_OT_bake
from ..bake.session import BakeSession, resumable, running
from ..characters import active_character, active_mesh, meshes_of_armature, selected_characters, why_not_pinned
from ..painting.add import FOLLOWTHROUGH_OT_add
from ..painting.paint import FOLLOWTHROUGH_OT_select_character
from ..painting.remove import FOLLOWTHROUGH_OT_remove
from ..preview import live
from ..preview.operator import FOLLOWTHROUGH_OT_preview
from ..properties.bake_settings import frame_range, object_settings


class FollowthroughPanel:
    """Where all panels of the add-on are."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Followthrough"


class FOLLOWTHROUGH_PT_main(FollowthroughPanel, Panel):
    bl_label = "Followthrough"

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        if active_character(context) is not None:
            self.layout.operator(FOLLOWTHROUGH_OT_remove.bl_idname, text="", icon="X", emboss=False)

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        bake = running()
        if bake is not None:
            draw_progress(layout, bake)
            return
        obj = active_mesh(context)
        if obj is None:
            draw_choice_of_mesh(layout, context)
            return
        if reason := why_not_bakeable(obj, obj.followthrough.output):
            draw_text(layout, context, reason, icon="ERROR")
            if any(why_not_bakeable(obj, output) is None for output in OUTPUTS):
                layout.prop(obj.followthrough, "output", text="")
        elif not obj.followthrough.is_added:
            row = layout.row()
            row.scale_y = 1.4
            row.operator(FOLLOWTHROUGH_OT_add.bl_idname, icon="ADD")
        else:
            draw_bake(layout, context)
        draw_baked(layout, obj)


def draw_choice_of_mesh(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What to select where the active object is no mesh: for an armature, the meshes that it moves are a click away."""
    obj = context.object
    meshes = meshes_of_armature(context.scene, obj) if obj is not None and obj.type == "ARMATURE" else []
    if not meshes:
        layout.label(text="Select a skinned mesh", icon="INFO")
        return
    layout.label(text="Select a mesh of the armature", icon="INFO")
    column = layout.column(align=True)
    for mesh in meshes:
        column.operator(FOLLOWTHROUGH_OT_select_character.bl_idname, text=mesh.name, icon="MESH_DATA").name = mesh.name


def draw_progress(layout: bpy.types.UILayout, bake: BakeSession) -> None:
    """The Bake button as the status line, and how to stop."""
    column = layout.column(align=True)
    row = column.row()
    row.scale_y = 1.4
    row.progress(factor=bake.done / bake.total, type="BAR", text=bake.status())
    column.label(text="Esc cancels and changes nothing")


def draw_bake(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The Bake button, which says what it would bake."""
    characters = selected_characters(context)
    try:
        frames, scene = frame_range(characters[0]), context.scene
    except ValueError as problem:
        draw_text(layout, context, str(problem), icon="ERROR")
        return
    start, end = frames.ends_in(scene)
    for obj in characters:
        if reason := why_not_seen(obj) or why_not_pinned(obj):
            draw_text(layout, context, reason, icon="ERROR")
    draw_preview(layout, context)
    draw_cautions(layout, context, characters)
    text = f"Bake {end - start + 1} {'Frame' if end == start else 'Frames'}"
    if len(characters) > 1:
        text += f" of {len(characters)} Meshes"
    row = layout.row(align=True)
    row.scale_y = 1.4
    stopped = resumable(scene, {obj.name: object_settings(obj) for obj in characters}, frames)
    if stopped is not None:
        text = f"Resume Baking from Frame {stopped}"
    row.operator(FOLLOWTHROUGH_OT_bake.bl_idname, text=text, icon="PHYSICS")
    if stopped is not None:
        row.operator(FOLLOWTHROUGH_OT_discard_stopped_bake.bl_idname, text="", icon="X")


def why_not_seen(obj: bpy.types.Object) -> str | None:
    """That a character is hidden; None where it is not."""
    return None if obj.visible_get() else f"'{obj.name}' is hidden, and Blender does not pose it: show it first"


def draw_preview(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The switch of the live preview, how fast it is, and why it ended where it did so by itself."""
    preview = live.running()
    column = layout.column(align=True)
    column.operator(
        FOLLOWTHROUGH_OT_preview.bl_idname,
        text="End Preview" if preview is not None else "Preview",
        icon="PAUSE" if preview is not None else "PLAY",
        depress=preview is not None,
    )
    if preview is not None:
        column.label(text=live.figures(preview), icon="INFO")
    elif live.why_ended():
        draw_text(column, context, f"Preview ended: {live.why_ended()}", icon="ERROR")


def draw_cautions(layout: bpy.types.UILayout, context: bpy.types.Context, characters: list[bpy.types.Object]) -> None:
    """What the emulator has not learned, and the simulation, which can do it, a click away."""
    texts = [(obj.name, caution_about(obj, context.scene)) for obj in characters if not why_not_pinned(obj)]
    told = [f"{name}: {text}" if len(characters) > 1 else text for name, text in texts if text]
    if told:
        box = layout.box()
        for text in told:
            draw_text(box, context, text, icon="ERROR")
        box.operator(FOLLOWTHROUGH_OT_use_simulation.bl_idname, icon="PHYSICS")


def draw_baked(layout: bpy.types.UILayout, obj: bpy.types.Object) -> None:
    """What is baked already, and Clear."""
    baked = baked_range(obj)
    if baked is None:
        return
    row = layout.row()
    row.label(text=f"Baked {baked[0]} to {baked[1]}", icon="CHECKMARK")
    row.operator(FOLLOWTHROUGH_OT_clear.bl_idname, text="Clear", icon="TRASH")


def draw_text(layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str) -> None:
    """A message in as many lines as the sidebar's width needs."""
    scale = context.preferences.system.ui_scale
    width = context.region.width / scale if context.region is not None else 250
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, max(12, int((width - 60) / 6.5)))):
        column.label(text=line, icon="BLANK1" if index else icon)
