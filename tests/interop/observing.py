"""An agent that observes a chain of nodes, of either version of ROS."""
import json
import statistics
import time
import urllib.error
import urllib.request

from processes import Process, free_port, wait_until

# Nodes of the chain: topics and the seconds that they take.
HOPS = [("/camera", "/a", 0.005), ("/a", "/b", 0.02), ("/b", "/c", 0.05)]
# Largest difference in seconds between what is reported and what was taken, on a machine where nobody waits for a processor.
TOLERANCE = 0.001
# Messages that a median is taken of, here as by a node.
WINDOW = 20
# A busy machine lets nodes and agent wait for a processor: until it does not for a while.
PATIENCE = 120


def pipeline(name, ros_version, source, target, keys="", peer=""):
    """Returns the configuration of a pipeline that observes what is between two topics, together with the agent at an address."""
    together = f', peer = "{peer}"' if peer else ""
    return (
        f'[[pipeline]]\nname = "{name}"\n{keys}\n'
        f'placement = {{ kind = "observe", ros_version = {ros_version}, input = "{source}", output = "{target}"{together} }}\n'
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
        """Returns a resource of the API; nothing while there is none."""
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self.http}/api/v1/{path}", timeout=10) as answer:
                return json.load(answer)
        except (OSError, urllib.error.URLError):
            return None

    def run_of(self, name):
        """Returns the newest run of a pipeline, if there is one."""
        runs = (self.get("runs") or {"runs": []})["runs"]
        return next((run for run in runs if run["pipeline"] == name), None)

    def answered(self, name):
        """Returns the newest stored iterations with an answer of the newest run of a pipeline, at most WINDOW."""
        run = self.run_of(name)
        after = max(0, sum(run["counts"].values()) - 5 * WINDOW) if run else 0
        found = run and self.get(f"runs/{run['number']}/iterations?after={after}&limit=1000")
        return [one for one in found["iterations"] if one["outcome"] == "ok"][-WINDOW:] if found else []


def tolerance():
    """Returns the largest difference between what is reported and what was taken, in seconds.

    A node says what it took from the moment at which it runs until it publishes. What is reported begins and ends when the agent and
    the next node are woken: on a busy machine both wait for a processor, as a sleeping process does.
    """
    late = []
    for _ in range(WINDOW):
        begun = time.perf_counter()
        time.sleep(TOLERANCE)
        late.append(time.perf_counter() - begun - TOLERANCE)
    return TOLERANCE + 2 * statistics.median(late)


def check_latencies(observer, relays):
    """Waits until the medians that the pipelines `hop0`, `hop1`, … report are those that the nodes say they took."""

    def compared(index):
        said = relays[index].newest("median")
        totals = [one["total"] for one in observer.answered(f"hop{index}")]
        if said is None or len(totals) < WINDOW:
            return None
        return statistics.median(totals), float(said.split()[1])

    for index, (_, _, seconds) in enumerate(HOPS):
        found = []

        def agrees():
            found.append(compared(index))
            return found[-1] is not None and abs(found[-1][0] - found[-1][1]) < tolerance()

        wait_until(agrees, lambda: f"medians of {seconds} s, reported and taken, within a millisecond: {found[-1]}", PATIENCE)
        reported, taken = found[-1]
        print(f"ok      hop {index}: {reported * 1e3:.2f} ms reported, {taken * 1e3:.2f} ms taken", flush=True)
        assert taken >= seconds


def check_two_agents(peernetd, folder, ros_version, relays):
    """Observes the chain as if its second node were on another host: the first one is the way there, the third one the way back.

    The clock of that host's agent is 5 s ahead. Waits until the medians of all three stages are those that the nodes say.
    """
    data, topics = free_port(), [source for source, _, _ in HOPS] + [HOPS[-1][1]]
    serve = f'[serve]\nlisten = "tcp://127.0.0.1:{data}"\n[clock_fault]\noffset_ms = 5000.0\n'
    rack = serve + pipeline("chain", ros_version, topics[1], topics[2])
    robot = pipeline("chain", ros_version, topics[0], topics[3], peer=f"tcp://127.0.0.1:{data}")
    with Observer(peernetd, folder, rack, name="rack"), Observer(peernetd, folder, robot) as observer:
        found = {}

        def agrees():
            newest = observer.answered("chain")
            for name, relay in zip(("upload", "inference", "download"), relays):
                said = relay.newest("median")
                seconds = [stage["seconds"] for one in newest for stage in one["stages"] if stage["name"] == name]
                seconds = [value for value in seconds if value is not None]
                if said and len(seconds) == WINDOW:
                    found[name] = (statistics.median(seconds), float(said.split()[1]))
            allowed = tolerance()
            return len(found) == len(HOPS) and all(abs(reported - taken) < allowed for reported, taken in found.values())

        wait_until(agrees, lambda: f"stages of both hosts, reported and taken: {found}", PATIENCE)
        detail = observer.get(f"runs/{observer.run_of('chain')['number']}")
        assert detail["placement"]["peer"] == "rack", detail
        observer.stop()
    for name, (reported, taken) in found.items():
        print(f"ok      {name}: {reported * 1e3:.2f} ms reported, {taken * 1e3:.2f} ms taken, clocks 5 s apart", flush=True)
