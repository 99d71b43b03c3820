# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node, which are also the settings of its parts.

Names follow libcaer_driver where the meaning is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from mixtac_driver.davis346.biases import number
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_events.codec import ENCODINGS
from mixtac_node.parameters import parameter


class RecoveryPolicy(str, Enum):
    """Reaction to a failure.

    Attributes:
        RECONNECT: Open the camera again, with growing pauses, until it is back.
        FAIL_STOP: End with the reason; a camera that was never there is still waited for.
    """

    RECONNECT = 'reconnect'
    FAIL_STOP = 'fail_stop'


@dataclass(frozen=True)
class DeviceParameters:
    """Device, transport, packets, recovery and calibration; all fixed while the node runs."""

    device: str = parameter(
        'davis346',
        'Device to open: davis346 for a camera on USB, virtual or virtual:/path/of/socket for the '
        'virtual sensor, or the path of a recording (an AEDAT4 file, or a bag folder or file)',
        read_only=True,
    )
    serial: str = parameter(
        '', 'Serial number of the camera. Empty: the only one attached', read_only=True
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
        'Largest payload of an event packet',
        100_000_000,
        'bytes',
        minimum=1000,
        read_only=True,
    )
    camera_frame_id: str = parameter('camera', 'Frame of events and images', read_only=True)
    imu_frame_id: str = parameter('imu', 'Frame of inertial samples', read_only=True)
    stream_timeout: float = parameter(
        3.0,
        'Time without any data after which the stream counts as dead; a camera sends its time '
        'every 33 ms even in the dark',
        unit='s',
        minimum=0.1,
        maximum=60.0,
        read_only=True,
    )
    usb_transfers: int = number(
        128, 'Number of USB reads queued at the camera', 1024, minimum=1, read_only=True
    )
    usb_transfer_size: int = number(
        65536, 'Size of a USB read', 1 << 22, 'bytes', minimum=512, read_only=True
    )
    usb_queue_size: int = number(
        32 << 20,
        'Limit of received data waiting to be decoded',
        1 << 30,
        'bytes',
        minimum=1 << 16,
        read_only=True,
    )
    recovery_policy: str = parameter(
        RecoveryPolicy.RECONNECT.value,
        'Reaction to a camera failure: reconnect opens the camera again until it is back; '
        'fail_stop ends the driver with the reason and exit status 1',
        choices=tuple(policy.value for policy in RecoveryPolicy),
        read_only=True,
    )
    recovery_first_pause: float = parameter(
        0.05,
        'Pause before the first attempt to reconnect',
        unit='s',
        minimum=0.01,
        maximum=60.0,
        read_only=True,
    )
    recovery_longest_pause: float = parameter(
        0.5,
        'Longest pause between attempts to reconnect; each pause is twice as long as the previous '
        'one. Plugging in a camera ends the pause',
        unit='s',
        minimum=0.01,
        maximum=600.0,
        read_only=True,
    )
    recovery_give_up_after: float = parameter(
        0.0,
        'Time without a stream after which the driver ends as with fail_stop; 0: never',
        unit='s',
        minimum=0.0,
        maximum=86_400.0,
        read_only=True,
    )
    camera_name: str = parameter(
        'davis346',
        'Name of the camera in its calibration: letters, digits and _',
        read_only=True,
    )
    camerainfo_url: str = parameter(
        '',
        'Calibration written by `mixtac calibrate`: file:///path, package://name/path or a path, '
        'where ${NAME} is camera_name and ${ROS_HOME} is ~/.ros unless set. Empty: '
        'file://${ROS_HOME}/camera_info/${NAME}.yaml',
        read_only=True,
    )
    undistort_frames: bool = parameter(
        False,
        'Also publish frames without lens distortion; needs a calibration',
        read_only=True,
    )
    undistort_events: bool = parameter(
        False,
        'Also publish events at undistorted pixels; needs a calibration',
        read_only=True,
    )


NO_SEEK = -1.0
"""Value of `playback_seek` that does nothing."""
_WHICH = 'Empty: the only one; none: do not play any'


@dataclass(frozen=True)
class PlaybackParameters:
    """How a recording is played."""

    playback_rate: float = parameter(
        1.0,
        'Playback speed of a recording: 1 is real time, 0 as fast as the subscribers allow',
        minimum=0.0,
        maximum=1000.0,
    )
    playback_loop: bool = parameter(
        False,
        'Play a recording again from its start when it ends; stamps continue, shifted by its '
        'length and 1 ms',
    )
    playback_paused: bool = parameter(False, 'Pause playback of a recording')
    playback_start: float = parameter(
        0.0,
        'Position in a recording at which playback starts, also when looping',
        unit='s',
        minimum=0.0,
        maximum=1e9,
        read_only=True,
    )
    playback_seek: float = parameter(
        NO_SEEK,
        'Playback jumps to every new value, counted from the first event; -1: no jump. Stamps '
        'never go back: after a jump to an earlier position they continue 1 ms after the latest. '
        'No effect once a recording has ended',
        unit='s',
        minimum=NO_SEEK,
        maximum=1e9,
    )
    playback_restamp: bool = parameter(
        False,
        'Move recorded stamps to the time of playback (at the start, at loops and jumps)',
        read_only=True,
    )
    playback_clock: bool = parameter(
        False,
        'Publish the recorded camera clock on /clock, for nodes with use_sim_time; the driver '
        'itself stays on the host clock',
        read_only=True,
    )
    playback_events_topic: str = parameter(
        '', f'Topic or stream of events to play. {_WHICH}', read_only=True
    )
    playback_image_topic: str = parameter(
        '', f'Topic or stream of frames to play. {_WHICH}', read_only=True
    )
    playback_imu_topic: str = parameter(
        '', f'Topic or stream of inertial samples to play. {_WHICH}', read_only=True
    )


@dataclass(frozen=True)
class DriverParameters(CameraParameters, PlaybackParameters, DeviceParameters):
    """All parameters: what to open, how to run it, and how to publish its data."""
