"""Paints what lies on the belt and is no part: shavings, loose screws, nuts and washers; and the dust on everything."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFilter

from metal import lamp_direction
from scene import Scene
from view import View

SUBPIXELS = 3  # sub-pixels per pixel, along each axis, with which shavings are drawn


def scatter(canvas: np.ndarray, scene: Scene, view: View, rng: np.random.Generator) -> None:
    """Paints shavings and loose fasteners onto the belt."""
    for _ in range(scene.shavings):
        x, y = rng.uniform(-115, 115), rng.uniform(-85, 85)
        bright, coverage = _shaving(view.scale, rng)
        colour = rng.uniform(0.25, 0.7) * np.array([1.0, 0.98, 0.94], np.float32)
        _place(canvas, scene, view, x, y, bright, coverage, colour, height=0.8)
    for x, y, angle, kind in scene.fasteners:
        bright, coverage = _fastener(kind, angle, view.scale, scene)
        _place(canvas, scene, view, x, y, bright, coverage, np.array([0.6, 0.6, 0.58], np.float32), height=3.0)


def dust(canvas: np.ndarray, scene: Scene, view: View, rng: np.random.Generator) -> None:
    """Paints specks onto everything, brighter or darker than the surface below them."""
    for _ in range(scene.dust):
        x, y = rng.integers(0, view.width), rng.integers(0, view.height)
        radius = min(rng.exponential(0.12), 0.4) * view.scale
        strength = rng.uniform(-0.25, 0.35) * min(1.0, 2 * radius)
        n = int(np.ceil(2 * radius)) + 1
        spot = canvas[y : y + n, x : x + n]
        rows, columns = np.mgrid[: spot.shape[0], : spot.shape[1]]
        away = np.hypot(rows - (n - 1) / 2, columns - (n - 1) / 2)
        spot *= 1 + strength * np.clip(radius + 0.5 - away, 0, 1)[..., None].astype(np.float32)


def _place(
    canvas: np.ndarray,
    scene: Scene,
    view: View,
    x: float,
    y: float,
    bright: np.ndarray,
    coverage: np.ndarray,
    colour: np.ndarray,
    height: float,
) -> None:
    """Blends the shadow of a small object onto the belt at (x, y) mm, and then the object.

    `bright` and `coverage` are the brightness of the object and the share of each pixel that it covers; both [n, n].
    """
    lamp = lamp_direction(scene.light)
    offset = -lamp[:2] / lamp[2] * height * view.scale * 0.5
    px, py = view.pixel(x, y)
    n = coverage.shape[0]
    soft = Image.fromarray((coverage * 255).astype(np.uint8)).filter(
        ImageFilter.GaussianBlur(0.35 * height * view.scale * 0.5)
    )
    for dx, dy, is_shadow in ((*offset, True), (0.0, 0.0, False)):
        left, top = round(px + dx - n / 2), round(py + dy - n / 2)
        x0, y0, x1, y1 = max(0, left), max(0, top), min(view.width, left + n), min(view.height, top + n)
        if x1 <= x0 or y1 <= y0:
            continue
        inner = (slice(y0 - top, y1 - top), slice(x0 - left, x1 - left))
        target = canvas[y0:y1, x0:x1]
        if is_shadow:
            target *= 1 - 0.6 * (np.asarray(soft, np.float32)[inner] / 255)[..., None]
        else:
            target += (bright[inner][..., None] * colour - target) * coverage[inner][..., None]


def _shaving(scale: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A curled shaving: its brightness, and the share of each pixel that it covers; both [n, n]."""
    size = rng.uniform(1.5, 7.0)  # mm
    n = max(6, round(2.4 * size * scale))
    turns = rng.uniform(0.25, 2.4)
    t = np.linspace(0, 1, 60)
    angle = rng.uniform(0, 2 * np.pi) + turns * 2 * np.pi * t
    drift = rng.uniform(-0.5, 0.5, 2)
    reach = 0.42 * n * SUBPIXELS * (0.35 + 0.65 * t * rng.uniform(0.3, 1.0))
    px = n * SUBPIXELS / 2 + np.cos(angle) * reach * 0.6 + (t - 0.5) * drift[0] * n * SUBPIXELS
    py = n * SUBPIXELS / 2 + np.sin(angle) * reach * 0.6 + (t - 0.5) * drift[1] * n * SUBPIXELS
    coverage, bright = Image.new("L", (n * SUBPIXELS, n * SUBPIXELS)), Image.new("L", (n * SUBPIXELS, n * SUBPIXELS))
    width = max(2, round(rng.uniform(0.25, 0.8) * scale * SUBPIXELS))
    glint = rng.uniform(0, 2 * np.pi)
    for i in range(t.size - 1):
        line = [(px[i], py[i]), (px[i + 1], py[i + 1])]
        ImageDraw.Draw(coverage).line(line, fill=255, width=width)
        shine = 60 + 190 * max(0.0, np.cos(2 * angle[i] - glint)) ** 3
        ImageDraw.Draw(bright).line(line, fill=round(shine), width=width + 2)
    small = [np.asarray(image.resize((n, n), Image.BOX), np.float32) / 255 for image in (bright, coverage)]
    return small[0], small[1]


def _fastener(kind: str, angle: float, scale: float, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """A lying screw, a nut or a washer: brightness, and the share of each pixel that it covers; both [n, n]."""
    n = round(26 * scale)
    at = (np.arange(n) + 0.5 - n / 2) / scale
    x, y = np.meshgrid(at, at)
    lamp = lamp_direction(scene.light)
    u, v = np.cos(angle) * x + np.sin(angle) * y, -np.sin(angle) * x + np.cos(angle) * y
    lamp_v = -np.sin(angle) * lamp[0] + np.cos(angle) * lamp[1]
    if kind == "screw":
        return _screw(u, v, lamp_v, lamp[2], scale)
    r = np.hypot(x, y)
    outer = r - 5.5
    if kind == "nut":
        outer = np.max([np.abs(np.cos(a) * u + np.sin(a) * v) for a in np.radians((0, 60, 120))], axis=0) - 4.0
    away = np.maximum(outer, 2.6 - r)
    facing = (x * lamp[0] + y * lamp[1]) / (r + 1e-3)
    bevel = np.exp(-((away + 0.4) ** 2) / 0.15)
    bright = 0.5 + 0.35 * bevel * facing * np.where(r < 3.4, -1, 1)
    return bright.astype(np.float32), np.clip(0.5 - away * scale, 0, 1).astype(np.float32)


def _screw(u: np.ndarray, v: np.ndarray, lamp_v: float, lamp_z: float, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """A cap screw along u: head 5 mm long and 8.5 mm in diameter, thread 14 mm long and 5 mm in diameter."""
    head = np.maximum(np.abs(u + 7.5) - 2.5, np.abs(v) - 4.25)
    thread_radius = 2.5 + 0.18 * np.sin((u + 0.35 * v) * 2 * np.pi / 0.9)
    thread = np.maximum(np.abs(u - 2) - 7.0, np.abs(v) - thread_radius)
    is_head = head < thread
    across = np.clip(v / np.where(is_head, 4.25, 2.5), -1, 1)
    facing = across * lamp_v + np.sqrt(1 - across**2) * lamp_z
    bright = 0.08 + 0.35 * np.maximum(facing, 0) + 0.6 * np.maximum(facing, 0) ** 12
    ribs = np.where(is_head, np.sin(across * 40), np.sin((u + 0.35 * v) * 2 * np.pi / 0.9))
    bright *= 1 + np.where(is_head, 0.12, 0.45) * ribs
    away = np.minimum(head, thread)
    return bright.astype(np.float32), np.clip(0.5 - away * scale, 0, 1).astype(np.float32)
