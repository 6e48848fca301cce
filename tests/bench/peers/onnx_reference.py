"""The demo model as Python runs it: PIL and numpy before it, onnxruntime with one thread. Prints JSON, in seconds.

Usage: onnx_reference.py MODEL-FOLDER PICTURES-FOLDER SECONDS
"""

from __future__ import annotations

import io
import itertools
import json
import sys
import time
import tomllib
from pathlib import Path

import onnxruntime
from PIL import Image

from quantiles import spread

WARM_UP = 30


def main() -> None:
    folder, pictures, seconds = Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3])
    card = tomllib.loads((folder / "model.toml").read_text())
    # The functions that the model was trained with.
    sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "models/quality_control"))
    from preprocessing import normalised, resized

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(folder / "model.onnx", options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    files = sorted(path for path in pictures.iterdir() if path.suffix in (".jpg", ".jpeg"))

    preprocessing, inference = [], []
    end = None
    for count, path in enumerate(itertools.cycle(files)):
        if count == WARM_UP:
            end = time.perf_counter() + seconds
        data = path.read_bytes()
        begin = time.perf_counter()
        tensor = normalised(resized(Image.open(io.BytesIO(data))))
        ready = time.perf_counter()
        session.run(None, {name: tensor})
        done = time.perf_counter()
        if count == 0 and list(tensor.shape) != card["input"]["shape"]:
            sys.exit(f"the card asks for {card['input']['shape']}, PIL and numpy made {list(tensor.shape)}")
        if end is not None:
            preprocessing.append(ready - begin)
            inference.append(done - ready)
            if done > end:
                break
    figures = {"preprocessing": spread(preprocessing), "inference": spread(inference)}
    print(json.dumps({"version": onnxruntime.__version__, "stages": figures}))


if __name__ == "__main__":
    main()
