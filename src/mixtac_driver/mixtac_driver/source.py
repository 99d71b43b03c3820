# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The source of the driver's data: a camera, a simulated one, or a recording, by device string."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Protocol

from mixtac_core.recordings.recording import AEDAT4_SUFFIX, BAG_SUFFIXES
from mixtac_driver.camera import CameraBatch, Davis346, SourceStatus
from mixtac_driver.davis346.control import CameraControl, PixelFilter
from mixtac_driver.device import check_device, is_real
from mixtac_driver.errors import UnknownDeviceError
from mixtac_driver.parameters import DriverParameters


class Source(Protocol):
    """Yields batches; `batches` is for one thread, everything else may be used from others."""

    @property
    def control(self) -> CameraControl | None:
        """Requests to the camera; None where there is no camera, as for a recording."""

    def status(self) -> SourceStatus:
        """Return its state, open or not."""

    def open(self) -> None:
        """Open it.

        Raises:
            MixtacError: It cannot be opened.
        """

    def start(self) -> None:
        """Start streaming.

        Raises:
            MixtacError: It cannot be started.
        """

    def batches(self) -> Iterator[CameraBatch]:
        """Yield the data until stopped.

        Raises:
            EndOfStream: There are no more data, and nothing is wrong.
            RecordingError: There are no more data, and opening it again does not help.
            DriverError: The stream died; it may be opened again.
        """

    def apply(self, parameters: DriverParameters, pixel_filter: PixelFilter = ()) -> None:
        """Take new parameters; each source uses those that concern it.

        Args:
            parameters: All of them.
            pixel_filter: Pixels whose events the camera drops, most important first.

        Raises:
            MixtacError: They contradict each other, or a request failed; nothing was changed.
        """

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""

    def close(self) -> None:
        """Stop streaming if necessary and close the device."""


class SourceKind(Enum):
    """Kind of a source; values are shown to users."""

    CAMERA = 'camera'
    SIMULATED = 'simulated camera'
    RECORDED = 'recording'


def source_kind(device: str) -> SourceKind:
    """Return the kind of source that a device string names.

    Raises:
        UnknownDeviceError: It names nothing known.
    """
    if is_real(device):
        return SourceKind.CAMERA
    try:
        check_device(device)
    except UnknownDeviceError as error:
        path = Path(device)
        if path.suffix in (AEDAT4_SUFFIX, *BAG_SUFFIXES) or '/' in device or path.exists():
            return SourceKind.RECORDED
        remedy = f'{error.remedy}, or the path of a recording'
        raise UnknownDeviceError(error.message, remedy=remedy) from error
    return SourceKind.SIMULATED


def make_source(
    parameters: DriverParameters,
    *,
    pixel_filter: PixelFilter = (),
) -> Source:
    """Return the source behind the parameter `device`, not yet open.

    Args:
        parameters: All of them.
        pixel_filter: Pixels whose events a camera drops, most important first.

    Raises:
        UnknownDeviceError: The device string names nothing known.
    """
    if source_kind(parameters.device) is SourceKind.RECORDED:
        # A camera's driver starts without the readers of recordings.
        from mixtac_driver.playback import RecordedSource

        return RecordedSource(parameters)
    return Davis346(parameters, pixel_filter=pixel_filter)
