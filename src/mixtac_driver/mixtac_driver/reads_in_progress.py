# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Counts the reads that are under way, so that nobody closes a handle below them."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from types import TracebackType


class ReadsInProgress:
    """A context manager for every read, from any thread."""

    def __init__(self) -> None:
        self._count = 0
        self._ended = threading.Condition()

    def __enter__(self) -> None:
        """Note that a read begins."""
        with self._ended:
            self._count += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Note that it ended."""
        with self._ended:
            self._count -= 1
            self._ended.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait until there are none.

        Args:
            seconds: Longest time to wait [s].

        Returns:
            Whether there are none.
        """
        with self._ended:
            return self._ended.wait_for(lambda: not self._count, seconds)
