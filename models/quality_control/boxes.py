"""The boxes around a scene's defects in its picture. They are known exactly, because the picture is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import part
from scene import LABELS, Scene
from view import View

DEFECTS = LABELS[1:]
NAMES = ("scratch", "dent", "missing hole")  # for each label of DEFECTS, the name of such a defect


@dataclass(frozen=True)
class Box:
    """The box of a defect: the index of the defect's class in NAMES, and the edges of the box in pixels."""

    kind: int
    left: float
    top: float
    right: float
    bottom: float


def boxes(scene: Scene, width: int) -> list[Box]:
    """The boxes of a scene's defects in a picture that is `width` pixels wide and three quarters as high."""
    view = View.of(scene.camera, width)
    found = []
    for kind, points in _defects(scene):
        c, s = np.cos(scene.pose.angle), np.sin(scene.pose.angle)
        pixels = np.array(
            [
                view.pixel(scene.pose.x + c * u - s * v, scene.pose.y + s * u + c * v, part.THICKNESS)
                for u, v in points
            ]
        )
        left, top = np.clip(pixels.min(axis=0), 0, (view.width, view.height))
        right, bottom = np.clip(pixels.max(axis=0), 0, (view.width, view.height))
        if right - left > 2 and bottom - top > 2:
            found.append(Box(kind, float(left), float(top), float(right), float(bottom)))
    return found


def _defects(scene: Scene) -> list[tuple[int, np.ndarray]]:
    """For each defect: its class, and points [n, 2] of the part, in mm, that its box must contain."""
    circle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(circle), np.sin(circle)], axis=1)
    found = []
    for scratch in scene.scratches:
        on_face = scratch.points[part.distance(*scratch.points.T) < -0.3]
        if len(on_face) > 1:
            # 1 mm is added on all sides: a scratch along an axis would have a box without width or height.
            found.append((0, np.concatenate([on_face - 1.0, on_face + 1.0])))
    found += [(1, np.array([dent.x, dent.y]) + dent.radius * ring) for dent in scene.dents]
    for hole in part.HOLES:
        if hole.name == scene.missing_hole:
            found.append((2, np.array([hole.x, hole.y]) + ring * [hole.radius, hole.radius + hole.span / 2]))
    return found
