"""Sends probes from forged source addresses for some seconds: forged_probes.py ADDRESS PORT PER_SECOND SECONDS.

Prints the number of sent probes.
"""

import random
import socket
import struct
import sys
import time

address, port, per_second, seconds = sys.argv[1], *map(int, sys.argv[2:])
target = socket.inet_aton(address)
out = socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_RAW)
begin = time.monotonic()
sent = 0
while (elapsed := time.monotonic() - begin) < seconds:
    while sent < elapsed * per_second:
        source = struct.pack("!I", 0x0B000000 + random.getrandbits(24))
        # The kernel fills in the fields that are zero: length, id and checksum of the IP header. UDP needs no checksum.
        ip = struct.pack("!BBHHHBBH4s4s", 0x45, 0, 0, 0, 0, 64, socket.IPPROTO_UDP, 0, source, target)
        udp = struct.pack("!HHHH", random.randrange(1024, 65536), port, 8 + 44, 0)
        out.sendto(ip + udp + bytes(44), (address, 0))
        sent += 1
    time.sleep(0.001)
print(sent)
