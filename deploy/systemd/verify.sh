#!/bin/sh
# Checks the units, the sysusers.d and the tmpfiles.d files without installing them. Fails on any warning.
# Usage: verify.sh [FOLDER]   where the *.service files are (default: beside this script)
set -eu

here=$(cd "$(dirname "$0")" && pwd)
units=$(cd "${1:-$here}" && pwd)
# unit:maximum exposure by `systemd-analyze security`, in tenths (0 best, 100 worst), so that a weaker sandbox is noticed.
limits="agent:30 aggregator:20"

for tool in systemd-analyze systemd-sysusers systemd-tmpfiles; do
    command -v "$tool" >/dev/null || { echo "verify.sh: $tool not found; install the package systemd" >&2; exit 69; }
done

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
failed=0

# quiet NAME COMMAND…: the command must succeed without output.
quiet() {
    what=$1
    shift
    if "$@" >"$scratch/output" 2>&1 && [ ! -s "$scratch/output" ]; then
        echo "ok      $what"
    else
        echo "FAILED  $what"
        sed 's/^/        /' "$scratch/output"
        failed=1
    fi
}

# succeeds NAME COMMAND…: the command must succeed; its output is shown only if it fails.
succeeds() {
    what=$1
    shift
    if "$@" >"$scratch/output" 2>&1; then
        echo "ok      $what"
    else
        echo "FAILED  $what"
        sed 's/^/        /' "$scratch/output"
        failed=1
    fi
}

# `verify` requires that the program exists. If it is not installed, copies of the units name a placeholder.
mkdir "$scratch/units"
cp "$units"/peernet-*.service "$scratch/units"
if [ ! -x /usr/bin/peernetd ]; then
    printf '#!/bin/sh\n' >"$scratch/peernetd"
    chmod 755 "$scratch/peernetd"
    sed -i "s|/usr/bin/peernetd|$scratch/peernetd|" "$scratch/units"/*.service
fi

for entry in $limits; do
    unit=peernet-${entry%:*}.service
    limit=${entry#*:}
    # The check is not recursive, so that errors of other units of this machine are ignored.
    quiet "$unit: verify" systemd-analyze verify --recursive-errors=no --man=no --generators=no "$scratch/units/$unit"
    succeeds "$unit: exposure at most $limit/100" \
        systemd-analyze security --offline=yes --no-pager --threshold="$limit" "$scratch/units/$unit"
done

# Users and folders are created in an empty root.
root=$scratch/root
mkdir -p "$root/etc" "$root/usr/lib/sysusers.d" "$root/usr/lib/tmpfiles.d"
if [ -d "$here/../sysusers.d" ]; then
    cp "$here/../sysusers.d/peernet.conf" "$root/usr/lib/sysusers.d/"
    cp "$here/../tmpfiles.d/peernet.conf" "$root/usr/lib/tmpfiles.d/"
    if [ "$(id -u)" = 0 ]; then
        succeeds "sysusers.d: creates the user" systemd-sysusers --root="$root" peernet.conf
        quiet "sysusers.d: peernet exists" grep -q '^peernet:' "$root/etc/passwd"
        # systemd-tmpfiles looks names up in the root's own passwd.
        succeeds "tmpfiles.d: creates the folders" systemd-tmpfiles --root="$root" --create peernet.conf
        quiet "tmpfiles.d: state folder exists" test -d "$root/var/lib/peernet/agent"
    else
        succeeds "sysusers.d: is valid" systemd-sysusers --root="$root" --dry-run peernet.conf
    fi
fi
exit "$failed"
