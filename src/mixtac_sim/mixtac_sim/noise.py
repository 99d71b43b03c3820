# SPDX-FileCopyrightText: 2026 Mixtac maintainers
# SPDX-License-Identifier: Apache-2.0
"""Events that no change of light has caused: shot noise, hot pixels, bursts from frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mixtac_sim.array_geometry import PIXELS
from mixtac_sim.random_streams import BlockStreams
from mixtac_sim.readout import pack

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from mixtac_sim.pixels import PixelSettings, PixelSpread

BURST_NS = 60_000
"""Time over which a frame's reset or readout disturbs pixels [ns] (estimate)."""


def shot_rate_hz(light_lux: NDArray[np.float32], settings: PixelSettings) -> NDArray[np.float64]:
    """Return the rate of shot-noise events of pixels, both polarities [Hz]; less in the light."""
    rate = settings.shot_hz / (1.0 + light_lux.astype(np.float64) / settings.shot_lux)
    return np.asarray(rate)


class NoiseSource:
    """Noise events, block by block; the light at rest sets their rates.

    Args:
        light_lux: Light at rest [pixels] [lx].
        settings: Settings of the chip.
        spread: Differences between pixels, for its hot pixels.
        frame_burst: Share of pixels that fire when a frame is reset or read.
        seed: Seed of the trial.
    """

    def __init__(
        self,
        light_lux: NDArray[np.float32],
        settings: PixelSettings,
        spread: PixelSpread,
        frame_burst: float,
        seed: int,
    ) -> None:
        self._cumulative = np.cumsum(shot_rate_hz(light_lux, settings))
        self._hot_pixel = spread.hot_pixel.astype(np.int64)
        self._hot = np.cumsum(spread.hot_hz)
        self._frame_burst = frame_burst
        self._streams = BlockStreams(seed, 'noise events')

    @property
    def shot_total_hz(self) -> float:
        """Return the rate of shot-noise events of the whole array [Hz]."""
        return float(self._cumulative[-1])

    @property
    def hot_total_hz(self) -> float:
        """Return the rate of all hot pixels together [Hz]."""
        return float(self._hot[-1])

    def block(self, index: int, span_ns: int, bursts_ns: Sequence[int]) -> NDArray[np.int64]:
        """Return the packed noise events of one block.

        Args:
            index: Number of the block.
            span_ns: Its length [ns].
            bursts_ns: Resets and readouts of frames in it, from its start [ns].
        """
        rng = self._streams.block(index)
        parts = [self._shot(rng, span_ns), self._hot_events(rng, span_ns)]
        parts += [self._burst(rng, at) for at in bursts_ns]
        return np.concatenate(parts)

    def _shot(self, rng: np.random.Generator, span_ns: int) -> NDArray[np.int64]:
        count = rng.poisson(self._cumulative[-1] * 1e-9 * span_ns)
        drawn = rng.random(count) * self._cumulative[-1]
        pixel = np.minimum(np.searchsorted(self._cumulative, drawn), PIXELS - 1)
        return pack(rng.integers(0, span_ns, count), pixel, rng.integers(0, 2, count))

    def _hot_events(self, rng: np.random.Generator, span_ns: int) -> NDArray[np.int64]:
        if not len(self._hot):
            return np.empty(0, np.int64)
        count = rng.poisson(self._hot[-1] * 1e-9 * span_ns)
        chosen = np.searchsorted(self._hot, rng.random(count) * self._hot[-1])
        pixel = self._hot_pixel[np.minimum(chosen, len(self._hot_pixel) - 1)]
        return pack(rng.integers(0, span_ns, count), pixel, np.ones(count, np.int64))

    def _burst(self, rng: np.random.Generator, at_ns: int) -> NDArray[np.int64]:
        count = rng.poisson(self._frame_burst * PIXELS)
        times = at_ns + rng.integers(0, BURST_NS, count)
        return pack(times, rng.integers(0, PIXELS, count), rng.integers(0, 2, count))
