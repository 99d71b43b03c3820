# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The loss counter of numbered messages.

A small module of its own because everything that receives event packets counts losses with it.
"""

from __future__ import annotations

RESTART_STEP = 1_000_000
"""A larger step forward is a restart of the sender: 1000 s without packets at 1 kHz."""


class SequenceCounter:
    """Counts received, lost and repeated messages by their numbers, and restarts of the sender.

    Attributes:
        received: Messages seen, without repetitions.
        lost: Messages missing between them. Messages missing around a restart are not counted,
            because their number is unknown.
        repeated: Messages with the number of the one before.
        restarts: Times that the numbers went back, or forward by more than RESTART_STEP.
        continuous: False if something is missing directly before the latest message: a loss or
            a restart. True after the first message.
        last: Number of the latest message, None before the first.
    """

    def __init__(self) -> None:
        self.received = self.lost = self.repeated = self.restarts = 0
        self.continuous = True
        self.last: int | None = None

    def update(self, seq: int) -> int:
        """Count a message.

        Args:
            seq: Its number; the sender counts up by one.

        Returns:
            The number of messages missing before it: 0 for the first, after a restart and for a
            repetition, never negative.
        """
        seq = int(seq)
        step = 1 if self.last is None else seq - self.last
        self.last = seq
        self.continuous = step in {0, 1}
        if step == 0:
            self.repeated += 1
            return 0
        self.received += 1
        if not 0 < step <= RESTART_STEP:
            self.restarts += 1
            return 0
        self.lost += step - 1
        return step - 1
