# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Reading what the operating system shows of itself in files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class HostFiles:
    """The files of the operating system.

    Attributes:
        root: What stands for the root folder; another one only in tests.
    """

    root: Path = Path('/')

    def path(self, absolute: str) -> Path:
        """Return where a path like `/sys/bus` is found."""
        return self.root / absolute.lstrip('/')

    def text(self, absolute: str) -> str | None:
        """Return the text of a file without blanks around it, or None where it cannot be read."""
        return read_text(self.path(absolute))

    def number(self, absolute: str) -> int | None:
        """Return the number in a file, or None where there is none."""
        text = self.text(absolute)
        return int(text) if text is not None and text.lstrip('-').isdigit() else None

    def may_use(self, absolute: str) -> bool:
        """Return whether this process may read and write a file."""
        return os.access(self.path(absolute), os.R_OK | os.W_OK)


def read_text(path: Path) -> str | None:
    """Return the text of a file without blanks around it, or None where it cannot be read."""
    try:
        return path.read_text(errors='replace').strip()
    except OSError:
        return None
