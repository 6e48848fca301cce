"""Runs programs for the interoperability checks and reads their output."""
import queue
import socket
import subprocess
import threading
import time

# Time limit of each wait. Seconds.
TIMEOUT_S = 60


class Process:
    """A program whose output is read line by line, and which ends with the check."""

    def __init__(self, *command, environment=None):
        self.command = [str(part) for part in command]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            self.command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=environment
        )
        self.lines = queue.Queue()
        self.errors = []
        threading.Thread(target=self._read, args=(self.process.stdout, self.lines.put), daemon=True).start()
        threading.Thread(target=self._read, args=(self.process.stderr, self.errors.append), daemon=True).start()

    @staticmethod
    def _read(stream, take):
        for line in stream:
            take(line.rstrip("\n"))
        # None marks the end of the output.
        take(None)

    def line(self):
        """Returns the next line."""
        try:
            line = self.lines.get(timeout=TIMEOUT_S)
        except queue.Empty:
            line = None
        assert line is not None, f"{self.command} printed no further line; its errors: {self.errors}"
        return line

    def wait_for(self, part):
        """Returns the next line that contains a text."""
        while True:
            line = self.line()
            if part in line:
                return line

    def newest(self, part):
        """Returns the newest line that contains a text, if there is one since the last call.

        Discards all other lines.
        """
        lines = [self.lines.get() for _ in range(self.lines.qsize())]
        return next((line for line in reversed(lines) if line and part in line), None)

    def has_error(self, part):
        """Returns whether a line of its standard error contains a text."""
        return any(part in line for line in list(self.errors) if line)

    def finish(self):
        """Closes the standard input of the program, and waits until it exits with status 0."""
        self.process.stdin.close()
        status = self.process.wait(timeout=TIMEOUT_S)
        assert status == 0, f"{self.command} ended with {status}; its errors: {self.errors}"

    def stop(self):
        """Terminates a daemon, and waits until it exits with status 0."""
        self.process.terminate()
        status = self.process.wait(timeout=TIMEOUT_S)
        assert status == 0, f"{self.command} ended with {status}; its errors: {self.errors}"

    def kill(self):
        self.process.kill()
        self.process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.kill()


def wait_until(condition, what, timeout=TIMEOUT_S):
    """Waits until a condition holds, and returns the seconds. `what` is its description, or a function that returns it."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < timeout, f"not within {timeout} s: {what() if callable(what) else what}"
        time.sleep(0.02)
    return time.monotonic() - start


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]
