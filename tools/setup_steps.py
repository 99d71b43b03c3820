# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Steps of the set-up: each runs when its inputs changed, and its failure is one clear message."""

from __future__ import annotations

import hashlib
import importlib
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent


def project_file() -> dict[str, Any]:
    """Return the content of pyproject.toml; before Python 3.11 by the parser that pip brings."""
    try:
        tomllib = importlib.import_module('tomllib')
    except ImportError:
        tomllib = importlib.import_module('pip._vendor.tomli')
    content: dict[str, Any] = tomllib.loads((ROOT / 'pyproject.toml').read_text())
    return content


NO_SPACE = 'no space is left: free some on the disk, or set TMPDIR to a folder with more'


class SetupError(Exception):
    """A step that cannot be done here; the text says why and what to do."""


def say(text: str) -> None:
    """Print one progress line."""
    print(f'[setup] {text}', file=sys.stderr, flush=True)


class Steps:
    """Runs named steps whose inputs changed, remembering what succeeded.

    Args:
        record: JSON file with the fingerprint of each finished step.
    """

    def __init__(self, record: Path) -> None:
        self._record = record
        try:
            self._done = json.loads(record.read_text())
        except (OSError, ValueError):
            self._done = {}

    def is_done(self, name: str, fingerprint: str) -> bool:
        """Return whether a step succeeded with these inputs."""
        return bool(self._done.get(name) == fingerprint)

    def forget(self, name: str) -> None:
        """Forget a step that is about to run again: should it fail, it is due the next time."""
        if self._done.pop(name, None) is not None:
            self._write()

    def finish(self, name: str, fingerprint: str) -> None:
        """Remember that a step succeeded."""
        self._done[name] = fingerprint
        self._write()

    def _write(self) -> None:
        self._record.parent.mkdir(parents=True, exist_ok=True)
        partial = self._record.with_suffix('.partial')
        partial.write_text(json.dumps(self._done, indent=1))
        partial.replace(self._record)


def fingerprint(files: list[Path], *extra: str) -> str:
    """Return a hash over the contents and names of files and some strings."""
    digest = hashlib.sha256('\n'.join(extra).encode())
    for path in sorted(files):
        digest.update(str(path.relative_to(ROOT)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def call(command: list[str], failure: str, env: dict[str, str] | None = None) -> None:
    """Run a command, its output to the log file that the error names.

    Raises:
        SetupError: It failed; with the last lines of its output.
    """
    log = ROOT / 'log' / 'setup.log'
    log.parent.mkdir(exist_ok=True)
    with log.open('a') as stream:
        stream.write(f'\n$ {" ".join(command)}\n')
        stream.flush()
        result = subprocess.run(
            command, cwd=ROOT, env=env, stdout=stream, stderr=subprocess.STDOUT, check=False
        )
    if result.returncode:
        tail = '\n'.join(log.read_text(errors='replace').splitlines()[-15:])
        if 'No space left on device' in tail:
            failure = NO_SPACE
        raise SetupError(f'{failure}\n{tail}\n(the whole output is in {log.relative_to(ROOT)})')
