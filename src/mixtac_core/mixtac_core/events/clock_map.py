# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""The map from the camera clock to the host clock, estimated from arrival times.

Data arrive some time after the camera stamped them, never before. Over camera time, the true
relation of the two clocks therefore lies below all arrivals, and the fastest arrivals lie close to
it. The map is the line below all recent arrivals that is closest to them on average; it passes
through two corners of their lower convex hull (Moon, Skelly, Towsley: "Estimation and removal of
clock skew from network delay measurements", INFOCOM 1999). The smallest delay itself cannot be
measured in this way and stays in the offset.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

BUCKET_US = 1_000_000
"""The quickest arrival of each bucket of this length [us, camera clock] is kept."""
BUCKETS = 60
"""Buckets kept: the skew is fitted over the last minute."""
SKEW_AFTER_US = 10_000_000
"""Shortest span for a skew [us]: over shorter ones the delays dominate."""
MOST_SKEW = 500e-6
"""Limit of the skew: ten times the usual tolerance of a crystal oscillator."""
STEP_US = 10_000.0
"""A pair this far below the line [us], or `STEP_BUCKETS` buckets in a row this far above it, means
that one of the clocks was set."""
STEP_BUCKETS = 3
"""Buckets in a row, see `STEP_US`."""


class _Point(NamedTuple):
    """A pair, relative to the first one.

    Attributes:
        t: Camera time [us].
        delay: Host time less camera time [us].
    """

    t: float
    delay: float


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """Figures of the map.

    Attributes:
        offset_us: Host time less camera time [us], at the middle of the pairs.
        skew_ppm: How much faster the host's clock runs [1e-6].
        span_s: Time over which pairs were collected [s].
        steps: How often one of the clocks was set since the last restart.
    """

    offset_us: float
    skew_ppm: float
    span_s: float
    steps: int


class ClockMap:
    """A running map from the camera's clock [us] to the host's [ns since the Unix epoch].

    Attributes:
        ready: Whether there is a pair yet.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Discard all pairs, as after a reset of the camera's clock."""
        self.ready = False
        self._origin_us = self._origin_ns = 0
        self._buckets: deque[_Point] = deque(maxlen=BUCKETS)
        self._current: _Point | None = None
        self._bucket = self._late_buckets = self._steps = 0
        self._middle = self._level = self._slope = 0.0

    def add(self, camera_us: int, host_ns: int) -> None:
        """Add a pair.

        Args:
            camera_us: Camera time of the newest data of a transfer; does not decrease.
            host_ns: Host time of its arrival.
        """
        if not self.ready:
            self.ready = True
            self._origin_us, self._origin_ns = camera_us, host_ns
        t = float(camera_us - self._origin_us)
        point = _Point(t, (host_ns - self._origin_ns) / 1000 - t)
        excess = self._excess(point)
        if excess >= -STEP_US:
            self._collect(point)
        if excess < -STEP_US or self._late_buckets >= STEP_BUCKETS:
            steps = self._steps + 1
            self.restart()
            self._steps = steps
            self.add(camera_us, host_ns)
        elif excess < 0:
            self._fit()

    def to_host_ns(self, camera_us: int) -> int:
        """Return the host time [ns] of a camera time [us]; needs `ready`."""
        t = camera_us - self._origin_us
        delay_us = self._level + self._slope * (float(t) - self._middle)
        return self._origin_ns + t * 1000 + round(delay_us * 1000)

    def to_camera_us(self, host_ns: int) -> int:
        """Return the camera time [us] of a host time [ns]; needs `ready`."""
        elapsed = (host_ns - self._origin_ns) / 1000
        at = (elapsed - self._level + self._slope * self._middle) / (1 + self._slope)
        return self._origin_us + round(at)

    def estimate(self) -> ClockEstimate:
        """Return the figures of the map; needs `ready`."""
        points = self._points()
        return ClockEstimate(
            offset_us=self._origin_ns / 1000 - self._origin_us + self._level,
            skew_ppm=self._slope * 1e6,
            span_s=(points[-1].t - points[0].t) / 1e6 if points else 0.0,
            steps=self._steps,
        )

    def _excess(self, point: _Point) -> float:
        return point.delay - (self._level + self._slope * (point.t - self._middle))

    def _points(self) -> list[_Point]:
        return [*self._buckets, *([self._current] if self._current else [])]

    def _collect(self, point: _Point) -> None:
        bucket = int(point.t // BUCKET_US)
        if self._current is not None and bucket != self._bucket:
            late = self._excess(self._current) > STEP_US
            self._late_buckets = self._late_buckets + 1 if late else 0
            self._buckets.append(self._current)
            self._current = None
            self._fit()
        self._bucket = bucket
        if self._current is None or self._excess(point) < self._excess(self._current):
            self._current = point

    def _fit(self) -> None:
        points = self._points()
        self._middle = sum(p.t for p in points) / len(points)
        slope = 0.0
        if points[-1].t - points[0].t >= SKEW_AFTER_US:
            slope = min(max(_slope_below(points, self._middle), -MOST_SKEW), MOST_SKEW)
        self._slope = slope
        self._level = min(p.delay - slope * (p.t - self._middle) for p in points)


def _slope_below(points: list[_Point], middle: float) -> float:
    """Return the slope of the edge of the lower hull over `middle`; `points` are sorted."""
    t, delay = np.array(points).T
    left = int(t.searchsorted(middle))
    # The hull is the lowest of all lines between a point on the left and one on the right.
    slopes = (delay[left:] - delay[:left, None]) / (t[left:] - t[:left, None])
    heights = delay[:left, None] + slopes * (middle - t[:left, None])
    return float(slopes.flat[heights.argmin()])
