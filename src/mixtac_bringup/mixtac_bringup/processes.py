# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Node processes: started together, watched, ended by their own pid."""

from __future__ import annotations

import signal
import subprocess
import time
from typing import TYPE_CHECKING

from mixtac_bringup.errors import GraphError

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

STOP_GRACE_S = 8.0


class ProcessGroup:
    """The processes of a graph.

    Args:
        log_dir: Folder for one log file per process, or None to let them write to the terminal.
        env: Environment of the processes; None for this process's own.
    """

    def __init__(self, log_dir: Path | None = None, env: dict[str, str] | None = None) -> None:
        self._log_dir = log_dir
        self._env = env
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> ProcessGroup:
        """Return the group."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End all processes."""
        self.stop()

    def start(self, name: str, command: list[str]) -> None:
        """Start a process under a name.

        In a session of its own, so that a Ctrl-C in the terminal reaches this process first and
        the nodes are ended in order.
        """
        if self._log_dir is None:
            self._processes[name] = subprocess.Popen(
                command, env=self._env, stdin=subprocess.DEVNULL, start_new_session=True
            )
            return
        self._log_dir.mkdir(parents=True, exist_ok=True)
        with (self._log_dir / f'{name}.log').open('wb') as log:
            self._processes[name] = subprocess.Popen(
                command,
                env=self._env,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def check(self) -> None:
        """Raise if a process has ended.

        Raises:
            GraphError: Names the process and its last words.
        """
        for name, process in self._processes.items():
            code = process.poll()
            if code is not None:
                raise GraphError(self._obituary(name, code))

    def stop(self, name: str | None = None) -> dict[str, int]:
        """End one process or all, newest first: SIGINT, then SIGKILL after a grace time.

        Returns:
            Exit status by name.
        """
        names = [name] if name is not None else list(reversed(self._processes))
        for each in names:
            if self._processes[each].poll() is None:
                self._processes[each].send_signal(signal.SIGINT)
        codes = {}
        deadline = time.monotonic() + STOP_GRACE_S
        for each in names:
            codes[each] = _wait(self._processes.pop(each), deadline)
        return codes

    def last_line(self, name: str) -> str:
        """Return the last error line that a process logged, or an empty string."""
        if self._log_dir is None:
            return ''
        text = (self._log_dir / f'{name}.log').read_text(errors='replace')
        lines = [line for line in text.splitlines() if line.strip()]
        errors = [line for line in lines if 'error' in line.lower()]
        return (errors or lines or [''])[-1].strip()

    def _obituary(self, name: str, code: int) -> str:
        said = self.last_line(name).removeprefix('error: ')
        return f'{name} ended with status {code}' + (f': {said}' if said else '')


def _wait(process: subprocess.Popen[bytes], deadline: float) -> int:
    try:
        return process.wait(max(0.1, deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()
