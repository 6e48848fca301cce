"""A rospy node that publishes, subscribes or echoes, as ros1_peer.rs does.

rospy_peer.py publish NAME TOPIC COUNT BYTES [SUBSCRIBERS]
rospy_peer.py subscribe NAME TOPIC COUNT
rospy_peer.py collect NAME TOPIC COUNT      like subscribe, for byte arrays with the data of pictures
rospy_peer.py rate NAME TOPIC COUNT
rospy_peer.py refused NAME TOPIC
rospy_peer.py echo NAME IN OUT
rospy_peer.py ping NAME OUT IN COUNT BYTES
"""
import queue
import sys
import time

import rospy
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String, UInt8MultiArray

# Size of the receive buffers. rospy reads a message in one call only if its buffer holds it.
BUFFER_BYTES = 1 << 24


def print_line(line):
    print(line, flush=True)


def picture(number, length):
    """Byte i of picture n is i + n (mod 251)."""
    pattern = bytes((index + number) % 251 for index in range(251))
    data = (pattern * (length // 251 + 1))[:length]
    message = CompressedImage(format="raw", data=data)
    message.header.frame_id = "camera"
    message.header.stamp = rospy.Time(number, 0)
    return message


def publish(topic, count, length, subscribers=1):
    publisher = rospy.Publisher(topic, CompressedImage, queue_size=int(count))
    print_line("ready")
    while publisher.get_num_connections() < int(subscribers):
        rospy.sleep(0.01)
    for number in range(int(count)):
        publisher.publish(picture(number, int(length)))
    # The node runs until the test closes its standard input.
    sys.stdin.read()


def subscribe(topic, count):
    arrived = queue.Queue()
    rospy.Subscriber(topic, CompressedImage, arrived.put, buff_size=BUFFER_BYTES, tcp_nodelay=True)
    print_line("ready")
    for _ in range(int(count)):
        message = arrived.get()
        number = message.header.stamp.secs
        intact = message.data == picture(number, len(message.data)).data
        print_line(f"picture {number} {len(message.data)} {'intact' if intact else 'damaged'}")


def collect(topic, count):
    arrived = queue.Queue()
    rospy.Subscriber(topic, UInt8MultiArray, arrived.put, buff_size=BUFFER_BYTES, tcp_nodelay=True)
    print_line("ready")
    for number in range(int(count)):
        data = arrived.get().data
        print_line(f"picture {number} {len(data)} {'intact' if data == picture(number, len(data)).data else 'damaged'}")


def rate(topic, count):
    """Prints the messages per second between the first and the last."""
    stamps = queue.Queue()
    rospy.Subscriber(
        topic, CompressedImage, lambda message: stamps.put(time.monotonic()), buff_size=BUFFER_BYTES, tcp_nodelay=True
    )
    print_line("ready")
    first = last = stamps.get()
    for _ in range(1, int(count)):
        last = stamps.get()
    # rospy does not report dropped messages. The 0 gives the line the form of ros1_peer's line.
    print_line(f"rate {(int(count) - 1) / (last - first):.0f} dropped 0")


def refused(topic):
    """Subscribes with a type that is not the topic's."""
    rospy.Subscriber(topic, String, lambda message: print_line("message"))
    print_line("ready")
    sys.stdin.read()


def echo(source, target):
    publisher = rospy.Publisher(target, CompressedImage, queue_size=1000, tcp_nodelay=True)
    rospy.Subscriber(source, CompressedImage, publisher.publish, buff_size=BUFFER_BYTES, tcp_nodelay=True)
    print_line("ready")
    sys.stdin.read()


def ping(out, back, count, length):
    """Makes round trips, one at a time.

    Prints the median and the 99th percentile in microseconds, and the number of round trips per second.
    """
    arrived = queue.Queue()
    subscriber = rospy.Subscriber(back, CompressedImage, arrived.put, buff_size=BUFFER_BYTES, tcp_nodelay=True)
    publisher = rospy.Publisher(out, CompressedImage, queue_size=1000, tcp_nodelay=True)
    while publisher.get_num_connections() == 0 or subscriber.get_num_connections() == 0:
        rospy.sleep(0.01)
    message = picture(0, int(length))
    # A rospy node may count as connected before it sends. The message is therefore repeated until an
    # answer arrives. Then the answers to the repetitions are received, until none arrives for 0.3 s.
    answers = 0
    while True:
        if not answers:
            publisher.publish(message)
        try:
            arrived.get(timeout=0.3)
            answers += 1
        except queue.Empty:
            if answers:
                break
    micros = []
    for _ in range(int(count)):
        start = time.monotonic_ns()
        publisher.publish(message)
        arrived.get()
        micros.append((time.monotonic_ns() - start) // 1000)
    micros.sort()
    quantile = lambda percent: micros[(len(micros) - 1) * percent // 100]
    print_line(f"median {quantile(50)} p99 {quantile(99)} rate {int(count) * 1e6 / sum(micros):.0f}")


def main():
    command, name, *arguments = sys.argv[1:]
    rospy.init_node(name, disable_signals=True)
    commands = {
        "publish": publish, "subscribe": subscribe, "collect": collect, "rate": rate, "refused": refused, "echo": echo,
        "ping": ping,
    }
    commands[command](*arguments)
    rospy.signal_shutdown("done")


main()
