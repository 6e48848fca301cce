#!/usr/bin/env bash
# Nodes and agents of PEERNet against the ROS 1 of Debian: rosmaster, rostopic, rosnode and rospy.
set -euo pipefail
cd "$(dirname "$0")/../../.."
tests/interop/build.sh
export PYTHONPATH=$PWD/tests/interop
programs=${CARGO_TARGET_DIR:-target}/debug
python3 tests/interop/ros1/check.py "$programs/examples/ros1_peer"
python3 tests/interop/ros1/agent.py "$programs/peernetd"
python3 tests/interop/ros1/observe.py "$programs/peernetd"
