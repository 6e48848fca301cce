"""Smooth random fields, made by enlarging small ones."""

from __future__ import annotations

import numpy as np
from PIL import Image


def smooth_noise(
    rng: np.random.Generator, shape: tuple[int, int], size: float, size_x: float | None = None
) -> np.ndarray:
    """Noise [rows, columns] of mean 0 and deviation about 1, with features of `size` pixels.

    `size_x`, where given, is the features' size along the columns, so that
    streaks can be made.
    """
    rows = max(2, round(shape[0] / max(size, 1)) + 1)
    columns = max(2, round(shape[1] / max(size_x or size, 1)) + 1)
    small = rng.standard_normal((rows, columns), np.float32)
    if (rows, columns) == shape:
        return small
    return enlarge(small, shape)


def enlarge(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """A float32 field [rows, columns] resampled to `shape`, bicubic."""
    return np.asarray(Image.fromarray(field.astype(np.float32)).resize(shape[::-1], Image.BICUBIC))


def blurred(field: np.ndarray, size: float) -> np.ndarray:
    """A field [rows, columns] blurred over about `size` pixels, by way of a smaller one."""
    rows = max(2, round(field.shape[0] / max(size, 1)))
    columns = max(2, round(field.shape[1] / max(size, 1)))
    small = Image.fromarray(field.astype(np.float32)).resize((columns, rows), Image.BILINEAR)
    return enlarge(np.asarray(small), field.shape)
