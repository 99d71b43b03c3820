# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""USB errors of the virtual camera."""

from __future__ import annotations

from errno import EBUSY, EIO, ENODEV, EPIPE, ETIMEDOUT

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


class NoVirtualSensorError(VirtualUsbError):
    """No virtual sensor listens on the socket."""

    errno = ENODEV
