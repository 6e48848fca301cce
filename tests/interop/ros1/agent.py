"""Checks the sensor and the actuator `ros` of an agent against rospy and rostopic. Usage: agent.py PEERNETD"""
import contextlib
import os
import re
import sys
import tempfile

from harness import ROSPY, run_tool, start_master
from processes import Process, wait_until

PICTURES = 50
PICTURE_BYTES = 1_000_000

# The actuator `log` writes a line for each answer, and the check counts these lines. `rostopic echo` receives
# `/answer`.
CONFIGURATION = """
[agent]
name = "robot"
state_dir = "{folder}/robot"

[[model]]
name = "echo"
kind = "echo"

[[pipeline]]
name = "camera"
sensor = {{ kind = "ros", topic = "/camera", type = "sensor_msgs/CompressedImage", queue = {pictures} }}
placement = {{ kind = "local", model = "echo" }}
actuator = {{ kind = "ros", topic = "/seen", type = "std_msgs/UInt8MultiArray" }}

[[pipeline]]
name = "camera-again"
sensor = {{ kind = "ros", topic = "/camera", queue = {pictures} }}
placement = {{ kind = "local", model = "echo" }}
actuator = {{ kind = "log" }}

[[pipeline]]
name = "words"
sensor = {{ kind = "ros", topic = "/words" }}
placement = {{ kind = "local", model = "echo" }}
actuator = {{ kind = "ros", topic = "/answer" }}
"""


@contextlib.contextmanager
def agent():
    with tempfile.TemporaryDirectory(prefix="interop-ros1-") as folder:
        file = os.path.join(folder, "robot.toml")
        with open(file, "w") as text:
            text.write(CONFIGURATION.format(folder=folder, pictures=PICTURES))
        environment = dict(os.environ, ROS_VERSION="1")
        with Process(os.path.abspath(sys.argv[1]), "run", file, environment=environment) as process:
            yield process
            process.stop()


def main():
    master = start_master()
    try:
        with agent() as robot:
            wait_until(lambda: "/seen" in run_tool("rostopic", "list").split(), "the agent publishes its answers")
            nodes = [node for node in run_tool("rosnode", "list").split() if node.startswith("/peernet_")]
            assert len(nodes) == 2, f"one node, and another for the second subscription of /camera: {nodes}"
            assert run_tool("rostopic", "type", "/seen").strip() == "std_msgs/UInt8MultiArray"
            with Process(*ROSPY, "collect", "collector", "/seen", PICTURES) as collector:
                collector.wait_for("ready")
                wait_until(lambda: "/collector" in run_tool("rostopic", "info", "/seen"), "the collector subscribes")
                # The source waits for two subscribers, `camera` and `camera-again`.
                with Process(*ROSPY, "publish", "source", "/camera", PICTURES, PICTURE_BYTES, 2) as source:
                    for number in range(PICTURES):
                        assert collector.wait_for("picture") == f"picture {number} {PICTURE_BYTES} intact"
                    source.finish()
                collector.finish()
            print(f"ok    {PICTURES} pictures of {PICTURE_BYTES} bytes of rospy passed sensor and actuator", flush=True)
            answers = lambda: sum(f"bytes={PICTURE_BYTES}" in (line or "") for line in list(robot.errors))
            # This pipeline may be slower than the one whose answers were collected.
            wait_until(lambda: answers() == PICTURES, lambda: f"{PICTURES} answers of camera-again; it has {answers()}")
            print("ok    another pipeline received the same topic", flush=True)
            with Process("rostopic", "echo", "/answer") as echo:
                wait_until(lambda: "rostopic_" in run_tool("rostopic", "info", "/answer"), "rostopic subscribes")
                run_tool("rostopic", "pub", "--once", "/words", "std_msgs/String", "turn left")
                assert re.search("turn left", echo.wait_for("data:"))
            print("ok    rostopic echo receives the answer to the message of rostopic pub", flush=True)
    finally:
        master.kill()


main()
