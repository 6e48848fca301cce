#!/bin/sh
# Builds two packages in target/debian with Debian's own tools. peernet_VERSION_ARCHITECTURE.deb contains the program from
# FOLDER (default: target/release) and the library of ONNX Runtime; peernet-dbgsym_… contains the program's debug symbols.
# Usage: build.sh [FOLDER]      (`make deb` first builds the program and fetches the library)
set -eu

root=$(cd "$(dirname "$0")/../.." && pwd)
here=$root/deploy/debian
out=$root/target/debian
stage=$out/peernet
cd "$root"
programs=${1:-target/release}

fail() { echo "build.sh: $*" >&2; exit 69; }
for tool in dpkg-deb dpkg-shlibdeps objcopy readelf; do
    command -v "$tool" >/dev/null || fail "$tool is missing; to install it: deploy/install-tools.sh deb"
done
for file in "$programs/peernetd" onnxruntime/lib/libonnxruntime.so; do
    [ -e "$file" ] || fail "$file is missing; make deb builds it"
done

version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)-1
architecture=$(dpkg --print-architecture)
symbols_stage=$out/peernet-dbgsym
rm -rf "$stage" "$symbols_stage"

# put MODE FOLDER FILE…: installs files into a folder of the package.
put() {
    mode=$1 folder=$stage/$2
    shift 2
    install -d -m 755 "$folder"
    install -m "$mode" "$@" "$folder"
}

# The program is the command line if it is started by the name of one of the links below.
put 755 usr/bin "$programs/peernetd"
for name in peernet PEERNet peernet_cli; do ln -s peernetd "$stage/usr/bin/$name"; done

# Debuggers and `perf` find the symbols by the program's build id.
build_id=$(readelf --notes "$programs/peernetd" | sed -n 's/^ *Build ID: //p')
[ -n "$build_id" ] || fail "$programs/peernetd has no build id; is it linked with --build-id?"
symbols=usr/lib/debug/.build-id/$(echo "$build_id" | cut -c1-2)
install -d -m 755 "$symbols_stage/$symbols"
symbols=$symbols_stage/$symbols/$(echo "$build_id" | cut -c3-).debug
objcopy --only-keep-debug --compress-debug-sections=zlib "$programs/peernetd" "$symbols"
chmod 644 "$symbols"
objcopy --strip-unneeded --add-gnu-debuglink="$symbols" "$stage/usr/bin/peernetd"

put 644 etc/peernet "$here"/etc/*.toml
put 644 usr/lib/systemd/system deploy/systemd/*.service
put 644 usr/lib/sysusers.d deploy/sysusers.d/peernet.conf
put 644 usr/lib/tmpfiles.d deploy/tmpfiles.d/peernet.conf

# The library with its links, and libonnxruntime_providers_shared.so, which GPU providers from another build need.
install -d -m 755 "$stage/usr/lib/peernet"
cp --no-dereference onnxruntime/lib/libonnxruntime*.so* "$stage/usr/lib/peernet"

put 755 usr/share/peernet models/export_torchvision.py deploy/test-links.sh
put 644 usr/share/peernet/models/quality-control models/quality-control/model.onnx models/quality-control/model.toml
put 644 usr/share/peernet/models/quality-control/pictures models/quality-control/pictures/*
put 644 usr/share/peernet/models/defect-detector models/defect-detector/model.onnx models/defect-detector/model.toml
put 644 usr/share/peernet/models/defect-detector/pictures models/defect-detector/pictures/*
put 644 usr/share/peernet/models/teleoperation-policy models/teleoperation-policy/*

doc=usr/share/doc/peernet
put 644 $doc README.md CHANGELOG.md
install -m 644 deploy/README.md "$stage/$doc/deploy.md"
put 644 $doc/docs docs/*.md
put 644 $doc/docs/experiments docs/experiments/*.md
put 644 $doc/onnxruntime onnxruntime/lib/LICENSE onnxruntime/lib/ThirdPartyNotices.txt
put 644 $doc/examples configs/*.toml
put 644 $doc/examples/experiments configs/experiments/*.toml
put 644 $doc/examples/experiments/networks configs/experiments/networks/*.yaml
put 644 $doc/examples/python configs/python/*.py
put 644 $doc/examples/language-models configs/language-models/*.py
put 644 $doc/examples/teleoperation configs/teleoperation/*.py configs/teleoperation/arm.xml configs/teleoperation/requirements.txt
# Paths of the checkout are replaced by paths of the package.
find "$stage/$doc/examples" -name '*.toml' -exec sed -i \
    -e "s|\"models/|\"/usr/share/peernet/models/|" -e "s|configs/|/$doc/examples/|" {} +
{
    printf 'Copyright: the PEERNet authors\nLicense: MIT or Apache-2.0, whichever you choose\n\n'
    cat LICENSE-MIT LICENSE-APACHE
} >"$stage/$doc/copyright"
chmod 644 "$stage/$doc/copyright"

# Find the packages of the libraries that the programs are linked with. dpkg-shlibdeps runs only in a folder of sources that has
# debian/control.
sources=$(mktemp -d)
trap 'rm -rf "$sources"' EXIT
mkdir "$sources/debian"
printf 'Source: peernet\n\nPackage: peernet\nArchitecture: any\n' >"$sources/debian/control"
libraries=$(cd "$sources" && dpkg-shlibdeps -O "$stage"/usr/bin/peernetd \
    "$stage"/usr/lib/peernet/libonnxruntime.so | sed -n 's/^shlibs:Depends=//p')
[ -n "$libraries" ] || fail "dpkg-shlibdeps found no library"

install -d -m 755 "$stage/DEBIAN"
install -m 755 "$here/postinst" "$here/prerm" "$here/postrm" "$stage/DEBIAN"
(cd "$stage" && find etc -type f | sed 's|^|/|') >"$stage/DEBIAN/conffiles"
(cd "$stage" && find usr -type f -print0 | xargs -0 md5sum) >"$stage/DEBIAN/md5sums"
cat >"$stage/DEBIAN/control" <<END
Package: peernet
Version: $version
Architecture: $architecture
Maintainer: The PEERNet authors <maintainers@peernet.invalid>
Installed-Size: $(du -sk --exclude=DEBIAN "$stage" | cut -f1)
Depends: $libraries, systemd, init-system-helpers, passwd
Recommends: ca-certificates
Suggests: chrony
Section: net
Priority: optional
Description: profiles networked robots, live and stage by stage
 PEERNet measures the whole loop of a networked robot: sensing, both directions
 of the network, inference on a remote machine, and actuation. One-way delays
 carry an interval that contains the truth.
 .
 This package holds the daemon peernetd with its two roles (the agent for robots
 and computing servers, the aggregator with dashboard and REST API), the command
 line peernet, their systemd units, a CPU build of ONNX Runtime and the
 quality-control demo model.
END
chmod 644 "$stage/DEBIAN/control" "$stage/DEBIAN/conffiles" "$stage/DEBIAN/md5sums"

install -d -m 755 "$symbols_stage/DEBIAN"
(cd "$symbols_stage" && find usr -type f -print0 | xargs -0 md5sum) >"$symbols_stage/DEBIAN/md5sums"
cat >"$symbols_stage/DEBIAN/control" <<END
Package: peernet-dbgsym
Version: $version
Architecture: $architecture
Maintainer: The PEERNet authors <maintainers@peernet.invalid>
Installed-Size: $(du -sk --exclude=DEBIAN "$symbols_stage" | cut -f1)
Depends: peernet (= $version)
Section: debug
Priority: optional
Build-Ids: $build_id
Description: debug symbols for peernet
END
chmod 644 "$symbols_stage/DEBIAN/control" "$symbols_stage/DEBIAN/md5sums"

rm -f "$out"/*.deb
for package in peernet-dbgsym peernet; do
    file=$out/${package}_${version}_$architecture.deb
    dpkg-deb --build --root-owner-group -Zzstd "$out/$package" "$file" >/dev/null
    rm -rf "${out:?}/$package"
    echo "$file"
done
