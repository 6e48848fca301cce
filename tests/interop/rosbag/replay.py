"""Plays the bag of a session and compares what agents receive with it. Usage: replay.py BAG

The agents subscribe to `/robot/request` and `/robot/response` and publish the samples on `/seen/request` and
`/seen/response`. The sample of a picture is the picture's file. The sample of any other message is the serialised
message.
"""
import subprocess
import sys
import threading
import time

import rosbag
import rospy
from std_msgs.msg import UInt8MultiArray

# Time limit of the replay. Seconds.
TIMEOUT_S = 60
TOPICS = ["request", "response"]


def recorded_samples(bag, topic):
    """Returns the bytes of each recorded message as an agent publishes them."""
    raw = bag.read_messages(topics=[f"/robot/{topic}"], raw=True)
    if topic == "response":
        # A raw message is a tuple of the type's name, the serialised message and other elements.
        return [message[1] for _, message, _ in raw]
    return [bytes(message.data) for _, message, _ in bag.read_messages(topics=[f"/robot/{topic}"])]


def main():
    with rosbag.Bag(sys.argv[1]) as bag:
        expected = {topic: recorded_samples(bag, topic) for topic in TOPICS}
    assert all(len(messages) > 50 for messages in expected.values()), {t: len(m) for t, m in expected.items()}
    seen = {topic: [] for topic in TOPICS}
    progress = threading.Condition()

    def collect(message, topic):
        with progress:
            seen[topic].append(bytes(message.data))
            progress.notify()

    rospy.init_node("collector", disable_signals=True)
    subscribers = [rospy.Subscriber(f"/seen/{topic}", UInt8MultiArray, collect, topic) for topic in TOPICS]
    end = time.monotonic() + TIMEOUT_S
    while not all(one.get_num_connections() for one in subscribers):
        assert time.monotonic() < end, "the agents do not publish"
        time.sleep(0.02)
    subprocess.run(
        ["rosbag", "play", "--quiet", "--wait-for-subscribers", "--delay=1", sys.argv[1]], check=True, timeout=TIMEOUT_S
    )
    with progress:
        progress.wait_for(lambda: all(len(seen[topic]) >= len(expected[topic]) for topic in TOPICS), TIMEOUT_S)
    for topic in TOPICS:
        counts = f"{len(seen[topic])} of {len(expected[topic])}"
        assert seen[topic] == expected[topic], f"/robot/{topic}: {counts} messages arrived, or some were changed"
        print(f"ok    {counts} messages of /robot/{topic} were replayed unchanged", flush=True)
    rospy.signal_shutdown("done")


main()
