"""Programs that the benchmarks start: none outlives them, whatever ends them."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
RELEASE = ROOT / "target/release"
PEERNETD = RELEASE / "peernetd"
PEERNET = RELEASE / "peernet"
BARE_TCP = RELEASE / "bare-tcp"
BARE_UDP = RELEASE / "bare-udp"
BARE_DDS = RELEASE / "bare-dds"
ROSLIBRUST_PEER = ROOT / "target/interop/release/roslibrust-peer"
EVENT_STREAM = RELEASE / "event-stream"

PR_SET_PDEATHSIG = 1
STOP_TIMEOUT_S = 20.0


class Failure(Exception):
    """What was tried, what went wrong and what to do, ready to print."""


def peer(module: str, *arguments: object) -> list[str]:
    """The command that runs one of the Python programs of peers/."""
    return [sys.executable, "-B", "-m", f"peers.{module}", *map(str, arguments)]


class Program:
    """A running program with its output in a log file."""

    def __init__(
        self,
        command: Sequence[object],
        log: Path,
        *,
        folder: Path = HERE,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.command = [str(part) for part in command]
        self.log = log
        with log.open("wb") as file:
            self._child = subprocess.Popen(
                self.command,
                # Open and silent: some programs end when their input does.
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env={**os.environ, **(environment or {})},
                process_group=0,
                preexec_fn=_die_with_parent,
            )

    @property
    def pid(self) -> int:
        return self._child.pid

    def text(self) -> str:
        """All it wrote so far."""
        return self.log.read_text(errors="replace")

    def cpu_seconds(self) -> float:
        """Processor time that it has used, of user and system."""
        # The name of the program, in brackets, may have spaces.
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def check(self) -> None:
        """Fails when it has ended."""
        if (code := self._child.poll()) is not None:
            raise Failure(f"{self.command} ended by itself (exit code {code}); it said:\n{tail(self.text())}")

    def wait_until(self, what: str, holds: Callable[[], bool], timeout_s: float = 30.0) -> None:
        """Waits for something that this program is to bring about."""
        deadline = time.monotonic() + timeout_s
        while not holds():
            self.check()
            if time.monotonic() > deadline:
                raise Failure(
                    f"waited {timeout_s:.0f} s in vain until {what}; {self.command} said:\n{tail(self.text())}"
                )
            time.sleep(0.05)

    def stop(self) -> None:
        """SIGTERM, and SIGKILL when that does not help."""
        if self._child.poll() is None:
            self._signal(signal.SIGTERM)
            try:
                self._child.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._signal(signal.SIGKILL)
                self._child.wait()

    def _signal(self, number: signal.Signals) -> None:
        os.killpg(self._child.pid, number)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def output(
    command: Sequence[object],
    *,
    folder: Path = HERE,
    timeout_s: float = 120.0,
    show: bool = False,
    environment: Mapping[str, str] | None = None,
) -> str:
    """Runs a program to its end and returns its standard output; `show` lets its standard error through."""
    child = subprocess.Popen(
        [str(part) for part in command],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=None if show else subprocess.PIPE,
        cwd=folder,
        env={**os.environ, **(environment or {})},
        text=True,
        process_group=0,
        preexec_fn=_die_with_parent,
    )
    try:
        out, err = child.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        raise Failure(f"{command} did not end within {timeout_s:.0f} s") from None
    finally:
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
            child.wait()
    if child.returncode != 0:
        raise Failure(f"{command} failed (exit code {child.returncode}):\n{tail(out + (err or ''))}")
    return out


def output_and_cpu(
    command: Sequence[object], *, timeout_s: float = 120.0, environment: Mapping[str, str] | None = None
) -> tuple[str, float]:
    """Runs a program to its end; its standard output, and the processor time that it and its children used."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    text = output(command, timeout_s=timeout_s, environment=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return text, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def tail(text: str, lines: int = 15) -> str:
    """The last lines of a log, indented."""
    return "\n".join(f"    {line}" for line in text.rstrip().splitlines()[-lines:])


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
