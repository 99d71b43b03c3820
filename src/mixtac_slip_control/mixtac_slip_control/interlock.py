# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the arm may follow slip: off at start, on by request, off for good after a fault."""

from __future__ import annotations

from enum import IntEnum

from mixtac_slip_control.errors import SlipControlError


class InterlockState(IntEnum):
    """State of the interlock; the numbers are those of `mixtac_msgs/SlipState`."""

    DISABLED = 0
    """Slip is reported, nothing moves."""
    ENABLED = 1
    """Slip moves the arm."""
    STOPPED = 2
    """A fault has stopped it; only a reset leads to DISABLED."""


class Interlock:
    """Latches the first fault.

    Attributes:
        state: Present state.
        reason: Why it stopped; empty unless it did.
    """

    def __init__(self) -> None:
        self.state = InterlockState.DISABLED
        self.reason = ''

    @property
    def enabled(self) -> bool:
        """Whether the arm may follow slip."""
        return self.state is InterlockState.ENABLED

    def enable(self, fault: str | None) -> None:
        """Let the arm follow slip.

        Args:
            fault: What speaks against it now, or None.

        Raises:
            SlipControlError: Something does, or it is stopped and was not reset.
        """
        if self.state is InterlockState.STOPPED:
            raise SlipControlError(
                f'slip control is stopped ({self.reason}): remove the cause and call ~/reset'
            )
        if fault is not None:
            raise SlipControlError(f'slip control stays disabled: {fault}')
        self.state = InterlockState.ENABLED

    def disable(self) -> None:
        """Let nothing move; a stop stays a stop."""
        if self.state is InterlockState.ENABLED:
            self.state = InterlockState.DISABLED

    def stop(self, reason: str) -> None:
        """Stop for good; the first reason is kept. Without effect unless enabled."""
        if self.state is InterlockState.ENABLED:
            self.state = InterlockState.STOPPED
            self.reason = reason

    def reset(self) -> None:
        """Leave the stop; the arm stays disabled."""
        if self.state is InterlockState.STOPPED:
            self.state = InterlockState.DISABLED
        self.reason = ''
