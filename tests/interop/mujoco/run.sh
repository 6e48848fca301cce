#!/usr/bin/env bash
# A short run of the experiment of docs/experiments/teleoperation.md: the arm in MuJoCo, and the servers behind three links between two
# network namespaces. Needs root.
set -euo pipefail
cd "$(dirname "$0")/../../.."
tests/interop/build.sh
PATH=$(realpath "${CARGO_TARGET_DIR:-target}/debug"):$PATH
python=$PWD/.venv-tools/interop/bin/python
folder=$(mktemp -d)
agent=
has_links=
finish() {
    [[ -z $agent ]] || { kill "$agent" && wait "$agent"; } || true
    # If `up` failed, it has removed its links. Links that existed before belong to someone else.
    if [[ -n $has_links ]]; then
        deploy/test-links.sh down
    fi
    rm -rf "$folder"
}
trap finish EXIT

deploy/test-links.sh up
has_links=yes
ip netns exec peernet-cloud peernetd run configs/teleoperation-cloud.toml >"$folder/agent.log" 2>&1 &
agent=$!
ip netns exec peernet-edge env PEERNET_PYTHON="$python" peernet run configs/experiments/teleoperation.toml \
    --set experiment.episodes=3 --set experiment.episode_steps=12 --result-loc "$folder/results" || { cat "$folder/agent.log"; exit 1; }
deploy/test-links.sh status
"$python" -B tests/interop/mujoco/check.py "$folder/results"
