#!/usr/bin/env bash
# Builds the programs for the interoperability tests: the daemon with ROS 2, the examples, and the tests of ROS 2. One command builds
# the whole workspace, because cargo rebuilds the dependencies for another choice of packages or features.
# Usage: build.sh [--test]    (--test: also runs the tests of ROS 2)
set -euo pipefail
cd "$(dirname "$0")/../.."
common=(--workspace --locked --features "peernetd/ros2,peernet-ros/ros2,peernet-networks/ros2" --test ros2)
cargo build "${common[@]}" --bins --examples
if [[ ${1:-} == --test ]]; then
    exec cargo test "${common[@]}" --offline -- ros2:: ::ros2 sessions:: topics::
fi
