# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Opens a camera and judges what it is and what comes from it."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

from mixtac_driver.camera import Davis346
from mixtac_driver.configuration import Configuration
from mixtac_driver.doctor.finding import Finding, Level, ok
from mixtac_driver.doctor.measurement import measure
from mixtac_driver.errors import DriverError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from mixtac_driver.doctor.finding import Value
    from mixtac_driver.doctor.measurement import Measurement
    from mixtac_driver.identity import Identity

IMU_NAMES = {0: 'no inertial unit', 1: 'MPU6050', 2: 'MPU9250'}
COLOR_FILTERS = {0: 'monochrome', 1: 'RGGB', 2: 'GRBG', 3: 'GBRG', 4: 'BGGR'}
RATE_TOLERANCE = 0.9
LONGEST_GAP_MS = 10.0
MOST_SKEW_PPM = 100.0
MOST_RESIDUAL_US = 1000.0
SKEW_AFTER_S = 10.0
MOST_BEHIND_S = 0.2
CABLE = 'try another cable and another port; if it stays, plug the camera in again'
BUSY = 'close busy programs; the computer reads the camera too late'


def check_running(
    device: str,
    seconds: float,
    *,
    serial: str = '',
    backend: Any = None,  # noqa: ANN401
) -> Iterator[Finding]:
    """Open a camera, let it run, and yield findings as they come.

    Args:
        device: Device string (see `mixtac_driver.backend`).
        seconds: How long to count [s].
        serial: Serial number, or empty for the only camera.
        backend: A pyusb backend to use instead of the one that `device` names.
    """
    configuration = Configuration()
    camera = Davis346(device, serial=serial, configuration=configuration, backend=backend)
    try:
        camera.open()
    except DriverError as error:
        yield failure('opening the camera', error)
        return
    try:
        yield check_identity(camera.identity)
        yield from check_measurement(
            measure(camera, seconds), configuration, camera.identity.imu_type
        )
    except DriverError as error:
        yield failure('data stream', error)
    finally:
        with contextlib.suppress(DriverError):
            camera.close()


def failure(name: str, error: DriverError) -> Finding:
    """Return an error of the driver as a finding; its text holds the remedy after a colon."""
    text = str(error)
    cut = max(text.rfind(': '), text.rfind('; '))
    if cut < 0:
        return Finding(name, Level.ERROR, text, CABLE)
    return Finding(name, Level.ERROR, text[:cut], text[cut + 2 :])


def check_identity(identity: Identity) -> Finding:
    """Say what the camera is."""
    firmware, logic = ('.'.join(map(str, v)) for v in (identity.firmware, identity.logic))
    colour = COLOR_FILTERS.get(identity.features.color_filter, 'colour filter with white')
    unit = IMU_NAMES.get(identity.imu_type, f'inertial unit {identity.imu_type}')
    clock = 'own clock' if identity.is_master else 'clock from the synchronisation cable'
    values: dict[str, Value] = {
        'serial': identity.serial,
        'chip': identity.chip,
        'firmware': firmware,
        'logic': logic,
        'color_filter': identity.features.color_filter,
        'imu_type': identity.imu_type,
        'master': identity.is_master,
    }
    parts = (
        *(identity.chip, identity.serial or 'no serial number', f'firmware {firmware}'),
        *(f'logic {logic}', colour, unit, clock),
    )
    return Finding('identity', Level.OK, ', '.join(parts), values=values)


def check_measurement(
    result: Measurement, configuration: Configuration, imu_type: int
) -> list[Finding]:
    """Judge what came against what was asked for."""
    return [
        _check_events(result),
        _check_frames(result, configuration),
        _check_samples(result, configuration, imu_type),
        _check_transfers(result),
        _check_losses(result),
        _check_clock(result),
    ]


def _check_events(result: Measurement) -> Finding:
    rate = result.rate(result.events)
    values = {'events [1/s]': round(rate, 1), 'edges [1/s]': round(result.rate(result.edges), 1)}
    if not result.events:
        found = f'none in {result.seconds:.1f} s'
        remedy = 'take the lens cap off and move something in view; else check the biases'
        return Finding('events', Level.WARN, found, remedy, values)
    return Finding('events', Level.OK, f'{rate:,.0f} /s', values=values)


def _check_frames(result: Measurement, configuration: Configuration) -> Finding:
    period_us = max(configuration.aps_frame_interval_us, configuration.aps_exposure_us, 1)
    return _check_rate('frames', result, result.frames, 1e6 / period_us)


def _check_samples(result: Measurement, configuration: Configuration, imu_type: int) -> Finding:
    if not imu_type:
        return ok('inertial samples', 'the camera has no inertial unit')
    wanted = 1000 / (1 + configuration.imu_sample_rate_divider)
    return _check_rate('inertial samples', result, result.samples, wanted)


def _check_rate(name: str, result: Measurement, count: int, wanted: float) -> Finding:
    rate = result.rate(count)
    values = {f'{name} [1/s]': round(rate, 1), 'wanted [1/s]': round(wanted, 1)}
    if not count:
        found = f'none in {result.seconds:.1f} s, {wanted:.0f} /s were asked for'
        return Finding(name, Level.ERROR, found, 'plug the camera in again', values)
    # One more or less is a matter of when the counting began.
    if count + 1 < RATE_TOLERANCE * wanted * result.seconds:
        return Finding(name, Level.WARN, f'{rate:.1f} /s instead of {wanted:.0f} /s', CABLE, values)
    return Finding(name, Level.OK, f'{rate:.1f} /s', values=values)


def _check_transfers(result: Measurement) -> Finding:
    megabytes = result.size / max(result.elapsed_s, 1e-9) / 1e6
    middle, late = result.gaps_ms
    values: dict[str, Value] = {
        'usb [MB/s]': round(megabytes, 3),
        'gap p50 [ms]': round(middle, 3),
        'gap p99 [ms]': round(late, 3),
        'stalls': result.transport.stalls,
    }
    found = f'{megabytes:.2f} MB/s, one every {middle:.2f} ms (p50), {late:.2f} ms (p99)'
    if result.transport.stalls:
        return Finding(
            'transfers', Level.WARN, f'{found}, {result.transport.stalls} stalls', CABLE, values
        )
    if late > LONGEST_GAP_MS:
        return Finding('transfers', Level.WARN, found, BUSY, values)
    return Finding('transfers', Level.OK, found, values=values)


def _check_losses(result: Measurement) -> Finding:
    dropped, behind_s = result.transport.dropped_transfers, result.elapsed_s - result.seconds
    values: dict[str, Value] = {
        **result.losses,
        'transfers_dropped': dropped,
        'behind [s]': round(behind_s, 3),
    }
    if dropped:
        found = f'{dropped} transfers dropped because decoding fell behind'
        return Finding('losses', Level.WARN, found, BUSY, values)
    if result.losses:
        listed = ', '.join(f'{n} {name.replace("_", " ")}' for name, n in result.losses.items())
        return Finding('losses', Level.WARN, listed, CABLE, values)
    if behind_s > MOST_BEHIND_S:
        found = f'none yet, but decoding is {behind_s:.1f} s behind after {result.elapsed_s:.1f} s'
        return Finding('losses', Level.WARN, found, BUSY, values)
    return Finding('losses', Level.OK, 'none', values=values)


def _check_clock(result: Measurement) -> Finding:
    clock = result.clock
    if clock is None:
        return Finding('camera clock', Level.WARN, 'no data to compare it by', CABLE)
    values: dict[str, Value] = {
        'skew [ppm]': round(clock.skew_ppm, 2) if clock.span_s >= SKEW_AFTER_S else None,
        'residual [us]': round(clock.residual_us, 1),
        'resets': result.clock_resets,
    }
    told = (
        f'skew {clock.skew_ppm:+.1f} ppm'
        if clock.span_s >= SKEW_AFTER_S
        else f'skew takes {SKEW_AFTER_S:.0f} s to measure (--seconds {SKEW_AFTER_S + 2:.0f})'
    )
    found = f'{told}; residual {clock.residual_us:.0f} us'
    if result.clock_resets:
        remedy = 'look after the synchronisation cable'
        found += f', {result.clock_resets} resets nobody asked for'
        return Finding('camera clock', Level.WARN, found, remedy, values)
    if abs(clock.skew_ppm) > MOST_SKEW_PPM:
        remedy = 'let a time server keep the clock of this computer; else the camera is at fault'
        return Finding('camera clock', Level.WARN, found, remedy, values)
    if clock.residual_us > MOST_RESIDUAL_US:
        return Finding('camera clock', Level.WARN, found, BUSY, values)
    return Finding('camera clock', Level.OK, found, values=values)
