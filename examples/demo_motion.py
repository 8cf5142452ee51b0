# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo creature's actions: Walk, Jump and Shake, as keys on its armature. What is soft is not animated here.

Rotations are given in degrees about the armature's axes: about x leans forwards (and moves a hanging arm backwards),
about y leans to the creature's left, about z turns to its left.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from math import cos, pi, radians, sin

import bpy
from mathutils import Euler, Quaternion, Vector

from demo_creature import BONES

FPS = 24
HIPS = Vector(BONES["hips"][0])
HIP_JOINT = Vector(BONES["thigh.L"][0])
KNEE = Vector(BONES["shin.L"][0])
ANKLE = Vector(BONES["foot.L"][0])


@dataclass
class Posture:
    """One frame: where the hips and ankles are, metres from rest, and rotations of bones in degrees."""

    hips: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turns: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    ankles: dict[str, tuple[float, float]] = field(default_factory=dict)  # side: backwards and up
    feet: dict[str, float] = field(default_factory=dict)  # side: toes down


def hermite(frame: float, keys: list[tuple[float, float, float]]) -> float:
    """Value at a frame of a curve through keys (frame, value, slope a frame), constant outside."""
    if frame <= keys[0][0]:
        return keys[0][1]
    for (f0, v0, s0), (f1, v1, s1) in pairwise(keys):
        if frame <= f1:
            span = f1 - f0
            t = (frame - f0) / span
            return (
                (2 * t**3 - 3 * t**2 + 1) * v0
                + (t**3 - 2 * t**2 + t) * span * s0
                + (3 * t**2 - 2 * t**3) * v1
                + (t**3 - t**2) * span * s1
            )
    return keys[-1][1]


def eased(frame: float, keys: list[tuple[float, float]]) -> float:
    """Value at a frame of a curve that rests at every key (frame, value)."""
    return hermite(frame, [(at, value, 0.0) for at, value in keys])


def walk(frame: float, length: float = 24.0) -> Posture:
    """A heavy waddle on the spot; two steps a cycle."""
    phase = 2 * pi * frame / length
    stance = 0.58
    middle = 2 * pi * stance / 2  # left foot under the body
    left = cos(phase - middle)
    bounce = cos(2 * (phase - middle))
    posture = Posture(hips=(0.05 * left, 0.0, -0.028 + 0.038 * bounce))
    swing = sin(phase - middle)
    posture.turns = {
        "hips": (3.0, 6.0 * left, 9.0 * swing),
        "spine": (-1.0 - 2.0 * bounce, -4.0 * left, -6.0 * swing),
        "chest": (1.0, -5.0 * left, -9.0 * swing),
        "head": (-3.0 + 4.0 * cos(2 * (phase - middle) - 0.9), 5.0 * left, 5.0 * swing),
        "tail": (0.0, 0.0, -16.0 * sin(phase - middle - 0.5)),
        "upper_arm.L": (-26.0 * swing, 8.0, 0.0),
        "upper_arm.R": (26.0 * swing, -8.0, 0.0),
        "forearm.L": (-18.0 - 14.0 * swing, 0.0, 0.0),
        "forearm.R": (-18.0 + 14.0 * swing, 0.0, 0.0),
    }
    for side, offset in (("L", 0.0), ("R", 0.5)):
        place = (frame / length + offset) % 1.0
        if place < stance:
            share = place / stance
            posture.ankles[side] = (-0.15 + 0.30 * share, 0.0)
            posture.feet[side] = -14.0 * max(1.0 - share * 6.0, 0.0)
        else:
            share = (place - stance) / (1.0 - stance)
            along = share * share * (3.0 - 2.0 * share)
            posture.ankles[side] = (0.15 - 0.30 * along, 0.10 * sin(pi * share) ** 1.2)
            posture.feet[side] = 26.0 * sin(pi * min(share * 1.3, 1.0)) - 14.0 * share**3
    return posture


def jump(frame: float) -> Posture:
    """Anticipation, half a second in the air, a hard landing, and a stop within a third of a second."""
    height = hermite(
        frame,
        [
            (2, 0.0, 0.0),
            (5, 0.015, 0.0),
            (11, -0.15, 0.0),
            (16, 0.02, 0.105),
            (28, 0.02, -0.105),
            (31, -0.135, 0.0),
            (36, 0.012, 0.0),
            (39, 0.0, 0.0),
        ],
    )
    lean = eased(frame, [(2, 0), (5, -3), (11, 17), (16, -6), (22, 2), (27, -2), (31, 15), (36, -4), (40, 0)])
    head = eased(frame, [(3, 0), (11, -18), (15, 4), (22, 8), (28, -6), (31, 4), (36, -4), (41, 0)])
    arm = eased(frame, [(2, 0), (5, -8), (11, 48), (17, -120), (23, -95), (28, -70), (32, 22), (37, -6), (41, 0)])
    spread = eased(frame, [(11, 4), (17, 18), (27, 32), (31, 26), (37, 0)])
    elbow = eased(frame, [(2, 0), (11, -22), (17, -8), (28, -25), (32, -35), (38, 0)])
    flying = 16 < frame < 28
    tuck = eased(frame, [(16, 0.0), (21, 0.07), (28, 0.0)])
    toes = eased(frame, [(13, 0), (16.5, 34), (22, 18), (27.5, 0)])
    posture = Posture(hips=(0.0, 0.03 * lean / 17.0, height))
    posture.turns = {
        "hips": (0.7 * lean, 0.0, 0.0),
        "spine": (0.6 * lean, 0.0, 0.0),
        "chest": (0.5 * lean, 0.0, 0.0),
        "head": (head - 0.8 * lean, 0.0, 0.0),
        "tail": (eased(frame, [(3, 0), (11, 22), (17, -22), (25, 12), (31, -14), (37, 0)]), 0.0, 0.0),
        "upper_arm.L": (arm, -spread, 0.0),
        "upper_arm.R": (arm, spread, 0.0),
        "forearm.L": (elbow, 0.0, 0.0),
        "forearm.R": (elbow, 0.0, 0.0),
    }
    for side in "LR":
        posture.ankles[side] = (0.0, (height - 0.02) + tuck if flying else 0.0)
        posture.feet[side] = toes
    return posture


def shake(frame: float) -> Posture:
    """A wet dog's shake, three times a second, from the head down."""
    strength = eased(frame, [(2, 0.0), (9, 1.0), (22, 1.0), (27, 0.0)])
    crouch = eased(frame, [(0, 0.0), (6, -0.06), (22, -0.05), (29, 0.0)])

    def twist(lag: float) -> float:
        return strength * sin(2 * pi * (frame - 2.0 - lag) / 8.0)

    posture = Posture(hips=(0.02 * twist(1.5), 0.0, crouch))
    posture.turns = {
        "hips": (5.0 * strength, 2.5 * twist(2.0), 6.0 * twist(1.5)),
        "spine": (4.0 * strength, 0.0, 5.0 * twist(1.0)),
        "chest": (4.0 * strength, 3.0 * twist(0.8), 5.0 * twist(0.7)),
        "head": (4.0 * strength, 5.0 * twist(0.5), 3.0 * twist(0.0)),
        "tail": (0.0, 0.0, -14.0 * twist(2.5)),
        "upper_arm.L": (0.0, -16.0 * strength, 10.0 * twist(1.5)),
        "upper_arm.R": (0.0, 16.0 * strength, 10.0 * twist(1.5)),
        "forearm.L": (-14.0 * strength, 0.0, 0.0),
        "forearm.R": (-14.0 * strength, 0.0, 0.0),
    }
    return posture


#: Every action: what it does, and its length in frames.
ACTIONS: dict[str, tuple[Callable[[float], Posture], int]] = {
    "Walk": (walk, 24),
    "Jump": (jump, 50),
    "Shake": (shake, 40),
}


def rotation(turn: tuple[float, float, float]) -> Quaternion:
    """Rotation of angles in degrees about x, then y, then z."""
    return Euler([radians(angle) for angle in turn], "XYZ").to_quaternion()


def clearance(down: float) -> float:
    """How far an ankle must rise so that a foot turned toes down by this angle, radians, stays above the floor."""
    return max(
        0.30 * sin(down) + 0.04 * cos(down) - 0.09,
        0.22 * sin(down) + 0.09 * cos(down) - 0.09,
        -0.09 * sin(down) + 0.085 * cos(down) - 0.09,
        0.0,
    )


def pose(armature: bpy.types.Object, posture: Posture) -> None:
    """Put an armature into a posture; legs reach for their ankles."""
    turns = {name: rotation(turn) for name, turn in posture.turns.items()}
    hips = turns.get("hips", Quaternion())
    for side, sign in (("L", 1.0), ("R", -1.0)):
        mirror = Vector((sign, 1.0, 1.0))
        joint, knee, ankle = (point * mirror for point in (HIP_JOINT, KNEE, ANKLE))
        backwards, up = posture.ankles.get(side, (0.0, 0.0))
        down = radians(posture.feet.get(side, 0.0))
        target = ankle + Vector((0.0, backwards, max(up, clearance(down))))
        target = HIPS + hips.inverted() @ (target - HIPS - Vector(posture.hips))
        thigh, shin = (knee - joint).length, (ankle - knee).length
        reach = target - joint
        distance = min(max(reach.length, abs(thigh - shin) + 1e-3), 0.999 * (thigh + shin))
        direction = reach.normalized()
        forwards = Vector((0.0, -1.0, 0.0))
        forwards = (forwards - direction * forwards.dot(direction)).normalized()
        along = (thigh**2 - shin**2 + distance**2) / (2 * distance)
        bent = joint + direction * along + forwards * max(thigh**2 - along**2, 0.0) ** 0.5
        reached = joint + direction * distance
        upper = (knee - joint).rotation_difference(bent - joint)
        lower = (ankle - knee).rotation_difference(upper.inverted() @ (reached - bent))
        turns[f"thigh.{side}"], turns[f"shin.{side}"] = upper, lower
        sole = rotation((posture.feet.get(side, 0.0), 0.0, 0.0))
        turns[f"foot.{side}"] = (hips @ upper @ lower).inverted() @ sole
    for bone in armature.pose.bones:
        rest = bone.bone.matrix_local.to_quaternion()
        turn = rest.inverted() @ turns.get(bone.name, Quaternion()) @ rest
        bone.rotation_quaternion = -turn if turn.dot(bone.rotation_quaternion) < 0 else turn
    rest = armature.data.bones["hips"].matrix_local.to_quaternion()
    armature.pose.bones["hips"].location = rest.inverted() @ Vector(posture.hips)


def make_actions(armature: bpy.types.Object) -> dict[str, bpy.types.Action]:
    """Key every action, from frame 0 on, and leave the armature at rest without an active one."""
    animation = armature.animation_data_create()
    actions = {}
    for name, (posture_at, length) in ACTIONS.items():
        action = bpy.data.actions.new(name)
        action.use_fake_user = True
        animation.action = action
        for frame in range(length + 1):
            pose(armature, posture_at(float(frame)))
            for bone in armature.pose.bones:
                bone.keyframe_insert("rotation_quaternion", frame=frame)
            armature.pose.bones["hips"].keyframe_insert("location", frame=frame)
        actions[name] = action
    animation.action = None
    pose(armature, Posture())
    return actions


def play(armature: bpy.types.Object, strips: list[tuple[str, int, int, int]]) -> int:
    """Put actions one after the other on the armature's NLA, each on a track of its own.

    Parameters
    ----------
    strips
        Name of an action, the frame it starts at, how often it is repeated and how many frames it takes to blend in.

    Returns
    -------
    The last strip's last frame.
    """
    end = 0
    for name, start, repeat, blend_in in strips:
        track = armature.animation_data.nla_tracks.new()
        track.name = name
        strip = track.strips.new(name, start, bpy.data.actions[name])
        if hasattr(strip, "action_slot") and strip.action_slot is None:
            strip.action_slot = strip.action.slots[0]
        strip.action_frame_end = ACTIONS[name][1]
        strip.repeat = repeat
        strip.extrapolation = "HOLD_FORWARD"
        strip.blend_in = blend_in
        end = int(strip.frame_end)
    return end
