# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node; names follow libcaer_driver where the meaning is the same."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.camera import StreamSettings
from mixtac_driver.davis346.biases import BiasParameters, biases, number
from mixtac_driver.davis346.settings import (
    ApsParameters,
    ChipParameters,
    Configuration,
    DvsParameters,
    ExternalParameters,
    ImuParameters,
    Region,
    chip_registers,
)
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.supervisor import RecoveryParameters
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


@dataclass(frozen=True)
class CalibrationParameters:
    """Where the calibration is, and what it is used for."""

    camera_name: str = parameter(
        'davis346',
        'Name of the camera in its calibration: letters, digits and _',
        read_only=True,
    )
    camerainfo_url: str = parameter(
        '',
        'Calibration written by `mixtac calibrate`: file:///path, package://name/path or a path, '
        'where ${NAME} is camera_name and ${ROS_HOME} is ~/.ros unless set; empty is '
        'file://${ROS_HOME}/camera_info/${NAME}.yaml',
        read_only=True,
    )
    undistort_frames: bool = parameter(
        False,
        'Publish frames without the distortion of the lens as well; needs a calibration',
        read_only=True,
    )
    undistort_events: bool = parameter(
        False,
        'Publish events at undistorted pixels as well; needs a calibration',
        read_only=True,
    )


# The fields come in the order of the bases from last to first.
NO_SEEK = -1.0
"""Value of `playback_seek` that does nothing."""
_WHICH = 'empty takes the only one, none plays none'


@dataclass(frozen=True)
class PlaybackParameters:
    """How a recording is played."""

    playback_rate: float = parameter(
        1.0,
        'Speed of a recording: 1 is real time, 0 as fast as its subscribers allow',
        minimum=0.0,
        maximum=1000.0,
    )
    playback_loop: bool = parameter(
        False,
        'A recording starts again at its end; stamps go on by its length and 1 ms',
    )
    playback_paused: bool = parameter(False, 'A recording stands still')
    playback_start: float = parameter(
        0.0,
        'Where in a recording to begin, also when looping',
        unit='s',
        minimum=0.0,
        maximum=1e9,
        read_only=True,
    )
    playback_seek: float = parameter(
        NO_SEEK,
        'A new value jumps there, counted from the first event; stamps never go back: after a jump '
        'to an earlier place they go on 1 ms after the latest; -1 does nothing; without effect '
        'once a recording has ended',
        unit='s',
        minimum=NO_SEEK,
        maximum=1e9,
    )
    playback_restamp: bool = parameter(
        False,
        'Stamps are moved to the time of playing (at the start, at loops and jumps) instead of '
        'being those recorded',
        read_only=True,
    )
    playback_clock: bool = parameter(
        False,
        'The recorded camera clock is published on /clock, for nodes with use_sim_time; the driver '
        'itself stays on the host clock',
        read_only=True,
    )
    playback_events_topic: str = parameter(
        '', f'Which topic or stream of events to play; {_WHICH}', read_only=True
    )
    playback_image_topic: str = parameter(
        '', f'Which topic or stream of frames to play; {_WHICH}', read_only=True
    )
    playback_imu_topic: str = parameter(
        '', f'Which topic or stream of inertial samples to play; {_WHICH}', read_only=True
    )


@dataclass(frozen=True)
class DriverParameters(
    ChipParameters,
    BiasParameters,
    ExternalParameters,
    ImuParameters,
    ApsParameters,
    DvsParameters,
    CalibrationParameters,
    PlaybackParameters,
    RecoveryParameters,
    DeviceParameters,
):
    """What to open, how to run it, and how to publish what it sees."""


def camera_configuration(
    p: DriverParameters, pixel_filter: tuple[tuple[int, int], ...] = ()
) -> Configuration:
    """Return the camera settings that node parameters stand for.

    Args:
        p: The parameters.
        pixel_filter: Up to eight (column, row) that the camera itself masks.

    Raises:
        ConfigurationError: They contradict each other.
    """
    configuration = Configuration(
        dvs_enabled=p.dvs_enabled,
        aps_enabled=p.aps_enabled,
        imu_accelerometer_enabled=p.imu_acc_enabled,
        imu_gyroscope_enabled=p.imu_gyro_enabled,
        imu_temperature_enabled=p.imu_temp_enabled,
        external_input_enabled=p.external_input_enabled,
        biases=biases(p),
        chip=chip_registers(p),
        pixel_filter=pixel_filter,
        background_activity_filter_enabled=p.background_activity_filter_enabled,
        background_activity_filter_time=p.background_activity_filter_time,
        refractory_period_enabled=p.refractory_period_enabled,
        refractory_period_time=p.refractory_period_time,
        roi=Region(p.roi_start_col, p.roi_start_row, p.roi_end_col, p.roi_end_row),
        skip_enabled=p.skip_enabled,
        skip_events_every=p.skip_events_every,
        polarity_flatten=p.polarity_flatten,
        polarity_suppress=p.polarity_suppress,
        polarity_suppress_type=p.polarity_suppress_type,
        aps_global_shutter=p.aps_global_shutter,
        aps_roi=Region(
            p.aps_roi_start_col, p.aps_roi_start_row, p.aps_roi_end_col, p.aps_roi_end_row
        ),
        aps_exposure_us=p.aps_exposure,
        aps_frame_interval_us=p.aps_frame_interval,
        imu_sample_rate_divider=p.imu_sample_rate_divider,
        imu_low_pass_filter=p.imu_low_pass_filter,
        imu_gyroscope_low_pass_filter=p.imu_gyro_low_pass_filter,
        imu_acceleration_scale=p.imu_acc_scale,
        imu_gyroscope_scale=p.imu_gyro_scale,
        detect_rising=p.external_input_rising,
        detect_falling=p.external_input_falling,
        detect_pulses=p.external_input_pulses,
        pulse_polarity=p.external_input_pulse_polarity,
        pulse_length_us=p.external_input_pulse_length,
        generator_enabled=p.generator_enabled,
        generator_polarity=p.generator_polarity,
        generator_interval_us=p.generator_interval,
        generator_length_us=p.generator_length,
        inject_on_rising=p.generator_inject_on_rising,
        inject_on_falling=p.generator_inject_on_falling,
        early_packet_delay_us=p.usb_early_packet_delay,
    )
    configuration.check()
    if p.aps_auto_exposure_minimum > p.aps_auto_exposure_maximum:
        raise ConfigurationError(
            f'aps_auto_exposure_minimum = {p.aps_auto_exposure_minimum}: give at most '
            f'aps_auto_exposure_maximum = {p.aps_auto_exposure_maximum}'
        )
    return configuration
