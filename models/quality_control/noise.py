"""Smooth random fields, made by enlarging small ones."""

from __future__ import annotations

import numpy as np
from PIL import Image


def smooth_noise(
    rng: np.random.Generator, shape: tuple[int, int], size: float, size_x: float | None = None
) -> np.ndarray:
    """Noise [rows, columns] with mean 0, standard deviation of about 1 and features of `size` pixels.

    `size_x` is the width of the features; if it differs from `size`, the
    features are streaks.
    """
    rows = max(2, round(shape[0] / max(size, 1)) + 1)
    columns = max(2, round(shape[1] / max(size_x or size, 1)) + 1)
    small = rng.standard_normal((rows, columns), np.float32)
    if (rows, columns) == shape:
        return small
    return enlarge(small, shape)


def enlarge(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A field [rows, columns], resampled to `shape` with the bicubic filter: float32."""
    return np.asarray(Image.fromarray(field.astype(np.float32)).resize(shape[::-1], Image.BICUBIC))


def blur(field: np.ndarray, size: float) -> np.ndarray:
    """A field [rows, columns], blurred over about `size` pixels: it is made smaller and enlarged again."""
    rows = max(2, round(field.shape[0] / max(size, 1)))
    columns = max(2, round(field.shape[1] / max(size, 1)))
    small = Image.fromarray(field.astype(np.float32)).resize((columns, rows), Image.BILINEAR)
    return enlarge(np.asarray(small), field.shape)
