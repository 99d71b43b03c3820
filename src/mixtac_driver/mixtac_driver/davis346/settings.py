# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the camera in physical units: the node parameters are the settings.

Every setting may change while the camera runs. Names follow libcaer_driver where the meaning is the
same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from mixtac_core.node.parameters import parameter, specs
from mixtac_driver.davis346.biases import BiasParameters
from mixtac_driver.davis346.model import DAVIS346
from mixtac_driver.errors import ConfigurationError

LAST_COLUMN = DAVIS346.width - 1
"""Last column of the pixel array."""
LAST_ROW = DAVIS346.height - 1
"""Last row of the pixel array."""
MAXIMUM_EXPOSURE_US = 4_194_303
"""Longest exposure that the logic can count [us]."""
MAXIMUM_FRAME_INTERVAL_US = 8_388_607
"""Longest frame interval that the logic can count [us]."""
MAXIMUM_PULSE_US = 1_048_575
"""Longest pulse that the logic can count [us]."""


class Region(NamedTuple):
    """A rectangle of pixels in user orientation; both ends belong to it."""

    start_column: int
    start_row: int
    end_column: int
    end_row: int

    def check(self, name: str) -> None:
        """Raise if the rectangle is empty.

        Args:
            name: Prefix of its parameters, for the message.

        Raises:
            ConfigurationError: It is empty.
        """
        if self.start_column > self.end_column or self.start_row > self.end_row:
            raise ConfigurationError(
                f'{name} columns {self.start_column} .. {self.end_column}, rows {self.start_row} '
                f'.. {self.end_row}: give start <= end'
            )

    def within(self, width: int, height: int, name: str) -> Region:
        """Return the part of the rectangle that lies inside a pixel array.

        Args:
            width: Columns of the array.
            height: Rows of the array.
            name: Prefix of its parameters, for the message.

        Raises:
            ConfigurationError: No part of it does.
        """
        end_column, end_row = min(self.end_column, width - 1), min(self.end_row, height - 1)
        region = self._replace(end_column=end_column, end_row=end_row)
        region.check(name)
        return region


@dataclass(frozen=True)
class SensorParameters:
    """Settings of the event pixels, frame pixels, inertial unit, connector and chip.

    Attributes:
        dvs_enabled: Enable event output
        background_activity_filter_enabled: Background activity filter: the camera drops events that
            no neighbouring pixel supports. Off by default, because the force estimator was trained
            on all events
        background_activity_filter_time: Background activity filter: longest time since an event of
            a neighbouring pixel, in steps of 250 us
        refractory_period_enabled: Refractory period filter: the camera drops events soon after one
            of the same pixel
        refractory_period_time: Refractory period, in steps of 250 us
        roi_start_col: First column of the events
        roi_start_row: First row of the events
        roi_end_col: Last column of the events
        roi_end_row: Last row of the events
        skip_enabled: Enable dropping of every n-th event in the camera
        skip_events_every: Drop every n-th event; see skip_enabled
        polarity_flatten: Report all events as OFF
        polarity_suppress: Enable dropping of the events of one polarity
        polarity_suppress_type: Polarity to drop: false OFF, true ON; see polarity_suppress
        dvs_pixel_mask: Pixel mask: grey 8-bit PNG image in the size of the camera. Events of pixels
            that are not black are dropped, those of the eight brightest by the camera itself.
            Empty: no mask
        hot_pixels_duration: Time over which the service find_hot_pixels counts events; keep the
            scene still
        hot_pixels_file: Name of a file, such as left_mask.png, in the state folder ($MIXTAC_HOME,
            by default ~/.local/state/mixtac). The service find_hot_pixels writes the mask to it;
            the driver reads it at start. Empty: the mask lasts until the driver ends
        aps_enabled: Enable frame output
        aps_exposure: Exposure time; the shipped force estimator was trained at the default
        aps_frame_interval: Frame interval; 0: as fast as possible
        aps_global_shutter: Global shutter: expose all pixels at the same time
        aps_roi_start_col: First column of the frames
        aps_roi_start_row: First row of the frames
        aps_roi_end_col: Last column of the frames
        aps_roi_end_row: Last row of the frames
        aps_auto_exposure: Automatic exposure: the driver adjusts the exposure to the brightness of
            the frames, starting from aps_exposure
        aps_auto_exposure_target: Target mean brightness of automatic exposure, as a fraction of
            full scale
        aps_auto_exposure_minimum: Shortest exposure time of automatic exposure
        aps_auto_exposure_maximum: Longest exposure time of automatic exposure
        imu_acc_enabled: Enable the accelerometer
        imu_gyro_enabled: Enable the gyroscope
        imu_temp_enabled: Enable the temperature sensor of the inertial unit
        imu_acc_scale: Accelerometer range: 0 .. 3 for 2, 4, 8, 16 g
        imu_gyro_scale: Gyroscope range: 0 .. 3 for 250, 500, 1000, 2000 deg/s
        imu_low_pass_filter: Low-pass filter of the accelerometer; on an MPU6050 also of the
            gyroscope
        imu_gyro_low_pass_filter: Low-pass filter of the gyroscope on an MPU9250
        imu_sample_rate_divider: Sample rate divider n of the inertial unit: the rate is 1 kHz / (n
            + 1), or 8 kHz / (n + 1) where the low-pass filter is 0 or 7
        external_input_enabled: Enable edge detection at the synchronisation input
        external_input_rising: Report rising edges at the synchronisation input
        external_input_falling: Report falling edges at the synchronisation input
        external_input_pulses: Report pulses at the synchronisation input
        external_input_pulse_polarity: Level of the pulses to report at the synchronisation input:
            true high, false low
        external_input_pulse_length: Shortest pulse to report at the synchronisation input
        generator_enabled: Enable the pulse generator at the synchronisation output
        generator_polarity: Level of the generated pulses: true high, false low
        generator_interval: Period of the generated pulses
        generator_length: Length of the generated pulses; shorter than generator_interval
        generator_inject_on_rising: Report rising edges of the pulse generator
        generator_inject_on_falling: Report falling edges of the pulse generator
        usb_early_packet_delay: Longest time that the camera holds back data before it sends a USB
            packet
    """

    dvs_enabled: bool = parameter(True)
    background_activity_filter_enabled: bool = parameter(False)
    background_activity_filter_time: int = parameter(8, within=(0, 4095))
    refractory_period_enabled: bool = parameter(False)
    refractory_period_time: int = parameter(1, within=(0, 4095))
    roi_start_col: int = parameter(0, within=(0, LAST_COLUMN))
    roi_start_row: int = parameter(0, within=(0, LAST_ROW))
    roi_end_col: int = parameter(LAST_COLUMN, within=(0, LAST_COLUMN))
    roi_end_row: int = parameter(LAST_ROW, within=(0, LAST_ROW))
    skip_enabled: bool = parameter(False)
    skip_events_every: int = parameter(5, within=(0, 255))
    polarity_flatten: bool = parameter(False)
    polarity_suppress: bool = parameter(False)
    polarity_suppress_type: bool = parameter(False)
    dvs_pixel_mask: str = parameter('')
    hot_pixels_duration: float = parameter(2.0, unit='s', within=(0.1, 4.0))
    hot_pixels_file: str = parameter('')

    aps_enabled: bool = parameter(True)
    aps_exposure: int = parameter(7000, unit='us', within=(1, MAXIMUM_EXPOSURE_US))
    aps_frame_interval: int = parameter(40_000, unit='us', within=(0, MAXIMUM_FRAME_INTERVAL_US))
    aps_global_shutter: bool = parameter(True)
    aps_roi_start_col: int = parameter(0, within=(0, LAST_COLUMN))
    aps_roi_start_row: int = parameter(0, within=(0, LAST_ROW))
    aps_roi_end_col: int = parameter(LAST_COLUMN, within=(0, LAST_COLUMN))
    aps_roi_end_row: int = parameter(LAST_ROW, within=(0, LAST_ROW))
    aps_auto_exposure: bool = parameter(False)
    aps_auto_exposure_target: float = parameter(0.35, within=(0.05, 0.9))
    aps_auto_exposure_minimum: int = parameter(20, unit='us', within=(1, MAXIMUM_EXPOSURE_US))
    aps_auto_exposure_maximum: int = parameter(30_000, unit='us', within=(1, MAXIMUM_EXPOSURE_US))

    imu_acc_enabled: bool = parameter(True)
    imu_gyro_enabled: bool = parameter(True)
    imu_temp_enabled: bool = parameter(True)
    imu_acc_scale: int = parameter(1, within=(0, 3))
    imu_gyro_scale: int = parameter(1, within=(0, 3))
    imu_low_pass_filter: int = parameter(1, within=(0, 7))
    imu_gyro_low_pass_filter: int = parameter(1, within=(0, 7))
    imu_sample_rate_divider: int = parameter(0, within=(0, 255))

    external_input_enabled: bool = parameter(True)
    external_input_rising: bool = parameter(False)
    external_input_falling: bool = parameter(False)
    external_input_pulses: bool = parameter(True)
    external_input_pulse_polarity: bool = parameter(True)
    external_input_pulse_length: int = parameter(10, unit='us', within=(1, MAXIMUM_PULSE_US))
    generator_enabled: bool = parameter(False)
    generator_polarity: bool = parameter(True)
    generator_interval: int = parameter(10, unit='us', within=(2, MAXIMUM_PULSE_US))
    generator_length: int = parameter(5, unit='us', within=(1, MAXIMUM_PULSE_US))
    generator_inject_on_rising: bool = parameter(False)
    generator_inject_on_falling: bool = parameter(False)

    usb_early_packet_delay: int = parameter(200, unit='us', within=(125, 15_875))


@dataclass(frozen=True)
class CameraParameters(BiasParameters, SensorParameters):
    """All settings of a camera."""

    @property
    def roi(self) -> Region:
        """Region whose events are sent."""
        return Region(self.roi_start_col, self.roi_start_row, self.roi_end_col, self.roi_end_row)

    @property
    def aps_roi(self) -> Region:
        """Region that frames cover."""
        return Region(
            self.aps_roi_start_col,
            self.aps_roi_start_row,
            self.aps_roi_end_col,
            self.aps_roi_end_row,
        )

    def check(self) -> None:
        """Raise if a value is out of range, or if values contradict each other.

        Raises:
            ConfigurationError: Two values contradict each other.
            ParameterError: A value is out of range.
        """
        for spec in _SPECS:
            spec.check(getattr(self, spec.name))
        self.roi.check('roi')
        self.aps_roi.check('aps_roi')
        for name, limit, apart in (
            ('generator_length', 'generator_interval', 1),
            ('aps_auto_exposure_minimum', 'aps_auto_exposure_maximum', 0),
        ):
            value, most = getattr(self, name), getattr(self, limit) - apart
            if value > most:
                raise ConfigurationError(f'{name} = {value}: give at most {most}, by {limit}')


_SPECS = specs(CameraParameters)
