#!/usr/bin/env python3
"""Runs the tests of the whole workspace and lists the slowest.

    run.py [--lint] [FILTER]…

All packages are built by one command, because cargo rebuilds dependencies for another selection of packages. The test
programs of the crates run first, concurrently. The end-to-end tests follow, because they need the machine for themselves,
and then the examples in the documentation. End-to-end tests mostly wait, so twice as many as there are cores run
concurrently. Tests that flood a host use all processor time and run last. `--lint` runs the lints meanwhile with idle
priority. FILTER: names of tests, as for `cargo test`.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CARGO = os.environ.get("CARGO", "cargo")
# Number of slowest tests that are listed.
SLOWEST = 10
# Package of the end-to-end tests.
END_TO_END = "peernet-tests"
# Beginning of the names of the tests that flood a host.
FLOODS = "limits::"
# Line of the test harness with a test's name, result and time.
RESULT = re.compile(r"^test (.+) \.\.\. (\w+) <([0-9.]+)s>$")
# Line of the test harness with the number of the examples of a package.
EXAMPLES = re.compile(r"^running ([0-9]+) tests?$", re.MULTILINE)


@dataclass(frozen=True)
class Program:
    """A test program and the folder in which cargo would run it."""

    package: str
    name: str
    path: str
    folder: Path


@dataclass(frozen=True)
class ProgramResult:
    """The result of a test program."""

    program: Program
    code: int
    seconds: float
    output: str

    def tests(self) -> list[tuple[float, str]]:
        """Returns seconds and names of its tests."""
        found = (RESULT.match(line) for line in self.output.splitlines())
        return [(float(match[3]), f"{self.program.package} {match[1]}") for match in found if match]

    def report(self) -> None:
        """Prints the result, with the whole output if it failed."""
        if self.code:
            print(self.output)
        print(f"{self.program.package} {self.program.name}: {len(self.tests())} tests in {self.seconds:.1f} s", flush=True)


def build() -> list[Program]:
    """Builds all test programs."""
    command = [CARGO, "test", "--workspace", "--locked", "--no-run", "--message-format=json-render-diagnostics"]
    output = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    programs = []
    for line in output.splitlines():
        message = json.loads(line)
        if message["reason"] == "compiler-artifact" and message["profile"]["test"] and message["executable"]:
            folder = Path(message["manifest_path"]).parent
            programs.append(Program(package_in(folder), message["target"]["name"], message["executable"], folder))
    return programs


def package_in(folder: Path) -> str:
    """Returns the name of the package in a folder."""
    with (folder / "Cargo.toml").open("rb") as manifest:
        return tomllib.load(manifest)["package"]["name"]


def run(program: Program, threads: int, filters: list[str], *, prints_tests: bool = False) -> ProgramResult:
    """Runs a test program. With `prints_tests`, prints the result of each test immediately.

    The times of tests are an unstable feature of the test harness, which RUSTC_BOOTSTRAP enables.
    """
    command = [program.path, "-Zunstable-options", "--report-time", "--test-threads", str(threads), *filters]
    begin = time.monotonic()
    lines = []
    with subprocess.Popen(
        command,
        cwd=program.folder,
        # ONNX Runtime would keep an identifier in the user's home and send events; the programs switch that off themselves.
        env={**os.environ, "RUSTC_BOOTSTRAP": "1", "ORT_DISABLE_TELEMETRY": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    ) as process:
        for line in process.stdout or ():
            lines.append(line)
            if prints_tests and RESULT.match(line):
                print(f"  {line}", end="", flush=True)
    return ProgramResult(program, process.returncode, time.monotonic() - begin, "".join(lines))


def flooding_tests(program: Program, filters: list[str]) -> list[str]:
    """Returns the names of the selected tests that flood a host."""
    command = [program.path, "--list", "--format", "terse", *filters]
    listed = subprocess.run(command, cwd=program.folder, stdout=subprocess.PIPE, text=True, check=True).stdout
    names = (line.removesuffix(": test") for line in listed.splitlines() if line.endswith(": test"))
    # The same comparison as that of `--skip`, so that each test runs once.
    return [name for name in names if FLOODS in name]


@contextmanager
def linting() -> Iterator[subprocess.Popen[str]]:
    """Runs the lints with idle priority, and prints their output at the end if they failed."""
    command = ["chrt", "--idle", "0", CARGO, "clippy", "--workspace", "--all-targets", "--locked", "--", "--deny", "warnings"]
    with tempfile.TemporaryFile("w+") as log:
        with subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=subprocess.STDOUT, text=True) as process:
            yield process
        if process.returncode:
            log.seek(0)
            print(log.read())


def main() -> int:
    filters, cores = [word for word in sys.argv[1:] if word != "--lint"], os.cpu_count() or 1
    programs = build()
    if "--lint" not in sys.argv[1:]:
        return run_all(programs, cores, filters)
    with linting() as lints:
        status = run_all(programs, cores, filters)
    if lints.returncode:
        print("failed: the lints", file=sys.stderr)
    return status or lints.returncode


def run_all(programs: list[Program], cores: int, filters: list[str]) -> int:
    """Runs all tests and returns the exit status."""
    crates = [program for program in programs if program.package != END_TO_END]
    results = []
    with ThreadPoolExecutor(cores) as pool:
        for result in pool.map(lambda program: run(program, cores, filters), crates):
            result.report()
            results.append(result)
    for program in programs:
        if program.package == END_TO_END:
            results.append(run(program, 2 * cores, ["--skip", FLOODS, *filters], prints_tests=True))
            results[-1].report()
            if floods := flooding_tests(program, filters):
                results.append(run(program, cores, ["--exact", *floods], prints_tests=True))
                results[-1].report()
    failed = [f"{result.program.package} {result.program.name}" for result in results if result.code]
    examples = [CARGO, "test", "--workspace", "--locked", "--doc", "--quiet", "--", *filters]
    ended = subprocess.run(examples, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    if ended.returncode:
        print(ended.stdout)
        failed.append("the examples in the documentation")
    tests = [test for result in results for test in result.tests()]
    if not tests and not any(int(count) for count in EXAMPLES.findall(ended.stdout)):
        failed.append(f"no test was run, the filters are: {' '.join(filters) or 'none'}")
    slowest = sorted(tests, reverse=True)[:SLOWEST]
    print("the slowest:", *(f"  {seconds:6.1f} s  {name}" for seconds, name in slowest), sep="\n")
    if failed:
        print(f"failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
