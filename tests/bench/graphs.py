"""ONNX models that the benchmarks create: one that accepts batches, and one with the output of a YOLO detector."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from statistics import median

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper

from programs import Failure

# Name that the first dimension of inputs and outputs gets. A dimension with a name instead of a size is open: it may
# have any size.
BATCH = "batch"
# Number of samples in the batch whose results are compared with those of single samples, and largest difference.
COMPARED_BATCH = 4
TOLERANCE = 1e-4

# Input, candidates and classes of YOLOv8 for COCO.
SIDE, CANDIDATES, CLASSES = 640, 8_400, 80
# Share of the candidates with a score above the threshold, and number of objects around which these candidates lie.
CONFIDENT, OBJECTS = 0.02, 12
DETECTOR_CARD = """\
name = "{name}"
task = "detection"

[input]
name = "images"
dtype = "float32"
layout = "nchw"
shape = [1, 3, {side}, {side}]
colour = "rgb"

[preprocessing]
resize = {{ mode = "letterbox", width = {side}, height = {side} }}
scale = 0.00392156862745098
mean = [0.0, 0.0, 0.0]
std = [1.0, 1.0, 1.0]

[output]
layout = "yolov8"
name = "output0"
labels = {labels}
"""


def copy_with_open_batch(source: Path, target: Path) -> None:
    """Copies a model's folder without its pictures, and changes the graph so that it takes batches of any size.

    Raises a failure if the results of a batch differ from those of its samples one by one.
    """
    target.mkdir()
    shutil.copy(source / "model.toml", target)
    model = onnx.load(source / "model.onnx")
    graph = model.graph
    # The recorded shapes of intermediate values have a first dimension of 1.
    del graph.value_info[:]
    for value in (*graph.input, *graph.output):
        value.type.tensor_type.shape.dim[0].dim_param = BATCH
    _open_reshapes(graph)
    # The card has the hash of the original graph, which the changed graph does not match.
    lines = (target / "model.toml").read_text().splitlines(keepends=True)
    (target / "model.toml").write_text("".join(line for line in lines if not line.startswith("sha256")))
    onnx.checker.check_model(model)
    onnx.save(model, target / "model.onnx")
    _compare(target / "model.onnx")


def _open_reshapes(graph: onnx.GraphProto) -> None:
    """Changes constant shapes of Reshape nodes: a first dimension of 1 becomes 0, which copies that of the input."""
    shapes = {node.input[1] for node in graph.node if node.op_type == "Reshape"}
    constants = {tensor.name: tensor for tensor in graph.initializer}
    for node in graph.node:
        if node.op_type == "Constant":
            constants.update((node.output[0], one.t) for one in node.attribute if one.name == "value")
    for name in shapes & constants.keys():
        tensor = constants[name]
        shape = numpy_helper.to_array(tensor).copy()
        if shape.size and shape[0] == 1:
            shape[0] = 0
            tensor.CopyFrom(numpy_helper.from_array(shape, tensor.name))


def seconds_per_sample(folder: Path, sizes: tuple[int, ...], rounds: int) -> dict[int, float]:
    """Returns the median time per sample, seconds, in batches of these sizes, with one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(folder / "model.onnx", options, providers=["CPUExecutionProvider"])
    model_input = session.get_inputs()[0]
    times: dict[int, list[float]] = {size: [] for size in sizes}
    for size in (*sizes, *sizes * rounds):
        batch = np.zeros((size, *model_input.shape[1:]), np.float32)
        begin = time.perf_counter()
        session.run(None, {model_input.name: batch})
        times[size].append((time.perf_counter() - begin) / size)
    # The first round warms up.
    return {size: median(values[1:]) for size, values in times.items()}


def _compare(file: Path) -> None:
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    model_input = session.get_inputs()[0]
    shape = (COMPARED_BATCH, *model_input.shape[1:])
    batch = np.random.default_rng(1).standard_normal(shape, dtype=np.float32)
    together = session.run(None, {model_input.name: batch})[0]
    alone = np.concatenate([session.run(None, {model_input.name: one[None]})[0] for one in batch])
    if together.shape != alone.shape or not np.allclose(together, alone, atol=TOLERANCE, rtol=TOLERANCE):
        raise Failure(f"{file} gives other results for a batch of {COMPARED_BATCH} than for one sample at a time")


def make_detector(folder: Path) -> None:
    """Creates a model whose output has the shape of YOLOv8's, but always has the same candidates.

    Its inference takes almost no time, so the stages before and after it can be compared.
    """
    folder.mkdir()
    constant = numpy_helper.from_array(_candidates(), "candidates")
    nodes = [
        # A graph must use its input. So one pixel of it is multiplied by zero and added.
        helper.make_node("Slice", ["images", "begin", "end"], ["corner"]),
        helper.make_node("ReduceMax", ["corner"], ["pixel"], keepdims=0),
        helper.make_node("Mul", ["pixel", "zero"], ["nothing"]),
        helper.make_node("Add", ["candidates", "nothing"], ["output0"]),
    ]
    initializers = [
        constant,
        numpy_helper.from_array(np.zeros(4, np.int64), "begin"),
        numpy_helper.from_array(np.ones(4, np.int64), "end"),
        numpy_helper.from_array(np.zeros((), np.float32), "zero"),
    ]
    model_input = helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, SIDE, SIDE])
    model_output = helper.make_tensor_value_info("output0", TensorProto.FLOAT, [1, 4 + CLASSES, CANDIDATES])
    graph = helper.make_graph(nodes, "detector", [model_input], [model_output], initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, folder / "model.onnx")
    labels = [f"class {number}" for number in range(CLASSES)]
    (folder / "model.toml").write_text(DETECTOR_CARD.format(name=folder.name, side=SIDE, labels=labels))


def _candidates() -> np.ndarray:
    """Returns candidates [1, 4 + classes, n]. Only those around the objects have scores above the threshold."""
    random = np.random.default_rng(1)
    out = np.empty((4 + CLASSES, CANDIDATES), np.float32)
    out[:2] = random.uniform(0, SIDE, (2, CANDIDATES))
    out[2:4] = random.uniform(10, 200, (2, CANDIDATES))
    out[4:] = random.uniform(0, 0.01, (CLASSES, CANDIDATES))
    centres = random.uniform(150, SIDE - 150, (2, OBJECTS))
    sizes = random.uniform(40, 200, (2, OBJECTS))
    classes = random.integers(0, CLASSES, OBJECTS)
    for candidate in random.choice(CANDIDATES, int(CONFIDENT * CANDIDATES), replace=False):
        number = candidate % OBJECTS
        out[:2, candidate] = centres[:, number] + random.normal(0, 3, 2)
        out[2:4, candidate] = sizes[:, number] * random.normal(1, 0.03, 2)
        out[4 + classes[number], candidate] = random.uniform(0.3, 0.95)
    return out[None]
