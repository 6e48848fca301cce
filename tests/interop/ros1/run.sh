#!/usr/bin/env bash
# Nodes of ours against the ROS 1 of Debian: rosmaster, rostopic, rosnode and rospy.
set -euo pipefail
cd "$(dirname "$0")/../../.."
cargo build --release --locked --package peernet-ros --example ros1_peer
exec python3 tests/interop/ros1/check.py "${CARGO_TARGET_DIR:-target}/release/examples/ros1_peer"
