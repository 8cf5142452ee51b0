# SPDX-License-Identifier: GPL-3.0-or-later
"""Actions: the one that plays our shape keys, and choosing which of a file's actions an armature plays.

Blender 4.4 gave actions layers and slots, and 5.0 took `Action.fcurves` away; both kinds are handled here and nowhere
else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

#: Custom property of the actions that we made.
MARK = "followthrough"
#: Group that our curves are in, and name of our slot and NLA track.
OURS = "Followthrough"

HAS_SLOTS = "slots" in bpy.types.Action.bl_rna.properties

_LINEAR = 1  # of Keyframe.interpolation


def frame_length(scene: bpy.types.Scene) -> float:
    """How far animation goes on in a frame of the scene: 1 where its time is not remapped."""
    return float(scene.render.frame_map_old) / float(scene.render.frame_map_new)


def scene_frames(times: tuple[int, int], scene: bpy.types.Scene) -> tuple[int, int]:
    """First and last frame of the scene in which animation of these times plays."""
    length = frame_length(scene)
    return math.ceil(times[0] / length), math.floor(times[1] / length)


@dataclass(frozen=True)
class Curve:
    """A property's values at some frames, linear between them and constant outside."""

    data_path: str
    frames: Sequence[int]
    values: Sequence[float]


def relative_curves(frames: Sequence[int], blocks: Sequence[str]) -> list[Curve]:
    """One shape key a frame: 0 in the frame before, 1 in its own, 0 in the next."""
    return [
        Curve(f'key_blocks["{bpy.utils.escape_identifier(block)}"].value', (frame - 1, frame, frame + 1), (0, 1, 0))
        for frame, block in zip(frames, blocks, strict=True)
    ]


def write_action(key: bpy.types.Key, name: str, curves: Sequence[Curve], length: float = 1.0) -> None:
    """Animate shape keys with an action of ours.

    It becomes the shape keys' own where they had no animation; otherwise it plays from an NLA track beside
    that. `length` is the scene's `frame_length`: animation is read there instead of at the frame.
    """
    animation = key.animation_data or key.animation_data_create()
    foreign = animation.action is not None or len(animation.nla_tracks) > 0
    action = bpy.data.actions.new(name)
    action[MARK] = True
    slot = None
    if HAS_SLOTS:
        slot = action.slots.new(id_type="KEY", name=OURS)
        strip = action.layers.new(OURS).strips.new(type="KEYFRAME")
        holder = strip.channelbag(slot, ensure=True)
    else:
        action.id_root = "KEY"
        holder = action
    group = holder.groups.new(OURS)
    for wanted in curves:
        curve = holder.fcurves.new(wanted.data_path)
        curve.group = group
        points = np.column_stack([length * np.array(wanted.frames), wanted.values]).ravel().astype(np.float32)
        curve.keyframe_points.add(len(wanted.frames))
        for part in ("co", "handle_left", "handle_right"):
            curve.keyframe_points.foreach_set(part, points)
        curve.keyframe_points.foreach_set("interpolation", np.full(len(wanted.frames), _LINEAR, dtype=np.int32))
        curve.update()
    if not foreign:
        animation.action = action
        if HAS_SLOTS:
            animation.action_slot = slot
        return
    track = animation.nla_tracks.new()
    track.name = OURS
    start = length * min(int(curve.frames[0]) for curve in curves)
    clip = track.strips.new(OURS, math.floor(start), action)
    if start != math.floor(start):
        clip.frame_start_ui = start
    if HAS_SLOTS:
        clip.action_slot = slot


def remove_action(key: bpy.types.Key) -> None:
    """Take our animation off the shape keys, and delete our actions where nothing else uses them.

    Curves that someone else keyed into our action stay, and the action with them, no longer as ours.
    """
    animation = key.animation_data
    if animation is None:
        return
    ours = set()
    if is_ours(animation.action):
        action = animation.action
        foreign = [curve for curve in _curves(action) if not _is_our_curve(curve)]
        if not foreign:
            ours.add(action)
            animation.action = None
        else:
            _give_away(action, animation)
    for track in list(animation.nla_tracks):
        actions = {strip.action for strip in track.strips}
        if actions and all(is_ours(action) for action in actions):
            ours |= actions
            animation.nla_tracks.remove(track)
    for action in ours:
        if action.users == int(action.use_fake_user):
            bpy.data.actions.remove(action)
    if animation.action is None and not len(animation.nla_tracks) and not len(animation.drivers):
        key.animation_data_clear()


def animated_blocks(key: bpy.types.Key) -> frozenset[str]:
    """Names of the shape keys that our own curves animate; follows when someone renames a key."""
    animation = key.animation_data
    if animation is None:
        return frozenset()
    actions = [animation.action, *(strip.action for track in animation.nla_tracks for strip in track.strips)]
    paths = {
        curve.data_path for action in actions if is_ours(action) for curve in _curves(action) if _is_our_curve(curve)
    }
    return frozenset(
        block.name
        for block in key.key_blocks
        if f'key_blocks["{bpy.utils.escape_identifier(block.name)}"].value' in paths
    )


def has_foreign_animation(key: bpy.types.Key | None) -> bool:
    """Whether something else than our own curves animates or drives the shape keys."""
    animation = None if key is None else key.animation_data
    if animation is None:
        return False
    actions = [animation.action, *(strip.action for track in animation.nla_tracks for strip in track.strips)]
    return len(animation.drivers) > 0 or any(
        not _is_our_curve(curve) for action in actions if action is not None for curve in _curves(action)
    )


def animated_paths(animation: bpy.types.AnimData | None) -> set[str]:
    """Data paths that actions, NLA tracks or drivers move."""
    if animation is None:
        return set()
    actions = [animation.action, *(strip.action for track in animation.nla_tracks for strip in track.strips)]
    paths = {curve.data_path for action in actions if action is not None for curve in _curves(action)}
    return paths | {driver.data_path for driver in animation.drivers}


def is_ours(action: bpy.types.Action | None) -> bool:
    """Whether a bake made this action."""
    return action is not None and MARK in action


def play_action(objects: Iterable[bpy.types.Object], name: str) -> tuple[int, int]:
    """Let objects play one action alone: it becomes their active one, and their NLA tracks are switched off.

    Parameters
    ----------
    objects
        Armatures (or whatever the action moves).
    name
        Of the action; where an importer added an object's name to it, "Walk" also finds "Walk_root" and "root|Walk".

    Returns
    -------
    First and last frame of the action.

    Raises
    ------
    ValueError
        Where there is no such action, or none for these objects, naming those that there are.
    """
    objects = list(objects)
    played = []
    for obj in objects:
        action = _find_action(obj, name)
        if action is None:
            continue
        animation = obj.animation_data or obj.animation_data_create()
        animation.use_nla = False
        animation.action = action
        if HAS_SLOTS:
            suitable = list(animation.action_suitable_slots)
            if not suitable:
                continue
            if animation.action_slot is None or animation.action_slot not in suitable:
                animation.action_slot = suitable[0]
        played.append(action)
    if not played:
        there = sorted(action.name for action in bpy.data.actions if not is_ours(action))
        raise ValueError(
            f"action: found no {name!r} for {_named(objects)}, expected one of {', '.join(there) or 'none'}"
        )
    return _range(played)


def played_range(objects: Iterable[bpy.types.Object]) -> tuple[int, int] | None:
    """First and last frame of what the objects play now; None where nothing is animated."""
    actions = []
    for obj in objects:
        animation = obj.animation_data
        if animation is None:
            continue
        if animation.action is not None:
            actions.append(animation.action)
        elif animation.use_nla:
            for track in animation.nla_tracks:
                if not track.mute:
                    actions.extend(strip.action for strip in track.strips if strip.action is not None)
    return _range(actions) if actions else None


def _range(actions: Sequence[bpy.types.Action]) -> tuple[int, int]:
    starts, ends = zip(*(action.frame_range for action in actions), strict=True)
    return math.floor(min(starts) + 1e-3), math.ceil(max(ends) - 1e-3)


def _named(objects: Sequence[bpy.types.Object]) -> str:
    return ", ".join(repr(obj.name) for obj in objects) or "any armature"


def _find_action(obj: bpy.types.Object, name: str) -> bpy.types.Action | None:
    for candidate in (name, f"{name}_{obj.name}", f"{obj.name}|{name}"):
        action = bpy.data.actions.get(candidate)
        if action is not None and not is_ours(action):
            return action
    if obj.animation_data is not None:
        for track in obj.animation_data.nla_tracks:
            if track.name == name and len(track.strips) == 1:
                return track.strips[0].action
    by_last_part = [action for action in bpy.data.actions if name in action.name.split("|")]
    return by_last_part[0] if len(by_last_part) == 1 else None


def _holders(action: bpy.types.Action) -> Iterator[bpy.types.bpy_struct]:
    """Whatever has the action's curves."""
    if not HAS_SLOTS:
        yield action
        return
    for layer in action.layers:
        for strip in layer.strips:
            yield from strip.channelbags


def _curves(action: bpy.types.Action) -> Iterator[bpy.types.FCurve]:
    for holder in _holders(action):
        yield from holder.fcurves


def _is_our_curve(curve: bpy.types.FCurve) -> bool:
    return curve.group is not None and curve.group.name == OURS


def _give_away(action: bpy.types.Action, animation: bpy.types.AnimData) -> None:
    """Take our curves, and our slot where nothing else is in it, out of an action that others have keyed into."""
    for holder in list(_holders(action)):
        for curve in [curve for curve in holder.fcurves if _is_our_curve(curve)]:
            holder.fcurves.remove(curve)
        for group in [group for group in holder.groups if group.name == OURS]:
            holder.groups.remove(group)
        if HAS_SLOTS and holder.slot == animation.action_slot and not len(holder.fcurves):
            slot = holder.slot
            animation.action = None
            action.slots.remove(slot)
    del action[MARK]
    action.name = f"{action.name.removeprefix(OURS).strip()}Action"
