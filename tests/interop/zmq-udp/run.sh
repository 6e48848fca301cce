#!/usr/bin/env bash
# An edge and a cloud of zmq-udp whose datagrams all pass through real RADIO and DISH sockets of libzmq, in both
# directions. Builds libzmq with its draft sockets, which takes some minutes and a C++ compiler the first time.
set -euo pipefail
cd "$(dirname "$0")/../../.."
exec cargo run --release --manifest-path tests/interop/zmq-udp/Cargo.toml --target-dir target/interop
