#!/usr/bin/env bash
# Runs the interoperability tests one folder after the other, and prints how long each took. Runs all of them unless some are named.
# Usage: run.sh [FOLDER]…    (such as ros1)
set -euo pipefail
cd "$(dirname "$0")"
if [[ $# == 0 ]]; then
    set -- */
fi
failed=()
times=()
timed() {
    local name=$1 begin=$SECONDS
    shift
    echo "== $name"
    "$@" || failed+=("$name")
    times+=("$(printf '%5d s  %s' $((SECONDS - begin)) "$name")")
}
timed "the build" ./build.sh
for folder in "$@"; do
    timed "${folder%/}" "./${folder%/}/run.sh"
done
printf '%s\n' "${times[@]}" "$(printf '%5d s  in all' "$SECONDS")"
if [[ ${#failed[@]} != 0 ]]; then
    echo "failed: ${failed[*]}" >&2
    exit 1
fi
