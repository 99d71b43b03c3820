# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Register writes for settings, and the sequences that start, stop and reset the camera.

Settings are written in the order of libcaer.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from mixtac_driver.clock import Origin
from mixtac_driver.davis346.biases import DEFAULT_BIASES
from mixtac_driver.davis346.model import PIXEL_FILTERS
from mixtac_driver.davis346.registers import Aps, Chip, Dvs, ExternalInput, Imu, Module, Mux, Usb
from mixtac_driver.davis346.settings import CHIP_DEFAULTS, Configuration
from mixtac_driver.usb.protocol import Write

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from mixtac_driver.davis346.identity import Clocks, Identity
    from mixtac_driver.usb.protocol import Protocol


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


QUIET_S = 0.01
"""Time for data still on its way after everything was stopped."""
BIASES_SETTLE_S = 0.2
LOGIC_SETTLE_S = 0.05
STOP_WRITES = (
    Write(Module.DVS, Dvs.RUN, 0),
    Write(Module.APS, Aps.RUN, 0),
    Write(Module.IMU, Imu.RUN_ACCELEROMETER, 0),
    Write(Module.IMU, Imu.RUN_GYROSCOPE, 0),
    Write(Module.IMU, Imu.RUN_TEMPERATURE, 0),
    Write(Module.EXTERNAL_INPUT, ExternalInput.RUN_DETECTOR, 0),
    Write(Module.MUX, Mux.RUN, 0),
    Write(Module.MUX, Mux.TIMESTAMP_RUN, 0),
    Write(Module.USB, Usb.RUN, 0),
)
CHIP_OFF = Write(Module.MUX, Mux.RUN_CHIP, 0)


def start(
    protocol: Protocol,
    configuration: Configuration,
    begin_reading: Callable[[], None],
    sleep: Callable[[float], None] = time.sleep,
) -> None:
    """Bring a configured camera from any state to streaming.

    Args:
        protocol: Register access.
        configuration: Says which sensors run.
        begin_reading: Clears the data endpoint and begins to read it; data flow soon after.
        sleep: Waits a number of seconds.

    Raises:
        UsbError: A request failed.
    """
    protocol.write_each([*STOP_WRITES, CHIP_OFF])
    sleep(QUIET_S)
    begin_reading()
    protocol.write(Module.MUX, Mux.RUN_CHIP, 1)
    sleep(BIASES_SETTLE_S)
    protocol.write(Module.USB, Usb.RUN, 1)
    protocol.write(Module.MUX, Mux.TIMESTAMP_RUN, 1)
    protocol.write(Module.MUX, Mux.RUN, 1)
    sleep(LOGIC_SETTLE_S)
    protocol.write_each([write for write in run_writes(configuration) if write.value])


def stop(protocol: Protocol, end_reading: Callable[[], None]) -> None:
    """Stop streaming and switch the chip off.

    Args:
        protocol: Register access.
        end_reading: Ends the reads of the data endpoint.

    Raises:
        UsbError: A request failed; reading was ended all the same.
    """
    try:
        protocol.write_each(STOP_WRITES)
    finally:
        end_reading()
    protocol.write_each([CHIP_OFF])


def reset_timestamps(protocol: Protocol, now_ns: Callable[[], int] = time.time_ns) -> Origin:
    """Set the camera's clock to zero and say when that was.

    The reset happens between two readings of the host clock; their middle is taken.

    Args:
        protocol: Register access.
        now_ns: Host clock [ns since the Unix epoch].

    Raises:
        UsbError: The request failed.
    """
    before = now_ns()
    protocol.write_at_once(
        [Write(Module.MUX, Mux.TIMESTAMP_RESET, 1), Write(Module.MUX, Mux.TIMESTAMP_RESET, 0)]
    )
    after = now_ns()
    middle_us = (before + after + 1000) // 2000
    return Origin(middle_us * 1000, (after - before) // 2 + 500)
