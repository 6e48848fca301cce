# How Python values become parts of a sample, and parts become values. Standard library only; numpy, PIL and torch are
# used where the user's code has them.
import io
import json
import math
import pickle
import sys

PICKLE = "application/x-python-pickle"
# A tree of containers as JSON whose leaves may be the parts that follow.
TREE = "application/x-python-tree"
OR_PICKLE = "say pickle = true on both ends"
# A message takes 64 parts; the first may be the tree or the pickle.
MAX_LEAVES = 63

DTYPES = {
    "bool": "?", "u8": "u1", "i8": "i1", "u16": "<u2", "i16": "<i2", "f16": "<f2", "u32": "<u4", "i32": "<i4",
    "f32": "<f4", "u64": "<u8", "i64": "<i8", "f64": "<f8", "c64": "<c8", "c128": "<c16",
}
ELEMENTS = {
    "b1": "bool", "u1": "u8", "i1": "i8", "u2": "u16", "i2": "i16", "f2": "f16", "u4": "u32", "i4": "i32",
    "f4": "f32", "u8": "u64", "i8": "i64", "f8": "f64", "c8": "c64", "c16": "c128",
}
# Modes of PIL whose pixels are numbers of other types.
NUMBERS = {"I;16": "u16", "I": "i32", "F": "f32"}
PIXELS = {"RGB": ("rgb8", 3), "L": ("grey8", 1)}


# Made once: dumps() with separators would make one for each call.
to_json = json.JSONEncoder(separators=(",", ":")).encode


class Refused(Exception):
    """A value that cannot cross."""


class Gone(Exception):
    """The other end of the pipe is closed."""


def part(media, data, shape=(), element=None):
    return {"media": media, "shape": list(shape), "element": element}, data


# --- Python to parts ---


class Encoder:
    def __init__(self, may_pickle):
        self.may_pickle = may_pickle

    def parts(self, value):
        form = self.form(value)
        if form is not None:
            return [form(value)]
        if self.may_pickle and not self.plain(value):
            return self.pickled(value)
        if isinstance(value, (list, tuple)) and 1 < len(value) <= MAX_LEAVES:
            forms = [self.form(one) for one in value]
            if all(forms) and any(not isinstance(one, str) for one in value):
                return [form(one) for form, one in zip(forms, value)]
        leaves = []
        tree, is_json = self.tree(value, leaves, 0)
        if not leaves and is_json:
            # Only numpy's scalars are left to the default.
            text = json.dumps(value, separators=(",", ":"), default=lambda scalar: scalar.item())
            return [part("json", text.encode())]
        if len(leaves) > MAX_LEAVES:
            many = (len(leaves), MAX_LEAVES)
            raise Refused("a value holds %d arrays, pictures or byte strings; at most %d cross" % many)
        return [part({"other": TREE}, to_json(tree).encode())] + leaves

    def form(self, value):
        """What makes the part of a value that has a form of its own; None for others."""
        if isinstance(value, (bytes, bytearray, memoryview)):
            return self.bytes
        if isinstance(value, str):
            return self.text
        numpy = sys.modules.get("numpy")
        if numpy is not None and isinstance(value, numpy.ndarray):
            lossless = type(value) is numpy.ndarray and value.dtype.str[1:] in ELEMENTS
            return self.array if lossless or not self.may_pickle else None
        image = sys.modules.get("PIL.Image")
        if image is not None and isinstance(value, image.Image):
            return self.picture if value.mode in PIXELS or not self.may_pickle else None
        torch = sys.modules.get("torch")
        if torch is not None and isinstance(value, torch.Tensor) and not self.may_pickle:
            return self.tensor
        return None

    def bytes(self, value):
        return part("bytes", value if memoryview(value).c_contiguous else value.tobytes())

    def text(self, value):
        return part("text", value.encode())

    def tensor(self, value):
        return self.array(value.detach().cpu().numpy())

    def array(self, value):
        numpy = sys.modules["numpy"]
        if isinstance(value, numpy.ma.MaskedArray) and numpy.ma.is_masked(value):
            raise Refused("a masked array does not cross, because its mask would be lost; fill it, or " + OR_PICKLE)
        element = ELEMENTS.get(value.dtype.str[1:])
        if element is None:
            raise Refused("an array of type %s does not cross; convert it, or %s" % (value.dtype, OR_PICKLE))
        value = numpy.ascontiguousarray(value, dtype=DTYPES[element]).reshape(value.shape)
        data = value.reshape(-1).view(numpy.uint8).data if value.size else b""
        return part("tensor", data, value.shape, element)

    def picture(self, value):
        if value.mode in NUMBERS:
            return part("tensor", value.tobytes(), (value.height, value.width), NUMBERS[value.mode])
        if value.mode not in PIXELS:
            value = value.convert("L" if value.mode in ("1", "LA", "La") else "RGB")
        name, channels = PIXELS[value.mode]
        return part({"pixels": name}, value.tobytes(), (value.height, value.width, channels), "u8")

    def plain(self, value, depth=0):
        """Whether a value is made of built-in types alone, so that nothing is lost without a pickle."""
        kind = type(value)
        if value is None or kind in (bool, int, float):
            return True
        if depth > 100:
            return False
        if kind in (list, tuple):
            return all(self.plain(one, depth + 1) for one in value)
        if kind is dict:
            return all(type(key) is str and self.plain(one, depth + 1) for key, one in value.items())
        return self.form(value) is not None

    def tree(self, value, leaves, depth):
        """The value as JSON, with lists, tuples and dictionaries told apart, and whether it is JSON as it stands."""
        if value is None or isinstance(value, (bool, int)):
            return value, True
        if isinstance(value, float):
            return value, math.isfinite(value)
        if depth > 100:
            raise Refused("a value is nested more than 100 levels deep")
        if isinstance(value, str):
            return value, True
        form = self.form(value)
        if form is not None:
            leaves.append(form(value))
            return {"part": len(leaves)}, False
        if isinstance(value, (list, tuple)):
            items = [self.tree(one, leaves, depth + 1) for one in value]
            tree = [item for item, _ in items]
            return (tree if isinstance(value, list) else {"tuple": tree}), all(plain for _, plain in items)
        if isinstance(value, dict):
            keys = [self.tree(key, leaves, depth + 1)[0] for key in value]
            if not all(key is None or isinstance(key, (str, int, float)) for key in keys):
                raise Refused("a dictionary whose keys are not strings or numbers does not cross; " + OR_PICKLE)
            items = [self.tree(one, leaves, depth + 1) for one in value.values()]
            is_json = all(isinstance(key, str) for key in keys) and all(plain for _, plain in items)
            return {"dict": [[key, item] for key, (item, _) in zip(keys, items)]}, is_json
        numpy = sys.modules.get("numpy")
        if numpy is not None and isinstance(value, numpy.generic):
            return self.tree(value.item(), leaves, depth)
        kind = type(value)
        raise Refused(
            "a %s.%s does not cross; return bytes, text, numbers, arrays, pictures, lists or dictionaries of them, or %s"
            % (kind.__module__, kind.__qualname__, OR_PICKLE)
        )

    def pickled(self, value):
        buffers = []
        try:
            try:
                data = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
                buffers = [buffer.raw() for buffer in buffers]
            except BufferError:
                buffers = None
            if buffers is None or len(buffers) > MAX_LEAVES:
                data, buffers = pickle.dumps(value, protocol=5), []
        except Exception as error:
            raise Refused("a %s cannot be pickled: %s" % (type(value).__qualname__, error)) from None
        return [part({"other": PICKLE}, data)] + [part("bytes", buffer) for buffer in buffers]


# --- Parts to Python ---


class Decoder:
    def __init__(self, may_pickle, images):
        self.may_pickle = may_pickle
        self.images = images

    def read(self, border, heads):
        """The value of the parts that come next; all are read, whatever is wrong with one."""
        first = heads[0]["description"]["media"] if heads else None
        other = first.get("other") if isinstance(first, dict) else None
        if other == PICKLE:
            return self.unpickled([border.array(head) for head in heads])
        values, refused = [], None
        for head in heads:
            description = head["description"]
            data = border.array(head) if description["media"] == "tensor" else border.bytes(head)
            try:
                values.append(self.value(description, data))
            except Exception as error:
                # The other parts still have to be read.
                refused = refused or error
        if refused is not None:
            raise Refused(str(refused) or type(refused).__name__)
        if other == TREE:
            try:
                return grown(json.loads(values[0]), values)
            except Exception as error:
                raise Refused("a value arrived whose containers make no sense: %s" % error) from None
        return None if not values else values[0] if len(values) == 1 else tuple(values)

    def value(self, description, data):
        media = description["media"]
        if media == "text":
            return data.decode()
        if media == "json":
            return json.loads(data)
        if media == "tensor":
            return self.array(description, data)
        if isinstance(media, dict) and "pixels" in media:
            return self.pixels(description, data)
        if media in ("jpeg", "png") and self.images == "pil":
            return pil().open(io.BytesIO(data))
        return data

    def array(self, description, data):
        numpy = imported("numpy", "an array", "python3-numpy", "")
        dtype, shape = DTYPES.get(description["element"]), description["shape"]
        try:
            return numpy.frombuffer(data, dtype="u1" if dtype is None else dtype).reshape(shape if dtype else -1)
        except ValueError as error:
            raise Refused("an array is not of its shape: %s" % error) from None

    def pixels(self, description, data):
        height, width, channels = description["shape"]
        if self.images == "pil":
            mode = "RGB" if channels == 3 else "L"
            return pil().frombuffer(mode, (width, height), data, "raw", mode, 0, 1)
        if self.images == "numpy":
            numpy = imported("numpy", "a picture", "python3-numpy", " or say images = 'bytes'")
            return numpy.frombuffer(data, dtype="u1").reshape(height, width, channels)
        return data

    def unpickled(self, parts):
        if not self.may_pickle:
            raise Refused(
                "a pickled object arrived and is not unpickled, because that runs code of whoever sent it; "
                "where you trust them, say pickle = true here as well"
            )
        return pickle.loads(parts[0], buffers=parts[1:])


def pil():
    return imported("PIL.Image", "a picture", "python3-pil", " or say images = 'numpy' or 'bytes'")


def imported(module, what, package, otherwise):
    try:
        __import__(module)
    except ImportError as error:
        text = "%s arrived and %s cannot be imported (%s); install %s%s"
        raise Refused(text % (what, module, error, package, otherwise)) from None
    return sys.modules[module]


def grown(tree, parts):
    """The value of a tree whose leaves are `parts`."""
    if isinstance(tree, list):
        return [grown(one, parts) for one in tree]
    if not isinstance(tree, dict):
        return tree
    if "part" in tree:
        return parts[tree["part"]]
    if "tuple" in tree:
        return tuple(grown(one, parts) for one in tree["tuple"])
    return {key: grown(one, parts) for key, one in tree["dict"]}


