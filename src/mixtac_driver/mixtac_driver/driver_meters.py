# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""What a running driver counts, for `/diagnostics`."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

from mixtac_node.rates import RateMeter, RecentValues

if TYPE_CHECKING:
    from mixtac_driver.clock_map import ClockEstimate


class DriverMeters:
    """Fed by the thread that publishes, read by the one that reports.

    Attributes:
        events: Events decoded.
        packets: Packets published.
        frames: Frames decoded.
        samples: Inertial samples decoded.
        edges: Edges of the external input and the generator decoded.
        edges_dropped: Edges not published because there were too many.
        ages_s: From arrival to publication of packets [s].
        clock: Latest figures of the clock map, or None.
        temperature: Latest temperature of the camera [degrees Celsius], NaN without.
        exposure_us: Exposure of the latest frame [us], NaN without.
    """

    def __init__(self) -> None:
        self.events, self.packets = RateMeter(), RateMeter()
        self.frames, self.samples, self.edges = RateMeter(), RateMeter(), RateMeter()
        self.edges_dropped = 0
        self.ages_s = RecentValues()
        self.clock: ClockEstimate | None = None
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
            'external edges not published': self.edges_dropped,
            'packet age median [s]': self.ages_s.quantile(0.5),
            'packet age p99 [s]': self.ages_s.quantile(0.99),
        }
        latest = {'temperature [C]': self.temperature, 'exposure [us]': self.exposure_us}
        return values | {name: value for name, value in latest.items() if not math.isnan(value)}
