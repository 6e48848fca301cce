"""Watches the pictures of a session over ROS 2 with Eclipse Cyclone DDS. Usage: cyclonedds_viewer.py TOPIC JPEG COUNT"""
import pathlib
import sys

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.util import duration

from cyclonedds_peer import CompressedImage_, Incoming

# The QoS with which tools of ROS 2 subscribe.
QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))


def main():
    topic, file, count = sys.argv[1:]
    picture = pathlib.Path(file).read_bytes()
    incoming = Incoming(DomainParticipant(), f"rt{topic}", CompressedImage_, QOS)
    print("watching", flush=True)
    stamps = []
    for _ in range(int(count)):
        seen = incoming.next()
        assert seen.format == "jpeg", seen.format
        assert bytes(seen.data) == picture, f"{len(seen.data)} bytes, not the {len(picture)} of {file}"
        stamps.append((seen.header.stamp.sec, seen.header.stamp.nanosec))
    assert stamps == sorted(set(stamps)), f"the stamps of the pictures do not increase: {stamps}"
    print(f"saw {len(stamps)} pictures of {len(picture)} bytes", flush=True)


main()
