# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The process that serves the page of the live view: on this machine only, without telemetry."""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import tempfile
import time
from pathlib import Path
from urllib.parse import quote

from mixtac_events.errors import MixtacError
from mixtac_node.process import GraphError, ProcessGroup


class ViewError(MixtacError):
    """A live view that cannot be served or written."""


HOST = '127.0.0.1'
_START_S = 20.0


def require_rerun() -> Path:
    """Return the path of rerun's program.

    Raises:
        ViewError: The optional package rerun-sdk is not installed.
    """
    spec = importlib.util.find_spec('rerun_cli')
    if spec is None or spec.origin is None:
        raise ViewError(
            'the live view needs rerun-sdk (about 500 MB)', remedy='install it with `make view`'
        )
    # The script of that name would start this program as a child and not end it.
    return Path(spec.origin).parent / 'rerun'


class ViewerServer:
    """Serves the page and its data until `close`.

    Args:
        port: Port of the page; 0 for any free one.
        data_port: Port of its data; 0 for any free one.
        memory_mb: Data kept for pages opened later [MB].

    Attributes:
        data_url: Address to send the data to.
        page_url: Address to open in a browser.

    Raises:
        ViewError: rerun-sdk is missing, a port is taken, or the server does not start.
    """

    def __init__(self, port: int, data_port: int, memory_mb: int) -> None:
        program = require_rerun()
        self._home = tempfile.TemporaryDirectory(prefix='mixtac-view-')
        port, data_port = free_port(port, 'port'), free_port(data_port, 'data_port')
        self.data_url = f'rerun+http://{HOST}:{data_port}/proxy'
        self.page_url = f'http://{HOST}:{port}/?url={quote(self.data_url, safe="")}'
        environment = _private_environment(Path(self._home.name))
        subprocess.run(
            [program, 'analytics', 'disable'], env=environment, capture_output=True, check=False
        )
        self._processes = ProcessGroup(Path(self._home.name), environment)
        self._processes.start('server', _command(program, port, data_port, memory_mb))
        try:
            self._wait_for(port)
            self._wait_for(data_port)
        except ViewError:
            self.close()
            raise

    def check(self) -> None:
        """Raise a ViewError if the server has ended by itself."""
        try:
            self._processes.check()
        except GraphError as error:
            raise ViewError(f'live view: {error}; {self._last_line()}') from error

    def close(self) -> None:
        """End the server and remove its files."""
        self._processes.stop()
        self._home.cleanup()

    def _wait_for(self, port: int) -> None:
        deadline = time.monotonic() + _START_S
        while True:
            self.check()
            try:
                socket.create_connection((HOST, port), timeout=1.0).close()
            except OSError as error:
                if time.monotonic() > deadline:
                    raise ViewError(
                        f'the server of the live view does not answer on port {port} after '
                        f'{_START_S:.0f} s: {self._last_line()}'
                    ) from error
                time.sleep(0.05)
            else:
                return

    def _last_line(self) -> str:
        log = Path(self._home.name) / 'server.log'
        lines = log.read_text(errors='replace').strip().splitlines()
        return lines[-1] if lines else 'no output'


def free_port(port: int, name: str) -> int:
    """Return a free TCP port of this machine.

    Args:
        port: Wanted port, 0 for any.
        name: Name of its parameter.

    Raises:
        ViewError: It is in use.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((HOST, port))
        except OSError as error:
            raise ViewError(
                f'{name} {port} cannot be used ({error.strerror})',
                remedy='stop the other view, or choose another port or 0 for any',
            ) from error
        return int(trial.getsockname()[1])


def _command(program: Path, port: int, data_port: int, memory_mb: int) -> list[str]:
    command = [str(program), '--serve-web', '--bind', HOST, '--port', str(data_port)]
    command += ['--web-viewer-port', str(port)]
    return [*command, '--server-memory-limit', f'{memory_mb}MB']


def _private_environment(home: Path) -> dict[str, str]:
    """Return an environment with private rerun settings and usage data off."""
    folders = {'XDG_CONFIG_HOME': str(home / 'config'), 'XDG_DATA_HOME': str(home / 'data')}
    return {**os.environ, **folders, 'TELEMETRY_ENABLED': 'false', 'RERUN_APP_ONLY': 'true'}
