"""A process that was started for an agent: what it says, how it ends, and that it never outlives its parent."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

LINES = 20
"""How many of the last lines of stderr are kept."""

_REFUSED = re.compile(r"zenoh_link_tls\S*\s+(?P<why>[^.\n]*)")
"""What Zenoh says of somebody whom TLS does not let in."""


@dataclass(frozen=True)
class Exit:
    """How a process ended.

    Parameters
    ----------
    name : str
        Of its agent.
    time : float
        When it was noticed, seconds since the launch.
    code : int
        Its exit code; negative: the signal that ended it.
    wanted : bool
        Whether the launch itself ended it, by a kill that was asked for or at the end.
    stderr : tuple of str
        Its last lines.
    """

    name: str
    time: float
    code: int
    wanted: bool
    stderr: tuple[str, ...]

    @property
    def cause(self) -> str:
        """What the code says, in words."""
        if self.code >= 0:
            return f"exit code {self.code}"
        try:
            return signal.Signals(-self.code).name
        except ValueError:
            return f"signal {-self.code}"


class Child:
    """One process of an agent; it leaves when its standard input closes, so also when its parent dies.

    Parameters
    ----------
    name : str
    arguments : sequence of str
        Of the command ``covey``.
    """

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.name = name
        self.killed = False
        """Whether its parent sent it SIGKILL."""
        self.refused: Counter[str] = Counter()
        """How often somebody was not let in, by what was wrong with the certificate."""
        self._lines: deque[str] = deque(maxlen=LINES)
        self._report = b""
        # A group of its own: Ctrl-C on a terminal reaches the parent alone, which passes it on once.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "covey", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
            env={**os.environ, "NO_COLOR": "1"},
        )
        self._readers = [
            threading.Thread(target=self._read_stderr, daemon=True),
            threading.Thread(target=self._read_stdout, daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    @property
    def code(self) -> int | None:
        """Its exit code; None while it runs."""
        return self._process.poll()

    @property
    def stderr(self) -> tuple[str, ...]:
        """The last lines that it wrote."""
        return tuple(self._lines)

    def report(self) -> dict[str, Any] | None:
        """Return what it reported at its end, if it came to that."""
        for reader in self._readers:
            reader.join(1.0)
        try:
            report = json.loads(self._report)
        except ValueError:
            return None
        return report if isinstance(report, dict) else None

    def send(self, number: int) -> None:
        """Send it a signal, if it still runs."""
        if self.code is None:
            self.killed |= number == signal.SIGKILL
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(number)

    def release(self) -> None:
        """Close its standard input: it may leave."""
        stdin = self._process.stdin
        if stdin is not None:
            with contextlib.suppress(OSError):
                stdin.close()

    def wait(self, timeout: float) -> bool:
        """Wait for its end, seconds at most; whether it has come."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self) -> None:
        """Make sure that it has ended, and let go of its pipes."""
        self.release()
        if self.code is None:
            self._process.kill()
        self._process.wait()
        for reader in self._readers:
            reader.join(1.0)
        for stream in (self._process.stdout, self._process.stderr):
            if stream is not None:
                stream.close()

    def _read_stderr(self) -> None:
        stream = self._process.stderr
        assert stream is not None
        for data in stream:
            line = data.decode("utf-8", "replace").rstrip()
            refused = _REFUSED.search(line)
            if refused is None:
                self._lines.append(line)
            else:
                self.refused[refused["why"]] += 1

    def _read_stdout(self) -> None:
        stream = self._process.stdout
        assert stream is not None
        self._report = stream.read()
