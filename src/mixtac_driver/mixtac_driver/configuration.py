# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the camera in everyday units, and the register writes they stand for."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mixtac_driver.biases import DEFAULT_BIASES, Bias
from mixtac_driver.errors import ConfigurationError
from mixtac_driver.registers import (
    Aps,
    Chip,
    Dvs,
    ExternalInput,
    Imu,
    Module,
    Mux,
    Usb,
    Write,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mixtac_driver.identity import Clocks, Identity

PIXEL_FILTERS = 8
MAXIMUM_EXPOSURE_US = 4_194_303
MAXIMUM_FRAME_INTERVAL_US = 8_388_607
CHIP_DEFAULTS = (
    *((Chip(number), 0) for number in range(128, 136)),
    (Chip.RESET_CALIBRATION_NEURON, 1),
    (Chip.TYPE_N_CALIBRATION_NEURON, 0),
    (Chip.RESET_TEST_PIXEL, 1),
    (Chip.AER_NAROW, 0),
    (Chip.USE_A_OUT, 0),
    (Chip.SELECT_GRAY_COUNTER, 1),
    (Chip.TEST_ADC, 0),
)


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
        pixel_filter: Up to eight (column, row) whose events the camera drops.
    """

    dvs_enabled: bool = True
    aps_enabled: bool = True
    imu_accelerometer_enabled: bool = True
    imu_gyroscope_enabled: bool = True
    imu_temperature_enabled: bool = True
    external_input_enabled: bool = True
    biases: Mapping[str, Bias] = field(default_factory=dict)
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
    imu_acceleration_scale: int = 1
    imu_gyroscope_scale: int = 1
    detect_rising: bool = False
    detect_falling: bool = False
    detect_pulses: bool = True
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
        if len(self.pixel_filter) > PIXEL_FILTERS:
            raise ConfigurationError(
                f'{len(self.pixel_filter)} pixels filtered; the camera has {PIXEL_FILTERS} filters'
            )
        for column, row in self.pixel_filter:
            Region(column, row, column, row).check('pixel_filter')
        unknown = sorted(set(self.biases) - set(DEFAULT_BIASES))
        if unknown:
            raise ConfigurationError(
                f'bias {unknown[0]} is unknown; there are {", ".join(DEFAULT_BIASES)}'
            )


_LIMITS = {
    'background_activity_filter_time': 4095,
    'refractory_period_time': 4095,
    'skip_events_every': 255,
    'aps_exposure_us': MAXIMUM_EXPOSURE_US,
    'aps_frame_interval_us': MAXIMUM_FRAME_INTERVAL_US,
    'imu_sample_rate_divider': 255,
    'imu_low_pass_filter': 7,
    'imu_acceleration_scale': 3,
    'imu_gyroscope_scale': 3,
    'early_packet_delay_us': 15875,
}


def cycles(duration_us: float, clock_mhz: float) -> int:
    """Return a duration [us] in cycles of a clock, rounded."""
    return round(duration_us * clock_mhz)


def register_writes(configuration: Configuration, identity: Identity) -> list[Write]:
    """Return the writes that put settings into a camera, in libcaer's order; nothing is started.

    Args:
        configuration: Settings.
        identity: The camera: its clocks, and the blocks it lacks, which are left alone.

    Raises:
        ConfigurationError: A setting is out of range.
    """
    configuration.check()
    biases = [
        Write(Module.CHIP, address, configuration.biases.get(name, default).encode())
        for name, (address, default) in DEFAULT_BIASES.items()
    ]
    chip = [Write(Module.CHIP, parameter, value) for parameter, value in CHIP_DEFAULTS]
    multiplexer = [
        Write(Module.MUX, Mux.DROP_EXTERNAL_INPUT_ON_STALL, 1),
        Write(Module.MUX, Mux.DROP_DVS_ON_STALL, 1),
    ]
    return [
        *biases,
        *chip,
        *multiplexer,
        *_dvs_writes(configuration, identity),
        *_aps_writes(configuration, identity),
        *_imu_writes(configuration, identity),
        *_external_input_writes(configuration, identity),
        *_usb_writes(configuration, identity.clocks),
    ]


def changed_writes(old: Sequence[Write], new: Sequence[Write]) -> list[Write]:
    """Return the writes of `new` whose value differs from `old`."""
    before = {write[:2]: write.value for write in old}
    return [write for write in new if before.get(write[:2]) != write.value]


def _dvs_writes(configuration: Configuration, identity: Identity) -> list[Write]:
    c, has = configuration, identity.features
    values: list[tuple[int, int]] = [(Dvs.WAIT_ON_STALL, 0), (Dvs.EXTERNAL_AER_CONTROL, 0)]
    if has.pixel_filter:
        values += _pixel_filter_values(c.pixel_filter)
    if has.background_activity:
        values += [
            (Dvs.BACKGROUND_ACTIVITY_ENABLE, c.background_activity_filter_enabled),
            (Dvs.BACKGROUND_ACTIVITY_TIME, c.background_activity_filter_time),
            (Dvs.REFRACTORY_ENABLE, c.refractory_period_enabled),
            (Dvs.REFRACTORY_TIME, c.refractory_period_time),
        ]
    if has.roi:
        values += [
            (Dvs.ROI_START_COLUMN, c.roi.start_column),
            (Dvs.ROI_START_ROW, c.roi.start_row),
            (Dvs.ROI_END_COLUMN, c.roi.end_column),
            (Dvs.ROI_END_ROW, c.roi.end_row),
        ]
    if has.skip:
        values += [(Dvs.SKIP_ENABLE, c.skip_enabled), (Dvs.SKIP_EVERY, c.skip_events_every)]
    if has.polarity:
        values += [
            (Dvs.POLARITY_FLATTEN, c.polarity_flatten),
            (Dvs.POLARITY_SUPPRESS, c.polarity_suppress),
            (Dvs.POLARITY_SUPPRESS_TYPE, c.polarity_suppress_type),
        ]
    return [Write(Module.DVS, parameter, int(value)) for parameter, value in values]


def _pixel_filter_values(pixels: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    # A filter on the pixel one beyond the corner matches nothing.
    slots = [*pixels, *[(346, 260)] * (PIXEL_FILTERS - len(pixels))]
    values = []
    for k, (column, row) in enumerate(slots):
        values += [(Dvs.PIXEL_0_ROW + 2 * k, row), (Dvs.PIXEL_0_COLUMN + 2 * k, column)]
    return values


def _aps_writes(configuration: Configuration, identity: Identity) -> list[Write]:
    c, adc = configuration, identity.clocks.adc
    writes = [Write(Module.APS, Aps.WAIT_ON_STALL, 1)]
    if identity.features.global_shutter:
        # The chip must know before the read-out does.
        shutter = int(c.aps_global_shutter)
        writes += [
            Write(Module.CHIP, Chip.GLOBAL_SHUTTER, shutter),
            Write(Module.APS, Aps.GLOBAL_SHUTTER, shutter),
        ]
    values = (
        (Aps.START_COLUMN, c.aps_roi.start_column),
        (Aps.START_ROW, c.aps_roi.start_row),
        (Aps.END_COLUMN, c.aps_roi.end_column),
        (Aps.END_ROW, c.aps_roi.end_row),
        (Aps.EXPOSURE, cycles(c.aps_exposure_us, adc)),
        (Aps.FRAME_INTERVAL, cycles(c.aps_frame_interval_us, adc)),
    )
    return writes + [Write(Module.APS, parameter, value) for parameter, value in values]


def _imu_writes(configuration: Configuration, identity: Identity) -> list[Write]:
    c = configuration
    values = [
        (Imu.SAMPLE_RATE_DIVIDER, c.imu_sample_rate_divider),
        (Imu.ACCELEROMETER_LOW_PASS, c.imu_low_pass_filter),
        (Imu.ACCELEROMETER_SCALE, c.imu_acceleration_scale),
    ]
    if identity.imu_type == 2:
        values.append((Imu.GYROSCOPE_LOW_PASS, c.imu_low_pass_filter))
    values.append((Imu.GYROSCOPE_SCALE, c.imu_gyroscope_scale))
    return [Write(Module.IMU, parameter, value) for parameter, value in values]


def _external_input_writes(configuration: Configuration, identity: Identity) -> list[Write]:
    c, logic = configuration, identity.clocks.logic
    values: list[tuple[int, int]] = [
        (ExternalInput.DETECT_RISING, c.detect_rising),
        (ExternalInput.DETECT_FALLING, c.detect_falling),
        (ExternalInput.DETECT_PULSES, c.detect_pulses),
        (ExternalInput.PULSE_POLARITY, 1),
        (ExternalInput.PULSE_LENGTH, cycles(10, logic)),
    ]
    if identity.features.generator:
        values += [
            (ExternalInput.RUN_GENERATOR, 0),
            (ExternalInput.GENERATOR_POLARITY, 1),
            (ExternalInput.GENERATOR_INTERVAL, cycles(10, logic)),
            (ExternalInput.GENERATOR_LENGTH, cycles(5, logic)),
            (ExternalInput.INJECT_ON_RISING, 0),
            (ExternalInput.INJECT_ON_FALLING, 0),
        ]
    return [Write(Module.EXTERNAL_INPUT, parameter, int(value)) for parameter, value in values]


def _usb_writes(configuration: Configuration, clocks: Clocks) -> list[Write]:
    delay = cycles(configuration.early_packet_delay_us, clocks.usb)
    return [Write(Module.USB, Usb.EARLY_PACKET_DELAY, delay)]
