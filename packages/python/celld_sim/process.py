"""celld-sim as a child process: start, ready line, log, end.

In: the command line. Out: the ready line as a dictionary, or a SimulatorError with what the program wrote.
Its standard input is a pipe from this process, so that it ends when this one does, however that happens.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import tempfile
import time
from typing import Any, Dict, List, Optional

from celld_sim.errors import SimulatorError

GRACE_S = 5.0
"""Longest time between the order to end and the end, s; then it is killed."""


class AddressTaken(SimulatorError):
    """Another program has one of the ports."""


class Process:
    """One running simulator."""

    def __init__(self, command: List[str], start_timeout: float) -> None:
        self._command = command
        self._log = tempfile.TemporaryFile()
        try:
            # From the root folder: it would take a file config/sim.yaml where it runs for its own.
            # In a session of its own: Ctrl-C at the terminal is meant for the caller. Its end is that of the pipe.
            self._child = subprocess.Popen(
                command,
                cwd="/",
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._log,
                start_new_session=True,
            )
        except OSError as error:
            self._log.close()
            raise SimulatorError(f"{command[0]} cannot be run: {error.strerror}") from error
        try:
            self.ready = self._ready(start_timeout)
        except BaseException:
            self.stop()
            raise

    @property
    def pid(self) -> int:
        """Number of the process."""
        return self._child.pid

    def running(self) -> bool:
        """Whether it has not ended."""
        return self._child.poll() is None

    def log(self) -> str:
        """What it has written to standard error so far."""
        # Not by moving the position of the file: it is the child's too.
        size = os.fstat(self._log.fileno()).st_size
        return os.pread(self._log.fileno(), size, 0).decode(errors="replace")

    def stop(self) -> str:
        """Ends it; returns the whole log."""
        if self._child.poll() is None:
            self._child.terminate()
            try:
                self._child.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                self._child.kill()
                self._child.wait()
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                pipe.close()
        log = self.log()
        self._log.close()
        return log

    def _ready(self, timeout: float) -> Dict[str, Any]:
        line = self._first_line(timeout)
        if line is None:
            code = self._child.wait()
            words = self.log().strip() or "it wrote nothing"
            kind = AddressTaken if "in use" in words else SimulatorError
            raise kind(f"celld-sim ended with {code}: {words}\n(command: {' '.join(self._command)})")
        try:
            ready = json.loads(line)
        except ValueError:
            ready = None
        if not isinstance(ready, dict) or ready.get("ready") is not True:
            raise SimulatorError(f"{self._command[0]} wrote no ready line: {line!r}")
        return ready

    def _first_line(self, timeout: float) -> Optional[bytes]:
        """The first line of standard output; None when the program ended before."""
        assert self._child.stdout is not None
        stream, line, deadline = self._child.stdout.fileno(), b"", time.monotonic() + timeout
        while not line.endswith(b"\n"):
            left = deadline - time.monotonic()
            if left <= 0 or not select.select([stream], [], [], left)[0]:
                words = self.log().strip() or "it wrote nothing"
                raise SimulatorError(f"celld-sim was not ready within {timeout} s: {words}")
            # Nothing follows the ready line, so no more than the line is read.
            part = os.read(stream, 65536)
            if not part:
                return None
            line += part
        return line
