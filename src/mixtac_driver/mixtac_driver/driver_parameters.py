# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the driver node; names are libcaer_driver's where they mean the same."""

from __future__ import annotations

from dataclasses import dataclass

from mixtac_driver.aps_parameters import ApsParameters
from mixtac_driver.bias_parameters import BiasParameters, biases
from mixtac_driver.calibration.calibration_parameters import CalibrationParameters
from mixtac_driver.chip_parameters import ChipParameters, chip_registers
from mixtac_driver.configuration import Configuration, Region
from mixtac_driver.device_parameters import DeviceParameters
from mixtac_driver.dvs_parameters import DvsParameters
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.external_parameters import ExternalParameters
from mixtac_driver.imu_parameters import ImuParameters
from mixtac_driver.recordings.playback_parameters import PlaybackParameters
from mixtac_driver.recovery_parameters import RecoveryParameters


# The fields come in the order of the bases from last to first.
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
