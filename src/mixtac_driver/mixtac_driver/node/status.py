# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Status of the driver on `/diagnostics`: rates, losses, clock, recovery, camera statistics."""

from __future__ import annotations

import contextlib
import math
import time

from mixtac_core.events.clock_map import ClockEstimate
from mixtac_core.node.diagnostics import ERROR, OK, WARN, RateMeter, RecentValues, Status
from mixtac_driver.camera import SourceStatus
from mixtac_driver.davis346.control import LOST
from mixtac_driver.errors import DriverError
from mixtac_driver.node.settings import DriverSettings
from mixtac_driver.supervisor import Source, SourceKind, State, Supervisor, source_kind

QUIET_S = 5.0
"""Time without data [s] from which a stream that counts as alive is reported nevertheless."""
CLOCK_STEPPED = 'the camera clock or the host clock stepped: call ~/reset_timestamps'
_STREAMING = {
    SourceKind.CAMERA: 'streaming',
    SourceKind.SIMULATED: 'streaming from a simulated camera',
    SourceKind.RECORDED: 'playing a recording',
}


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
        self.frames, self.samples = RateMeter(), RateMeter()
        self.edges = self.edges_dropped = 0
        self.ages_s = RecentValues()
        self.clock: tuple[ClockEstimate, int] | None = None
        self.temperature = self.exposure_us = math.nan

    def figures(self) -> dict[str, object]:
        """Return the rates since the last call, and the latest values."""
        now_s = time.monotonic()
        latest = {'temperature [C]': self.temperature, 'exposure [us]': self.exposure_us}
        return {
            'events per second': self.events.read(now_s),
            'packets per second': self.packets.read(now_s),
            'frames per second': self.frames.read(now_s),
            'imu samples per second': self.samples.read(now_s),
            'external edges': self.edges,
            'external edges dropped': self.edges_dropped,
            'packet age median [s]': self.ages_s.quantile(0.5),
            'packet age p99 [s]': self.ages_s.quantile(0.99),
            **{name: value for name, value in latest.items() if not math.isnan(value)},
        }


class DriverStatus:
    """Collects the figures of a running driver.

    Args:
        source: The source.
        supervisor: Keeps the source streaming.
        settings: Settings of the source.
        meters: Counters of published data.
    """

    def __init__(
        self,
        source: Source,
        supervisor: Supervisor,
        settings: DriverSettings,
        meters: DriverMeters,
    ) -> None:
        self._source, self._supervisor = source, supervisor
        self._settings, self._meters = settings, meters
        self._kind = source_kind(settings.parameters.device)
        self._lost_before = 0
        self._dropped_before: int | None = None
        self._reconnects_before = supervisor.reconnects

    def status(self) -> Status:
        """Return the current status; rates are over the time since the last call."""
        source, (dropped, statistics) = self._source.status(), self._statistics()
        identity, mask = source.identity, self._settings.mask
        values: dict[str, object] = {
            'state': self._supervisor.state.value,
            'device': self._settings.parameters.device,
            'simulated': self._kind is SourceKind.SIMULATED,
            'replayed': self._kind is SourceKind.RECORDED,
        }
        if identity is not None:
            values['serial'], values['chip'] = identity.serial, identity.chip
            values['firmware'] = '.'.join(map(str, identity.firmware))
            values['logic'] = '.'.join(map(str, identity.logic))
        values |= self._meters.figures() | dict(source.figures) | dict(source.losses)
        values['pixels masked'] = len(mask.pixels)
        values['events masked on the host'] = mask.dropped
        values |= statistics | self._clock(source)
        by_kind = sorted(self._supervisor.failures_by_kind.items())
        values['failures'] = sum(self._supervisor.failures_by_kind.values())
        values |= {f'failures {kind}': count for kind, count in by_kind}
        values['reconnects'] = self._supervisor.reconnects
        values['latest outage [s]'] = self._supervisor.outage_s
        level, message = self._verdict(source, self._fresh_trouble(source, dropped))
        return Status(level, message, values)

    def _verdict(self, source: SourceStatus, trouble: str) -> tuple[int, str]:
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

    def _fresh_trouble(self, source: SourceStatus, dropped: int) -> str:
        """Return what went wrong since the last call, or empty."""
        lost, reconnects = sum(source.losses.values()), self._supervisor.reconnects
        fresh, self._lost_before = lost > self._lost_before, lost
        again, self._reconnects_before = reconnects > self._reconnects_before, reconnects
        if again:
            return f'there was an outage of {self._supervisor.outage_s:.1f} s'
        if fresh:
            return 'data were lost or damaged'
        if source.trouble:
            return source.trouble
        if dropped:
            return 'the camera dropped events: too many to send'
        clock = self._meters.clock
        if self._kind is not SourceKind.RECORDED and clock is not None and clock[0].steps:
            return CLOCK_STEPPED
        return ''

    def _statistics(self) -> tuple[int, dict[str, object]]:
        """Return events that the camera dropped since the last call, and its own counters."""
        control, counters = self._source.control, dict[str, int]()
        if control is not None:
            # The thread that reads the data reports failures of the camera.
            with contextlib.suppress(DriverError):
                counters = control.statistics()
        if not counters:
            return 0, {}
        # A camera that was not unplugged counts on from an earlier session; a reopened one may
        # count from zero.
        lost = sum(counters[name] for name in LOST)
        before = lost if self._dropped_before is None else self._dropped_before
        self._dropped_before = lost
        return max(lost - before, 0), {f'camera {name}': n for name, n in counters.items()}

    def _clock(self, source: SourceStatus) -> dict[str, object]:
        origin = source.origin
        if origin is None or self._meters.clock is None:
            return {}
        clock, origin_us = self._meters.clock
        return {
            'clock origin uncertainty [us]': origin.uncertainty_ns / 1000,
            'clock offset [us]': clock.offset_us - origin_us,
            'clock skew [ppm]': clock.skew_ppm,
            'clock steps': clock.steps,
        }
