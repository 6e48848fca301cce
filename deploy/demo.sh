#!/bin/bash
# Runs the demo: an aggregator, a cloud agent and an edge agent on loopback, with the configurations of configs/. A real
# deployment runs these three processes on three machines. Ctrl-C stops them in the order edge, cloud, aggregator, so that
# no event is lost.
# Usage: demo.sh PATH-TO-PEERNETD [FOLDER-OF-CONFIGURATIONS [FOLDER-OF-LOGS]]
set -euo pipefail
cd "$(dirname "$0")/.."

peernetd=${1:?usage: demo.sh PATH-TO-PEERNETD [FOLDER-OF-CONFIGURATIONS [FOLDER-OF-LOGS]]}
configs=${2:-configs}
logs=${3:-data/logs}
roles=(aggregator cloud edge)
mkdir -p "$logs"
declare -A pid=()

# Each process gets its own process group, so that Ctrl-C reaches only this script, which stops the processes in order.
set -m

finish() {
    local code=$?
    trap - EXIT INT TERM HUP
    for role in edge cloud aggregator; do
        [ -n "${pid[$role]:-}" ] || continue
        kill -TERM "${pid[$role]}" 2>/dev/null || true
        wait "${pid[$role]}" 2>/dev/null || true
    done
    [ -z "${started:-}" ] || echo "demo: stopped. The measurements remain in the folders that the configurations in $configs name; the next start adds to them."
    exit "$code"
}
trap finish EXIT
trap 'echo; exit 0' INT TERM HUP

# The address is read from the aggregator's configuration, so that a changed port works.
listen=$(sed -n '/^\[web\]/,/^\[/s/^listen = "\(.*\)".*/\1/p' "$configs/aggregator.toml")

# fail_for_role ROLE: shows why the process of this role stopped, and ends the demo.
fail_for_role() {
    echo "demo: the $1 stopped unexpectedly; the last lines of $logs/$1.log:" >&2
    tail -n 5 "$logs/$1.log" >&2
    exit 1
}

dashboard_answers() { (exec 3<>"/dev/tcp/${listen%:*}/${listen##*:}") 2>/dev/null; }

if dashboard_answers; then
    echo "demo: another program listens on $listen; stop it, or copy $configs/{aggregator,cloud,edge}.toml to a folder, change the ports there," \
        "and run: deploy/demo.sh $peernetd FOLDER" >&2
    exit 1
fi

started=yes
for role in "${roles[@]}"; do
    "$peernetd" run "$configs/$role.toml" >"$logs/$role.log" 2>&1 &
    pid[$role]=$!
    # The agents would wait for the aggregator anyway. Waiting here shows its errors first.
    while [ "$role" = aggregator ] && ! dashboard_answers; do
        kill -0 "${pid[$role]}" 2>/dev/null || fail_for_role "$role"
        sleep 0.1
    done
done

cat <<TEXT

  PEERNet demo: a factory quality-control line, three pipelines over thirty pictures of parts
  Dashboard   http://$listen
  REST        http://$listen/api/v1/pipelines
  Logs        $logs/
  Ctrl-C stops all three processes.

TEXT

while :; do
    for role in "${roles[@]}"; do
        kill -0 "${pid[$role]}" 2>/dev/null || fail_for_role "$role"
    done
    # `sleep` runs in the background, so that a signal interrupts `wait`. A killed `sleep` in the foreground would end the script.
    sleep 1 &
    wait $! || true
done
