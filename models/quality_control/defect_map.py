"""The position of a scene's defect in the picture. It is known exactly, because the picture is drawn."""

from __future__ import annotations

import numpy as np

import part
from scene import LABELS, Scene
from view import View


def defect_cells(scene: Scene, rows: int, columns: int) -> np.ndarray:
    """The cells of a grid over the picture that show the defect: bool [len(LABELS) - 1, rows, columns].

    The first axis is the class of the defect; the class `good` is left out.
    """
    cells = np.zeros((len(LABELS) - 1, rows, columns), bool)
    points = _points(scene)
    if len(points) == 0:
        return cells
    # The width does not matter, because a cell is a share of the picture.
    view = View.of(scene.camera, 1280)
    c, s = np.cos(scene.pose.angle), np.sin(scene.pose.angle)
    for u, v in points:
        x, y = scene.pose.x + c * u - s * v, scene.pose.y + s * u + c * v
        px, py = view.pixel(x, y, part.THICKNESS)
        column, row = int(px * columns / view.width), int(py * rows / view.height)
        if 0 <= row < rows and 0 <= column < columns:
            cells[LABELS.index(scene.label) - 1, row, column] = True
    return cells


def _points(scene: Scene) -> np.ndarray:
    """Points of the part [n, 2], in mm, that belong to the defect."""
    points = [scratch.points[part.distance(*scratch.points.T) < -0.3] for scratch in scene.scratches]
    points += [np.array([dent.x, dent.y]) + 0.8 * dent.radius * _disc() for dent in scene.dents]
    for hole in part.HOLES:
        if hole.name == scene.missing_hole:
            points.append(np.array([hole.x, hole.y]) + _disc() * [hole.radius, hole.radius + hole.span / 2])
    return np.concatenate(points) if points else np.zeros((0, 2))


def _disc() -> np.ndarray:
    """Points spread over the unit disc, [n, 2]."""
    side = np.linspace(-1, 1, 9)
    x, y = np.meshgrid(side, side)
    inside = np.hypot(x, y) <= 1
    return np.stack([x[inside], y[inside]], axis=1)
