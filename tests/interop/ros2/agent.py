"""Checks the sensor and the actuator `ros` of agents against Cyclone DDS. Usage: agent.py PEERNETD"""
import os
import pathlib
import sys
import tempfile

from processes import Process, wait_until

PICTURES = 40
PICTURE_BYTES = 1_000_000
CYCLONE = [sys.executable, pathlib.Path(__file__).resolve().parent / "cyclonedds_peer.py"]

CONFIGURATION = """
[agent]
name = "robot"
state_dir = "{folder}/robot"

[[model]]
name = "echo"
kind = "echo"

# No picture may be missing or changed.
[[pipeline]]
name = "camera"
sensor = {{ kind = "ros", topic = "/camera", type = "sensor_msgs/msg/CompressedImage", queue = {pictures} }}
placement = {{ kind = "local", model = "echo" }}
actuator = {{ kind = "ros", topic = "/seen", type = "std_msgs/UInt8MultiArray" }}

# The publisher is best-effort. The sensor of `strict` requests reliable messages, the sensor of `lenient` does not.
[[pipeline]]
name = "strict"
sensor = {{ kind = "ros", topic = "/sketchy", type = "sensor_msgs/msg/CompressedImage" }}
placement = {{ kind = "local", model = "echo" }}

[[pipeline]]
name = "lenient"
sensor = {{ kind = "ros", topic = "/sketchy", type = "sensor_msgs/msg/CompressedImage", reliability = "best-effort" }}
placement = {{ kind = "local", model = "echo" }}
actuator = {{ kind = "log" }}
"""

REFUSED = "the QoS policy reliability does not fit: the publisher offers best-effort, the subscription requests reliable"


def main():
    with tempfile.TemporaryDirectory(prefix="interop-ros2-") as folder:
        file = os.path.join(folder, "robot.toml")
        with open(file, "w") as text:
            text.write(CONFIGURATION.format(folder=folder, pictures=PICTURES))
        with Process(sys.argv[1], "run", file, environment=dict(os.environ, ROS_VERSION="2")) as agent:
            with Process(*CYCLONE, "receive", "/seen", "bytes", PICTURES, PICTURE_BYTES) as receiver:
                with Process(*CYCLONE, "publish", "/camera", "image", PICTURES, PICTURE_BYTES) as publisher:
                    publisher.finish()
                receiver.finish()
            print(f"ok      {PICTURES} pictures of {PICTURE_BYTES} bytes of Cyclone DDS passed sensor and actuator")
            with Process(*CYCLONE, "offer", "/sketchy", "image", 10_000, 1000):
                # `has_error` searches the log, because an agent logs to standard error.
                wait_until(lambda: agent.has_error("bytes=1000"), "best-effort pictures reach a best-effort sensor")
                wait_until(lambda: agent.has_error(REFUSED), "the log names the QoS policy")
            print("ok      a reliable sensor names the QoS policy of a best-effort publisher, and a best-effort sensor accepts it")
            agent.stop()


main()
