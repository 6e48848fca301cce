"""Profiles a chain of rospy nodes without a change of theirs. Usage: observe.py PEERNETD

Each of three nodes takes a known time; what an agent reports must be within a millisecond of what the node says it took, by
medians of 20 messages. A busy machine lets nodes and agent wait for a processor: until it does not for two seconds.
"""
import json
import os
import pathlib
import queue
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request

# Longest time in seconds that anything may take.
PATIENCE = 120
# Nodes of the chain: topics and the seconds that they take.
HOPS = [("/camera", "/a", 0.005), ("/a", "/b", 0.02), ("/b", "/c", 0.05)]
# Largest difference in seconds between what is reported and what was taken.
TOLERANCE = 0.001
# Messages that a median is taken of, here as by a node.
WINDOW = 20

PEERNETD = os.path.abspath(sys.argv[1])
# Debian's packages belong to Debian's Python.
CHAIN = ["/usr/bin/python3", str(pathlib.Path(__file__).resolve().parent / "rospy_chain.py")]


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


class Process:
    """A program whose lines are read as they come, and which ends with the check."""

    def __init__(self, *command):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self.lines = queue.Queue()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        for line in self.process.stdout:
            self.lines.put(line.rstrip("\n"))

    def newest(self, part):
        """Returns the newest line that contains a text, if there is one since the last call."""
        lines = [self.lines.get() for _ in range(self.lines.qsize())]
        return next((line for line in reversed(lines) if part in line), None)

    def wait_for(self, part):
        """Returns the next line that contains a text."""
        while part not in (line := self.lines.get(timeout=PATIENCE)):
            pass
        return line


def until(condition, what):
    """Returns what a condition returns once that is something."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            if (found := condition()) is not None:
                return found
        except (OSError, urllib.error.URLError):
            pass
        time.sleep(0.1)
    raise AssertionError(f"not within {PATIENCE} s: {what}")


def configuration(folder, events, http):
    pipelines = "".join(
        f'[[pipeline]]\nname = "hop{index}"\n'
        f'placement = {{ kind = "observe", ros_version = 1, input = "{source}", output = "{target}" }}\n'
        for index, (source, target, _) in enumerate(HOPS)
    )
    file = folder / "robot.toml"
    file.write_text(
        f'[aggregator]\nname = "aggregator"\nlisten = "tcp://127.0.0.1:{events}"\n'
        f'database = "{folder}/database.sqlite"\n[web]\nlisten = "127.0.0.1:{http}"\n'
        f'[agent]\nname = "robot"\nstate_dir = "{folder}/robot"\naggregator = "tcp://127.0.0.1:{events}"\n{pipelines}'
    )
    return str(file)


def main():
    folder = pathlib.Path(tempfile.mkdtemp())
    master, events, http = free_port(), free_port(), free_port()
    os.environ.update(ROS_MASTER_URI=f"http://127.0.0.1:{master}", ROS_IP="127.0.0.1", ROS_HOME=str(folder))

    def get(path):
        with urllib.request.urlopen(f"http://127.0.0.1:{http}/api/v1/{path}", timeout=10) as answer:
            return json.load(answer)

    started = []

    def start(*command):
        started.append(Process(*command))
        return started[-1]

    try:
        start("rosmaster", "--core", "-p", str(master))
        until(lambda: socket.create_connection(("127.0.0.1", master)).close() or True, "rosmaster answers")
        relays = []
        for index, (source, target, seconds) in enumerate(HOPS):
            relays.append(start(*CHAIN, "relay", f"relay{index}", source, target, str(seconds)))
            relays[-1].wait_for("ready")
        start(*CHAIN, "camera", "camera", "/camera", "10").wait_for("ready")
        start(PEERNETD, "run", configuration(folder, events, http))

        def compared(index):
            """Returns what is reported and what was taken, in seconds, once they agree."""
            said = relays[index].newest("median")
            runs = [run["number"] for run in get("runs")["runs"] if run["pipeline"] == f"hop{index}"]
            if said is None or not runs:
                return None
            iterations = get(f"runs/{runs[0]}/iterations?limit=1000")["iterations"]
            totals = [one["total"] for one in iterations if one["outcome"] == "ok"][-WINDOW:]
            if len(totals) < WINDOW:
                return None
            reported, taken = statistics.median(totals), float(said.split()[1])
            return (reported, taken) if abs(reported - taken) < TOLERANCE else None

        for index, (_, _, seconds) in enumerate(HOPS):
            reported, taken = until(lambda: compared(index), f"a median within a millisecond of {seconds} s")
            print(f"hop {index}: {reported * 1e3:.2f} ms reported, {taken * 1e3:.2f} ms taken")
            assert taken >= seconds
        print("the chain of rospy nodes was observed")
    finally:
        for process in reversed(started):
            process.process.kill()
            process.process.wait()


main()
