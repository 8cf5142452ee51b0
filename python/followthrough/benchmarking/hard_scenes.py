# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that are hard for a solver, and unlike what the emulator is trained on.

Bodies of cubes with limbs, whips and sheets one cell thick, that hang, are loose or come in parts, and a four-legged runner filled with
coarse cubes, at rest as in its first frame, where cubes are squashed and turned inside out; dances, dead stops, spins, teleports, mirror
images, collapse and jitter; 5e4 to 5e6 Pa, uniform and painted; 24 to 60 frames a second. Lengths are in edges until `Scene.sequence`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from followthrough.character import FloatArray
from followthrough.datasets.bodies import Body, body_of
from followthrough.datasets.choreography import dance
from followthrough.datasets.recipes import random_numbers
from followthrough.datasets.skeletons import Pose, Skeleton
from followthrough.datasets.spheres import FRAME_TIME
from followthrough.datasets.surfaces import ellipsoid, together, tube
from followthrough.sequences import Sequence

Cell = tuple[int, int, int]
Bone = tuple[str, str, tuple[float, float, float], tuple[float, float, float]]

#: m, kg/m³; and the longest side of the runner, m.
_EDGE, _DENSITY, _RUNNER_LENGTH = 0.2, 1000.0, 5.0
#: The six tets of a cube, by their corners.
_CUBE = (
    ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1)),
    ((0, 1, 0), (0, 0, 1), (1, 0, 1), (0, 1, 1)),
    ((1, 0, 0), (1, 1, 0), (0, 1, 0), (1, 0, 1)),
    ((1, 1, 0), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
    ((1, 1, 0), (0, 1, 0), (1, 0, 1), (0, 1, 1)),
)
#: Seconds of the runner's stride.
_STRIDE = 0.5
#: Largest displacement of a crumpled rest shape's vertices, edges.
_CRUMPLE = 0.3


@dataclass(frozen=True, eq=False)
class _Puppet:
    """A body, the names of its bones, and the length of an edge, m."""

    body: Body
    bones: tuple[str, ...]
    edge: float = _EDGE


def _box(low: Cell, high: Cell) -> set[Cell]:
    along_x, along_y, along_z = (range(a, b) for a, b in zip(low, high, strict=True))
    return set(itertools.product(along_x, along_y, along_z))


def _ball(radius: float) -> set[Cell]:
    reach = math.ceil(radius)
    cells = _box((-reach, -reach, -reach), (reach, reach, reach))
    return {cell for cell in cells if math.dist(cell, (-0.5, -0.5, -0.5)) < radius}


def _skeleton(bones: Iterable[Bone]) -> tuple[Skeleton, tuple[str, ...]]:
    """Of bones (name, parent's name, head, tail)."""
    names, parents, heads, tails = zip(*bones, strict=True)
    numbers = tuple(names.index(parent) if parent else -1 for parent in parents)
    return Skeleton(np.array(heads, dtype=float), np.array(tails, dtype=float), numbers), names


def _puppet(
    cells: set[Cell], bones: list[Bone], held: tuple[str, ...], radius: float = 0.0, point: Cell | None = None
) -> _Puppet:
    """Cubes of which some bones hold what is near, or a point holds its nearest vertex, or nothing anything."""
    corners = np.array([[np.add(cell, corner) for corner in tet] for cell in sorted(cells) for tet in _CUBE])
    vertices, tets = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    places = vertices.astype(np.float64)
    skeleton, names = _skeleton(bones)
    constrained = np.zeros(len(places), dtype=bool)
    if held:
        constrained = skeleton.distances(places)[:, [names.index(name) for name in held]].min(axis=1) <= radius
    if point is not None:
        constrained[np.argmin(np.linalg.norm(places - np.array(point), axis=1))] = True
    tets = tets.reshape(-1, 4).astype(np.int32)
    return _Puppet(Body(places, tets, skeleton, skeleton.weights(places), constrained), names)


def _stick() -> _Puppet:
    """A trunk with arms and legs one cell thick that nothing holds."""
    cells = _box((-2, -1, 7), (2, 2, 14)) | _box((1, 0, 0), (2, 1, 7)) | _box((-2, 0, 0), (-1, 1, 7))
    cells |= _box((2, 0, 12), (10, 1, 13)) | _box((-10, 0, 12), (-2, 1, 13))
    bones: list[Bone] = [("hips", "", (0, 0.5, 7), (0, 0.5, 10.5)), ("chest", "hips", (0, 0.5, 10.5), (0, 0.5, 14))]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        leg, arm = f"{side} leg", f"{side} arm"
        bones += [
            (leg, "hips", (1.5 * sign, 0.5, 7), (1.5 * sign, 0.5, 3.5)),
            (leg + " 2", leg, (1.5 * sign, 0.5, 3.5), (1.5 * sign, 0.5, 0)),
            (arm, "chest", (2 * sign, 0.5, 12.5), (6 * sign, 0.5, 12.5)),
            (arm + " 2", arm, (6 * sign, 0.5, 12.5), (10 * sign, 0.5, 12.5)),
        ]
    return _puppet(cells, bones, ("hips", "chest"), 0.75)


def _whips() -> _Puppet:
    """A ball with two whips one cell thick and one two cells thick."""
    cells = _ball(3.8) | _box((1, 0, 3), (2, 1, 16)) | _box((-2, 0, 3), (-1, 1, 14)) | _box((-1, -16, -1), (1, -3, 1))
    return _puppet(cells, [("head", "", (0, 0, -2), (0, 0, 2))], ("head",), 1.8)


def _stalked() -> _Puppet:
    """A ball on a stalk that is held at its end."""
    cells = _ball(5.2) | _box((-1, -1, 4), (1, 1, 12))
    bones: list[Bone] = [("hips", "", (0, 0, 11.4), (0, 0, 12)), ("chest", "hips", (0, 0, 12), (0, 0, 12.6))]
    return _puppet(cells, bones, ("hips",), 1.6)


def _sheet() -> _Puppet:
    """One cell thick, held along the middle."""
    bones: list[Bone] = [("hips", "", (-9, 0.5, 0), (0, 0.5, 0)), ("chest", "hips", (0, 0.5, 0), (9, 0.5, 0))]
    return _puppet(_box((-9, 0, -7), (9, 1, 7)), bones, ("hips", "chest"), 0.8)


_PARTS = (
    _box((-3, -2, 0), (2, 2, 7))
    | _box((4, -1, 0), (7, 2, 5))
    | _box((-9, -1, 5), (-5, 1, 7))
    | _box((-1, -1, 10), (2, 2, 13))
)
_PART_BONES: list[Bone] = [
    ("hips", "", (0, 0, 0), (0, 0, 6)),
    ("arm", "hips", (4, 0, 3), (7, 0, 3)),
    ("left arm", "hips", (-9, 0, 6), (-5, 0, 6)),
    ("head", "hips", (0, 0, 10), (0, 0, 13)),
]


def _parts() -> _Puppet:
    """Four blocks that share nothing, each held."""
    return _puppet(_PARTS, _PART_BONES, ("hips", "arm", "left arm", "head"), 1.2)


def _loose() -> _Puppet:
    """The same, of which only one is held."""
    return _puppet(_PARTS, _PART_BONES, ("hips",), 1.2)


def _hanging() -> _Puppet:
    """A block that hangs on one vertex."""
    return _puppet(_box((-2, -2, 0), (2, 2, 9)), [("hips", "", (0, 0, 11), (0, 0, 9))], (), point=(0, 0, 9))


def _free() -> _Puppet:
    """A block that nothing holds."""
    bones: list[Bone] = [("hips", "", (0, 0, 0), (0, 0, 4)), ("chest", "hips", (0, 0, 4), (0, 0, 9))]
    return _puppet(_box((-2, -2, 0), (3, 2, 9)), bones, ())


def _block() -> _Puppet:
    """A plump block around two bones."""
    bones: list[Bone] = [("hips", "", (0, 0, 0), (0, 0, 5)), ("chest", "hips", (0, 0, 5), (0, 0, 11))]
    return _puppet(_box((-5, -3, 0), (4, 3, 11)), bones, ("hips", "chest"), 1.3)


def _bridge() -> _Puppet:
    """Two held blocks, and between them a limb one cell thick and one two cells thick."""
    cells = _box((-9, -2, 0), (-5, 2, 4)) | _box((5, -2, 0), (9, 2, 4))
    cells |= _box((-5, 1, 2), (5, 2, 3)) | _box((-5, -2, 0), (5, 0, 2))
    bones: list[Bone] = [("hips", "", (-7, 0, 1), (-7, 0, 3)), ("arm", "hips", (7, 0, 1), (7, 0, 3))]
    return _puppet(cells, bones, ("hips", "arm"), 1.6)


def _runner(cells: int) -> _Puppet:
    """Four thin legs, a bending back, a long tail, ears, so many cubes long; its bones hold what is very near them."""
    bones: list[Bone] = [
        ("hips", "", (0, -4.0, 7.0), (0, 0, 7.4)),
        ("chest", "hips", (0, 0, 7.4), (0, 4.0, 7.4)),
        ("neck", "chest", (0, 4.0, 7.4), (0, 6.0, 9.6)),
        ("head", "neck", (0, 6.0, 9.6), (0, 9.0, 9.4)),
        ("tail", "hips", (0, -4.0, 7.0), (0, -7.5, 7.4)),
        ("tail 2", "tail", (0, -7.5, 7.4), (0, -11.0, 6.6)),
    ]
    flesh = [
        tube([b[2] for b in bones[:2]] + [bones[1][3]], [1.9, 1.7, 2.0]),
        tube([bones[2][2], bones[2][3]], [1.5, 1.0]),
        tube([bones[3][2], bones[3][3]], [1.4, 0.6]),
        tube([bones[4][2], bones[5][2], bones[5][3]], [0.7, 1.2, 0.5]),
        ellipsoid((0, -3.2, 6.8), (2.0, 2.3, 2.0)),
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for name, parent, y in (("front leg", "chest", 3.4), ("back leg", "hips", -3.6)):
            joints = [(1.3 * sign, y, 6.4), (1.4 * sign, y + 0.6, 3.2), (1.4 * sign, y, 0.0)]
            bones += [
                (f"{side} {name}", parent, joints[0], joints[1]),
                (f"{side} {name} 2", f"{side} {name}", joints[1], joints[2]),
            ]
            flesh.append(tube(joints, [1.1, 0.7, 0.5]))
        ear = [(0.8 * sign, 6.2, 10.4), (1.3 * sign, 5.8, 12.6)]
        bones.append((f"{side} ear", "head", ear[0], ear[1]))
        flesh.append(tube(ear, [0.7, 0.3]))
    skeleton, names = _skeleton(bones)
    surface = together(flesh)
    scale = cells / float(np.ptp(surface.vertices, axis=0).max())
    surface = type(surface)(scale * surface.vertices, surface.triangles)
    skeleton = Skeleton(scale * skeleton.heads, scale * skeleton.tails, skeleton.parents)
    return _Puppet(body_of(surface, skeleton, 0.9, list(range(len(names)))), names, _RUNNER_LENGTH / cells)


_BODIES: dict[str, Callable[[], _Puppet]] = {
    "stick": _stick,
    "whips": _whips,
    "stalked": _stalked,
    "sheet": _sheet,
    "parts": _parts,
    "loose": _loose,
    "hanging": _hanging,
    "free": _free,
    "block": _block,
    "bridge": _bridge,
    "runner 15": lambda: _runner(15),
    "runner 20": lambda: _runner(20),
    "runner 25": lambda: _runner(25),
}


@cache
def _made(body: str) -> _Puppet:
    return _BODIES[body]()


def _danced(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> Pose:
    """A dance, at times that are counted in the frames of the training data."""
    pose = dance(random, math.ceil(times[-1]) + 20, puppet.bones)
    whole = np.arange(len(pose.turns))

    def at(values: FloatArray) -> FloatArray:
        columns = [np.interp(times, whole, column) for column in values.reshape(len(whole), -1).T]
        return np.stack(columns, axis=1).reshape(len(times), *values.shape[1:])

    return Pose(at(pose.turns), at(pose.translations))


def _nothing(puppet: _Puppet, times: FloatArray) -> Pose:
    return Pose(np.zeros((len(times), len(puppet.bones), 3)), np.zeros((len(times), 3)))


def _dance(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    return puppet.body.reference(_danced(puppet, times, random))


def _stop(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """Runs off, faster than it is long in twenty frames, and stops dead."""
    pose = _nothing(puppet, times)
    since = times % 40
    pose.translations[:, 0] = 8.0 * np.sin(2 * np.pi * np.minimum(since, 20.0) / 27)
    pose.translations[:, 2] = 0.35 * np.where(since < 20, since, 0.0)
    return puppet.body.reference(pose)


def _spin(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """Turns fourteen times a hundred frames, nodding, and stops after forty."""
    pose = _nothing(puppet, times)
    turning = np.minimum(times, 40.0)
    pose.turns[:, 0, 2] = 0.45 * turning
    pose.turns[:, 0, 0] = 0.5 * np.sin(0.2 * turning)
    return puppet.body.reference(pose)


def _teleport(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """A dance that is elsewhere, ten edges or so away, every thirty frames."""
    reference = _dance(puppet, times, random)
    for frame in range(25, len(times), 30):
        reference[frame:] += 6.0 * random.normal(size=3)
    return reference


def _mirror(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """A dance that is its mirror image for thirty frames."""
    reference = _dance(puppet, times, random)
    reference[30:60, :, 0] = 2 * reference[30:60, :, 0].mean(axis=1, keepdims=True) - reference[30:60, :, 0]
    return reference


def _collapse(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """A dance that shrinks to three tenths of its size within ten frames, and grows again."""
    reference = _dance(puppet, times, random)
    frames = np.arange(len(times))
    size = 1 - 0.7 * (np.clip((frames - 20) / 10, 0, 1) - np.clip((frames - 40) / 10, 0, 1))
    middle = reference.mean(axis=1, keepdims=True)
    shrunk: FloatArray = middle + size[:, None, None] * (reference - middle)
    return shrunk


def _jitter(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """A dance of which every vertex trembles."""
    reference = _dance(puppet, times, random)
    return reference + 0.05 * random.normal(size=reference.shape)


def _bone_jitter(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """A dance of which every bone trembles."""
    pose = _danced(puppet, times, random)
    turns = pose.turns + 0.02 * random.normal(size=pose.turns.shape)
    return puppet.body.reference(Pose(turns, pose.translations + 0.05 * random.normal(size=pose.translations.shape)))


def _torn(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """A dance of which one corner is elsewhere, turned about, for ten frames."""
    reference = _dance(puppet, times, random)
    far = puppet.body.vertices @ np.array([1.0, 0.3, 0.6])
    corner = np.argsort(-far)[: max(8, len(far) // 25)]
    for frame in range(25, 35):
        middle = reference[frame, corner].mean(axis=0)
        reference[frame, corner] = 2 * middle + np.array([12.0, 0.0, 9.0]) - reference[frame, corner]
    return reference


def _swing(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """Every bone swings to and fro in twenty frames, and the whole jumps."""
    pose = _nothing(puppet, times)
    for bone in range(len(puppet.bones)):
        phase = 2 * np.pi * (times[:, None] / 20 + random.random(3))
        pose.turns[:, bone] = (0.25 if bone == 0 else 0.5) * random.random(3) * np.sin(phase)
    pose.translations[:, 2] = 1.5 * np.abs(np.sin(np.pi * times / 20))
    return puppet.body.reference(pose)


def _gallop(puppet: _Puppet, times: FloatArray, random: np.random.Generator) -> FloatArray:
    """Two strides a second, stretched at the beginning."""
    pose = _nothing(puppet, times)
    phase = 2 * np.pi * times * FRAME_TIME / _STRIDE
    for bone, name in enumerate(puppet.bones):
        late = 0.5 * ("left" in name) + (np.pi if "back" in name else 0.0)
        if "leg 2" in name:
            pose.turns[:, bone, 0] = (1.5 if "back" in name else -1.5) * (0.6 + 0.4 * np.sin(phase - late))
        elif "leg" in name:
            pose.turns[:, bone, 0] = 1.2 * np.cos(phase - late)
        elif "tail" in name:
            pose.turns[:, bone, 0] = 0.7 * np.sin(phase - 1.0)
            pose.turns[:, bone, 2] = 0.3 * np.sin(0.5 * phase)
        elif name in ("chest", "neck"):
            pose.turns[:, bone, 0] = 0.6 * np.cos(phase) * (1 if name == "chest" else -1)
    pose.translations[:, 2] = 1.2 * np.abs(np.sin(0.5 * phase))
    return puppet.body.reference(pose)


_MOTIONS: dict[str, Callable[[_Puppet, FloatArray, np.random.Generator], FloatArray]] = {
    "dance": _dance,
    "stop": _stop,
    "spin": _spin,
    "teleport": _teleport,
    "mirror": _mirror,
    "collapse": _collapse,
    "jitter": _jitter,
    "bone jitter": _bone_jitter,
    "torn": _torn,
    "swing": _swing,
    "gallop": _gallop,
}


@dataclass(frozen=True)
class Scene:
    """A body in a motion.

    Attributes
    ----------
    body, motion : str
        As this module has them.
    youngs_modulus : float
        Pa.
    painted : bool
        A hundred times as stiff in some places as in others.
    rest : str
        "bind", as the body is filled with cubes; "first", as the reference is in the first frame; or "crumpled", likewise, but with
        vertices displaced there that later frames put back.
    frames_a_second : float
    speed : float
        Of the motion.
    frames : int
    """

    body: str
    motion: str
    youngs_modulus: float = 5e4
    painted: bool = False
    rest: str = "bind"
    frames_a_second: float = 1 / FRAME_TIME
    speed: float = 1.0
    frames: int = 100

    @property
    def name(self) -> str:
        """What tells it from the others."""
        parts = [self.body, self.motion, f"{self.youngs_modulus:.0e} Pa".replace("e+0", "e")]
        parts += ["painted"] * self.painted + [f"rest {self.rest}"] * (self.rest != "bind")
        if self.frames_a_second != 1 / FRAME_TIME:
            parts.append(f"{self.frames_a_second:g} fps")
        if self.speed != 1:
            parts.append(f"{self.speed:g} times as fast")
        return ", ".join(parts)

    def sequence(self) -> Sequence:
        """Without its true motion. Metres are the paper's units: an edge is 0.2 long, or the runner 5."""
        puppet = _made(self.body)
        body, edge = puppet.body, puppet.edge
        random = random_numbers(f"hard scene {self.name}", 0, 0)
        times = self.speed * np.arange(self.frames) / (self.frames_a_second * FRAME_TIME)
        reference = edge * _MOTIONS[self.motion](puppet, times, random)
        if self.rest == "crumpled":
            there = 0.5 + 0.5 * np.cos(2 * np.pi * times / 20)
            reference += edge * _CRUMPLE * there[:, None, None] * (2 * random.random(body.vertices.shape) - 1)
        modulus = np.full(len(body.vertices), self.youngs_modulus)
        if self.painted:
            x, _, z = body.vertices.T
            modulus *= 10 ** np.clip(np.sin(0.6 * x) + np.cos(0.4 * z + 1), -1, 1)
        return Sequence(
            rest_positions=edge * body.vertices if self.rest == "bind" else reference[0],
            tets=body.tets,
            constrained=body.constrained,
            youngs_modulus=modulus,
            dt=1 / self.frames_a_second,
            reference=reference,
            density=_DENSITY,
        )


def _all_scenes() -> tuple[Scene, ...]:
    scenes: list[Scene] = []
    for body in ("stick", "whips", "stalked", "sheet", "parts", "loose", "hanging", "free", "bridge"):
        scenes += [
            Scene(body, "dance"),
            Scene(body, "dance", 5e6),
            Scene(body, "dance", 3e5, painted=True, frames_a_second=30),
        ]
    motions = ("stop", "spin", "teleport", "mirror", "collapse", "jitter", "bone jitter", "torn", "swing")
    for number, motion in enumerate(motions):
        pair = [Scene("block", motion), Scene("stick", motion)]
        scenes += pair[:: -1 if number % 2 == 0 else 1]
    for motion in ("teleport", "jitter", "torn"):
        scenes += [Scene("bridge", motion, 5e5), Scene("block", motion, 5e6, frames_a_second=60)]
    scenes += [Scene("whips", "spin"), Scene("sheet", "stop"), Scene("sheet", "spin"), Scene("stalked", "spin")]
    scenes += [
        Scene("block", "swing", rest="crumpled"),
        Scene("block", "dance", 5e5, rest="crumpled", frames_a_second=24),
    ]
    for body in ("runner 15", "runner 20", "runner 25"):
        scenes += [
            Scene(body, "gallop", rest="first"),
            Scene(body, "gallop"),
            Scene(body, "gallop", 5e6, rest="first", frames_a_second=24),
            Scene(body, "gallop", rest="first", speed=2),
            Scene(body, "gallop", 3e5, painted=True, rest="first", frames_a_second=60),
        ]
    return tuple(scenes)


#: All of them.
SCENES = _all_scenes()
#: What is chosen on the first half is reported on the other.
HALVES = ("choose", "report")


def half(which: str) -> tuple[Scene, ...]:
    """Every second scene, from the first one on to choose on, from the second one on to report.

    Raises
    ------
    ValueError
        On any other name.
    """
    if which not in HALVES:
        raise ValueError(f"half: found {which}, expected {' or '.join(HALVES)}")
    return SCENES[HALVES.index(which) :: 2]
