"""Daemons for one measurement: their configurations, their folder, their start in the order in which nothing waits."""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import store
from namespaces import Host
from programs import PEERNETD, ROOT, Program

LOOPBACK = Host("", "127.0.0.1")


class Plant:
    """A folder with daemons."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.database = folder / "peernet.sqlite"
        self._running: list[Program] = []

    def daemon(
        self, name: str, configuration: str, host: Host = LOOPBACK, environment: Mapping[str, str] | None = None
    ) -> Program:
        """Starts `peernetd run` and waits until it says that it is ready."""
        path = self.folder / f"{name}.toml"
        path.write_text(configuration)
        command = [PEERNETD, "run", path]
        with _ready_socket(self.folder / f"{name}.ready") as ready:
            program = Program(
                host.inside(command) if host.name else command,
                self.folder / f"{name}.log",
                folder=self.folder,
                environment={
                    "NOTIFY_SOCKET": str(self.folder / f"{name}.ready"),
                    "ORT_DYLIB_PATH": str(ROOT / "onnxruntime/lib/libonnxruntime.so"),
                    "RUST_BACKTRACE": "1",
                    **(environment or {}),
                },
            )
            self._running.append(program)
            program.wait_until(f"{name} is ready", lambda: _said_ready(ready))
        return program

    def aggregator(self, host: Host = LOOPBACK, *, events: int = 5550, web: int = 8040) -> Program:
        """An aggregator with its database in this plant's folder."""
        text = f"""
            [aggregator]
            name = "aggregator"
            listen = "tcp://{host.address}:{events}"
            database = "{self.database}"
            [web]
            listen = "127.0.0.1:{web}"
        """
        return self.daemon("aggregator", text, host)

    def is_stored(self, pipeline: str) -> bool:
        """Whether a run of this pipeline has come to its end in the database."""
        run = store.run_of(self.database, pipeline)
        return run is not None and run.ended

    def link(self, name: str) -> None:
        """Makes a folder of the checkout visible under the same relative path, for configurations that name it."""
        (self.folder / name).symlink_to(ROOT / name)

    def stop(self) -> None:
        """Ends the daemons, the last first: what they hold goes to those that were there before."""
        while self._running:
            self._running.pop().stop()


@contextmanager
def plant() -> Iterator[Plant]:
    """An empty plant; its daemons end with it and its folder goes."""
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        it = Plant(Path(folder))
        try:
            yield it
        finally:
            it.stop()


def free_ports(count: int) -> list[int]:
    """Ports of loopback nobody listens on at the moment."""
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [one.getsockname()[1] for one in sockets]
    finally:
        for one in sockets:
            one.close()


@contextmanager
def _ready_socket(path: Path) -> Iterator[socket.socket]:
    """Where a daemon tells its service manager that it is ready."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ready:
        # A daemon of the same name may have been there before.
        path.unlink(missing_ok=True)
        ready.bind(str(path))
        ready.setblocking(False)
        yield ready


def _said_ready(ready: socket.socket) -> bool:
    try:
        while True:
            if b"READY=1" in ready.recv(4096):
                return True
    except BlockingIOError:
        return False
