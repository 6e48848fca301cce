"""Runs the commands of the paper's program over ROS 2 while Cyclone DDS receives the pictures.

Usage: session.py PEERNET JPEG
"""
import csv
import os
import pathlib
import sys
import tempfile

from processes import Process

ITERATIONS = 40
WATCHED = 10
HERE = pathlib.Path(__file__).resolve().parent
VIEWER = [sys.executable, HERE / "cyclonedds_viewer.py"]

NETWORK = """
devices:
  jetson-orin: 127.0.0.1
  cluster: 127.0.0.1
server: cluster
ros2:
  interfaces: [lo]
"""


def command(folder, role, name):
    file = os.path.join(folder, "net_config.yaml")
    return [sys.argv[1], role, "--name", name, "--network", "ros", "--network-config", file]


def main():
    environment = dict(os.environ, ROS_VERSION="2")
    with tempfile.TemporaryDirectory(prefix="interop-ros2-") as folder:
        with open(os.path.join(folder, "net_config.yaml"), "w") as file:
            file.write(NETWORK)
        results = os.path.join(folder, "results")
        server = command(folder, "--server", "cluster") + ["--model-name", "dummy", "--iterations", ITERATIONS]
        client = command(folder, "--client", "jetson-orin")
        client += ["--dataset-loc", sys.argv[2], "--encoding", "file", "--iterations", ITERATIONS, "--result-loc", results]
        environment |= {"XDG_STATE_HOME": folder, "HOME": folder}
        with Process(*VIEWER, "/jetson_orin/request", sys.argv[2], WATCHED) as viewer:
            viewer.wait_for("watching")
            with Process(*server, environment=environment) as cloud, Process(*client, environment=environment) as edge:
                seen = viewer.wait_for("saw")
                edge.finish()
                cloud.finish()
        with open(os.path.join(results, "data.csv"), newline="") as file:
            rows = list(csv.DictReader(file))
        outcomes = {row["outcome"] for row in rows}
        assert (len(rows), outcomes) == (ITERATIONS, {"ok"}), (len(rows), outcomes)
    print(f"ok      {ITERATIONS} iterations of the paper's commands over ROS 2; Cyclone DDS {seen}")


main()
