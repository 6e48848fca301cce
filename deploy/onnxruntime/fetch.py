#!/usr/bin/env python3
"""Fetch the pinned ONNX Runtime library and unpack it where PEERNet looks for it.

pip downloads the official wheel from PyPI. First pip and then this script compare the wheel with the hash in `pinned.toml`. Does
nothing if this version is already installed. Needs only Python 3.9 and pip.
"""

import argparse
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parent.parent
PINS = HERE / "pinned.toml"
STAMP = ".fetched"
PYTHON_TAG = "312"  # pip must be told one of the interpreters the wheel exists for

# Members that are extracted from the wheel: pattern of the member's name, and file name in the destination (None: the group of the
# pattern).
WANTED = [
    (re.compile(r"onnxruntime/capi/(libonnxruntime\.so\.\d+\.\d+\.\d+)"), None),
    (re.compile(r"onnxruntime/capi/(libonnxruntime_providers_shared\.so)"), None),
    (re.compile(r"onnxruntime/LICENSE"), "LICENSE"),
    (re.compile(r"onnxruntime/ThirdPartyNotices\.txt"), "ThirdPartyNotices.txt"),
]


class FetchError(Exception):
    """A failure with a complete message: what was tried, what happened and what to do."""


def read_pins(path):
    """Parses the `key = "value"` lines of pinned.toml; Python 3.9 has no TOML parser."""
    pins, table = {}, None
    for number, line in enumerate(path.read_text().splitlines(), 1):
        line = line.split("#", 1)[0].strip()
        if not line:
            continue
        if match := re.fullmatch(r"\[(\w+)\]", line):
            table = pins.setdefault(match[1], {})
        elif match := re.fullmatch(r'(\w+)\s*=\s*"([^"]*)"', line):
            (pins if table is None else table)[match[1]] = match[2]
        else:
            raise FetchError(f"{path}:{number}: expected [table] or key = \"value\", found {line!r}")
    return pins


def find_pip():
    """Returns the command of pip: of this interpreter, of the tools' virtual environment, or in PATH."""
    candidates = [
        [sys.executable, "-m", "pip"],
        [str(REPOSITORY / ".venv-tools/bin/python"), "-m", "pip"],
        ["pip3"],
    ]
    for command in candidates:
        try:
            subprocess.run([*command, "--version"], check=True, capture_output=True)
            return command
        except (OSError, subprocess.CalledProcessError):
            continue
    tried = ", ".join(" ".join(command) for command in candidates)
    raise FetchError(f"no pip found (tried {tried}); install it: apt-get install python3-pip")


def download(pip, version, pin, folder):
    """Downloads the wheel into `folder`, checks its hash and returns its path."""
    requirement = f"onnxruntime=={version} --hash=sha256:{pin['sha256']}\n"
    requirements = folder / "requirements.txt"
    requirements.write_text(requirement)
    command = [
        *pip, "download", "--quiet", "--no-deps", "--require-hashes", "--only-binary", ":all:",
        "--implementation", "cp", "--python-version", PYTHON_TAG, "--abi", f"cp{PYTHON_TAG}",
        "--platform", pin["platform"], "--dest", str(folder), "--requirement", str(requirements),
    ]  # fmt: skip
    environment = {**os.environ, "PIP_REQUIRE_VIRTUALENV": "0", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    result = subprocess.run(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if result.returncode != 0:
        raise FetchError(
            f"could not download onnxruntime {version} for {pin['platform']}\n"
            f"  tried: {' '.join(command)}\n"
            + "".join(f"  pip: {line}\n" for line in result.stdout.strip().splitlines()[-6:])
            + "  without a network: put the wheel into a folder and set PIP_NO_INDEX=1 PIP_FIND_LINKS=<folder>\n"
            "  with another library of your own: set ORT_DYLIB_PATH or, in the configuration, [onnxruntime] library"
        )
    wheels = list(folder.glob("onnxruntime-*.whl"))
    if len(wheels) != 1:
        raise FetchError(f"expected one wheel in {folder}, found {[wheel.name for wheel in wheels]}")
    digest = hashlib.sha256(wheels[0].read_bytes()).hexdigest()
    if digest != pin["sha256"]:
        raise FetchError(
            f"{wheels[0].name} has sha256 {digest}\n  but {PINS} requires {pin['sha256']}\n"
            "  the download is damaged or was changed, or pinned.toml is wrong: nothing was unpacked"
        )
    return wheels[0]


def unpack(wheel, folder):
    """Copies the wanted members into `folder` and returns their names, the library first."""
    names = []
    with zipfile.ZipFile(wheel) as archive:
        for pattern, name in WANTED:
            for member in archive.namelist():
                if match := pattern.fullmatch(member):
                    target = folder / (name or match[1])
                    with archive.open(member) as source, target.open("wb") as sink:
                        shutil.copyfileobj(source, sink)
                    target.chmod(0o644)
                    names.append(target.name)
    if not names or not names[0].startswith("libonnxruntime.so."):
        raise FetchError(f"no libonnxruntime.so.* in {wheel.name}: has the wheel's layout changed?")
    return names


def install(staging, names, destination, stamp):
    """Moves the unpacked files to the destination. The stamp is written last, so that an interrupted installation is repeated."""
    destination.mkdir(parents=True, exist_ok=True)
    # Without a stamp, the folder may contain libraries that are not from an earlier fetch. They stay.
    if (destination / STAMP).exists():
        for old in destination.glob("libonnxruntime*"):
            old.unlink()
        (destination / STAMP).unlink()
    for name in names:
        os.replace(staging / name, destination / name)
    for link in ("libonnxruntime.so", "libonnxruntime.so.1"):
        (destination / link).unlink(missing_ok=True)
        (destination / link).symlink_to(names[0])
    (destination / STAMP).write_text(stamp)


def is_installed(destination, stamp):
    try:
        return (destination / STAMP).read_text() == stamp and (destination / "libonnxruntime.so.1").exists()
    except OSError:
        return False


def fetch(arch, destination, force):
    pins = read_pins(PINS)
    architectures = [key for key, value in pins.items() if isinstance(value, dict)]
    if arch not in architectures:
        raise FetchError(
            f"PyPI's wheel is pinned for {' and '.join(architectures)}, not for {arch}\n"
            "  build ONNX Runtime for it and set ORT_DYLIB_PATH or, in the configuration, [onnxruntime] library"
        )
    version, pin = pins["version"], pins[arch]
    stamp = f"onnxruntime {version} {arch} sha256:{pin['sha256']}\n"
    if is_installed(destination, stamp) and not force:
        print(f"onnxruntime {version} for {arch} is already installed in {destination}")
        return
    pip = find_pip()
    print(f"fetching onnxruntime {version} for {arch} from PyPI into {destination}", flush=True)
    destination.parent.mkdir(parents=True, exist_ok=True)
    # The folder is on the file system of the destination, so that the files can be renamed into it.
    with tempfile.TemporaryDirectory(prefix=".onnxruntime-", dir=destination.parent) as scratch:
        scratch = Path(scratch)
        names = unpack(download(pip, version, pin, scratch), scratch)
        install(scratch, names, destination, stamp)
    print(f"unpacked {', '.join(names)}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arch", default=platform.machine(), help="x86_64 or aarch64 (default: this machine's)")
    parser.add_argument("--dest", type=Path, default=REPOSITORY / "onnxruntime/lib", help="target folder (default: %(default)s)")
    parser.add_argument("--force", action="store_true", help="fetch again even if it is installed")
    arguments = parser.parse_args()
    arch = {"amd64": "x86_64", "arm64": "aarch64"}.get(arguments.arch, arguments.arch)
    try:
        fetch(arch, arguments.dest.resolve(), arguments.force)
    except FetchError as error:
        sys.exit(f"fetch.py: {error}")
    except OSError as error:
        sys.exit(f"fetch.py: cannot write to {arguments.dest}: {error}; choose another folder with --dest")


if __name__ == "__main__":
    main()
