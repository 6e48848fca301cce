"""A Cyclone DDS node of a chain: a camera, or a relay that answers after a known time.

cyclonedds_chain.py camera TOPIC HZ
cyclonedds_chain.py relay IN OUT DELAY_S [DROPPED EXTRA]
The camera publishes best-effort. The relays subscribe best-effort and publish reliably. A relay prints the median of
its real processing times, in seconds, after each 20 messages. It leaves each DROPPED-th message without an answer, and
publishes a message of another stamp after each EXTRA-th.
"""
import statistics
import sys
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds_peer import CompressedImage_, Header_, Incoming, Outgoing, Time_

BEST_EFFORT = Qos(Policy.Reliability.BestEffort)


def print_line(line):
    print(line, flush=True)


def camera(participant, topic, hz):
    outgoing = Outgoing(participant, "rt" + topic, CompressedImage_, BEST_EFFORT)
    print_line("ready")
    while True:
        now = time.time_ns()
        header = Header_(Time_(now // 1_000_000_000, now % 1_000_000_000), "cam")
        outgoing.writer.write(CompressedImage_(header, "jpeg", bytes(10_000)))
        time.sleep(1 / float(hz))


def relay(participant, source, target, delay, dropped=0, extra=0):
    incoming = Incoming(participant, "rt" + source, CompressedImage_, BEST_EFFORT)
    outgoing = Outgoing(participant, "rt" + target, CompressedImage_)
    print_line("ready")
    durations, number = [], 0
    while True:
        message = incoming.next()
        start = time.monotonic()
        number += 1
        if int(dropped) and number % int(dropped) == 0:
            continue
        time.sleep(float(delay))
        outgoing.writer.write(message)
        durations.append(time.monotonic() - start)
        if int(extra) and number % int(extra) == 0:
            message.header.stamp.nanosec = (message.header.stamp.nanosec + 1) % 1_000_000_000
            outgoing.writer.write(message)
        if len(durations) == 20:
            print_line(f"median {statistics.median(durations)}")
            durations.clear()


command, *arguments = sys.argv[1:]
{"camera": camera, "relay": relay}[command](DomainParticipant(), *arguments)
