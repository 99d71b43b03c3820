# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Errors of the driver; imports no other driver module, because all of them use it."""

from __future__ import annotations

from mixtac_core.events.errors import MixtacError


class DriverError(MixtacError):
    """Base of every error of this package that a user may see."""


class UsbError(DriverError):
    """A USB request that failed, or a camera that may not be opened."""


class AccessError(UsbError):
    """The operating system does not permit opening the camera."""


class InUseError(UsbError):
    """Another program holds the camera."""


class StallError(UsbError):
    """The camera refused a request, or its data endpoint stays halted."""


class NoAnswerError(UsbError):
    """The camera did not answer a request in time."""


class BusError(UsbError):
    """The bus failed, or the camera sent more than requested."""


class UnknownDeviceError(DriverError):
    """A device string that names nothing known."""


class NoCameraError(UsbError):
    """No camera, or none with the wanted serial number, is attached."""


class DisconnectedError(UsbError):
    """The camera went away while it was open."""


class UnsupportedCameraError(DriverError):
    """A camera whose chip, firmware or logic is not supported."""


class ConfigurationError(DriverError):
    """A setting that the camera does not support."""


class StreamError(DriverError):
    """A data stream that stopped, or never confirmed its start."""


class HungReadError(StreamError):
    """USB reads that the kernel does not return: only the end of the process frees the camera."""


class EndOfStream(DriverError):  # noqa: N818 - a state, not a failure
    """The regular end of a recording."""
