#!/bin/sh
# Checks the units, the sysusers.d and the tmpfiles.d files without installing them. Any warning of `systemd-analyze verify` is a
# failure. Without root, the tmpfiles.d file is not checked, and the sysusers.d file only by a dry run.
# Usage: verify.sh [FOLDER]   where the *.service files are (default: beside this script)
set -eu

here=$(cd "$(dirname "$0")" && pwd)
units=$(cd "${1:-$here}" && pwd)
# unit:limit of the exposure that `systemd-analyze security` prints, in tenths (0 is best, 100 is worst). A weaker sandbox
# exceeds the limit.
limits="agent:30 aggregator:20"

for tool in systemd-analyze systemd-sysusers systemd-tmpfiles; do
    command -v "$tool" >/dev/null || { echo "verify.sh: $tool not found; install the package systemd" >&2; exit 69; }
done

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
failed=0

# expect_no_output NAME COMMAND…: the command must succeed without output.
expect_no_output() {
    name=$1
    shift
    if "$@" >"$scratch/output" 2>&1 && [ ! -s "$scratch/output" ]; then
        echo "ok      $name"
    else
        echo "FAILED  $name"
        sed 's/^/        /' "$scratch/output"
        failed=1
    fi
}

# expect_success NAME COMMAND…: the command must succeed; its output is shown only if it fails.
expect_success() {
    name=$1
    shift
    if "$@" >"$scratch/output" 2>&1; then
        echo "ok      $name"
    else
        echo "FAILED  $name"
        sed 's/^/        /' "$scratch/output"
        failed=1
    fi
}

# `systemd-analyze verify` requires that the program exists. If it is not installed, copies of the units name a placeholder.
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
    expect_no_output "$unit: verify" systemd-analyze verify --recursive-errors=no --man=no --generators=no "$scratch/units/$unit"
    expect_success "$unit: exposure at most $limit/100" \
        systemd-analyze security --offline=yes --no-pager --threshold="$limit" "$scratch/units/$unit"
done

# Users and folders are created in an empty root.
root=$scratch/root
mkdir -p "$root/etc" "$root/usr/lib/sysusers.d" "$root/usr/lib/tmpfiles.d"
if [ -d "$here/../sysusers.d" ]; then
    cp "$here/../sysusers.d/peernet.conf" "$root/usr/lib/sysusers.d/"
    cp "$here/../tmpfiles.d/peernet.conf" "$root/usr/lib/tmpfiles.d/"
    if [ "$(id -u)" = 0 ]; then
        expect_success "sysusers.d: creates the user" systemd-sysusers --root="$root" peernet.conf
        expect_no_output "sysusers.d: peernet exists" grep -q '^peernet:' "$root/etc/passwd"
        # systemd-tmpfiles looks names up in the root's own passwd.
        expect_success "tmpfiles.d: creates the folders" systemd-tmpfiles --root="$root" --create peernet.conf
        expect_no_output "tmpfiles.d: state folder exists" test -d "$root/var/lib/peernet/agent"
    else
        expect_success "sysusers.d: is valid" systemd-sysusers --root="$root" --dry-run peernet.conf
    fi
fi
exit "$failed"
