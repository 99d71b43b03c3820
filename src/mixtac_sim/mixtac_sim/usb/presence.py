# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Whether the virtual camera is plugged in, and which host session holds its interface."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from mixtac_sim.usb.errors import UsbBusy, UsbGone

if TYPE_CHECKING:
    from collections.abc import Hashable


class Presence:
    """Presence and ownership. Not thread safe: the device guards it.

    Attributes:
        plugs: How often the device was plugged in; a session that began before the last time is
            dead for ever, as a file handle of an unplugged device is.
        resets: How often the port was reset.
    """

    def __init__(self) -> None:
        self.plugs = 1
        self.resets = 0
        self._owner: Hashable | None = None
        self._back_at: float | None = None

    @property
    def is_gone(self) -> bool:
        """Whether the device is unplugged."""
        return self._back_at is not None

    @property
    def is_due(self) -> bool:
        """Whether an unplugged device is to be plugged in by now."""
        return self._back_at is not None and time.monotonic() >= self._back_at

    def unplug(self, seconds: float = math.inf) -> None:
        """Remove the device; it is due again after some seconds."""
        self._back_at = time.monotonic() + seconds

    def plug_in(self) -> None:
        """Bring the device back; all sessions from before are over."""
        self._back_at = None
        self._owner = None
        self.plugs += 1

    def check(self, plugs: int | None = None) -> None:
        """Make sure that the device is there, and was since a session began.

        Args:
            plugs: What `plugs` was when the session began.

        Raises:
            UsbGone: It is not, or was not.
        """
        if self.is_gone:
            raise UsbGone('the virtual camera was unplugged; start the virtual sensor again')
        if plugs is not None and plugs != self.plugs:
            raise UsbGone('the virtual camera was unplugged meanwhile; open it again')

    def claim(self, owner: Hashable) -> None:
        """Give the interface to one session.

        Raises:
            UsbBusy: Another session has it.
        """
        if self._owner not in {None, owner}:
            raise UsbBusy('the virtual camera is in use by another program; close that one')
        self._owner = owner

    def release(self, owner: Hashable) -> None:
        """Take the interface back from a session that may or may not hold it."""
        if self._owner == owner:
            self._owner = None
