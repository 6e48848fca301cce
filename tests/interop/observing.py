"""An agent that observes a chain of nodes, of either version of ROS."""
import json
import statistics
import time
import urllib.error
import urllib.request

from processes import Process, free_port, wait_until

# Nodes of the chain: input topic, output topic, processing time in seconds.
HOPS = [("/camera", "/a", 0.005), ("/a", "/b", 0.02), ("/b", "/c", 0.05)]
# Largest difference between reported and real durations on an idle machine. Seconds.
TOLERANCE = 0.001
# Number of messages of a median. The nodes print a median after as many messages.
WINDOW = 20
# Time limit of the comparisons. On a busy machine they only succeed while neither nodes nor agent wait for a processor. Seconds.
TIMEOUT_S = 120


def pipeline(name, ros_version, source, target, keys="", peer=""):
    """Returns the configuration of a pipeline that observes the nodes between two topics.

    `peer` is the address of the agent on the host of the middle nodes; empty if all nodes are on one host.
    """
    peer_key = f', peer = "{peer}"' if peer else ""
    return (
        f'[[pipeline]]\nname = "{name}"\n{keys}\n'
        f'placement = {{ kind = "observe", ros_version = {ros_version}, input = "{source}", output = "{target}"{peer_key} }}\n'
    )


class Observer(Process):
    """An agent and its aggregator in one process."""

    def __init__(self, peernetd, folder, pipelines, environment=None, name="robot"):
        events, self.http = free_port(), free_port()
        file = f"{folder}/{name}.toml"
        with open(file, "w") as text:
            text.write(
                f'[aggregator]\nname = "aggregator"\nlisten = "tcp://127.0.0.1:{events}"\n'
                f'database = "{folder}/{name}.sqlite"\n[web]\nlisten = "127.0.0.1:{self.http}"\n'
                f'[agent]\nname = "{name}"\nstate_dir = "{folder}/{name}"\naggregator = "tcp://127.0.0.1:{events}"\n'
                + pipelines
            )
        super().__init__(peernetd, "run", file, environment=environment)

    def get(self, path):
        """Returns a resource of the API, or None while it does not exist."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.http}/api/v1/{path}", timeout=10) as answer:
                return json.load(answer)
        except (OSError, urllib.error.URLError):
            return None

    def newest_run(self, name):
        """Returns the newest run of a pipeline, if there is one."""
        runs = (self.get("runs") or {"runs": []})["runs"]
        return next((run for run in runs if run["pipeline"] == name), None)

    def answered_iterations(self, name):
        """Returns the newest answered iterations of the newest run of a pipeline, at most WINDOW."""
        run = self.newest_run(name)
        # Lost and failed iterations are left out, so more iterations than WINDOW are requested.
        after = max(0, sum(run["counts"].values()) - 5 * WINDOW) if run else 0
        found = run and self.get(f"runs/{run['number']}/iterations?after={after}&limit=1000")
        return [one for one in found["iterations"] if one["outcome"] == "ok"][-WINDOW:] if found else []


def tolerance():
    """Returns the largest allowed difference between reported and real durations, in seconds.

    A node measures from the moment at which it runs until it publishes. The agent measures between the moments at which
    it is woken. On a busy machine both wait for a processor. A sleeping process waits as long, so its median delay is
    measured and allowed for both.
    """
    delays = []
    for _ in range(WINDOW):
        start = time.perf_counter()
        time.sleep(TOLERANCE)
        delays.append(time.perf_counter() - start - TOLERANCE)
    return TOLERANCE + 2 * statistics.median(delays)


def check_latencies(observer, relays):
    """Waits until the medians of the pipelines `hop0`, `hop1`, … agree with those that the nodes print."""

    def medians(index):
        """Returns the reported and the real median of a hop, seconds; None with too few messages."""
        # A node prints `median SECONDS` after each WINDOW messages.
        printed = relays[index].newest("median")
        totals = [one["total"] for one in observer.answered_iterations(f"hop{index}")]
        if printed is None or len(totals) < WINDOW:
            return None
        return statistics.median(totals), float(printed.split()[1])

    for index, (_, _, seconds) in enumerate(HOPS):
        found = []

        def agrees():
            found.append(medians(index))
            return found[-1] is not None and abs(found[-1][0] - found[-1][1]) < tolerance()

        wait_until(agrees, lambda: f"reported and real medians of {seconds} s agree: {found[-1]}", TIMEOUT_S)
        reported, real = found[-1]
        print(f"ok      hop {index}: {reported * 1e3:.2f} ms reported, {real * 1e3:.2f} ms real", flush=True)
        assert real >= seconds


def check_two_agents(peernetd, folder, ros_version, relays):
    """Observes the chain as if its second node were on another host.

    The time of the first node must be reported as the upload, that of the third node as the download. The clock of the
    other host's agent is 5 s ahead. Waits until the medians of all three stages agree with those that the nodes print.
    """
    data, topics = free_port(), [source for source, _, _ in HOPS] + [HOPS[-1][1]]
    serve = f'[serve]\nlisten = "tcp://127.0.0.1:{data}"\n[clock_fault]\noffset_ms = 5000.0\n'
    rack = serve + pipeline("chain", ros_version, topics[1], topics[2])
    robot = pipeline("chain", ros_version, topics[0], topics[3], peer=f"tcp://127.0.0.1:{data}")
    with Observer(peernetd, folder, rack, name="rack"), Observer(peernetd, folder, robot) as observer:
        found = {}

        def agrees():
            newest = observer.answered_iterations("chain")
            for name, relay in zip(("upload", "inference", "download"), relays):
                printed = relay.newest("median")
                seconds = [stage["seconds"] for one in newest for stage in one["stages"] if stage["name"] == name]
                seconds = [value for value in seconds if value is not None]
                if printed and len(seconds) == WINDOW:
                    found[name] = (statistics.median(seconds), float(printed.split()[1]))
            allowed = tolerance()
            return len(found) == len(HOPS) and all(abs(reported - real) < allowed for reported, real in found.values())

        wait_until(agrees, lambda: f"reported and real stages of both hosts agree: {found}", TIMEOUT_S)
        detail = observer.get(f"runs/{observer.newest_run('chain')['number']}")
        assert detail["placement"]["peer"] == "rack", detail
        observer.stop()
    for name, (reported, real) in found.items():
        print(f"ok      {name}: {reported * 1e3:.2f} ms reported, {real * 1e3:.2f} ms real, clocks 5 s apart", flush=True)
