# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Status of the driver on `/diagnostics`: rates, losses, clock, recovery, camera statistics."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict

from mixtac_driver.camera import SourceStatus
from mixtac_driver.davis346.control import CameraControl, CameraStatistics
from mixtac_driver.errors import DriverError
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.source import Source, SourceKind, source_kind
from mixtac_driver.supervisor import State, Supervisor
from mixtac_events.clock_map import ClockEstimate
from mixtac_node.diagnostics import ERROR, OK, WARN, RateMeter, RecentValues, Status

DROPPED = ('camera dropped', 'camera external input dropped', 'camera dvs dropped')
"""Counters shown as totals; the others are shown as rates."""


class Rates:
    """Rates of named totals."""

    def __init__(self) -> None:
        self._meters: dict[str, RateMeter] = {}

    def read(self, totals: Mapping[str, int]) -> dict[str, object]:
        """Return the rates since the last call, by name."""
        rates: dict[str, object] = {}
        now_s = time.monotonic()
        for name, total in totals.items():
            meter = self._meters.setdefault(name, RateMeter())
            meter.total = total
            rates[f'{name} per second'] = max(meter.read(now_s), 0.0)
        return rates


class StatisticsMeter:
    """Reads the counters of a camera.

    Args:
        control: Requests to the camera.

    Attributes:
        fresh_losses: Data that the camera dropped unintentionally since the previous read.
    """

    def __init__(self, control: CameraControl) -> None:
        self.fresh_losses = 0
        self._control = control
        self._lost: int | None = None
        self._rates = Rates()

    def read(self) -> dict[str, object]:
        """Return figures by name; none while the camera is closed or does not answer."""
        self.fresh_losses = 0
        try:
            statistics = self._control.statistics()
        except DriverError:
            # The thread that reads the data reports failures of the camera.
            return {}
        return {} if statistics is None else self._figures(statistics)

    def _figures(self, statistics: CameraStatistics) -> dict[str, object]:
        # A camera that was not unplugged counts on from an earlier session; a reopened one may
        # count from zero.
        before = statistics.lost if self._lost is None else self._lost
        self.fresh_losses, self._lost = max(statistics.lost - before, 0), statistics.lost
        totals = {f'camera {k.replace("_", " ")}': v for k, v in asdict(statistics).items()}
        dropped = {name: totals.pop(name) for name in DROPPED}
        return dropped | self._rates.read(totals)


class DriverMeters:
    """Counters of the decoding thread, read by the thread that reports.

    Attributes:
        events: Events decoded.
        packets: Packets published.
        frames: Frames decoded.
        samples: Inertial samples decoded.
        edges: Edges of the external input and the generator decoded.
        edges_dropped: Edges dropped because there were too many.
        ages_s: Time from arrival to publication of packets [s].
        clock: Latest figures of the clock map, and the origin of the camera's clock to which they
            belong [us since the Unix epoch]; None before.
        temperature: Latest temperature of the camera [degrees Celsius], NaN without.
        exposure_us: Exposure of the latest frame [us], NaN without.
    """

    def __init__(self) -> None:
        self.events, self.packets = RateMeter(), RateMeter()
        self.frames, self.samples, self.edges = RateMeter(), RateMeter(), RateMeter()
        self.edges_dropped = 0
        self.ages_s = RecentValues()
        self.clock: tuple[ClockEstimate, int] | None = None
        self.temperature = math.nan
        self.exposure_us = math.nan

    def rates(self) -> dict[str, object]:
        """Return the rates since the last call, and the latest values."""
        now_s = time.monotonic()
        values: dict[str, object] = {
            'events per second': self.events.read(now_s),
            'packets per second': self.packets.read(now_s),
            'frames per second': self.frames.read(now_s),
            'imu samples per second': self.samples.read(now_s),
            'external edges': self.edges.total,
            'external edges dropped': self.edges_dropped,
            'packet age median [s]': self.ages_s.quantile(0.5),
            'packet age p99 [s]': self.ages_s.quantile(0.99),
        }
        latest = {'temperature [C]': self.temperature, 'exposure [us]': self.exposure_us}
        return values | {name: value for name, value in latest.items() if not math.isnan(value)}


QUIET_S = 5.0
"""Time without data [s] from which a stream that counts as alive is reported nevertheless."""
CLOCK_STEPPED = 'the camera clock or the host clock stepped: call ~/reset_timestamps'
_STREAMING = {
    SourceKind.CAMERA: 'streaming',
    SourceKind.SIMULATED: 'streaming from a simulated camera',
    SourceKind.RECORDED: 'playing a recording',
}


class DriverStatus:
    """Collects the figures of a running driver.

    Args:
        device: Device string.
        source: The source.
        supervisor: Keeps the source streaming.
        settings: Settings of the source.
        meters: Counters of published data.
    """

    def __init__(
        self,
        device: str,
        source: Source,
        supervisor: Supervisor,
        settings: DriverSettings,
        meters: DriverMeters,
    ) -> None:
        self._device, self._source, self._supervisor = device, source, supervisor
        self._kind = source_kind(device)
        self._settings, self._meters = settings, meters
        self._statistics = StatisticsMeter(source.control) if source.control else None
        self._rates = Rates()
        self._lost_before = 0
        self._reconnects_before = supervisor.reconnects

    def status(self) -> Status:
        """Return the current status; rates are over the time since the last call."""
        source = self._source.status()
        values = {
            'state': self._supervisor.state.value,
            'device': self._device,
            'simulated': self._kind is SourceKind.SIMULATED,
            'replayed': self._kind is SourceKind.RECORDED,
            **_identity(source),
            **self._meters.rates(),
            **self._rates.read(source.totals),
            **source.figures,
            **source.losses,
            'pixels masked': len(self._settings.mask.pixels),
            'events masked on the host': self._settings.mask.dropped,
            **(self._statistics.read() if self._statistics else {}),
            **self._clock(source),
            **self._recovery(),
        }
        level, message = self._verdict(source)
        return Status(level, message, values)

    def _verdict(self, source: SourceStatus) -> tuple[int, str]:
        trouble = self._fresh_trouble(source)
        supervisor = self._supervisor
        if supervisor.state is State.ENDED:
            return OK, 'the recording has ended'
        if source.paused and supervisor.state is not State.FAILED:
            return OK, 'the recording is paused'
        if supervisor.state is not State.STREAMING:
            return ERROR, supervisor.error or 'no stream yet'
        if supervisor.quiet_s > QUIET_S and self._kind is not SourceKind.RECORDED:
            return ERROR, f'no data for {supervisor.quiet_s:.0f} s'
        kind = _STREAMING[self._kind]
        return (WARN, f'{kind}, but {trouble}') if trouble else (OK, kind)

    def _fresh_trouble(self, source: SourceStatus) -> str:
        lost, reconnects = sum(source.losses.values()), self._supervisor.reconnects
        fresh, self._lost_before = lost > self._lost_before, lost
        again, self._reconnects_before = reconnects > self._reconnects_before, reconnects
        if again:
            return f'there was an outage of {self._supervisor.outage_s:.1f} s'
        if fresh:
            return 'data were lost or damaged'
        if source.trouble:
            return source.trouble
        if self._statistics is not None and self._statistics.fresh_losses:
            return 'the camera dropped events: too many to send'
        if self._kind is not SourceKind.RECORDED and self._meters.clock is not None:
            clock, _ = self._meters.clock
            if clock.steps:
                return CLOCK_STEPPED
        return ''

    def _recovery(self) -> dict[str, object]:
        supervisor = self._supervisor
        by_kind = sorted(supervisor.failures_by_kind.items())
        return {
            'failures': supervisor.failures,
            **{f'failures {kind}': count for kind, count in by_kind},
            'reconnects': supervisor.reconnects,
            'latest outage [s]': supervisor.outage_s,
        }

    def _clock(self, source: SourceStatus) -> dict[str, object]:
        origin = source.origin
        if origin is None or self._meters.clock is None:
            return {}
        clock, origin_us = self._meters.clock
        return {
            'clock origin uncertainty [us]': origin.uncertainty_ns / 1000,
            'clock offset [us]': clock.offset_us - origin_us,
            'clock skew [ppm]': clock.skew_ppm,
            'clock residual [us]': clock.residual_us,
            'clock steps': clock.steps,
        }


def _identity(source: SourceStatus) -> dict[str, object]:
    identity = source.identity
    if identity is None:
        return {}
    return {
        'serial': identity.serial,
        'chip': identity.chip,
        'firmware': '.'.join(map(str, identity.firmware)),
        'logic': '.'.join(map(str, identity.logic)),
    }
