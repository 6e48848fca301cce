#!/bin/bash
# The demo: an aggregator, a cloud agent and an edge agent on loopback, the three processes that a real deployment
# starts on three machines, with the configurations of configs/. Runs until Ctrl-C, then ends them in the order in
# which nothing is lost: edge, cloud, aggregator.
# Usage: demo.sh PATH-TO-PEERNETD [FOLDER-OF-CONFIGURATIONS [FOLDER-OF-LOGS]]
set -euo pipefail
cd "$(dirname "$0")/.."

peernetd=${1:?usage: demo.sh PATH-TO-PEERNETD [FOLDER-OF-CONFIGURATIONS [FOLDER-OF-LOGS]]}
configs=${2:-configs}
logs=${3:-data/logs}
roles=(aggregator cloud edge)
mkdir -p "$logs"
declare -A pid=()

# Every process in a process group of its own: Ctrl-C reaches this script alone, which then ends them in order.
set -m

finish() {
    local code=$?
    trap - EXIT INT TERM
    for role in edge cloud aggregator; do
        [ -n "${pid[$role]:-}" ] || continue
        kill -TERM "${pid[$role]}" 2>/dev/null || true
        wait "${pid[$role]}" 2>/dev/null || true
    done
    [ -z "${started:-}" ] || echo "demo: ended. What was measured is kept where the configurations in $configs say; the next start adds to it."
    exit "$code"
}
trap finish EXIT
trap 'echo; exit 0' INT TERM

# The address in the aggregator's configuration, so that a changed port is followed.
listen=$(sed -n '/^\[web\]/,/^\[/s/^listen = "\(.*\)".*/\1/p' "$configs/aggregator.toml")

failed() {
    echo "demo: the $1 ended by itself; the last lines of $logs/$1.log:" >&2
    tail -n 5 "$logs/$1.log" >&2
    exit 1
}

answers() { (exec 3<>"/dev/tcp/${listen%:*}/${listen##*:}") 2>/dev/null; }

if answers; then
    echo "demo: something listens on $listen already; end it, or change [web] listen in configs/aggregator.toml" >&2
    exit 1
fi

started=yes
for role in "${roles[@]}"; do
    "$peernetd" run "$configs/$role.toml" >"$logs/$role.log" 2>&1 &
    pid[$role]=$!
    # The others would wait for the aggregator by themselves; waiting here makes its errors the first ones seen.
    while [ "$role" = aggregator ] && ! answers; do
        kill -0 "${pid[$role]}" 2>/dev/null || failed "$role"
        sleep 0.1
    done
done

cat <<TEXT

  PEERNet demo: a factory quality-control line, three pipelines over thirty pictures of parts
  Dashboard   http://$listen
  REST        http://$listen/api/v1/pipelines
  Logs        $logs/
  Ctrl-C ends everything.

TEXT

while :; do
    for role in "${roles[@]}"; do
        kill -0 "${pid[$role]}" 2>/dev/null || failed "$role"
    done
    # In the background, so that a signal ends the waiting and not the sleep, whose code would end the script.
    sleep 1 &
    wait $! || true
done
