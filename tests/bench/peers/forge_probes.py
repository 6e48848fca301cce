"""A program on the path that alters answers to probes, so that the reflector's clocks seem to be ahead.

    forge_probes.py --listen PORT --reflector ADDRESS:PORT --add-ms N --mark N

Probes that a packet filter redirects to PORT go on, marked, to the reflector; the stamps of each answer are altered.
"""

from __future__ import annotations

import argparse
import select
import socket
import struct

# Offsets of the reflector's stamps in a packet without and with authentication (RFC 8762, sections 4.2.1 and 4.3.1).
OPEN_STAMPS, AUTHENTICATED_STAMPS = (4, 16), (16, 32)
# First bytes of the value of the TLV with stamps of the free-running clock, and offsets of the stamps in this value.
RAW_MARK = b"PRAW"
RAW_STAMPS = (8, 16)


def forged(answer: bytes, add_ns: int) -> bytes:
    """Returns the answer as a reflector would give it whose clocks are `add_ns` ahead."""
    packet = bytearray(answer)
    # An authenticated packet has zeros where a packet without authentication has its first stamp.
    is_open = any(packet[4:12])
    ntp = (add_ns << 32) // 1_000_000_000
    for at in OPEN_STAMPS if is_open else AUTHENTICATED_STAMPS:
        _add(packet, at, ntp)
    if (mark := packet.find(RAW_MARK)) >= 0:
        for at in RAW_STAMPS:
            _add(packet, mark + at, add_ns)
    return bytes(packet)


def _add(packet: bytearray, at: int, added: int) -> None:
    (stamp,) = struct.unpack_from(">Q", packet, at)
    struct.pack_into(">Q", packet, at, (stamp + added) % (1 << 64))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--listen", type=int, required=True)
    parser.add_argument("--reflector", required=True)
    parser.add_argument("--add-ms", type=float, required=True)
    parser.add_argument("--mark", type=int, required=True)
    arguments = parser.parse_args()
    host, _, port = arguments.reflector.rpartition(":")
    near, far = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    near.bind(("0.0.0.0", arguments.listen))
    far.setsockopt(socket.SOL_SOCKET, socket.SO_MARK, arguments.mark)
    far.connect((host, int(port)))
    edge = None
    print("forging", flush=True)
    while True:
        for ready in select.select([near, far], [], [])[0]:
            if ready is near:
                probe, edge = near.recvfrom(2048)
                far.send(probe)
            elif edge is not None:
                near.sendto(forged(far.recv(2048), round(arguments.add_ms * 1e6)), edge)


if __name__ == "__main__":
    main()
