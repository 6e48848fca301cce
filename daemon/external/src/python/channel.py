# Part of the worker's source: mod.rs concatenates its files. values.py imports json and sys, and defines the
# limits, the exceptions and to_json.
#
# The channel to the daemon: two pipes and shared memory.
import mmap
import os

MESSAGE_PREFIX = b"PN1\n"
# Parts shorter than this (one page of memory) are sent through the pipe, after the header.
MIN_SHARED_BYTES = 4096
# Every part in the shared memory begins at a multiple of this (one cache line).
ALIGNMENT = 64


class Channel:
    """Reads requests and writes replies. Custom code gets other standard streams."""

    def __init__(self):
        self.source = os.fdopen(os.dup(0), "rb", 1 << 13)
        self.sink = os.dup(1)
        self.memory = None
        # Consecutive requests often have equal headers, so a header that equals the previous header is not parsed again.
        self.header, self.request = b"", None
        null_device = os.open(os.devnull, os.O_RDONLY)
        os.dup2(null_device, 0)
        os.close(null_device)
        # The output of custom code goes to standard error.
        os.dup2(2, 1)
        sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")
        # A forked process must not use the pipes.
        os.register_at_fork(after_in_child=self.close_in_child)

    def map_shared_memory(self, descriptor):
        """Maps the shared memory in the inherited file descriptor."""
        self.memory = SharedMemory(descriptor)

    def close_in_child(self):
        os.close(self.source.fileno())
        os.close(self.sink)
        if self.memory is not None:
            os.close(self.memory.descriptor)

    def read(self):
        """The next request, or None if the daemon has closed the pipe."""
        prefix = self.source.read(8)
        if len(prefix) < 8:
            return None
        if prefix[:4] != MESSAGE_PREFIX:
            raise RuntimeError("the request begins with %r" % prefix)
        header = self.read_exactly(int.from_bytes(prefix[4:], "little"))
        if header != self.header:
            self.header, self.request = header, json.loads(header)
        return self.request

    def bytes(self, part_head):
        """The content of a part. Its head is its entry in the header; without `at`, the part comes through the pipe."""
        if part_head.get("at") is None:
            return self.read_exactly(part_head["length"])
        return self.memory.bytes(part_head["at"], part_head["length"])

    def array(self, part_head):
        """The content of a part in writable memory, so that custom code can change arrays in place."""
        length = part_head["length"]
        empty = getattr(sys.modules.get("numpy"), "empty", None)
        data = bytearray(length) if empty is None else empty(length, "u1")
        if part_head.get("at") is not None:
            memoryview(data)[:] = self.memory.view(part_head["at"], length)
        elif self.source.readinto(data) < length:
            raise PipeClosed
        return data

    def read_exactly(self, length):
        data = self.source.read(length)
        if len(data) < length:
            raise PipeClosed
        return data

    def write(self, kind, body):
        self.send(self.frame(kind, body))

    def frame(self, kind, body, parts=()):
        """Copies large parts to the shared memory. Returns the chunks to send through the pipe."""
        pipe_chunks = []
        if parts:
            parts = [(description, memoryview(data)) for description, data in parts]
            length = sum(data.nbytes for _, data in parts)
            if length > MAX_BYTES:
                raise UnsupportedValue(TOO_MANY_BYTES % (length, MAX_BYTES))
            body["parts"] = part_heads = []
            end = 0
            for description, data in parts:
                part_head = {"description": description, "length": data.nbytes}
                part_heads.append(part_head)
                if data.nbytes >= MIN_SHARED_BYTES:
                    part_head["at"] = -(-end // ALIGNMENT) * ALIGNMENT
                    end = part_head["at"] + data.nbytes
                    try:
                        self.memory.put(part_head["at"], data.cast("B"))
                    except (MemoryError, OSError) as error:
                        text = "not enough memory for a value of %d bytes: %s"
                        raise UnsupportedValue(text % (length, error)) from None
                elif data.nbytes:
                    pipe_chunks.append(data.cast("B"))
        header = to_json({kind: body}).encode()
        return [memoryview(MESSAGE_PREFIX + len(header).to_bytes(4, "little") + header)] + pipe_chunks

    def send(self, chunks):
        while chunks:
            written = os.writev(self.sink, chunks)
            while chunks and written >= len(chunks[0]):
                written -= len(chunks.pop(0))
            if written:
                chunks[0] = chunks[0][written:]


class SharedMemory:
    """Memory shared with the daemon. It never shrinks, and one side never writes while the other reads."""

    def __init__(self, descriptor):
        self.descriptor = descriptor
        # A program that custom code starts must not inherit the file.
        os.set_inheritable(descriptor, False)
        self.map = mmap.mmap(descriptor, 0)

    def map_up_to(self, end):
        """The memory, mapped at least up to `end`."""
        if len(self.map) < end:
            length = 1 << (end - 1).bit_length()
            if os.fstat(self.descriptor).st_size < length:
                os.ftruncate(self.descriptor, length)
            self.map = mmap.mmap(self.descriptor, length)
        return self.map

    def bytes(self, at, length):
        return self.map_up_to(at + length)[at : at + length]

    def view(self, at, length):
        return memoryview(self.map_up_to(at + length))[at : at + length]

    def put(self, at, data):
        self.map_up_to(at + len(data))[at : at + len(data)] = data


