# SPDX-License-Identifier: GPL-3.0-or-later
"""Lively motions for training: fast turns, jumps, stops, twists and swings, put together at random."""

from __future__ import annotations

import numpy as np

from followthrough.character import FloatArray
from followthrough.datasets.recipes import log_uniform, unit_vector
from followthrough.datasets.skeletons import Pose

#: Shortest and longest gesture, frames.
_DURATIONS = (3.0, 40.0)
#: Largest turn of a joint, and of the whole body in one gesture, radians.
_JOINT_TURN, _BODY_TURN = 1.1, 2.5


def move(frames: int, start: int, duration: int, sharpness: float) -> FloatArray:
    """A way from 0 to 1, (F,); its speed ends suddenly for a sharpness of 1, and fades out for 0."""
    share = np.clip((np.arange(frames) - start) / duration, 0.0, 1.0)
    smooth = share * share * (3.0 - 2.0 * share)
    sudden = share * share
    way: FloatArray = smooth + sharpness * (sudden - smooth)
    return way


def hops(frames: int, start: int, duration: int, count: int) -> FloatArray:
    """Parabolas of height 1 one after the other, (F,), with a take-off and a landing in no time."""
    phase = (np.arange(frames) - start) / duration
    within = phase - np.floor(phase)
    height: FloatArray = np.where((phase >= 0) & (phase < count), 4.0 * within * (1.0 - within), 0.0)
    return height


def swings(frames: int, start: int, duration: int, count: int) -> FloatArray:
    """Swings to both sides, (F,), that begin and end at 0; suddenly, as they are sines."""
    phase = (np.arange(frames) - start) / duration
    swing: FloatArray = np.where((phase >= 0) & (phase < count), np.sin(2.0 * np.pi * phase), 0.0)
    return swing


def gesture(random: np.random.Generator, frames: int) -> tuple[FloatArray, bool]:
    """One gesture, (F,), of size 1 that begins after the first frames; and whether it is a hop."""
    duration = max(2, round(log_uniform(random, *_DURATIONS)))
    start = 1 + int(random.random() * max(1, frames - 1 - duration))
    kind = random.random()
    if kind < 0.3:
        return move(frames, start, duration, random.random()), False
    if kind < 0.5:
        back = start + duration + int(random.random() * 10)
        sharpness = random.random()
        return move(frames, start, duration, sharpness) - move(frames, back, duration, sharpness), False
    if kind < 0.75:
        return hops(frames, start, max(4, duration), 1 + int(random.random() * 3)), True
    return swings(frames, start, max(6, duration), 1 + int(random.random() * 4)), False


def random_pose(random: np.random.Generator, frames: int, bones: int) -> Pose:
    """Gestures of the whole body and of every joint; a still first frame.

    The motion is of size 1 or so; `at_acceleration` gives it the size that it is to have.
    """
    turns = np.zeros((frames, bones, 3))
    translations = np.zeros((frames, 3))
    for _ in range(max(2, frames // 40) + int(random.random() * 3)):
        way, hopping = gesture(random, frames)
        direction = np.array([0.0, 0.0, 1.0]) if hopping and random.random() < 0.5 else unit_vector(random)
        translations += way[:, None] * direction * log_uniform(random, 0.5, 8.0)
    for bone in range(bones):
        limit = _JOINT_TURN if bone else _BODY_TURN
        for _ in range(int(random.random() * 4) + (bone > 0)):
            way, _ = gesture(random, frames)
            turns[:, bone] += way[:, None] * unit_vector(random) * log_uniform(random, 0.1, 1.0) * limit
        sizes = np.linalg.norm(turns[:, bone], axis=1).max()
        if bone and sizes > limit:
            turns[:, bone] *= limit / sizes
    return Pose(turns, translations)
