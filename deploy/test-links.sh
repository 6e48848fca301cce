#!/bin/bash
# Creates the networks of docs/experiments/teleoperation.md on one machine: two network namespaces that stand for the robot and
# the servers, joined by three links. Each link has its own subnet, rate and delay. All exist at the same time.
#
#     link    robot         servers                      up            down        delay up  delay down
#     lan     192.168.1.20  192.168.1.30  192.168.1.40   1 Gbit/s      1 Gbit/s    none      none
#     campus  10.20.0.20    10.20.0.30    10.20.0.40     160 Mbit/s    160 Mbit/s  2 ± 1 ms  2 ± 1 ms
#     5g      10.8.0.20     10.8.0.30     10.8.0.40      10.3 Mbit/s   50 Mbit/s   60 ms     60 to 490 ms, mean 229
#
# The addresses are those of configs/experiments/networks. They exist only in the two namespaces, so they cannot conflict
# with addresses of this machine's own networks.
#
# Usage, as root:
#     test-links.sh up        creates namespaces and links; if anything fails, it removes everything again
#     test-links.sh status    shows the links; exit code 0 if all of them work, 3 if they do not exist or one is broken
#     test-links.sh down      removes everything; also succeeds if nothing exists
# Run programs in the namespaces with `ip netns exec peernet-edge COMMAND` and `ip netns exec peernet-cloud COMMAND`.
# Exit codes: 64 wrong usage, 69 something is missing or failed, 77 not root.
#
# Needs iproute2, procps and vde2 (packages of Debian), and a kernel with veth, tun and the token bucket filter tc-tbf(8).
# The delays are made by wirefilter(1) of vde2, because not every kernel has netem.
set -euo pipefail

edge=peernet-edge
cloud=peernet-cloud
state=/run/peernet-test-links

# --- profiles -------------------------------------------------------------------------------------------------------
# Source of the numbers: the paper's table of teleoperation configurations, means of upload and download. A pair of pictures of
# 640 × 480 pixels has 2 × 640 × 480 × 3 = 1,843,200 bytes; resized to 320 × 240 it has 460,800 bytes. Of each Ethernet frame of
# 1,514 bytes, 1,448 are payload of TCP, so the links carry 1,927,000 and 482,000 bytes.
#
# lan: 1,927,000 B at 1 Gbit/s take 15.4 ms. Paper: 17.53 ms. Resized: 3.9 ms. Paper: 6.25 ms. No delay is added for the
#     difference. Download without added delay: below 1 ms. Paper: 0.37 and 0.62 ms.
# campus (CAN in the paper): the rate is chosen for the pair that is not resized: 1,927,000 B at 160 Mbit/s take 96 ms, and the delay
#     adds 2 to 3 ms. Paper: 98.28 ms. Resized: 24 ms and the delay. Paper: 14.53 ms. No rate reproduces both, because the paper does
#     not give the size to which it resizes: 14.53 ms suffice for half of our bytes. Download: the delay alone. Paper: 1.73 to 3.59 ms.
# 5g: over 5G the paper sends only resized pictures. Its upload takes 432.71 ms; it does not say how much of that is delay and how much
#     transmission. We assume a delay of 60 ms, a usual value for a mobile network with a VPN. The other 373 ms for 482,000 B are
#     10.3 Mbit/s. To the paper's second server, the A100, the upload takes 339.20 ± 234.52 ms; both servers share this profile.
#     The download is an action of some hundred bytes, so its time is the delay alone. The five delays below have the mean 229 ms and
#     the standard deviation 150 ms. Paper: 228.84 ± 149.83 ms. The smallest delay is the same in both directions,
#     because the estimates of the clock offset by NTP and PEERNet assume this. 50 Mbit/s is a usual value; it does not matter for an action.

# Names of the links. The interfaces of a link have the same name, in both namespaces.
links='lan campus 5g'

# profile LINK: sets these variables to the properties of a link.
# subnet: first three numbers of its addresses.
# up_rate, down_rate, up_burst, down_burst: arguments of tbf. Timers fill the bucket; in a virtual machine they may be some hundred
#     microseconds late, and then tokens beyond `burst` are lost. So `burst` is what the rate carries in 0.5 to 3 ms. With a larger
#     bucket the beginning of each picture would not be limited to the rate.
# up_delay, down_delay: text that `status` prints.
# wire: options of a wirefilter that keeps the order of packets; empty for a veth pair without delay. LR is the direction from the edge to
#     the cloud.
# down_delays: delays from the cloud to the edge, ms. A second wirefilter in series selects one of them every 20 ms, each with the same
#     probability. Empty if there is no second wirefilter.
profile() {
    case $1 in
        lan)
            subnet=192.168.1
            up_rate=1gbit up_burst=64kb
            down_rate=1gbit down_burst=64kb
            up_delay='none' down_delay='none'
            wire=
            down_delays=
            ;;
        campus)
            subnet=10.20.0
            up_rate=160mbit up_burst=16kb
            down_rate=160mbit down_burst=16kb
            # Each packet has a random delay from 1 to 3 ms, but never overtakes the one before it. So the end of a picture has a
            # delay near 3 ms, and a single packet 2 ms on average.
            wire='-d LR2+1 -d RL2+1'
            up_delay='2 ± 1 ms' down_delay='2 ± 1 ms'
            down_delays=
            ;;
        5g)
            subnet=10.8.0
            up_rate=10300kbit up_burst=4kb
            down_rate=50mbit down_burst=8kb
            wire='-d LR60'
            up_delay='60 ms' down_delay='60 to 490 ms'
            down_delays='60 120 190 285 490'
            ;;
    esac
}

# Largest number of bytes that may wait at the beginning of a link. It is larger than two pairs of pictures, so nothing is dropped
# there. With drops, the transfer times would depend on how TCP recovers, not on the link.
queue_limit=4mb

# --------------------------------------------------------------------------------------------------------------------

fail() { echo "test-links: $*" >&2; exit 69; }

need_root() {
    [ "$(id -u)" = 0 ] || { echo "test-links: network namespaces need root; run it as root: sudo $0 $1" >&2; exit 77; }
}

# need_tool COMMAND PACKAGE
need_tool() {
    command -v "$1" >/dev/null || fail "the command $1 is missing; install the package $2: apt-get install $2"
}

# existing_namespaces: prints the names of our namespaces, if they exist.
existing_namespaces() {
    for namespace in "$edge" "$cloud"; do
        [ ! -e "/run/netns/$namespace" ] || echo "$namespace"
    done
}

# is_link_process PID: succeeds if this process is a switch or a wire of a link. /proc names no program for a process that has ended but
# has not been reaped.
is_link_process() {
    case $(readlink "/proc/$1/exe" 2>/dev/null) in
        */vde_switch* | */wirefilter*) return 0 ;;
    esac
    return 1
}

# link_processes: prints the ids of the switches and wires of the links, one a line, some of them twice.
link_processes() {
    local pid
    # Both sources are needed: a switch or wire that has just started has no pid file yet, and `ip netns pids` does not list the
    # processes of a namespace that was deleted manually.
    {
        cat "$state"/*.pid 2>/dev/null || true
        for namespace in $(existing_namespaces); do ip netns pids "$namespace" 2>/dev/null || true; done
    } | while read -r pid; do
        # The program is checked, because the system may have given the id to another process.
        ! is_link_process "$pid" || echo "$pid"
    done
}

# --- up -------------------------------------------------------------------------------------------------------------

# in_namespace NAMESPACE COMMAND…
in_namespace() { ip netns exec "$@"; }

# wait_for DESCRIPTION COMMAND…: waits at most 5 s until the command succeeds.
wait_for() {
    local description=$1
    shift
    for _ in $(seq 100); do
        ! "$@" >/dev/null 2>&1 || return 0
        sleep 0.05
    done
    fail "$description did not appear within 5 s"
}

add_namespace() {
    ip netns add "$1"
    # Programs in one namespace, such as the simulated robot and its agent, reach each other at 127.0.0.1.
    ip -n "$1" link set lo up
    # tcp_congestion_control: every kernel has Reno, and it does not pace. BBR, the default of some hosts, paces and measures the rate
    # for seconds, and Cubic leaves slow start as soon as the delay varies (HyStart). With them the transfer times would show the
    # algorithm, not the link.
    # tcp_slow_start_after_idle: otherwise TCP would reset its window while the simulation renders, a pause that a real robot does not have.
    # tcp_no_metrics_save: otherwise a run would inherit the window of the run before it.
    # tcp_early_retrans: otherwise TCP would send tail loss probes whenever an acknowledgement is slow. If the answer to a probe is
    # overtaken, TCP assumes a loss and halves its window: uploads over 5G then take 500 to 800 ms instead of 432.
    in_namespace "$1" sysctl -qw net.ipv4.tcp_congestion_control=reno net.ipv4.tcp_slow_start_after_idle=0 \
        net.ipv4.tcp_no_metrics_save=1 net.ipv4.tcp_early_retrans=0
    # Largest number of datagrams that may wait for a switch or a wire. Many kernels allow 10 by default, and a busy machine would lose
    # packets.
    in_namespace "$1" sysctl -qw net.unix.max_dgram_qlen=1000
    # IPv6 is off, because its router solicitations would disturb the measurement. A kernel without IPv6 does not have this setting.
    in_namespace "$1" sysctl -qw net.ipv6.conf.all.disable_ipv6=1 2>/dev/null || true
}

# prioritise PID_FILE: gives a switch or wire priority over all other programs. If it waits some milliseconds for a processor, its queue
# overflows, and TCP has to send parts of pictures again: on a busy machine an upload over the campus link then took 110 ms instead
# of 98.
prioritise() {
    # Some containers forbid real-time scheduling.
    chrt --rr --pid 10 "$(cat "$1")" 2>/dev/null || renice --priority -15 --pid "$(cat "$1")" >/dev/null 2>&1 || true
}

# add_switch NAME NAMESPACE OPTION…: starts a virtual switch in the namespace, with the socket $state/NAME.
add_switch() {
    local sock=$state/$1 namespace=$2
    shift 2
    in_namespace "$namespace" vde_switch --sock "$sock" "$@" --daemon --pidfile "$sock.pid" </dev/null >"$sock.log" 2>&1 \
        || fail "vde_switch failed for $sock: $(tr '\n' ' ' <"$sock.log")"
    # The switch goes into the background before it is ready.
    wait_for "the socket $sock/ctl of vde_switch" test -S "$sock/ctl"
    wait_for "the file $sock.pid of vde_switch" test -s "$sock.pid"
    prioritise "$sock.pid"
}

# add_wire LEFT RIGHT OPTION…: connects two switches by a wirefilter.
add_wire() {
    local wire=$state/$1:$2 plugs=$state/$1:$state/$2
    shift 2
    in_namespace "$edge" wirefilter -v "$plugs" "$@" -M "$wire.commands" --daemon --pidfile "$wire.pid" </dev/null >"$wire.log" 2>&1 \
        || fail "wirefilter failed for $wire: $(tr '\n' ' ' <"$wire.log")"
    wait_for "the file $wire.pid of wirefilter" test -s "$wire.pid"
    prioritise "$wire.pid"
    # wirefilter continues after an error in its start file, so its log is checked.
    [ ! -s "$wire.log" ] || fail "wirefilter does not accept the settings of $wire: $(tr '\n' ' ' <"$wire.log")"
}

# write_states FILE DELAY…: writes a start file of wirefilter with one state for each delay from the cloud to the edge.
write_states() {
    local file=$1 state_count=$(($# - 1)) from to
    shift
    {
        echo "markov-numnodes $state_count"
        echo "markov-time 20"
        for ((from = 0; from < state_count; from++)); do
            echo "delay RL$1[$from]"
            shift
            for ((to = 0; to < state_count; to++)); do
                [ "$to" = "$from" ] || echo "setedge $from,$to,$((100 / state_count))"
            done
        done
    } >"$file"
}

add_link() {
    local link=$1
    profile "$link"
    if [ -z "$wire" ]; then
        ip link add "$link" netns "$edge" type veth peer name "$link" netns "$cloud"
    else
        add_switch "$link-edge" "$edge" --tap "$link"
        add_switch "$link-cloud" "$cloud" --tap "$link"
        local next=$link-cloud
        if [ -n "$down_delays" ]; then
            # A wirefilter has one queue for both directions. If it keeps the order of packets, an answer waits for the slowest of all
            # acknowledgements before it. If it does not, packets of a picture overtake each other too, and TCP sends them again.
            # So there are two wirefilters: the first keeps the order and delays pictures; the second does not keep the order, delays
            # answers, and passes pictures on at once. All packets within 20 ms have the same delay there. With a random delay for each
            # packet, an answer of several packets would have the largest of their delays.
            next=$link-middle
            add_switch "$next" "$edge"
            # shellcheck disable=SC2086
            write_states "$state/$link.states" $down_delays
            add_wire "$next" "$link-cloud" -f "$state/$link.states" --nofifo
        fi
        # shellcheck disable=SC2086
        add_wire "$link-edge" "$next" $wire
        for namespace in "$edge" "$cloud"; do
            wait_for "the interface $link of vde_switch in $namespace" ip -n "$namespace" link show dev "$link"
        done
    fi
    ip -n "$edge" address add "$subnet.20/24" dev "$link"
    ip -n "$cloud" address add "$subnet.30/24" dev "$link"
    ip -n "$cloud" address add "$subnet.40/24" dev "$link"
    ip -n "$edge" link set "$link" up
    ip -n "$cloud" link set "$link" up
    tc -n "$edge" qdisc add dev "$link" root tbf rate "$up_rate" burst "$up_burst" limit "$queue_limit"
    tc -n "$cloud" qdisc add dev "$link" root tbf rate "$down_rate" burst "$down_burst" limit "$queue_limit"
}

up() {
    need_tool ip iproute2
    need_tool tc iproute2
    need_tool sysctl procps
    need_tool vde_switch vde2
    need_tool wirefilter vde2
    local existing
    existing=$(existing_namespaces)
    if [ -e "$state" ] || [ -n "$existing" ]; then
        fail "already up, or not removed completely; see '$0 status', remove it with '$0 down'"
    fi
    [ -e /dev/net/tun ] || fail "the kernel has no /dev/net/tun; load the module tun: modprobe tun"
    # From here on, everything is removed after any failure or signal.
    trap 'code=$?; trap - EXIT; [ "$code" = 0 ] || { echo "test-links: up failed; everything is removed again" >&2; remove; }; exit "$code"' EXIT
    trap 'exit 130' INT TERM HUP
    mkdir -m 700 "$state"
    add_namespace "$edge"
    add_namespace "$cloud"
    for link in $links; do
        add_link "$link"
    done
    status
}

# --- status ---------------------------------------------------------------------------------------------------------

status() {
    if [ ! -e "$state" ] && [ -z "$(existing_namespaces)" ]; then
        echo "down"
        exit 3
    fi
    local broken=0
    printf '%-7s %-13s %-26s %-10s %-9s %-12s %-22s %s\n' link robot servers up down 'delay up' 'delay down' state
    for link in $links; do
        profile "$link"
        local condition=works
        for namespace in "$edge" "$cloud"; do
            tc -n "$namespace" qdisc show dev "$link" 2>/dev/null | grep -q tbf || condition="broken: no interface $link in $namespace"
        done
        for file in "$state/$link"-*.pid; do
            [ -z "$wire" ] || is_link_process "$(cat "$file" 2>/dev/null)" || condition="broken: the process of $file has ended"
        done
        [ "$condition" = works ] || broken=1
        printf '%-7s %-13s %-26s %-10s %-9s %-12s %-22s %s\n' "$link" "$subnet.20" "$subnet.30 $subnet.40" "$up_rate" "$down_rate" \
            "$up_delay" "$down_delay" "$condition"
    done
    [ "$broken" = 0 ] || exit 3
}

# --- down -----------------------------------------------------------------------------------------------------------

# other_programs: prints the programs in our namespaces that this script did not start.
other_programs() {
    local pid
    for namespace in $(existing_namespaces); do
        for pid in $(ip netns pids "$namespace" 2>/dev/null); do
            is_link_process "$pid" || echo "$(cat "/proc/$pid/comm" 2>/dev/null || echo '?') (process $pid in $namespace)"
        done
    done
}

# remove: ends the processes of the links and deletes the namespaces.
remove() {
    local pids
    pids=$(link_processes)
    # shellcheck disable=SC2086
    [ -z "$pids" ] || kill $pids 2>/dev/null || true
    for _ in $(seq 40); do
        [ -n "$(link_processes)" ] || break
        sleep 0.05
    done
    pids=$(link_processes)
    # shellcheck disable=SC2086
    [ -z "$pids" ] || kill -KILL $pids 2>/dev/null || true
    for namespace in $(existing_namespaces); do
        ip netns delete "$namespace" || echo "test-links: cannot delete the namespace $namespace" >&2
    done
    rm -rf "$state"
}

down() {
    need_tool ip iproute2
    local programs
    programs=$(other_programs)
    # If the namespaces were deleted now, they would exist without a name until these processes end.
    [ -z "$programs" ] || fail "programs still run in the namespaces; end them first: $(echo "$programs" | paste -sd, | sed 's/,/, /g')"
    remove
    echo "down"
}

# --------------------------------------------------------------------------------------------------------------------

case ${1:-} in
    up | status | down)
        [ $# = 1 ] || { echo "usage: test-links.sh up|status|down" >&2; exit 64; }
        need_root "$1"
        "$1"
        ;;
    *)
        echo "usage: test-links.sh up|status|down" >&2
        exit 64
        ;;
esac
