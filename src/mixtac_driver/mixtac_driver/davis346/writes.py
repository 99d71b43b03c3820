# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Register writes for settings, and the sequences that start, stop and reset the camera.

Settings are written in the order of libcaer.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

from mixtac_driver.clock import Origin
from mixtac_driver.davis346.model import CameraModel, Identity
from mixtac_driver.davis346.registers import (
    PIXEL_FILTERS,
    Aps,
    Chip,
    Dvs,
    ExternalInput,
    Imu,
    Module,
    Mux,
    Usb,
)
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_driver.usb.protocol import Protocol, Write

DVS_REGION = (Dvs.ROI_START_COLUMN, Dvs.ROI_START_ROW, Dvs.ROI_END_COLUMN, Dvs.ROI_END_ROW)
APS_REGION = (Aps.START_COLUMN, Aps.START_ROW, Aps.END_COLUMN, Aps.END_ROW)
"""Registers of a region, in the order of the fields of `Region`."""


SENSORS: Mapping[tuple[int, int], str] = MappingProxyType(
    {
        (Module.DVS, Dvs.RUN): 'dvs_enabled',
        (Module.APS, Aps.RUN): 'aps_enabled',
        (Module.IMU, Imu.RUN_ACCELEROMETER): 'imu_acc_enabled',
        (Module.IMU, Imu.RUN_GYROSCOPE): 'imu_gyro_enabled',
        (Module.IMU, Imu.RUN_TEMPERATURE): 'imu_temp_enabled',
        (Module.EXTERNAL_INPUT, ExternalInput.RUN_DETECTOR): 'external_input_enabled',
    }
)
"""Register that runs each sensor, and the parameter that enables it."""


def cycles(duration_us: float, clock_mhz: float) -> int:
    """Return a duration [us] in cycles of a clock, rounded."""
    return round(duration_us * clock_mhz)


def register_writes(
    p: CameraParameters, identity: Identity, pixel_filter: Sequence[tuple[int, int]] = ()
) -> list[Write]:
    """Return the writes that put settings into a camera, in libcaer's order; nothing is started.

    Args:
        p: Settings.
        identity: The camera: its model, its clocks and its sizes.
        pixel_filter: (column, row) of pixels whose events the camera drops, most important first;
            it takes as many as it has filters.

    Raises:
        ConfigurationError: Settings contradict each other or do not fit the pixel array.
        ParameterError: A setting is out of range.
    """
    p.check()
    model, geometry, clocks = identity.model, identity.geometry, identity.clocks
    width, height = geometry.event_size
    groups: list[tuple[Module, Iterable[tuple[int, int]]]] = [
        (Module.CHIP, ((bias.address, bias.encode(p)) for bias in model.biases.values())),
        (Module.CHIP, model.chip_registers.items()),
        (Module.MUX, ((Mux.DROP_EXTERNAL_INPUT_ON_STALL, 1), (Mux.DROP_DVS_ON_STALL, 1))),
        (
            Module.DVS,
            (
                (Dvs.WAIT_ON_STALL, 0),
                (Dvs.EXTERNAL_AER_CONTROL, 0),
                *_pixel_filter_values(pixel_filter, width, height),
                (Dvs.BACKGROUND_ACTIVITY_ENABLE, p.background_activity_filter_enabled),
                (Dvs.BACKGROUND_ACTIVITY_TIME, p.background_activity_filter_time),
                (Dvs.REFRACTORY_ENABLE, p.refractory_period_enabled),
                (Dvs.REFRACTORY_TIME, p.refractory_period_time),
                *zip(DVS_REGION, p.roi.within(width, height, 'roi'), strict=True),
                (Dvs.SKIP_ENABLE, p.skip_enabled),
                (Dvs.SKIP_EVERY, p.skip_events_every),
                (Dvs.POLARITY_FLATTEN, p.polarity_flatten),
                (Dvs.POLARITY_SUPPRESS, p.polarity_suppress),
                (Dvs.POLARITY_SUPPRESS_TYPE, p.polarity_suppress_type),
            ),
        ),
    ]
    if model.has_frames:
        roi = p.aps_roi.within(geometry.width, geometry.height, 'aps_roi')
        groups += [
            (Module.APS, ((Aps.WAIT_ON_STALL, 1),)),
            # The chip must know its shutter before the read-out does.
            (Module.CHIP, ((Chip.GLOBAL_SHUTTER, p.aps_global_shutter),)),
            (Module.APS, ((Aps.GLOBAL_SHUTTER, p.aps_global_shutter),)),
            (Module.APS, zip(APS_REGION, roi, strict=True)),
            (Module.APS, ((Aps.EXPOSURE, cycles(p.aps_exposure, clocks.adc)),)),
            (Module.APS, ((Aps.FRAME_INTERVAL, cycles(p.aps_frame_interval, clocks.adc)),)),
        ]
    low_pass = ((Imu.GYROSCOPE_LOW_PASS, p.imu_gyro_low_pass_filter),)
    imu = (
        (Imu.SAMPLE_RATE_DIVIDER, p.imu_sample_rate_divider),
        (Imu.ACCELEROMETER_LOW_PASS, p.imu_low_pass_filter),
        (Imu.ACCELEROMETER_SCALE, p.imu_acc_scale),
        *(low_pass if identity.imu_type == 2 else ()),
        (Imu.GYROSCOPE_SCALE, p.imu_gyro_scale),
    )
    groups += [
        (Module.IMU, imu),
        (Module.EXTERNAL_INPUT, _external_input_values(p, clocks.logic)),
        (Module.USB, ((Usb.EARLY_PACKET_DELAY, cycles(p.usb_early_packet_delay, clocks.usb)),)),
    ]
    found = [Write(module, number, int(n)) for module, values in groups for number, n in values]
    return [each for each in found if (each.module, each.parameter) not in identity.absent]


def run_writes(p: CameraParameters, model: CameraModel) -> list[Write]:
    """Return the writes that switch each sensor of a running camera on or off."""
    on = {name: getattr(p, name) for name in SENSORS.values()}
    on['aps_enabled'] &= model.has_frames
    return [Write(*address, int(on[name])) for address, name in SENSORS.items()]


def _pixel_filter_values(
    pixels: Sequence[tuple[int, int]], width: int, height: int
) -> list[tuple[int, int]]:
    # A filter on the pixel one beyond the corner matches nothing.
    slots = [*pixels[:PIXEL_FILTERS], *[(width, height)] * (PIXEL_FILTERS - len(pixels))]
    values = []
    for k, (column, row) in enumerate(slots):
        values += [(Dvs.PIXEL_0_ROW + 2 * k, row), (Dvs.PIXEL_0_COLUMN + 2 * k, column)]
    return values


def _external_input_values(p: CameraParameters, logic: float) -> tuple[tuple[int, int], ...]:
    run = (ExternalInput.RUN_GENERATOR, p.generator_enabled)
    generator: tuple[tuple[int, int], ...] = (
        (ExternalInput.GENERATOR_POLARITY, p.generator_polarity),
        (ExternalInput.GENERATOR_INTERVAL, cycles(p.generator_interval, logic)),
        (ExternalInput.GENERATOR_LENGTH, cycles(p.generator_length, logic)),
        (ExternalInput.INJECT_ON_RISING, p.generator_inject_on_rising),
        (ExternalInput.INJECT_ON_FALLING, p.generator_inject_on_falling),
    )
    return (
        (ExternalInput.DETECT_RISING, p.external_input_rising),
        (ExternalInput.DETECT_FALLING, p.external_input_falling),
        (ExternalInput.DETECT_PULSES, p.external_input_pulses),
        (ExternalInput.PULSE_POLARITY, p.external_input_pulse_polarity),
        (ExternalInput.PULSE_LENGTH, cycles(p.external_input_pulse_length, logic)),
        # The generator stops before its settings change and starts with the new ones.
        *((*generator, run) if p.generator_enabled else (run, *generator)),
    )


QUIET_S = 0.01
"""Time for data still on its way after everything was stopped."""
BIASES_SETTLE_S = 0.2
LOGIC_SETTLE_S = 0.05
STOP_WRITES = (
    *(Write(module, parameter, 0) for module, parameter in SENSORS),
    Write(Module.MUX, Mux.RUN, 0),
    Write(Module.MUX, Mux.TIMESTAMP_RUN, 0),
    Write(Module.USB, Usb.RUN, 0),
)
CHIP_OFF = Write(Module.MUX, Mux.RUN_CHIP, 0)


def start_streaming(
    protocol: Protocol, run: Sequence[Write], begin_reading: Callable[[], None]
) -> None:
    """Bring a configured camera from any state to streaming.

    Args:
        protocol: Register access.
        run: Sensors to switch on or off (see `run_writes`).
        begin_reading: Clears the data endpoint and starts to read it; data follow soon after.

    Raises:
        UsbError: A request failed.
    """
    protocol.write_each([*STOP_WRITES, CHIP_OFF])
    time.sleep(QUIET_S)
    begin_reading()
    protocol.write(Module.MUX, Mux.RUN_CHIP, 1)
    time.sleep(BIASES_SETTLE_S)
    protocol.write(Module.USB, Usb.RUN, 1)
    protocol.write(Module.MUX, Mux.TIMESTAMP_RUN, 1)
    protocol.write(Module.MUX, Mux.RUN, 1)
    time.sleep(LOGIC_SETTLE_S)
    protocol.write_each([write for write in run if write.value])


def stop_streaming(protocol: Protocol, end_reading: Callable[[], None]) -> None:
    """Stop streaming and switch the chip off.

    Args:
        protocol: Register access.
        end_reading: Ends the reads of the data endpoint.

    Raises:
        UsbError: A request failed; reading was ended nevertheless.
    """
    try:
        protocol.write_each(STOP_WRITES)
    finally:
        end_reading()
    protocol.write_each([CHIP_OFF])


def reset_clock(protocol: Protocol) -> Origin:
    """Set the camera's clock to zero and return the host time of the reset.

    The reset happens between two readings of the host clock; their middle is taken.

    Args:
        protocol: Register access.

    Raises:
        UsbError: The request failed.
    """
    before = time.time_ns()
    protocol.write_at_once(
        [Write(Module.MUX, Mux.TIMESTAMP_RESET, 1), Write(Module.MUX, Mux.TIMESTAMP_RESET, 0)]
    )
    after = time.time_ns()
    middle_us = (before + after + 1000) // 2000
    return Origin(middle_us * 1000, (after - before) // 2 + 500)
