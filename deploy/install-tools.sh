#!/bin/sh
# Installs the tools that building, testing and benchmarking need, and prints the name and the purpose of each. Tools that
# are installed already are not touched. On systems other than Debian and Ubuntu it prints which packages to install.
# Usage: install-tools.sh build|deb|test|interop|bench…      (each set includes build)
set -eu

cargo_deny=0.20.2
stamp_suite=1.0.0

root=$(cd "$(dirname "$0")/.." && pwd)
venv=$root/.venv-tools
chrony=$venv/chrony

say() { echo "install-tools: $*"; }
fail() { echo "install-tools: $*" >&2; exit 69; }

# --- packages of the distribution -----------------------------------------------------------------------------------
# Columns: command that must exist (a|b: one of these commands), package, purpose. A leading / means a file, not a command.
build_packages='
cc            build-essential   C compiler and linker for the crates with C code
make          build-essential   the Makefile
ld.lld        lld               links the programs faster than the default linker
pkg-config    pkg-config        build scripts look for libraries with it
git           git               the commit in --version
python3       python3           fetches ONNX Runtime
/etc/ssl/certs/ca-certificates.crt  ca-certificates  downloads over HTTPS
'
test_packages='
chromium|chromium-browser|google-chrome  chromium  the dashboard is tested in a browser
node          nodejs            the browser test
npm           npm               the browser test
ip            iproute2          network namespaces as hosts
sysctl        procps            settings of those hosts
nft           nftables          links between hosts that lose and block packets
vde_switch    vde2              links between hosts that delay packets
wirefilter    vde2              links between hosts that delay packets
tcpdump       tcpdump           captures of the packets between hosts
faketime      faketime          programs that are shown a false time
/usr/lib/python3/dist-packages/numpy  python3-numpy  custom Python objects get arrays
/usr/lib/python3/dist-packages/PIL    python3-pil    custom Python objects get pictures
/usr/lib/python3/dist-packages/torch        python3-torch        models are exported from torchvision
/usr/lib/python3/dist-packages/torchvision  python3-torchvision  models are exported from torchvision
/usr/lib/python3/dist-packages/onnx         python3-onnx         models are exported from torchvision
mkfs.ext4     e2fsprogs         file systems that become read-only
losetup       mount             file systems in files
unshare       util-linux        throw-away roots for the package test
rosmaster     python3-rosmaster  a real master of ROS 1
sqlite3       sqlite3           the tests read the store with it, as users do
curl          curl              the tests request the REST API with it, as the documents do
systemd-analyze  systemd        the units are checked with it
'
deb_packages='
dpkg-deb      dpkg              the Debian package
dpkg-shlibdeps   dpkg-dev       the Debian package
objcopy       binutils          the Debian package
readelf       binutils          the Debian package
'
interop_packages='
rosmaster     python3-rosmaster       a real master of ROS 1
rostopic      python3-rostopic        tools of ROS 1 list our topics
rosnode       python3-rosnode         tools of ROS 1 list our nodes
/usr/lib/rosbag/record  python3-rosbag    records our sessions and replays them
/usr/lib/python3/dist-packages/rospy        python3-rospy        nodes of ROS 1
/usr/lib/python3/dist-packages/roslaunch    python3-roslaunch    the other packages need it without declaring it
/usr/lib/python3/dist-packages/sensor_msgs  python3-sensor-msgs  pictures as messages of ROS 1
/usr/lib/python3/dist-packages/std_msgs     python3-std-msgs     texts as messages of ROS 1
/usr/include/fastdds/dds/domain/DomainParticipant.hpp  libfastrtps-dev  Fast DDS, a middleware of ROS 2
/usr/include/openssl/ssl.h  libssl-dev    compiles roslibrust, with which our networks are compared
g++           build-essential   compiles programs for Fast DDS and libzmq
ip            iproute2          network namespaces as hosts
unshare       util-linux        network namespaces as hosts
wirefilter    vde2              links between hosts that delay packets
/usr/lib/x86_64-linux-gnu/libOSMesa.so.8|/usr/lib/aarch64-linux-gnu/libOSMesa.so.8  libosmesa6  MuJoCo renders without a screen
'

# Prints "package  reason" for each line of $1 whose command is missing.
missing_packages() {
    echo "$1" | while read -r commands package reason; do
        [ -n "$commands" ] || continue
        found=
        for command in $(echo "$commands" | tr '|' ' '); do
            case $command in
                /*) [ -e "$command" ] && found=1 ;;
                *) command -v "$command" >/dev/null 2>&1 && found=1 ;;
            esac
        done
        [ -n "$found" ] || echo "$package  $reason"
    done
}

# Sets as_root, the command prefix that gives root permissions. $1 is the apt-get command that needs them.
become_root() {
    [ -z "${as_root+set}" ] || return 0
    as_root=
    [ "$(id -u)" != 0 ] || return 0
    command -v sudo >/dev/null || fail "apt-get needs root, and sudo is not installed; run as root: apt-get $1"
    say "apt-get needs root, calling sudo"
    as_root=sudo
}

wait_for_lock="-o DPkg::Lock::Timeout=600"

update_lists() {
    become_root update
    # shellcheck disable=SC2086
    $as_root apt-get $wait_for_lock update --quiet --quiet
}

install_packages() {
    missing=$(missing_packages "$1")
    # Python modules that Debian has in separate packages.
    python3 -m pip --version >/dev/null 2>&1 || missing="$missing
python3-pip  fetches ONNX Runtime's wheel"
    if [ -n "${wants_venv:-}" ] && ! python3 -c 'import ensurepip, venv' 2>/dev/null; then
        missing="$missing
python3-venv  virtual environments for the Python packages of tests and benchmarks"
    fi
    missing=$(echo "$missing" | sed '/^$/d')
    [ -n "$missing" ] || return 0
    say "missing:"
    echo "$missing" | sed 's/^/    /'
    packages=$(echo "$missing" | cut -d' ' -f1 | sort -u | tr '\n' ' ')
    command -v apt-get >/dev/null || fail "apt-get is not installed; install these packages with the system's package manager: $packages"
    say "installing with apt-get"
    become_root "install $packages"
    update_lists || fail "apt-get update failed; is there a network? the missing packages are: $packages"
    # shellcheck disable=SC2086
    $as_root env DEBIAN_FRONTEND=noninteractive apt-get $wait_for_lock install --yes --quiet --quiet \
        --no-install-recommends -o Dpkg::Use-Pty=0 $packages \
        || fail "apt-get install failed; run it manually to see why: apt-get install $packages"
    still=$(missing_packages "$1" | cut -d' ' -f1 | sort -u | tr '\n' ' ')
    [ -z "$still" ] || fail "apt-get succeeded, but the commands of these packages are not in PATH: $still"
}

# --- Rust -----------------------------------------------------------------------------------------------------------

check_rust() {
    command -v cargo >/dev/null || fail "cargo is not in PATH; install Rust from https://rustup.rs, which then uses rust-toolchain.toml"
    cd "$root"
    cargo --version >/dev/null 2>&1 \
        || fail "cargo cannot use the toolchain of rust-toolchain.toml; install it: rustup toolchain install"
    for component in fmt clippy; do
        cargo "$component" --version >/dev/null 2>&1 || {
            say "cargo $component is missing; adding it with rustup"
            rustup component add "$([ "$component" = fmt ] && echo rustfmt || echo clippy)" \
                || fail "cargo $component is missing and rustup cannot add it"
        }
    done
}

# cargo_tool NAME VERSION PURPOSE: builds and installs a tool, unless this version is installed.
cargo_tool() {
    [ "$("$1" --version 2>/dev/null)" != "$1 $2" ] || return 0
    say "building $1 $2 ($3) with cargo install; this takes about a minute, once"
    # The build uses neither the workspace's target folder nor its linker flags. It is a debug build, because that compiles
    # faster and the tools do little work.
    (cd "$root" && env -u CARGO_TARGET_DIR -u RUSTFLAGS cargo install --debug --locked --version "$2" "$1") \
        || fail "cargo install $1 --version $2 --debug --locked failed"
    [ "$("$1" --version 2>/dev/null)" = "$1 $2" ] \
        || fail "$1 $2 is installed, but PATH has another version first: $(command -v "$1" || echo none)"
}

# --- Python packages of the tests and of interop --------------------------------------------------------------------

# python_environment NAME PACKAGES PURPOSE: installs deploy/NAME-requirements.txt into a virtual environment.
python_environment() {
    requirements=$root/deploy/$1-requirements.txt
    # The copy beside the packages says what was installed.
    cmp -s "$requirements" "$venv/$1/requirements.txt" && [ -x "$venv/$1/bin/python" ] && return 0
    say "installing $2 into $venv/$1, for $3"
    python3 -m venv --clear "$venv/$1" || fail "python3 -m venv $venv/$1 failed"
    "$venv/$1/bin/python" -m pip install --quiet --disable-pip-version-check --requirement "$requirements" \
        || fail "pip could not install $requirements into $venv/$1; is there a network?"
    cp "$requirements" "$venv/$1/requirements.txt"
}

# --- Python packages of the benchmarks ------------------------------------------------------------------------------

install_bench_environment() {
    requirements=$root/deploy/bench-requirements.txt
    # The copy beside the packages says what was installed.
    cmp -s "$requirements" "$venv/requirements.txt" && [ -x "$venv/bin/python" ] && return 0
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
        || fail "the benchmarks' onnxruntime needs Python 3.11 or newer, python3 is $(python3 --version 2>&1)"
    say "installing numpy, onnx, onnxruntime, pillow and pyzmq into $venv, for make bench"
    python3 -m venv --clear "$venv" || fail "python3 -m venv $venv failed"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --requirement "$requirements" \
        || fail "pip could not install $requirements into $venv; is there a network?"
    cp "$requirements" "$venv/requirements.txt"
}

# --- chrony for the tests -------------------------------------------------------------------------------------------

# chrony is unpacked and not installed, because an installation would remove systemd-timesyncd and start a daemon that sets the clock.
unpack_chrony() {
    "$chrony/usr/sbin/chronyd" --version >/dev/null 2>&1 && return 0
    command -v apt-get >/dev/null \
        || fail "apt-get is not installed; copy the distribution's chronyd to $chrony/usr/sbin and chronyc into $chrony/usr/bin"
    say "unpacking chrony into $chrony, for tests with time daemons"
    rm -rf "$chrony"
    mkdir -p "$chrony"
    # Without this option, apt run as root warns that its sandbox user cannot write to this folder.
    sandbox="-o APT::Sandbox::User=$(id -un)"
    # shellcheck disable=SC2086
    (cd "$chrony" && { apt-get $sandbox --quiet --quiet download chrony \
        || { update_lists && apt-get $sandbox --quiet --quiet download chrony; }; }) \
        || fail "apt-get download chrony failed; is there a network?"
    dpkg-deb --extract "$chrony"/chrony_*.deb "$chrony" || fail "cannot unpack $chrony/chrony_*.deb"
    rm "$chrony"/chrony_*.deb
    "$chrony/usr/sbin/chronyd" --version >/dev/null \
        || fail "chronyd does not start; missing libraries: $(ldd "$chrony/usr/sbin/chronyd" | sed -n 's/ => not found//p' | tr -d '\t' | tr '\n' ' ')"
}

# --------------------------------------------------------------------------------------------------------------------

[ $# -gt 0 ] || fail "usage: install-tools.sh build|deb|test|interop|bench…"
packages=$build_packages
for set in "$@"; do
    case $set in
        build) ;;
        deb) packages=$packages$deb_packages ;;
        test)
            packages=$packages$test_packages$deb_packages
            wants_chrony=1
            wants_api=1
            wants_venv=1
            ;;
        interop)
            packages=$packages$interop_packages
            wants_interop=1
            wants_venv=1
            ;;
        bench) wants_venv=1 ;;
        *) fail "unknown set '$set'; known are build, deb, test, interop and bench" ;;
    esac
done
install_packages "$packages"
check_rust
for set in "$@"; do
    case $set in
        test)
            cargo_tool cargo-deny "$cargo_deny" "licences, bans and sources of the dependencies"
            cargo_tool stamp-suite "$stamp_suite" "a STAMP implementation that is not ours"
            ;;
        bench) install_bench_environment ;;
    esac
done
# These come after the benchmarks' environment, whose installation clears the folder that contains them.
[ -z "${wants_api:-}" ] || python_environment api "schemathesis" "the tests of the REST API"
[ -z "${wants_interop:-}" ] || python_environment interop "Cyclone DDS, llama.cpp, MuJoCo and pyzmq" "tests with foreign peers"
[ -z "${wants_chrony:-}" ] || unpack_chrony
say "$*: all tools are installed"
