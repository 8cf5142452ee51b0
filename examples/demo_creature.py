# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo creature as plain arrays: surface, colours, bones, skin weights and what is painted on it. No Blender here.

It stands on the ground, looks along -Y, is 1.4 m tall without its ears, and its body is symmetric about x = 0: the zero
level of one field, a smooth union of round shapes, each grown around a bone. Eyes, nose, mouth and toes are closed
parts of their own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from demo_surface import (
    Field,
    FloatArray,
    IntArray,
    along,
    ball,
    edges_of,
    ellipsoid,
    gradient,
    is_closed,
    neighbour_mean,
    pipe,
    polygonise,
    smooth_path,
    smooth_union,
    tube,
)
from followthrough.character import Rig, Surface
from followthrough.suggestions import suggest_paint

#: Head, tail and parent of every bone; bones of the left side stand for both.
BONES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], str | None]] = {
    "hips": ((0.0, 0.04, 0.42), (0.0, 0.04, 0.58), None),
    "spine": ((0.0, 0.04, 0.58), (0.0, 0.03, 0.78), "hips"),
    "chest": ((0.0, 0.03, 0.78), (0.0, 0.0, 0.96), "spine"),
    "head": ((0.0, 0.0, 0.96), (0.0, -0.02, 1.34), "chest"),
    "ear.L": ((0.11, -0.01, 1.28), (0.155, 0.0, 1.41), "head"),
    "tail": ((0.0, 0.22, 0.40), (0.0, 0.38, 0.35), "hips"),
    "upper_arm.L": ((0.17, 0.0, 0.86), (0.36, -0.01, 0.70), "chest"),
    "forearm.L": ((0.36, -0.01, 0.70), (0.47, -0.05, 0.55), "upper_arm.L"),
    "hand.L": ((0.47, -0.05, 0.55), (0.52, -0.08, 0.46), "forearm.L"),
    "thigh.L": ((0.16, 0.03, 0.42), (0.185, -0.04, 0.24), "hips"),
    "shin.L": ((0.185, -0.04, 0.24), (0.19, 0.03, 0.09), "thigh.L"),
    "foot.L": ((0.19, 0.03, 0.09), (0.205, -0.16, 0.04), "shin.L"),
}

EAR = smooth_path(
    np.array(
        [
            [0.10, -0.01, 1.26],
            [0.15, 0.0, 1.42],
            [0.24, 0.01, 1.60],
            [0.38, 0.01, 1.71],
            [0.53, -0.01, 1.68],
            [0.62, -0.03, 1.56],
        ]
    ),
    12,
)
TAIL = smooth_path(
    np.array(
        [
            [0.0, 0.22, 0.40],
            [0.0, 0.40, 0.33],
            [0.0, 0.58, 0.36],
            [0.0, 0.72, 0.50],
            [0.0, 0.76, 0.68],
            [0.0, 0.70, 0.83],
        ]
    ),
    11,
)
EAR_RADII = np.interp(np.linspace(0, 1, len(EAR)), [0, 0.15, 0.5, 0.8, 1], [0.055, 0.06, 0.105, 0.10, 0.07])
TAIL_RADII = np.interp(np.linspace(0, 1, len(TAIL)), [0, 0.25, 0.72, 0.9, 1], [0.13, 0.085, 0.055, 0.095, 0.10])
#: Ears are this much flatter, front to back, than they are wide.
EAR_FLATNESS = 2.0
EYE = np.array([0.098, -0.218, 1.185])
EYE_RADIUS = 0.066
GAZE = np.array([-0.03, -1.0, 0.0])
BELLY = (0.0, -0.085, 0.54)

COLOURS = {  # sRGB
    "skin": (0.25, 0.62, 0.60),
    "back": (0.13, 0.42, 0.46),
    "belly": (0.97, 0.88, 0.70),
    "coral": (0.93, 0.50, 0.43),
    "cheek": (0.93, 0.56, 0.48),
    "white": (0.97, 0.97, 0.95),
    "iris": (0.42, 0.24, 0.10),
    "pupil": (0.03, 0.02, 0.03),
    "nose": (0.36, 0.13, 0.16),
    "mouth": (0.30, 0.10, 0.12),
    "claw": (0.98, 0.92, 0.80),
}


@dataclass(frozen=True)
class Creature:
    """The creature at rest.

    Attributes
    ----------
    vertices : (v, 3) float64
        Metres.
    faces
        Corners of every face, counter-clockwise seen from outside: quads, and triangles at the small parts' poles.
    colours : (v, 3) float64
        Linear RGB.
    occlusion : (v,) float64
        1 where the sky is seen, less in folds.
    bones : names of the bones, in the order of the columns of `weights`.
    weights : (v, b) float64
        Rows sum to 1.
    stiffness, mass, pins : (v,) float64
        Painted values, 0 to 1.
    body : number of vertices of the body; those of the small parts follow.
    """

    vertices: FloatArray
    faces: list[tuple[int, ...]]
    colours: FloatArray
    occlusion: FloatArray
    bones: list[str]
    weights: FloatArray
    stiffness: FloatArray
    mass: FloatArray
    pins: FloatArray
    body: int


def mirrored(name: str) -> str:
    """Name of the same thing on the other side."""
    return name[:-2] + ".R" if name.endswith(".L") else name


def all_bones() -> dict[str, tuple[FloatArray, FloatArray, str | None]]:
    """Head, tail and parent of every bone, both sides; parents come first."""
    bones: dict[str, tuple[FloatArray, FloatArray, str | None]] = {}
    flip = np.array([-1.0, 1.0, 1.0])
    for name, (head, tail, parent) in BONES.items():
        bones[name] = (np.array(head), np.array(tail), parent)
        if name.endswith(".L"):
            bones[mirrored(name)] = (np.array(head) * flip, np.array(tail) * flip, parent and mirrored(parent))
    return bones


def shapes(points: FloatArray) -> dict[str, FloatArray]:
    """Fields of the round shapes around each bone, left side only where there are two: a distance (p,) a bone."""

    def segment(bone: str, start: float, end: float) -> FloatArray:
        head, tail, _ = BONES[bone]
        return tube(points, np.array([head, tail]), np.array([start, end]))

    flat = np.array([1.0, EAR_FLATNESS, 1.0])
    muzzle = ellipsoid(points, (0.0, -0.21, 1.075), (0.135, 0.125, 0.085))
    cheek = ellipsoid(points, (0.125, -0.10, 1.06), (0.135, 0.13, 0.115))
    skull = ellipsoid(points, (0.0, -0.03, 1.17), (0.235, 0.215, 0.205))
    return {
        "hips": smooth_union(
            ellipsoid(points, (0.0, 0.07, 0.42), (0.28, 0.26, 0.20)),
            ellipsoid(points, (0.13, 0.13, 0.38), (0.16, 0.17, 0.15)),
            0.08,
        ),
        "spine": ellipsoid(points, BELLY, (0.36, 0.345, 0.305)),
        "chest": ellipsoid(points, (0.0, 0.02, 0.84), (0.225, 0.185, 0.20)),
        "head": smooth_union(smooth_union(skull, cheek, 0.07), muzzle, 0.05),
        "ear.L": tube(points * flat, EAR * flat, EAR_RADII) / np.sqrt(EAR_FLATNESS),
        "tail": tube(points, TAIL, TAIL_RADII),
        "upper_arm.L": segment("upper_arm.L", 0.085, 0.066),
        "forearm.L": segment("forearm.L", 0.066, 0.058),
        "hand.L": ellipsoid(points, (0.505, -0.07, 0.49), (0.07, 0.075, 0.085)),
        "thigh.L": segment("thigh.L", 0.14, 0.105),
        "shin.L": segment("shin.L", 0.105, 0.095),
        "foot.L": smooth_union(
            ellipsoid(points, (0.205, -0.07, 0.06), (0.105, 0.185, 0.075)),
            ellipsoid(points, (0.195, 0.03, 0.08), (0.095, 0.095, 0.085)),
            0.05,
        ),
    }


#: How wide the fillet is where a bone's shape joins those before it.
FILLETS = {
    "spine": 0.12,
    "chest": 0.12,
    "head": 0.05,
    "tail": 0.10,
    "thigh.L": 0.06,
    "shin.L": 0.05,
    "foot.L": 0.04,
    "upper_arm.L": 0.06,
    "forearm.L": 0.04,
    "hand.L": 0.04,
    "ear.L": 0.04,
}


def body_field(points: FloatArray) -> FloatArray:
    """Field of the whole body (p,); both sides."""
    folded = points * np.array([1.0, 1.0, 1.0])
    folded[:, 0] = np.abs(folded[:, 0])
    parts = shapes(folded)
    field = parts["hips"]
    for bone, width in FILLETS.items():
        field = smooth_union(field, parts[bone], width)
    floor = 0.004 - points[:, 2]
    return np.maximum(field, floor)


def smoothstep(low: float, high: float, values: FloatArray) -> FloatArray:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def linear(name: str) -> FloatArray:
    """A colour of the palette in linear RGB (3,)."""
    srgb = np.array(COLOURS[name])
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def skin_weights(vertices: FloatArray, edges: IntArray, smoothing: int) -> tuple[list[str], FloatArray]:
    """Weights by distance to the shapes around bones, smoothed over the mesh: bones, and (v, b), rows summing to 1."""
    bones = list(all_bones())
    columns = []
    sides = {1: shapes(vertices), -1: shapes(vertices * np.array([-1.0, 1.0, 1.0]))}
    for bone in bones:
        left = bone[:-2] + ".L" if bone.endswith(".R") else bone
        columns.append(sides[-1 if bone.endswith(".R") else 1][left])
    distance = np.column_stack(columns)
    nearness = np.exp(-(distance - distance.min(axis=1, keepdims=True)) / 0.022)
    weights = nearness / nearness.sum(axis=1, keepdims=True)
    for _ in range(smoothing):
        weights = 0.5 * weights + 0.5 * neighbour_mean(weights, edges)
    weights[weights < 0.01] = 0.0
    order = np.argsort(weights, axis=1)[:, :-4]
    np.put_along_axis(weights, order, 0.0, axis=1)
    return bones, weights / weights.sum(axis=1, keepdims=True)


def body_regions(vertices: FloatArray) -> dict[str, FloatArray]:
    """Where things are on the body, for colours and paint: values (v,) by name.

    `ear` and `tail` run from 0 at the root to 1 at the tip and are 0 elsewhere; the others are masks from 0 to 1.
    """
    folded = vertices.copy()
    folded[:, 0] = np.abs(folded[:, 0])
    parts = shapes(folded)
    nearest = {bone: smoothstep(0.03, 0.0, distance) for bone, distance in parts.items()}
    rest = np.minimum(parts["head"], parts["chest"])
    flat = np.array([1.0, EAR_FLATNESS, 1.0])
    ear_place, _ = along(folded * flat, EAR * flat)
    tail_place, _ = along(folded, TAIL)
    z = folded[:, 2]
    trunk = np.maximum(nearest["spine"], nearest["hips"]) * smoothstep(0.96, 0.80, z) * smoothstep(0.16, 0.27, z)
    limb = np.minimum.reduce([parts[b] for b in ("upper_arm.L", "forearm.L", "hand.L", "shin.L", "foot.L")])
    trunk = trunk * smoothstep(0.0, 0.06, limb)
    direction = (folded - np.array([0.0, 0.05, 0.55])) / 0.33
    return {
        "ear": np.where(parts["ear.L"] < rest, ear_place, 0.0) * smoothstep(0.03, 0.0, parts["ear.L"]),
        "tail": np.where(parts["tail"] < np.minimum(parts["hips"], parts["spine"]), tail_place, 0.0)
        * smoothstep(0.03, 0.0, parts["tail"]),
        "trunk": trunk,
        "belly": trunk * smoothstep(0.10, 0.85, -direction[:, 1] - 0.15 * np.abs(direction[:, 2])),
        "rump": trunk * smoothstep(0.25, 0.75, direction[:, 1] - 0.8 * direction[:, 2] - 0.1),
        "sides": trunk * smoothstep(0.55, 0.95, np.abs(direction[:, 0])),
        "cheek": smoothstep(0.11, 0.03, np.linalg.norm(folded - np.array([0.20, -0.185, 1.065]), axis=1)),
        "limb": smoothstep(0.04, 0.0, limb),
    }


def body_colours(vertices: FloatArray, normals: FloatArray, regions: dict[str, FloatArray]) -> FloatArray:
    """Linear RGB of the body's vertices (v, 3)."""
    x, y, z = np.abs(vertices[:, 0]), vertices[:, 1], vertices[:, 2]

    def mix(colours: FloatArray, name: str, share: FloatArray) -> FloatArray:
        return colours + share[:, None] * (linear(name) - colours)

    colours = np.tile(linear("skin"), (len(vertices), 1))
    folded = np.column_stack([x, y, z])
    spots = [
        ((0.10, 0.24, 0.72), 0.075),
        ((0.24, 0.22, 0.60), 0.06),
        ((0.09, 0.20, 0.90), 0.055),
        ((0.20, 0.30, 0.46), 0.07),
    ]
    spots += [((0.12, 0.14, 1.28), 0.06), ((0.20, 0.09, 1.16), 0.045)]
    for centre, radius in spots:
        distance = np.linalg.norm(folded - np.array(centre), axis=1)
        colours = mix(colours, "back", 0.85 * smoothstep(1.15 * radius, 0.75 * radius, distance))
    # The patch is an ellipse seen from the front.
    patch = np.hypot(x / 0.26, (z - 0.535) / 0.27)
    front = smoothstep(-0.02, -0.10, y) * (z < 0.9) * (1 - regions["limb"])
    colours = mix(colours, "belly", smoothstep(1.04, 0.96, patch) * front)
    muzzle = np.hypot(x / 0.145, (z - 1.06) / 0.085)
    colours = mix(colours, "belly", smoothstep(1.05, 0.92, muzzle) * smoothstep(-0.19, -0.23, y) * (z > 0.95))
    colours = mix(colours, "cheek", 0.75 * smoothstep(0.062, 0.035, np.hypot(x - 0.205, z - 1.065)) * (y < -0.05))
    flat = np.array([1.0, EAR_FLATNESS, 1.0])
    place, distance = along(folded * flat, EAR * flat)
    wide = np.linalg.norm((folded - centre_of(EAR, place)) * np.array([1.0, 0.0, 1.0]), axis=1)
    radius = np.interp(place, np.linspace(0, 1, len(EAR_RADII)), EAR_RADII)
    inner = (
        smoothstep(0.85, 0.55, wide / radius) * smoothstep(0.0, 0.35, -normals[:, 1]) * smoothstep(0.14, 0.28, place)
    )
    colours = mix(colours, "coral", inner * smoothstep(0.95, 0.86, place) * (regions["ear"] > 0))
    colours = mix(colours, "back", smoothstep(0.80, 0.86, regions["ear"]) * (1 - inner))
    colours = mix(colours, "belly", smoothstep(0.76, 0.80, regions["tail"]))
    for band in (0.42, 0.58):
        colours = mix(colours, "back", smoothstep(0.035, 0.02, np.abs(regions["tail"] - band)))
    return colours


def centre_of(path: FloatArray, place: FloatArray) -> FloatArray:
    """Points (p, 3) of a polyline at places from 0 to 1 (p,)."""
    at = np.linspace(0.0, 1.0, len(path))
    return np.column_stack([np.interp(place, at, column) for column in path.T])


def paint(
    vertices: FloatArray, faces: list[tuple[int, ...]], weights: FloatArray, regions: dict[str, FloatArray], body: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Stiffness, mass and pins, (v,) each: what Add Followthrough suggests, and what an artist makes of it.

    Face, hands, feet and the small parts are pinned, and the tail's tip is heavy.
    """
    bones = all_bones()
    surface = Surface(
        rest_positions=vertices,
        triangles=np.array([(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)], dtype=np.int32),
        rig=Rig(
            bone_indices=np.tile(np.arange(len(bones), dtype=np.int32), (len(vertices), 1)),
            bone_weights=weights,
            bone_segments=np.array([[head, tail] for head, tail, _ in bones.values()]),
        ),
    )
    suggested = suggest_paint(surface)
    soft = np.maximum.reduce(
        [smoothstep(0.0, 0.2, regions[name]) for name in ("ear", "tail", "belly", "rump", "sides", "cheek")]
    )
    mass, pins = suggested.mass.copy(), suggested.pins.copy()
    pins[:body] = np.maximum(pins[:body], 1.0 - soft)
    pins[body:] = 1.0
    mass[:body] += 0.1 * smoothstep(0.7, 1.0, regions["tail"])
    return suggested.stiffness, mass, pins


def small_parts(detail: float) -> list[tuple[FloatArray, list[tuple[int, ...]], FloatArray, str]]:
    """Eyes, lids, nose, mouth, tooth and claws: vertices, faces, colours and the bone that carries each."""

    def rings(count: int) -> FloatArray:
        return np.linspace(0.0, np.pi, max(int(count * detail), 5) + 1)[1:-1]

    segments = max(int(20 * detail), 10)
    flip = np.array([-1.0, 1.0, 1.0])
    parts = []

    def plain(vertices: FloatArray, colour: str) -> FloatArray:
        return np.tile(linear(colour), (len(vertices), 1))

    def blob(centre: FloatArray, radii: tuple[float, float, float], colour: str, bone: str, pole: FloatArray) -> None:
        vertices, faces, _ = ball(centre, np.array(radii), rings(9), max(int(14 * detail), 8), pole)
        parts.append((vertices, faces, plain(vertices, colour), bone))

    for side in (1.0, -1.0):
        mirror = np.where(flip < 0, side, 1.0)
        suffix = ".L" if side > 0 else ".R"
        gaze = GAZE * mirror / np.linalg.norm(GAZE)
        iris = np.array([0.0, 0.30, 0.31, 0.54, 0.56])
        angles = np.concatenate([[0.16], iris[1:], np.linspace(0.7, np.pi, max(int(10 * detail), 5))[:-1]])
        vertices, faces, angle = ball(EYE * mirror, np.full(3, EYE_RADIUS), angles, segments, gaze)
        colours = plain(vertices, "white")
        colours[angle < 0.55] = linear("iris")
        colours[angle < 0.305] = linear("pupil")
        parts.append((vertices, faces, colours, "head"))
        glint = EYE * mirror + EYE_RADIUS * 0.93 * unit(gaze + np.array([0.17, 0.0, 0.22]))
        blob(glint, (0.0125, 0.0125, 0.0125), "white", "head", gaze)
        lid = EYE * mirror + np.array([0.0, 0.016, 0.020])
        blob(lid, (0.074, 0.072, 0.066), "skin", "head", np.array([0.0, 0.0, 1.0]))
        for toe in (-0.055, 0.0, 0.055):
            centre = np.array([0.208 + toe, -0.235 + 0.35 * abs(toe), 0.048]) * mirror
            blob(centre, (0.024, 0.034, 0.026), "claw", "foot" + suffix, np.array([0.0, -1.0, 0.2]))

    blob(np.array([0.0, -0.328, 1.112]), (0.040, 0.026, 0.026), "nose", "head", np.array([0.0, -1.0, 0.0]))
    across = np.linspace(-1.0, 1.0, max(int(24 * detail), 10))
    smile = np.column_stack([0.092 * across, np.full(len(across), -0.5), 1.030 + 0.030 * across**2])
    smile = onto(body_field, smile, np.array([0.0, 1.0, 0.0]))
    vertices, faces = pipe(smile, 0.0068 * np.sqrt(np.maximum(1.12 - across**2, 0.02)), 8)
    parts.append((vertices, faces, plain(vertices, "mouth"), "head"))
    tooth = smile[len(smile) // 2] + np.array([0.026, 0.004, -0.010])
    blob(tooth, (0.015, 0.009, 0.017), "white", "head", np.array([0.0, 0.0, 1.0]))
    return parts


def unit(vector: FloatArray) -> FloatArray:
    """A vector at length 1."""
    return np.asarray(vector / np.linalg.norm(vector))


def onto(field: Field, points: FloatArray, direction: FloatArray) -> FloatArray:
    """Move points (p, 3) along a direction until they meet the surface."""
    for _ in range(60):
        points = points + np.maximum(field(points), 0.0)[:, None] * 0.7 * direction
    return points


def make_creature(vertices: int = 9000) -> Creature:
    """Make the creature with about this many vertices (2,000 or more; within a tenth).

    The same number gives the same arrays.
    """
    if vertices < 2000:
        raise ValueError(f"vertices: found {vertices}, expected 2000 or more (ears and toes need that many)")
    detail = float(np.clip(np.sqrt(vertices / 9000.0), 0.5, 2.0))
    parts = small_parts(detail)
    wanted = vertices - sum(len(part[0]) for part in parts)
    cell = np.sqrt(BODY_AREA / wanted)
    low, high = np.array([0.0, -0.45, 0.0]), np.array([0.72, 0.86, 1.84])
    body, quads = polygonise(body_field, low, high, cell)
    while not is_closed(quads):  # two sheets of skin met in one cell of the grid: another grid parts them
        cell *= 1.003
        body, quads = polygonise(body_field, low, high, cell)
    edges = edges_of(quads)
    slope = gradient(body_field, body)
    normals = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9)
    bones, weights = skin_weights(body, edges, smoothing=round(0.06 / cell) ** 2)
    regions = body_regions(body)
    colours = body_colours(body, normals, regions)
    occlusion = np.ones(len(body))
    for reach in (0.03, 0.06, 0.12):
        occlusion -= 0.33 * np.clip(1.0 - body_field(body + reach * normals) / reach, 0.0, 1.0)

    faces = [tuple(int(i) for i in quad) for quad in quads]
    everything = [body]
    for points, part_faces, part_colours, bone in parts:
        start = sum(len(array) for array in everything)
        faces += [tuple(start + i for i in face) for face in part_faces]
        everything.append(points)
        colours = np.vstack([colours, part_colours])
        row = np.zeros(len(bones))
        row[bones.index(bone)] = 1.0
        weights = np.vstack([weights, np.tile(row, (len(points), 1))])
        occlusion = np.concatenate([occlusion, np.ones(len(points))])
    points = np.concatenate(everything)
    stiffness, mass, pins = paint(points, faces, weights, regions, len(body))
    return Creature(
        vertices=points,
        faces=faces,
        colours=colours,
        occlusion=np.clip(occlusion, 0.0, 1.0),
        bones=bones,
        weights=weights,
        stiffness=stiffness,
        mass=mass,
        pins=pins,
        body=len(body),
    )


#: Vertices of the body at a cell size of 1 m; square metres, nearly.
BODY_AREA = 6.0
