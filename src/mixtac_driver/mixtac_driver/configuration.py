# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the camera in everyday units, and what of them a camera can take."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from mixtac_driver.biases import DEFAULT_BIASES, Bias
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.registers import Chip

if TYPE_CHECKING:
    from collections.abc import Mapping

PIXEL_FILTERS = 8
MAXIMUM_EXPOSURE_US = 4_194_303
MAXIMUM_FRAME_INTERVAL_US = 8_388_607
MAXIMUM_PULSE_US = 1_048_575
CHIP_DEFAULTS: Mapping[Chip, int] = MappingProxyType(
    {
        **{Chip(number): 0 for number in range(128, 136)},
        Chip.RESET_CALIBRATION_NEURON: 1,
        Chip.TYPE_N_CALIBRATION_NEURON: 0,
        Chip.RESET_TEST_PIXEL: 1,
        Chip.AER_NAROW: 0,
        Chip.USE_A_OUT: 0,
        Chip.SELECT_GRAY_COUNTER: 1,
        Chip.TEST_ADC: 0,
    }
)
"""Chip registers in the order of writing; the shutter is set elsewhere."""
LARGEST_MULTIPLEXER = 15
"""Chip multiplexers (up to BIAS_MUX_0) have four bits, the other registers one."""


@dataclass(frozen=True, slots=True)
class Region:
    """A rectangle of pixels in user orientation; both ends belong to it."""

    start_column: int = 0
    start_row: int = 0
    end_column: int = 345
    end_row: int = 259

    def check(self, name: str) -> None:
        """Refuse a rectangle that is empty or leaves the array.

        Args:
            name: What it is, for the message.

        Raises:
            ConfigurationError: As said.
        """
        columns_fit = 0 <= self.start_column <= self.end_column <= 345
        if not (columns_fit and 0 <= self.start_row <= self.end_row <= 259):
            raise ConfigurationError(
                f'{name} columns {self.start_column} .. {self.end_column}, rows {self.start_row} '
                f'.. {self.end_row}: give start <= end within 0 .. 345 and 0 .. 259'
            )


@dataclass(frozen=True, slots=True)
class Configuration:
    """All settings; the defaults are those of libcaer 3.3.

    Times are in microseconds, filter times in steps of 250 us.

    Attributes:
        biases: Biases that differ from the default table, by name.
        chip: Chip registers that differ from CHIP_DEFAULTS.
        pixel_filter: Up to eight (column, row) whose events the camera drops.
        imu_low_pass_filter: Filter of the acceleration; of the rotation too in an MPU6050.
        imu_gyroscope_low_pass_filter: Filter of the rotation in an MPU9250.
        detect_pulses: Detect pulses of at least `pulse_length_us` with level `pulse_polarity`.
        generator_interval_us: Time from pulse to pulse of the generator.
        inject_on_rising: The generator puts a rising edge word into the stream with each of its
            rising edges; likewise for falling ones.
    """

    dvs_enabled: bool = True
    aps_enabled: bool = True
    imu_accelerometer_enabled: bool = True
    imu_gyroscope_enabled: bool = True
    imu_temperature_enabled: bool = True
    external_input_enabled: bool = True
    biases: Mapping[str, Bias] = field(default_factory=dict)
    chip: Mapping[Chip, int] = field(default_factory=dict)
    pixel_filter: tuple[tuple[int, int], ...] = ()
    background_activity_filter_enabled: bool = True
    background_activity_filter_time: int = 8
    refractory_period_enabled: bool = False
    refractory_period_time: int = 1
    roi: Region = Region()
    skip_enabled: bool = False
    skip_events_every: int = 5
    polarity_flatten: bool = False
    polarity_suppress: bool = False
    polarity_suppress_type: bool = False
    aps_global_shutter: bool = True
    aps_roi: Region = Region()
    aps_exposure_us: int = 4000
    aps_frame_interval_us: int = 40000
    imu_sample_rate_divider: int = 0
    imu_low_pass_filter: int = 1
    imu_gyroscope_low_pass_filter: int = 1
    imu_acceleration_scale: int = 1
    imu_gyroscope_scale: int = 1
    detect_rising: bool = False
    detect_falling: bool = False
    detect_pulses: bool = True
    pulse_polarity: bool = True
    pulse_length_us: int = 10
    generator_enabled: bool = False
    generator_polarity: bool = True
    generator_interval_us: int = 10
    generator_length_us: int = 5
    inject_on_rising: bool = False
    inject_on_falling: bool = False
    early_packet_delay_us: int = 1000

    def check(self) -> None:
        """Refuse settings that the registers cannot hold.

        Raises:
            ConfigurationError: Names the setting, its value and what is allowed.
        """
        for name, maximum in _LIMITS.items():
            value = getattr(self, name)
            if not 0 <= value <= maximum:
                raise ConfigurationError(f'{name} = {value}: outside 0 .. {maximum}')
        self.roi.check('roi')
        self.aps_roi.check('aps_roi')
        self._check_pixels()
        self._check_chip()
        self._check_generator()

    def _check_pixels(self) -> None:
        if len(self.pixel_filter) > PIXEL_FILTERS:
            raise ConfigurationError(
                f'{len(self.pixel_filter)} pixels filtered; the camera has {PIXEL_FILTERS} filters'
            )
        for column, row in self.pixel_filter:
            Region(column, row, column, row).check('pixel_filter')

    def _check_chip(self) -> None:
        unknown = sorted(set(self.biases) - set(DEFAULT_BIASES))
        if unknown:
            raise ConfigurationError(
                f'bias {unknown[0]} is unknown; there are {", ".join(DEFAULT_BIASES)}'
            )
        for name, bias in self.biases.items():
            if type(bias) is not type(DEFAULT_BIASES[name][1]):
                wanted = type(DEFAULT_BIASES[name][1]).__name__
                raise ConfigurationError(f'bias {name} = {bias}: give a {wanted}')
            bias.encode()
        for register, value in self.chip.items():
            maximum = LARGEST_MULTIPLEXER if register <= Chip.BIAS_MUX_0 else 1
            if register not in CHIP_DEFAULTS or not 0 <= value <= maximum:
                raise ConfigurationError(
                    f'chip register {int(register)} = {value}: give one of '
                    f'{", ".join(str(int(known)) for known in CHIP_DEFAULTS)} a value of 0 .. '
                    f'{maximum}'
                )

    def _check_generator(self) -> None:
        if self.generator_length_us >= self.generator_interval_us:
            raise ConfigurationError(
                f'generator_length_us = {self.generator_length_us}: give less than the interval '
                f'of {self.generator_interval_us} us'
            )


_LIMITS = {
    'background_activity_filter_time': 4095,
    'refractory_period_time': 4095,
    'skip_events_every': 255,
    'aps_exposure_us': MAXIMUM_EXPOSURE_US,
    'aps_frame_interval_us': MAXIMUM_FRAME_INTERVAL_US,
    'imu_sample_rate_divider': 255,
    'imu_low_pass_filter': 7,
    'imu_gyroscope_low_pass_filter': 7,
    'imu_acceleration_scale': 3,
    'imu_gyroscope_scale': 3,
    'pulse_length_us': MAXIMUM_PULSE_US,
    'generator_interval_us': MAXIMUM_PULSE_US,
    'generator_length_us': MAXIMUM_PULSE_US,
    'early_packet_delay_us': 15875,
}
