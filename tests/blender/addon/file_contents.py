# SPDX-License-Identifier: GPL-3.0-or-later
"""Everything of the open file that the add-on could touch, to compare before and after."""

import json
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray


def keys(obj: bpy.types.Object) -> list[str]:
    return [block.name for block in obj.data.shape_keys.key_blocks] if obj.data.shape_keys else []


def points(obj: bpy.types.Object) -> NDArray[np.float32]:
    blocks = obj.data.shape_keys.key_blocks
    out = np.empty((len(blocks), len(obj.data.vertices) * 3), dtype=np.float32)
    for row, block in zip(out, blocks, strict=True):
        block.points.foreach_get("co", row)
    return out


def contents() -> str:
    """Everything of the file that a bake could touch, as text."""
    scene = bpy.context.scene
    state: dict[str, Any] = {
        "frame": (scene.frame_current, scene.frame_subframe),
        "active": bpy.context.object.name,
        "selected": sorted(obj.name for obj in bpy.context.selected_objects),
        "blocks": {
            kind: sorted(getattr(bpy.data, kind).keys()) for kind in ("actions", "meshes", "objects", "shape_keys")
        },
    }
    for obj in bpy.data.objects:
        state[obj.name] = (obj.mode, np.array(obj.matrix_world).tolist(), [group.name for group in obj.vertex_groups])
        if obj.type == "MESH":
            state[f"{obj.name} keys"] = (keys(obj), points(obj).tolist() if obj.data.shape_keys else None)
            state[f"{obj.name} modifiers"] = [(m.name, m.show_viewport, m.show_render) for m in obj.modifiers]
            state[f"{obj.name} mesh"] = [tuple(vertex.co) for vertex in obj.data.vertices]
    return json.dumps(state, sort_keys=True)
