# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The clock that a recording is played on."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

LATE_S = 0.01
LONGEST_WAIT_S = 3600.0


@dataclass(slots=True)
class Lag:
    """How far the playing is behind its clock; nothing is left out and the clock is not slowed.

    Attributes:
        now_s: At the latest step [s].
        most_s: At the worst step [s].
        late_steps: Steps more than LATE_S behind.
    """

    now_s: float = 0.0
    most_s: float = 0.0
    late_steps: int = 0


class PlaybackClock:
    """Says when something recorded is due; sleeps until then.

    `wait_until` is for one thread, everything else for any.

    Args:
        rate: Recorded seconds per second; 0 never waits.
        now_s: Clock [s] that only goes forward.
        changed: Condition that is waited on.

    Attributes:
        lag: How far the one who waits is behind.
    """

    def __init__(
        self,
        rate: float = 1.0,
        *,
        now_s: Callable[[], float] = time.monotonic,
        changed: threading.Condition | None = None,
    ) -> None:
        self.lag = Lag()
        self._rate = rate
        self._now_s = now_s
        self._changed = changed or threading.Condition()
        self._anchor: tuple[float, float] | None = None
        self._paused_at_s: float | None = None
        self._interrupted = False
        self._reached_us: int | None = None

    @property
    def rate(self) -> float:
        """Recorded seconds per second; 0 never waits."""
        return self._rate

    @property
    def is_paused(self) -> bool:
        """True between `pause` and `resume`."""
        return self._paused_at_s is not None

    def restart(self) -> None:
        """Begin anew: what is waited for next is due at once, and waits are not interrupted."""
        with self._changed:
            self._anchor = None
            self._reached_us = None
            self._interrupted = False

    def set_rate(self, rate: float) -> None:
        """Go on at another rate from where playing is now."""
        with self._changed:
            if rate != self._rate:
                self._rate = rate
                self._anchor = None
                self._changed.notify_all()

    def pause(self) -> None:
        """Stand still."""
        with self._changed:
            if self._paused_at_s is None:
                self._paused_at_s = self._now_s()
                self._changed.notify_all()

    def resume(self) -> None:
        """Go on after `pause`."""
        with self._changed:
            if self._paused_at_s is None:
                return
            if self._anchor is not None:
                at_s, at_us = self._anchor
                self._anchor = (at_s + self._now_s() - self._paused_at_s, at_us)
            self._paused_at_s = None
            self._changed.notify_all()

    def interrupt(self) -> None:
        """End the wait in progress and all later ones until `restart`."""
        with self._changed:
            self._interrupted = True
            self._changed.notify_all()

    def wait_until(self, due_us: int) -> bool:
        """Sleep until a recorded time is due.

        Args:
            due_us: The time [us], on a clock that only goes forward.

        Returns:
            False where the wait was interrupted.
        """
        with self._changed:
            while not self._interrupted:
                if self._paused_at_s is not None:
                    self._changed.wait()
                    continue
                remaining_s = self._remaining_s(due_us)
                if remaining_s <= 0:
                    self._reached(due_us, max(-remaining_s, 0.0))
                    return True
                self._changed.wait(min(remaining_s, LONGEST_WAIT_S))
            return False

    def _remaining_s(self, due_us: int) -> float:
        if self._rate == 0:
            return 0.0
        now_s = self._now_s()
        if self._anchor is None:
            # After a change of rate, what was handed on last is where playing is now.
            from_us = due_us if self._reached_us is None else self._reached_us
            self._anchor = (now_s, from_us)
        at_s, at_us = self._anchor
        return at_s + (due_us - at_us) / 1e6 / self._rate - now_s

    def _reached(self, due_us: int, behind_s: float) -> None:
        self._reached_us = due_us
        self.lag.now_s = behind_s
        self.lag.most_s = max(self.lag.most_s, behind_s)
        self.lag.late_steps += behind_s > LATE_S
