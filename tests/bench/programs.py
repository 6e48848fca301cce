"""Programs that the benchmarks start. All of them end with the benchmark, even if it is killed."""

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
    """A failure with a complete message: what was tried, what happened and what to do."""


def peer(module: str, *arguments: object) -> list[str]:
    """Returns the command that runs one of the Python programs of peers/."""
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
                # The input stays open without data, because some programs end when their input ends.
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
        """Returns all output so far."""
        return self.log.read_text(errors="replace")

    def cpu_seconds(self) -> float:
        """Returns the used processor time, user and system, in seconds."""
        # The name of the program, in brackets, may have spaces.
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def raise_if_ended(self) -> None:
        """Raises a failure if the program has ended."""
        if (code := self._child.poll()) is not None:
            raise Failure(f"{self.command} ended unexpectedly (exit code {code}); its last output:\n{tail(self.text())}")

    def wait_until(self, what: str, condition: Callable[[], bool], timeout_s: float = 30.0) -> None:
        """Waits until a condition holds that this program should fulfil."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            self.raise_if_ended()
            if time.monotonic() > deadline:
                raise Failure(
                    f"timeout after {timeout_s:.0f} s while waiting until {what}; last output of {self.command}:\n"
                    f"{tail(self.text())}"
                )
            time.sleep(0.05)

    def stop(self) -> None:
        """Sends SIGTERM, and SIGKILL if the program does not end."""
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
    """Runs a program to its end. Returns its standard output, and the processor time of it and its children."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    text = output(command, timeout_s=timeout_s, environment=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return text, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def tail(text: str, lines: int = 15) -> str:
    """Returns the last lines of a log, indented."""
    return "\n".join(f"    {line}" for line in text.rstrip().splitlines()[-lines:])


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
