"""What the overview costs a browser: the counters of a headless Chromium that shows it."""

from __future__ import annotations

import json
import shutil

from deployment import free_ports, deployment
from programs import ROOT, Failure, output
from report import Section, Table

BROWSER = ROOT / "tests/browser"
PIPELINES = 4
RATE_HZ = 10.0
AIM = 0.05


def prepare() -> None:
    for tool in ("node", "npm"):
        if shutil.which(tool) is None:
            raise Failure(f"{tool} is not in PATH; install it and chromium with deploy/install-tools.sh test")
    output(["npm", "ci", "--silent", "--no-audit", "--no-fund"], folder=BROWSER, timeout_s=300)


def measure(quick: bool) -> Section:
    seconds = 10 if quick else 60
    section = Section("What the overview costs a browser")
    section.say(
        f"{PIPELINES} pipelines of {RATE_HZ:.0f} iterations a second, two of them remote; the overview in a headless "
        f"Chromium of 1440 × 900 pixels, over {seconds} s. The browser's own counters: the share of one core "
        "that the page's main thread takes for all tasks (TaskDuration), for scripts, for layout and for styles. "
        "*Processor time* is the time of this thread on the processor; *time that passed* includes its waits for the "
        "processor."
    )
    events, data, web = free_ports(3)
    with deployment() as daemons:
        daemons.aggregator(events=events, web=web)
        aggregator_line = f'aggregator = "tcp://127.0.0.1:{events}"'
        serve = f'[serve]\nlisten = "tcp://127.0.0.1:{data}"\n'
        daemons.daemon("rack", _agent("rack", aggregator_line, daemons.folder) + serve + MODEL)
        lines = "".join(_pipeline(at, data) for at in range(PIPELINES))
        daemons.daemon("cam", _agent("cam", aggregator_line, daemons.folder) + MODEL + lines)
        address = f"http://127.0.0.1:{web}"
        costs = json.loads(output(["node", "cost.mjs", address, seconds], folder=BROWSER, timeout_s=seconds * 3 + 120))
    table = Table("counted in", "all tasks, %", "scripts, %", "layout, %", "styles, %")
    for name, cost in (("processor time", costs["processor"]), ("time that passed", costs["passed"])):
        table.row(name, *(f"{100 * cost[key]:.1f}" for key in ("task", "script", "layout", "style")))
    section.table(table)
    # The time that passed depends on the other programs of the machine.
    task = costs["processor"]["task"]
    section.aim(f"overview of {PIPELINES} pipelines ≤ {AIM:.0%} of a core", f"{task:.1%}", task <= AIM)
    return section


MODEL = """
[[model]]
name = "model"
kind = "sleep"
preprocessing_ms = 2
inference_ms = 20
postprocessing_ms = 1
"""


def _agent(name: str, aggregator_line: str, folder: object) -> str:
    # With different clock identities the agents relate their clocks, as agents of two machines do.
    return f'[agent]\nname = "{name}"\nstate_dir = "{folder}/{name}"\nclock_identity = "{name}"\n{aggregator_line}\n'


def _pipeline(at: int, data: int) -> str:
    remote = f'{{ kind = "remote", peer = "tcp://127.0.0.1:{data}", model = "model" }}'
    placement = remote if at % 2 else '{ kind = "local", model = "model" }'
    return (
        f'[[pipeline]]\nname = "pipeline-{at + 1}"\nsensor = {{ kind = "synthetic", size_bytes = 20000 }}\n'
        f'placement = {placement}\nload = {{ mode = "rate", hz = {RATE_HZ} }}\n'
    )
