"""Computes the model's input from a picture, exactly as the card (model.toml) says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

WIDTH, HEIGHT = 224, 168
SCALE = 1 / 255
MEAN = (0.30, 0.30, 0.30)
STD = (0.25, 0.25, 0.25)


def resize(image: Image.Image, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """RGB bytes [height, width, 3] of the picture, resized with Pillow's bilinear filter, which antialiases."""
    return np.asarray(image.convert("RGB").resize((width, height), Image.BILINEAR))


def normalise(
    pixels: np.ndarray, scale: float = SCALE, mean: Sequence[float] = MEAN, std: Sequence[float] = STD
) -> np.ndarray:
    """The model's input, float32 [1, 3, height, width], from bytes [height, width, 3]."""
    values = (pixels.astype(np.float32) * scale - np.float32(mean)) / np.float32(std)
    return np.ascontiguousarray(values.transpose(2, 0, 1)[None], dtype=np.float32)
