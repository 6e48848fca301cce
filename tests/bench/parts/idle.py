"""What a daemon costs its host: with nothing to do, and with the demo's configuration."""

from __future__ import annotations

import os
import re
import time
from dataclasses import dataclass
from pathlib import Path

from deployment import Deployment, free_ports, deployment
from programs import ROOT, Program
from report import Section, Table

SETTLE_S = 3.0
DEMO = ("aggregator", "cloud", "edge")


@dataclass(frozen=True)
class Cost:
    """What a process used in a measurement."""

    # Processor time in seconds per second, and wake-ups per second, over the measurement.
    processor: float
    wake_ups: float
    # Memory at the end, bytes: resident, and the part of it that is not mapped from files.
    resident: int
    own: int


def prepare() -> None:
    pass


def measure(quick: bool) -> Section:
    seconds = 4.0 if quick else 20.0
    section = Section("What it costs to run")
    section.say(
        f"Over {seconds:.0f} s, {SETTLE_S:.0f} s after the start. Processor: user and system time of all threads, in "
        "percent of one core. Wake-ups: voluntary context switches. Memory: what is resident, and the part of it that "
        "is the process's own (not mapped from files, which processes share)."
    )
    table = Table("daemon", "processor, %", "wake-ups/s", "resident, MiB", "own, MiB")
    for name, cost in {**_idle(seconds), **_demo(seconds)}.items():
        table.row(
            name,
            f"{100 * cost.processor:.2f}",
            f"{cost.wake_ups:.0f}",
            f"{cost.resident / 2**20:.1f}",
            f"{cost.own / 2**20:.1f}",
        )
    section.table(table)
    return section


def _idle(seconds: float) -> dict[str, Cost]:
    events, web = free_ports(2)
    with deployment() as daemons:
        programs = {
            "aggregator with one idle agent": daemons.aggregator(events=events, web=web),
            "idle agent without aggregator": daemons.daemon("alone", _agent(daemons, "alone", "")),
            "idle agent with aggregator": daemons.daemon(
                "agent", _agent(daemons, "agent", f'aggregator = "tcp://127.0.0.1:{events}"')
            ),
        }
        return measure_costs(programs, seconds)


def _demo(seconds: float) -> dict[str, Cost]:
    """Runs the configuration files of the demo, with free ports."""
    ports = dict(zip(("5550", "5551", "8040"), map(str, free_ports(3)), strict=True))
    with deployment() as daemons:
        for folder in ("models", "onnxruntime"):
            daemons.link(folder)
        programs = {}
        for role in DEMO:
            text = (ROOT / "configs" / f"{role}.toml").read_text()
            moved = re.sub(r"(?<=:)(5550|5551|8040)\b", lambda match: ports[match[0]], text)
            programs[f"demo: {role}"] = daemons.daemon(role, moved)
        return measure_costs(programs, seconds)


def _agent(daemons: Deployment, name: str, aggregator_line: str) -> str:
    return f"""
        [agent]
        name = "{name}"
        state_dir = "{daemons.folder}/{name}"
        {aggregator_line}
    """


def measure_costs(programs: dict[str, Program], seconds: float) -> dict[str, Cost]:
    """Measures running programs for `seconds`, from SETTLE_S after the call. Raises a failure if one has ended."""
    time.sleep(SETTLE_S)
    begin = time.monotonic()
    before = {name: (_processor(program.pid), _wake_ups(program.pid)) for name, program in programs.items()}
    time.sleep(seconds)
    elapsed = time.monotonic() - begin
    costs = {}
    for name, program in programs.items():
        program.raise_if_ended()
        processor, wake_ups = before[name]
        costs[name] = Cost(
            (_processor(program.pid) - processor) / elapsed,
            (_wake_ups(program.pid) - wake_ups) / elapsed,
            _memory(program.pid, "VmRSS"),
            _memory(program.pid, "RssAnon"),
        )
    return costs


def _processor(pid: int) -> float:
    """Returns the processor time since the process began, seconds."""
    # The program's name in parentheses may contain anything, so only the text after the last parenthesis is split.
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _wake_ups(pid: int) -> int:
    """Returns the voluntary context switches of the present threads."""
    statuses = (task.joinpath("status").read_text() for task in Path(f"/proc/{pid}/task").iterdir())
    return sum(_field(text, "voluntary_ctxt_switches") for text in statuses)


def _memory(pid: int, field: str) -> int:
    """Returns a memory field of the process's status, bytes."""
    return _field(Path(f"/proc/{pid}/status").read_text(), field) * 1024


def _field(status: str, name: str) -> int:
    match = re.search(rf"^{name}:\s+(\d+)", status, re.MULTILINE)
    return int(match[1]) if match else 0
