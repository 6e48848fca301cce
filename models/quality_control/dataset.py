"""The training set: drawn in memory, as a camera, a JPEG encoder and a downsizing sender would deliver it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from multiprocessing import Pool

import numpy as np
from PIL import Image

import draw
import preprocessing
import scene
import where
from network import CELL
from scene import LABELS

WIDTHS = (1280, 640, 320)  # of the pictures that the model should recognise
SHARE_FULL = 0.1  # of the scenes, drawn at 1280; the others at 640, which takes a quarter of the time
FILTERS = (Image.BILINEAR, Image.BICUBIC, Image.BOX, Image.LANCZOS)


@dataclass(frozen=True)
class Dataset:
    """Drawn scenes: the model's inputs as bytes, label indices, and where the defects are."""

    pictures: np.ndarray  # uint8 [n, len(WIDTHS), height, width, 3]
    labels: np.ndarray  # int64 [n]
    maps: np.ndarray  # bool [n, len(LABELS) - 1, height / CELL, width / CELL]


def load(first_seed: int, count: int, workers: int) -> Dataset:
    """`count` scenes, the label of each being LABELS[seed % 4]."""
    seeds = range(first_seed, first_seed + count)
    with Pool(workers) as pool:
        pictures = np.stack(pool.map(variants, seeds, chunksize=8))
    rows, columns = preprocessing.HEIGHT // CELL, preprocessing.WIDTH // CELL
    drawn = (scene.sample(seed, LABELS[seed % len(LABELS)]) for seed in seeds)
    maps = np.stack([where.defect_map(one, rows, columns) for one in drawn])
    return Dataset(pictures, np.array([seed % len(LABELS) for seed in seeds]), maps)


def variants(seed: int) -> np.ndarray:
    """The model's input for one scene, sent at each of WIDTHS: bytes [len(WIDTHS), height, width, 3].

    A scene that is drawn at 640 has the encoded drawing as its entry of 1280. About half of the smaller entries are
    made from the encoded drawing, and so are encoded twice; the others are made from the drawing itself.
    """
    rng = np.random.default_rng([seed, 77])
    full = rng.random() < SHARE_FULL
    drawn = draw.picture(seed, LABELS[seed % len(LABELS)], 1280 if full else 640)
    sent = encoded(drawn, rng)
    found = [preprocessing.resized(sent)]
    for width in WIDTHS[1:]:
        source = drawn if rng.random() < 0.5 else sent
        small = source.resize((width, width * 3 // 4), FILTERS[rng.integers(len(FILTERS))])
        found.append(preprocessing.resized(encoded(small, rng)))
    return np.stack(found)


def encoded(image: Image.Image, rng: np.random.Generator) -> Image.Image:
    """The picture after JPEG at a quality of 70 to 95."""
    file = io.BytesIO()
    image.save(file, "JPEG", quality=int(rng.integers(70, 96)))
    return Image.open(file).convert("RGB")
