# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node; names are libcaer_driver's where they mean the same."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.biases import DEFAULT_BIASES, Bias, CurrentBias, VoltageBias, with_current
from mixtac_driver.configuration import Configuration, Region
from mixtac_driver.stream import StreamSettings
from mixtac_events.codec import ENCODINGS
from mixtac_node.parameters import parameter

CURRENT_BIASES = {
    'DiffBn': 'DiffBn',
    'ONBn': 'OnBn',
    'OFFBn': 'OffBn',
    'PrBp': 'PrBp',
    'PrSFBp': 'PrSFBp',
    'RefrBp': 'RefrBp',
}
"""Parameter names of coarse-fine biases and what they are called in DEFAULT_BIASES."""
VOLTAGE_BIASES = {'ADC_RefHigh': 'AdcRefHigh', 'ADC_RefLow': 'AdcRefLow'}


def _fixed(default: bool, description: str) -> bool:
    return parameter(default, description, read_only=True)


def _number(default: int, description: str, maximum: int, unit: str = '', minimum: int = 0) -> int:
    return parameter(
        default, description, unit=unit, minimum=minimum, maximum=maximum, read_only=True
    )


def _coarse(name: str, description: str) -> int:
    bias = DEFAULT_BIASES[name][1]
    default = bias.coarse if isinstance(bias, CurrentBias) else 0
    return parameter(default, f'{description}, coarse step', minimum=0, maximum=7)


def _fine(name: str, description: str) -> int:
    bias = DEFAULT_BIASES[name][1]
    default = bias.fine if isinstance(bias, CurrentBias) else 0
    return parameter(default, f'{description}, fine step', minimum=0, maximum=255)


@dataclass(frozen=True)
class DriverParameters:
    """What to open, how to run it, and how to publish what it sees."""

    device: str = parameter(
        'davis346',
        'What to open: davis346 for a camera on USB, virtual or virtual:/path/of/socket for the '
        'virtual sensor',
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
    event_message_size_threshold: int = _number(
        300_000, 'Longest payload of an event packet', 100_000_000, 'bytes', minimum=1000
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
    usb_transfer_size: int = _number(65536, 'Bytes per USB read', 1 << 22, 'bytes', minimum=512)
    usb_queue_size: int = _number(
        32 << 20, 'Bytes that may wait to be decoded', 1 << 30, 'bytes', minimum=1 << 16
    )
    usb_early_packet_delay: int = _number(
        1000, 'Time after which the camera sends what it has', 15_875, 'us', minimum=125
    )

    dvs_enabled: bool = _fixed(True, 'Events on')
    background_activity_filter_enabled: bool = _fixed(
        False,
        'The camera drops events that no neighbour supports; off, because the force estimator was '
        'trained on all events',
    )
    background_activity_filter_time: int = _number(
        8, 'Time within which a neighbour must have fired', 4095, '250 us'
    )
    refractory_period_enabled: bool = _fixed(False, 'The camera drops events soon after another')
    refractory_period_time: int = _number(1, 'Time within which it does', 4095, '250 us')
    roi_start_col: int = _number(0, 'First column of the events', 345)
    roi_start_row: int = _number(0, 'First row of the events', 259)
    roi_end_col: int = _number(345, 'Last column of the events', 345)
    roi_end_row: int = _number(259, 'Last row of the events', 259)
    skip_enabled: bool = _fixed(False, 'The camera drops one event in so many')
    skip_events_every: int = _number(5, 'Which one it drops', 255)
    polarity_flatten: bool = _fixed(False, 'All events become OFF')
    polarity_suppress: bool = _fixed(False, 'One polarity is dropped')
    polarity_suppress_type: bool = _fixed(False, 'Which: false OFF, true ON')

    aps_enabled: bool = _fixed(True, 'Frames on')
    aps_exposure: int = parameter(
        7000,
        'Exposure; the shipped force estimator was trained at the default',
        unit='us',
        minimum=1,
        maximum=1_000_000,
    )
    aps_frame_interval: int = parameter(
        40_000, 'Time from frame to frame', unit='us', minimum=1, maximum=8_388_607
    )
    aps_global_shutter: bool = _fixed(True, 'All pixels are exposed at once')
    aps_roi_start_col: int = _number(0, 'First column of the frames', 345)
    aps_roi_start_row: int = _number(0, 'First row of the frames', 259)
    aps_roi_end_col: int = _number(345, 'Last column of the frames', 345)
    aps_roi_end_row: int = _number(259, 'Last row of the frames', 259)

    imu_acc_enabled: bool = _fixed(True, 'Acceleration on')
    imu_gyro_enabled: bool = _fixed(True, 'Angular velocity on')
    imu_temp_enabled: bool = _fixed(True, 'Temperature on')
    imu_acc_scale: int = _number(1, 'Range of acceleration: 0 .. 3 are 2, 4, 8, 16 g', 3)
    imu_gyro_scale: int = _number(
        1, 'Range of angular velocity: 0 .. 3 are 250, 500, 1000, 2000 deg/s', 3
    )
    imu_low_pass_filter: int = _number(1, 'Low-pass filter of the unit', 7)
    imu_sample_rate_divider: int = _number(
        0, 'Sample rate is 1 kHz divided by this number plus one', 255
    )

    DiffBn_coarse: int = _coarse('DiffBn', 'Gain of the change detector')
    DiffBn_fine: int = _fine('DiffBn', 'Gain of the change detector')
    ONBn_coarse: int = _coarse('OnBn', 'Threshold of ON events')
    ONBn_fine: int = _fine('OnBn', 'Threshold of ON events')
    OFFBn_coarse: int = _coarse('OffBn', 'Threshold of OFF events')
    OFFBn_fine: int = _fine('OffBn', 'Threshold of OFF events')
    PrBp_coarse: int = _coarse('PrBp', 'Bandwidth of the photoreceptor')
    PrBp_fine: int = _fine('PrBp', 'Bandwidth of the photoreceptor')
    PrSFBp_coarse: int = _coarse('PrSFBp', 'Bandwidth of the source follower')
    PrSFBp_fine: int = _fine('PrSFBp', 'Bandwidth of the source follower')
    RefrBp_coarse: int = _coarse('RefrBp', 'Refractory period of the pixels')
    RefrBp_fine: int = _fine('RefrBp', 'Refractory period of the pixels')
    ADC_RefHigh_voltage: int = parameter(32, 'White level of frames', minimum=0, maximum=63)
    ADC_RefHigh_current: int = parameter(7, 'Its drive', minimum=0, maximum=7)
    ADC_RefLow_voltage: int = parameter(1, 'Black level of frames', minimum=0, maximum=63)
    ADC_RefLow_current: int = parameter(7, 'Its drive', minimum=0, maximum=7)


def camera_configuration(p: DriverParameters) -> Configuration:
    """Return the camera settings that node parameters stand for.

    Raises:
        ConfigurationError: They contradict each other.
    """
    configuration = Configuration(
        dvs_enabled=p.dvs_enabled,
        aps_enabled=p.aps_enabled,
        imu_accelerometer_enabled=p.imu_acc_enabled,
        imu_gyroscope_enabled=p.imu_gyro_enabled,
        imu_temperature_enabled=p.imu_temp_enabled,
        biases=_biases(p),
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
        imu_acceleration_scale=p.imu_acc_scale,
        imu_gyroscope_scale=p.imu_gyro_scale,
        early_packet_delay_us=p.usb_early_packet_delay,
    )
    configuration.check()
    return configuration


def stream_settings(p: DriverParameters) -> StreamSettings:
    """Return how data are to be taken from the camera."""
    return StreamSettings(
        transfer_size=p.usb_transfer_size,
        queue_size=p.usb_queue_size,
        silence_s=p.stream_timeout,
        confirmation_s=p.stream_timeout,
    )


def _biases(p: DriverParameters) -> dict[str, Bias]:
    biases: dict[str, Bias] = {}
    for parameter_name, name in CURRENT_BIASES.items():
        biases[name] = with_current(
            name, getattr(p, f'{parameter_name}_coarse'), getattr(p, f'{parameter_name}_fine')
        )
    for parameter_name, name in VOLTAGE_BIASES.items():
        biases[name] = VoltageBias(
            getattr(p, f'{parameter_name}_voltage'), getattr(p, f'{parameter_name}_current')
        )
    return biases
