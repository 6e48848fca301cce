#!/bin/bash
# Starts the demo like `make demo`, with other ports and in a temporary folder, and tests it in headless Chromium.
# Usage: run.sh PATH-TO-PEERNETD (peernet must be in the same folder)        SCREENSHOTS=FOLDER keeps screenshots of every page
set -euo pipefail
cd "$(dirname "$0")/../.."

peernetd=${1:?usage: run.sh PATH-TO-PEERNETD}
node tests/browser/numbers.mjs
site=$(mktemp -d)
trap 'kill -TERM "${demo:-}" 2>/dev/null && wait "$demo" 2>/dev/null; rm -rf "$site"' EXIT

(cd tests/browser && npm ci --silent --no-audit --no-fund)

# Three ports that are free at present.
read -r events data http < <(python3 -c '
import socket
sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(3)]
print(*(s.getsockname()[1] for s in sockets))')
for role in aggregator cloud edge; do
    sed -e "s/:5550/:$events/; s/:5551/:$data/; s/:8040/:$http/; s#\"data/#\"$site/#" \
        "configs/$role.toml" >"$site/$role.toml"
done
# One machine has only one clock. A clock identity and an injected clock fault give the edge another one, so that there is an
# offset to estimate.
sed -i 's/^\[agent\]$/[agent]\nclock_identity = "edge"/' "$site/edge.toml"
printf '\n[clock_fault]\noffset_ms = 1000.0\ndrift_ppm = 20.0\n' >>"$site/edge.toml"

deploy/demo.sh "$peernetd" "$site" "$site/logs" >"$site/demo.log" 2>&1 &
demo=$!
until grep -q Dashboard "$site/demo.log"; do
    kill -0 "$demo" 2>/dev/null || { cat "$site/demo.log" >&2; exit 1; }
    sleep 0.2
done

# Runs with episodes, and with answers of several lengths, which the demo does not have.
cat >"$site/tasks.toml" <<TOML
[experiment]
name = "tasks"
episodes = 3
episode_steps = 40
aggregator = "tcp://127.0.0.1:$events"

[agent]
name = "robot"

[pipeline]
sensor = { kind = "synthetic", sizes_bytes = [20000, 60000, 100000] }
placement = { kind = "local", model = "echo" }
load = { mode = "rate", hz = 20.0 }

[[model]]
name = "echo"
kind = "echo"

[[axis]]
name = "Where"
[[axis.value]]
label = "local"
[[axis.value]]
label = "cloud"
set = { "pipeline.placement" = { kind = "remote", peer = "tcp://127.0.0.1:$data", model = "echo" } }
TOML
"$(dirname "$peernetd")/peernet" run "$site/tasks.toml" --result-loc "$site/tasks" >"$site/tasks.log" 2>&1 || { cat "$site/tasks.log" >&2; exit 1; }

DATABASE="$site/aggregator/peernet.sqlite" node tests/browser/run.mjs "http://127.0.0.1:$http" || { tail -n 20 "$site"/logs/*.log >&2; exit 1; }
