#!/usr/bin/env bash
# The rosbag of Debian records a session over the network `ros`. The sensor `ros` of an agent must receive the replay completely and
# unchanged.
set -euo pipefail
cd "$(dirname "$0")/../../.."
tests/interop/build.sh
here=$PWD/tests/interop/rosbag
programs=$(realpath "${CARGO_TARGET_DIR:-target}/debug")
picture=$PWD/models/quality-control/pictures/part-0001.jpg
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$folder"' EXIT
cd "$folder"
port=$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
export ROS_MASTER_URI=http://127.0.0.1:$port ROS_IP=127.0.0.1 ROS_VERSION=1 ROS_HOME=$folder
rosmaster --core -p "$port" >master.log 2>&1 &
until rostopic list >/dev/null 2>&1; do sleep 0.2; done

rosbag record --output-name=session.bag /robot/request /robot/response __name:=recorder >record.log 2>&1 &
recorder=$!
# The recorder must have subscribed before the session begins. `-s` lists topics with subscribers.
until rostopic list -s 2>/dev/null | grep --quiet /robot/request; do sleep 0.2; done
cat >net.yaml <<'YAML'
devices: {robot: 127.0.0.1, cluster: 127.0.0.1}
server: cluster
ros_version: 1
YAML
common=(--network ros --network-config net.yaml --iterations 60)
"$programs/peernet" --server --name cluster "${common[@]}" >server.log 2>&1 &
server=$!
"$programs/peernet" --client --name robot "${common[@]}" --dataset-loc "$picture" --encoding file --result-loc results >client.log 2>&1 &
client=$!
for process in "$client" "$server"; do
    wait "$process" || { cat ./*.log; exit 1; }
done
rosnode kill /recorder >kill.log 2>&1
wait "$recorder" || true

for topic in request response; do
    cat >"$topic.toml" <<CONFIGURATION
[agent]
name = "$topic"
state_dir = "$folder/$topic"
[[model]]
name = "echo"
kind = "echo"
[[pipeline]]
name = "replayed"
sensor = { kind = "ros", topic = "/robot/$topic", queue = 1000, timeout_ms = 60000 }
placement = { kind = "local", model = "echo" }
actuator = { kind = "ros", topic = "/seen/$topic", type = "std_msgs/UInt8MultiArray" }
CONFIGURATION
    "$programs/peernetd" run "$topic.toml" >"agent-$topic.log" 2>&1 &
done
/usr/bin/python3 "$here/replay.py" session.bag || { cat agent-*.log record.log; exit 1; }
