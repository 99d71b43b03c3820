# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Results of long measurements that are kept, so that a stopped one goes on where it was."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


class Kept:
    """Results by their keys, one JSON line each.

    A key names what was measured and with which settings, not the version of the code: begin a new
    file after a change of the code.

    Args:
        path: The file; None keeps nothing.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._known: dict[str, Any] = {}
        if path is not None and path.exists():
            for line in path.read_text(encoding='utf-8').splitlines():
                entry = json.loads(line)
                self._known[entry['key']] = entry['value']

    def get(self, key: str, measure: Callable[[], Any]) -> Any:  # noqa: ANN401
        """Return the kept result of a key, or measure and keep it.

        Args:
            key: Names the measurement.
            measure: Returns what JSON can hold; not a number is kept as such.
        """
        if key not in self._known:
            self._known[key] = measure()
            if self._path is not None:
                line = json.dumps({'key': key, 'value': self._known[key]})
                with self._path.open('a', encoding='utf-8') as file:
                    file.write(line + '\n')
        return self._known[key]


def digest(*parts: object) -> str:
    """Return a short name of settings: equal settings have equal names."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:12]
