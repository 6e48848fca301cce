"""Paints the conveyor belt: weave, wear, stains, seam, guide rail, and the light of the lamp."""

from __future__ import annotations

import numpy as np

from metal import lamp_direction
from noise import smooth_noise
from scene import Scene
from view import View


def paint(scene: Scene, view: View, rng: np.random.Generator) -> np.ndarray:
    """The empty belt in linear light, float32 [height, width, 3]."""
    x, y = view.points(0.0)
    shape = x.shape
    weave = np.sin(x * (2 * np.pi / 2.6)) * np.sin(y * (2 * np.pi / 2.6))
    wear = smooth_noise(rng, shape, 5 * view.scale, 70 * view.scale)
    stains = smooth_noise(rng, shape, 28 * view.scale)
    grain = smooth_noise(rng, shape, 0.45 * view.scale)
    tone = 1 + 0.10 * weave + 0.10 * wear + 0.13 * stains + 0.06 * grain
    # A few bright streaks along the belt: the noise rarely exceeds 1.9 standard deviations.
    tone += 0.35 * np.maximum(smooth_noise(rng, shape, 1.2 * view.scale, 40 * view.scale) - 1.9, 0)
    if scene.seam is not None:
        away = np.abs(x - scene.seam - 0.18 * y)
        tone *= 1 - 0.55 * np.exp(-((away / 0.7) ** 2)) + 0.35 * np.exp(-(((away - 1.8) / 0.8) ** 2))
    canvas = np.clip(tone, 0.1, None)[..., None] * np.asarray(scene.belt, np.float32)
    sheen = np.clip(0.006 * (1 + weave * 0.4 + 0.3 * grain), 0, None)
    canvas += sheen[..., None]
    if scene.rail is not None:
        _rail(canvas, scene, y, view, rng)
    canvas *= _falloff(scene, x, y)[..., None]
    return canvas


def _falloff(scene: Scene, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Factor of the light at each point of the belt: 1.2 in the middle."""
    light = scene.light
    lamp = lamp_direction(light) * light.distance
    square = (lamp[0] - x) ** 2 + (lamp[1] - y) ** 2 + lamp[2] ** 2
    direct = (light.distance**2 / square) ** 1.5
    return (light.ambient + (1.2 - light.ambient) * direct).astype(np.float32)


def _rail(canvas: np.ndarray, scene: Scene, y: np.ndarray, view: View, rng: np.random.Generator) -> None:
    """An aluminium guide along one side of the belt, with its shadow."""
    side = np.sign(scene.rail)
    beyond_edge = (y - scene.rail) * side  # mm, positive on the rail
    canvas *= (1 - 0.6 * np.exp(-np.maximum(-beyond_edge, 0) / 5.0))[..., None]
    brushed = 1 + 0.10 * smooth_noise(rng, y.shape, 1, 60 * view.scale)
    profile = 0.20 + 0.16 * np.exp(-((beyond_edge - 1.0) ** 2)) + 0.10 * np.cos(beyond_edge / 6.0)
    profile *= 1 - 0.7 * np.exp(-(((beyond_edge - 11.0) / 1.6) ** 2))
    coverage = np.clip(0.5 + beyond_edge * view.scale, 0, 1)
    metal = (profile * brushed)[..., None] * np.array([0.97, 1.0, 1.03], np.float32)
    canvas += (metal - canvas) * coverage[..., None]
