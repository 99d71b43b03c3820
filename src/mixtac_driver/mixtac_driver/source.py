# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What the driver runs on: a camera, a simulated one, or a recording, by the device string."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from mixtac_driver.camera import Davis346
from mixtac_driver.errors import UnknownDeviceError
from mixtac_driver.playback.source import RecordedSource
from mixtac_driver.usb.device import check_device, is_real, known_devices
from mixtac_recordings.camera_stream import SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mixtac_driver.camera import CameraBatch, StreamSettings
    from mixtac_driver.clock import Origin
    from mixtac_driver.davis346.control import CameraControl
    from mixtac_driver.davis346.identity import Identity
    from mixtac_driver.davis346.settings import Configuration
    from mixtac_driver.decode.state import DecoderCounters
    from mixtac_driver.parameters import PlaybackParameters
    from mixtac_driver.usb.transport import DebugMessage, TransportCounters
    from mixtac_events.clock_map import ClockMap


class Source(Protocol):
    """What gives batches; `batches` is for one thread, everything else may be used from others."""

    @property
    def clock(self) -> ClockMap:
        """Map from the camera's clock [us, without origin] to the host's."""

    @property
    def is_master(self) -> bool:
        """True where the camera runs on its own clock."""

    @property
    def identity(self) -> Identity:
        """What it is.

        Raises:
            DriverError: It was not opened.
        """

    @property
    def known_identity(self) -> Identity | None:
        """What it is, or was when last open; None before."""

    @property
    def is_open(self) -> bool:
        """True between `open` and `close`."""

    @property
    def origin(self) -> Origin | None:
        """What is added to the camera's clock to publish times; None before it is known."""

    @property
    def clock_resets(self) -> int:
        """Resets of the camera's clock that nobody asked for."""

    @property
    def transport_counters(self) -> TransportCounters:
        """What came over USB since the start."""

    @property
    def decoder_counters(self) -> DecoderCounters | None:
        """What was seen and dropped since the start; None before it."""

    @property
    def control(self) -> CameraControl:
        """Settings and requests; usable from any thread, open or not."""

    def attached(self) -> frozenset[tuple[int, int]]:
        """Return bus and address of every camera that could be opened."""

    def open(self) -> None:
        """Open it.

        Raises:
            DriverError: It cannot be opened.
        """

    def start(self) -> None:
        """Begin a stream.

        Raises:
            DriverError: It cannot be started.
        """

    def batches(self) -> Iterator[CameraBatch]:
        """Yield what is seen until stopped.

        Raises:
            EndOfStream: Nothing more will come, and nothing is wrong.
            RecordingError: Nothing more will come, and opening it again does not help.
            DriverError: The stream died; it may be opened again.
        """

    def apply(self, configuration: Configuration) -> None:
        """Change settings of the camera; without effect on a recording.

        Raises:
            DriverError: They cannot be changed.
        """

    def reset_timestamps(self) -> None:
        """Set the camera's clock to zero; published time goes on.

        Raises:
            DriverError: It does not stream, cannot be asked, or the request failed.
        """

    def request_stop(self) -> None:
        """Make `batches` end soon; returns at once."""

    def stop(self) -> None:
        """Stop the stream.

        Raises:
            DriverError: It could not be told.
        """

    def close(self) -> None:
        """Stop if need be and give the device back."""


class SourceKind(Enum):
    """Where data come from; the values are for people."""

    CAMERA = 'camera'
    SIMULATED = 'simulated camera'
    RECORDED = 'recording'


def source_kind(device: str) -> SourceKind:
    """Return what a device string names.

    Raises:
        UnknownDeviceError: Nothing known.
    """
    if is_real(device):
        return SourceKind.CAMERA
    if device.partition(':')[0] not in known_devices() and _looks_like_a_path(device):
        return SourceKind.RECORDED
    try:
        check_device(device)
    except UnknownDeviceError as error:
        raise UnknownDeviceError(f'{error}, or the path of a recording') from error
    return SourceKind.SIMULATED


def make_source(
    device: str,
    *,
    serial: str,
    configuration: Configuration,
    stream: StreamSettings,
    playback: PlaybackParameters,
    on_debug: Callable[[DebugMessage], None] | None = None,
) -> Source:
    """Return the source behind a device string, not yet open.

    Args:
        device: Name of a device (see `backend`), or the path of a recording.
        serial: Serial number, or empty for the only camera.
        configuration: Settings of a camera.
        stream: How data are taken from a camera.
        playback: How a recording is played.
        on_debug: Called, in a thread of its own, with messages of a camera's USB controller.

    Raises:
        UnknownDeviceError: Nothing is known by that device string.
    """
    if source_kind(device) is SourceKind.RECORDED:
        return RecordedSource(device, playback)
    return Davis346(
        device, serial=serial, configuration=configuration, stream=stream, on_debug=on_debug
    )


def _looks_like_a_path(device: str) -> bool:
    path = Path(device)
    return path.suffix in SUFFIXES or '/' in device or path.exists()
