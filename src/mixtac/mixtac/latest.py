# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The latest value of a stream; its read methods have the names of LeRobot's cameras."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Generic, TypeVar

from mixtac_core.events.errors import MixtacError

T = TypeVar('T')
LONG_MS = 300_000
"""A virtual sensor needs some seconds to its first force, on a busy computer minutes."""
LOOK_S = 0.1
"""Longest time until a waiting reader notices that the source has ended [s]."""


class SensorError(MixtacError):
    """A sensor that cannot be read."""


class NotOpenError(SensorError):
    """A sensor that was not opened, or is closed."""


class NoReadingError(SensorError):
    """There was no reading yet."""


class ReadTimeoutError(SensorError, TimeoutError):
    """No new reading came in time."""


class StaleReadingError(SensorError, TimeoutError):
    """The latest reading is too old."""


class Latest(Generic[T]):
    """Keeps the latest value; one thread writes it, any number of threads read it.

    Args:
        what: Name of a value, for messages.
        check: Raises an error if no further value can arrive.
        reason: Returns why there is no value at the moment; empty if unknown.
    """

    def __init__(self, what: str, check: Callable[[], None], reason: Callable[[], str]) -> None:
        self._what, self._check, self._reason = what, check, reason
        self._changed = threading.Condition()
        self._value: T | None = None
        self._count = self._taken = 0
        self._at_s = 0.0

    def clear(self) -> None:
        """Forget the value: another session begins."""
        with self._changed:
            self._value, self._taken = None, self._count

    def put(self, value: T) -> None:
        """Replace the value and wake those who wait."""
        with self._changed:
            self._value = value
            self._count += 1
            self._at_s = time.monotonic()
            self._changed.notify_all()

    def read(self, timeout_ms: float = LONG_MS) -> T:
        """Wait for a value that is newer than this call, and return it.

        Args:
            timeout_ms: Longest time to wait [ms].

        Raises:
            NotOpenError: The sensor is closed.
            ReadTimeoutError: No value arrived in time.
            MixtacError: The source has ended or failed.
        """
        return self._newer_than(self._count, timeout_ms)

    def async_read(self, timeout_ms: float = 200) -> T:
        """Return the latest value that no `async_read` has returned; wait for it if necessary.

        Arguments and errors as in `read`.
        """
        return self._newer_than(self._taken, timeout_ms)

    def read_latest(self, max_age_ms: float = 500) -> T:
        """Return the latest value at once; the next call may return the same.

        Args:
            max_age_ms: Greatest age of the value [ms].

        Raises:
            NotOpenError: The sensor is closed.
            NoReadingError: No value has arrived yet.
            StaleReadingError: The value is older than that.
            MixtacError: The source has ended or failed.
        """
        self._check()
        with self._changed:
            value, age_ms = self._value, (time.monotonic() - self._at_s) * 1e3
        if value is None:
            raise NoReadingError(f'no {self._what} yet{self._why()}', remedy='wait with read()')
        if age_ms > max_age_ms:
            raise StaleReadingError(
                f'the latest {self._what} is {age_ms:.0f} ms old, more than {max_age_ms:g}'
                f'{self._why()}'
            )
        return value

    def _newer_than(self, count: int, timeout_ms: float) -> T:
        deadline_s = time.monotonic() + timeout_ms / 1e3
        with self._changed:
            while self._count <= count:
                self._check()
                left_s = deadline_s - time.monotonic()
                if left_s <= 0:
                    raise ReadTimeoutError(
                        f'no new {self._what} within {timeout_ms:g} ms{self._why()}'
                    )
                # In short waits: the end of the source notifies nobody.
                self._changed.wait(min(left_s, LOOK_S))
            self._check()
            self._taken = self._count
            assert self._value is not None  # noqa: S101  (it was counted)
            return self._value

    def _why(self) -> str:
        reason = self._reason()
        return f': {reason}' if reason else ''
