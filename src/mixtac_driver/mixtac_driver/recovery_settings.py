# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What to do when there is no camera: named policies and growing pauses."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class RecoveryPolicy(str, Enum):
    """What a failure leads to.

    Attributes:
        RECONNECT: Open the camera again, with growing pauses, until it is back.
        FAIL_STOP: End with the reason; a camera that was never there is still waited for.
    """

    RECONNECT = 'reconnect'
    FAIL_STOP = 'fail_stop'


@dataclass(frozen=True, slots=True)
class RecoverySettings:
    """How failures are dealt with.

    Attributes:
        policy: What a failure leads to.
        first_pause_s: Pause before the first attempt to open the camera again [s].
        longest_pause_s: Longest pause [s]; each is twice as long as the one before.
        give_up_after_s: Time without a stream [s] after which reconnecting ends; 0 never ends.
    """

    policy: RecoveryPolicy = RecoveryPolicy.RECONNECT
    first_pause_s: float = 0.05
    longest_pause_s: float = 0.5
    give_up_after_s: float = 0.0

    def gives_up(self, seconds: float) -> bool:
        """Return whether so many seconds without a stream are too many."""
        return 0 < self.give_up_after_s <= seconds


class Backoff:
    """Pauses that double up to a bound.

    Args:
        first_s: First pause [s].
        longest_s: Longest pause [s].
    """

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s = min(first_s, longest_s)
        self._longest_s = longest_s
        self._next_s = self._first_s

    def next(self) -> float:
        """Return the next pause [s]."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._longest_s)
        return pause_s

    def reset(self) -> None:
        """Begin with the first pause again."""
        self._next_s = self._first_s
