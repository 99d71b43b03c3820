# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What benchmarks of running nodes share: CPU time, loss and age of received packets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import psutil

from mixtac_events.sequence import SequenceCounter
from mixtac_lab.bench.pattern import MARKER, MARKER_US

if TYPE_CHECKING:
    from mixtac_events.arrays import Events
    from mixtac_node.process import JsonProcess


def cpu_s(process: JsonProcess) -> float:
    """Return the CPU time that a running process has used [s]."""
    times = psutil.Process(process.pid).cpu_times()
    return float(times.user + times.system)


BIN_US = 5
BINS = 200_000
"""Ages up to one second."""


class Arrivals:
    """Takes packets in order of arrival.

    The times of the packets are the camera's count plus the host time at which the driver believes
    that the count was zero. The error of that belief is seen at the markers and taken out again, so
    that ages are true ones.

    Args:
        origin_ns: True host time [ns since the Unix epoch] at which the camera's clock read zero.
        period_us: Length of the pattern [us].
        events: Events per period.
    """

    def __init__(self, origin_ns: int, period_us: int, events: int) -> None:
        self._origin_us = origin_ns // 1000
        self._period_us, self._expected = period_us, events
        self._histogram = np.zeros(BINS, np.int64)
        self._error_us: int | None = None
        self._packets = SequenceCounter()
        self._since_marker: int | None = None
        self._periods = self._events = self._marker_us = 0
        self._last_us = 0
        self._backwards = 0

    def add(self, seq: int, events: Events, arrival_ns: int) -> None:
        """Take a packet.

        Args:
            seq: Its number.
            events: Its events.
            arrival_ns: Host time of arrival [ns since the Unix epoch].
        """
        self._packets.update(seq)
        if not len(events):
            return
        self._backwards += int(events.t[0]) < self._last_us
        self._last_us = int(events.t[-1])
        self._count(events)
        if self._error_us is not None and self._periods:
            ages = arrival_ns // 1000 - (events.t - self._error_us)
            np.add.at(self._histogram, np.clip(ages // BIN_US, 0, BINS - 1), 1)

    def _count(self, events: Events) -> None:
        markers = np.flatnonzero((events.x == MARKER[0]) & (events.y == MARKER[1]))
        done = 0
        for at in markers.tolist():
            if self._since_marker is not None:
                got = self._since_marker + at - done
                elapsed = int(events.t[at]) - self._marker_us
                self._periods += round(elapsed / self._period_us)
                self._events += got
            self._since_marker, done = 0, at
            self._marker_us = int(events.t[at])
            phase = self._marker_us - MARKER_US - self._origin_us
            half = self._period_us // 2
            self._error_us = (phase + half) % self._period_us - half
        if self._since_marker is not None:
            self._since_marker += len(events) - done

    def summary(self) -> dict[str, float]:
        """Return the figures: ages [ms], counts, and the error of the clock's origin [us]."""
        total = int(self._histogram.sum())
        cumulated = np.cumsum(self._histogram)

        def age_ms(quantile: float) -> float:
            at = np.searchsorted(cumulated, quantile * total)
            return float((int(at) + 0.5) * BIN_US / 1000) if total else float('nan')

        return {
            'age_p50_ms': age_ms(0.5),
            'age_p99_ms': age_ms(0.99),
            'age_p999_ms': age_ms(0.999),
            'age_max_ms': age_ms(1.0),
            'packets': self._packets.received,
            'packets_lost': self._packets.lost,
            'events': self._events,
            'events_lost': self._periods * self._expected - self._events,
            'periods': self._periods,
            'backwards': self._backwards,
            'origin_error_us': float(self._error_us or 0),
        }
