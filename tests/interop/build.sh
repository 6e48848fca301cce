#!/usr/bin/env bash
# Builds the programs of ours that meet foreign peers: the daemon with ROS 2, and the examples. With the features of the whole
# workspace, so that what `make test` has built is built once.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo build --workspace --bins --examples --locked --features peernetd/ros2,peernet-ros/ros2
