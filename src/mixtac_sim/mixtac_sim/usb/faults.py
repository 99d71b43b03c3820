# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""USB errors of the virtual camera, and faults that provoke them.

`mixtac_sim.usb.device.VirtualDavis346.inject` injects a `Fault`. Real cameras have no such
interface.
"""

from __future__ import annotations

import math
import random
import time
from dataclasses import dataclass
from enum import Enum, auto
from errno import EBUSY, EIO, ENODEV, EOVERFLOW, EPIPE, ETIMEDOUT
from threading import Condition
from typing import Final

from mixtac_core.events.errors import MixtacError


class VirtualUsbError(MixtacError):
    """Base of all failures of the virtual USB device and its transports.

    Attributes:
        errno: The error as a host sees it.
    """

    errno = EIO


class UsbStall(VirtualUsbError):  # noqa: N818 - the USB term
    """The device refuses a request (STALL handshake)."""

    errno = EPIPE


class UsbTimeout(VirtualUsbError):  # noqa: N818 - the USB term
    """No data before the time-out."""

    errno = ETIMEDOUT


class UsbGone(VirtualUsbError):  # noqa: N818 - the USB term
    """The device was unplugged or its server ended."""

    errno = ENODEV


class UsbBusy(VirtualUsbError):  # noqa: N818 - the USB term
    """Another session has claimed the interface."""

    errno = EBUSY


class UsbOverflow(VirtualUsbError):  # noqa: N818 - the USB term
    """The device sent more than requested (babble)."""

    errno = EOVERFLOW


class NoVirtualSensorError(VirtualUsbError):
    """No virtual sensor listens on the socket."""

    errno = ENODEV


class FaultKind(Enum):
    """Kinds of faults.

    Attributes:
        STALL_DATA: The data endpoint halts until the host clears the halt, ``count`` times.
        STALL_CONTROL: Vendor requests are refused.
        TIMEOUT_CONTROL: Vendor requests find no answer.
        GARBAGE_REGISTERS: Registers read as random numbers.
        SHORT_READS: Reads return a random number of bytes, odd ones too; the other half of a word
            that was cut is lost.
        DROP_BYTES: ``size`` bytes are lost, rounded up to whole words.
        FREEZE: The data endpoint has nothing to send; with neither ``seconds`` nor ``count`` until
            the host restarts the stream.
        HANG_READS: Reads do not return, not even at their time-out.
        BABBLE: Reads fail because more data came than requested (EOVERFLOW).
        READ_ERROR: Reads fail on the bus (EIO).
    """

    STALL_DATA = auto()
    STALL_CONTROL = auto()
    TIMEOUT_CONTROL = auto()
    GARBAGE_REGISTERS = auto()
    SHORT_READS = auto()
    DROP_BYTES = auto()
    FREEZE = auto()
    HANG_READS = auto()
    BABBLE = auto()
    READ_ERROR = auto()


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault.

    Attributes:
        kind: Kind of the fault.
        seconds: Duration [s]; 0 for no end.
        count: Requests or reads after which it ends; 0 for no end.
        size: Bytes lost.
        seed: Seed of random values.
    """

    kind: FaultKind
    seconds: float = 0.0
    count: int = 0
    size: int = 0
    seed: int = 0


_BLOCKING: Final = (FaultKind.FREEZE, FaultKind.HANG_READS)
_LONGEST_SHORT_READ: Final = 1500
_VENDOR: Final = 0x40


class FaultInjector:
    """The active faults. Not thread safe: the device guards it with its condition.

    Args:
        condition: The device's; its lock is held whenever a method is called.
    """

    def __init__(self, condition: Condition) -> None:
        self._condition = condition
        self._random = random.Random()  # noqa: S311 - not for secrets
        self._until_s: dict[FaultKind, float] = {}
        self._left: dict[FaultKind, float] = {}
        self._halted = False
        self._drop = 0

    def clear(self) -> None:
        """End all faults."""
        self._left = {}
        self._halted = False
        self._drop = 0
        self._condition.notify_all()

    def begin(self, fault: Fault) -> None:
        """Start a fault."""
        self._random.seed(fault.seed)
        if fault.kind is FaultKind.DROP_BYTES:
            self._drop += fault.size + fault.size % 2
            return
        self._until_s[fault.kind] = time.monotonic() + (fault.seconds or math.inf)
        self._left[fault.kind] = fault.count or math.inf
        self._condition.notify_all()

    def restarted(self) -> None:
        """Note that the host restarted the stream."""
        if self._until_s.get(FaultKind.FREEZE) == math.inf:
            self._left[FaultKind.FREEZE] = 0

    def before_control(self, request_type: int, limit_s: float) -> None:
        """Apply the faults to a control request.

        Args:
            request_type: ``bmRequestType``.
            limit_s: How long the host waits [s].

        Raises:
            UsbStall: It is refused.
            UsbTimeout: It finds no answer in time.
        """
        if request_type & _VENDOR and self._take(FaultKind.STALL_CONTROL):
            raise UsbStall('the request was refused (injected fault)')
        if request_type & _VENDOR and self._take(FaultKind.TIMEOUT_CONTROL):
            self._sleep(self._until_s[FaultKind.TIMEOUT_CONTROL] - time.monotonic(), limit_s)

    def answer(self, request_type: int, answer: bytes) -> bytes:
        """Return what is answered to a request instead of this."""
        if request_type & _VENDOR and self._take(FaultKind.GARBAGE_REGISTERS):
            return self._random.randbytes(len(answer))
        return answer

    def halt_cleared(self) -> None:
        """Note that the host cleared the halt of the data endpoint."""
        self._halted = False

    def before_read(self) -> None:
        """Apply the faults to a read of the data endpoint.

        Raises:
            UsbStall: The endpoint is halted.
            UsbOverflow: More data came than requested.
            VirtualUsbError: The bus failed.
        """
        self._halted = self._halted or self._take(FaultKind.STALL_DATA)
        if self._halted:
            raise UsbStall('the data endpoint is halted (injected fault); clear the halt')
        if self._take(FaultKind.BABBLE):
            raise UsbOverflow('more data came than requested (injected fault)')
        if self._take(FaultKind.READ_ERROR):
            raise VirtualUsbError('the bus failed (injected fault)')

    @property
    def is_frozen(self) -> bool:
        """Whether the data endpoint has nothing to send."""
        return any(self._is_active(kind) for kind in _BLOCKING)

    @property
    def is_hung(self) -> bool:
        """Whether reads miss their time-out."""
        return self._is_active(FaultKind.HANG_READS)

    @property
    def thaws_at(self) -> float:
        """When the next of the faults that block reads ends [s, monotonic clock]."""
        return min((self._until_s[k] for k in _BLOCKING if self._is_active(k)), default=math.inf)

    def take_dropped(self, available: int) -> int:
        """Return the number of waiting bytes to drop."""
        count = min(self._drop, available)
        self._drop -= count
        return count

    def granted(self, length: int) -> int:
        """Return how many of ``length`` bytes a read gets."""
        if length > 1 and self._take(FaultKind.SHORT_READS):
            return self._random.randint(1, min(length, _LONGEST_SHORT_READ))
        return length

    def _is_active(self, kind: FaultKind) -> bool:
        return self._left.get(kind, 0) > 0 and time.monotonic() < self._until_s[kind]

    def _take(self, kind: FaultKind) -> bool:
        active = self._is_active(kind)
        if active:
            self._left[kind] -= 1
        return active

    def _sleep(self, seconds: float, limit_s: float) -> None:
        faults = self._left
        deadline = time.monotonic() + min(seconds, limit_s)
        # Clearing the faults, a reset and unplugging end the wait.
        while faults is self._left and time.monotonic() < deadline:
            self._condition.wait(min(deadline - time.monotonic(), 1.0))
        if faults is self._left and seconds > limit_s:
            raise UsbTimeout(f'no answer within {limit_s} s (injected fault)')
