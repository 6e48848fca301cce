"""Runs the selected parts, prints their tables, and writes them as Markdown."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import time
from types import FrameType

import machine
import parts
from programs import PEERNETD, ROOT, Failure
from report import Section, aims_table

RESULTS = ROOT / "target/bench/measurements.md"
INTERRUPTIONS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main() -> int:
    parser = argparse.ArgumentParser(prog="run.sh", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"one of {', '.join(parts.ALL)}; default: all")
    parser.add_argument("--quick", action="store_true", help="short runs, whose figures are too noisy to be quoted")
    arguments = parser.parse_args()
    if unknown := set(arguments.parts) - set(parts.ALL):
        parser.error(f"unknown part {', '.join(sorted(unknown))}; known parts are {', '.join(parts.ALL)}")
    for number in INTERRUPTIONS:
        signal.signal(number, _interrupt)
    # The order is fixed: the fastest parts run first, so that failures show early.
    return run([name for name in parts.ALL if name in (arguments.parts or parts.ALL)], arguments.quick)


def run(names: list[str], quick: bool) -> int:
    if not PEERNETD.exists():
        raise Failure(f"{PEERNETD} does not exist; build it with cargo build --release --package peernetd")
    for name in names:
        parts.ALL[name].prepare()
    steal, begin = machine.steal(), time.monotonic()
    head = ["# Measurements", *machine.facts()]
    if quick:
        head.append("**Short runs**: the figures must not be quoted.")
    print("\n\n".join(head), flush=True)
    sections: list[Section] = []
    for name in names:
        print(f"\n… {name}", file=sys.stderr, flush=True)
        section = parts.ALL[name].measure(quick)
        sections.append(section)
        print(f"\n{section.markdown()}", flush=True)
    seconds = time.monotonic() - begin
    stolen = (machine.steal() - steal) / (seconds * (os.cpu_count() or 1))
    tail = [
        "## Aims",
        aims_table(sections),
        f"Taken in {seconds / 60:.1f} min; {stolen:.1%} of the processor time was stolen by other machines.",
    ]
    print("\n" + "\n\n".join(tail))
    RESULTS.parent.mkdir(parents=True, exist_ok=True)
    RESULTS.write_text("\n\n".join([*head, *(section.markdown() for section in sections), *tail]) + "\n")
    print(f"\nThe same as Markdown: {RESULTS.relative_to(ROOT)}")
    return 0


def _interrupt(number: int, frame: FrameType | None) -> None:
    # Further signals are ignored, so that the cleanup is complete.
    for other in INTERRUPTIONS:
        signal.signal(other, signal.SIG_IGN)
    raise KeyboardInterrupt


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failure as failure:
        print(f"bench: {failure}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("bench: interrupted; all programs and files were removed", file=sys.stderr)
        sys.exit(130)
