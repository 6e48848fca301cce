#!/bin/sh
# Installs, uses, upgrades, removes and purges the package, and checks that it leaves no files behind.
# Usage: test.sh PACKAGE.deb
#
# Runs in a temporary overlay of this machine's root, in its own mount namespace, so that nothing remains even if a check
# fails. If overlays are not allowed, as in some containers, it works on the machine itself, but only if that is a container
# without PEERNet. Needs root or sudo.
set -eu

fail() { echo "test.sh: $*" >&2; exit 1; }

# --- inside: checks of the package --------------------------------------------------------------------------

# Files that change with the installation of any package.
noise='^/etc/(passwd|group|shadow|gshadow|subuid|subgid)-?$|^/etc/\.pwd\.lock$|^/etc/ld\.so\.cache$|^/var/(cache|log|tmp)/|^/var/lib/(dpkg|apt)/|^/usr/share/man/'

listing() { find /etc /opt /srv /usr /var -xdev \( -type f -o -type l -o -type d \) | grep -Ev "$noise" | sort; }

step() { echo "--- $*"; }

check_installed() {
    step "programs"
    expect_program peernetd
    for name in peernet PEERNet peernet_cli; do expect_program "$name" peernet; done
    [ -e /usr/lib/peernet/libonnxruntime.so.1 ] || fail "the ONNX Runtime library is not in /usr/lib/peernet"

    step "user and folders"
    [ "$(getent passwd peernet | cut -d: -f6,7)" = /var/lib/peernet:/usr/sbin/nologin ] \
        || fail "unexpected user: $(getent passwd peernet)"
    getent group render >/dev/null || fail "no group render: the agent's unit would not start"
    expect_owner /var/lib/peernet/agent "peernet peernet 750"
    expect_owner /var/lib/peernet/aggregator "peernet peernet 750"
    expect_owner /var/lib/peernet/models "root root 755"
    expect_owner /etc/peernet/keys "root peernet 750"

    step "configurations, read as the user of the units"
    for role in agent aggregator; do as_unit "$role" peernetd check "/etc/peernet/$role.toml"; done

    step "examples in the folder where they are installed"
    examples=/usr/share/doc/peernet/examples
    for file in "$examples"/*.toml; do as_unit agent peernetd check "$file"; done
    for file in "$examples"/experiments/*.toml; do as_unit agent peernet run --check "$file"; done
    as_unit agent peernet run --only Where=local --set experiment.repeats=1 "$examples/experiments/demo.toml"

    step "units"
    for unit in agent aggregator; do
        output=$(systemd-analyze verify --recursive-errors=no --man=no --generators=no \
            "/usr/lib/systemd/system/peernet-$unit.service" 2>&1) || fail "systemd-analyze verify: $output"
        [ -z "$output" ] || fail "systemd-analyze verify: $output"
        # The installation enables no unit.
        [ "$(systemctl is-enabled "peernet-$unit" || true)" = disabled ] || fail "peernet-$unit is enabled"
    done
}

# as_unit ROLE COMMAND…: runs a command as the user, and in the folder, of the role's unit.
as_unit() {
    state=/var/lib/peernet/$1
    shift
    setpriv --reuid=peernet --regid=peernet --clear-groups \
        env --chdir="$state" HOME=/var/lib/peernet STATE_DIRECTORY="$state" "$@"
}

# expect_program NAME [PRINTED-NAME]: `NAME --version` must begin with the printed name (default: NAME).
expect_program() {
    version=$("$1" --version)
    echo "$1: $version"
    [ "${version%% *}" = "${2:-$1}" ] || fail "$1 is not ${2:-$1}"
}

# expect_owner PATH "USER GROUP MODE"
expect_owner() {
    found=$(stat -c '%U %G %a' "$1")
    [ "$found" = "$2" ] || fail "$1 is $found, not $2"
}

# documented_configuration STEP: prints the configuration in this step of docs/two-machines.md.
documented_configuration() {
    awk -v step="$1." '/^[0-9]+\. /{ within = $1 == step } within && sub(/^       /, "")' /usr/share/doc/peernet/docs/two-machines.md
}

# This machine stands for both machines of the documented instructions: its network has the cloud's address.
two_machines() {
    ip link set lo up
    ip address add 10.0.0.2/32 dev lo
    install -d -o peernet -g peernet /var/lib/peernet/robot /var/lib/peernet/cloud
    cp -r /usr/share/peernet/models/quality-control/pictures /var/lib/peernet/pictures
    processes=
    step=0
    for role in aggregator cloud robot; do
        step=$((step + 1))
        documented_configuration $step >"/tmp/$role.toml"
        [ -s "/tmp/$role.toml" ] || fail "docs/two-machines.md has no configuration in step $step"
        as_unit "$role" peernetd check "/tmp/$role.toml"
        # Each process has its own host name and state folder, as on a separate machine.
        unshare --uts --mount sh "$0" --machine "$role" >"/tmp/$role.log" 2>&1 &
        processes="$processes $!"
    done
    # shellcheck disable=SC2086
    trap "kill $processes; wait" EXIT
    expect_running robot/inspection http://10.0.0.2:8040
}

# expect_running PIPELINE DASHBOARD: the pipeline must get answers within a minute.
expect_running() {
    answers="^$1 .* running +[0-9.]+ +[0-9]"
    for _ in $(seq 120); do
        peernet status --url "$2" >/tmp/status 2>&1 || true
        grep -Eq "$answers" /tmp/status && break
        sleep 0.5
    done
    cat /tmp/status
    grep -Eq "$answers" /tmp/status || fail "$1 gets no answers: $(tail -n 5 /tmp/*.log)"
}

# The example that needs no other machine.
all_in_one() {
    ip link set lo up
    cd /tmp
    peernetd run /usr/share/doc/peernet/examples/all-in-one.toml >/tmp/all-in-one.log 2>&1 &
    # shellcheck disable=SC2064
    trap "kill $!; wait" EXIT
    expect_running all-in-one/over-the-network http://127.0.0.1:8040
}

# Runs the process of role $1. The cloud and the robot are both agents, so the folder of the role is mounted in place of the
# agent's state folder.
machine() {
    hostname "$1"
    [ "$1" = aggregator ] || mount --bind "/var/lib/peernet/$1" /var/lib/peernet/agent
    exec setpriv --reuid=peernet --regid=peernet --clear-groups \
        env --chdir="/var/lib/peernet/$1" HOME=/var/lib/peernet peernetd run "/tmp/$1.toml"
}

inside() {
    deb=$1
    before=$(mktemp)
    after=$(mktemp)
    listing >"$before"

    step "install"
    install_package "$deb"
    check_installed
    step "the instructions for two machines"
    unshare --net sh "$0" --two-machines
    step "the example on one machine"
    unshare --net sh "$0" --all-in-one

    step "an upgrade keeps edited configurations and enabled units"
    systemctl enable --quiet peernet-agent
    echo "# edited" >>/etc/peernet/agent.toml
    install_package "$deb"
    tail -n 1 /etc/peernet/agent.toml | grep -q '# edited' || fail "the upgrade overwrote /etc/peernet/agent.toml"
    [ "$(systemctl is-enabled peernet-agent)" = enabled ] || fail "the upgrade disabled peernet-agent"

    step "remove keeps configuration and recordings"
    touch /var/lib/peernet/agent/recording /etc/peernet/keys/key
    dpkg --remove peernet
    [ ! -e /usr/bin/peernetd ] || fail "remove left /usr/bin/peernetd"
    [ ! -e /usr/lib/peernet ] || fail "remove left /usr/lib/peernet"
    [ -f /etc/peernet/agent.toml ] || fail "remove deleted /etc/peernet/agent.toml"
    [ -f /var/lib/peernet/agent/recording ] || fail "remove deleted the recordings"

    step "after reinstallation the unit is enabled as before"
    install_package "$deb"
    [ "$(systemctl is-enabled peernet-agent)" = enabled ] || fail "peernet-agent is not enabled any more"

    step "purge leaves nothing"
    dpkg --purge peernet
    listing >"$after"
    left=$(comm -13 "$before" "$after")
    gone=$(comm -23 "$before" "$after")
    rm -f "$before" "$after"
    [ -z "$left" ] || fail "left behind: $left"
    [ -z "$gone" ] || fail "deleted, although the package does not own it: $gone"
    ! getent passwd peernet || fail "purge left the user peernet"
    ! getent group peernet || fail "purge left the group peernet"
    echo "test.sh: $(basename "$deb") installs, works, upgrades, removes and purges cleanly"
}

# apt is used instead of dpkg, because it fetches dependencies that this machine lacks.
install_package() {
    DEBIAN_FRONTEND=noninteractive apt-get install --yes --quiet --quiet --reinstall --allow-downgrades \
        --no-install-recommends -o APT::Sandbox::User=root -o Dpkg::Use-Pty=0 -o Dpkg::Options::=--force-confold "$1"
}

# --- outside: preparation of the overlay ---------------------------------------------------------------------------------

# Mounts a temporary overlay of / in the folder $2 and copies the package $1 into it; fails if overlays are not allowed.
# Runs in a mount namespace.
mount_overlay() {
    # A tmpfs, because the upper layer of an overlay cannot be on another overlay, which a container's root often is.
    mount -t tmpfs tmpfs "$2" || return 1
    mkdir "$2/upper" "$2/work" "$2/root" || return 1
    mount -t overlay overlay -o "lowerdir=/,upperdir=$2/upper,workdir=$2/work" "$2/root" || return 1
    for folder in dev proc sys; do mount --rbind "/$folder" "$2/root/$folder" || return 1; done
    # The machine's /run is not mounted, because the checks must not reach its systemd.
    for folder in run tmp; do mount -t tmpfs tmpfs "$2/root/$folder" || return 1; done
    cp "$1" "$2/root/package.deb" && cp "$0" "$2/root/test.sh"
}

case "${1:-}" in
    --inside) inside "$2" ;;
    --two-machines) two_machines ;;
    --all-in-one) all_in_one ;;
    --machine) machine "$2" ;;
    --overlay)
        mount_overlay "$2" "$3" || exit 75
        echo "test.sh: in an overlay of /"
        exec chroot "$3/root" sh /test.sh --inside /package.deb
        ;;
    *.deb)
        [ -f "$1" ] || fail "no such file: $1"
        if [ "$(id -u)" != 0 ]; then
            echo "test.sh: installing a package needs root, calling sudo"
            exec sudo sh "$0" "$1"
        fi
        for tool in apt-get dpkg systemd-analyze setpriv unshare; do
            command -v "$tool" >/dev/null || fail "$tool not found; this test needs a Debian system with systemd and util-linux"
        done
        scratch=$(mktemp -d)
        status=0
        unshare --mount --propagation private sh "$0" --overlay "$1" "$scratch" || status=$?
        rmdir "$scratch"
        # 75: no overlay is allowed. If `unshare` itself is not allowed, the status is 1, as after a failed check, but no check has run.
        if [ "$status" = 75 ] || ! unshare --mount true 2>/dev/null; then
            [ -e /.dockerenv ] || [ -e /run/.containerenv ] || systemd-detect-virt --quiet --container \
                || fail "no overlay can be mounted here, and this is not a container: refusing to install on the machine itself"
            if getent passwd peernet >/dev/null || [ -e /etc/peernet ] || [ -e /var/lib/peernet ]; then
                fail "no overlay can be mounted here, and PEERNet is on this machine already: purge it first"
            fi
            echo "test.sh: no overlay can be mounted here, installing in this container"
            status=0
            sh "$0" --inside "$(readlink -f "$1")" || status=$?
        fi
        exit "$status"
        ;;
    *) fail "usage: test.sh PACKAGE.deb" ;;
esac
