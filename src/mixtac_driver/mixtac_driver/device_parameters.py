# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters: what to open, and how its data travel to the topics."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.parameter_fields import number
from mixtac_driver.stream import StreamSettings
from mixtac_events.codec import ENCODINGS
from mixtac_node.parameters import parameter


@dataclass(frozen=True)
class DeviceParameters:
    """Device, transport, packets and frames of reference; mostly fixed while the node runs."""

    device: str = parameter(
        'davis346',
        'What to open: davis346 for a camera on USB, virtual or virtual:/path/of/socket for the '
        'virtual sensor, or the path of a recording: an AEDAT4 file, or a bag folder or file',
        read_only=True,
    )
    serial: str = parameter(
        '', 'Serial number of the camera; empty takes the only one attached', read_only=True
    )
    encoding: str = parameter(
        'libcaer_cmp', 'Encoding of event packets', choices=ENCODINGS, read_only=True
    )
    event_message_time_threshold: float = parameter(
        1e-3,
        'Longest time that an event packet spans',
        unit='s',
        minimum=1e-4,
        maximum=0.1,
        read_only=True,
    )
    event_message_size_threshold: int = number(
        300_000,
        'Longest payload of an event packet',
        100_000_000,
        'bytes',
        minimum=1000,
        read_only=True,
    )
    camera_frame_id: str = parameter('camera', 'Frame of events and images', read_only=True)
    imu_frame_id: str = parameter('imu', 'Frame of inertial samples', read_only=True)
    stream_timeout: float = parameter(
        3.0,
        'Time without any data after which the stream counts as dead; a camera sends time every '
        '33 ms even in the dark',
        unit='s',
        minimum=0.1,
        maximum=60.0,
        read_only=True,
    )
    usb_transfers: int = number(
        128, 'USB reads that wait at the camera at once', 1024, minimum=1, read_only=True
    )
    usb_transfer_size: int = number(
        65536, 'Bytes per USB read', 1 << 22, 'bytes', minimum=512, read_only=True
    )
    usb_queue_size: int = number(
        32 << 20,
        'Bytes that may wait to be decoded besides',
        1 << 30,
        'bytes',
        minimum=1 << 16,
        read_only=True,
    )
    usb_early_packet_delay: int = number(
        200, 'Time after which the camera sends what it has', 15_875, 'us', minimum=125
    )


def stream_settings(p: DeviceParameters) -> StreamSettings:
    """Return how data are to be taken from the camera."""
    return StreamSettings(
        transfers=p.usb_transfers,
        transfer_size=p.usb_transfer_size,
        queue_size=p.usb_queue_size,
        silence_s=p.stream_timeout,
        confirmation_s=p.stream_timeout,
    )
