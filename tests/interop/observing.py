"""An agent that observes a chain of nodes, of either version of ROS."""
import json
import statistics
import urllib.error
import urllib.request

from processes import Process, free_port, wait_until

# Nodes of the chain: topics and the seconds that they take.
HOPS = [("/camera", "/a", 0.005), ("/a", "/b", 0.02), ("/b", "/c", 0.05)]
# Largest difference in seconds between what is reported and what was taken.
TOLERANCE = 0.001
# Messages that a median is taken of, here as by a node.
WINDOW = 20
# A busy machine lets nodes and agent wait for a processor: until it does not for a while.
PATIENCE = 120


def pipeline(name, ros_version, source, target, keys=""):
    """Returns the configuration of a pipeline that observes what is between two topics."""
    return (
        f'[[pipeline]]\nname = "{name}"\n{keys}\n'
        f'placement = {{ kind = "observe", ros_version = {ros_version}, input = "{source}", output = "{target}" }}\n'
    )


class Observer(Process):
    """An agent and its aggregator in one process."""

    def __init__(self, peernetd, folder, pipelines, environment=None):
        events, self.http = free_port(), free_port()
        file = f"{folder}/robot.toml"
        with open(file, "w") as text:
            text.write(
                f'[aggregator]\nname = "aggregator"\nlisten = "tcp://127.0.0.1:{events}"\n'
                f'database = "{folder}/database.sqlite"\n[web]\nlisten = "127.0.0.1:{self.http}"\n'
                f'[agent]\nname = "robot"\nstate_dir = "{folder}/robot"\naggregator = "tcp://127.0.0.1:{events}"\n'
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

    def iterations(self, name):
        """Returns the stored iterations of the newest run of a pipeline."""
        run = self.run_of(name)
        found = run and self.get(f"runs/{run['number']}/iterations?limit=1000")
        return found["iterations"] if found else []


def check_latencies(observer, relays):
    """Waits until the medians that the pipelines `hop0`, `hop1`, … report are those that the nodes say they took."""

    def compared(index):
        said = relays[index].newest("median")
        totals = [one["total"] for one in observer.iterations(f"hop{index}") if one["outcome"] == "ok"][-WINDOW:]
        if said is None or len(totals) < WINDOW:
            return None
        reported, taken = statistics.median(totals), float(said.split()[1])
        return (reported, taken) if abs(reported - taken) < TOLERANCE else None

    for index, (_, _, seconds) in enumerate(HOPS):
        found = []

        def agrees():
            found.append(compared(index))
            return found[-1] is not None

        wait_until(agrees, f"a median within a millisecond of {seconds} s", PATIENCE)
        reported, taken = found[-1]
        print(f"ok      hop {index}: {reported * 1e3:.2f} ms reported, {taken * 1e3:.2f} ms taken", flush=True)
        assert taken >= seconds
