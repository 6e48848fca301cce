# The process around a user's object: reads a call, makes it, writes what it gave.
import inspect
import time
import traceback

METHODS = {"sensor": "sample", "model": "infer"}
MAX_TEXT = 4000
# What users say to end the process, and so do; everything else that they raise fails one call.
ENDS = (SystemExit, KeyboardInterrupt)
now = time.monotonic_ns


def found(module, path, method):
    """The user's object, made where it is a class."""
    __import__(module)
    thing = sys.modules[module]
    for name in path.split(".") if path else ():
        if not hasattr(thing, name):
            there = [one for one in vars(thing) if not one.startswith("_")] if hasattr(thing, "__dict__") else []
            raise Refused("%s has no %s; it has %s" % (module, path, ", ".join(there[:20]) or "nothing"))
        thing = getattr(thing, name)
    what = "%s %s" % (kind_of(thing), "%s::%s" % (module, path) if path else module)
    if inspect.isclass(thing):
        thing = thing()
    if not callable(getattr(thing, method, None)):
        raise Refused("the %s has no %s(%s)" % (what, method, "x" if method == "infer" else ""))
    return thing, what


def kind_of(thing):
    if inspect.isclass(thing):
        return "class"
    if inspect.ismodule(thing):
        return "module"
    return "function" if inspect.isfunction(thing) else "object"


def told(module, name):
    """A text that a module says of itself, whatever users put into its place."""
    try:
        text = getattr(sys.modules.get(module), name, None)
        return plain(text) if isinstance(text, str) else None
    except Exception:
        return None


def plain(text):
    """A text that can be written, and not without an end."""
    return str(text)[:MAX_TEXT].encode("utf-8", "backslashreplace").decode()


def finished():
    """Waits until what was given to a GPU is computed, so that it counts where it was caused."""
    # Another thread may be importing it just now.
    cuda = getattr(sys.modules.get("torch"), "cuda", None)
    if hasattr(cuda, "is_initialized") and cuda.is_initialized():
        cuda.synchronize()


def pictures(value):
    """The pictures that a value is or holds."""
    held = value.values() if isinstance(value, dict) else value if isinstance(value, (list, tuple)) else (value,)
    return [one for one in held if is_a(one, "PIL.Image", "Image")] if len(held) <= MAX_LEAVES else []


class Sensor:
    def __init__(self, thing):
        self.thing = thing

    def call(self, _, stages):
        begun = now()
        try:
            value = self.thing.sample()
            # PIL opens files lazily; decoding them is part of having a sample.
            for picture in pictures(value):
                picture.load()
            finished()
        finally:
            stages.append(("sample", begun, now()))
        return value


class Model:
    def __init__(self, thing):
        steps = (("preprocess", "preprocess"), ("infer", "infer"), ("postprocess", "postprocess"))
        self.steps = [(stage, getattr(thing, name)) for stage, name in steps if callable(getattr(thing, name, None))]

    def call(self, value, stages):
        for stage, step in self.steps:
            begun = now()
            try:
                value = step(value)
                finished()
            finally:
                stages.append((stage, begun, now()))
        return value


def text_of(error):
    """An exception in one line, then its traceback from the user's first frame on, then bounded."""
    trace = error.__traceback__
    while trace is not None and trace.tb_frame.f_code.co_filename.startswith(("<peernet>", "<frozen importlib")):
        trace = trace.tb_next
    line = "".join(traceback.format_exception_only(type(error), error)).strip()
    if trace is None and error.__cause__ is None and error.__context__ is None:
        return line
    lines = "".join(traceback.format_exception(type(error), error, trace)).strip()
    return line[: MAX_TEXT // 4] + "\n" + lines


def fail(border, kind, text, stages):
    # Half a character cannot be written, whoever put it into a message.
    text = text.encode("utf-8", "backslashreplace").decode()
    if len(text) > MAX_TEXT:
        text = text[: MAX_TEXT // 2] + "\n  …\n" + text[-MAX_TEXT // 2 :]
    border.write(kind, {"text": text, "stages": stages})


def start(request):
    settings = request["start"]
    sys.path[:] = [""] + [place for place in sys.path if place != ""]
    sys.argv[:] = [settings["module"]]
    if settings["role"] == "model" and settings["images"] == "pil":
        # So that the first picture does not wait for it.
        try:
            import PIL.Image  # noqa: F401
        except ImportError:
            pass
    # What opens the pictures that a model is given is one of its libraries, whoever imports it.
    folder, before = os.getcwd(), set(sys.modules) - {"PIL"}
    thing, what = found(settings["module"], settings["path"], METHODS[settings["role"]])
    role = Sensor(thing) if settings["role"] == "sensor" else Model(thing)
    version = ".".join(str(number) for number in sys.version_info[:3])
    about = {"what": what, "python": version, "executable": plain(sys.executable or "")}
    about.update(made_of(settings["module"], folder, before))
    return role, about, Encoder(settings["pickle"]), Decoder(settings["pickle"], settings["images"])


def answer(border, request, role, encoder, decoder):
    stages = []
    try:
        value = decoder.read(border, request["call"]["parts"])
        value = role.call(value, stages)
        frame = border.frame("value", {"stages": stages, "parts": []}, encoder.parts(value))
    except (Gone, *ENDS):
        raise
    except Refused as error:
        fail(border, "refused", str(error), stages)
    except BaseException as error:
        if isinstance(error, StopIteration) and isinstance(role, Sensor):
            border.write("over", {"stages": stages})
        else:
            fail(border, "raised", text_of(error), stages)
    else:
        border.send(frame)


def main():
    border = Border()
    request = border.read()
    border.share(request["start"]["window"])
    try:
        role, about, encoder, decoder = start(request)
    except ENDS:
        raise
    except Refused as error:
        return fail(border, "refused", str(error), [])
    except BaseException as error:
        return fail(border, "raised", text_of(error), [])
    border.write("ready", about)
    while True:
        request = border.read()
        if request is None:
            return None
        answer(border, request, role, encoder, decoder)


main()
