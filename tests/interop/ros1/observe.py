"""Observes a chain of unmodified rospy nodes. Usage: observe.py PEERNETD

Each of three nodes takes a known time. The medians of 20 messages that an agent reports must be within a millisecond of those that
each node measured, with one agent and with two.
"""
import contextlib
import os
import pathlib
import sys
import tempfile

from harness import start_master
from observing import HOPS, Observer, check_latencies, check_two_agents, pipeline
from processes import Process

# Only Debian's Python can import the rospy of Debian's packages.
CHAIN = ["/usr/bin/python3", pathlib.Path(__file__).resolve().parent / "rospy_chain.py"]


def main():
    master = start_master()
    try:
        with contextlib.ExitStack() as started:
            relays = []
            for index, (source, target, seconds) in enumerate(HOPS):
                relay = Process(*CHAIN, "relay", f"relay{index}", source, target, seconds)
                relays.append(started.enter_context(relay))
                relay.wait_for("ready")
            camera = started.enter_context(Process(*CHAIN, "camera", "camera", "/camera", 10))
            camera.wait_for("ready")
            folder = started.enter_context(tempfile.TemporaryDirectory(prefix="interop-ros1-"))
            pipelines = "".join(
                pipeline(f"hop{index}", 1, source, target) for index, (source, target, _) in enumerate(HOPS)
            )
            peernetd = os.path.abspath(sys.argv[1])
            with Observer(peernetd, folder, pipelines) as observer:
                check_latencies(observer, relays)
                observer.stop()
            check_two_agents(peernetd, folder, 1, relays)
        print("ok      the chain of rospy nodes was observed")
    finally:
        master.kill()


main()
