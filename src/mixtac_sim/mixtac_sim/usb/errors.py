# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What can go wrong on the virtual USB."""

from __future__ import annotations

from mixtac_events.errors import MixtacError


class VirtualUsbError(MixtacError):
    """Base of all failures of the virtual USB device and its transports."""


class UsbStall(VirtualUsbError):  # noqa: N818 - the USB term
    """The device refuses a request (STALL handshake); a host sees ``EPIPE``."""


class UsbTimeout(VirtualUsbError):  # noqa: N818 - the USB term
    """No data within the time asked for; a host sees ``ETIMEDOUT``."""


class UsbGone(VirtualUsbError):  # noqa: N818 - the USB term
    """The device was unplugged or its server ended; a host sees ``ENODEV``."""


class UsbBusy(VirtualUsbError):  # noqa: N818 - the USB term
    """Somebody else has claimed the interface; a host sees ``EBUSY``."""


class UsbOverflow(VirtualUsbError):  # noqa: N818 - the USB term
    """The device sent more than was asked for (babble); a host sees ``EOVERFLOW``."""


class FaultError(VirtualUsbError):
    """A fault that cannot be injected."""


class NoVirtualSensorError(VirtualUsbError):
    """Nobody serves a virtual sensor where one was looked for."""
