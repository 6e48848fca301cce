"""Draws pictures of machined parts on a factory line.

    draw.py FOLDER --width 1280 --quality 85 --first-seed 1 --count good=18 scratched=4

A scene (scene.py) becomes a picture in three steps: the belt and the clutter on
it (belt.py, clutter.py), the parts (metal.py), the camera (sensor.py).
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from PIL import Image

import belt
import clutter
import metal
import scene as scenes
import sensor
from view import View


def draw_picture(seed: int, label: str, width: int) -> Image.Image:
    """The RGB picture of `seed` and `label`, `width` pixels wide and three quarters as high."""
    scene = scenes.sample(seed, label)
    rng = np.random.default_rng([seed, width])
    view = View.of(scene.camera, width)
    light = belt.paint(scene, view, rng)
    clutter.scatter(light, scene, view, rng)
    if scene.neighbour is not None:
        metal.paint(light, metal.without_defects(scene), scene.neighbour, view, rng)
    face_brightness = metal.paint(light, scene, scene.pose, view, rng)
    clutter.dust(light, scene, view, rng)
    return sensor.expose(light, face_brightness, scene, rng)


def shuffled_labels(counts: dict[str, int], seed: int) -> list[str]:
    """The labels in a random order that `seed` determines. Each label occurs as often as `counts` says."""
    labels = [label for label, count in counts.items() for _ in range(count)]
    return [labels[i] for i in np.random.default_rng(seed).permutation(len(labels))]


def write_folder(folder: Path, counts: dict[str, int], width: int, quality: int, first_seed: int) -> None:
    """Writes part-0001.jpg … and labels.csv; the first picture has the seed first_seed, the next first_seed + 1."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "labels.csv").open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(("file", "label"))
        for index, label in enumerate(shuffled_labels(counts, first_seed)):
            name = f"part-{index + 1:04}.jpg"
            draw_picture(first_seed + index, label, width).save(folder / name, quality=quality, optimize=True)
            rows.writerow((name, label))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Draws a folder of labelled pictures.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--width", type=int, default=1280)
    parser.add_argument("--quality", type=int, default=85, help="quality of the JPEG files")
    parser.add_argument("--first-seed", type=int, required=True)
    parser.add_argument("--count", nargs="+", required=True, metavar="LABEL=N")
    options = parser.parse_args()
    counts = {label: int(number) for label, number in (pair.split("=") for pair in options.count)}
    write_folder(options.out, counts, options.width, options.quality, options.first_seed)


if __name__ == "__main__":
    main()
