#!/usr/bin/env python3
"""Writes small ONNX models with their cards, and what numpy computes from their outputs.

    graphs.py OUT

Each model is a folder in OUT. The outputs of detectors are random constants; `expected.json` in the folder of a detector has
the answer for a picture of the size PICTURE. The computation follows the definitions of the layouts and shares no code with
the program under test.
"""

import json
import sys
from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save_model
from PIL import Image

PICTURE = (120, 80)  # width, height
INPUT = (64, 64)
LABELS = ["bolt", "nut", "washer"]
SCORE, IOU, MAX_DETECTIONS = 0.3, 0.5, 20  # thresholds of score and overlap; limit of the number of detections
TYPES = {
    "float16": TensorProto.FLOAT16, "float32": TensorProto.FLOAT, "float64": TensorProto.DOUBLE,
    "int8": TensorProto.INT8, "int16": TensorProto.INT16, "int32": TensorProto.INT32, "int64": TensorProto.INT64,
    "uint8": TensorProto.UINT8, "uint16": TensorProto.UINT16, "uint32": TensorProto.UINT32, "uint64": TensorProto.UINT64,
    "bool": TensorProto.BOOL,
}
PREPROCESSING = """
[preprocessing]
resize = {{ mode = "letterbox", width = {0}, height = {1} }}
scale = 0.00392156862745098
mean = [0.1, 0.2, 0.3]
std = [0.5, 1.0, 2.0]
""".format(*INPUT)


def tensor_info(name, dtype, shape):
    return helper.make_tensor_value_info(name, TYPES[dtype], shape)


def write(out, name, card, nodes, inputs, outputs, initialisers=()):
    graph = helper.make_graph(nodes, name, inputs, outputs, [numpy_helper.from_array(a, n) for n, a in initialisers])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    checker.check_model(model)
    folder = out / name
    folder.mkdir(parents=True, exist_ok=True)
    save_model(model, str(folder / "model.onnx"))
    (folder / "model.toml").write_text(f'name = "{name}"\n{card}')
    return folder


def picture_input(width=INPUT[0], height=INPUT[1]):
    return f'[input]\nname = "image"\ndtype = "float32"\nlayout = "nchw"\nshape = [1, 3, {height}, {width}]\ncolour = "rgb"\n'


# --- detection --------------------------------------------------------------------------------------------------------


def detector(out, name, outputs, card_lines, candidates, iou):
    """Writes a model with constant outputs, and the answer that follows from `candidates`. A candidate is a class, a score, and
    the edges left, top, right and bottom in pixels of the input. `card_lines` describe the outputs. Without `iou`, no
    candidate is suppressed because it overlaps a better one."""
    names = list(outputs)
    nodes = [helper.make_node("Identity", ["c_" + n], [n]) for n in names]
    types = {code: name for name, code in TYPES.items()}
    infos = [tensor_info(n, types[numpy_helper.from_array(a).data_type], a.shape) for n, a in outputs.items()]
    labels = json.dumps(LABELS)
    card = f'task = "detection"\n{picture_input()}{PREPROCESSING}[output]\nlabels = {labels}\n'
    card += f"score_threshold = {SCORE}\nmax_detections = {MAX_DETECTIONS}\n{card_lines}\n"
    if iou is not None:
        card += f"iou_threshold = {iou}\n"
    inputs = [tensor_info("image", "float32", [1, 3, INPUT[1], INPUT[0]])]
    constants = [("c_" + n, a) for n, a in outputs.items()]
    folder = write(out, name, card, nodes, inputs, infos, constants)
    found = to_picture(suppress_overlaps([c for c in candidates if c[1] > SCORE], iou))
    (folder / "expected.json").write_text(json.dumps(found))


def suppress_overlaps(candidates, iou):
    remaining = sorted(candidates, key=lambda c: -c[1])
    kept = []
    while remaining and len(kept) < MAX_DETECTIONS:
        best = remaining.pop(0)
        kept.append(best)
        if iou is not None:
            boxes = np.array([c[2:] for c in remaining]).reshape(-1, 4)
            low, high = np.maximum(boxes[:, :2], best[2:4]), np.minimum(boxes[:, 2:], best[4:6])
            common = np.prod(np.clip(high - low, 0, None), axis=1)
            areas = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
            area = (best[4] - best[2]) * (best[5] - best[3])
            overlap = common / (areas + area - common)
            remaining = [c for c, o in zip(remaining, overlap) if c[0] != best[0] or o <= iou]
    return kept


def letterbox():
    """Returns the size of the resized picture, and the position of its upper left corner in the input."""
    factor = min(INPUT[0] / PICTURE[0], INPUT[1] / PICTURE[1])
    size = [round(side * factor) for side in PICTURE]
    return size, [(whole - part) // 2 for whole, part in zip(INPUT, size)]


def to_picture(candidates):
    size, corner = letterbox()
    answer = []
    for class_index, score, *edges in candidates:
        points = (np.array(edges).reshape(2, 2) - corner) * np.array(PICTURE) / size
        points = np.clip(points, 0, PICTURE)
        if (points[1] > points[0]).all():
            answer.append({"label": LABELS[int(class_index)], "score": float(score), "box": points.ravel().tolist()})
    return answer


def random_boxes(rng, count):
    """Returns boxes [count, 4] as centre and size. They lie around a few places, so that many boxes overlap."""
    places = rng.uniform(10, 54, (6, 2))
    centres = places[rng.integers(0, len(places), count)] + rng.normal(0, 2, (count, 2))
    return np.concatenate([centres, rng.uniform(8, 30, (count, 2))], axis=1).astype(np.float32)


def edges(boxes):
    """Returns the edges left, top, right and bottom of boxes."""
    return np.concatenate([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], axis=1)


def detectors(out):
    rng = np.random.default_rng(11)
    count = 150
    boxes, scores = random_boxes(rng, count), rng.uniform(0, 1, (count, 3)).astype(np.float32)
    classes = scores.argmax(axis=1)
    classified_boxes = [(k, s[k], *e) for k, s, e in zip(classes, scores, edges(boxes))]
    rows = np.concatenate([boxes.T, scores.T])[None]
    detector(out, "yolov8", {"output0": rows}, 'layout = "yolov8"\nname = "output0"', classified_boxes, IOU)

    half = rows.astype(np.float16)
    h = half[0].astype(np.float32)
    best_half = [(c[4:].argmax(), c[4:].max(), *e) for c, e in zip(h.T, edges(h[:4].T))]
    detector(out, "yolov8-half", {"output0": half}, 'layout = "yolov8"\nname = "output0"', best_half, IOU)

    objects = rng.normal(0, 2, count).astype(np.float32)
    logits = rng.normal(0, 2, (count, 3)).astype(np.float32)
    sigmoid = lambda x: 1 / (1 + np.exp(-x.astype(np.float64)))
    raw = np.concatenate([boxes, objects[:, None], logits], axis=1)[None]
    candidates = [(l.argmax(), sigmoid(o) * sigmoid(l).max(), *e) for o, l, e in zip(objects, logits, edges(boxes))]
    lines = 'layout = "yolov5"\nname = "output"\nactivation = "sigmoid"'
    detector(out, "yolov5", {"output": raw}, lines, candidates, IOU)

    top = np.concatenate([edges(boxes), scores.max(axis=1)[:, None], classes[:, None].astype(np.float32)], axis=1)
    top[-20:, 4:] = (0.0, -1.0)  # rows that pad the output and have no class
    candidates = [(r[5], r[4], *r[:4]) for r in top[:-20]]
    lines = 'layout = "yolov10"\nname = "output0"'
    detector(out, "yolov10", {"output0": top[None].astype(np.float32)}, lines, candidates, None)

    # The fourth class of DETR stands for no object.
    queries = rng.normal(0, 2, (count, 4)).astype(np.float32)
    softmax = np.exp(queries.astype(np.float64))
    softmax /= softmax.sum(axis=1, keepdims=True)
    candidates = [(s[:3].argmax(), s[:3].max(), *e) for s, e in zip(softmax, edges(boxes))]
    fractions = boxes / np.array([*INPUT, *INPUT], np.float32)
    lines = 'layout = "detr"\nscores = "logits"\nboxes = "pred_boxes"\n'
    outputs = {"logits": queries[None], "pred_boxes": fractions[None]}
    detector(out, "detr", outputs, lines + 'activation = "softmax"', candidates, None)

    pairs = [(k, sigmoid(l[k]), *e) for l, e in zip(logits, edges(boxes)) for k in range(3)]
    outputs = {"logits": logits[None], "pred_boxes": fractions[None]}
    detector(out, "rt-detr", outputs, lines + 'activation = "sigmoid"', pairs, None)

    e = edges(boxes) / np.array([*INPUT, *INPUT])
    # `count` says that only the first 100 rows are detections. The other rows have a class without a label.
    separate = {
        "boxes": e[:, [1, 0, 3, 2]].astype(np.float32)[None],
        "scores": scores.max(axis=1)[None],
        "classes": np.where(np.arange(count) < 100, classes, 99).astype(np.int64)[None],
        "count": np.array([[100]], np.int32),
    }
    lines = 'layout = "nms"\nboxes = "boxes"\nscores = "scores"\nclasses = "classes"\ncount = "count"\n'
    detector(out, "nms", separate, lines + 'box_format = "yxyx"\nbox_unit = "fraction"', classified_boxes[:100], None)

    plain = {"boxes": edges(boxes), "scores": scores.max(axis=1), "classes": classes.astype(np.float32)}
    lines = 'layout = "nms"\nboxes = "boxes"\nscores = "scores"\nclasses = "classes"'
    detector(out, "nms-plain", plain, lines, classified_boxes, None)
    # The program refuses the outputs of the following models, so no test reads their `expected.json`.
    infinite = {**plain, "scores": np.where(np.arange(count) == 7, np.inf, plain["scores"]).astype(np.float32)}
    detector(out, "nms-infinite-score", infinite, lines, [], None)
    with_count = {**plain, "count": np.array([1.5], np.float32)}
    detector(out, "nms-fraction-of-rows", with_count, lines + '\ncount = "count"', [], None)
    plain["classes"] = classes.astype(np.float32) + 1
    detector(out, "nms-unknown-class", plain, lines, [], None)


# --- arrays -----------------------------------------------------------------------------------------------------------


def policy(out, name, batch):
    """Writes a model that computes, for each sample of a batch: action = 2 state + mean(front) + offset; done = action > 0."""
    card = """
task = "tensors"
[[input]]
name = "front"
dtype = "uint8"
layout = "nhwc"
shape = [1, 2, 2, 3]
colour = "rgb"
[[input]]
name = "state"
dtype = "float32"
shape = [1, 2]
[[input]]
name = "offset"
dtype = "int64"
shape = [1, 2]
value = [[10, -1000]]
[preprocessing]
[[output]]
name = "action"
dtype = "float32"
shape = [1, 2]
[[output]]
name = "done"
dtype = "bool"
shape = [1, 2]
"""
    nodes = [
        helper.make_node("Cast", ["front"], ["pixels"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["pixels"], ["means"], axes=[1, 2, 3], keepdims=1),
        helper.make_node("Flatten", ["means"], ["mean"], axis=1),
        helper.make_node("Cast", ["offset"], ["shift"], to=TensorProto.FLOAT),
        helper.make_node("Add", ["state", "state"], ["double"]),
        helper.make_node("Add", ["double", "mean"], ["sum"]),
        helper.make_node("Add", ["sum", "shift"], ["action"]),
        helper.make_node("Greater", ["action", "zero"], ["done"]),
    ]
    inputs = [
        tensor_info("front", "uint8", [batch, 2, 2, 3]),
        tensor_info("state", "float32", [batch, 2]),
        tensor_info("offset", "int64", [1, 2]),
    ]
    outputs = [tensor_info("action", "float32", [batch, 2]), tensor_info("done", "bool", [batch, 2])]
    write(out, name, card, nodes, inputs, outputs, [("zero", np.zeros(1, np.float32))])


def arrays(out):
    for name in TYPES:
        card = f'task = "tensors"\n[input]\nname = "x"\ndtype = "{name}"\nshape = [3]\n'
        card += f'[output]\nname = "y"\ndtype = "{name}"\nshape = [3]\n'
        node = helper.make_node("Identity", ["x"], ["y"])
        write(out, "identity-" + name, card, [node], [tensor_info("x", name, [3])], [tensor_info("y", name, [3])])

    policy(out, "policy", 1)
    policy(out, "open-policy", "batch")

    # The root of a negative number is NaN. Loading a model runs it on zeros, which have roots, so that the model can be
    # loaded.
    for name, shape in (("root", [3]), ("open-root", ["batch", 3])):
        card_shape = [1 if length == "batch" else length for length in shape]
        card = f'task = "tensors"\n[input]\nname = "x"\ndtype = "float32"\nshape = {card_shape}\n'
        card += f'[output]\nname = "y"\ndtype = "float32"\nshape = {card_shape}\n'
        node = helper.make_node("Sqrt", ["x"], ["y"])
        write(out, name, card, [node], [tensor_info("x", "float32", shape)], [tensor_info("y", "float32", shape)])

    # The batch dimension of the input is open, but the output has one row for all samples of a batch. Such a model
    # cannot compute batches.
    card = 'task = "tensors"\n[input]\nname = "x"\ndtype = "float32"\nshape = [1, 3]\n'
    card += '[output]\nname = "y"\ndtype = "float32"\nshape = [1, 3]\n'
    node = helper.make_node("ReduceMean", ["x"], ["y"], axes=[0])
    write(out, "mean-of-rows", card, [node], [tensor_info("x", "float32", ["batch", 3])], [tensor_info("y", "float32", [1, 3])])

    # ONNX Runtime refuses the whole run if one sample of a batch has an index beyond the table.
    card = 'task = "tensors"\n[input]\nname = "x"\ndtype = "int64"\nshape = [1, 3]\n'
    card += '[output]\nname = "y"\ndtype = "float32"\nshape = [1, 3]\n'
    node = helper.make_node("Gather", ["squares", "x"], ["y"])
    squares = ("squares", np.arange(1000, dtype=np.float32) ** 2)
    inputs, outputs = [tensor_info("x", "int64", ["batch", 3])], [tensor_info("y", "float32", ["batch", 3])]
    write(out, "table", card, [node], inputs, outputs, [squares])

    # A loop that runs as often as the input says. The loop of `endless` always runs longer than a test can wait.
    card = 'task = "tensors"\n[input]\nname = "x"\ndtype = "int64"\nshape = [1]\n'
    card += '[output]\nname = "y"\ndtype = "int64"\nshape = [1]\n'
    body = helper.make_graph(
        [helper.make_node("Identity", ["goes_on"], ["continues"]), helper.make_node("Add", ["sum", "one"], ["more"])],
        "body",
        [tensor_info("index", "int64", []), tensor_info("goes_on", "bool", []), tensor_info("sum", "int64", [1])],
        [tensor_info("continues", "bool", []), tensor_info("more", "int64", [1])],
    )
    loops = {"counter": ("x", []), "endless": ("most", [("most", np.array([1 << 60]))])}
    constants = [("true", np.array(True)), ("zero", np.zeros(1, np.int64)), ("one", np.ones(1, np.int64))]
    for name, (runs, initialisers) in loops.items():
        node = helper.make_node("Loop", [runs, "true", "zero"], ["y"], body=body)
        inputs, outputs = [tensor_info("x", "int64", [1])], [tensor_info("y", "int64", [1])]
        write(out, name, card, [node], inputs, outputs, constants + initialisers)

    # A loop that runs as often as the largest number of a batch says. The answer to a sample is the sample's number.
    nodes = [
        helper.make_node("ReduceMax", ["x"], ["runs"], keepdims=0),
        helper.make_node("Loop", ["runs", "true", "zero"], ["sum"], body=body),
        helper.make_node("Min", ["x", "sum"], ["y"]),
    ]
    card = card.replace("shape = [1]", "shape = [1, 1]")
    shape = ["batch", 1]
    inputs, outputs = [tensor_info("x", "int64", shape)], [tensor_info("y", "int64", shape)]
    write(out, "open-counter", card, nodes, inputs, outputs, constants)

    card = f'task = "tensors"\n{picture_input()}{PREPROCESSING}'
    card += f'[output]\nname = "y"\ndtype = "float32"\nshape = [1, 3, {INPUT[1]}, {INPUT[0]}]\n'
    shape = [1, 3, INPUT[1], INPUT[0]]
    node = helper.make_node("Identity", ["image"], ["y"])
    folder = write(out, "picture", card, [node], [tensor_info("image", "float32", shape)], [tensor_info("y", "float32", shape)])
    rng = np.random.default_rng(5)
    coarse = rng.integers(0, 256, (10, 15, 3), np.uint8)
    picture = Image.fromarray(coarse).resize(PICTURE, Image.BICUBIC)
    (folder / "picture.rgb").write_bytes(picture.tobytes())
    size, (x, y) = letterbox()
    canvas = np.full((INPUT[1], INPUT[0], 3), 114, np.float32)
    canvas[y : y + size[1], x : x + size[0]] = np.asarray(picture.resize(size, Image.BILINEAR))
    numbers = (canvas / 255 - np.array([0.1, 0.2, 0.3])) / np.array([0.5, 1.0, 2.0])
    (folder / "expected.f32").write_bytes(numbers.transpose(2, 0, 1).astype("<f4").tobytes())


# --- pictures to other answers ----------------------------------------------------------------------------------------


def other_tasks(out):
    shape = [1, 3, INPUT[1], INPUT[0]]
    plain = PREPROCESSING.replace("mean = [0.1, 0.2, 0.3]", "mean = [0.0, 0.0, 0.0]").replace(
        "std = [0.5, 1.0, 2.0]", "std = [1.0, 1.0, 1.0]")
    # The strongest colour is the class.
    card = f'task = "segmentation"\n{picture_input()}{plain}[output]\nname = "y"\nlabels = ["red", "green", "blue"]\n'
    node = helper.make_node("Identity", ["image"], ["y"])
    write(out, "segmentation", card, [node], [tensor_info("image", "float32", shape)], [tensor_info("y", "float32", shape)])
    node = helper.make_node("ArgMax", ["image"], ["y"], axis=1, keepdims=0)
    outputs = [tensor_info("y", "int64", [1, INPUT[1], INPUT[0]])]
    write(out, "segmentation-classes", card, [node], [tensor_info("image", "float32", shape)], outputs)

    card = f'task = "embedding"\n{picture_input()}{plain}[output]\nname = "y"\nnormalise = true\n'
    node = helper.make_node("ReduceMean", ["image"], ["y"], axes=[2, 3], keepdims=0)
    write(out, "embedding", card, [node], [tensor_info("image", "float32", shape)], [tensor_info("y", "float32", [1, 3])])

    # Constant outputs that cannot be converted to an answer, or that fit no card of the task.
    classes = '[output]\nname = "y"\nlabels = ["red", "green", "blue"]\nactivation = "softmax"\n'
    vector = '[output]\nname = "y"\nnormalise = true\n'
    ones = np.ones((1, 3), np.float32)
    for name, task, output, numbers in [
        ("classes-nan", "classification", classes, ones * np.nan),
        ("classes-infinite", "classification", classes, ones * np.inf),
        ("classes-bool", "classification", classes, ones > 0),
        ("classes-rank-3", "classification", classes, ones[..., None]),
        ("classes-two-rows", "classification", classes, np.ones((2, 3), np.float32)),
        ("classes-four", "classification", classes, np.ones((1, 4), np.float32)),
        ("embedding-infinite", "embedding", vector, ones * np.inf),
        ("embedding-zero", "embedding", vector, ones * 0),
    ]:
        card = f'task = "{task}"\n{picture_input()}{plain}{output}'
        node = helper.make_node("Identity", ["constant"], ["y"])
        dtype = "bool" if numbers.dtype == bool else "float32"
        outputs = [tensor_info("y", dtype, numbers.shape)]
        write(out, name, card, [node], [tensor_info("image", "float32", shape)], outputs, [("constant", numbers)])


def main():
    out = Path(sys.argv[1])
    detectors(out)
    arrays(out)
    other_tasks(out)


if __name__ == "__main__":
    main()
