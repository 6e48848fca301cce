"""Facts about the machine on which the figures were measured."""

from __future__ import annotations

import os
import platform
import re
import subprocess
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from programs import ROOT

# Runnable tasks per core above which other programs determine the figures.
BUSY = 0.25


def facts() -> list[str]:
    """Returns the facts as lines of Markdown."""
    memory = _first(r"MemTotal:\s+(\d+)", Path("/proc/meminfo").read_text())
    python = ", ".join(f"{name} {_version(name)}" for name in ("pyzmq", "numpy", "pillow", "onnxruntime"))
    lines = [
        f"Measured {time.strftime('%Y-%m-%d %H:%M UTC', time.gmtime())} on {_processor()}, {os.cpu_count()} cores, "
        f"{int(memory) / 2**20:.0f} GiB, {platform.system()} {platform.release()}.",
        f"PEERNet {_commit()}, {_output_of('rustc', '--version')}; Python {platform.python_version()}, {python}.",
    ]
    if (load := os.getloadavg()[0] / (os.cpu_count() or 1)) > BUSY:
        lines.append(
            f"**The machine was busy** when this began (load average {os.getloadavg()[0]:.2f}, {load:.2f} a core): "
            "ratios suffer less than absolute figures, but both suffer."
        )
    return lines


def steal() -> float:
    """Returns the stolen time of all cores since boot, seconds: time that the hypervisor gave to other machines."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


def _processor() -> str:
    text = Path("/proc/cpuinfo").read_text()
    name = _first(r"model name\s*:\s*(.+)", text) or _first(r"Model\s*:\s*(.+)", text)
    return f"{name or platform.processor() or 'an unnamed processor'} ({platform.machine()})"


def _commit() -> str:
    commit = _output_of("git", "-C", str(ROOT), "rev-parse", "--short", "HEAD")
    changed = _output_of("git", "-C", str(ROOT), "status", "--porcelain", "--untracked-files=no")
    return f"{commit or 'of no known commit'}{' with changes' if changed else ''}"


def _output_of(*command: str) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT).stdout.strip()
    except OSError:
        return ""


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "missing"


def _first(pattern: str, text: str) -> str:
    match = re.search(pattern, text)
    return match[1].strip() if match else ""
