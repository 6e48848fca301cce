#!/usr/bin/env python3
"""Exports classifiers of torchvision as models for PEERNet: DIR/NAME/model.onnx and its card model.toml.

    python3 models/export_torchvision.py efficientnet_v2_s efficientnet_v2_m efficientnet_v2_l
    python3 models/export_torchvision.py resnet50 --weights IMAGENET1K_V1 --models-dir /var/lib/peernet/models
    python3 models/export_torchvision.py efficientnet_v2_s --weights none --seed 7

The card describes the transforms (resize, crop, normalisation) and the labels that belong to the weights.
`--weights none` needs no download: the weights are random, so the answers mean nothing, but they take exactly as long
to compute. The card then describes the transforms of the model's default weights.

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

# torchvision resizes the shorter side of a picture to `size` (with Pillow, which always antialiases), cuts out the
# centre, and computes (byte / 255 - mean) / std for each value.
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

# Names of filters in torchvision, and the card's names of the same filters.
FILTERS = {
    name: name for name in ("nearest", "box", "bilinear", "bicubic", "lanczos")
}


class ExportError(Exception):
    """A model cannot be exported; the text says why, and what the user can do."""


class ExportedModel(NamedTuple):
    """An exported model, and what is needed to compare its answers with those of torchvision."""

    folder: Path
    model: torch.nn.Module
    transforms: Any


def select_weights(name: str, choice: str) -> tuple[Any, Any]:
    """The weights to load (`None`: random weights), and the weights whose transforms and labels the card describes."""
    published = get_model_weights(name)
    if choice == "none":
        return None, published.DEFAULT
    if choice == "default":
        return published.DEFAULT, published.DEFAULT
    try:
        return published[choice], published[choice]
    except KeyError:
        names = ", ".join(weights.name for weights in published)
        raise ExportError(f"{name} has no weights {choice}; it has default, none, {names}") from None


def build_model(name: str, weights: Any, seed: int, size: int) -> torch.nn.Module:
    """The model, ready to compute answers for pictures of `size` by `size` pixels."""
    torch.manual_seed(seed)
    try:
        model = get_model_builder(name)(weights=weights)
    except OSError as error:
        source = getattr(weights, "url", "the weights")
        raise ExportError(f"cannot download {source}: {error}; without internet use --weights none") from None
    model.eval()
    if weights is None:
        calibrate(model, size)
    return model


def calibrate(model: torch.nn.Module, size: int) -> None:
    """Gives a random model activations as large as those of a trained model.

    Each batch normalisation gets its statistics from random pictures. Without these statistics the values would shrink
    or grow from layer to layer, until all pictures get the same answer. The residual branches get small weights, as is
    usual at the start of a training (Goyal et al. 2017, section 5.1). Otherwise a pixel that differs by 1 would change
    the whole answer.
    """
    norms = [module for module in model.modules() if isinstance(module, torch.nn.modules.batchnorm._BatchNorm)]
    if not norms:
        return
    for module in model.modules():
        # Blocks of torchvision say with this attribute whether they have a residual connection.
        if getattr(module, "use_res_connect", False):
            last_norm = [norm for norm in module.modules() if norm in norms][-1]
            torch.nn.init.constant_(last_norm.weight, 0.05)
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None
        norm.train()
    with torch.no_grad():
        model(random_pictures(4, size))
    model.eval()


def random_pictures(count: int, size: int) -> torch.Tensor:
    """Random pictures with a standard deviation of 1. As in photographs, small details are weaker than large ones."""
    pictures, side = torch.zeros(count, 3, size, size), 3
    while side <= size:
        octave = torch.nn.functional.interpolate(torch.randn(count, 3, side, side), size=(size, size), mode="bilinear")
        pictures += octave / side
        side *= 2
    return pictures / pictures.std()


def export(name: str, models_dir: Path, weights: str = "default", seed: int = 0, opset: int = 13,
           overwrite: bool = False) -> ExportedModel:
    """Writes the model's folder. After an error there is no incomplete folder."""
    folder = models_dir / name
    if folder.exists() and not overwrite:
        raise ExportError(f"{folder} exists; use --overwrite to replace it, or another --models-dir")
    loaded, described = select_weights(name, weights)
    transforms = described.transforms()
    crop, resize = side_length(transforms.crop_size), side_length(transforms.resize_size)
    if crop > resize:
        raise ExportError(f"{name} pads pictures ({resize} pixels to {crop}), which a card cannot describe")
    if transforms.interpolation.value not in FILTERS:
        filter_name = transforms.interpolation.value
        raise ExportError(f"{name} resizes pictures with {filter_name}, which a card cannot describe")
    model = build_model(name, loaded, seed, crop)
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
    return ExportedModel(folder, model, transforms)


def side_length(length: list[int] | int) -> int:
    """The length of a side in pixels. torchvision keeps some lengths as a list with one element."""
    return length if isinstance(length, int) else length[0]


def write_onnx(model: torch.nn.Module, size: int, opset: int, file: Path) -> None:
    """Writes the graph and its weights into one file, and checks the file with onnx."""
    # From torch 2.9 on, the default is the dynamo exporter, which writes the weights into a separate file.
    exporter = {"dynamo": False} if "dynamo" in inspect.signature(torch.onnx.export).parameters else {}
    # There is no torch.no_grad() here: without gradients torch uses fused attention, for which ONNX has no operator.
    try:
        torch.onnx.export(model, torch.zeros(1, 3, size, size), str(file), input_names=["image"],
                          output_names=["logits"], opset_version=opset, **exporter)
    except (torch.onnx.errors.OnnxExporterError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise ExportError(f"torch {torch.__version__} cannot export it with --opset {opset}: {reason}") from error
    onnx.checker.check_model(str(file))


def argument_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+", metavar="MODEL",
                        help="name in torchvision, such as efficientnet_v2_s; also the name of the model's folder")
    parser.add_argument("--models-dir", type=Path, default=Path("models"), metavar="DIR",
                        help="folder in which the folders of the models are created (default: models)")
    parser.add_argument("--weights", default="default", metavar="NAME",
                        help="default, none (random weights, without a download), or a name such as IMAGENET1K_V1")
    parser.add_argument("--seed", type=int, default=0, help="seed of random weights (default: 0)")
    parser.add_argument("--batch", type=int, choices=[1], default=1,
                        help="pictures per batch; only 1 is possible (default: 1)")
    parser.add_argument("--opset", type=int, default=13, help="version of ONNX's operators (default: 13)")
    parser.add_argument("--overwrite", action="store_true", help="replace folders that exist")
    return parser


def main(arguments: list[str] | None = None) -> list[ExportedModel]:
    """Exports the models that the arguments name (`None`: the arguments of the command line)."""
    options = argument_parser().parse_args(arguments)
    classifiers = list_models(module=torchvision.models)
    for name in options.models:
        if name not in classifiers:
            names = ", ".join(classifiers)
            raise ExportError(f"torchvision {torchvision.__version__} has no classifier {name}; it has {names}")
    exported = []
    for name in options.models:
        model = export(name, options.models_dir, options.weights, options.seed, options.opset, options.overwrite)
        size = (model.folder / "model.onnx").stat().st_size
        print(f"{model.folder}: {size / 1e6:.0f} MB; see `peernet models show {model.folder}/`", flush=True)
        exported.append(model)
    return exported


if __name__ == "__main__":
    try:
        main()
    except (ExportError, OSError) as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")
