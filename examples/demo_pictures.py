# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures without a GPU: a small renderer in NumPy, contact sheets and videos.

Blender's own renderers need a graphics card or many seconds a frame; this one draws the demo's 18,000 triangles in a
fraction of a second on one core, with soft shadows from one light, and the same on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Image = NDArray[np.uint8]

SKY_TOP = np.array([0.60, 0.71, 0.80])
SKY_LOW = np.array([0.93, 0.91, 0.86])
FLOOR = np.array([0.80, 0.77, 0.71])
KEY = np.array([1.00, 0.93, 0.82]) * 1.12
SKY_LIGHT = np.array([0.52, 0.60, 0.70])
BOUNCE = np.array([0.36, 0.30, 0.24])
TO_LIGHT = np.array([0.50, -0.62, 0.86]) / np.linalg.norm([0.50, -0.62, 0.86])


@dataclass(frozen=True)
class Camera:
    """A perspective camera.

    Parameters
    ----------
    position, target
        Where it is and what is in the middle of the picture; (3,), metres.
    half_height
        Half of what it sees at the target's distance, top to bottom, metres.
    width, height
        Pixels.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    half_height: float
    width: int
    height: int

    def axes(self) -> FloatArray:
        """Right, up and forward, as rows."""
        forward = np.array(self.target) - self.position
        forward /= np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    def focal(self) -> float:
        """Pixels a unit of slope."""
        distance = float(np.linalg.norm(np.array(self.target) - self.position))
        return 0.5 * self.height * distance / self.half_height

    def project(self, points: FloatArray) -> FloatArray:
        """Pixel coordinates and depth of points: (p, 3)."""
        local = (points - np.array(self.position)) @ self.axes().T
        scale = self.focal() / local[:, 2]
        return np.column_stack(
            [0.5 * self.width + local[:, 0] * scale, 0.5 * self.height - local[:, 1] * scale, local[:, 2]]
        )

    def rays(self) -> FloatArray:
        """Directions through the pixels' centres (height * width, 3), of length 1."""
        right, up, forward = self.axes()
        x = (np.arange(self.width) + 0.5 - 0.5 * self.width) / self.focal()
        y = (0.5 * self.height - np.arange(self.height) - 0.5) / self.focal()
        rays = forward + y[:, None, None] * up + x[None, :, None] * right
        rays = rays.reshape(-1, 3)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


@dataclass(frozen=True)
class Scenery:
    """What stays the same from picture to picture.

    Parameters
    ----------
    triangles : (t, 3) int64, counter-clockwise seen from outside
    colours : (v, 3) float64, linear RGB
    occlusion : (v,) float64, 1 where the sky is seen
    """

    triangles: IntArray
    colours: FloatArray
    occlusion: FloatArray


_scenery: Scenery | None = None


def save_scenery(path: Path, scenery: Scenery) -> None:
    """Write down what all pictures share, for `load_scenery`."""
    np.savez(path, triangles=scenery.triangles, colours=scenery.colours, occlusion=scenery.occlusion)


def load_scenery(path: Path) -> None:
    """Give a drawing process what all of its pictures share."""
    global _scenery
    with np.load(path) as arrays:
        _scenery = Scenery(arrays["triangles"], arrays["colours"], arrays["occlusion"])


def draw_job(job: tuple[FloatArray, Camera, int]) -> Image:
    """Draw one picture in a process that has its scenery: positions, camera, samples."""
    assert _scenery is not None
    return render(job[0].astype(np.float64), _scenery, job[1], job[2])


def rasterise(
    screen: FloatArray, triangles: IntArray, width: int, height: int
) -> tuple[IntArray, IntArray, FloatArray]:
    """Nearest triangle in every pixel that any covers.

    Parameters
    ----------
    screen : (v, 3) float64
        Pixel coordinates and depth of the vertices, all in front of the camera.
    triangles : (t, 3) int64

    Returns
    -------
    pixels (p,), the triangle in each (p,) and its barycentric weights (p, 3), linear on the screen.
    """
    corners = screen[triangles]
    low = np.clip(np.ceil(corners[:, :, :2].min(axis=1) - 0.5), 0, [width, height]).astype(np.int64)
    high = np.clip(np.ceil(corners[:, :, :2].max(axis=1) - 0.5), 0, [width, height]).astype(np.int64)
    size = np.maximum(high - low, 0)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    count = np.where(np.abs(area) > 1e-12, size[:, 0] * size[:, 1], 0)
    triangle = np.repeat(np.arange(len(triangles)), count)
    place = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    columns = size[triangle, 0]
    x = low[triangle, 0] + place % columns
    y = low[triangle, 1] + place // columns

    # Barycentric weights are linear on the screen: three planes a triangle.
    centre_x, centre_y = x + 0.5, y + 0.5
    weights = np.empty((len(triangle), 3))
    for k in range(3):
        p, q = corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]
        slope_x = (p[:, 1] - q[:, 1]) / np.where(count > 0, area, 1.0)
        slope_y = (q[:, 0] - p[:, 0]) / np.where(count > 0, area, 1.0)
        offset = -slope_x * p[:, 0] - slope_y * p[:, 1]
        weights[:, k] = slope_x[triangle] * centre_x + slope_y[triangle] * centre_y + offset[triangle]
    covered = (weights >= 0).all(axis=1)
    triangle, weights = triangle[covered], weights[covered]
    pixel = (y * width + x)[covered]
    depth = np.einsum("ij,ij->i", weights, screen[triangles, 2][triangle])

    # Nearest first within a pixel: depth and number packed in one integer.
    nearest = np.full(width * height, np.iinfo(np.int64).max)
    span = max(float(np.ptp(depth)), 1e-9) if len(depth) else 1.0
    key = ((depth - depth.min(initial=np.inf)) / span * (2**30)).astype(np.int64) << 32 | np.arange(len(depth))
    np.minimum.at(nearest, pixel, key)
    drawn = np.flatnonzero(nearest != np.iinfo(np.int64).max)
    chosen = nearest[drawn] & 0xFFFFFFFF
    return drawn, triangle[chosen], weights[chosen]


def vertex_normals(positions: FloatArray, triangles: IntArray) -> FloatArray:
    """Unit normals of the vertices (v, 3), weighted by the areas of the triangles."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    facing = np.cross(b - a, c - a)
    total = np.column_stack(
        [np.bincount(triangles.ravel(), weights=np.repeat(facing[:, k], 3), minlength=len(positions)) for k in range(3)]
    )
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-20))


class ShadowMap:
    """Depth seen from the light, and how much of it reaches a point."""

    def __init__(self, positions: FloatArray, triangles: IntArray, size: int = 384, span: float = 3.4) -> None:
        side = np.cross([0.0, 0.0, 1.0], TO_LIGHT)
        side /= np.linalg.norm(side)
        self.axes = np.array([side, np.cross(TO_LIGHT, side), -TO_LIGHT])
        self.size, self.scale, self.centre = size, size / span, np.array([0.0, 0.0, 0.7])
        screen = self._screen(positions)
        pixels, drawn, weights = rasterise(screen, triangles, size, size)
        depth = np.full(size * size, 1e3)
        depth[pixels] = np.einsum("ij,ij->i", weights, screen[triangles[drawn], 2])
        self.depth = depth.reshape(size, size)

    def _screen(self, points: FloatArray) -> FloatArray:
        local = (points - self.centre) @ self.axes.T
        return np.column_stack([local[:, :2] * self.scale + 0.5 * self.size, local[:, 2]])

    def light(self, points: FloatArray, bias: float, spread: float) -> FloatArray:
        """Share of the light that reaches points (p,): the mean over a disc of `spread` metres."""
        screen = self._screen(points)
        lit = np.zeros(len(points))
        turn = np.arange(13) * 2.399963
        radius = np.sqrt((np.arange(13) + 0.5) / 13) * spread * self.scale
        for dx, dy in zip(radius * np.cos(turn), radius * np.sin(turn), strict=True):
            column = np.clip(screen[:, 0] + dx, 0, self.size - 1).astype(np.int64)
            row = np.clip(screen[:, 1] + dy, 0, self.size - 1).astype(np.int64)
            lit += self.depth[row, column] > screen[:, 2] - bias
        return lit / 13


def render(positions: FloatArray, scenery: Scenery, camera: Camera, samples: int = 2) -> Image:
    """Draw a creature that stands on the floor z = 0.

    Parameters
    ----------
    positions : (v, 3) float64, in the world, metres
    scenery, camera
    samples : pixels of the drawing along each side of a pixel of the picture

    Returns
    -------
    (height, width, 3) uint8, sRGB.
    """
    fine = Camera(camera.position, camera.target, camera.half_height, camera.width * samples, camera.height * samples)
    eye = np.array(fine.position)
    triangles = scenery.triangles
    shadow = ShadowMap(positions, triangles)
    stage = _backdrop(camera, shadow).reshape(camera.height, 1, camera.width, 1, 3)
    shape = (camera.height, samples, camera.width, samples, 3)
    picture = np.broadcast_to(stage, shape).reshape(-1, 3).copy()

    normals = vertex_normals(positions, triangles)
    screen = fine.project(positions)
    a, b, c = (screen[triangles[:, k]] for k in range(3))
    front = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) < (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    facing = triangles[front]
    pixels, drawn, weights = rasterise(screen, facing, fine.width, fine.height)
    corners = facing[drawn]
    weights = weights / screen[corners, 2]
    weights /= weights.sum(axis=1, keepdims=True)

    def at_pixels(values: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("ij,ijk->ik", weights, values[corners]))

    point, normal = at_pixels(positions), at_pixels(normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
    surface = at_pixels(np.column_stack([scenery.colours, scenery.occlusion]))
    albedo, open_sky = surface[:, :3], surface[:, 3:]
    to_eye = eye - point
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)

    facing_light = normal @ TO_LIGHT
    wrapped = np.clip((facing_light + 0.25) / 1.25, 0.0, 1.0)
    lit = shadow.light(point + 0.012 * normal, bias=0.022, spread=0.022)
    key = (wrapped * (0.12 + 0.88 * lit))[:, None]
    up = (0.5 + 0.5 * normal[:, 2])[:, None]
    near_floor = np.clip(point[:, 2:] / 0.25, 0.35, 1.0)
    ambient = open_sky * (up * SKY_LIGHT + (1.0 - up) * BOUNCE * near_floor)
    half = to_eye + TO_LIGHT
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    gloss = 0.10 * np.clip(np.einsum("ij,ij->i", normal, half), 0, 1) ** 24 * lit
    grazing = 1.0 - np.clip(np.einsum("ij,ij->i", normal, to_eye), 0.0, 1.0)
    rim = 0.16 * grazing**3 * (0.4 + 0.6 * up[:, 0])
    picture[pixels] = albedo * (key * KEY + ambient) + gloss[:, None] * KEY + rim[:, None] * SKY_LIGHT

    picture = picture.reshape(shape).mean(axis=(1, 3))
    return _to_srgb(picture)


def _backdrop(camera: Camera, shadow: ShadowMap) -> FloatArray:
    """Floor with the creature's shadow, fading into the sky: (pixels, 3), linear."""
    picture, near, points, floor, fade = _empty_stage(camera)
    picture = picture.copy()
    shaded = floor * (0.45 + 0.55 * shadow.light(points, bias=0.0, spread=0.06))[:, None]
    picture[near] = shaded + (SKY_LOW - shaded) * fade
    return picture


@lru_cache(maxsize=4)
def _empty_stage(camera: Camera) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray]:
    """The picture without anybody (pixels, 3); where a shadow may reach the floor: pixels, points, colour, fading."""
    rays = camera.rays()
    eye = np.array(camera.position)
    picture = SKY_LOW + (SKY_TOP - SKY_LOW) * np.clip(rays[:, 2:] * 2.2, 0.0, 1.0)
    down = np.flatnonzero(rays[:, 2] < -1e-3)
    points = eye - (eye[2] / rays[down, 2])[:, None] * rays[down]
    from_middle = np.hypot(points[:, 0], points[:, 1])
    floor = FLOOR * (0.55 * KEY + 0.62 * SKY_LIGHT)
    fade = np.clip((from_middle - 1.0) / 4.0, 0.0, 1.0)[:, None]
    fade = fade * fade * (3.0 - 2.0 * fade)
    picture[down] = floor + (SKY_LOW - floor) * fade
    near = from_middle < 2.2
    return picture, down[near], points[near], floor, fade[near]


def _to_srgb(picture: FloatArray) -> Image:
    soft = np.where(picture > 0.7, 0.7 + 0.3 * np.tanh((picture - 0.7) / 0.3), picture)
    srgb = np.where(soft <= 0.0031308, 12.92 * soft, 1.055 * np.maximum(soft, 1e-6) ** (1 / 2.4) - 0.055)
    return np.clip(np.round(srgb * 255.0), 0, 255).astype(np.uint8)


def contact_sheet(rows: list[tuple[str, list[Image]]], captions: list[str], path: Path) -> None:
    """Write pictures in rows under captions, each row with its title at the left."""
    from PIL import Image as Pictures
    from PIL import ImageDraw, ImageFont

    height, width = rows[0][1][0].shape[:2]
    margin, gap, header = 46, 4, 34
    sheet = Pictures.new(
        "RGB",
        (margin + len(captions) * (width + gap), header + len(rows) * (height + gap)),
        (250, 248, 244),
    )
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=17)
    for column, caption in enumerate(captions):
        centre = margin + column * (width + gap) + width // 2
        draw.text((centre, header // 2), caption, fill=(60, 58, 66), font=font, anchor="mm")
    for row, (title, pictures) in enumerate(rows):
        top = header + row * (height + gap)
        label = Pictures.new("RGB", (height, margin), (250, 248, 244))
        ImageDraw.Draw(label).text((height // 2, margin // 2), title, fill=(60, 58, 66), font=font, anchor="mm")
        sheet.paste(label.rotate(90, expand=True), (0, top))
        for column, picture in enumerate(pictures):
            sheet.paste(Pictures.fromarray(picture), (margin + column * (width + gap), top))
    sheet.save(path)


def labelled(picture: Image, text: str) -> Image:
    """A picture with a text at its foot."""
    from PIL import Image as Pictures
    from PIL import ImageDraw, ImageFont

    canvas = Pictures.fromarray(picture)
    font = ImageFont.load_default(size=18)
    ImageDraw.Draw(canvas).text(
        (canvas.width // 2, canvas.height - 16), text, fill=(70, 66, 72), font=font, anchor="mm"
    )
    return np.asarray(canvas)


def write_video(frames: list[Image], fps: float, path: Path) -> None:
    """Write an H.264 video that every browser plays."""
    import imageio.v2 as imageio

    with imageio.get_writer(
        path, format="FFMPEG", fps=fps, codec="libx264", quality=8, macro_block_size=2, pixelformat="yuv420p"
    ) as writer:
        for frame in frames:
            writer.append_data(frame)
