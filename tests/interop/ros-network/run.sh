#!/usr/bin/env bash
# The commands of the paper's program over the network `ros`, with the rosmaster of Debian and rostopic as a viewer.
set -euo pipefail
cd "$(dirname "$0")/../../.."
tests/interop/build.sh
peernet="$(realpath "${CARGO_TARGET_DIR:-target}/debug/peernet")"
picture="$PWD/models/quality-control/pictures/part-0001.jpg"
folder="$(mktemp -d)"
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$folder"' EXIT
cd "$folder"
port="$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')"
export ROS_MASTER_URI="http://127.0.0.1:$port" ROS_IP=127.0.0.1
rosmaster --core -p "$port" >master.log 2>&1 &
until rostopic list >/dev/null 2>&1; do sleep 0.2; done
cat >net.yaml <<'YAML'
devices: {robot: 127.0.0.1, cluster: 127.0.0.1}
server: cluster
ros_version: 1
YAML
common=(--network ros --network-config net.yaml --iterations 60)
"$peernet" --server --name cluster "${common[@]}" >server.log 2>&1 &
server=$!
"$peernet" --client --name robot "${common[@]}" --dataset-loc "$picture" --encoding file --result-loc results >client.log 2>&1 &
client=$!
timeout 60 rostopic echo -n 5 --noarr /robot/request >seen.log 2>rostopic.log &
viewer=$!
for process in "$client" "$server" "$viewer"; do
  wait "$process" || { cat ./*.log; exit 1; }
done
bytes="$(stat -c %s "$picture")"
test "$(grep -c 'format: "jpeg"' seen.log)" = 5 || { cat seen.log; exit 1; }
test "$(grep -c "array type: uint8, length: $bytes" seen.log)" = 5 || { cat seen.log; exit 1; }
test "$(grep -c ',ok,' results/data.csv)" -ge 60 || { cat results/data.csv; exit 1; }
echo "ros-network: passed"
