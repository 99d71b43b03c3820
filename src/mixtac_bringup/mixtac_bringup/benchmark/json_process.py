# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""A child process that talks in lines of JSON, with its CPU time."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import threading
import time
from typing import TYPE_CHECKING, Any

import psutil

from mixtac_bringup.errors import GraphError
from mixtac_bringup.processes import ending_with_parent

if TYPE_CHECKING:
    from types import TracebackType

STOP_TIMEOUT_S = 10.0
POLL_S = 0.1


class JsonProcess:
    """Starts a process; ends it by its pid, or with its parent.

    Args:
        name: What it is, for messages.
        command: Command line.
        env: Environment.
    """

    def __init__(self, name: str, command: list[str], env: dict[str, str]) -> None:
        self._name = name
        self._process = subprocess.Popen(
            ending_with_parent(command),
            env=env,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._lines: queue.Queue[dict[str, Any]] = queue.Queue()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> JsonProcess:
        """Return the process."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End it if it still runs."""
        self.stop()

    def send(self, **values: object) -> None:
        """Send one line."""
        assert self._process.stdin is not None  # noqa: S101  (always piped)
        self._process.stdin.write(json.dumps(values) + '\n')
        self._process.stdin.flush()

    def expect(self, key: str, timeout_s: float) -> dict[str, Any]:
        """Return the next line that has a key.

        Raises:
            GraphError: None came in time.
        """
        deadline_s = time.monotonic() + timeout_s
        while time.monotonic() < deadline_s:
            ended = not self._thread.is_alive()
            with contextlib.suppress(queue.Empty):
                line = self._lines.get(timeout=POLL_S)
                if key in line:
                    return line
                continue
            if ended:
                break
        code = self._process.poll()
        state = 'still runs' if code is None else f'ended with status {code}'
        raise GraphError(f'{self._name} said nothing of {key!r} within {timeout_s:g} s; it {state}')

    def latest(self, key: str, line: dict[str, Any]) -> dict[str, Any]:
        """Return the newest line with a key among those said so far, or the one given."""
        with contextlib.suppress(queue.Empty):
            while True:
                said = self._lines.get_nowait()
                line = said if key in said else line
        return line

    def cpu_s(self) -> float:
        """Return the CPU time it used so far [s]."""
        times = psutil.Process(self._process.pid).cpu_times()
        return float(times.user + times.system)

    def stop(self) -> None:
        """End it: SIGTERM, then SIGKILL after a grace time. What it said can still be read."""
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._thread.join(1.0)

    def _read(self) -> None:
        assert self._process.stdout is not None  # noqa: S101  (always piped)
        for line in self._process.stdout:
            with contextlib.suppress(ValueError):
                self._lines.put(json.loads(line))
