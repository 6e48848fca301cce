"""An edge in the session protocol: a DEALER of libzmq. Everything here is described in docs/session-protocol.md."""
import time
import uuid

import msgpack
import zmq

PROTOCOL = 4
# Time limit of an answer. Seconds.
TIMEOUT_S = 30
# Number of the standard name of the root of a request's tree.
ITERATION = 0
# Number of the node kind "container".
CONTAINER = 0


class Refused(Exception):
    """The cloud refused the session."""


def boot_id():
    with open("/proc/sys/kernel/random/boot_id") as file:
        return file.read().strip()


class Session:
    """A session with a cloud; requests may be sent before earlier ones are answered."""

    def __init__(self, context, address, model=None, pipeline="pyzmq"):
        self.socket = context.socket(zmq.DEALER)
        self.socket.setsockopt(zmq.LINGER, 1000)
        self.socket.setsockopt(zmq.RCVTIMEO, TIMEOUT_S * 1000)
        self.socket.connect(address)
        self.host = uuid.uuid4().bytes
        self.next_request = 0
        hello = {
            "protocol": PROTOCOL,
            "host": self.host,
            "name": "pyzmq-edge",
            "clock": {"boot": boot_id(), "clock": "system"},
            "pipeline": pipeline,
            "model": model,
            "device": None,
        }
        self.send_header({"open": {"hello": hello, "max_message_bytes": 1 << 30}})
        kind, content = self.receive()[0]
        if kind == "refused":
            self.socket.close()
            raise Refused(content["reason"])
        assert kind == "accepted", kind
        assert content["protocol"] == PROTOCOL
        self.accepted, self.id = content["accepted"], content["session"]

    def send_header(self, header, *frames):
        self.socket.send_multipart([msgpack.packb(header), *frames])

    def receive(self):
        """Returns the kind, content and further frames of the next message. Clock updates are skipped."""
        while True:
            header, *frames = self.socket.recv_multipart()
            [(kind, content)] = msgpack.unpackb(header).items()
            if kind != "clock":
                return (kind, content), frames

    def request(self, parts, descriptions=None, source="pyzmq", label=None):
        """Sends a sample and returns the number of the request."""
        number, self.next_request = self.next_request, self.next_request + 1
        descriptions = descriptions or [["bytes", [], None] for _ in parts]
        wall, mono = time.time_ns(), time.monotonic_ns()
        tree = msgpack.packb([1, [[self.host, wall]], [[None, ITERATION, 0, 0, CONTAINER]]])
        # The last element is the epoch, which may be 0.
        departure = [time.time_ns(), time.monotonic_ns() - mono, 0]
        header = {"request": [self.id, number, departure, [descriptions, source, label]]}
        self.send_header(header, tree, *parts)
        return number

    def answer(self):
        """Returns the number of the next answered request, the parts of its answer and the cloud's nodes."""
        (kind, content), frames = self.receive()
        assert kind == "reply", (kind, content)
        session, number, _departure, _epoch, outcome = content
        assert session == self.id
        [(outcome, detail)] = outcome.items()
        assert outcome == "answer", (outcome, detail)
        tree_delta, *parts = frames
        version, base, anchor, anchors, closed, received, nodes = msgpack.unpackb(tree_delta)
        # The request's tree has only the root, at position 0. The receiver adds `upload` at position 1 and closes
        # `upload`.
        assert (version, base, closed) == (1, 2, 1), (version, base, closed)
        assert anchor[0] == self.accepted["host"] and not anchors
        assert received > 0
        # The sample of an answer begins with the descriptions of its parts.
        assert len(detail[0]) == len(parts)
        return number, parts, nodes

    def close(self, reason="finished"):
        self.send_header({"goodbye": {"session": self.id, "reason": reason}})
        self.socket.close()
