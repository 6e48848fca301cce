#!/usr/bin/env bash
# Models of kind `openai` against llama.cpp's server (PyPI xllamacpp) with a model of random weights. Runs on loopback, on free ports.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)

"$root/tests/interop/build.sh"
export PYTHONPATH=$root/tests/interop PYTHONDONTWRITEBYTECODE=1
exec "$root/.venv-tools/interop/bin/python" "$here/check.py" "${CARGO_TARGET_DIR:-$root/target}/debug"
