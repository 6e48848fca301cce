#!/usr/bin/env bash
# Builds all of ours that meets foreign peers: the daemon with ROS 2, the examples, and the tests of ROS 2. In one command for the
# whole workspace, because cargo builds the dependencies anew for another choice of packages or features.
# Usage: build.sh [--test]    (--test: runs the tests of ROS 2, too)
set -euo pipefail
cd "$(dirname "$0")/../.."
common=(--workspace --locked --features "peernetd/ros2,peernet-ros/ros2,peernet-networks/ros2" --test ros2)
cargo build "${common[@]}" --bins --examples
if [[ ${1:-} == --test ]]; then
    exec cargo test "${common[@]}" --offline -- ros2:: ::ros2 sessions:: topics::
fi
