"""An unknown host that sends what no host should, on every port of PEERNet, for a bounded time at a bounded rate.

    attack.py attack ADDRESS --events PORT --data PORT --http PORT --probes PORT [--udp-data PORT] [--ros-master PORT]
                     --seconds N [--bytes-per-second N] [--life SECONDS]
    attack.py discard ADDRESS --events PORT …      reads the same traffic and does nothing with it

`attack` prints one line of JSON at its end: bytes sent, connections made, refused and closed by the other side.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import struct
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict, dataclass

from attack_ros import RosAttack

# ZMTP 3.1, mechanism NULL, the greeting and the READY command of a DEALER.
GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"NULL".ljust(20, b"\0") + bytes(32)
READY_BODY = b"\x05READY" + b"\x0bSocket-Type" + struct.pack(">I", 6) + b"DEALER"
READY = b"\x04" + bytes([len(READY_BODY)]) + READY_BODY
LONG_FRAME = 0x02
# Length of the frame that is sent without its last byte, and length that a header claims for a frame that does not
# follow.
UNFINISHED = 60_000_000
CLAIMED = 1 << 62
CHUNK = 16 * 1024
# Connections that are held open at once, of each kind on each port.
HELD = 60
# RADIO/DISH over UDP: the group, then PEERNet's packets (daemon/networks/src/transport/datagram/packet.rs).
RADIO = b"\x07peernet"
HELLO, COOKIE, OPEN, OPENED, DATA = 1, 0x82, 3, 0x84, 5
# Length of every fragment but the last.
STRIDE = 1_100


@dataclass
class Counts:
    """What happened."""

    bytes_sent: int = 0
    connections: int = 0
    refused: int = 0
    closed_by_peer: int = 0
    datagrams: int = 0


class Rate:
    """A token bucket over all senders, in bytes. It holds at most what 0.1 s bring."""

    def __init__(self, bytes_per_second: float) -> None:
        self.rate = bytes_per_second
        self.level = 0.0
        self.at = time.monotonic()

    async def take(self, size: int) -> None:
        """Waits until `size` bytes may be sent."""
        now = time.monotonic()
        self.level = min(self.rate / 10, self.level + (now - self.at) * self.rate) - size
        self.at = now
        if self.level < 0:
            await asyncio.sleep(-self.level / self.rate)


class Attack:
    """All senders against one host."""

    def __init__(self, address: str, seconds: float, bytes_per_second: float, lifetime_s: float) -> None:
        self.address = address
        # Time after which each connection is replaced, seconds; 0: when the other side closes it.
        self.lifetime_s = lifetime_s
        self.until = time.monotonic() + seconds
        self.rate = Rate(bytes_per_second)
        self.counts = Counts()

    def goes_on(self) -> bool:
        return time.monotonic() < self.until

    async def keep_connecting(self, port: int, behave: Callable[[Connection], Awaitable[None]], share: float) -> None:
        """Opens one connection after the other and calls `behave` for each.

        Without a lifetime, a connection is replaced as soon as the other side closes it. With a lifetime, it is
        replaced when the lifetime is over and never earlier, so the traffic does not depend on what the other side does.
        The first connection is opened after a `share` of the lifetime, so that not all connections begin at once.
        """
        loop = asyncio.get_running_loop()
        end = loop.time() + share * self.lifetime_s
        while self.goes_on():
            if not self.lifetime_s:
                await self._connect_once(port, behave)
                # A connection costs the kernel and both programs time, so it counts as a kilobyte.
                await self.rate.take(1_000)
                continue
            await asyncio.sleep(max(0.0, end - loop.time()))
            end = loop.time() + self.lifetime_s
            with suppress(TimeoutError):
                async with asyncio.timeout_at(end):
                    await self._connect_once(port, behave)

    async def _connect_once(self, port: int, behave: Callable[[Connection], Awaitable[None]]) -> None:
        try:
            reader, writer = await asyncio.open_connection(self.address, port)
        except OSError:
            self.counts.refused += 1
            await asyncio.sleep(0.2)
            return
        self.counts.connections += 1
        connection = Connection(self, reader, writer)
        try:
            await behave(connection)
            await connection.hold()
        except (OSError, EOFError):
            self.counts.closed_by_peer += 1
        finally:
            writer.close()

    async def datagrams(self, port: int) -> None:
        """Sends datagrams of 44 random bytes, the length of a probe, at a tenth of the rate of all connections."""
        transport, _ = await asyncio.get_running_loop().create_datagram_endpoint(
            asyncio.DatagramProtocol, remote_addr=(self.address, port)
        )
        rate = Rate(self.rate.rate / 10)
        while self.goes_on():
            await rate.take(440)
            for _ in range(10):
                transport.sendto(os.urandom(44))
                self.counts.datagrams += 1
                self.counts.bytes_sent += 44
        transport.close()

    async def udp_data(self, port: int) -> None:
        """Opens virtual connections on a port of zmq-udp, one of each kind in turn, each with some datagrams."""
        behaviours = (udp_garbage, udp_hello_only, udp_claimed_sizes, udp_unfinished_messages)
        while self.goes_on():
            for behave in behaviours:
                transport, peer = await asyncio.get_running_loop().create_datagram_endpoint(
                    lambda: UdpPeer(self), remote_addr=(self.address, port)
                )
                # The other side may not answer, as `discard` does not.
                with suppress(TimeoutError):
                    await asyncio.wait_for(behave(peer), 2)
                transport.close()


class UdpPeer(asyncio.DatagramProtocol):
    """One socket of the attack on a port of zmq-udp."""

    def __init__(self, attack: Attack) -> None:
        self.attack = attack
        self.arrived: asyncio.Queue[bytes] = asyncio.Queue()

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, _address: tuple[str, int]) -> None:
        self.arrived.put_nowait(data.removeprefix(RADIO))

    def error_received(self, _error: OSError) -> None:
        self.attack.counts.refused += 1

    async def send(self, packet: bytes) -> None:
        await self.attack.rate.take(len(packet))
        self.transport.sendto(RADIO + packet)
        self.attack.counts.datagrams += 1
        self.attack.counts.bytes_sent += len(packet)

    async def expect(self, kind: int) -> bytes:
        while True:
            packet = await self.arrived.get()
            if packet[:1] == bytes([kind]):
                return packet[1:]

    async def hello(self, nonce: bytes) -> bytes:
        """Says hello; returns the cookie."""
        await self.send((bytes([HELLO, 1]) + nonce + bytes(2)).ljust(64, b"\0"))
        return (await self.expect(COOKIE))[8:24]

    async def open(self) -> bytes:
        """Opens a connection; returns its number."""
        nonce = os.urandom(8)
        cookie = await self.hello(nonce)
        # Reply port (that of the sender), window, longest datagram.
        terms = struct.pack(">HIH", 0, 1 << 30, 1_200)
        await self.send((bytes([OPEN]) + nonce + cookie + terms).ljust(1_200, b"\0"))
        number = (await self.expect(OPENED))[8:16]
        self.attack.counts.connections += 1
        return number

    async def send_fragment(self, connection: bytes, sequence: int, offset: int, total: int) -> None:
        number, tag, checksum, lifetime_ms = sequence, 1, 0, 0
        header = struct.pack(">IQQIIIHH", number, sequence, tag, offset, total, checksum, STRIDE, lifetime_ms)
        size = min(STRIDE, total - offset)
        await self.send(bytes([DATA]) + connection + header + bytes(size))


class Connection:
    """One connection of the attack."""

    def __init__(self, attack: Attack, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.attack = attack
        self.reader = reader
        self.writer = writer

    async def send(self, data: bytes) -> None:
        await self.attack.rate.take(len(data))
        self.writer.write(data)
        await self.writer.drain()
        self.attack.counts.bytes_sent += len(data)

    async def hold(self) -> None:
        """Keeps the connection until the other side closes it or the attack ends."""
        while self.attack.goes_on():
            with suppress(TimeoutError):
                if not await asyncio.wait_for(self.reader.read(CHUNK), 0.5):
                    raise EOFError


async def silence(connection: Connection) -> None:
    """Connects and says nothing."""


async def half_a_greeting(connection: Connection) -> None:
    await connection.send(GREETING[:10])


async def garbage(connection: Connection) -> None:
    while connection.attack.goes_on():
        await connection.send(os.urandom(CHUNK))


async def _handshake(connection: Connection) -> None:
    await connection.send(GREETING)
    await connection.send(READY)


async def claimed_size(connection: Connection) -> None:
    await _handshake(connection)
    await connection.send(bytes([LONG_FRAME]) + struct.pack(">Q", CLAIMED) + bytes(64))


async def unfinished_frame(connection: Connection) -> None:
    await _handshake(connection)
    await connection.send(bytes([LONG_FRAME]) + struct.pack(">Q", UNFINISHED))
    # All but the last byte.
    left = UNFINISHED - 1
    while connection.attack.goes_on() and left:
        size = min(left, CHUNK)
        await connection.send(bytes(size))
        left -= size


async def unfinished_headers(connection: Connection) -> None:
    await connection.send(b"GET / HTTP/1.1\r\nHost: localhost\r\n")
    while connection.attack.goes_on():
        await connection.send(b"X-Filler: " + b"x" * 200 + b"\r\n")
        await asyncio.sleep(0.5)


async def claimed_body(connection: Connection) -> None:
    head = b"POST /api/v1/runs HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4611686018427387904\r\n\r\n"
    await connection.send(head)
    await garbage(connection)


async def udp_garbage(peer: UdpPeer) -> None:
    for _ in range(100):
        await peer.send(os.urandom(1_000))


async def udp_hello_only(peer: UdpPeer) -> None:
    for _ in range(10):
        await peer.hello(os.urandom(8))


async def udp_claimed_sizes(peer: UdpPeer) -> None:
    connection = await peer.open()
    for sequence in range(100):
        await peer.send_fragment(connection, sequence, 0, (1 << 32) - 1)


async def udp_unfinished_messages(peer: UdpPeer) -> None:
    connection = await peer.open()
    for sequence in range(4):
        # All but the first fragment.
        for offset in range(STRIDE, 60_000, STRIDE):
            await peer.send_fragment(connection, sequence, offset, 60_000)


ZMTP = (silence, half_a_greeting, garbage, claimed_size, unfinished_frame)
HTTP = (silence, garbage, unfinished_headers, claimed_body)


async def attack(arguments: argparse.Namespace) -> None:
    senders = Attack(arguments.address, arguments.seconds, arguments.bytes_per_second, arguments.life)
    ports = [(arguments.events, ZMTP), (arguments.data, ZMTP), (arguments.http, HTTP)]
    slots = [(port, behave) for port, behaviours in ports for behave in behaviours for _ in range(HELD)]
    jobs = [
        senders.keep_connecting(port, behave, number / len(slots))
        for number, (port, behave) in enumerate(slots)
    ]
    if arguments.udp_data:
        jobs.append(senders.udp_data(arguments.udp_data))
    if arguments.ros_master:
        jobs.append(RosAttack(senders, arguments.ros_master).run())
    await asyncio.gather(*jobs, senders.datagrams(arguments.probes))
    print(json.dumps(asdict(senders.counts)))


async def discard(arguments: argparse.Namespace) -> None:
    async def read(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(OSError):
            while await reader.read(1 << 20):
                pass
        writer.close()

    for port in (arguments.events, arguments.data, arguments.http):
        await asyncio.start_server(read, arguments.address, port, backlog=1_024)
    loop = asyncio.get_running_loop()
    for port in filter(None, (arguments.probes, arguments.udp_data)):
        await loop.create_datagram_endpoint(asyncio.DatagramProtocol, local_addr=(arguments.address, port))
    print("discarding", flush=True)
    await asyncio.Event().wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("attack", "discard"))
    parser.add_argument("address")
    for port in ("events", "data", "http", "probes"):
        parser.add_argument(f"--{port}", type=int, required=True)
    parser.add_argument("--udp-data", type=int, help="a port of zmq-udp")
    parser.add_argument("--ros-master", type=int, help="port of a ROS master with a cloud and its robot")
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--bytes-per-second", type=float, default=4_000_000)
    parser.add_argument("--life", type=float, default=0, help="seconds after which each connection is replaced")
    arguments = parser.parse_args()
    with suppress(KeyboardInterrupt):
        asyncio.run({"attack": attack, "discard": discard}[arguments.what](arguments))
    return 0


if __name__ == "__main__":
    sys.exit(main())
