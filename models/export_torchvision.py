#!/usr/bin/env python3
"""Exports classifiers of torchvision as models for PEERNet: DIR/NAME/model.onnx and its card model.toml.

    python3 models/export_torchvision.py efficientnet_v2_s efficientnet_v2_m efficientnet_v2_l
    python3 models/export_torchvision.py resnet50 --weights IMAGENET1K_V1 --models-dir /var/lib/peernet/models
    python3 models/export_torchvision.py efficientnet_v2_s --weights none --seed 7

The card carries the weights' own transforms (resize, crop, normalisation) and their labels. `--weights none` needs no
download: the weights are random, so the answers mean nothing, but take exactly as long; the transforms are those of
the model's default weights.

See docs/models.md.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

try:
    import onnx
    import torch
    import torchvision
    from torchvision.models import get_model_builder, get_model_weights, list_models
except ImportError as error:
    sys.exit(
        f"{Path(sys.argv[0]).name}: {error} (in {sys.executable}); on Debian and Ubuntu: apt-get install python3-torch"
        " python3-torchvision python3-onnx, and run this with /usr/bin/python3; elsewhere: pip install torch"
        " 'torchvision>=0.14' onnx"
    )

CARD = """\
name = {name}
task = "classification"
description = {description}
version = {version}

[input]
name = "image"
dtype = "float32"
layout = "nchw"
shape = [1, 3, {crop}, {crop}]
colour = "rgb"

# What torchvision does with a picture: the shorter side to `size` (with Pillow, which always antialiases), the centre cut
# out, (byte / 255 - mean) / std.
[preprocessing]
resize = {{ mode = "shortest", size = {resize}, filter = {filter}, antialias = true }}
crop = {{ width = {crop}, height = {crop}, rounding = "half-even" }}
scale = {scale!r}
mean = {mean}
std = {std}

[output]
name = "logits"
activation = "softmax"
top_k = 5
labels = {labels}

[provenance]
script = "models/export_torchvision.py"
weights = {weights}
torchvision = {torchvision}
torch = {torch}
opset = {opset}
sha256 = {sha256}
"""

# torchvision's names of filters, and the card's.
FILTERS = {
    name: name for name in ("nearest", "box", "bilinear", "bicubic", "lanczos")
}


class Refused(Exception):
    """Something that cannot be exported; the text says what and what to do."""


class Exported(NamedTuple):
    """A model, as it was exported."""

    folder: Path
    model: torch.nn.Module
    transforms: Any


def weights_of(name: str, wanted: str) -> tuple[Any, Any]:
    """The weights to load, `None` for random ones, and those whose transforms and labels are taken."""
    known = get_model_weights(name)
    if wanted == "none":
        return None, known.DEFAULT
    if wanted == "default":
        return known.DEFAULT, known.DEFAULT
    try:
        return known[wanted], known[wanted]
    except KeyError:
        names = ", ".join(weights.name for weights in known)
        raise Refused(f"{name} has no weights {wanted}; there is default, none, {names}") from None


def build(name: str, weights: Any, seed: int, size: int) -> torch.nn.Module:
    """The model, ready to be run on pictures of `size` pixels squared."""
    torch.manual_seed(seed)
    try:
        model = get_model_builder(name)(weights=weights)
    except OSError as error:
        where = getattr(weights, "url", "the weights")
        raise Refused(f"cannot download {where}: {error}; without internet take --weights none") from None
    model.eval()
    if weights is None:
        settle(model, size)
    return model


def settle(model: torch.nn.Module, size: int) -> None:
    """Makes a random model as well-behaved as a trained one.

    Its batch normalisations get mean and variance from random pictures whose coarse details are stronger than their fine
    details, as in photographs. Without these statistics each layer passes on less, or more, than it was given, until all
    answers are the same. Its residual branches begin weak, as is usual in training (Goyal et al. 2017, section 5.1).
    Otherwise one pixel whose value changes by 1 would change the whole answer.
    """
    norms = [module for module in model.modules() if isinstance(module, torch.nn.modules.batchnorm._BatchNorm)]
    if not norms:
        return
    for module in model.modules():
        if getattr(module, "use_res_connect", False):
            last = [norm for norm in module.modules() if norm in norms][-1]
            torch.nn.init.constant_(last.weight, 0.05)
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None
        norm.train()
    with torch.no_grad():
        model(pictures(4, size))
    model.eval()


def pictures(count: int, size: int) -> torch.Tensor:
    """Random pictures, normalised: each octave of detail half as strong as the one before."""
    drawn, side = torch.zeros(count, 3, size, size), 3
    while side <= size:
        octave = torch.nn.functional.interpolate(torch.randn(count, 3, side, side), size=(size, size), mode="bilinear")
        drawn += octave / side
        side *= 2
    return drawn / drawn.std()


def export(name: str, models_dir: Path, weights: str = "default", seed: int = 0, opset: int = 13,
           overwrite: bool = False) -> Exported:
    """Writes the model's folder, whole or not at all."""
    folder = models_dir / name
    if folder.exists() and not overwrite:
        raise Refused(f"{folder} exists; give --overwrite to replace it, or another --models-dir")
    loaded, described = weights_of(name, weights)
    transforms = described.transforms()
    crop, resize = single(transforms.crop_size), single(transforms.resize_size)
    if crop > resize:
        raise Refused(f"{name} pads pictures ({resize} pixels to {crop}), which no card can say")
    if transforms.interpolation.value not in FILTERS:
        raise Refused(f"{name} scales pictures by {transforms.interpolation.value}, which no card can say")
    model = build(name, loaded, seed, crop)
    models_dir.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(dir=models_dir, prefix=f".{name}-"))
    try:
        file = scratch / "model.onnx"
        write_onnx(model, crop, opset, file)
        version = f"random-{seed}" if loaded is None else loaded.name
        card = CARD.format(
            name=json.dumps(name),
            description=json.dumps(f"torchvision's {name} for ImageNet-1K"
                                   + (", with random weights: its answers mean nothing" if loaded is None else "")),
            version=json.dumps(version),
            weights=json.dumps(f"random, seed {seed}" if loaded is None else str(loaded)),
            crop=crop, resize=resize, filter=json.dumps(FILTERS[transforms.interpolation.value]), scale=1 / 255,
            mean=[float(value) for value in transforms.mean], std=[float(value) for value in transforms.std],
            labels=json.dumps(described.meta["categories"], ensure_ascii=False),
            torchvision=json.dumps(torchvision.__version__), torch=json.dumps(str(torch.__version__)), opset=opset,
            sha256=json.dumps(hashlib.sha256(file.read_bytes()).hexdigest()),
        )
        (scratch / "model.toml").write_text(card, encoding="utf-8")
        scratch.chmod(0o755)
        if folder.exists():
            shutil.rmtree(folder)
        scratch.rename(folder)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    return Exported(folder, model, transforms)


def single(length: list[int] | int) -> int:
    """torchvision keeps one length as a list of one."""
    return length if isinstance(length, int) else length[0]


def write_onnx(model: torch.nn.Module, size: int, opset: int, file: Path) -> None:
    """The graph with its weights in one file, checked by onnx."""
    # Since torch 2.9 the default is the other exporter, which writes the weights to a separate file.
    choice = {"dynamo": False} if "dynamo" in inspect.signature(torch.onnx.export).parameters else {}
    # Not under `torch.no_grad()`: there torch uses its fused attention, for which ONNX has no operator.
    try:
        torch.onnx.export(model, torch.zeros(1, 3, size, size), str(file), input_names=["image"],
                          output_names=["logits"], opset_version=opset, **choice)
    except (torch.onnx.errors.OnnxExporterError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise Refused(f"torch {torch.__version__} cannot export it with --opset {opset}: {reason}") from error
    onnx.checker.check_model(str(file))


def arguments() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+", metavar="MODEL",
                        help="names in torchvision, such as efficientnet_v2_s; each becomes a folder of that name")
    parser.add_argument("--models-dir", type=Path, default=Path("models"), metavar="DIR",
                        help="where the folders are made (default: models)")
    parser.add_argument("--weights", default="default", metavar="NAME",
                        help="default, none (random ones, without a download), or a name such as IMAGENET1K_V1")
    parser.add_argument("--seed", type=int, default=0, help="of random weights (default: 0)")
    parser.add_argument("--batch", type=int, choices=[1], default=1,
                        help="length of the graph's first dimension; only 1 is possible, and such a model computes no batches (default: 1)")
    parser.add_argument("--opset", type=int, default=13, help="version of ONNX's operators (default: 13)")
    parser.add_argument("--overwrite", action="store_true", help="replace folders that exist")
    return parser


def main(given: list[str] | None = None) -> list[Exported]:
    asked = arguments().parse_args(given)
    known = list_models(module=torchvision.models)
    for name in asked.models:
        if name not in known:
            raise Refused(f"torchvision {torchvision.__version__} has no classifier {name}; it has {', '.join(known)}")
    exported = []
    for name in asked.models:
        one = export(name, asked.models_dir, asked.weights, asked.seed, asked.opset, asked.overwrite)
        size = (one.folder / "model.onnx").stat().st_size
        print(f"{one.folder}: {size / 1e6:.0f} MB; see `peernet models show {one.folder}/`", flush=True)
        exported.append(one)
    return exported


if __name__ == "__main__":
    try:
        main()
    except (Refused, OSError) as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")
