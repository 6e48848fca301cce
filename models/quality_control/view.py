"""The camera's geometry: which point of which plane a pixel sees.

World: x to the right along the belt, y down across it, z up from the belt, in
millimetres; the camera looks at the origin. Pictures are 4:3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image

import part
import surface
from scene import Camera, Pose


@dataclass(frozen=True)
class View:
    """A camera with a picture size: `rays` is the 3x3 matrix from pixels to ray directions."""

    width: int
    height: int
    position: np.ndarray  # [3] mm
    rays: np.ndarray  # [3, 3]
    scale: float  # pixels per mm at the origin

    @staticmethod
    def of(camera: Camera, width: int) -> View:
        """The view of `camera` in a picture `width` pixels wide."""
        height = width * 3 // 4
        t, d = camera.tilt, camera.tilt_direction
        back = np.array([np.sin(t) * np.cos(d), np.sin(t) * np.sin(d), np.cos(t)])
        right = np.array([1.0, 0, 0]) - back[0] * back
        right /= np.linalg.norm(right)
        down = np.cross(right, back)
        down *= np.sign(down[1])
        scale = width / camera.view
        focal = scale * camera.distance
        rays = np.stack([right / focal, down / focal, -back - right * width / 2 / focal - down * height / 2 / focal], 1)
        return View(width, height, back * camera.distance, rays, scale)

    def to_plane(self, z: float) -> np.ndarray:
        """Homography [3, 3] from pixel (x, y, 1) to the (x, y, 1) in mm of the plane at height z."""
        reach = z - self.position[2]
        direction = self.rays
        return np.stack(
            [
                self.position[0] * direction[2] + reach * direction[0],
                self.position[1] * direction[2] + reach * direction[1],
                direction[2],
            ]
        )

    def points(self, z: float) -> tuple[np.ndarray, np.ndarray]:
        """Where each pixel's ray meets the plane at height z: x and y in mm, [height, width]."""
        matrix = self.to_plane(z)
        px = (np.arange(self.width) + 0.5)[None, :]
        py = (np.arange(self.height) + 0.5)[:, None]
        x, y, w = (m[0] * px + m[1] * py + m[2] for m in matrix)
        return (x / w).astype(np.float32), (y / w).astype(np.float32)

    def pixel(self, x: float, y: float, z: float = 0.0) -> tuple[float, float]:
        """The pixel that sees the point (x, y, z)."""
        found = np.linalg.inv(self.to_plane(z)) @ np.array([x, y, 1.0])
        return found[0] / found[2], found[1] / found[2]


@dataclass(frozen=True)
class Window:
    """The rectangle of pixels in which a part and its shadow can be seen."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns, for indexing."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def empty(self) -> bool:
        """Whether no pixel is in it."""
        return self.right <= self.left or self.bottom <= self.top


def window(view: View, pose: Pose, reach: float) -> Window:
    """The window of a part at `pose`, with `reach` mm around it."""
    c, s = np.cos(pose.angle), np.sin(pose.angle)
    half_x, half_y = part.LENGTH / 2 + reach, part.WIDTH / 2 + reach
    corners = [(a * half_x, b * half_y) for a in (-1, 1) for b in (-1, 1)]
    seen = np.array([view.pixel(pose.x + c * u - s * v, pose.y + s * u + c * v) for u, v in corners])
    left, top = np.floor(seen.min(0)).astype(int)
    right, bottom = np.ceil(seen.max(0)).astype(int)
    return Window(max(0, left), max(0, top), min(view.width, right), min(view.height, bottom))


def warp(
    field: np.ndarray,
    texels: float,
    view: View,
    pose: Pose,
    where: Window,
    z: float,
    shift: tuple[float, float] = (0, 0),
) -> np.ndarray:
    """A map of the part's face as the window's pixels see it when it lies at height z.

    `shift` (mm) is added to the point seen before the map is read. Beyond the map the result is 0.
    """
    c, s = np.cos(pose.angle), np.sin(pose.angle)
    tx, ty = shift[0] - pose.x, shift[1] - pose.y
    turn = np.array([[c, s, c * tx + s * ty], [-s, c, -s * tx + c * ty], [0, 0, 1]])
    half_x, half_y = part.LENGTH / 2 + surface.MARGIN, part.WIDTH / 2 + surface.MARGIN
    texel = np.array([[texels, 0, half_x * texels], [0, texels, half_y * texels], [0, 0, 1]])
    start = np.array([[1, 0, where.left], [0, 1, where.top], [0, 0, 1]])
    matrix = texel @ turn @ view.to_plane(z) @ start
    matrix /= matrix[2, 2]
    size = (where.right - where.left, where.bottom - where.top)
    image = Image.fromarray(field.astype(np.float32))
    return np.asarray(image.transform(size, Image.PERSPECTIVE, matrix.ravel()[:8].tolist(), Image.BILINEAR))
