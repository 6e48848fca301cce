"""The daemons of one measurement: their folder, their configurations and their start, receivers before senders."""

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


class Deployment:
    """A folder with daemons."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.database = folder / "peernet.sqlite"
        self._running: list[Program] = []

    def daemon(
        self, name: str, configuration: str, host: Host = LOOPBACK, environment: Mapping[str, str] | None = None
    ) -> Program:
        """Starts `peernetd run` and waits until it reports that it is ready."""
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
            program.wait_until(f"{name} is ready", lambda: _has_reported_ready(ready))
        return program

    def aggregator(self, host: Host = LOOPBACK, *, events: int = 5550, web: int = 8040) -> Program:
        """Starts an aggregator with its database in this deployment's folder."""
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
        """Returns whether the database has a finished run of this pipeline."""
        run = store.run_of(self.database, pipeline)
        return run is not None and run.has_ended

    def link(self, name: str) -> None:
        """Links a folder of the checkout under the same relative path, for configurations that name it."""
        (self.folder / name).symlink_to(ROOT / name)

    def stop(self) -> None:
        """Stops the daemons in reverse order, so that each can still deliver its events to the ones before it."""
        while self._running:
            self._running.pop().stop()


@contextmanager
def deployment() -> Iterator[Deployment]:
    """Yields an empty deployment. Its daemons are stopped and its folder is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="peernet-bench-") as folder:
        daemons = Deployment(Path(folder))
        try:
            yield daemons
        finally:
            daemons.stop()


def free_ports(count: int) -> list[int]:
    """Returns loopback ports on which no program listens at present."""
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
    """Yields the socket on which a daemon reports to its service manager that it is ready."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ready:
        # An earlier daemon of the same name may have left its socket.
        path.unlink(missing_ok=True)
        ready.bind(str(path))
        ready.setblocking(False)
        yield ready


def _has_reported_ready(ready: socket.socket) -> bool:
    try:
        while True:
            if b"READY=1" in ready.recv(4096):
                return True
    except BlockingIOError:
        return False
