# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The register writes that settings stand for, in libcaer's order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mixtac_driver.biases import DEFAULT_BIASES
from mixtac_driver.configuration import CHIP_DEFAULTS, PIXEL_FILTERS, Configuration
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
    from collections.abc import Sequence

    from mixtac_driver.identity import Clocks, Identity


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
    chip = [
        Write(Module.CHIP, register, configuration.chip.get(register, value))
        for register, value in CHIP_DEFAULTS.items()
    ]
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


def run_writes(configuration: Configuration) -> list[Write]:
    """Return the writes that switch each sensor of a running camera on or off."""
    wanted = (
        (Module.DVS, Dvs.RUN, configuration.dvs_enabled),
        (Module.APS, Aps.RUN, configuration.aps_enabled),
        (Module.IMU, Imu.RUN_ACCELEROMETER, configuration.imu_accelerometer_enabled),
        (Module.IMU, Imu.RUN_GYROSCOPE, configuration.imu_gyroscope_enabled),
        (Module.IMU, Imu.RUN_TEMPERATURE, configuration.imu_temperature_enabled),
        (Module.EXTERNAL_INPUT, ExternalInput.RUN_DETECTOR, configuration.external_input_enabled),
    )
    return [Write(module, parameter, int(enabled)) for module, parameter, enabled in wanted]


def exposure_write(exposure_us: int, clocks: Clocks) -> Write:
    """Return the write that sets the exposure [us]."""
    return Write(Module.APS, Aps.EXPOSURE, cycles(exposure_us, clocks.adc))


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
        values.append((Imu.GYROSCOPE_LOW_PASS, c.imu_gyroscope_low_pass_filter))
    values.append((Imu.GYROSCOPE_SCALE, c.imu_gyroscope_scale))
    return [Write(Module.IMU, parameter, value) for parameter, value in values]


def _external_input_writes(configuration: Configuration, identity: Identity) -> list[Write]:
    c, logic = configuration, identity.clocks.logic
    values: list[tuple[int, int]] = [
        (ExternalInput.DETECT_RISING, c.detect_rising),
        (ExternalInput.DETECT_FALLING, c.detect_falling),
        (ExternalInput.DETECT_PULSES, c.detect_pulses),
        (ExternalInput.PULSE_POLARITY, c.pulse_polarity),
        (ExternalInput.PULSE_LENGTH, cycles(c.pulse_length_us, logic)),
    ]
    if identity.features.generator:
        run = (ExternalInput.RUN_GENERATOR, c.generator_enabled)
        generator: list[tuple[int, int]] = [
            (ExternalInput.GENERATOR_POLARITY, c.generator_polarity),
            (ExternalInput.GENERATOR_INTERVAL, cycles(c.generator_interval_us, logic)),
            (ExternalInput.GENERATOR_LENGTH, cycles(c.generator_length_us, logic)),
            (ExternalInput.INJECT_ON_RISING, c.inject_on_rising),
            (ExternalInput.INJECT_ON_FALLING, c.inject_on_falling),
        ]
        # It stops before its settings change and starts with the new ones.
        values += [*generator, run] if c.generator_enabled else [run, *generator]
    return [Write(Module.EXTERNAL_INPUT, parameter, int(value)) for parameter, value in values]


def _usb_writes(configuration: Configuration, clocks: Clocks) -> list[Write]:
    delay = cycles(configuration.early_packet_delay_us, clocks.usb)
    return [Write(Module.USB, Usb.EARLY_PACKET_DELAY, delay)]
