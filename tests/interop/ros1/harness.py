"""A master and programs for the checks with ROS 1."""
import os
import signal
import subprocess
import tempfile
import xmlrpc.client

from processes import TIMEOUT_S, free_port, wait_until

# Only Debian's Python can import the rospy of Debian's packages.
ROSPY = ["/usr/bin/python3", os.path.join(os.path.dirname(os.path.abspath(__file__)), "rospy_peer.py")]


class Master:
    """rosmaster, which can be killed and started again."""

    def __init__(self):
        self.port = free_port()
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
        """Returns the names of the nodes that publish a topic, sorted."""
        publishers, _subscribers, _services = xmlrpc.client.ServerProxy(self.uri).getSystemState("/check")[2]
        return {name: sorted(nodes) for name, nodes in publishers}.get(topic, [])

    def kill(self):
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def run_tool(*command):
    """Runs a command-line tool of ROS and returns its output."""
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S)
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
