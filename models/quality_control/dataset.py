"""The training set. Its pictures are drawn in memory; as in use, they are then encoded as JPEG and made smaller."""

from __future__ import annotations

import io
from dataclasses import dataclass
from multiprocessing import Pool

import numpy as np
from PIL import Image

import draw
import preprocessing
import scene
from defect_map import defect_cells
from network import CELL
from scene import LABELS

WIDTHS = (1280, 640, 320)  # widths of the pictures that the model must be able to classify
# Share of the scenes that are drawn 1280 wide. The others are drawn 640 wide, which takes a quarter of the time.
FULL_WIDTH_SHARE = 0.1
FILTERS = (Image.BILINEAR, Image.BICUBIC, Image.BOX, Image.LANCZOS)


@dataclass(frozen=True)
class Dataset:
    """Drawn scenes: the inputs of the model as bytes, the indices of the labels, and the positions of the defects."""

    pictures: np.ndarray  # uint8 [n, len(WIDTHS), height, width, 3]
    labels: np.ndarray  # int64 [n]
    maps: np.ndarray  # bool [n, len(LABELS) - 1, height / CELL, width / CELL]


def draw_dataset(first_seed: int, count: int, workers: int) -> Dataset:
    """Draws `count` scenes. The label of each scene is LABELS[seed % 4]."""
    seeds = range(first_seed, first_seed + count)
    with Pool(workers) as pool:
        pictures = np.stack(pool.map(input_variants, seeds, chunksize=8))
    rows, columns = preprocessing.HEIGHT // CELL, preprocessing.WIDTH // CELL
    scenes = (scene.sample(seed, LABELS[seed % len(LABELS)]) for seed in seeds)
    maps = np.stack([defect_cells(drawn, rows, columns) for drawn in scenes])
    return Dataset(pictures, np.array([seed % len(LABELS) for seed in seeds]), maps)


def input_variants(seed: int) -> np.ndarray:
    """The inputs of the model for one scene that is sent at each of WIDTHS: bytes [len(WIDTHS), height, width, 3].

    If a scene is drawn 640 wide, this drawing also stands for the picture that is 1280 wide. About half of the smaller
    pictures are made from the encoded drawing, so they are encoded twice; the others are made from the drawing itself.
    """
    # 77 is neither an index of a label (scene.py) nor a width (draw.py), so no other generator has the same seed.
    rng = np.random.default_rng([seed, 77])
    is_full_width = rng.random() < FULL_WIDTH_SHARE
    drawn = draw.draw_picture(seed, LABELS[seed % len(LABELS)], 1280 if is_full_width else 640)
    encoded = encode_and_decode(drawn, rng)
    inputs = [preprocessing.resize(encoded)]
    for width in WIDTHS[1:]:
        source = drawn if rng.random() < 0.5 else encoded
        small = source.resize((width, width * 3 // 4), FILTERS[rng.integers(len(FILTERS))])
        inputs.append(preprocessing.resize(encode_and_decode(small, rng)))
    return np.stack(inputs)


def encode_and_decode(image: Image.Image, rng: np.random.Generator) -> Image.Image:
    """The picture after JPEG compression at a random quality from 70 to 95."""
    file = io.BytesIO()
    image.save(file, "JPEG", quality=int(rng.integers(70, 96)))
    return Image.open(file).convert("RGB")
