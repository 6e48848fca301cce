"""A master and programs for the checks with ROS 1."""
import os
import queue
import signal
import socket
import subprocess
import tempfile
import threading
import time
import xmlrpc.client

# Longest time in seconds that anything may take.
PATIENCE = 60
# Debian's packages belong to Debian's Python.
ROSPY = ["/usr/bin/python3", os.path.join(os.path.dirname(os.path.abspath(__file__)), "rospy_peer.py")]


class Process:
    """A program whose lines are read one by one."""

    def __init__(self, *command, environment=None):
        self.command = [str(part) for part in command]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            self.command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=environment
        )
        self.lines = queue.Queue()
        self.errors = []
        threading.Thread(target=self._read, args=(self.process.stdout, self.lines.put), daemon=True).start()
        threading.Thread(target=self._read, args=(self.process.stderr, self.errors.append), daemon=True).start()

    @staticmethod
    def _read(stream, take):
        for line in stream:
            take(line.rstrip("\n"))
        take(None)

    def line(self):
        """Returns the next line."""
        try:
            line = self.lines.get(timeout=PATIENCE)
        except queue.Empty:
            line = None
        assert line is not None, f"{self.command} says nothing more; its errors: {self.errors}"
        return line

    def wait_for(self, part):
        """Returns the next line that contains a text."""
        while True:
            line = self.line()
            if part in line:
                return line

    def finish(self):
        """Ends the program's input, and waits for its success."""
        self.process.stdin.close()
        status = self.process.wait(timeout=PATIENCE)
        assert status == 0, f"{self.command} ended with {status}; its errors: {self.errors}"

    def kill(self):
        self.process.kill()
        self.process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.kill()


class Master:
    """rosmaster, which can be killed and started again."""

    def __init__(self):
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.uri = f"http://127.0.0.1:{self.port}"
        self.start()

    def start(self):
        self.process = subprocess.Popen(
            ["rosmaster", "--core", "-p", str(self.port)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        wait_until(lambda: self.answers(), "rosmaster answers")

    def answers(self):
        try:
            return xmlrpc.client.ServerProxy(self.uri).getUri("/check")[0] == 1
        except OSError:
            return False

    def publishers(self, topic):
        state = xmlrpc.client.ServerProxy(self.uri).getSystemState("/check")[2]
        return dict(map(tuple, [(name, sorted(nodes)) for name, nodes in state[0]])).get(topic, [])

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def wait_until(condition, what, patience=PATIENCE):
    """Returns the seconds until a condition holds."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < patience, f"not within {patience} s: {what}"
        time.sleep(0.02)
    return time.monotonic() - start


def tool(*command):
    """Runs a command-line tool of ROS and returns its output."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
    return done.stdout


def start_master():
    """Starts a master, and sets the environment of nodes on loopback."""
    home = tempfile.mkdtemp(prefix="interop-ros1-")
    os.environ.update(ROS_IP="127.0.0.1", ROS_HOME=home, ROS_LOG_DIR=f"{home}/log", PYTHONUNBUFFERED="1")
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ.pop("ROS_NAMESPACE", None)
    master = Master()
    os.environ["ROS_MASTER_URI"] = master.uri
    return master
