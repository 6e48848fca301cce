"""Checks nodes of PEERNet against rosmaster, rostopic, rosnode and rospy. Usage: check.py ROS1_PEER [measure]

Needs the packages that `deploy/install-tools.sh interop` installs. Everything runs on loopback, with a master on a
free port. The last line has the number of passed checks.
"""
import ctypes
import glob
import os
import re
import socket
import subprocess
import sys
import time
import traceback
import xmlrpc.client

from harness import ROSPY, run_tool, start_master
from processes import TIMEOUT_S, Process, wait_until

# Longest time until all topics are registered again at a restarted master, as documented in daemon/ros/src/ros1. Seconds.
MAX_REREGISTRATION_S = 5
PICTURES = 200
PICTURE_BYTES = 1_000_000

OURS = os.path.abspath(sys.argv[1])


def ours(*arguments):
    return Process(OURS, *arguments)


def rospy(*arguments):
    return Process(*ROSPY, *arguments)


def check_tools_see_our_publisher():
    with ours("latch", "talker", "/text", "hello from us") as talker:
        talker.wait_for("ready")
        assert "hello from us" in run_tool("rostopic", "echo", "-n", "1", "/text")
        assert "/text" in run_tool("rostopic", "list").split()
        assert run_tool("rostopic", "type", "/text").strip() == "std_msgs/String"
        assert "/talker" in run_tool("rostopic", "info", "/text")
        assert "/talker" in run_tool("rosnode", "list").split()
        assert "reply from" in run_tool("rosnode", "ping", "-c", "1", "/talker")
        with Process("rostopic", "echo", "/text") as echo:
            echo.wait_for("hello from us")
            information = run_tool("rosnode", "info", "/talker")
            assert "direction: outbound" in information, information
        talker.finish()
    assert master.publishers("/text") == []


def check_rosnode_kill_ends_our_node():
    with ours("subscribe", "victim", "/text", 1) as victim:
        victim.wait_for("ready")
        run_tool("rosnode", "kill", "/victim")
        assert "asked it to shut down" in victim.wait_for("error")


def check_we_receive_from_rostopic_pub():
    with ours("subscribe", "listener", "/from_tool", 1) as listener:
        listener.wait_for("ready")
        run_tool("rostopic", "pub", "-1", "/from_tool", "std_msgs/String", "data: 'from the tool'")
        assert listener.wait_for("text") == "text from the tool"
        listener.finish()


def check_rostopic_hz_counts_our_messages():
    with ours("publish", "stream", "/stream", 1_000_000, 1000) as stream, \
            Process("stdbuf", "-oL", "rostopic", "hz", "/stream") as meter:
        stream.wait_for("ready")
        rate = float(re.search(r"average rate: ([\d.]+)", meter.wait_for("average rate")).group(1))
        assert rate > 1000, rate
        print(f"    rostopic hz sees {rate:.0f} messages of 1 kB per second")


def check_pictures_from_rospy_all_arrive():
    with ours("subscribe", "sink", "/pictures", PICTURES) as sink:
        sink.wait_for("ready")
        with rospy("publish", "source", "/pictures", PICTURES, PICTURE_BYTES) as source:
            for number in range(PICTURES):
                line = sink.wait_for("picture")
                assert line == f"picture {number} {PICTURE_BYTES} intact from /source", line
            assert sink.line() == f"messages {PICTURES} dropped 0"
            sink.finish()
            source.finish()


def check_pictures_to_rospy_all_arrive():
    with ours("publish", "source", "/pictures", PICTURES, PICTURE_BYTES) as source:
        source.wait_for("ready")
        with rospy("subscribe", "sink", "/pictures", PICTURES) as sink:
            for number in range(PICTURES):
                line = sink.wait_for("picture")
                assert line == f"picture {number} {PICTURE_BYTES} intact", line
            source.process.stdin.close()
            assert source.wait_for("offered") == f"offered {PICTURES} sent {PICTURES} dropped 0 lost 0"
            sink.finish()


def check_rospy_with_other_type_is_refused():
    with ours("publish", "typed", "/typed", 1, 10) as typed:
        typed.wait_for("ready")
        with rospy("refused", "wrong", "/typed") as wrong:
            wrong.wait_for("ready")
            wait_until(lambda: typed.has_error("a connection of a ROS subscriber was not established"), "refused")
        texts = "".join(open(path, errors="replace").read() for path in glob.glob(f"{os.environ['ROS_LOG_DIR']}/*.log"))
        expected = (
            "topic /typed has two message types: "
            "sensor_msgs/CompressedImage (md5sum 8f7a12909da2c9d3332d540a0977563f) here, "
            "std_msgs/String (md5sum 992ce8a1687cec8c8bd883ec73ca41d1) at node /wrong"
        )
        # The text is in the log of the refused rospy node or in that of our node.
        assert expected in texts or typed.has_error(expected), typed.errors


def check_rospy_refuses_us_with_its_text():
    with rospy("publish", "typed", "/typed", 1, 10) as typed:
        typed.wait_for("ready")
        # `state` prints the states of the topic's publishers until one fails.
        with ours("state", "wrong", "/typed") as wrong:
            line = wrong.wait_for("failed")
            assert "the publisher of topic /typed refuses the subscription: " in line, line
            print(f"    {line}")


def check_restarted_master_knows_our_topics():
    with ours("latch", "talker", "/text", "still here") as talker, \
            ours("subscribe", "listener", "/later", 1) as listener:
        talker.wait_for("ready")
        listener.wait_for("ready")
        master.kill()
        time.sleep(1)
        master.start()
        seconds = wait_until(lambda: master.publishers("/text") == ["/talker"], "registered", MAX_REREGISTRATION_S)
        print(f"    registered again {seconds:.1f} s after the master's restart")
        assert "still here" in run_tool("rostopic", "echo", "-n", "1", "/text")
        run_tool("rostopic", "pub", "-1", "/later", "std_msgs/String", "data: 'after the restart'")
        assert listener.wait_for("text") == "text after the restart"


def tcp_options(pid, port):
    """Returns TCP_NODELAY of a process's established TCP connections that have a port at one end."""
    library = ctypes.CDLL(None, use_errno=True)
    process = os.pidfd_open(pid)
    found = []
    for entry in os.listdir(f"/proc/{pid}/fd"):
        # pidfd_getfd, for which Python has no function.
        copy = library.syscall(438, process, int(entry), 0)
        if copy < 0:
            continue
        try:
            connection = socket.socket(fileno=copy)
            ends = {connection.getsockname()[1], connection.getpeername()[1]}
            if port in ends:
                found.append(connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            connection.close()
        except (OSError, TypeError, IndexError):
            # The descriptor is not an established connection.
            pass
    os.close(process)
    return found


def check_connections_have_nodelay():
    with ours("latch", "talker", "/text", "quick") as talker:
        talker.wait_for("ready")
        with Process("rostopic", "echo", "/text") as echo:
            echo.wait_for("quick")
            node = xmlrpc.client.ServerProxy(xmlrpc.client.ServerProxy(master.uri).lookupNode("/check", "/talker")[2])
            port = node.requestTopic("/check", "/text", [["TCPROS"]])[2][2]
            options = tcp_options(talker.process.pid, port)
            assert options and all(options), options


def check_own_address_is_found_without_ros_ip():
    environment = {name: value for name, value in os.environ.items() if name != "ROS_IP"}
    environment["ROS_MASTER_URI"] = f"http://localhost:{master.port}"
    with Process(OURS, "latch", "talker", "/text", "found", environment=environment) as talker:
        talker.wait_for("ready")
        assert "found" in run_tool("rostopic", "echo", "-n", "1", "/text")
        talker.finish()


def check_error_names_unreachable_master():
    environment = dict(os.environ, ROS_MASTER_URI="http://127.0.0.1:9")
    done = subprocess.run([OURS, "state", "lonely", "/t"], env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    expected = "no ROS master answers at http://127.0.0.1:9: Connection refused (os error 111)"
    assert done.returncode == 1 and expected in done.stdout, done


def measure():
    """Prints round trips over two topics, one message at a time, and the rates over one topic."""
    print(f"\n{'round trips':24}{'bytes':>10}{'median us':>11}{'p99 us':>9}{'per s':>8}")
    for title, pinger, echoer in [("ours, rospy echoes", ours, rospy), ("rospy, rospy echoes", rospy, rospy),
                                  ("ours, ours echoes", ours, ours)]:
        for length, count in [(1000, 2000), (PICTURE_BYTES, 200)]:
            with echoer("echo", "echo", "/ping", "/pong") as echo:
                echo.wait_for("ready")
                with pinger("ping", "ping", "/ping", "/pong", count, length) as ping:
                    figures = re.search(r"median (\d+) p99 (\d+) rate (\d+)", ping.wait_for("median"))
                    ping.finish()
                print(f"{title:24}{length:>10}{figures[1]:>11}{figures[2]:>9}{figures[3]:>8}")

    print(f"\n{'one way':24}{'bytes':>10}{'per s':>11}")
    for title, source, sink in [("ours to rospy", ours, rospy), ("rospy to ours", rospy, ours),
                                ("rospy to rospy", rospy, rospy), ("ours to ours", ours, ours)]:
        for length, count in [(1000, 20_000), (PICTURE_BYTES, 200)]:
            with sink("rate", "sink", "/flow", count) as meter:
                meter.wait_for("ready")
                with source("publish", "source", "/flow", count, length):
                    rate = re.search(r"rate (\d+) dropped 0", meter.wait_for("rate"))
                    meter.finish()
                print(f"{title:24}{length:>10}{rate[1]:>11}")


checks = [value for name, value in list(globals().items()) if name.startswith("check_")]
master = start_master()
failed = 0
try:
    for check in checks:
        title = check.__name__.removeprefix("check_").replace("_", " ")
        try:
            check()
            print(f"ok    {title}", flush=True)
        except Exception:
            failed += 1
            print(f"FAIL  {title}\n{traceback.format_exc()}", flush=True)
    # Only meaningful with a release build.
    if sys.argv[2:] == ["measure"]:
        measure()
finally:
    master.kill()
print(f"ros1: {len(checks) - failed} passed, {failed} failed")
sys.exit(failed > 0)
