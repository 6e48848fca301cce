#!/bin/sh
# Checks the units, the sysusers.d and the tmpfiles.d files without installing them. Fails on any warning.
# Usage: verify.sh [FOLDER]   where the *.service files are (default: beside this script)
set -eu

here=$(cd "$(dirname "$0")" && pwd)
units=$(cd "${1:-$here}" && pwd)
# unit:highest exposure that `systemd-analyze security` may find, in tenths (0 best, 100 worst), so that no loosening
# slips in unnoticed.
limits="agent:30 aggregator:20"

for tool in systemd-analyze systemd-sysusers systemd-tmpfiles; do
    command -v "$tool" >/dev/null || { echo "verify.sh: $tool not found; install the package systemd" >&2; exit 69; }
done

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
failed=0

# quiet WHAT COMMAND…: the command must succeed and say nothing.
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

# succeeds WHAT COMMAND…: the command must succeed; what it says is shown only if not.
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

# `verify` wants to see the program. Where it is not installed, copies of the units name a stand-in for it.
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
    # Only this unit's own errors: the ones of the machine's other units are not ours.
    quiet "$unit: verify" systemd-analyze verify --recursive-errors=no --man=no --generators=no "$scratch/units/$unit"
    succeeds "$unit: exposure at most $limit/100" \
        systemd-analyze security --offline=yes --no-pager --threshold="$limit" "$scratch/units/$unit"
done

# Into an empty root: users are really made, folders are really made.
root=$scratch/root
mkdir -p "$root/etc" "$root/usr/lib/sysusers.d" "$root/usr/lib/tmpfiles.d"
if [ -d "$here/../sysusers.d" ]; then
    cp "$here/../sysusers.d/peernet.conf" "$root/usr/lib/sysusers.d/"
    cp "$here/../tmpfiles.d/peernet.conf" "$root/usr/lib/tmpfiles.d/"
    if [ "$(id -u)" = 0 ]; then
        succeeds "sysusers.d: makes the user" systemd-sysusers --root="$root" peernet.conf
        quiet "sysusers.d: peernet is there" grep -q '^peernet:' "$root/etc/passwd"
        # systemd-tmpfiles looks names up in the root's own passwd.
        succeeds "tmpfiles.d: makes the folders" systemd-tmpfiles --root="$root" --create peernet.conf
        quiet "tmpfiles.d: state folder is there" test -d "$root/var/lib/peernet/agent"
    else
        succeeds "sysusers.d: is understood" systemd-sysusers --root="$root" --dry-run peernet.conf
    fi
fi
exit "$failed"
