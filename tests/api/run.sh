#!/bin/bash
# Asks a running demo what its OpenAPI document promises: schemathesis makes requests that keep and that break the document,
# and checks that no answer is a server error or other than described.
# Usage: run.sh PATH-TO-PEERNETD [REQUESTS]        REQUESTS per operation and phase at most; 20 unless given
set -euo pipefail
cd "$(dirname "$0")/../.."

peernetd=${1:?usage: run.sh PATH-TO-PEERNETD [REQUESTS]}
requests=${2:-20}
schemathesis=.venv-tools/api/bin/schemathesis
[ -x "$schemathesis" ] || { echo "run.sh: $schemathesis is not there; make it with deploy/install-tools.sh test" >&2; exit 69; }
site=$(mktemp -d)
trap 'kill -TERM "${demo:-}" 2>/dev/null && wait "$demo" 2>/dev/null; rm -rf "$site"' EXIT

read -r events data http < <(python3 -c '
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
print(*(s.getsockname()[1] for s in sockets))')
for role in aggregator cloud edge; do
    sed -e "s/:5550/:$events/; s/:5551/:$data/; s/:8040/:$http/; s#\"data/#\"$site/#" \
        "configs/$role.toml" >"$site/$role.toml"
done
deploy/demo.sh "$peernetd" "$site" "$site/logs" >"$site/demo.log" 2>&1 &
demo=$!
# The first run is there once its iterations are stored: then every operation has something to tell.
until curl -sf "http://127.0.0.1:$http/api/v1/runs/1/iterations?limit=1" 2>/dev/null | grep -q '"number"'; do
    kill -0 "$demo" 2>/dev/null || { cat "$site/demo.log" >&2; exit 1; }
    sleep 0.2
done

# A stream of events never ends: tests/it/stream.rs of the crate looks at it. A request that keeps the document may still
# name a run that is not there, or two times of which the first is not the earlier: positive_data_acceptance is left out.
(cd "$site" && "$OLDPWD/$schemathesis" run "http://127.0.0.1:$http/api/openapi.json" \
    --exclude-path /api/v1/live --exclude-checks positive_data_acceptance \
    --phases examples,coverage,fuzzing --max-examples "$requests" --request-timeout 30 \
    --suppress-health-check all --continue-on-failure --seed 1 --no-color) ||
    { tail -n 20 "$site"/logs/*.log >&2; exit 1; }
grep -l ' ERROR ' "$site"/logs/*.log && { grep -h ' ERROR ' "$site"/logs/*.log | tail -n 20 >&2; exit 1; } || true
