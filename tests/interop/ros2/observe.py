"""Observes a chain of unmodified Cyclone DDS nodes. Usage: observe.py PEERNETD

Each of three nodes takes a known time. The medians of 20 messages that an agent reports must be within a millisecond of those that
each node measured, with one agent and with two. Another node drops some messages and publishes others without an input.
"""
import contextlib
import os
import pathlib
import sys
import tempfile

from observing import HOPS, Observer, check_latencies, check_two_agents, pipeline
from processes import Process, wait_until

HERE = pathlib.Path(__file__).resolve().parent
CHAIN = [sys.executable, HERE / "cyclonedds_chain.py"]
OFFER = [sys.executable, HERE / "cyclonedds_peer.py", "offer"]
# Each DROPPED-th message has no answer. Each EXTRA-th message has a second answer with another stamp.
MESSAGES, DROPPED, EXTRA = 120, 4, 5
TIMEOUT_MS, HZ = 500, 20


def check_chain(started, peernetd, folder):
    relays = []
    for source, target, seconds in HOPS:
        relays.append(started.enter_context(Process(*CHAIN, "relay", source, target, seconds)))
        relays[-1].wait_for("ready")
    started.enter_context(Process(*CHAIN, "camera", "/camera", 10)).wait_for("ready")
    pipelines = "".join(pipeline(f"hop{index}", 2, source, target) for index, (source, target, _) in enumerate(HOPS))
    with Observer(peernetd, folder, pipelines) as observer:
        check_latencies(observer, relays)
        facts = str(observer.get(f"runs/{observer.newest_run('hop0')['number']}")["facts"])
        for part in ("ROS 2, domain 0 on lo (127.0.0.1)", "/camera (sensor_msgs/msg/CompressedImage)", "on this host"):
            assert part in facts, f"{part} is missing in {facts}"
        # The facts use these words for a publisher on another host.
        assert "measures nothing" not in facts, facts
        observer.stop()
    check_two_agents(peernetd, folder, 2, relays)
    print("ok      the chain of Cyclone DDS nodes was observed", flush=True)


def check_counts(started, peernetd, folder):
    started.enter_context(Process(*CHAIN, "relay", "/lossy/in", "/lossy/out", 0.002, DROPPED, EXTRA)).wait_for("ready")
    started.enter_context(Process(*CHAIN, "camera", "/lossy/in", HZ)).wait_for("ready")
    keys = f"timeout_ms = {TIMEOUT_MS}\nwarm_up = {{ iterations = 0 }}\nlimit = {{ iterations = {MESSAGES} }}"
    with Observer(peernetd, folder, pipeline("lossy", 2, "/lossy/in", "/lossy/out", keys)) as observer:
        wait_until(lambda: (observer.newest_run("lossy") or {}).get("reason") == "finished", "the run ends by itself")
        run = observer.newest_run("lossy")["number"]
        counts = observer.get(f"runs/{run}")["counts"]
        assert (counts["ok"], counts["lost"]) == (MESSAGES - MESSAGES // DROPPED, MESSAGES // DROPPED), counts
        stages = observer.get(f"runs/{run}/stages")["stages"]
        unmatched = sum(one["count"] * one["mean"] for one in stages if one["name"] == "output-unmatched")
        # An EXTRA-th message that is also a DROPPED-th has no answer at all. Second answers of the first TIMEOUT_MS are
        # not counted, because they may belong to inputs before the run. Those of the last TIMEOUT_MS may still be
        # matched.
        max_unmatched = MESSAGES // EXTRA - MESSAGES // (EXTRA * DROPPED)
        undecided = 2 * (HZ * TIMEOUT_MS // 1000 // EXTRA + 1)
        assert max_unmatched - undecided <= unmatched <= max_unmatched, f"{unmatched} of {max_unmatched}"
        observer.stop()
    print(f"ok      {counts['lost']} of {MESSAGES} messages lost, {unmatched:.0f} second answers unmatched", flush=True)


def check_errors(started, peernetd, folder):
    for topic in ("/words", "/answers"):
        started.enter_context(Process(*OFFER, topic, "string", 10_000, 100))
    with Observer(peernetd, folder, pipeline("words", 2, "/words", "/answers")) as observer:
        refused = "has the type std_msgs/msg/String, which does not begin with a std_msgs/Header; set pair_by"
        wait_until(lambda: observer.has_error(refused), "the log says that there is no header")
        observer.stop()
    elsewhere = dict(os.environ, ROS_DOMAIN_ID="9")
    with Observer(peernetd, folder, pipeline("nobody", 2, "/words", "/answers"), elsewhere) as observer:
        parts = ["after 10 s of waiting: no node publishes /words; no node publishes /answers", "its ROS_DOMAIN_ID 9"]
        wait_until(lambda: all(map(observer.has_error, parts)), "the log names topics and domain")
        observer.stop()
    print("ok      topics without header and a wrong domain are named", flush=True)


def main():
    for check in (check_chain, check_counts, check_errors):
        with contextlib.ExitStack() as started:
            folder = started.enter_context(tempfile.TemporaryDirectory(prefix="interop-ros2-"))
            check(started, os.path.abspath(sys.argv[1]), folder)


main()
