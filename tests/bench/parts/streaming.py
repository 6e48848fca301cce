"""Streamed answers of a language model: the time that PEERNet adds to each token, and to answers without a stream."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

from deployment import free_ports
from experiments import cloud, need_peernet, run_experiment
from peers.token_server import WHOLE_BYTES
from programs import PEERNET, Failure, Program, output, peer
from quantiles import median_spread, spread
from report import Section, Table, micros, ratio, times

# Environment variable: folder with `peernetd` and `peernet` of an older build. If it is set, the two builds are compared
# by requests whose answers are not streamed.
BASELINE = "PEERNET_BENCH_BASELINE"
BURST, PACED, INTERVAL_MS = 2_000, 100, 5.0
READERS = ("bare reader", "reader with JSON", "PEERNet, local", "PEERNet, cloud")
BARE = READERS[0]

# Largest aimed-for time per token beyond the bare reader, and ratio to the older build.
TOKEN_AIM_S = 20e-6
BASELINE_AIM = 1.05


@dataclass(frozen=True)
class Answer:
    """One answer as its reader measured it."""

    # Start of the request, seconds since 1970.
    at: float
    # Seconds from the start to the end of the answer.
    total: float
    # Seconds from the start to the first token.
    first: float
    # Number of parts that arrived; only PEERNet has it.
    parts: float | None = None


@dataclass(frozen=True)
class Stamps:
    """Times of one answer at the server, seconds since 1970.

    The request is received; the first token is about to be written; the last token is about to be written.
    """

    received: float
    first: float
    last: float


@dataclass
class Bench:
    """Ports of the scripted server and of the cloud, and number of answers of each model in a run."""

    folder: Path
    server_port: int
    cloud_port: int
    counts: dict[str, int]

    def read(self, model: str, reader: str) -> list[Answer]:
        """Measures the answers of a model with one of READERS."""
        if not reader.startswith("PEERNet"):
            command = peer("token_server", "read", self.server_port, model, self.counts[model])
            command += [] if reader == BARE else ["--parse"]
            return [Answer(one["at"], one["total"], one["first"]) for one in json.loads(output(command))]
        is_local = reader == "PEERNet, local"
        name = f"{model}-{'local' if is_local else 'cloud'}"
        port = None if is_local else self.cloud_port
        text = _experiment(model, self.counts[model], port, _openai(self.server_port, model))
        (run,) = run_experiment(self.folder, name, text)
        first = "inference_time-to-first-token" if is_local else "first-part"
        return [
            Answer(float(row["at"]), float(row["total"]), float(row[first]), float(row.get("parts") or 0))
            for row in run.rows
        ]

    def stamps(self, model: str) -> list[Stamps]:
        """Returns the server's times of all answers of a model."""
        lines = map(json.loads, (self.folder / "stamps").read_text().splitlines())
        keys = ("received", "first", "last")
        return [Stamps(*(line[key] * 1e-9 for key in keys)) for line in lines if line["model"] == model]


@dataclass
class AnswerDelays:
    """Delays of the first token and of the end in one repeat, without the server's own times, seconds."""

    first: list[float] = field(default_factory=list)
    end: list[float] = field(default_factory=list)


def prepare() -> None:
    need_peernet()
    if baseline := _baseline():
        for name in ("peernetd", "peernet"):
            if not (baseline / name).exists():
                raise Failure(f"{BASELINE} names {baseline}, which has no {name}")


def measure(quick: bool) -> Section:
    repeats = 2 if quick else 7
    counts = {"burst": 5, "paced": 2, "whole": 50} if quick else {"burst": 30, "paced": 8, "whole": 1_000}
    section = Section("Streamed answers")
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as name:
        folder = Path(name)
        serve = peer("token_server", "serve", BURST, PACED, INTERVAL_MS, folder / "stamps")
        with Program(serve, folder / "server.log") as server:
            server.wait_until("it listens", lambda: server.text().endswith("\n"))
            port, (cloud_port, *other_ports) = int(server.text()), free_ports(3)
            bench = Bench(folder, port, cloud_port, counts)
            models = "".join(_openai(port, model) for model in counts)
            with cloud(folder, cloud_port, models):
                _burst(section, bench, repeats)
                _paced(section, bench, repeats)
                _whole(section, bench, repeats, other_ports)
    return section


def _burst(section: Section, bench: Bench, repeats: int) -> None:
    totals: dict[str, list[float]] = {reader: [] for reader in READERS}
    parts: list[float] = []

    def add(reader: str) -> None:
        answers = bench.read("burst", reader)
        totals[reader].append(median(answer.total for answer in answers))
        if reader == READERS[-1]:
            parts.extend(answer.parts or 0.0 for answer in answers)

    _in_turn("burst", repeats, READERS, add)
    section.say(
        f"A scripted server with the chat API of OpenAI on the loopback interface sends {BURST:,} tokens at once, one "
        "in each event. *Bare reader*: a Python program that reads the bytes and drops them; *with JSON*: one that "
        "parses each event. *Local*: `peernet run` with a local model of the kind `openai`; *cloud*: an agent has the "
        f"model, and sends each token to `peernet run` when it arrives. {repeats} repeats of {bench.counts['burst']} "
        "answers, in turn; medians over the repeats, differences taken repeat by repeat."
    )
    table = Table(f"{BURST:,} tokens at once, µs", "whole answer p50", "per token", "per token beyond the bare reader")
    for reader in READERS:
        beyond = [(a - b) / BURST for a, b in zip(totals[reader], totals[BARE], strict=True)]
        whole = median(totals[reader])
        table.row(reader, micros(whole), micros(whole / BURST), "–" if reader == BARE else micros(median(beyond)))
        if reader.startswith("PEERNet"):
            token_s = median(beyond)
            promise = f"streaming, {reader.removeprefix('PEERNet, ')}: ≤ {TOKEN_AIM_S * 1e6:g} µs per token"
            section.aim(promise, f"{micros(token_s)} µs", token_s <= TOKEN_AIM_S)
    section.table(table)
    section.say(f"Median number of parts per answer that arrived at the edge: {median(parts):,.0f}.")


def _paced(section: Section, bench: Bench, repeats: int) -> None:
    readers = (BARE, *READERS[2:])
    delays: dict[str, list[AnswerDelays]] = {reader: [] for reader in readers}
    _in_turn(
        "paced", repeats, readers, lambda reader: delays[reader].append(_delays(bench, bench.read("paced", reader)))
    )
    section.say(
        f"The same server sends {PACED} tokens, one each {INTERVAL_MS:g} ms; {repeats} repeats of "
        f"{bench.counts['paced']} answers, in turn. *First token*: from the request to the first token at the reader "
        "(with the cloud: `first-part`), minus the server's own time from the request to that token. *End*: from the "
        "server's stamp before it writes the last token to the end of the answer at the reader. All programs read the "
        "clock of one machine."
    )
    table = Table("delay, µs", "first token p50", "p99", "end p50", "p99")
    for reader, repeated in delays.items():
        spreads = [median_spread([spread(getattr(one, key)) for one in repeated]) for key in ("first", "end")]
        table.row(reader, *(micros(one[key]) for one in spreads for key in ("p50", "p99")))
    section.table(table)


def _delays(bench: Bench, answers: list[Answer]) -> AnswerDelays:
    stamps, delays = bench.stamps("paced"), AnswerDelays()
    for answer in answers:
        own = [one for one in stamps if answer.at <= one.received <= answer.at + answer.total]
        if len(own) != 1:
            raise Failure(
                f"the server received {len(own)} requests during the answer that began at {answer.at}; expected 1"
            )
        delays.first.append(answer.first - (own[0].first - own[0].received))
        delays.end.append(answer.at + answer.total - own[0].last)
    return delays


def _whole(section: Section, bench: Bench, repeats: int, ports: list[int]) -> None:
    count, baseline = bench.counts["whole"], _baseline()
    # For each name and repeat: spreads of the total, and of the total without inference.
    repeats_by_name: dict[str, list[dict[str, dict[str, float]]]] = {}
    echo_port, old_port = ports
    # Port of the cloud, and build of `peernet` that sends the requests.
    targets = {"not streamed": (echo_port, PEERNET), "one part": (bench.cloud_port, PEERNET)}
    if baseline:
        targets["baseline"] = (old_port, baseline / "peernet")

    def add(name: str) -> None:
        model = "whole" if name == "one part" else "echo"
        port, program = targets[name]
        text = _experiment(model, count, port, "")
        (run,) = run_experiment(bench.folder, f"{name.replace(' ', '-')}-cloud", text, program=program)
        total, inference = run.samples("total"), run.samples("inference")
        without = [a - b for a, b in zip(total, inference, strict=True)]
        spreads = {"total": spread(total), "without inference": spread(without)}
        repeats_by_name.setdefault(name, []).append(spreads)

    for repeat in range(repeats):
        # A process may stay on a faster or on a slower core, which changes the time of a request by
        # up to 40 %. These clouds are new processes in each repeat, so that the medians do not
        # depend on one core.
        with ExitStack() as clouds:
            clouds.enter_context(cloud(bench.folder, echo_port, _echo()))
            if baseline:
                clouds.enter_context(cloud(bench.folder, old_port, _echo(), program=baseline / "peernetd"))
            first, names = repeat % len(targets), list(targets)
            _in_turn(f"not streamed, processes {repeat + 1}", 1, [*names[first:], *names[:first]], add)
    section.say(
        f"An answer of {WHOLE_BYTES:,} bytes through the cloud: *not streamed*, by the model `echo`; in *one part*, by "
        "the server above in one token. The `total` of *one part* includes the request to the server; its *total without "
        f"inference* does not. {repeats} repeats of {count:,} answers, in turn."
        + (f" *Baseline*: not streamed, by the build that `{BASELINE}` names." if baseline else "")
    )
    table = Table("µs", "total p50", "p99", "total without inference p50", "p99")
    for name in targets:
        spreads = [
            median_spread([one[key] for one in repeats_by_name[name]]) for key in ("total", "without inference")
        ]
        table.row(name, *(micros(one[key]) for one in spreads for key in ("p50", "p99")))
    section.table(table)
    if baseline:
        ours, old = (
            [one["total"]["p50"] for one in repeats_by_name[name]] for name in ("not streamed", "baseline")
        )
        cost = ratio(ours, old)
        promise = f"a request that is not streamed ≤ {BASELINE_AIM:g} × the older build's"
        section.aim(promise, times(cost), cost <= BASELINE_AIM)


def _in_turn(what: str, repeats: int, names: tuple[str, ...] | list[str], measure_one: Callable[[str], None]) -> None:
    """Measures each name once in each repeat. A different name goes first in each repeat."""
    for repeat in range(repeats):
        first = repeat % len(names)
        for name in (*names[first:], *names[:first]):
            measure_one(name)
        print(f"  {what}: repeat {repeat + 1} of {repeats}", file=sys.stderr, flush=True)


def _experiment(model: str, iterations: int, port: int | None, models: str) -> str:
    """Returns an experiment that requests answers of a model.

    The model is one of the cloud on `port`; if `port` is `None`, a local one, which the tables `models` describe.
    """
    remote = f'{{ kind = "remote", peer = "tcp://127.0.0.1:{port}", model = "{model}" }}'
    placement = f'{{ kind = "local", model = "{model}" }}' if port is None else remote
    return f"""
[experiment]
iterations = {iterations}
warm_up = {{ iterations = {max(1, iterations // 10)} }}
[pipeline]
sensor = {{ kind = "text", length = 100 }}
placement = {placement}
load = {{ mode = "closed" }}
{models if port is None else ""}
"""


def _openai(port: int, model: str) -> str:
    return f'[[model]]\nname = "{model}"\nkind = "openai"\nurl = "http://127.0.0.1:{port}/v1"\nmodel = "{model}"\n'


def _echo() -> str:
    return f'[[model]]\nname = "echo"\nkind = "echo"\nanswer_bytes = {WHOLE_BYTES}\n'


def _baseline() -> Path | None:
    return Path(os.environ[BASELINE]) if os.environ.get(BASELINE) else None
