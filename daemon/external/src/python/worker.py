# Part of the worker's source: mod.rs concatenates its files. values.py imports math and sys.
#
# The worker process of a custom object: reads a request, calls the object and writes the result.
import inspect
import numbers
import time
import traceback

METHODS = {"sensor": "sample", "model": "infer", "actuator": "act"}
ARGUMENTS = {"sample": "", "infer": "x", "act": "answer"}
# Keys of the dictionary that act() may return. The first two have truth values.
FEEDBACK_KEYS = ("episode_ended", "success", "reward")
# Limit of the length of a text, in characters.
MAX_TEXT = 4000
# Exceptions that end the process; every other exception fails one call.
EXITS = (SystemExit, KeyboardInterrupt)
now = time.monotonic_ns


def load_object(module, path, method):
    """The custom object, and its description as text. A class is instantiated."""
    __import__(module)
    custom_object = sys.modules[module]
    for name in path.split(".") if path else ():
        if not hasattr(custom_object, name):
            names = defined_names(custom_object, module)
            raise UnsupportedValue("%s has no %s; it defines %s" % (module, path, ", ".join(names[:20]) or "nothing"))
        custom_object = getattr(custom_object, name)
    what = "%s %s" % (kind_of(custom_object), "%s::%s" % (module, path) if path else module)
    if inspect.isclass(custom_object):
        custom_object = custom_object()
    if not callable(getattr(custom_object, method, None)):
        raise UnsupportedValue("the %s has no %s(%s)" % (what, method, ARGUMENTS[method]))
    return custom_object, what


def defined_names(custom_object, module):
    """The public classes, functions and objects of a module or class, without those that the module imports from elsewhere."""
    def is_own(value):
        # An instance has the __module__ of its class; modules and plain values have none.
        return (str(getattr(value, "__module__", "")) + ".").startswith(module + ".")
    names = getattr(custom_object, "__dict__", {})
    return [name for name, value in names.items() if not name.startswith("_") and is_own(value)]


def kind_of(custom_object):
    if inspect.isclass(custom_object):
        return "class"
    if inspect.ismodule(custom_object):
        return "module"
    return "function" if inspect.isfunction(custom_object) else "object"


def module_text(module, name):
    """The text of an attribute of a module; None if it is missing or not a text."""
    try:
        text = getattr(sys.modules.get(module), name, None)
        return bounded_utf8(text) if isinstance(text, str) else None
    except Exception:
        return None


def bounded_utf8(text):
    """The text as valid UTF-8 of limited length."""
    return str(text)[:MAX_TEXT].encode("utf-8", "backslashreplace").decode()


def wait_for_gpu():
    """Waits until the GPU is idle, so that the work of the GPU counts for the stage that started it."""
    # Another thread may be importing torch.
    cuda = getattr(sys.modules.get("torch"), "cuda", None)
    if hasattr(cuda, "is_initialized") and cuda.is_initialized():
        cuda.synchronize()


def pictures(value):
    """The value if it is a picture, or the pictures in it. A container of over MAX_LEAVES items is not searched."""
    items = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else (value,)
    return [item for item in items if is_a(item, "PIL.Image", "Image")] if len(items) <= MAX_LEAVES else []


class Cancelled(Exception):
    """Ends a call whose answer nobody waits for any more."""


# Advice after the reason why the values that infer() yielded cannot be the whole answer.
RETURN_ADVICE = (
    "; infer() yielded %d values and returned none, "
    "so the yielded values are the whole answer: let infer() return another whole answer"
)
# A value that infer() yields counts for at least this number of bytes, so that the number of values in memory is
# limited, too.
MIN_YIELDED_BYTES = 64


class YieldedValues:
    """The values that infer() yielded. They are kept only while they are within the limits of one answer, because
    infer() may yield without end. Beyond the limits, infer() must return the whole answer."""

    def __init__(self):
        self.values = []
        self.count = self.leaves = self.bytes = 0

    def add(self, value, size):
        """Adds a value. `size` is a pair: its number of bytes, and its number of arrays, pictures and byte strings."""
        self.count += 1
        self.bytes += max(size[0], MIN_YIELDED_BYTES)
        self.leaves += size[1]
        if self.values is not None:
            self.values.append(value)
            if self.limit_text() is not None:
                self.values = None

    def limit_text(self):
        """The limit that the values exceed as one answer; None if they exceed none."""
        if self.leaves > MAX_LEAVES:
            return TOO_MANY_LEAVES % (self.leaves, MAX_LEAVES)
        return TOO_MANY_BYTES % (self.bytes, MAX_BYTES) if self.bytes > MAX_BYTES else None

    def whole_answer(self):
        """All values as one answer, and whether this answer is the list of the values."""
        if self.values is None:
            raise UnsupportedValue(self.limit_text() + RETURN_ADVICE % self.count)
        if all(isinstance(value, str) for value in self.values):
            return "".join(self.values), False
        return self.values, True


def send_partial_answers(generator, send_partial_answer):
    """Sends each value that infer() yields as a partial answer. Returns the whole answer, and whether it is the list of the
    yielded values. The whole answer is the value that infer() returns; if it returns none, all yielded values."""
    yielded = YieldedValues()
    while True:
        try:
            partial_answer = next(generator)
        except StopIteration as end:
            return (end.value, False) if end.value is not None else yielded.whole_answer()
        size = send_partial_answer(partial_answer)
        # send_partial_answer() returns None if nobody waits for the answer.
        if size is None:
            generator.close()
            raise Cancelled("nobody waits for the answer any more")
        yielded.add(partial_answer, size)


class Sensor:
    def __init__(self, custom_object):
        self.custom_object = custom_object

    def call(self, _, stages, send_partial_answer):
        started_at = now()
        try:
            value = self.custom_object.sample()
            # PIL decodes files lazily; decoding is part of taking the sample.
            for picture in pictures(value):
                picture.load()
            wait_for_gpu()
        finally:
            stages.append(("sample", started_at, now()))
        return value


class Actuator:
    def __init__(self, custom_object):
        self.custom_object = custom_object

    def call(self, value, stages, send_partial_answer):
        started_at = now()
        try:
            returned = self.custom_object.act(value)
            wait_for_gpu()
        finally:
            stages.append(("act", started_at, now()))
        return feedback(returned)


def feedback(returned):
    """The dictionary that act() returned, with the numbers and truth values of numpy converted to those of Python."""
    if returned is None:
        return None
    if not isinstance(returned, dict):
        raise UnsupportedValue("act() returned a %s; return None, or a dict with %s" % (kind_name(returned), ", ".join(FEEDBACK_KEYS)))
    for key in returned:
        if key not in FEEDBACK_KEYS:
            raise UnsupportedValue("act() returned the key %r; the keys are %s" % (key, ", ".join(FEEDBACK_KEYS)))
    for key in FEEDBACK_KEYS[:2]:
        value = returned.get(key)
        is_zero_or_one = isinstance(value, numbers.Integral) and value in (0, 1)
        if value is not None and not is_zero_or_one and not is_truth_value(value):
            raise UnsupportedValue("act() returned %s = %.60r; return True or False" % (key, value))
    reward = returned.get("reward")
    if isinstance(reward, (str, bytes, bytearray)) or is_truth_value(reward):
        raise UnsupportedValue("act() returned reward = %.60r; return a number" % (reward,))
    try:
        result = {key: bool(returned[key]) for key in FEEDBACK_KEYS[:2] if returned.get(key) is not None}
        if reward is not None:
            result["reward"] = float(reward)
    except (TypeError, ValueError) as error:
        raise UnsupportedValue("act() returned a value that cannot be used: %s" % error) from None
    if not math.isfinite(result.get("reward", 0.0)):
        raise UnsupportedValue("act() returned the reward %s, which is not a finite number" % result["reward"])
    return result


def is_truth_value(value):
    """Whether a value is True or False, or such a value of numpy or torch."""
    return isinstance(value, bool) or str(getattr(value, "dtype", "")) in ("bool", "torch.bool")


def kind_name(value):
    kind = type(value)
    return kind.__qualname__ if kind.__module__ == "builtins" else "%s.%s" % (kind.__module__, kind.__qualname__)


class Model:
    def __init__(self, custom_object):
        stages = ("preprocess", "infer", "postprocess")
        methods = ((stage, getattr(custom_object, stage, None)) for stage in stages)
        self.methods = [(stage, method) for stage, method in methods if callable(method)]
        # The list of the values that infer() yielded in the last call, if this list was the whole answer.
        self.yielded = None

    def call(self, value, stages, send_partial_answer):
        for stage, method in self.methods:
            started_at = now()
            try:
                value = method(value)
                if stage == "infer" and inspect.isgenerator(value):
                    value, is_list = send_partial_answers(value, send_partial_answer)
                    self.yielded = value if is_list else None
                wait_for_gpu()
            finally:
                stages.append((stage, started_at, now()))
        return value


ROLES = {"sensor": Sensor, "model": Model, "actuator": Actuator}


def exception_text(error):
    """An exception in one line, then its traceback from the first frame of custom code on."""
    trace = error.__traceback__
    while trace is not None and trace.tb_frame.f_code.co_filename.startswith(("<peernet>", "<frozen importlib")):
        trace = trace.tb_next
    line = "".join(traceback.format_exception_only(type(error), error)).strip()
    if trace is None and error.__cause__ is None and error.__context__ is None:
        return line
    lines = "".join(traceback.format_exception(type(error), error, trace)).strip()
    return line[: MAX_TEXT // 4] + "\n" + lines


def write_failure(channel, kind, text, stages):
    # Lone surrogates cannot be encoded.
    text = text.encode("utf-8", "backslashreplace").decode()
    if len(text) > MAX_TEXT:
        text = text[: MAX_TEXT // 2] + "\n  …\n" + text[-MAX_TEXT // 2 :]
    channel.write(kind, {"text": text, "stages": stages})


def start(request):
    settings = request["start"]
    sys.path[:] = [""] + [entry for entry in sys.path if entry != ""]
    sys.argv[:] = [settings["module"]]
    if settings["role"] == "model" and settings["images"] == "pil":
        # PIL is imported now, so that the first picture does not wait for the import.
        try:
            import PIL.Image  # noqa: F401
        except ImportError:
            pass
    # PIL opens the pictures of a model, so PIL is one of the model's libraries even if the model does not import it.
    folder, modules_before = os.getcwd(), set(sys.modules) - {"PIL"}
    custom_object, what = load_object(settings["module"], settings["path"], METHODS[settings["role"]])
    role = ROLES[settings["role"]](custom_object)
    advances = settings["role"] == "sensor" and callable(getattr(custom_object, "advance", None))
    # A model has no episodes.
    resets = settings["role"] != "model" and callable(getattr(custom_object, "reset", None))
    version = ".".join(str(number) for number in sys.version_info[:3])
    description = {
        "what": what,
        "python": version,
        "executable": bounded_utf8(sys.executable or ""),
        "resets": resets,
        "advances": advances,
    }
    description.update(describe_code(settings["module"], folder, modules_before))
    return role, description, Encoder(settings["pickle"]), Decoder(settings["pickle"], settings["images"])


def answer(channel, request, role, encoder, decoder):
    stages, value = [], None

    def send_partial_answer(value):
        """Sends a partial answer. Returns its size for YieldedValues.add(); None if nobody waits for the answer."""
        wait_for_gpu()
        parts = encoder.parts(value)
        size = sum(memoryview(data).nbytes for _, data in parts), encoder.leaf_count(parts)
        channel.send(channel.frame("part", {"parts": []}, parts))
        reply = channel.read()
        if reply is None:
            raise PipeClosed
        return size if "proceed" in reply else None

    try:
        if "reset" in request:
            value = reset(role.custom_object)
        elif "advance" in request:
            value = advance(role.custom_object, request["advance"]["seconds"])
        else:
            value = role.call(decoder.read(channel, request["call"]["parts"]), stages, send_partial_answer)
        frame = channel.frame("value", {"stages": stages, "parts": []}, encoder.parts(value))
    except (PipeClosed, *EXITS):
        raise
    except UnsupportedValue as error:
        text = str(error)
        # The value that cannot be transferred is the list of the values that infer() yielded.
        if value is not None and value is getattr(role, "yielded", None):
            text += RETURN_ADVICE % len(value)
        write_failure(channel, "refused", text, stages)
    except BaseException as error:
        if isinstance(error, StopIteration) and isinstance(role, Sensor) and "call" in request:
            channel.write("over", {"stages": stages})
        else:
            write_failure(channel, "raised", exception_text(error), stages)
    else:
        channel.send(frame)


def reset(custom_object):
    """Prepares the object for an episode. The value that its reset() returns is ignored: Gymnasium's environments return one."""
    custom_object.reset()
    wait_for_gpu()


def advance(custom_object, seconds):
    """Advances the simulation of a sensor. `seconds` is the time that the last iteration took."""
    custom_object.advance(seconds)
    wait_for_gpu()


def main():
    channel = Channel()
    request = channel.read()
    channel.map_shared_memory(request["start"]["window"])
    try:
        role, description, encoder, decoder = start(request)
    except EXITS:
        raise
    except UnsupportedValue as error:
        return write_failure(channel, "refused", str(error), [])
    except BaseException as error:
        return write_failure(channel, "raised", exception_text(error), [])
    channel.write("ready", description)
    while True:
        request = channel.read()
        if request is None:
            return None
        answer(channel, request, role, encoder, decoder)


main()
