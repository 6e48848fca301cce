"""Peer of the ROS 2 interoperability tests that uses Eclipse Cyclone DDS.

cyclonedds_peer.py publish|receive TOPIC string|image|bytes COUNT BYTES
cyclonedds_peer.py ping|pong TOPIC string|image|bytes COUNT BYTES      round trips; `ping` prints their quantiles
cyclonedds_peer.py offer TOPIC string|image|bytes COUNT BYTES    publishes ten times a second, best-effort
cyclonedds_peer.py nodes NAME                                    waits until the node list has NAME with a publisher
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos, ReadCondition, SampleState, InstanceState, ViewState, WaitSet
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, int32, sequence, uint8, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

TIMEOUT_S = 20.0
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=10)), Policy.History.KeepAll)


@dataclass
class String_(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Time_(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header_(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time_
    frame_id: str


@dataclass
class CompressedImage_(IdlStruct, typename="sensor_msgs.msg.dds_.CompressedImage_"):
    header: Header_
    format: str
    data: sequence[uint8]


@dataclass
class MultiArrayDimension_(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayDimension_"):
    label: str
    size: uint32
    stride: uint32


@dataclass
class MultiArrayLayout_(IdlStruct, typename="std_msgs.msg.dds_.MultiArrayLayout_"):
    dim: sequence[MultiArrayDimension_]
    data_offset: uint32


@dataclass
class UInt8MultiArray_(IdlStruct, typename="std_msgs.msg.dds_.UInt8MultiArray_"):
    layout: MultiArrayLayout_
    data: sequence[uint8]


@dataclass
class Gid_(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo_(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid_]
    writer_gid_seq: sequence[Gid_]


@dataclass
class ParticipantEntitiesInfo_(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
    gid: Gid_
    node_entities_info_seq: sequence[NodeEntitiesInfo_]


ALPHABET = "abcdefghijklmnopqrstuvwxyz"
TYPES = {"string": String_, "image": CompressedImage_, "bytes": UInt8MultiArray_}


def message(kind, size, number):
    if kind == "string":
        start = number % 26
        return String_((ALPHABET * (size // 26 + 2))[start : start + size])
    period = bytes((index * 31 + number) % 256 for index in range(256))
    data = (period * (size // 256 + 1))[:size]
    if kind == "bytes":
        return UInt8MultiArray_(MultiArrayLayout_([], 0), data)
    return CompressedImage_(Header_(Time_(number, 7), "cam"), "jpeg", data)


def is_same(kind, sample, expected):
    if kind == "string":
        return sample.data == expected.data
    if kind == "bytes":
        return bytes(sample.data) == bytes(expected.data)
    return (
        sample.header == expected.header
        and sample.format == expected.format
        and bytes(sample.data) == bytes(expected.data)
    )


class Incoming:
    """Waits for the samples of a topic without polling."""

    def __init__(self, participant, topic, type_, qos=RELIABLE):
        self.reader = DataReader(participant, Topic(participant, topic, type_, qos=qos), qos=qos)
        condition = ReadCondition(self.reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        self.waitset = WaitSet(participant)
        self.waitset.attach(condition)
        self.taken = []

    def next(self):
        while not self.taken:
            if not self.waitset.wait(duration(seconds=TIMEOUT_S)):
                raise SystemExit("cyclonedds: nothing arrived in time")
            self.taken = [sample for sample in self.reader.take(64) if sample.sample_info.valid_data]
        return self.taken.pop(0)


class Outgoing:
    def __init__(self, participant, topic, type_, qos=RELIABLE):
        self.writer = DataWriter(participant, Topic(participant, topic, type_, qos=qos), qos=qos)

    def wait_for_subscription(self):
        end = time.monotonic() + TIMEOUT_S
        while not self.writer.get_matched_subscriptions():
            if time.monotonic() > end:
                raise SystemExit("cyclonedds: no subscription was found in time")
            time.sleep(0.02)


def publish(participant, topic, kind, count, size):
    outgoing = Outgoing(participant, topic, TYPES[kind])
    outgoing.wait_for_subscription()
    # The subscription may not have discovered this publisher yet, and would miss messages until then.
    time.sleep(1)
    for number in range(count):
        outgoing.writer.write(message(kind, size, number))
    if not outgoing.writer.wait_for_acks(duration(seconds=TIMEOUT_S)):
        raise SystemExit("cyclonedds: some messages were not acknowledged in time")
    # A rustdds subscription drops messages that are unread when their publisher leaves.
    time.sleep(1)
    print("published and acknowledged:", count)


def difference(kind, size, count, sample, number):
    """Says which published message a sample is, or where its data differ from the message with its stamp.

    Byte arrays have no stamp. Their data are compared with message `number`.
    """
    same = [other for other in range(count) if is_same(kind, sample, message(kind, size, other))]
    if same:
        return f"is message {same[0]}"
    if kind == "string":
        return f"is no published message: {sample.data[:60]!r}, {len(sample.data)} bytes"
    other = sample.header.stamp.sec if kind == "image" else number
    data, expected = bytes(sample.data), bytes(message(kind, size, other).data)
    places = [index for index in range(min(len(data), len(expected))) if data[index] != expected[index]]
    first = f", first at byte {places[0]}" if places else ""
    return f"has {len(data)} of the {len(expected)} bytes of message {other}, and {len(places)} of them differ{first}"


def receive(participant, topic, kind, count, size):
    incoming = Incoming(participant, topic, TYPES[kind])
    for number in range(count):
        sample = incoming.next()
        if not is_same(kind, sample, message(kind, size, number)):
            raise SystemExit(f"cyclonedds: message {number} {difference(kind, size, count, sample, number)}")
    print("received unchanged:", count)


def offer(participant, topic, kind, count, size):
    outgoing = Outgoing(participant, topic, TYPES[kind], Qos(Policy.Reliability.BestEffort))
    for number in range(count):
        outgoing.writer.write(message(kind, size, number))
        time.sleep(0.1)


def pong(participant, topic, kind, count, _size):
    outgoing = Outgoing(participant, topic + "/pong", TYPES[kind])
    incoming = Incoming(participant, topic + "/ping", TYPES[kind])
    for _ in range(count):
        outgoing.writer.write(incoming.next())
    outgoing.writer.wait_for_acks(duration(seconds=TIMEOUT_S))


def ping(participant, topic, kind, count, size):
    outgoing = Outgoing(participant, topic + "/ping", TYPES[kind])
    incoming = Incoming(participant, topic + "/pong", TYPES[kind])
    outgoing.wait_for_subscription()
    while not incoming.reader.get_matched_publications():
        time.sleep(0.02)
    sample, times = message(kind, size, 1), []
    for _ in range(count):
        start = time.perf_counter()
        outgoing.writer.write(sample)
        incoming.next()
        times.append(time.perf_counter() - start)
    # The first tenth is warm-up.
    times = sorted(times[len(times) // 10 :])
    p50, p99 = times[len(times) // 2], times[len(times) * 99 // 100]
    rate = len(times) / sum(times)
    print(f"{size} bytes: {rate:.0f} round trips/s, p50 {p50 * 1e6:.0f} µs, p99 {p99 * 1e6:.0f} µs")


def nodes(participant, name):
    qos = Qos(
        Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1)
    )
    incoming = Incoming(participant, "ros_discovery_info", ParticipantEntitiesInfo_, qos)
    while True:
        for node in incoming.next().node_entities_info_seq:
            if node.node_namespace + node.node_name == name and node.writer_gid_seq:
                print("seen in the node list:", name)
                return


def main():
    participant = DomainParticipant()
    mode, *rest = sys.argv[1:]
    if mode == "nodes":
        nodes(participant, rest[0])
        return
    topic, kind, count, size = rest
    modes = {"publish": publish, "receive": receive, "offer": offer, "ping": ping, "pong": pong}
    modes[mode](participant, "rt" + topic, kind, int(count), int(size))


if __name__ == "__main__":
    main()
