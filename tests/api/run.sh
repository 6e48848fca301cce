#!/bin/bash
# Tests a running demo against its OpenAPI document: schemathesis sends valid and invalid requests, and checks that no answer is a
# server error or differs from the document.
# Usage: run.sh PATH-TO-PEERNETD [REQUESTS]        REQUESTS is the maximum number per operation (default: 5)
set -euo pipefail
cd "$(dirname "$0")/../.."

peernetd=${1:?usage: run.sh PATH-TO-PEERNETD [REQUESTS]}
requests=${2:-5}
schemathesis=.venv-tools/api/bin/schemathesis
[ -x "$schemathesis" ] || { echo "run.sh: $schemathesis does not exist; install it with deploy/install-tools.sh test" >&2; exit 69; }
folder=$(mktemp -d)
trap 'kill -TERM "${demo:-}" 2>/dev/null && wait "$demo" 2>/dev/null; rm -rf "$folder"' EXIT

read -r event_port data_port web_port < <(python3 -c '
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
print(*(s.getsockname()[1] for s in sockets))')
for role in aggregator cloud edge; do
    sed -e "s/:5550/:$event_port/; s/:5551/:$data_port/; s/:8040/:$web_port/; s#\"data/#\"$folder/#" \
        "configs/$role.toml" >"$folder/$role.toml"
done
deploy/demo.sh "$peernetd" "$folder" "$folder/logs" >"$folder/demo.log" 2>&1 &
demo=$!
# As soon as a remote run has figures, every operation has data to return.
until curl -sf "http://127.0.0.1:$web_port/api/v1/runs" 2>/dev/null | python3 -c '
import json, sys
sys.exit(not any(run["placement"]["kind"] == "remote" and run["total"] for run in json.load(sys.stdin)["runs"]))' 2>/dev/null; do
    kill -0 "$demo" 2>/dev/null || { cat "$folder/demo.log" >&2; exit 1; }
    sleep 0.2
done

# Names of existing items, so that requests reach stored data.
curl -sf "http://127.0.0.1:$web_port/api/v1/runs" | python3 -c '
import json, sys
runs = [run for run in json.load(sys.stdin)["runs"] if run["placement"]["kind"] == "remote" and run["total"]]
run = runs[0]
known = {"run": run["number"], "iteration": 1, "host": run["host"], "pipeline": run["pipeline"],
         "link": "~".join((run["host"], run["placement"]["peer"]))}
print("[parameters]", *(f"\"path.{name}\" = {json.dumps(value)}" for name, value in known.items()), sep="\n")
' >"$folder/known.toml"

# The live stream never ends, so it is excluded; web/tests/it/stream.rs tests it. The check positive_data_acceptance is excluded,
# because a valid request may name a run that does not exist, or a time range whose start is after its end.
run_schemathesis() {
    "$root/$schemathesis" "${config[@]}" run "http://127.0.0.1:$web_port/api/openapi.json" \
        --exclude-path /api/v1/live --exclude-checks positive_data_acceptance --max-examples "$requests" \
        --request-timeout 30 --suppress-health-check all --warnings off --continue-on-failure --seed 1 --no-color "$@"
}
fail_with_logs() {
    tail -n 20 "$folder"/logs/*.log >&2
    exit 1
}
root=$PWD
cd "$folder"
# The first run takes invented names, the second run the names of existing items. The second run omits PUT and DELETE,
# which would pin and unpin an existing run.
config=()
run_schemathesis --phases coverage,fuzzing || fail_with_logs
config=(--config-file known.toml)
run_schemathesis --phases coverage,fuzzing --mode positive --exclude-method PUT --exclude-method DELETE || fail_with_logs
if grep -h ' ERROR ' logs/*.log >&2; then
    echo "run.sh: the demo logged these errors during the requests" >&2
    exit 1
fi
