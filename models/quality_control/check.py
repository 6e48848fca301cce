"""Runs model.onnx on labelled folders with ONNX Runtime; prints accuracy, confusion matrix, latency.

    check.py models/quality-control                     pictures/ and held-out/ of the model's folder
    check.py models/quality-control FOLDER …            the named folders, which contain a labels.csv each
    check.py models/quality-control --first-to 320      pictures that are first resized to a width of 320

The preprocessing is read from the card, so the script also checks the card.
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np
import onnxruntime
from PIL import Image

import card
import preprocessing


class Model:
    """The model of a folder, which runs on one thread."""

    def __init__(self, folder: Path) -> None:
        self.card = card.read(folder)
        if card.digest(folder) != self.card["provenance"]["sha256"]:
            raise SystemExit("model.onnx is not the file that the card describes")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(str(folder / "model.onnx"), options, ["CPUExecutionProvider"])
        self.labels: list[str] = self.card["output"]["labels"]
        self.seconds: list[float] = []  # run time of each inference

    def classify(self, image: Image.Image) -> int:
        """Index of the label that the model predicts for a picture."""
        steps = self.card["preprocessing"]
        pixels = preprocessing.resize(image, steps["resize"]["width"], steps["resize"]["height"])
        values = preprocessing.normalise(pixels, steps["scale"], steps["mean"], steps["std"])
        start = time.perf_counter()
        logits = self.session.run([self.card["output"]["name"]], {self.card["input"]["name"]: values})[0]
        self.seconds.append(time.perf_counter() - start)
        return int(logits[0].argmax())


def confusion(model: Model, folder: Path, first_width: int | None) -> np.ndarray:
    """Counts the pictures of a folder: [true label, predicted label]. Prints the names of misclassified pictures.

    Each picture is first resized to a width of `first_width`, unless that is None.
    """
    counts = np.zeros((len(model.labels), len(model.labels)), int)
    with (folder / "labels.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            image = Image.open(folder / row["file"]).convert("RGB")
            if first_width is not None:
                image = image.resize((first_width, first_width * image.height // image.width), Image.BILINEAR)
            true, predicted = model.labels.index(row["label"]), model.classify(image)
            counts[true, predicted] += 1
            if true != predicted:
                print(f"  {row['file']}: {row['label']}, predicted {model.labels[predicted]}")
    return counts


def report(title: str, counts: np.ndarray, labels: list[str]) -> None:
    """Prints accuracy and confusion matrix."""
    correct, total = int(counts.trace()), int(counts.sum())
    print(f"{title}: {correct} of {total} correct, accuracy {correct / total:.4f}")
    print(f"{'true':>14} | predicted: " + ", ".join(labels))
    for label, row in zip(labels, counts, strict=True):
        print(f"{label:>14} | " + " ".join(f"{n:5}" for n in row))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Checks a model on labelled pictures.")
    parser.add_argument("model", type=Path)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--first-to", type=int, help="width in pixels to which pictures are first resized")
    parser.add_argument("--write-card", action="store_true", help="write the accuracy over all folders into the card")
    options = parser.parse_args()
    model = Model(options.model)
    total = 0
    for folder in options.folders or [options.model / "pictures", options.model / "held-out"]:
        counts = confusion(model, folder, options.first_to)
        report(str(folder), counts, model.labels)
        total = total + counts
    print(f"inference alone, one thread: median {1e3 * np.median(model.seconds):.2f} ms")
    if options.write_card:
        card.write_accuracy(options.model, round(float(total.trace() / total.sum()), 4))


if __name__ == "__main__":
    main()
