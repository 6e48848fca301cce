"""One-way delays of other programs, chrony and stamp-suite, over the path that PEERNet measures."""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from namespaces import Host
from programs import ROOT, Failure, Program, output
from quantiles import quantile

CHRONY = ROOT / ".venv-tools/chrony/usr"
# Port on which the edge's chronyd answers chronyc.
COMMAND_PORT = 323
CLIENT_LINES = f"port 0\ncmdport {COMMAND_PORT}\nbindcmdaddress 127.0.0.1\n"
SERVER_PORT = 11_123
STAMP_PORT = 8620
STAMP_PROBES = 300
# Fields of `chronyc -c tracking`.
SYSTEM_TIME, ROOT_DELAY, ROOT_DISPERSION = 4, 10, 11


@dataclass(frozen=True)
class ClaimErrors:
    """Mean error and median width of chrony's claims, seconds; share of claims that miss the true offset."""

    error: float
    width: float
    outside: float


def prepare() -> None:
    """Raises a failure if one of the programs is missing."""
    for program in (CHRONY / "sbin/chronyd", CHRONY / "bin/chronyc", stamp_suite_program(), faketime()):
        if not program.exists():
            raise Failure(f"{program} does not exist; install it with deploy/install-tools.sh test")


def chrony(edge: Host, cloud: Host, seconds: float) -> ClaimErrors:
    """Measures the claims of a chronyd on the edge that follows a chronyd on the cloud.

    Both read the clock of this machine and neither changes it, so the true offset is zero.
    """
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as name:
        folder = Path(name)
        serve = f"local stratum 10\nallow all\nbindaddress {cloud.address}\ncmdport 0\n"
        follow = f"server {cloud.address} iburst minpoll -2 maxpoll 0\n{CLIENT_LINES}"
        with _chronyd(cloud, folder / "cloud", serve), _chronyd(edge, folder / "edge", follow):
            _wait_for_synchronisation(edge)
            offsets, widths, outside = [], [], 0
            end = time.monotonic() + seconds
            while time.monotonic() < end:
                fields = output(_chronyc(edge, "-c", "tracking")).strip().split(",")
                offset = abs(float(fields[SYSTEM_TIME]))
                half_width = float(fields[ROOT_DELAY]) / 2 + float(fields[ROOT_DISPERSION])
                offsets.append(offset)
                widths.append(2 * half_width)
                outside += offset > half_width
                time.sleep(0.25)
    return ClaimErrors(fmean(offsets), quantile(sorted(widths), 0.5), outside / len(offsets))


@contextmanager
def daemons_with_small_claims(edge: Host, cloud: Host) -> Iterator[None]:
    """Runs two chronyd on each host; the second follows the first, so the second claims an error of microseconds."""
    serve = f"local stratum 10\nallow 127.0.0.1\nport {SERVER_PORT}\ncmdport 0\n"
    follow = f"server 127.0.0.1 port {SERVER_PORT} iburst minpoll -2 maxpoll 0\n{CLIENT_LINES}"
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder, ExitStack() as stack:
        for host in (edge, cloud):
            for name, lines in (("server", serve), ("client", follow)):
                stack.enter_context(_chronyd(host, Path(folder, f"{host.name}-{name}"), lines))
        for host in (edge, cloud):
            _wait_for_synchronisation(host)
        yield


def chronyc_settings() -> str:
    """Returns the lines of `[clock]` with which an agent queries its host's chronyd."""
    return f'chronyc = "{CHRONY}/bin/chronyc"\nchronyc_arguments = ["-h", "127.0.0.1", "-p", "{COMMAND_PORT}"]'


def _wait_for_synchronisation(host: Host) -> None:
    # At most 600 tries, 0.1 s apart; any correction, and a skew of at most 100 ppm.
    output(_chronyc(host, "waitsync", "600", "0", "100", "0.1"))


def _chronyc(host: Host, *command: str) -> list[str]:
    return host.inside([CHRONY / "bin/chronyc", "-h", "127.0.0.1", "-p", COMMAND_PORT, *command])


def _chronyd(host: Host, folder: Path, lines: str) -> Program:
    folder.mkdir()
    file = folder / "chrony.conf"
    # `bindcmdaddress /` disables the Unix socket for commands, which all chronyd of one file system would share.
    file.write_text(f"{lines}bindcmdaddress /\npidfile {folder}/pid\n")
    # With -x, chronyd does not change the clock.
    command = [CHRONY / "sbin/chronyd", "-x", "-d", "-U", "-u", "root", "-f", file]
    return Program(host.inside(command), folder / "log")


def stamp_suite_program() -> Path:
    return Path(shutil.which("stamp-suite") or Path.home() / ".cargo/bin/stamp-suite")


def faketime() -> Path:
    found = sorted(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1"))
    return found[0] if found else Path("/usr/lib/faketime/libfaketimeMT.so.1")


def false_time(ahead_s: float, *, every_clock: bool = False) -> dict[str, str]:
    """Returns the environment of a program that sees its wall clock, or all its clocks, `ahead_s` ahead."""
    shown = {"LD_PRELOAD": str(faketime()), "FAKETIME": f"{ahead_s:+}s"}
    return shown if every_clock else shown | {"DONT_FAKE_MONOTONIC": "1"}


def stamp_suite(edge: Host, cloud: Host, ahead_s: float, truths: tuple[float, float]) -> float:
    """Returns the larger error of stamp-suite's mean delays, up and down.

    The sender's clock is `ahead_s` ahead of the reflector's.
    """
    program = stamp_suite_program()
    reflect = [program, "--is-reflector", "--local-addr", cloud.address, "--local-port", STAMP_PORT]
    send = [program, "--remote-addr", cloud.address, "--remote-port", STAMP_PORT, "--count", STAMP_PROBES]
    send += ["--send-delay", "10", "--timeout", "5", "--clock-source", "PTP", "--output-format", "json"]
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        with Program(cloud.inside(reflect), Path(folder, "log")) as reflector:
            reflector.wait_until("it reflects", lambda: "Starting up" in reflector.text())
            text = output(edge.inside(send), environment=false_time(ahead_s))
    summary = next(json.loads(line) for line in text.splitlines() if '"summary"' in line)
    ways = [summary["owd"][f"{way}_avg_ms"] * 1e-3 for way in ("forward", "reverse")]
    return max(abs(way - truth) for way, truth in zip(ways, truths, strict=True))
