"""Checks a cloud of PEERNet with edges that use libzmq. Usage: check.py PEERNETD"""
import os
import socket
import subprocess
import sys
import tempfile
import time
import traceback

import zmq

from edge import Refused, Session

CONFIGURATION = """
[agent]
name = "cloud"
state_dir = "{folder}/cloud"

[serve]
listen = "tcp://127.0.0.1:{port}"

[[model]]
name = "echo"
kind = "echo"

[[model]]
name = "sleep"
kind = "sleep"
inference_ms = 300
"""
# Longer than the heartbeat timeout of a cloud, 5 s by default, after which the session of a silent peer ends.
IDLE_S = 12


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


def check_payloads_of_all_sizes_come_back_unchanged(context, address):
    session = Session(context, address, "echo")
    for size in [0, 1, 1_000, 60_000, 1_200_000, 20_000_000]:
        payload = os.urandom(size)
        number = session.request([payload])
        answered, parts, _nodes = session.answer()
        assert (answered, parts) == (number, [payload]), size
    several = [os.urandom(size) for size in [10, 0, 100_000]]
    session.request(several)
    assert session.answer()[1] == several
    session.close()


def check_answers_of_requests_in_flight_name_their_request(context, address):
    session = Session(context, address, "echo")
    payloads = {session.request([bytes([number])]): bytes([number]) for number in range(10)}
    for _ in range(10):
        number, parts, _nodes = session.answer()
        assert parts == [payloads.pop(number)]
    session.close()


def check_stages_of_the_cloud_come_with_the_answer(context, address):
    session = Session(context, address, "sleep")
    session.request([b"x"])
    _number, _parts, nodes = session.answer()
    # Number 9 of the standard names is `inference`, kind 1 a timer in nanoseconds.
    durations = [node[5] for node in nodes if node[1] == 9 and node[4] == 1]
    assert len(durations) == 1 and 0.3e9 <= durations[0] < 5e9, nodes
    session.close()


def check_unknown_model_is_refused_with_the_known_models(context, address):
    try:
        Session(context, address, "no-such-model")
    except Refused as refused:
        assert "echo" in str(refused) and "sleep" in str(refused), refused
    else:
        raise AssertionError("the unknown model was accepted")


def check_idle_session_stays_open(context, address):
    session = Session(context, address, "echo")
    time.sleep(IDLE_S)
    session.request([b"still here"])
    assert session.answer()[1] == [b"still here"]
    session.close()


def check_garbage_disturbs_no_other_session(context, address):
    session = Session(context, address, "echo")
    # The byte 0x81 begins a map of one entry in MessagePack. The entry is missing.
    for garbage in [[b"garbage"], [b""], [b"\x81", b"x"], [os.urandom(1000)] * 3]:
        misbehaving_peer = context.socket(zmq.DEALER)
        misbehaving_peer.connect(address)
        misbehaving_peer.send_multipart(garbage)
        session.request([b"unharmed"])
        assert session.answer()[1] == [b"unharmed"]
        misbehaving_peer.close(linger=1000)
    session.close()


def check_many_edges_are_served(context, address):
    sessions = [Session(context, address, "echo", f"line-{number}") for number in range(8)]
    for round_number in range(20):
        for session in sessions:
            session.request([b"%d" % round_number])
        for session in sessions:
            assert session.answer()[1] == [b"%d" % round_number]
    for session in sessions:
        session.close()


def main():
    folder = tempfile.mkdtemp(prefix="interop-pyzmq-")
    port = free_port()
    file = os.path.join(folder, "cloud.toml")
    with open(file, "w") as text:
        text.write(CONFIGURATION.format(folder=folder, port=port))
    log = open(os.path.join(folder, "log"), "w+")
    cloud = subprocess.Popen([sys.argv[1], "run", file], stdout=log, stderr=log)
    context, address, failed = zmq.Context(), f"tcp://127.0.0.1:{port}", 0
    checks = [value for name, value in globals().items() if name.startswith("check_")]
    try:
        for check in checks:
            title = check.__name__.removeprefix("check_").replace("_", " ")
            try:
                check(context, address)
                print(f"ok    {title}", flush=True)
            except Exception:
                failed += 1
                print(f"FAIL  {title}\n{traceback.format_exc()}", flush=True)
    finally:
        context.destroy(linger=0)
        cloud.terminate()
        if cloud.wait(timeout=60) != 0:
            failed += 1
            print(f"FAIL  the cloud ended with {cloud.returncode}")
        if failed:
            log.seek(0)
            print(log.read())
    print(f"pyzmq {zmq.pyzmq_version()}, libzmq {zmq.zmq_version()}: {len(checks)} checks, {failed} failed")
    return 1 if failed else 0


sys.exit(main())
