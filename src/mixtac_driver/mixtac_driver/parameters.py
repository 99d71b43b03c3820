# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node, which are also the settings of its parts.

Names follow libcaer_driver where the meaning is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from mixtac_core.node.parameters import fixed, parameter
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_driver.errors import ConfigurationError


class RecoveryPolicy(str, Enum):
    """Reaction to a failure.

    Attributes:
        RECONNECT: Open the camera again, with growing pauses, until it is back.
        FAIL_STOP: End with the reason; a camera that was never there is still waited for.
    """

    RECONNECT = 'reconnect'
    FAIL_STOP = 'fail_stop'


USB_PACKET = 1024
"""Largest packet of the data endpoint [bytes]: reads of other sizes end within one."""
MOST_QUEUED = 256 << 20
"""Limit of the memory of all USB reads that are queued [bytes]."""


@dataclass(frozen=True)
class DeviceParameters:
    """Device, transport, packets, recovery and calibration; all fixed while the node runs.

    Attributes:
        device: Device to open: davis346 for a camera on USB, virtual or virtual:/path/of/socket for
            the virtual sensor, or the path of a recording (an AEDAT4 file, a bag folder or file)
        serial: Serial number of the camera. Empty: the only one attached
        event_message_time_threshold: Longest time that an event packet spans
        event_message_size_threshold: Largest payload of an event packet
        camera_frame_id: Frame of events and images
        imu_frame_id: Frame of inertial samples
        stream_timeout: Time without any data after which the stream counts as dead; a camera sends
            its time every 33 ms even in the dark
        usb_transfers: Number of USB reads queued at the camera
        usb_transfer_size: Size of a USB read, a multiple of 1024; those queued may hold 256 MiB
        usb_queue_size: Limit of received data waiting to be decoded; at least one USB read
        recovery_policy: Reaction to a camera failure: reconnect opens the camera again until it is
            back; fail_stop ends the driver with the reason and exit status 1
        recovery_first_pause: Pause before the first attempt to reconnect
        recovery_longest_pause: Longest pause between attempts to reconnect; each pause is twice as
            long as the previous one. Plugging in a camera ends the pause
        recovery_give_up_after: Time without a stream after which the driver ends as with fail_stop;
            0: never
        camera_name: Name of the camera in its calibration: letters, digits and _
        camerainfo_url: Calibration written by `mixtac calibrate`: file:///path,
            package://name/path or a path, where ${NAME} is camera_name and ${ROS_HOME} is ~/.ros
            unless set. Empty: file://${ROS_HOME}/camera_info/${NAME}.yaml
        undistort_events: Also publish events at undistorted pixels; needs a calibration
    """

    device: str = fixed('davis346')
    serial: str = fixed('')
    event_message_time_threshold: float = fixed(1e-3, unit='s', within=(1e-4, 0.1))
    event_message_size_threshold: int = fixed(300_000, unit='bytes', within=(1000, 100_000_000))
    camera_frame_id: str = fixed('camera')
    imu_frame_id: str = fixed('imu')
    stream_timeout: float = fixed(3.0, unit='s', within=(0.1, 3600.0))
    usb_transfers: int = fixed(128, within=(1, 1024))
    usb_transfer_size: int = fixed(65536, unit='bytes', within=(USB_PACKET, 1 << 22))
    usb_queue_size: int = fixed(32 << 20, unit='bytes', within=(1 << 16, 1 << 30))
    recovery_policy: str = fixed(
        RecoveryPolicy.RECONNECT.value, choices=tuple(policy.value for policy in RecoveryPolicy)
    )
    recovery_first_pause: float = fixed(0.05, unit='s', within=(0.01, 60.0))
    recovery_longest_pause: float = fixed(0.5, unit='s', within=(0.01, 600.0))
    recovery_give_up_after: float = fixed(0.0, unit='s', within=(0.0, 86_400.0))
    camera_name: str = fixed('davis346')
    camerainfo_url: str = fixed('')
    undistort_events: bool = fixed(False)


@dataclass(frozen=True)
class PlaybackParameters:
    """How a recording is played.

    Attributes:
        playback_rate: Playback speed of a recording: 1 is real time, 0 as fast as the subscribers
            allow
        playback_loop: Play a recording again from its start when it ends; stamps continue, shifted
            by its length and 1 ms
        playback_paused: Pause playback of a recording
        playback_start: Position in a recording at which playback starts, also when looping
        playback_restamp: Move recorded stamps to the time of playback (at the start and at loops)
        playback_clock: Publish the recorded camera clock on /clock, for nodes with use_sim_time;
            the driver itself stays on the host clock
        playback_events_topic: Topic or stream of events to play. Empty: the only one; none: do not
            play any
        playback_image_topic: Topic or stream of frames to play. Empty: the only one; none: do not
            play any
        playback_imu_topic: Topic or stream of inertial samples to play. Empty: the only one; none:
            do not play any
    """

    playback_rate: float = parameter(1.0, within=(0.0, 1000.0))
    playback_loop: bool = parameter(False)
    playback_paused: bool = parameter(False)
    playback_start: float = fixed(0.0, unit='s', within=(0.0, 1e9))
    playback_restamp: bool = fixed(False)
    playback_clock: bool = fixed(False)
    playback_events_topic: str = fixed('')
    playback_image_topic: str = fixed('')
    playback_imu_topic: str = fixed('')


@dataclass(frozen=True)
class DriverParameters(CameraParameters, PlaybackParameters, DeviceParameters):
    """All parameters: what to open, how to run it, and how to publish its data."""

    def check(self) -> None:
        """Raise if a value is out of range, or if values contradict each other.

        Raises:
            ConfigurationError: Two values contradict each other, or reads of this size cannot be.
            ParameterError: A value is out of range.
        """
        super().check()
        size, transfers, queue = self.usb_transfer_size, self.usb_transfers, self.usb_queue_size
        if size % USB_PACKET:
            raise ConfigurationError(f'usb_transfer_size = {size}: give a multiple of {USB_PACKET}')
        if queue < size:
            raise ConfigurationError(
                f'usb_queue_size = {queue}: give at least usb_transfer_size = {size}'
            )
        if transfers * size > MOST_QUEUED:
            raise ConfigurationError(
                f'usb_transfers = {transfers} of usb_transfer_size = {size}: give at most '
                f'{MOST_QUEUED} bytes in all, such as usb_transfers = {MOST_QUEUED // size}'
            )
