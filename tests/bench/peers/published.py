"""One end of a Python program that does the paper's program's work, for `loop.py` and `python.py`.

Two pyzmq PAIR sockets, one per direction; the sender binds start_port + the receiver's number. A message is the pickle
of (data, logger), and the logger's six nodes travel with it. `upload` is opened by the client before it pickles and
closed by the server after it unpickled, `download` the other way. Sizes are taken by pickling once more, on the client,
before and after the exchange. The server polls, and writes a line of log per message; the client rewrites its results
every 1,000 iterations. The model is an echo.

Server: published.py server OWN-ADDRESS PEER-ADDRESS [--answer-bytes N]
Client: published.py client OWN-ADDRESS PEER-ADDRESS --bytes N --seconds S --results FILE; prints JSON
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import pickle
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zmq

from peers.published_logger import Container, Node, Timer, Timing, Value, write_csv
from quantiles import spread

START_PORT = 5551
# Numbers of the two ends, from which their ports follow.
NUMBERS = {"client": 0, "server": 1}
WARM_UP = 200
LARGE_BLOCK = 512 << 10
STAGES = ("sensing", "upload", "inference", "download")


@dataclass
class Message:
    data: Any
    logger: Node


class Link:
    """Both sockets of one end."""

    def __init__(self, role: str, own: str, peer: str) -> None:
        other = "client" if role == "server" else "server"
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        self.outgoing = context.socket(zmq.PAIR)
        self.outgoing.bind(f"tcp://{own}:{START_PORT + NUMBERS[other]}")
        self.incoming = context.socket(zmq.PAIR)
        self.incoming.connect(f"tcp://{peer}:{START_PORT + NUMBERS[role]}")

    def send(self, message: Message) -> None:
        self.outgoing.send_pyobj(message)

    def receive(self) -> Message:
        message: Message = self.incoming.recv_pyobj()
        return message


def serve(link: Link, answer_bytes: int | None) -> None:
    fixed = None if answer_bytes is None else os.urandom(answer_bytes)
    log = logging.getLogger("server")
    log.setLevel(logging.DEBUG)
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(name)s - %(levelname)s - %(message)s (%(filename)s:%(lineno)d)"))
    log.addHandler(handler)
    poller = zmq.Poller()
    poller.register(link.incoming, zmq.POLLIN)
    while True:
        poller.poll()
        message = link.receive()
        logger = message.logger
        logger.end_sub("upload")
        inference = logger.child("inference")
        inference.start_collection()
        answer = message.data if fixed is None else fixed
        inference.end_collection()
        logger.child("download").start_collection()
        log.debug("answering %s", "client")
        link.send(Message(answer, logger))


def iterate(link: Link, sample: bytes, number: int) -> Node:
    logger: Node = Container(str(number))
    with Timing(logger, "sensing"):
        data = sample
    for name, kind in (("upload", Timer), ("inference", Timer), ("download", Timer), ("upload-bytes", Value)):
        logger.log_section(name, kind)
    message = Message(data, logger)
    up, up_logger = (sys.getsizeof(pickle.dumps(one)) for one in (message, logger))
    logger.child("upload").start_collection()
    link.send(message)
    answer = link.receive()
    logger = answer.logger
    logger.end_sub("download")
    down, down_logger = (sys.getsizeof(pickle.dumps(one)) for one in (answer, logger))
    logger.end_sub("upload-bytes", up)
    for name, value in (
        ("upload-logger-bytes", up_logger),
        ("download-bytes", down),
        ("download-logger-bytes", down_logger),
        ("upload-throughput", 8 * up / logger.get_metric("upload")),
        ("download-throughput", 8 * down / logger.get_metric("download")),
    ):
        logger.log_section(name, Value).end_collection(value)
    return logger


def drive(link: Link, arguments: argparse.Namespace) -> dict[str, Any]:
    sample = os.urandom(arguments.bytes)
    for number in range(WARM_UP):
        iterate(link, sample, number)
    iterations: list[Node] = []
    begin = now = time.perf_counter()
    while now - begin < arguments.seconds:
        iterations.append(iterate(link, sample, len(iterations)))
        if len(iterations) % 1000 == 0:
            write_csv(arguments.results, iterations)
        now = time.perf_counter()
    return {
        "iterations": len(iterations),
        "seconds": now - begin,
        "stages": {name: spread(one.get_metric(name) for one in iterations) for name in STAGES},
    }


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("role", choices=tuple(NUMBERS))
    parser.add_argument("own")
    parser.add_argument("peer")
    parser.add_argument("--bytes", type=int, default=1000)
    parser.add_argument("--answer-bytes", type=int)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--results", type=Path, default=Path(os.devnull))
    arguments = parser.parse_args()
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # The paper's program imports pandas. When pandas frees a large block, malloc raises its threshold for mmap and from
    # then on keeps freed blocks. This block has the same effect; without it, messages of 150 kB take twice as long.
    del bytearray(LARGE_BLOCK)[:]
    link = Link(arguments.role, arguments.own, arguments.peer)
    if arguments.role == "server":
        serve(link, arguments.answer_bytes)
    else:
        print(json.dumps(drive(link, arguments)))


if __name__ == "__main__":
    main()
