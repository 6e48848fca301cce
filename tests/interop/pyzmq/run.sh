#!/usr/bin/env bash
# An edge in Python with libzmq (pyzmq) against a cloud of PEERNet. It implements the session protocol of docs/session-protocol.md.
# Runs on loopback, on a free port.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)

"$root/tests/interop/build.sh"
exec "$root/.venv-tools/interop/bin/python" "$here/check.py" "${CARGO_TARGET_DIR:-$root/target}/debug/peernetd"
