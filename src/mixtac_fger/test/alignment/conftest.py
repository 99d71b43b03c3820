# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Made-up recordings of taps, with the clocks known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from mixtac_fger.alignment.histories import BIN_US, EventCounts


@dataclass
class Scene:
    """Taps and slow presses, seen by a camera and a force sensor with clocks of their own."""

    taps_s: tuple[float, ...] = (1.2, 24.0)
    heights: tuple[float, ...] = (3.0, 2.6)
    tap_s: float = 0.014
    seconds: float = 26.0
    drift: float = 4e-5
    camera_start_us: int = 1_700_000_000_000_000
    reference_start_s: float = 1_690_000_123.25
    rate_hz: float = 800.0
    noise: float = 0.02
    events_per_newton: float = 9000.0
    background: float = 2e4
    presses: bool = True
    seed: int = 1
    limit: float = field(default=np.inf)
    latency_s: float = 4.15e-3  # the events come later than the force, as in the sensor

    def force(self, t: np.ndarray) -> np.ndarray:
        """Return the true force [N] at true times [s]."""
        force = np.zeros_like(t)
        for at, height in zip(self.taps_s, self.heights, strict=True):
            phase = np.clip((t - at) / self.tap_s, -0.5, 0.5)
            force += height * np.cos(np.pi * phase) ** 1.5
        if self.presses:
            on = (t > 3.0) & (t < self.seconds - 4.0)
            force += on * 0.4 * np.sin(np.pi * (t - 3.0) / 0.8) ** 2
        return force

    def recording(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return event times [us], force times [s] and force [N], each on its own clock."""
        rng = np.random.default_rng(self.seed)
        step = 1e-4
        t = np.arange(0.0, self.seconds, step)
        rate = self.background + self.events_per_newton * np.abs(np.gradient(self.force(t), step))
        count = rng.poisson(rate * step)
        events = np.sort(np.repeat(t, count) + rng.uniform(0.0, step, count.sum()))
        sampled = np.arange(0.0, self.seconds, 1.0 / self.rate_hz)
        measured = np.minimum(self.force(sampled), self.limit)
        measured = measured + rng.normal(0.0, self.noise, len(sampled)) * (measured < self.limit)
        camera = self.camera_start_us + np.rint((events + self.latency_s) * 1e6).astype(np.int64)
        return camera, self.reference_s(sampled), measured

    def reference_s(self, t: np.ndarray) -> np.ndarray:
        """Return true times on the reference clock [s]."""
        return self.reference_start_s + (1.0 + self.drift) * t

    def camera_us(self, t: float) -> int:
        """Return a true time on the camera clock [us]."""
        return self.camera_start_us + round(t * 1e6)


@pytest.fixture
def scene() -> type[Scene]:
    """Return the class, so that each test can set up its own scene."""
    return Scene


@pytest.fixture(scope='session')
def counted() -> Callable[[np.ndarray], EventCounts]:
    """Return a function that counts events at times [us]."""

    def count(t_us: np.ndarray) -> EventCounts:
        first = int(t_us.min()) // BIN_US
        return EventCounts(first * BIN_US, BIN_US, np.bincount(t_us // BIN_US - first))

    return count
