"""A server with the chat API of OpenAI that streams scripted answers, and programs that only read its streams.

    token_server.py serve BURST PACED INTERVAL-MS STAMPS    serves until it is stopped; prints its port
    token_server.py read PORT MODEL COUNT [--parse]         reads COUNT streams; prints JSON

The name of the model in the request selects the answer: `burst` sends BURST tokens at once; `paced` sends PACED tokens,
one each INTERVAL-MS; `whole` sends a text of WHOLE_BYTES in one token. The server answers one request at a time. For
each answer it appends a line of JSON to the file STAMPS: the model, and four times in nanoseconds since 1970: request
received, just before the first token, just before the last token, and end written. `read` drops the bytes; with
`--parse` it parses the JSON of each event first.
"""

from __future__ import annotations

import argparse
import json
import socket
import sys
import time
from pathlib import Path
from typing import Any

MODELS = ("burst", "paced", "whole")
WHOLE_BYTES = 1_000
END = b"0\r\n\r\n"
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n\r\n"


def event(data: str) -> bytes:
    """Returns a server-sent event as one chunk of HTTP."""
    body = f"data: {data}\n\n".encode()
    return b"%x\r\n%s\r\n" % (len(body), body)


def completion(model: str, choices: list[dict[str, Any]], **more: object) -> bytes:
    head = {"id": "chatcmpl-1", "object": "chat.completion.chunk", "created": 1_700_000_000, "model": model}
    return event(json.dumps({**head, "choices": choices, **more}, separators=(",", ":")))


def token(model: str, text: str) -> bytes:
    return completion(model, [{"index": 0, "delta": {"content": text}, "finish_reason": None}])


class Server:
    """Server whose answers are encoded in advance, so it adds little time."""

    def __init__(self, burst: int, paced: int, interval_s: float, stamps: Path) -> None:
        self.interval_s = interval_s
        self.stamps = stamps
        # By model: the encoded tokens, and the encoded end of the stream.
        self.answers: dict[str, tuple[list[bytes], bytes]] = {}
        for model, count in zip(MODELS, (burst, paced, 1), strict=True):
            texts = ["x" * WHOLE_BYTES] if model == "whole" else [f" t{number:04}" for number in range(count)]
            usage = {"prompt_tokens": 8, "completion_tokens": len(texts), "total_tokens": 8 + len(texts)}
            end = completion(model, [{"index": 0, "delta": {}, "finish_reason": "stop"}])
            end += completion(model, [], usage=usage) + event("[DONE]") + END
            self.answers[model] = [token(model, text) for text in texts], end

    def serve(self) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        print(listener.getsockname()[1], flush=True)
        while True:
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._answer(connection)

    def _answer(self, connection: socket.socket) -> None:
        with connection:
            try:
                head, body = receive_request(connection)
                if head.startswith(b"GET"):
                    models = json.dumps({"object": "list", "data": [{"id": model} for model in MODELS]}).encode()
                    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nConnection: close\r\n")
                    connection.sendall(b"Content-Length: %d\r\n\r\n%s" % (len(models), models))
                else:
                    self._stream(connection, json.loads(body)["model"])
            except (ConnectionError, EOFError):
                pass

    def _stream(self, connection: socket.socket, model: str) -> None:
        tokens, end = self.answers[model]
        received = time.time_ns()
        if model == "paced":
            connection.sendall(HEAD)
            due = time.monotonic()
            first = 0
            for one in tokens:
                due += self.interval_s
                time.sleep(max(0.0, due - time.monotonic()))
                last = time.time_ns()
                first = first or last
                connection.sendall(one)
            connection.sendall(end)
        else:
            first = last = time.time_ns()
            connection.sendall(HEAD + b"".join(tokens) + end)
        stamps = {"model": model, "received": received, "first": first, "last": last, "ended": time.time_ns()}
        with self.stamps.open("a") as file:
            file.write(json.dumps(stamps) + "\n")


def receive_request(connection: socket.socket) -> tuple[bytes, bytes]:
    """Returns head and body of a request."""
    data = b""
    while b"\r\n\r\n" not in data:
        data += receive(connection)
    head, _, body = data.partition(b"\r\n\r\n")
    length = 0
    for line in head.split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        if name.lower() == b"content-length":
            length = int(value)
    while len(body) < length:
        body += receive(connection)
    return head, body


def receive(connection: socket.socket) -> bytes:
    data = connection.recv(65_536)
    if not data:
        raise EOFError
    return data


def read(port: int, model: str, count: int, parse: bool) -> list[dict[str, float]]:
    """Reads answers one after the other; the first one is warm-up and is left out.

    Returns for each answer its start, seconds since 1970, and the seconds from there to its first token and to its end.
    """
    messages = [{"role": "user", "content": "x" * 100}]
    body = json.dumps({"model": model, "messages": messages, "stream": True}).encode()
    request = b"POST /v1/chat/completions HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
    request += b"Content-Length: %d\r\n\r\n%s" % (len(body), body)
    times = []
    for _ in range(count + 1):
        at, begin, first = time.time(), time.perf_counter(), 0.0
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall(request)
            rest = b""
            while not rest.endswith(END):
                data = receive(connection)
                if not first and b'"content"' in data:
                    first = time.perf_counter() - begin
                # The end may be divided between two reads.
                rest = parse_events(rest + data) if parse else (rest + data)[-len(END) :]
        total = time.perf_counter() - begin
        times.append({"at": at, "first": first, "total": total})
    return times[1:]


def parse_events(data: bytes) -> bytes:
    """Parses all complete events, and returns the bytes after them."""
    *events, rest = data.split(b"\n\n\r\n")
    for one in events:
        _, _, text = one.partition(b"data: ")
        if text != b"[DONE]":
            json.loads(text)
    return rest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    serve = commands.add_parser("serve")
    serve.add_argument("burst", type=int)
    serve.add_argument("paced", type=int)
    serve.add_argument("interval_ms", type=float)
    serve.add_argument("stamps", type=Path)
    reader = commands.add_parser("read")
    reader.add_argument("port", type=int)
    reader.add_argument("model", choices=MODELS)
    reader.add_argument("count", type=int)
    reader.add_argument("--parse", action="store_true")
    arguments = parser.parse_args()
    if arguments.command == "serve":
        Server(arguments.burst, arguments.paced, arguments.interval_ms / 1e3, arguments.stamps).serve()
    else:
        json.dump(read(arguments.port, arguments.model, arguments.count, arguments.parse), sys.stdout)


if __name__ == "__main__":
    main()
