# SPDX-License-Identifier: GPL-3.0-or-later
"""Dances to measure on: steps on a beat, eased from pose to pose, with quick turns, jumps and dead stops.

Nothing here is used to make training data, and nothing of the training gestures is used here.
"""

from __future__ import annotations

import numpy as np

from followthrough.character import FloatArray
from followthrough.datasets.skeletons import Pose

#: Frames of a beat: 110 to 150 a minute at a frame in 0.0316 s.
_BEATS = (13, 17)
#: Largest angles of a pose about x, y, z by the kind of bone, radians.
_FLEXIBILITY = {
    "hips": (0.25, 0.2, 0.0),
    "chest": (0.3, 0.3, 0.5),
    "head": (0.4, 0.3, 0.6),
    "arm": (0.7, 0.6, 0.4),
    "leg": (0.4, 0.15, 0.15),
}
#: Height of a jump and length of a step, edges.
_JUMP, _STEP = 4.0, 3.0
#: How quickly a pose is reached, in beats.
_QUICKEST, _SLOWEST = 0.5, 1.0


def _ease(share: FloatArray) -> FloatArray:
    """From 0 to 1 with an overshoot that swings back, as dancers accent a beat."""
    share = np.clip(share, 0.0, 1.0)
    eased: FloatArray = 1.0 - (1.0 - share) ** 3 * (1.0 + 3.0 * share - 4.0 * share**2)
    return eased


def _stopped_dead(share: FloatArray) -> FloatArray:
    """From 0 to 1, faster and faster, and then not at all."""
    way: FloatArray = np.clip(share, 0.0, 1.0) ** 1.3
    return way


def dance(random: np.random.Generator, frames: int, bones: tuple[str, ...]) -> Pose:
    """A dance of a character's bones.

    Every beat has a new pose of the limbs and a step of the body: a side step, a jump (crouch, flight, landing), a quarter
    or half turn in less than a beat, a bounce, or a freeze in which everything stops dead.

    Parameters
    ----------
    random
        Where it comes from.
    frames
        How many, F.
    bones
        Their names, which say how far they may turn.
    """
    beat = _BEATS[0] + int(random.random() * (_BEATS[1] - _BEATS[0] + 1))
    time = np.arange(frames, dtype=np.float64)
    turns = np.zeros((frames, len(bones), 3))
    translations = np.zeros((frames, 3))
    limits = np.array([_limits(name) for name in bones])
    now = np.zeros((len(bones), 3))
    side = 1.0
    frozen = False
    for start in range(beat, frames, beat):
        step = random.random()
        aim = limits * (2.0 * random.random(limits.shape) - 1.0)
        length = beat * (_QUICKEST + (_SLOWEST - _QUICKEST) * random.random())
        share = (time - start) / length
        if step < 0.15 and not frozen:  # a freeze: nothing new until the next beat
            frozen = True
            continue
        frozen = False
        way = _stopped_dead(share) if random.random() < 0.25 else _ease(share)
        turns += way[:, None, None] * (aim - now)
        now = aim
        if step < 0.4:
            side = -side
            translations[:, 0] += side * _STEP * (0.4 + 0.6 * random.random()) * way
        elif step < 0.65:
            translations[:, 2] += _jump((time - start) / beat) * (0.4 + 0.6 * random.random())
        elif step < 0.8:
            quarters = (1 + int(random.random() * 2)) * (1.0 if random.random() < 0.5 else -1.0)
            spin = _stopped_dead if random.random() < 0.4 else _ease
            turns[:, 0, 2] += quarters * np.pi / 2 * spin((time - start) / (beat * (0.45 + 0.25 * abs(quarters))))
        else:
            translations[:, 2] -= 1.2 * np.sin(np.pi * np.clip((time - start) / beat, 0.0, 1.0)) ** 2
    return Pose(_softened(turns), _softened(translations))


def _softened(values: FloatArray) -> FloatArray:
    """Jolts spread over three frames, as flesh on bones spreads them; the first frame stays."""
    before, after = np.concatenate([values[:1], values[:-1]]), np.concatenate([values[1:], values[-1:]])
    soft: FloatArray = (before + 2.0 * values + after) / 4.0
    soft[0] = values[0]
    return soft


def _limits(name: str) -> tuple[float, float, float]:
    for word, angles in _FLEXIBILITY.items():
        if word in name:
            return angles
    return (0.0, 0.0, 0.0)  # ears and tails hang on


def _jump(share: FloatArray) -> FloatArray:
    """Height of a crouch, a flight and a landing within a beat, (F,)."""
    crouch = -0.9 * np.sin(np.pi * np.clip(share / 0.3, 0.0, 1.0))
    flight = np.clip((share - 0.3) / 0.7, 0.0, 1.0)
    height: FloatArray = crouch + _JUMP * 4.0 * flight * (1.0 - flight)
    return height
