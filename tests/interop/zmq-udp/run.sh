#!/usr/bin/env bash
# An edge and a cloud of zmq-udp whose datagrams all pass through real RADIO and DISH sockets of libzmq, in both
# directions. Builds libzmq with its draft sockets, which needs a C++ compiler and takes a minute or two the first time.
set -euo pipefail
cd "$(dirname "$0")/../../.."
tests/interop/build.sh
here=tests/interop/zmq-udp
# Suppresses the warnings of libzmq.
CFLAGS=-w CXXFLAGS=-w cargo build --locked --manifest-path "$here/Cargo.toml" --target-dir target/interop
exec "${CARGO_TARGET_DIR:-target}/debug/examples/zmq_udp_peer" target/interop/debug/peernet-interop-zmq-udp
