"""Paints a machined part: top face, chamfers, walls of the plate and its holes, shadow on the belt."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import part
import surface
from noise import smooth_noise
from scene import Light, Pose, Scene
from view import View, Window, warp, window

WALL_LEVELS = (0.0, 0.2, 0.4, 0.6, 0.8)  # heights of the walls' slices, as fractions of the thickness
SHADOW_LEVELS = (0.12, 0.35, 0.6, 0.8, 1.0)  # heights that cast the shadow, as fractions of the thickness
SHADOW_REACH = 26.0  # mm: the shadow is never farther from the part
FAR = 20.0  # mm: distances beyond the map count as this distance

Vector = tuple[np.ndarray, np.ndarray, np.ndarray]  # x, y, z per pixel, each float32 [rows, columns]


@dataclass(frozen=True)
class VisiblePart:
    """A part in one window of the picture: its values at each pixel of the window."""

    face: surface.Surface
    view: View
    pose: Pose
    pixels: Window

    def map(self, field: np.ndarray, level: float = 1.0) -> np.ndarray:
        """The values of a map of the face at the points that the pixels show at height `level` of the thickness."""
        return warp(field, self.face.texels, self.view, self.pose, self.pixels, level * part.THICKNESS)

    def distance(self, level: float) -> np.ndarray:
        """Distance in mm from the part's edge to the points that the pixels show at the height `level`."""
        # `warp` returns 0 beyond the map, which becomes FAR.
        return FAR - self.map(np.maximum(FAR - self.face.edge_distance, 0), level)

    def distance_on_belt(self, shift: tuple[float, float]) -> np.ndarray:
        """Distance in mm from the part's edge to the points of the belt that the pixels show, moved by `shift` mm."""
        inside = np.maximum(FAR - self.face.edge_distance, 0)
        return FAR - warp(inside, self.face.texels, self.view, self.pose, self.pixels, 0.0, shift)

    def coverage(self, level: float) -> np.ndarray:
        """Share of each pixel that the part covers at the height `level`: 0..1, [rows, columns, 1]."""
        return np.clip(0.5 - self.distance(level) * self.view.scale, 0, 1)[..., None]

    def to_world(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A direction at each pixel of the top face in the world's frame, from its maps in the part's frame."""
        c, s = np.float32(np.cos(self.pose.angle)), np.float32(np.sin(self.pose.angle))
        u, v = self.map(x), self.map(y)
        return c * u - s * v, s * u + c * v


def without_defects(scene: Scene) -> Scene:
    """The scene, but its part has no defect."""
    return replace(scene, missing_hole=None, scratches=(), dents=())


def lamp_direction(light: Light) -> np.ndarray:
    """Unit vector [3] from the belt to the lamp."""
    flat = np.cos(light.elevation)
    return np.array([flat * np.cos(light.azimuth), flat * np.sin(light.azimuth), np.sin(light.elevation)])


def paint(canvas: np.ndarray, scene: Scene, pose: Pose, view: View, rng: np.random.Generator) -> float:
    """Paints the part into `canvas` (linear light, [height, width, 3]); returns its top face's mean brightness."""
    pixels = window(view, pose, SHADOW_REACH)
    if pixels.is_empty:
        return 0.0
    # The map has a little more texels per mm than the picture has pixels per mm, but at most 8.
    texels = min(1.25 * view.scale, 8.0)
    visible = VisiblePart(surface.build(scene, texels, rng), view, pose, pixels)
    patch = canvas[pixels.slices]
    _shadow(patch, visible, scene.light)
    _walls(patch, visible, scene, rng)
    face = _face(visible, scene)
    patch += (face - patch) * visible.coverage(1.0)
    flat = visible.distance(1.0) < -4
    return float(face[flat].mean()) if flat.any() else 0.0


def _shadow(patch: np.ndarray, visible: VisiblePart, light: Light) -> None:
    """Darkens the belt in the shadow of the plate. Higher edges of the plate cast softer shadows."""
    lamp = lamp_direction(light)
    reach = lamp[:2] / lamp[2] * part.THICKNESS
    shade = np.zeros(patch.shape[:2], np.float32)
    for level in SHADOW_LEVELS:
        soft = 0.4 + 2 * light.softness * part.THICKNESS * level
        away = visible.distance_on_belt((reach[0] * level, reach[1] * level))
        shade = np.maximum(shade, np.clip(0.5 - away / soft, 0, 1))
    contact = np.exp(-np.maximum(visible.distance(0.0), 0) / 3.0)
    patch *= (1 - (1 - 0.5 * light.ambient) * shade)[..., None]
    patch *= (1 - 0.45 * contact)[..., None]


def _walls(patch: np.ndarray, visible: VisiblePart, scene: Scene, rng: np.random.Generator) -> None:
    """Paints the walls of the plate and of its holes as slices, from the belt upwards."""
    out_y, out_x = np.gradient(visible.face.edge_distance, 1 / visible.face.texels)
    c, s = np.cos(visible.pose.angle), np.sin(visible.pose.angle)
    lamp = lamp_direction(scene.light)
    lit = np.clip((c * out_x - s * out_y) * lamp[0] + (s * out_x + c * out_y) * lamp[1], 0, 1)
    streaks = 1 + 0.06 * smooth_noise(rng, patch.shape[:2], 2.5)
    for level in WALL_LEVELS:
        bright = (0.10 + 0.12 * level + 0.42 * visible.map(lit, level) * (0.4 + 0.6 * level)) * streaks
        colour = bright[..., None] * np.asarray(scene.metal, np.float32)
        patch += (colour - patch) * visible.coverage(level)


def _face(visible: VisiblePart, scene: Scene) -> np.ndarray:
    """Linear light [rows, columns, 3] of the top face, also at pixels that the face does not cover."""
    slope_x, slope_y = visible.to_world(visible.face.slope_x, visible.face.slope_y)
    upright = 1 / np.sqrt(1 + slope_x**2 + slope_y**2)
    normal = (-slope_x * upright, -slope_y * upright, upright)
    along = visible.to_world(visible.face.along_x, visible.face.along_y)
    to_lamp, half = _directions(scene.light, visible)
    rough = visible.map(visible.face.rough) + (0.5 if scene.surface == "blasted" else 0.0)
    gloss = _gloss(normal, along, half, rough)
    diffuse = np.maximum(_dot(normal, to_lamp), 0)
    sky = scene.light.ambient * (0.55 + 0.45 * normal[2] ** 3 + 0.12 * normal[1])
    bright = visible.map(visible.face.albedo) * (sky * 0.55 + 0.30 * diffuse + 1.15 * gloss * (diffuse > 0))
    return bright[..., None] * np.asarray(scene.metal, np.float32)


def _dot(a: Vector, b: Vector) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Vector:
    length = np.sqrt(x**2 + y**2 + z**2)
    return x / length, y / length, z / length


def _directions(light: Light, visible: VisiblePart) -> tuple[Vector, Vector]:
    """Unit vectors at each pixel of the top face: to the lamp, and halfway between lamp and camera."""
    rows, columns = visible.pixels.slices
    x, y = (field[rows, columns] for field in visible.view.points(part.THICKNESS))

    def toward(point: np.ndarray) -> Vector:
        return _unit(point[0] - x, point[1] - y, np.full_like(x, point[2] - part.THICKNESS))

    to_lamp = toward((lamp_direction(light) * light.distance).astype(np.float32))
    to_camera = toward(visible.view.position.astype(np.float32))
    return to_lamp, _unit(*(a + b for a, b in zip(to_lamp, to_camera, strict=True)))


def _gloss(normal: Vector, along: tuple[np.ndarray, np.ndarray], half: Vector, rough: np.ndarray) -> np.ndarray:
    """Ward's highlight, wide across the machining marks and narrow along them, 0..1."""
    cosine = np.maximum(_dot(normal, half), 0.05)
    # Components of `half` in the surface: along the marks, and the square of the one across them.
    lengthwise = (half[0] - normal[0] * cosine) * along[0] + (half[1] - normal[1] * cosine) * along[1]
    across_squared = np.maximum(1 - cosine**2 - lengthwise**2, 0)
    a, b = 0.19 + 0.25 * rough, 0.40 + 0.15 * rough
    return np.exp(-((lengthwise / a) ** 2 + across_squared / b**2) / cosine**2) * (1 - 0.45 * rough)
