#!/bin/sh
# The benchmarks of `make bench`: tables on standard output and, as Markdown, in target/bench/measurements.md.
# Usage: run.sh [--quick] [node|loop|networks|python|model|detection|efficientnet|batching|decoding|streaming|ingest|stream|live|pages|delays|violations|idle|agent|attacked|browser]…    (all of them unless some are named)
set -eu
here=$(cd "$(dirname "$0")" && pwd)
python=$here/../../.venv-tools/bin/python
[ -x "$python" ] || { echo "run.sh: $python does not exist; create it with deploy/install-tools.sh bench" >&2; exit 69; }
exec "$python" -B "$here" "$@"
