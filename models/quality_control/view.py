"""The camera's geometry: the point that a pixel shows on a plane.

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
    """A camera and the size of its picture. `rays` is the matrix from pixels to directions of rays."""

    width: int
    height: int
    position: np.ndarray  # [3] mm
    rays: np.ndarray  # [3, 3]
    scale: float  # pixels per mm at the origin

    @staticmethod
    def of(camera: Camera, width: int) -> View:
        """The view of `camera` for a picture that is `width` pixels wide."""
        height = width * 3 // 4
        t, d = camera.tilt, camera.tilt_direction
        # Unit vectors: from the origin to the camera, and the directions of the picture's rows and columns.
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
        """The homography [3, 3] from pixels (x, y, 1) to points (x, y, 1), in mm, of the plane at height z."""
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
        """The points of the plane at height z that the pixels show: x and y in mm, [height, width]."""
        matrix = self.to_plane(z)
        px = (np.arange(self.width) + 0.5)[None, :]
        py = (np.arange(self.height) + 0.5)[:, None]
        x, y, w = (m[0] * px + m[1] * py + m[2] for m in matrix)
        return (x / w).astype(np.float32), (y / w).astype(np.float32)

    def pixel(self, x: float, y: float, z: float = 0.0) -> tuple[float, float]:
        """The pixel that shows the point (x, y, z)."""
        px, py, w = np.linalg.inv(self.to_plane(z)) @ np.array([x, y, 1.0])
        return px / w, py / w


@dataclass(frozen=True)
class Window:
    """The rectangle of pixels that can show a part and its shadow."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """The rows and columns of the window, as indices of a picture."""
        return slice(self.top, self.bottom), slice(self.left, self.right)

    @property
    def is_empty(self) -> bool:
        """Whether the window has no pixels."""
        return self.right <= self.left or self.bottom <= self.top


def window(view: View, pose: Pose, reach: float) -> Window:
    """The window that contains a part at `pose` and `reach` mm around the part."""
    c, s = np.cos(pose.angle), np.sin(pose.angle)
    half_x, half_y = part.LENGTH / 2 + reach, part.WIDTH / 2 + reach
    corners = [(a * half_x, b * half_y) for a in (-1, 1) for b in (-1, 1)]
    outline = np.array([view.pixel(pose.x + c * u - s * v, pose.y + s * u + c * v) for u, v in corners])
    left, top = np.floor(outline.min(0)).astype(int)
    right, bottom = np.ceil(outline.max(0)).astype(int)
    return Window(max(0, left), max(0, top), min(view.width, right), min(view.height, bottom))


def warp(
    field: np.ndarray,
    texels: float,
    view: View,
    pose: Pose,
    pixels: Window,
    z: float,
    shift: tuple[float, float] = (0, 0),
) -> np.ndarray:
    """The values of a map of the part's face at the window's pixels, if the face lies at height z.

    `shift` (mm) is added to the point that a pixel shows, before the map is read. Beyond the map the values are 0.
    """
    c, s = np.cos(pose.angle), np.sin(pose.angle)
    tx, ty = shift[0] - pose.x, shift[1] - pose.y
    turn = np.array([[c, s, c * tx + s * ty], [-s, c, -s * tx + c * ty], [0, 0, 1]])
    half_x, half_y = part.LENGTH / 2 + surface.MARGIN, part.WIDTH / 2 + surface.MARGIN
    texel = np.array([[texels, 0, half_x * texels], [0, texels, half_y * texels], [0, 0, 1]])
    start = np.array([[1, 0, pixels.left], [0, 1, pixels.top], [0, 0, 1]])
    matrix = texel @ turn @ view.to_plane(z) @ start
    matrix /= matrix[2, 2]
    size = (pixels.right - pixels.left, pixels.bottom - pixels.top)
    image = Image.fromarray(field.astype(np.float32))
    return np.asarray(image.transform(size, Image.PERSPECTIVE, matrix.ravel()[:8].tolist(), Image.BILINEAR))
