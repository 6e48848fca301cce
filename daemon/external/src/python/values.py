# Part of the worker's source: mod.rs concatenates its files.
#
# Conversion between Python values and parts of a sample. Standard library only; numpy, PIL and torch are used if
# custom code imports them.
import io
import json
import math
import pickle
import sys

PICKLE = "application/x-python-pickle"
# A tree of containers as JSON. Its leaves may refer to the parts that follow.
TREE = "application/x-python-tree"
# Advice at the end of an error text.
OR_PICKLE = "set pickle = true on both ends"
# A message holds up to 64 parts; the first may be the tree or the pickle.
MAX_LEAVES = 63
# Limit of the total size of a value: 1 GiB.
MAX_BYTES = 1 << 30
# Texts of exceeded limits.
TOO_MANY_LEAVES = "a value holds %d arrays, pictures or byte strings; at most %d can be transferred"
TOO_MANY_BYTES = "a value has %d bytes; at most %d can be transferred"
# Limit of one dimension of an array.
MAX_LENGTH = (1 << 32) - 1

# Types of numpy by the types of elements in descriptions, and the reverse.
DTYPES = {
    "bool": "?", "u8": "u1", "i8": "i1", "u16": "<u2", "i16": "<i2", "f16": "<f2", "u32": "<u4", "i32": "<i4",
    "f32": "<f4", "u64": "<u8", "i64": "<i8", "f64": "<f8", "c64": "<c8", "c128": "<c16",
}
ELEMENTS = {
    "b1": "bool", "u1": "u8", "i1": "i8", "u2": "u16", "i2": "i16", "f2": "f16", "u4": "u32", "i4": "i32",
    "f4": "f32", "u8": "u64", "i8": "i64", "f8": "f64", "c8": "c64", "c16": "c128",
}
# Modes of PIL whose pixels are numbers of another type than u8, with the type of the elements.
NUMBER_MODES = {"I;16": "u16", "I;16L": "u16", "I;16B": "u16", "I": "i32", "F": "f32"}
# Modes of PIL that are transferred as they are, with the name of the pixel format and the number of channels.
PIXEL_MODES = {"RGB": ("rgb8", 3), "L": ("grey8", 1)}


# Created once, because json.dumps() with separators creates an encoder in every call.
to_json = json.JSONEncoder(separators=(",", ":")).encode


class UnsupportedValue(Exception):
    """A value that cannot be transferred."""


class PipeClosed(Exception):
    """The other end of the pipe is closed."""


def is_a(value, module, kind):
    """Whether a value has that class. The module may be missing, or another thread may be importing it."""
    return isinstance(value, getattr(sys.modules.get(module), kind, ()))


def part(media, data, shape=(), element=None):
    return {"media": media, "shape": list(shape), "element": element}, data


# --- Python to parts ---


class Encoder:
    """Converts a Python value to parts."""

    def __init__(self, may_pickle):
        self.may_pickle = may_pickle

    def parts(self, value):
        # form() returns a method, which encodes the value as one part.
        form = self.form(value)
        if form is not None:
            return [form(value)]
        if self.may_pickle and not self.needs_no_pickle(value):
            return self.pickled(value)
        # Each item of a list becomes one part, if all items have a form. A list of texts becomes JSON instead.
        if isinstance(value, (list, tuple)) and 1 < len(value) <= MAX_LEAVES:
            forms = [self.form(item) for item in value]
            if all(forms) and any(not isinstance(item, str) for item in value):
                return [form(item) for form, item in zip(forms, value)]
        leaves = []
        tree, is_json = self.tree(value, leaves, 0)
        if not leaves and is_json:
            # `default` is called for numpy's scalars only.
            text = json.dumps(value, separators=(",", ":"), default=lambda scalar: scalar.item())
            return [part("json", text.encode())]
        if len(leaves) > MAX_LEAVES:
            raise UnsupportedValue(TOO_MANY_LEAVES % (len(leaves), MAX_LEAVES))
        return [part({"other": TREE}, to_json(tree).encode())] + leaves

    def leaf_count(self, parts):
        """The number of arrays, pictures and byte strings among the parts of a yielded value. The list of all yielded
        values may hold MAX_LEAVES of them. 0 if this list may be pickled, because a pickle may hold any number."""
        if self.may_pickle:
            return 0
        return sum(description["media"] not in ("text", "json", {"other": TREE}) for description, _ in parts)

    def form(self, value):
        """The method that encodes a value as a single part; None if there is none, or if the value may be pickled and a
        part would lose something of it."""
        if isinstance(value, (bytes, bytearray, memoryview)):
            return self.bytes
        if isinstance(value, str):
            return self.text
        if is_a(value, "numpy", "ndarray"):
            lossless = type(value) is sys.modules["numpy"].ndarray and value.dtype.str[1:] in ELEMENTS
            return self.array if lossless or not self.may_pickle else None
        if is_a(value, "PIL.Image", "Image"):
            return self.picture if value.mode in PIXEL_MODES or not self.may_pickle else None
        return self.tensor if is_a(value, "torch", "Tensor") and not self.may_pickle else None

    def bytes(self, value):
        view = memoryview(value)
        # A view may hold numbers, have several dimensions or be non-contiguous.
        is_bytes = view.format in ("B", "b", "c") and view.ndim == 1 and view.contiguous
        return part("bytes", value if is_bytes else view.tobytes())

    def text(self, value):
        try:
            return part("text", value.encode())
        except UnicodeEncodeError as error:
            text = "a text that is not Unicode cannot be transferred (%s); encode it"
            raise UnsupportedValue(text % error.reason) from None

    def tensor(self, value):
        try:
            return self.array(value.detach().cpu().numpy())
        except (RuntimeError, TypeError) as error:
            text = "a tensor of type %s cannot be transferred (%s); convert it, or %s"
            raise UnsupportedValue(text % (value.dtype, error, OR_PICKLE)) from None

    def array(self, value):
        numpy = sys.modules["numpy"]
        if isinstance(value, numpy.ma.MaskedArray) and numpy.ma.is_masked(value):
            text = "a masked array cannot be transferred, because its mask would be lost; fill it, or "
            raise UnsupportedValue(text + OR_PICKLE)
        element = ELEMENTS.get(value.dtype.str[1:])
        if element is None:
            text = "an array of type %s cannot be transferred; convert it, or %s"
            raise UnsupportedValue(text % (value.dtype, OR_PICKLE))
        if any(length > MAX_LENGTH for length in value.shape):
            text = "an array of shape %s cannot be transferred; each dimension may be at most %d"
            raise UnsupportedValue(text % (value.shape, MAX_LENGTH))
        value = numpy.ascontiguousarray(value, dtype=DTYPES[element]).reshape(value.shape)
        data = value.reshape(-1).view(numpy.uint8).data if value.size else b""
        return part("tensor", data, value.shape, element)

    def picture(self, value):
        if value.mode in NUMBER_MODES:
            data = value.tobytes()
            if value.mode == "I;16B":
                big_endian, data = data, bytearray(data)
                data[::2], data[1::2] = big_endian[1::2], big_endian[::2]
            return part("tensor", data, (value.height, value.width), NUMBER_MODES[value.mode])
        if value.mode not in PIXEL_MODES:
            try:
                value = value.convert("L" if value.mode in ("1", "LA") else "RGB")
            except ValueError as error:
                text = "a picture of mode %s cannot be transferred (%s); convert it"
                raise UnsupportedValue(text % (value.mode, error)) from None
        name, channels = PIXEL_MODES[value.mode]
        return part({"pixels": name}, value.tobytes(), (value.height, value.width, channels), "u8")

    def needs_no_pickle(self, value, depth=0):
        """Whether nothing of a value is lost without a pickle: the value consists of built-in types and of values that
        have a form."""
        kind = type(value)
        if value is None or kind in (bool, int, float):
            return True
        if depth > 100:
            return False
        if kind in (list, tuple):
            return all(self.needs_no_pickle(item, depth + 1) for item in value)
        if kind is dict:
            return all(type(key) is str and self.needs_no_pickle(item, depth + 1) for key, item in value.items())
        return self.form(value) is not None

    def tree(self, value, leaves, depth):
        """The value as a tree in JSON that distinguishes lists, tuples and dictionaries, and whether plain JSON can represent the
        value, too."""
        if value is None or isinstance(value, (bool, int)):
            return value, True
        if isinstance(value, float):
            return value, math.isfinite(value)
        # A container that contains itself would be nested without end.
        if depth > 100:
            raise UnsupportedValue("a value is nested more than 100 levels deep")
        if isinstance(value, str):
            return value, True
        form = self.form(value)
        if form is not None:
            leaves.append(form(value))
            # The tree itself is part 0, so the first leaf is part 1.
            return {"part": len(leaves)}, False
        if isinstance(value, (list, tuple)):
            items = [self.tree(item, leaves, depth + 1) for item in value]
            tree = [subtree for subtree, _ in items]
            is_json = all(item_is_json for _, item_is_json in items)
            return (tree if isinstance(value, list) else {"tuple": tree}), is_json
        if isinstance(value, dict):
            keys = [self.tree(key, leaves, depth + 1)[0] for key in value]
            if not all(key is None or isinstance(key, (str, int, float)) for key in keys):
                text = "a dictionary whose keys are not strings or numbers cannot be transferred; "
                raise UnsupportedValue(text + OR_PICKLE)
            items = [self.tree(item, leaves, depth + 1) for item in value.values()]
            is_json = all(isinstance(key, str) for key in keys) and all(item_is_json for _, item_is_json in items)
            return {"dict": [[key, item] for key, (item, _) in zip(keys, items)]}, is_json
        if is_a(value, "numpy", "generic") and value.dtype.kind in "biuf":
            number = value.item()
            # If Python has no matching type, item() returns a numpy scalar again.
            if isinstance(number, (bool, int, float)):
                return self.tree(number, leaves, depth)
        kind = type(value)
        raise UnsupportedValue(
            "a %s.%s cannot be transferred; return bytes, text, numbers, arrays, pictures, lists or dictionaries of "
            "them, or %s"
            % (kind.__module__, kind.__qualname__, OR_PICKLE)
        )

    def pickled(self, value):
        buffers = []
        try:
            try:
                data = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
                buffers = [buffer.raw() for buffer in buffers]
            except BufferError:
                # raw() refuses a buffer that is not contiguous. The pickle then contains all data itself.
                buffers = None
            if buffers is None or len(buffers) > MAX_LEAVES:
                data, buffers = pickle.dumps(value, protocol=5), []
        except Exception as error:
            raise UnsupportedValue("a %s cannot be pickled: %s" % (type(value).__qualname__, error)) from None
        return [part({"other": PICKLE}, data)] + [part("bytes", buffer) for buffer in buffers]


# --- Parts to Python ---


class Decoder:
    """Converts parts to a Python value."""

    def __init__(self, may_pickle, images):
        self.may_pickle = may_pickle
        self.images = images

    def read(self, channel, part_heads):
        """The value of the next parts. All parts are read, even if one is invalid."""
        first_media = part_heads[0]["description"]["media"] if part_heads else None
        custom_media = first_media.get("other") if isinstance(first_media, dict) else None
        values, first_error = [], None
        for part_head in part_heads:
            description = part_head["description"]
            try:
                if custom_media == PICKLE:
                    values.append(channel.array(part_head))
                elif description["media"] == "tensor":
                    values.append(self.array(description, channel.array(part_head)))
                else:
                    values.append(self.value(description, channel.bytes(part_head)))
            except PipeClosed:
                raise
            except Exception as error:
                # The other parts still have to be read.
                first_error = first_error or error
        if first_error is not None:
            raise UnsupportedValue(str(first_error) or type(first_error).__name__)
        if custom_media == PICKLE:
            return self.unpickled(values)
        if custom_media == TREE:
            try:
                return from_tree(json.loads(values[0]), values)
            except Exception as error:
                raise UnsupportedValue("a value arrived with invalid containers: %s" % error) from None
        return None if not values else values[0] if len(values) == 1 else tuple(values)

    def value(self, description, data):
        media = description["media"]
        if media == "text":
            return data.decode()
        if media == "json":
            return json.loads(data)
        if isinstance(media, dict) and "pixels" in media:
            return self.pixels(description, data)
        if media in ("jpeg", "png") and self.images == "pil":
            return pil().open(io.BytesIO(data))
        return data

    def array(self, description, data):
        numpy = import_library("numpy", "an array", "python3-numpy", "")
        dtype, shape = DTYPES.get(description["element"]), description["shape"]
        try:
            return numpy.frombuffer(data, dtype="u1" if dtype is None else dtype).reshape(shape if dtype else -1)
        except ValueError as error:
            raise UnsupportedValue("an array does not match its shape: %s" % error) from None

    def pixels(self, description, data):
        height, width, channels = description["shape"]
        if self.images == "pil":
            # Without this check, a peer could make PIL allocate gigabytes with a few bytes: the size of a picture without
            # bytes may be any numbers.
            if channels not in (1, 3) or height * width * channels != len(data):
                text = "a picture of %d x %d pixels and %d channels does not match its %d bytes"
                raise UnsupportedValue(text % (width, height, channels, len(data)))
            mode = "RGB" if channels == 3 else "L"
            if not data:
                return pil().new(mode, (width, height))
            return pil().frombuffer(mode, (width, height), data, "raw", mode, 0, 1)
        if self.images == "numpy":
            numpy = import_library("numpy", "a picture", "python3-numpy", " or set images = 'bytes'")
            return numpy.frombuffer(data, dtype="u1").reshape(height, width, channels)
        return data

    def unpickled(self, parts):
        if not self.may_pickle:
            raise UnsupportedValue(
                "a pickled object arrived and is not unpickled, because that runs code of the sender; "
                "if you trust the sender, set pickle = true here as well"
            )
        try:
            return pickle.loads(parts[0], buffers=parts[1:])
        except Exception as error:
            text = "a pickled object arrived that cannot be unpickled: %s: %s"
            raise UnsupportedValue(text % (type(error).__name__, error)) from None


def pil():
    return import_library("PIL.Image", "a picture", "python3-pil", " or set images = 'numpy' or 'bytes'")


def import_library(module, value_kind, package, alternative):
    try:
        __import__(module)
    except ImportError as error:
        text = "%s arrived and %s cannot be imported (%s); install %s%s"
        raise UnsupportedValue(text % (value_kind, module, error, package, alternative)) from None
    return sys.modules[module]


def from_tree(tree, parts):
    """The value of a tree. The first of `parts` is the tree itself, the others are its leaves."""
    if isinstance(tree, list):
        return [from_tree(item, parts) for item in tree]
    if not isinstance(tree, dict):
        return tree
    if "part" in tree:
        return parts[tree["part"]]
    if "tuple" in tree:
        return tuple(from_tree(item, parts) for item in tree["tuple"])
    return {key: from_tree(item, parts) for key, item in tree["dict"]}


