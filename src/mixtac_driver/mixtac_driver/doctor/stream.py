# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Findings about a running camera: identity, data rates, losses and clock."""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixtac_driver.camera import LOSSES, Davis346
from mixtac_driver.davis346.model import Identity
from mixtac_driver.davis346.settings import CameraParameters
from mixtac_driver.doctor.computer import Finding, Level, Value, ok
from mixtac_driver.parameters import DriverParameters
from mixtac_driver.usb.transport import TransportCounters
from mixtac_events.clock_map import ClockEstimate
from mixtac_events.errors import MixtacError
from mixtac_events.readings import Frame

LATEST_FRAMES = 5


@dataclass(slots=True)
class Measurement:
    """Counts of the data of a camera.

    Attributes:
        seconds: Duration after the first data, by the camera's clock [s].
        elapsed_s: The same by the host's clock, when the last data were decoded [s].
        events: Number of events.
        frames: Number of frames.
        samples: Number of inertial samples.
        edges: Number of edges of the external input and the generator.
        size: Bytes over USB.
        gaps_ms: Median and 99th percentile of the time between transfers [ms], NaN without two.
        losses: Decoder counters that stay at zero on an intact stream, by name, if not zero.
        transport: Counters of the USB reader.
        clock: The map from the camera's clock to the host's, or None without data.
        clock_resets: Resets of the camera's clock that the driver did not request.
        latest: Latest frames.
        counts: Events per pixel, `int64` [rows, columns].
    """

    seconds: float = 0.0
    elapsed_s: float = 0.0
    events: int = 0
    frames: int = 0
    samples: int = 0
    edges: int = 0
    size: int = 0
    gaps_ms: tuple[float, float] = (math.nan, math.nan)
    losses: dict[str, int] = field(default_factory=dict)
    transport: TransportCounters = field(default_factory=TransportCounters)
    clock: ClockEstimate | None = None
    clock_resets: int = 0
    latest: deque[Frame] = field(default_factory=lambda: deque(maxlen=LATEST_FRAMES))
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 0), np.int64))

    def rate(self, count: int) -> float:
        """Return a count per second of the camera's clock."""
        return count / self.seconds if self.seconds else 0.0


def measure(camera: Davis346, seconds: float) -> Measurement:
    """Start an open camera, count its data, and stop it.

    Args:
        camera: An open camera.
        seconds: Duration, from the first data on [s].

    Raises:
        UsbError: A request failed or the camera went away.
        StreamError: No data came, or the stream died.
    """
    camera.start()
    width, height = camera.identity.geometry.event_size
    result = Measurement(counts=np.zeros((height, width), np.int64))
    arrivals_ns = [0]
    began_s, began_us, size_before = 0.0, 0, 0
    for batch in camera.batches():
        if not began_s:
            # The first call of the decoder may have compiled it while data waited.
            began_s, began_us = time.monotonic(), batch.time_us
            size_before = camera.transport_counters.size
            continue
        events = batch.decoded.events
        result.events += len(events)
        np.add.at(result.counts, (events.y, events.x), 1)
        result.frames += len(batch.decoded.frames)
        result.latest.extend(batch.decoded.frames)
        result.samples += len(batch.decoded.imu.t)
        result.edges += len(batch.decoded.edges.t)
        if arrivals_ns[-1] != batch.arrival_ns:
            arrivals_ns.append(batch.arrival_ns)
        result.elapsed_s = time.monotonic() - began_s
        result.seconds = (batch.time_us - began_us) / 1e6
        if result.elapsed_s >= seconds:
            break
    result.transport, decoder = camera.transport_counters, camera.decoder_counters
    result.size = result.transport.size - size_before
    if len(arrivals_ns) > 2:
        middle, late = np.quantile(np.diff(arrivals_ns[1:]) / 1e6, (0.5, 0.99))
        result.gaps_ms = float(middle), float(late)
    counted = asdict(decoder) if decoder else {}
    result.losses = {name: counted[name] for name in LOSSES if counted.get(name)}
    result.clock = camera.clock.estimate() if camera.clock.ready else None
    result.clock_resets = camera.clock_resets
    camera.stop()
    return result


IMU_NAMES = {0: 'no inertial unit', 1: 'MPU6050', 2: 'MPU9250'}
COLOR_FILTERS = {0: 'monochrome', 1: 'RGGB', 2: 'GRBG', 3: 'GBRG', 4: 'BGGR'}
RATE_TOLERANCE = 0.9
LONGEST_GAP_MS = 10.0
MOST_SKEW_PPM = 100.0
MOST_RESIDUAL_US = 1000.0
SKEW_AFTER_S = 10.0
MOST_BEHIND_S = 0.2
CABLE = 'try another cable and port; if it persists, unplug and reconnect the camera'
BUSY = 'close busy programs: the computer reads the camera too late'


def check_running(
    device: str,
    seconds: float,
    *,
    serial: str = '',
    backend: Any = None,  # noqa: ANN401
    more: Callable[[str, Measurement], Finding] | None = None,
    on_transfer: Callable[[bytes], None] | None = None,
) -> Iterator[Finding]:
    """Open a camera, count its data, and yield findings one by one.

    Args:
        device: Device string (see `mixtac_driver.device`).
        seconds: Duration of the count [s].
        serial: Serial number, or empty for the only camera.
        backend: A pyusb backend to use instead of the one that `device` names.
        more: Makes one more finding of the serial number and the measurement.
        on_transfer: Called with the data of each transfer.
    """
    p = DriverParameters(device=device, serial=serial)
    camera = Davis346(p, backend=backend, on_transfer=on_transfer)
    try:
        camera.open()
    except MixtacError as error:
        yield failure('opening the camera', error)
        return
    try:
        yield check_identity(camera.identity)
        measured = measure(camera, seconds)
        yield from check_measurement(measured, p, camera.identity)
        if more is not None:
            yield more(camera.identity.serial, measured)
    except MixtacError as error:
        yield failure('data stream', error)
    finally:
        with contextlib.suppress(MixtacError):
            camera.close()


def failure(name: str, error: MixtacError) -> Finding:
    """Return an error as a finding with its remedy."""
    return Finding(name, Level.ERROR, error.message, error.remedy or CABLE)


def check_identity(identity: Identity) -> Finding:
    """Report what the camera is."""
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
    result: Measurement, p: CameraParameters, identity: Identity
) -> list[Finding]:
    """Compare the measurement with the settings."""
    return [
        _check_events(result),
        _check_frames(result, p, identity),
        _check_samples(result, p, identity),
        _check_transfers(result),
        _check_losses(result),
        _check_clock(result),
        _check_noise(result),
        _check_focus(result),
    ]


def _check_events(result: Measurement) -> Finding:
    rate = result.rate(result.events)
    values = {'events [1/s]': round(rate, 1), 'edges [1/s]': round(result.rate(result.edges), 1)}
    if not result.events:
        found = f'none in {result.seconds:.1f} s'
        remedy = 'take the lens cap off and move something in view; else check the biases'
        return Finding('events', Level.WARN, found, remedy, values)
    return Finding('events', Level.OK, f'{rate:,.0f} /s', values=values)


def _check_frames(result: Measurement, p: CameraParameters, identity: Identity) -> Finding:
    if not identity.model.has_frames:
        return ok('frames', 'the camera has event pixels only')
    period_us = max(p.aps_frame_interval, p.aps_exposure, 1)
    return _check_rate('frames', result, result.frames, 1e6 / period_us)


def _check_samples(result: Measurement, p: CameraParameters, identity: Identity) -> Finding:
    if not identity.imu_type:
        return ok('inertial samples', 'the camera has no inertial unit')
    wanted = 1000 / (1 + p.imu_sample_rate_divider)
    return _check_rate('inertial samples', result, result.samples, wanted)


def _check_rate(name: str, result: Measurement, count: int, wanted: float) -> Finding:
    rate = result.rate(count)
    values = {f'{name} [1/s]': round(rate, 1), 'wanted [1/s]': round(wanted, 1)}
    if not count:
        found = f'none in {result.seconds:.1f} s, {wanted:.0f} /s expected'
        return Finding(name, Level.ERROR, found, 'unplug and reconnect the camera', values)
    # One more or less depends on the start of the count.
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
        return Finding('camera clock', Level.WARN, 'no data to compare with', CABLE)
    values: dict[str, Value] = {
        'skew [ppm]': round(clock.skew_ppm, 2) if clock.span_s >= SKEW_AFTER_S else None,
        'residual [us]': round(clock.residual_us, 1),
        'resets': result.clock_resets,
    }
    skew = (
        f'skew {clock.skew_ppm:+.1f} ppm'
        if clock.span_s >= SKEW_AFTER_S
        else f'skew takes {SKEW_AFTER_S:.0f} s to measure (--seconds {SKEW_AFTER_S + 2:.0f})'
    )
    found = f'{skew}; residual {clock.residual_us:.0f} us'
    if result.clock_resets:
        remedy = 'check the synchronisation cable'
        found += f', {result.clock_resets} unexpected resets'
        return Finding('camera clock', Level.WARN, found, remedy, values)
    if abs(clock.skew_ppm) > MOST_SKEW_PPM:
        remedy = 'synchronise the clock of this computer; otherwise the camera is at fault'
        return Finding('camera clock', Level.WARN, found, remedy, values)
    if clock.residual_us > MOST_RESIDUAL_US:
        return Finding('camera clock', Level.WARN, found, BUSY, values)
    return Finding('camera clock', Level.OK, found, values=values)


HOT_HZ = 10.0
"""Event rate of a hot pixel in a still scene [1/s]."""
MOST_NOISE_HZ = 1.0
"""Largest median event rate of a pixel in a still scene [1/s]."""


def _check_noise(result: Measurement) -> Finding:
    """Check the event rate of the median pixel: noise, as long as most of the scene is still."""
    rates = result.counts / max(result.seconds, 1e-9)
    middle = float(np.median(rates)) if rates.size else 0.0
    hot = int((rates > HOT_HZ).sum())
    values: dict[str, Value] = {'median [1/s]': round(middle, 3), 'hot pixels': hot}
    found = f'{middle:.2f} /s per pixel (median), {hot} pixels above {HOT_HZ:g} /s'
    if middle > MOST_NOISE_HZ:
        remedy = 'keep the scene still; use a lamp on direct current, or raise the thresholds'
        return Finding('noise', Level.WARN, found, remedy, values)
    return Finding('noise', Level.OK, found, values=values)


LEAST_SHARPNESS = 0.12
"""Least ratio of the mean square difference of neighbours to that of pixels four apart."""


def _check_focus(result: Measurement) -> Finding:
    """Compare the detail at one pixel with the detail at four pixels in the latest frames."""
    shape = result.latest[-1].image.shape if result.latest else ()
    stack = np.array([f.image for f in result.latest if f.image.shape == shape], np.float64)
    if len(stack) < LATEST_FRAMES:
        return ok('focus', 'too few frames to measure')
    picture = stack.mean(axis=0)
    noise = 2.0 * float(stack.var(axis=0, ddof=1).mean()) / len(stack)
    near, far = (
        float((np.diff(picture[::step, ::step], axis=1) ** 2).mean()) - noise for step in (1, 4)
    )
    if far <= noise:
        return ok('focus', 'no contrast in view')
    sharpness = max(near, 0.0) / far
    values: dict[str, Value] = {'sharpness': round(sharpness, 3)}
    if sharpness < LEAST_SHARPNESS:
        remedy = 'turn the focus ring until the markers are sharp'
        return Finding('focus', Level.WARN, f'sharpness {sharpness:.2f}', remedy, values)
    return Finding('focus', Level.OK, f'sharpness {sharpness:.2f}', values=values)
