#!/bin/sh
# The long tests of `make soak`: end-to-end tests with release builds, many more kills and a backlog of a day. The
# measured counts are written to standard output and, as Markdown, to target/soak/measurements.md.
# Usage: run.sh [FILTER]…    (names of tests, such as stream::kills; default: the event stream, durability, and clocks and paths
# that violate the assumptions of intervals)
# PEERNET_SEED repeats a run.
set -eu
root=$(cd "$(dirname "$0")/../.." && pwd)
results=$root/target/soak
rows=$results/rows
mkdir -p "$results"
rm -f "$rows"

export PEERNET_KILLS="${PEERNET_KILLS:-200}"
# The iterations of a day at 20 Hz, produced in three minutes at 10 kHz.
export PEERNET_OUTAGE_ITERATIONS="${PEERNET_OUTAGE_ITERATIONS:-1728000}"
export PEERNET_OUTAGE_HZ="${PEERNET_OUTAGE_HZ:-10000}"
# While the backlog is delivered: maximum lag of the live state, and minimum number of stored nodes per second.
export PEERNET_LAG_MS="${PEERNET_LAG_MS:-500}"
export PEERNET_CATCH_UP="${PEERNET_CATCH_UP:-200000}"
# Duration of the test of the aggregator's memory.
export PEERNET_MEMORY_S="${PEERNET_MEMORY_S:-3600}"
export PEERNET_FIGURES="$rows"

[ $# -gt 0 ] || set -- stream:: durability:: clocks::assumptions:: clocks::forged::
cd "$root"
status=0
${CARGO:-cargo} test --release --locked --package peernet-tests --test it -- --include-ignored --test-threads 1 "$@" || status=$?
# Ten million hostile inputs each: damaged headers, calls and messages of ROS (three corpora), discovery announcements and node lists
# of ROS 2, datagrams and handshakes, and messages of ROS sessions of both versions.
inputs="${PEERNET_INPUTS:-10000000}"
PROPTEST_CASES=$((inputs * 3)) \
    ${CARGO:-cargo} test --release --locked --package peernet-ros --lib damaged_corpora || status=$?
PROPTEST_CASES=$inputs ${CARGO:-cargo} test --release --locked --package peernet-ros --lib -- \
    any_announcements_stay_within_bounds damaged_node_lists_are_read_within_bounds || status=$?
PROPTEST_CASES=$inputs ${CARGO:-cargo} test --release --locked --package peernet-networks --lib -- \
    invariants_hold_for_any_datagrams any_peer_messages_need_bounded_memory || status=$?
# Generated histories of two clocks and the paths between them, in which every interval must contain the truth.
PEERNET_HISTORIES="${PEERNET_HISTORIES:-100000}" \
    ${CARGO:-cargo} test --release --locked --package peernet-clock --lib generated_histories || status=$?

cpu=$(sed -n 's/^model name[[:space:]]*: //p' /proc/cpuinfo | head -1)
{
    echo "## Kills, outages and full disks"
    echo
    echo "Measured $(date -u '+%Y-%m-%d %H:%M') UTC on $cpu, $(nproc) cores, Linux $(uname -r), by \`make soak\`; $(target/release/peernetd --version)."
    echo
    echo "| test | what | figure |"
    echo "| --- | --- | ---: |"
    cat "$rows" 2>/dev/null || true
    [ "$status" = 0 ] || printf '\n**Not all of the tests passed.**\n'
} | tee "$results/measurements.md"
exit "$status"
