#!/usr/bin/env bash
# PEERNet's ROS 2 client against Eclipse Cyclone DDS (PyPI) and eProsima Fast DDS (Debian) in both directions, without a ROS
# installation. Runs in a separate network namespace that has only the loopback interface, and needs root.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../../.." && pwd)
work=$root/target/interop/ros2
venv=$root/.venv-tools/interop
ours=$root/target/debug/examples/ros2_peer
fast=$work/fastdds_peer

prepare() {
    mkdir -p "$work"
    "$root/tests/interop/build.sh"
    if [[ ! $fast -nt $here/fastdds_peer.cpp ]]; then
        g++ -std=c++17 -O1 -o "$fast" "$here/fastdds_peer.cpp" -lfastrtps -lfastcdr -pthread
    fi
}

if [[ ${1:-} != --inside ]]; then
    prepare
    exec unshare --net -- "$0" --inside
fi

ip link set lo up
export ROS_DOMAIN_ID=0 ROS_LOCALHOST_ONLY=1
export CYCLONEDDS_URI='<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
cyclone() { "$venv/bin/python" "$here/cyclonedds_peer.py" "$@"; }
failed=0

# check NAME RECEIVER... -- PUBLISHER...
check() {
    local name=$1 receiver=() log=$work/log
    shift
    while [[ $1 != -- ]]; do receiver+=("$1"); shift; done
    shift
    "${receiver[@]}" >"$log.receiver" 2>&1 &
    local process=$! ok=yes
    "$@" >"$log.publisher" 2>&1 || ok=no
    wait "$process" || ok=no
    if [[ $ok == yes ]]; then
        echo "ok      $name: $(tail -n 1 "$log.receiver")"
    else
        echo "FAILED  $name"
        sed 's/^/        /' "$log.receiver" "$log.publisher"
        failed=1
    fi
}

for load in "string 50 10" "string 50 60000" "image 50 150000" "image 40 1000000"; do
    read -r kind count size <<<"$load"
    message=(/interop/topic "$kind" "$count" "$size")
    check "Cyclone DDS to us, $kind of $size bytes" "$ours" receive "${message[@]}" -- cyclone publish "${message[@]}"
    check "us to Cyclone DDS, $kind of $size bytes" cyclone receive "${message[@]}" -- "$ours" publish "${message[@]}"
    # With the kernel's default receive buffer of 212,992 bytes Fast DDS loses fragments of large messages faster than
    # it repairs them. Therefore the last argument sets buffers of 4 MiB.
    check "Fast DDS to us, $kind of $size bytes" "$ours" receive "${message[@]}" -- "$fast" publish "${message[@]}" 4194304
    check "us to Fast DDS, $kind of $size bytes" "$fast" receive "${message[@]}" 4194304 -- "$ours" publish "${message[@]}"
done

# The node must still run when its entry is looked for. Therefore it waits for a message.
"$ours" echo /interop/node string 1 >"$work/log.node" 2>&1 &
node=$!
if cyclone nodes /peernet; then echo "ok      node list"; else echo "FAILED  node list"; failed=1; fi
kill "$node" 2>/dev/null || true
wait "$node" 2>/dev/null || true

for check in agent observe; do
    PYTHONPATH=$root/tests/interop "$venv/bin/python" "$here/$check.py" "$root/target/debug/peernetd" || failed=1
done
PYTHONPATH=$root/tests/interop "$venv/bin/python" "$here/session.py" "$root/target/debug/peernet" \
    "$root/models/quality-control/pictures/part-0001.jpg" || failed=1

# Tests of the ROS 2 client and of sessions between nodes of PEERNet.
"$root/tests/interop/build.sh" --test || failed=1
exit "$failed"
