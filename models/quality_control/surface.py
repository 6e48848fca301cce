"""The part's top face as maps: edge distance, slope, reflectance, machining direction.

Maps are float32 arrays [rows, columns] over a rectangle a little larger than
the part, `texels` per millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont

import part
from noise import smooth_noise
from scene import Dent, Scene, Scratch

MARGIN = 3.0  # mm: the maps extend this far beyond the part
SCRATCH_TEXELS = 10.0  # texels per mm with which scratches are drawn; they are then resized to the map


@dataclass(frozen=True)
class Surface:
    """The maps of one part, all of the same shape [rows, columns]."""

    texels: float
    edge_distance: np.ndarray  # mm to the nearest edge of the top face, negative on the metal
    slope_x: np.ndarray  # change of height per mm, along x
    slope_y: np.ndarray
    albedo: np.ndarray  # relative reflectance, 1.0 = clean metal
    along_x: np.ndarray  # direction of the machining marks, a unit vector
    along_y: np.ndarray
    rough: np.ndarray  # 0 machined .. 1 matt


def grid(texels: float) -> tuple[np.ndarray, np.ndarray]:
    """Position of every texel on the part in mm, from the part's middle: x [1, columns], y [rows, 1]."""
    half_x, half_y = part.LENGTH / 2 + MARGIN, part.WIDTH / 2 + MARGIN
    columns, rows = round(2 * half_x * texels), round(2 * half_y * texels)
    x = ((np.arange(columns) + 0.5) / texels - half_x).astype(np.float32)
    y = ((np.arange(rows) + 0.5) / texels - half_y).astype(np.float32)
    return x[None, :], y[:, None]


def build(scene: Scene, texels: float, rng: np.random.Generator) -> Surface:
    """The maps of the scene's part."""
    x, y = grid(texels)
    edge_distance = part.distance(x, y, scene.missing_hole).astype(np.float32)
    for dent in scene.dents:
        if dent.is_at_edge:
            edge_distance = _smooth_maximum(edge_distance, _notch(dent, x, y), 1.2)
    height = _shape(x, y, edge_distance, scene.missing_hole)
    marks, along_x, along_y = _marks(scene, x, y, edge_distance.shape, texels, rng)
    rough = np.zeros_like(edge_distance)
    albedo = 1.0 + 0.05 * smooth_noise(rng, edge_distance.shape, 18 * texels) + 0.9 * marks
    for dent in scene.dents:
        hollow, inside = _hollow(dent, x, y)
        height += hollow
        marks *= 1 - 0.5 * inside
        rough = np.maximum(rough, 0.35 * inside)
        albedo -= 0.08 * inside
    height += marks * 0.35 / texels * 2
    for scratch in scene.scratches:
        groove = _groove(scratch, edge_distance.shape)
        groove[edge_distance > -0.3] = 0
        height -= 0.17 * scratch.depth * groove
        albedo *= 1 + scratch.bright * scratch.depth * groove
    ink = _engraving(edge_distance.shape, texels, rng)
    ink[edge_distance > -2] = 0
    albedo *= 1 - 0.5 * ink
    albedo *= 1 - 0.12 * np.clip(smooth_noise(rng, edge_distance.shape, 30 * texels) - 0.3, 0, 1)
    slope_y, slope_x = np.gradient(height, 1 / texels)
    return Surface(texels, edge_distance, slope_x, slope_y, albedo, along_x, along_y, rough)


def _smooth_maximum(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """The larger of two distances; where they differ by less than `width`, the transition is smooth."""
    h = np.clip(0.5 + 0.5 * (a - b) / width, 0, 1)
    return b + (a - b) * h + width * h * (1 - h)


def _step(distance: np.ndarray, width: float) -> np.ndarray:
    """0 where the distance is positive, 1 where it is below -width, and a smooth transition between."""
    t = np.clip(-distance / width, 0, 1)
    return t * t * (3 - 2 * t)


def _shape(x: np.ndarray, y: np.ndarray, edge_distance: np.ndarray, missing_hole: str | None) -> np.ndarray:
    """Height of the intended shape in mm: chamfers, countersinks, recess."""
    height = -np.clip(part.CHAMFER + edge_distance, 0, part.CHAMFER)
    for hole in part.HOLES:
        if hole.name == missing_hole:
            continue
        height = np.minimum(height, -np.clip(hole.sink - hole.distance(x, y), 0, hole.sink))
        if hole.name == "bore":
            ring = np.hypot(x - hole.x, y - hole.y) - part.RECESS
            height -= part.RECESS_DEPTH * _step(ring, 0.7)
    return height.astype(np.float32)


def _marks(
    scene: Scene, x: np.ndarray, y: np.ndarray, shape: tuple[int, int], texels: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Machining marks (about -0.1..0.1) and their direction."""
    along_x, along_y = np.ones(shape, np.float32), np.zeros(shape, np.float32)
    fine = smooth_noise(rng, shape, 0.35 * texels)
    if scene.surface == "brushed":
        marks = 0.7 * smooth_noise(rng, shape, 0.3 * texels, 35 * texels)
        marks += 0.5 * smooth_noise(rng, shape, 0.8 * texels, 60 * texels)
    elif scene.surface == "milled":
        marks, along_x, along_y = _milling(rng, x, y, shape)
        marks += 0.2 * fine
    else:
        marks = 0.8 * fine + 0.3 * smooth_noise(rng, shape, 0.9 * texels)
    marks *= 0.085 * scene.grain
    if scene.missing_hole != "bore":
        bore = next(hole for hole in part.HOLES if hole.name == "bore")
        radius = np.hypot(x - bore.x, y - bore.y) + 1e-3
        turned = radius < part.RECESS
        rings = 0.05 * np.sin(radius * (2 * np.pi / 0.9)) + 0.03 * np.sin(radius * 4.1 + 1)
        marks = np.where(turned, rings * scene.grain, marks)
        along_x = np.where(turned, -(y - bore.y) / radius, along_x)
        along_y = np.where(turned, (x - bore.x) / radius, along_y)
    return marks.astype(np.float32), along_x.astype(np.float32), along_y.astype(np.float32)


def _milling(
    rng: np.random.Generator, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The arcs that a face mill leaves, in one to three passes along x."""
    passes = int(rng.integers(1, 4))
    pitch = part.WIDTH / passes
    radius = pitch * rng.uniform(0.62, 0.9)
    feed = rng.uniform(0.9, 1.7)
    row = np.clip(np.floor((y + part.WIDTH / 2) / pitch), 0, passes - 1)
    offset = (y + part.WIDTH / 2 - (row + 0.5) * pitch) / radius
    bow = np.sqrt(np.clip(1 - offset**2, 0.05, 1))
    phase = (x + radius * bow * np.where(row % 2 == 0, 1, -1)) / feed
    wear = 1 + 0.5 * np.interp(np.arange(shape[1]), np.linspace(0, shape[1], 24), rng.normal(0, 1, 24))[None, :]
    arcs = (0.5 * np.sin(2 * np.pi * phase) + 0.35 * np.sin(2 * np.pi * phase / 3.3 + row)) * wear
    along_x = np.broadcast_to(offset * np.where(row % 2 == 0, 1, -1), shape)
    along_y = np.broadcast_to(bow, shape)
    length = np.hypot(along_x, along_y)
    return arcs.astype(np.float32), along_x / length, along_y / length


def _hollow(dent: Dent, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height of a dent in mm, including its raised rim, and a mask: 1 in the middle of the dent, 0 outside."""
    c, s = np.cos(dent.angle), np.sin(dent.angle)
    dx, dy = x - dent.x, y - dent.y
    r = np.hypot((c * dx + s * dy) / dent.stretch, -s * dx + c * dy) / dent.radius
    bowl = np.exp(-(r**3) * 1.6)
    rim = 0.14 * np.exp(-(((r - 1.22) / 0.2) ** 2))
    return (dent.depth * (rim - bowl)).astype(np.float32), bowl.astype(np.float32)


def _notch(dent: Dent, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance from the edge of the notch that the impact left in the outline: positive where the metal is gone."""
    outward = np.array([dent.x / part.LENGTH, dent.y / part.WIDTH])
    axis = np.where(np.abs(outward) == np.abs(outward).max(), np.sign(outward), 0)
    reach = 0.35 * dent.radius
    cx, cy = np.array([dent.x, dent.y]) + axis * (dent.radius - reach)
    return dent.radius - np.hypot(x - cx, y - cy)


def _groove(scratch: Scratch, shape: tuple[int, int]) -> np.ndarray:
    """A mask that is 1 in a scratch and 0 outside. The scratch tapers towards its ends, and its pressure varies."""
    x, y = grid(SCRATCH_TEXELS)
    canvas = Image.new("L", (x.size, y.size))
    pen = ImageDraw.Draw(canvas)
    points = (scratch.points - [x[0, 0], y[0, 0]]) * SCRATCH_TEXELS
    count = len(points) - 1
    for i in range(count):
        taper = min(1.0, 6 * min(i + 1, count - i) / count)
        press = 0.8 + 0.2 * np.sin(i * 0.4 + points[0, 0])
        pen.line(
            [tuple(points[i]), tuple(points[i + 1])],
            fill=round(255 * taper * press),
            width=max(2, round(scratch.width * SCRATCH_TEXELS * (0.5 + 0.5 * taper))),
        )
    canvas = canvas.filter(ImageFilter.GaussianBlur(0.8)).resize(shape[::-1], Image.BOX)
    return np.asarray(canvas, np.float32) / 255


def _engraving(shape: tuple[int, int], texels: float, rng: np.random.Generator) -> np.ndarray:
    """A mask that is 1 in a laser-marked data matrix and in a serial number, and 0 outside."""
    x, y = grid(texels)
    canvas = Image.new("L", shape[::-1])
    cells = (rng.random((12, 12)) < 0.5).astype(np.uint8) * 255
    cells[:, 0] = cells[-1, :] = 255  # finder pattern of a data matrix: its left and bottom edges are solid
    side = round(8 * texels)
    code = Image.fromarray(cells).resize((side, side), Image.NEAREST)
    left, top = round((14 - x[0, 0]) * texels), round((25 - y[0, 0]) * texels)
    canvas.paste(code, (left, top))
    text = Image.new("L", (66, 11))
    ImageDraw.Draw(text).text((0, 0), f"PN4-{rng.integers(100000, 999999)}", 255, ImageFont.load_default())
    text = text.resize((round(24 * texels), round(4 * texels)), Image.BILINEAR)
    canvas.paste(text, (round((-14 - x[0, 0]) * texels), round((27 - y[0, 0]) * texels)))
    return np.asarray(canvas, np.float32) / 255
