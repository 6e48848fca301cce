# The border of the process: the protocol's two pipes, and the memory that both sides have.
import mmap
import os

MARK = b"PN1\n"
# Parts shorter than this cross in the pipe, with the header: a page.
LEAST = 4096
# Every part in the shared memory begins at a multiple of this: a cache line.
ALIGNMENT = 64


class Border:
    """What crosses it; the user's code has other pipes in the place of these."""

    def __init__(self):
        self.source = os.fdopen(os.dup(0), "rb", 1 << 13)
        self.sink = os.dup(1)
        self.window = None
        # Requests with equal headers follow each other where all samples are alike.
        self.header, self.request = b"", None
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        # What the user prints goes where their errors go.
        os.dup2(2, 1)
        sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")
        # A process that the user forks has no business with the pipes.
        os.register_at_fork(after_in_child=self.forget)

    def share(self, number):
        """From now on there is shared memory, in the inherited file of this number."""
        self.window = Window(number)

    def forget(self):
        os.close(self.source.fileno())
        os.close(self.sink)
        if self.window is not None:
            os.close(self.window.file)

    def read(self):
        """The next request, or None at the end."""
        prefix = self.source.read(8)
        if len(prefix) < 8:
            return None
        if prefix[:4] != MARK:
            raise RuntimeError("the request begins with %r" % prefix)
        header = self.piped(int.from_bytes(prefix[4:], "little"))
        if header != self.header:
            self.header, self.request = header, json.loads(header)
        return self.request

    def bytes(self, head):
        """The content of a part."""
        return self.piped(head["length"]) if head.get("at") is None else self.window.bytes(head["at"], head["length"])

    def array(self, head):
        """The content of a part that may be written to: arrays that a user gets can be worked on in place."""
        length = head["length"]
        empty = getattr(sys.modules.get("numpy"), "empty", None)
        data = bytearray(length) if empty is None else empty(length, "u1")
        if head.get("at") is not None:
            memoryview(data)[:] = self.window.view(head["at"], length)
        elif self.source.readinto(data) < length:
            raise Gone
        return data

    def piped(self, length):
        data = self.source.read(length)
        if len(data) < length:
            raise Gone
        return data

    def write(self, kind, body):
        self.send(self.frame(kind, body))

    def frame(self, kind, body, parts=()):
        """What is to be sent; large parts are in the shared memory by then."""
        piped = []
        if parts:
            parts = [(description, memoryview(data)) for description, data in parts]
            length = sum(data.nbytes for _, data in parts)
            if length > MAX_BYTES:
                raise Refused("a value has %d bytes; at most %d cross" % (length, MAX_BYTES))
            body["parts"] = heads = []
            end = 0
            for description, data in parts:
                head = {"description": description, "length": data.nbytes}
                heads.append(head)
                if data.nbytes >= LEAST:
                    head["at"] = -(-end // ALIGNMENT) * ALIGNMENT
                    end = head["at"] + data.nbytes
                    try:
                        self.window.put(head["at"], data.cast("B"))
                    except (MemoryError, OSError) as error:
                        raise Refused("there is no memory for a value of %d bytes: %s" % (length, error)) from None
                elif data.nbytes:
                    piped.append(data.cast("B"))
        header = to_json({kind: body}).encode()
        return [memoryview(MARK + len(header).to_bytes(4, "little") + header)] + piped

    def send(self, chunks):
        while chunks:
            written = os.writev(self.sink, chunks)
            while chunks and written >= len(chunks[0]):
                written -= len(chunks.pop(0))
            if written:
                chunks[0] = chunks[0][written:]


class Window:
    """Memory that both sides have. It can grow, never shrink; nobody writes while the other reads."""

    def __init__(self, file):
        self.file = file
        # A program that the user starts has no business with it.
        os.set_inheritable(file, False)
        self.map = mmap.mmap(file, 0)

    def reach(self, end):
        """The memory, mapped up to there."""
        if len(self.map) < end:
            length = 1 << (end - 1).bit_length()
            if os.fstat(self.file).st_size < length:
                os.ftruncate(self.file, length)
            self.map = mmap.mmap(self.file, length)
        return self.map

    def bytes(self, at, length):
        return self.reach(at + length)[at : at + length]

    def view(self, at, length):
        return memoryview(self.reach(at + length))[at : at + length]

    def put(self, at, data):
        self.reach(at + len(data))[at : at + len(data)] = data


