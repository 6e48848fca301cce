"""Programs that the checks with foreign peers start and read."""
import queue
import socket
import subprocess
import threading
import time

# Longest time in seconds that anything may take.
PATIENCE = 60


class Process:
    """A program whose lines are read one by one, and which ends with the check."""

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
        take(None)

    def line(self):
        """Returns the next line."""
        try:
            line = self.lines.get(timeout=PATIENCE)
        except queue.Empty:
            line = None
        assert line is not None, f"{self.command} says nothing more; its errors: {self.errors}"
        return line

    def wait_for(self, part):
        """Returns the next line that contains a text."""
        while True:
            line = self.line()
            if part in line:
                return line

    def newest(self, part):
        """Returns the newest line that contains a text, if there is one since the last call."""
        lines = [self.lines.get() for _ in range(self.lines.qsize())]
        return next((line for line in reversed(lines) if line and part in line), None)

    def has_error(self, part):
        """Returns whether a line of its errors contains a text."""
        return any(part in line for line in list(self.errors) if line)

    def finish(self):
        """Ends the program's input, and waits for its success."""
        self.process.stdin.close()
        status = self.process.wait(timeout=PATIENCE)
        assert status == 0, f"{self.command} ended with {status}; its errors: {self.errors}"

    def stop(self):
        """Asks a daemon to end, and waits for its success."""
        self.process.terminate()
        status = self.process.wait(timeout=PATIENCE)
        assert status == 0, f"{self.command} ended with {status}; its errors: {self.errors}"

    def kill(self):
        self.process.kill()
        self.process.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.kill()


def wait_until(condition, what, patience=PATIENCE):
    """Returns the seconds until a condition holds; `what` describes it, or is a function that does."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < patience, f"not within {patience} s: {what() if callable(what) else what}"
        time.sleep(0.02)
    return time.monotonic() - start


def free_port():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]
