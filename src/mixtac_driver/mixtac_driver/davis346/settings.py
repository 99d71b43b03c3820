# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the camera in physical units, their limits, and the node parameters for them.

Every setting may change while the camera runs.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING

from mixtac_driver.davis346.biases import DEFAULT_BIASES, Bias, number, switch
from mixtac_driver.davis346.model import (
    MAXIMUM_EXPOSURE_US,
    MAXIMUM_FRAME_INTERVAL_US,
    MAXIMUM_PULSE_US,
    PIXEL_FILTERS,
)
from mixtac_driver.davis346.registers import Chip
from mixtac_driver.errors import ConfigurationError
from mixtac_node.parameters import parameter

if TYPE_CHECKING:
    from collections.abc import Mapping


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


@dataclass(frozen=True)
class DvsParameters:
    """Events: all of it may change while the node runs."""

    dvs_enabled: bool = switch(True, 'Events on')
    background_activity_filter_enabled: bool = switch(
        False,
        'The camera drops events that no neighbour supports; off, because the force estimator was '
        'trained on all events',
    )
    background_activity_filter_time: int = number(
        8, 'Time within which a neighbour must have fired', 4095, '250 us'
    )
    refractory_period_enabled: bool = switch(False, 'The camera drops events soon after another')
    refractory_period_time: int = number(1, 'Time within which it does', 4095, '250 us')
    roi_start_col: int = number(0, 'First column of the events', 345)
    roi_start_row: int = number(0, 'First row of the events', 259)
    roi_end_col: int = number(345, 'Last column of the events', 345)
    roi_end_row: int = number(259, 'Last row of the events', 259)
    skip_enabled: bool = switch(False, 'The camera drops one event in so many')
    skip_events_every: int = number(5, 'Which one it drops', 255)
    polarity_flatten: bool = switch(False, 'All events become OFF')
    polarity_suppress: bool = switch(False, 'One polarity is dropped')
    polarity_suppress_type: bool = switch(False, 'Which: false OFF, true ON')
    dvs_pixel_mask: str = parameter(
        '',
        'Grey PNG image of 346 x 260 pixels: events of pixels that are not black are dropped, '
        'those of the eight brightest by the camera itself; empty for none',
    )
    hot_pixels_duration: float = parameter(
        2.0,
        'Time over which the service find_hot_pixels counts; keep the scene still',
        unit='s',
        minimum=0.1,
        maximum=4.0,
    )
    hot_pixels_minimum_rate: float = parameter(
        10.0,
        'Pixels with fewer events than this are not hot',
        unit='1/s',
        minimum=0.1,
        maximum=1e6,
    )
    hot_pixels_factor: float = parameter(
        10.0,
        'Pixels with fewer events than so many times the fourth noisiest pixel around them are '
        'not hot',
        minimum=1.0,
        maximum=1e6,
    )
    hot_pixels_file: str = parameter(
        '',
        'Where the service find_hot_pixels writes the mask, as an image for dvs_pixel_mask; empty '
        'for nowhere',
    )


@dataclass(frozen=True)
class ApsParameters:
    """Frames: all of it may change while the node runs."""

    aps_enabled: bool = switch(True, 'Frames on')
    aps_exposure: int = number(
        7000,
        'Exposure; the shipped force estimator was trained at the default',
        MAXIMUM_EXPOSURE_US,
        'us',
        minimum=1,
    )
    aps_frame_interval: int = number(
        40_000,
        'Time from frame to frame; 0 for as soon as can be',
        MAXIMUM_FRAME_INTERVAL_US,
        'us',
    )
    aps_global_shutter: bool = switch(True, 'All pixels are exposed at once')
    aps_roi_start_col: int = number(0, 'First column of the frames', 345)
    aps_roi_start_row: int = number(0, 'First row of the frames', 259)
    aps_roi_end_col: int = number(345, 'Last column of the frames', 345)
    aps_roi_end_row: int = number(259, 'Last row of the frames', 259)
    aps_auto_exposure: bool = switch(
        False, 'The driver sets the exposure by the brightness of the frames, from aps_exposure on'
    )
    aps_auto_exposure_target: float = parameter(
        0.35,
        'Mean brightness that auto-exposure aims at, as a fraction of full scale',
        minimum=0.05,
        maximum=0.9,
    )
    aps_auto_exposure_minimum: int = number(
        20, 'Shortest exposure that auto-exposure sets', MAXIMUM_EXPOSURE_US, 'us', minimum=1
    )
    aps_auto_exposure_maximum: int = number(
        30_000, 'Longest exposure that auto-exposure sets', MAXIMUM_EXPOSURE_US, 'us', minimum=1
    )


@dataclass(frozen=True)
class ImuParameters:
    """Inertial unit: all of it may change while the node runs."""

    imu_acc_enabled: bool = switch(True, 'Acceleration on')
    imu_gyro_enabled: bool = switch(True, 'Angular velocity on')
    imu_temp_enabled: bool = switch(True, 'Temperature on')
    imu_acc_scale: int = number(1, 'Range of acceleration: 0 .. 3 are 2, 4, 8, 16 g', 3)
    imu_gyro_scale: int = number(
        1, 'Range of angular velocity: 0 .. 3 are 250, 500, 1000, 2000 deg/s', 3
    )
    imu_low_pass_filter: int = number(
        1, 'Low-pass filter of acceleration; in an MPU6050 of angular velocity too', 7
    )
    imu_gyro_low_pass_filter: int = number(
        1, 'Low-pass filter of angular velocity in an MPU9250', 7
    )
    imu_sample_rate_divider: int = number(
        0,
        'Sample rate is 1 kHz divided by this number plus one (8 kHz where the filter is 0 or 7)',
        255,
    )


@dataclass(frozen=True)
class ExternalParameters:
    """Synchronisation connector: all of it may change while the node runs."""

    external_input_enabled: bool = switch(True, 'Detector of the input on')
    external_input_rising: bool = switch(False, 'It reports rising edges')
    external_input_falling: bool = switch(False, 'It reports falling edges')
    external_input_pulses: bool = switch(True, 'It reports pulses')
    external_input_pulse_polarity: bool = switch(True, 'Level of a pulse: true high, false low')
    external_input_pulse_length: int = number(
        10, 'Shortest pulse', MAXIMUM_PULSE_US, 'us', minimum=1
    )
    generator_enabled: bool = switch(False, 'Pulse generator at the output on')
    generator_polarity: bool = switch(True, 'Level of its pulses: true high, false low')
    generator_interval: int = number(
        10, 'Time from pulse to pulse', MAXIMUM_PULSE_US, 'us', minimum=2
    )
    generator_length: int = number(
        5, 'Length of its pulses, less than the interval', MAXIMUM_PULSE_US, 'us', minimum=1
    )
    generator_inject_on_rising: bool = switch(False, 'It reports its own rising edges')
    generator_inject_on_falling: bool = switch(False, 'It reports its own falling edges')


CHIP_REGISTERS = {
    'chip_digital_mux_0': Chip.DIGITAL_MUX_0,
    'chip_digital_mux_1': Chip.DIGITAL_MUX_1,
    'chip_digital_mux_2': Chip.DIGITAL_MUX_2,
    'chip_digital_mux_3': Chip.DIGITAL_MUX_3,
    'chip_analog_mux_0': Chip.ANALOG_MUX_0,
    'chip_analog_mux_1': Chip.ANALOG_MUX_1,
    'chip_analog_mux_2': Chip.ANALOG_MUX_2,
    'chip_bias_mux_0': Chip.BIAS_MUX_0,
    'chip_reset_calibration_neuron': Chip.RESET_CALIBRATION_NEURON,
    'chip_type_n_calibration_neuron': Chip.TYPE_N_CALIBRATION_NEURON,
    'chip_reset_test_pixel': Chip.RESET_TEST_PIXEL,
    'chip_aer_na_row': Chip.AER_NAROW,
    'chip_use_a_out': Chip.USE_A_OUT,
    'chip_select_gray_counter': Chip.SELECT_GRAY_COUNTER,
    'chip_test_adc': Chip.TEST_ADC,
}
"""Parameter names and their registers; Chip.GLOBAL_SHUTTER follows aps_global_shutter."""


@dataclass(frozen=True)
class ChipParameters:
    """For measurements on the chip itself: leave them alone unless you have its data sheet."""

    chip_digital_mux_0: int = number(0, 'Signal on the digital test pin 0', 15)
    chip_digital_mux_1: int = number(0, 'Signal on the digital test pin 1', 15)
    chip_digital_mux_2: int = number(0, 'Signal on the digital test pin 2', 15)
    chip_digital_mux_3: int = number(0, 'Signal on the digital test pin 3', 15)
    chip_analog_mux_0: int = number(0, 'Signal on the analogue test pin 0', 15)
    chip_analog_mux_1: int = number(0, 'Signal on the analogue test pin 1', 15)
    chip_analog_mux_2: int = number(0, 'Signal on the analogue test pin 2', 15)
    chip_bias_mux_0: int = number(0, 'Bias on the bias test pin', 15)
    chip_reset_calibration_neuron: bool = switch(True, 'Holds the calibration neuron in reset')
    chip_type_n_calibration_neuron: bool = switch(
        False, 'Calibration neuron measures N-type biases'
    )
    chip_reset_test_pixel: bool = switch(True, 'Holds the test pixel in reset')
    chip_aer_na_row: bool = switch(False, 'Other arbitration of the event rows (nArow)')
    chip_use_a_out: bool = switch(
        False, 'Frames through the analogue output pad instead of the on-chip ADC'
    )
    chip_select_gray_counter: bool = switch(True, 'On-chip ADC counts in Gray code')
    chip_test_adc: bool = switch(False, 'On-chip ADC measures AdcTestVoltage')


def chip_registers(p: ChipParameters) -> dict[Chip, int]:
    """Return the register values that parameters stand for."""
    return {register: int(getattr(p, name)) for name, register in CHIP_REGISTERS.items()}
